"""What a kind of effect is: one complete object, from which every engine takes what it needs.

X is the temperature (degC). A kind that lacks a part cannot be constructed, and an engine that meets a form of law,
bound or text that it does not know refuses the kind by its name (`unknown`): what is forgotten is never ignored.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Literal, Protocol

import numpy as np

from sim.effects.expression import Expression
from sim.sha import Array, Effect

Signals = Mapping[str, Array]
"""signal -> its held values; NaN before the first reading."""
Acts = Literal["running", "anywhere", "everywhere"]
"""Where a diagnosis lets it act: while the machine runs; in any locations; in all at once, as it is none's own."""
Rescaled = Literal["stays", "scaled", "mapped", "inverse cube"]
"""What becomes of a parameter p under T' = k T + b: p, k p, k p + b, p / k^3 (`correction`)."""
Feature = Literal[
    "dead time", "sensor lag", "sensor offset", "housing", "thermostat", "radiation", "disturbance", "machine offset"
]
"""What engines execute by code of their own, since it is no heat that could be written down beside the others."""

ABSOLUTE_SECONDS = "s, absolute"
"""The unit of a moment on the traces' clock: whoever counts from another zero moves such parameters."""

FEATURES: Mapping[Feature, tuple[str, ...]] = {
    "dead time": ("delay",),
    "sensor lag": ("tau", "order"),
    "sensor offset": ("size", "at"),
    "housing": ("coupling", "tau"),
    "thermostat": ("loss", "sink", "opens", "closes"),
    "radiation": ("gain", "surroundings", "zero", "linear", "scale", "shift"),
    "disturbance": ("sigma", "memory"),
    "machine offset": ("sigma",),
}
"""The parameters that the code of each feature reads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """`low`..`high` are usable, both ends included unless `positive` (then above 0), only integers where `whole`.

    One with a `default` may be left out, and so may one whose `role` is filled: the signal takes its place.
    """

    unit: str
    rescaled: Rescaled
    low: float = -inf
    high: float = inf
    positive: bool = False
    whole: bool = False
    default: float | None = None
    role: str = ""

    def holds(self, value: float) -> bool:
        """True for a usable value."""
        return isfinite(value) and self.low <= value <= self.high and (value > 0 or not self.positive)

    @property
    def words(self) -> str:
        """The range in words, such as "positive and finite"."""
        parts = ["positive"] if self.positive else [f"at least {self.low:g}"] if isfinite(self.low) else []
        parts += [f"at most {self.high:g}"] if isfinite(self.high) else []
        return " and ".join([*parts, "finite"]) if len(parts) < 2 else " and ".join(parts)


@dataclass(frozen=True, slots=True)
class Role:
    """What a signal is to an effect, and the plant's signal that usually is it ("": the plant has none)."""

    name: str
    signal: str


@dataclass(frozen=True, slots=True, kw_only=True)
class OptionalRole:
    """A role that may be absent, `without` says what then; `acts` is where the effect acts then, if not as usual."""

    role: Role
    without: str
    acts: Acts | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Roles:
    """The signals that a kind reads."""

    needed: tuple[Role, ...] = ()
    optional: tuple[OptionalRole, ...] = ()


# ------------------------------------------------------------------ laws: the one physics


@dataclass(frozen=True, slots=True)
class HeldLaw:
    """dX/dt += heat - loss X, (heat, loss) being held while the signals are: degC/s and 1/s, NaN where one is not read.

    Signals that were never read give NaN, and an engine then adds nothing.
    """

    heat_and_loss: Callable[[Effect, Signals], tuple[Array, Array]]


@dataclass(frozen=True, slots=True, kw_only=True)
class VaryingLaw:
    """dX/dt += heat(effect, time, since), which changes by itself while the signals stay.

    `time` is absolute s, `since` the seconds since the effect's `event` (inf before any), if `from_event`.
    `knots(effect, starts)` are the times at which the law is cut so that it is near a parabola from one to the next,
    `starts` being the ascending times of the event. `speed` (1/s) is how fast it changes at most, for grids.
    """

    heat: Callable[[Effect, Array, Array], Array]
    knots: Callable[[Effect, Array], Array]
    speed: Callable[[Effect], float]
    from_event: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordView:
    """A record as a law that only a diagnosis knows reads it, each (n,): `time` (absolute s) in the middle of each step
    of it, `running` 0 or 1, `rate` (1/s) at which the model's own flow goes to where it tends (0: nowhere), `signals`
    by role.

    `late(role, lag)` is a signal through a first-order lag (s), `run_since(at)` the seconds that the machine has run
    since a moment (absolute s; below 0 before it); both run on through what was cut out of the record.
    """

    time: Array
    running: Array
    rate: Array
    signals: Signals
    late: Callable[[str, float], Array]
    run_since: Callable[[float], Array]


@dataclass(frozen=True, slots=True)
class RecordedLaw:
    """dX/dt += heat - loss X along a record: of a rival without a name, which no engine executes."""

    heat_and_loss: Callable[[Effect, RecordView], tuple[Array, Array]]


@dataclass(frozen=True, slots=True, kw_only=True)
class LatePart:
    """The part of a held heat that comes after a dead time and through a first-order lag, whose parameters (s) `delay`
    and `lag` name: a lag of 0 is at once.

    `source(effect, signals)` is that part (degC/s) as the law holds it where the effect acts, NaN where a signal is not
    read. To what the law holds there is added, in all locations, since it goes on after a stop,

        dX/dt += D,    D = late - source,    d late/dt = (source(t - delay) - late) / lag

    with late = source before and at the first reading. So it follows from the signals alone (`sim.effects.late`).
    `heat` is the source as an expression and `text` as UPPAAL's; what else the law holds does not change with the
    signals.
    """

    lag: str
    delay: str
    source: Callable[[Effect, Signals], Array]
    heat: Expression
    text: "TextLaw"


@dataclass(frozen=True, slots=True)
class Structural:
    """As law, bound or text: the engines' own code of this feature does it."""

    feature: Feature


@dataclass(frozen=True, slots=True)
class EffectRefusal:
    """As bound or text: it is not done, for this reason (the end of a sentence that begins with the kind's name)."""

    reason: str


Law = HeldLaw | VaryingLaw | RecordedLaw | Structural


# ------------------------------------------------------------------ bounds: the law over intervals, for `verify`


@dataclass(frozen=True, slots=True)
class ExpressedBound:
    """The held heat that is written as an expression over roles, parameters and perhaps the temperature.

    It is enclosed over intervals (`expressed.enclosure`); straight in the temperature, and never growing with it.
    """

    heat: Expression


@dataclass(frozen=True, slots=True, kw_only=True)
class LossBound:
    """A heat -loss s (X - sink): s the signal of the role `strength`, at least 0 (1 without it), sink that of `sink`.

    The parameter `loss` is that of s = 1; a parameter called like the role `sink` stands in for its signal.
    """

    strength: str
    sink: str


@dataclass(frozen=True, slots=True, kw_only=True)
class VaryingBound:
    """(least, greatest) heat in degC/s; `grows_from` (absolute s) where it grows without end, then up to `horizon` s.

    `extremes` is called with the effect and the horizon.
    """

    extremes: Callable[[Effect, float], tuple[float, float]]
    grows_from: Callable[[Effect], float] | None = None


BoundLaw = ExpressedBound | LossBound | VaryingBound | Structural | EffectRefusal


# ------------------------------------------------------------------ UPPAAL's text


class TextWriter(Protocol):
    """What the export offers to a text law."""

    x: str

    def constant(self, name: str, value: float) -> str:
        """Declares a constant; its name in the document."""

    def read(self, effect: Effect, role: str) -> tuple[str, str]:
        """(value, flag that it was read) of the signal of a role."""

    def degrees(self, effect: Effect, role: str) -> str:
        """A temperature signal in the scale of X."""

    def since(self, effect: Effect) -> tuple[str, str]:
        """(flag that the effect's event was there, clock of the seconds since)."""

    def moment(self, name: str, time: float) -> str:
        """Declares an absolute time (s) as a constant on the document's `time`."""


@dataclass(frozen=True, slots=True)
class TextLaw:
    """The term of X's rate with its sign, as UPPAAL's text."""

    term: Callable[[TextWriter, Effect], str]


UppaalLaw = TextLaw | Structural | EffectRefusal


# ------------------------------------------------------------------ candidates of a diagnosis

COLD_SHARE = 0.02
"""Of a record, the coldest part, of which the warmest reading stands for what is read at rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineLog:
    """A record from which shapes are guessed, each (n,): `time` at the end of each step of `dt` s, `running` 0 or 1.

    `signals` are by role, never NaN; `smooth` (degC) is the reading without its noise.
    """

    time: Array
    dt: Array
    running: Array
    smooth: Array
    signals: Mapping[str, Array]

    def usual(self, role: str, *, running: bool) -> float:
        """The time's mean of a signal, or that of the time in which the machine runs."""
        column, weight = self.signals[role], self.dt * (self.running if running else 1.0)
        return float(np.average(column, weights=weight)) if weight.sum() > 0 else float(np.mean(column))

    @property
    def cold(self) -> float:
        """degC at rest."""
        return float(np.quantile(self.smooth, COLD_SHARE))

    @property
    def rests(self) -> bool:
        """Whether it rests in more of the record than what is `cold`; in less of it, nothing says how cold rest is."""
        return float(np.mean(self.running < 0.5)) > COLD_SHARE


Params = Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectCandidate:
    """How a diagnosis looks for a kind: shapes are tried, the strength is what the likelihood finds.

    `strength` names the parameter that scales it, `sign` what physics allows of it (0: either). `shapes` are the sets
    of the other parameters that are tried; `refine` gives the range of each one that is searched further, from one
    step of `widths` to the next (without one as a time or in degC), `either` those of which every value is fitted,
    since the screen, which is linear, cannot choose among them.
    `scan(times, score)` gives further shapes where the score (m,) of the residual (weighed by its inverse covariance)
    is greatest; `burden` (nats) is what looking at so many places costs. `experiment` would tell it from its twins.
    `look` says what to look at at the machine: part, sensor or habit, in the plant's words.
    `most` bounds the strength, `settled` makes the parameters of a trial agree with one another, and `jointly` names
    those of a shape (in degC) that every fit moves together with the strength.
    `once`: the strength is itself a time, so that twice of it is not twice the effect. A shape may have parameters that
    the kind has not: what they stand for is another effect (`besides`: (kind, parameters) from the whole shape), or
    that optional signals are left unread (`unread`, where it is not 0), or which share of the strength acts where the
    machine rests (`at_rest`; 1 where a shape has it not). `special`: the kinds that are special cases of it; where
    it does no better than they do, it is one of them and is left out. `words` says one of given parameters in the
    plant's words, for what has no name.
    """

    strength: str
    sign: float
    experiment: str
    look: str
    shapes: Callable[[MachineLog], Sequence[Params]]
    refine: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    widths: Mapping[str, float] = field(default_factory=dict)
    either: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    scan: Callable[[Array, Array], Sequence[Params]] | None = None
    burden: float = 0.0
    most: float = inf
    settled: Callable[[Params], Params] = lambda params: params
    jointly: Callable[[Params], tuple[str, ...]] = lambda _: ()
    once: bool = False
    besides: Callable[[Params], tuple[str, Mapping[str, float]] | None] | None = None
    unread: str = ""
    at_rest: str = ""
    special: tuple[str, ...] = ()
    words: Callable[[Params], str] | None = None


# ------------------------------------------------------------------ the kind


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectKind:
    """One kind of effect. Raises ValueError, naming it, where its parts do not fit one another.

    `meaning` is the one phrase that says what it is, `late` what of its heat may come through a lag. `consistent` gives
    what is wrong with parameters that are each in their range ("": nothing).
    """

    name: str
    meaning: str
    parameters: Mapping[str, Parameter]
    roles: Roles
    acts: Acts
    law: Law
    bound: BoundLaw
    uppaal: UppaalLaw
    candidate: EffectCandidate | None
    late: LatePart | None = None
    consistent: Callable[[Params], str] = lambda _: ""

    def __post_init__(self) -> None:
        wrong = self._misfit()
        if wrong:
            raise ValueError(f"the kind of effect {self.name!r} {wrong}")

    def _misfit(self) -> str:
        if not self.name or not self.meaning:
            return "needs a name and a meaning"
        if isinstance(self.law, Structural):
            lacking = [name for name in FEATURES[self.law.feature] if name not in self.parameters]
            if lacking:
                return f"is executed as a {self.law.feature}, which reads the parameter {lacking[0]!r}"
        for part in (self.bound, self.uppaal):
            if isinstance(part, Structural) and part != self.law:
                return f"is bounded or exported as a {part.feature}, which is not its law"
        if isinstance(self.bound, ExpressedBound | LossBound) and not isinstance(self.law, HeldLaw):
            return "has the bound of a held law, and another law"
        if isinstance(self.bound, ExpressedBound) and (not self.roles.needed or self.roles.optional):
            return "has the bound of an expression, which is for kinds that read signals, none of them optional"
        if isinstance(self.bound, LossBound) and "loss" not in self.parameters:
            return "has the bound of a loss, and no parameter 'loss'"
        if isinstance(self.bound, VaryingBound) and not isinstance(self.law, VaryingLaw):
            return "has the bound of a varying law, and another law"
        late = self.late
        if late is not None and not ({late.lag, late.delay} <= set(self.parameters) and isinstance(self.law, HeldLaw)):
            return f"has a part that comes late: that asks for a held law, parameters {late.lag!r} and {late.delay!r}"
        if self.candidate is not None and self.candidate.strength not in self.parameters:
            return f"is scaled by {self.candidate.strength!r}, which is no parameter of it"
        return ""

    @property
    def required_roles(self) -> tuple[str, ...]:
        """The roles that must be filled."""
        return tuple(role.name for role in self.roles.needed)

    @property
    def optional(self) -> tuple[str, ...]:
        """The roles that may be filled."""
        return tuple(optional.role.name for optional in self.roles.optional)

    @property
    def from_event(self) -> bool:
        """Whether it counts since an event."""
        return isinstance(self.law, VaryingLaw) and self.law.from_event

    @property
    def single(self) -> bool:
        """Whether an automaton has one at most: engines have one state for each feature, but add up offsets."""
        return isinstance(self.law, Structural) and self.law.feature != "sensor offset"

    def action_place(self, signals: Mapping[str, str]) -> Acts:
        """Where it acts with the signals that fill its roles."""
        absent = [
            optional.acts
            for optional in self.roles.optional
            if optional.role.name not in signals and optional.acts is not None
        ]
        return absent[0] if absent else self.acts


def unknown(engine: str, kind: str, part: object) -> ValueError:
    """The error of an engine that meets a form of law, bound or text that it does not know."""
    form = f"{type(part).__name__} of a {part.feature}" if isinstance(part, Structural) else type(part).__name__
    return ValueError(f"{engine} does not know effects of the kind {kind!r} ({form})")
