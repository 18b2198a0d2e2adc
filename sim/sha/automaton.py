"""A stochastic hybrid automaton as a description: locations, flows, edges. No current state lives in here."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Literal

from sim.sha.effect_line import EffectLine

Entry = Literal["parameter", "resample", "none"]
"""What entering a location does: draw the mode parameter m (X stays continuous), draw X (the thesis), or nothing."""


@dataclass(frozen=True, slots=True)
class Distribution:
    """A probability law: `kind` is a key of `distributions.LAWS`, `params` its parameters by name."""

    kind: str
    params: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Input:
    """A signal that moves a driven flow's target by gain * (signal - reference), degC per unit of the signal."""

    signal: str
    gain: float
    reference: float = 0.0


@dataclass(frozen=True, slots=True)
class Flow:
    """How the temperature moves inside a location: `kind` is a key of `flows.FLOWS`, `params` its constants by name.

    `k` in 1/s, `t0` and `tau` in s, `noise` in degC/sqrt(s). `inputs` only for `driven`. Any flow may fix its
    mode parameter by a constant `m` (in m's unit, see Location), where the location's entry does not draw it.
    """

    kind: str
    params: Mapping[str, float] = field(default_factory=dict)
    inputs: tuple[Input, ...] = ()


@dataclass(frozen=True, slots=True)
class Location:
    """One mode of the plant. `distribution` is the law of the mode parameter m (or of X on entry, for `resample`).

    What m means depends on the flow: the target temperature (exponential, driven; degC), the drift (linear; degC/s),
    the factor of 1/(t0+u) (logarithmic; degC), how far X moves after entry in all (transient; degC); nothing for
    constant.
    """

    name: str
    flow: Flow
    distribution: Distribution | None = None
    entry: Entry = "parameter"


@dataclass(frozen=True, slots=True)
class Edge:
    """A move from `source` to `target` on `symbol`. `guard` is kept as the artefact wrote it."""

    source: str
    symbol: str
    target: str
    guard: str | None = None


@dataclass(frozen=True, slots=True)
class Effect:
    """Something that acts on top of the flows, or between the temperature and its sensor.

    `kind` is a key of `effects.EFFECTS`, which says what `params` it takes and which roles `signals` fills (role -> the
    signal's name). It acts while the automaton is in one of `locations`, everywhere when there are none. `event` is the
    symbol since whose last occurrence an effect with a clock of its own counts. An engineer's own effect brings its
    `line`, from which its kind is made; `kind` is then the line's name.
    """

    kind: str
    params: Mapping[str, float]
    signals: Mapping[str, str] = field(default_factory=dict)
    locations: tuple[str, ...] = ()
    event: str = ""
    line: EffectLine | None = None


@dataclass(frozen=True, slots=True)
class SHA:
    """Locations, edges and the location where a trace starts.

    `max_rate` (degC/s) saturates every drift on both sides; `low`..`high` (degC) clamps the temperature, and clamps are
    counted by whoever simulates. `effects` act on top of the flows (`sim.effects.kinds`). Raises ValueError, naming the
    part, when a name is doubled, or an edge or an effect names a location that is not there.
    """

    name: str
    locations: tuple[Location, ...]
    edges: tuple[Edge, ...]
    initial: str
    max_rate: float = inf
    low: float = 0.0
    high: float = 150.0
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        known = Counter(location.name for location in self.locations)
        for name, times in known.items():
            if times > 1:
                raise ValueError(f"SHA {self.name!r}: location {name!r} is defined {times} times")
        if self.initial not in known:
            raise ValueError(f"SHA {self.name!r}: the initial location {self.initial!r} is not among its locations")
        for edge in self.edges:
            for end in (edge.source, edge.target):
                if end not in known:
                    raise ValueError(
                        f"SHA {self.name!r}: edge {edge.source} -{edge.symbol}-> {edge.target} names the location "
                        f"{end!r}, which is not defined"
                    )
        for effect in self.effects:
            for name in effect.locations:
                if name not in known:
                    raise ValueError(
                        f"SHA {self.name!r}: the effect {effect.kind!r} names the location {name!r}, "
                        f"which is not defined"
                    )
        if not self.max_rate > 0 or not self.low < self.high:
            raise ValueError(f"SHA {self.name!r}: max_rate must be positive and low below high")

    @property
    def by_name(self) -> dict[str, Location]:
        """The locations by their names (made anew at each call: keep it outside loops)."""
        return {location.name: location for location in self.locations}


def nondeterminism(sha: SHA) -> list[str]:
    """One sentence for each (location, symbol) that has several different targets; empty when deterministic."""
    targets: dict[tuple[str, str], str] = {}
    several: dict[tuple[str, str], set[str]] = {}
    for edge in sha.edges:
        move = edge.source, edge.symbol
        target = targets.setdefault(move, edge.target)
        if target != edge.target:
            several.setdefault(move, {target}).add(edge.target)
    return [
        f"location {source!r} has {len(ends)} targets on {symbol!r}: {', '.join(sorted(ends))}"
        for (source, symbol), ends in sorted(several.items())
    ]


def transitions(sha: SHA) -> dict[tuple[str, str], str]:
    """(source, symbol) -> target. Raises ValueError with the first conflict when the automaton is not deterministic."""
    conflicts = nondeterminism(sha)
    if conflicts:
        raise ValueError(f"SHA {sha.name!r} is not deterministic: {conflicts[0]}")
    guarded = next((edge for edge in sha.edges if edge.guard), None)
    if guarded is not None:
        raise ValueError(
            f"SHA {sha.name!r}: edge {guarded.source} -{guarded.symbol}-> {guarded.target} has the guard "
            f"{guarded.guard!r}; guards are kept but not executed yet"
        )
    return {(edge.source, edge.symbol): edge.target for edge in sha.edges}
