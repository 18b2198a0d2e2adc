"""The belief itself, as a value: what is known of the plant at one moment."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import sqrt
from typing import Any


@dataclass(frozen=True, slots=True)
class Innovation:
    """A reading against its prediction: `value` = reading - prediction (degC), its predicted `variance`, its `square`.

    `square` is value^2 / variance, chi-square with one degree of freedom when the model is right.
    """

    value: float
    variance: float
    square: float


@dataclass(frozen=True, slots=True)
class Delayed:
    """What a dead time holds back until `due` (absolute s): an event's symbol, or new values of `signals`.

    Or `jumps` (degC/s) of what comes late after a delay of its own, by effect: from then on they fade.
    """

    due: float
    symbol: str = ""
    signals: Mapping[str, float] = field(default_factory=dict)
    jumps: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Hidden:
    """What effects add to a belief (`sim.engine.plant` has the states).

    `mean` (d + 1) and `covariance` (d + 1, d + 1) are those of the d states and of m, `opened` says whether the mean's
    thermostat is open, `since` has for each start-up effect the time of its event (None before any), `pending` what a
    dead time holds back, in the order in which it is due. `late` has for each effect with a part that comes late what
    fades of its deviation (degC/s; `sim.effects.late`).
    """

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    opened: bool = False
    since: tuple[float | None, ...] = ()
    pending: tuple[Delayed, ...] = ()
    late: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Belief:
    """The state of the plant as far as it is known at `time` (absolute seconds).

    `location` was entered at `entered`; temperature and mode parameter are Gaussian with means `x` (degC), `m` and
    covariance `xx`, `xm`, `mm`; `offset` (degC) is what the inputs `signals` add to the flow's target here. `last` is
    the newest innovation, `recent` the squares of the newest ones (as many as the tracker's window), `evidence` the
    log-likelihood of all readings so far. `samples` counts the readings used, `unmatched` the events that had no edge,
    `late` the readings and events that came with a time before the belief's, `clamps` the steps that ended beyond the
    automaton's range and were put back to its border. Until `seen`, no temperature was read; `read_at` (s) is when the
    newest one was.

    With effects `x` and `xx` are those of what the sensor would read, its noise apart, and `hidden` has all the states;
    under a dead time `location` and `signals` are those that act already.
    """

    location: str
    entered: float
    time: float
    x: float
    m: float
    xx: float
    xm: float
    mm: float
    offset: float
    signals: Mapping[str, float]
    last: Innovation | None = None
    recent: tuple[float, ...] = ()
    evidence: float = 0.0
    samples: int = 0
    unmatched: int = 0
    late: int = 0
    seen: bool = False
    clamps: int = 0
    hidden: Hidden | None = None
    read_at: float | None = None

    @property
    def age(self) -> float:
        """Seconds since the location was entered."""
        return self.time - self.entered

    @property
    def sigma(self) -> float:
        """Standard deviation of the temperature, degC."""
        return sqrt(self.xx)


def restore_belief(saved: Mapping[str, Any]) -> Belief:
    """The belief that `dataclasses.asdict` and JSON have taken apart. Raises KeyError or TypeError."""
    last = Innovation(**saved["last"]) if saved["last"] else None
    hidden = saved.get("hidden")
    # JSON has no tuples: what came back as a list is made one again, so that equal beliefs compare equal.
    if hidden:
        hidden = Hidden(
            mean=tuple(hidden["mean"]),
            covariance=tuple(tuple(row) for row in hidden["covariance"]),
            opened=hidden["opened"],
            since=tuple(hidden["since"]),
            pending=tuple(Delayed(**{**item, "jumps": tuple(item.get("jumps", ()))}) for item in hidden["pending"]),
            late=tuple(hidden.get("late", ())),  # a belief saved before there were any has none
        )
    return Belief(
        **{
            **saved,
            "last": last,
            "recent": tuple(saved["recent"]),
            "signals": dict(saved["signals"]),
            "hidden": hidden or None,
        }
    )
