"""The effects: what may act on top of the flows, or between the temperature and its sensor, as one table.

X is the temperature (degC), a signal's name stands for its held value, u for the seconds since the last `event`, t for
absolute seconds. "heat" is added to dX/dt (degC/s) while the automaton is in the effect's locations. A signal that was
not read yet adds nothing: its heat is 0, its loss is 0. docs/effects.md has the equations, and how exactly each engine
solves them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite

import numpy as np

from sim.sha.automaton import SHA, Effect
from sim.sha.trace import Array

ABSOLUTE_ZERO = -273.15
"""degC."""


@dataclass(frozen=True, slots=True)
class Range:
    """What a parameter may be, `low`..`high`, both ends included unless `positive` (then above 0), and its unit."""

    low: float = -inf
    high: float = inf
    unit: str = ""
    positive: bool = False

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
class EffectKind:
    """One kind of effect: the roles its signals fill, its parameters with their ranges, and what it is.

    `roles` must be filled, `optional` roles may be. A parameter in `instead` (parameter -> role) may be left out where
    that role is filled, and is then not looked at; `defaults` may always be left out. `event`: it needs the symbol
    since which it counts. `everywhere`: it acts in all locations or in none. `single`: an automaton has one at most.
    """

    plain: str
    equation: str
    params: Mapping[str, Range]
    roles: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    instead: Mapping[str, str] = field(default_factory=dict)
    defaults: Mapping[str, float] = field(default_factory=dict)
    event: bool = False
    everywhere: bool = False
    single: bool = False


_ANY = Range(unit="degC/s per unit of the signal")
_REFERENCE = Range(unit="of the signal")
_LOSS = Range(low=0.0, unit="1/s per unit of the pump")
_DEGREES = Range(unit="degC")
_SECONDS = Range(unit="s", positive=True)
_SHIFTED = {"scale": Range(unit="1", positive=True), "shift": _DEGREES}
_AS_IT_IS = {"scale": 1.0, "shift": 0.0}


def _friction(signal: str, plain: str) -> EffectKind:
    return EffectKind(
        plain,
        f"heat gain*({signal}^power - reference^power), a negative {signal} counting as 0",
        {"gain": Range(unit="degC/s per unit of the power"), "reference": _REFERENCE, "power": Range(0.1, 5.0, "1")},
        roles=(signal,),
    )


EFFECTS: dict[str, EffectKind] = {
    "current-heating": EffectKind(
        "heating that grows in proportion to the motor's current",
        "heat gain*(current - reference)",
        {"gain": _ANY, "reference": _REFERENCE},
        roles=("current",),
    ),
    "quadratic-current-heating": EffectKind(
        "heating that grows with the square of the motor's current (copper losses)",
        "heat gain*(current^2 - reference^2)",
        {"gain": Range(unit="degC/s per squared unit of the signal"), "reference": _REFERENCE},
        roles=("current",),
    ),
    "current-saturation": EffectKind(
        "heating by the current that stops growing above a knee",
        "heat -gain*max(current - knee, 0)",
        {"gain": _ANY, "knee": _REFERENCE},
        roles=("current",),
    ),
    "torque-friction": _friction("torque", "friction heat that grows with the torque"),
    "speed-friction": _friction("speed", "friction heat that grows with the speed"),
    "vibration-friction": _friction("vibration", "friction heat that grows with the vibration"),
    "ambient-coupling": EffectKind(
        "the room's temperature carried into the bearing",
        "heat gain*(ambient - reference)",
        {"gain": Range(unit="1/s"), "reference": _DEGREES},
        roles=("ambient",),
    ),
    "feed-temperature-coupling": EffectKind(
        "the feed, at its own temperature, flowing past the bearing",
        "heat -loss*pump*(X - feed), the pump counting as 1 where it has no signal",
        {"loss": _LOSS, **_SHIFTED},
        roles=("feed",),
        optional=("pump",),
        defaults=_AS_IT_IS,
    ),
    "pump-cooling": EffectKind(
        "cooling while the pump runs",
        "heat -loss*pump*(X - sink), sink the signal of that role or the parameter",
        {"loss": _LOSS, "sink": _DEGREES, **_SHIFTED},
        roles=("pump",),
        optional=("sink",),
        instead={"sink": "sink"},
        defaults=_AS_IT_IS,
    ),
    "startup-churning": EffectKind(
        "extra heat after a start that dies away (cold grease being churned)",
        "heat gain*exp(-(u/tau)^shape)",
        {"gain": Range(unit="degC/s"), "tau": _SECONDS, "shape": Range(0.2, 5.0, "1")},
        event=True,
    ),
    "wear-drift": EffectKind(
        "friction heat that grows steadily with time (wear)",
        "heat gain*max(t - since, 0)",
        {"gain": Range(unit="degC/s^2"), "since": Range(unit="s, absolute")},
    ),
    "dead-time": EffectKind(
        "a dead time before anything that happens is felt",
        "events and signals act `delay` s later",
        {"delay": Range(low=0.0, unit="s")},
        everywhere=True,
        single=True,
    ),
    "sensor-lag": EffectKind(
        "a sensor that follows the temperature with a lag",
        "the sensor reads the last of `order` first-order lags of tau/order each, driven by X",
        {"tau": _SECONDS, "order": Range(1, 3, "1")},
        everywhere=True,
        single=True,
    ),
    "sensor-offset-step": EffectKind(
        "a sensor that reads wrong by a constant from one moment on",
        "the sensor reads X + size from t >= at on",
        {"size": _DEGREES, "at": Range(unit="s, absolute")},
        everywhere=True,
    ),
    "housing-thermal-mass": EffectKind(
        "a housing that stores heat and gives it back slowly",
        "heat coupling*(H - X), dH/dt = (X - H)/tau, H starts at X",
        {"coupling": Range(low=0.0, unit="1/s"), "tau": _SECONDS},
        single=True,
    ),
    "thermostatic-cooling": EffectKind(
        "cooling that a thermostat switches on and off",
        "heat -loss*(X - sink) while open; opens at X >= opens, closes at X <= closes, closed at the start",
        {"loss": Range(low=0.0, unit="1/s"), "sink": _DEGREES, "opens": _DEGREES, "closes": _DEGREES},
        single=True,
    ),
    "radiation-loss": EffectKind(
        "heat lost by radiation to the surroundings",
        "heat -gain*((X - zero)^4 - (Ts - zero)^4), Ts the ambient signal or `surroundings`, zero -273.15 degC",
        {"gain": Range(low=0.0, unit="1/(s degC^3)"), "surroundings": _DEGREES, "zero": _DEGREES, **_SHIFTED},
        optional=("ambient",),
        instead={"surroundings": "ambient"},
        defaults={**_AS_IT_IS, "zero": ABSOLUTE_ZERO},
        single=True,
    ),
}
"""All kinds. `scale` and `shift` map a temperature signal into the scale of X where the two differ (`correction`)."""


def parameter(effect: Effect, name: str) -> float:
    """The value of a parameter, its kind's default where it is left out."""
    if name in effect.params:
        return effect.params[name]
    return EFFECTS[effect.kind].defaults[name]


def acts_in(effect: Effect, location: str) -> bool:
    """True where the effect acts in the location of that name."""
    return not effect.locations or location in effect.locations


def check_effect(effect: Effect) -> None:
    """Raises ValueError, saying what would be right, for an unknown kind, parameters or roles that it cannot use."""
    kind = EFFECTS.get(effect.kind)
    if kind is None:
        raise ValueError(f"unknown effect {effect.kind!r}: known are {', '.join(EFFECTS)}")
    _check_params(effect, kind)
    _check_signals(effect, kind)
    if kind.event != bool(effect.event):
        said = "needs the event since which it counts" if kind.event else "counts from no event; leave `event` empty"
        raise ValueError(f"effect {effect.kind!r} {said}")
    if kind.everywhere and effect.locations:
        raise ValueError(f"effect {effect.kind!r} acts everywhere; leave `locations` empty")


def _check_params(effect: Effect, kind: EffectKind) -> None:
    spared = {name for name, role in kind.instead.items() if role in effect.signals} | set(kind.defaults)
    missing = [name for name in kind.params if name not in effect.params and name not in spared]
    strange = [name for name in effect.params if name not in kind.params]
    if missing or strange:
        wrong = f"{missing[0]} is missing" if missing else f"{strange[0]} is unknown"
        raise ValueError(f"effect {effect.kind!r} takes the parameters {', '.join(kind.params)}; {wrong}")
    for name, value in effect.params.items():
        if not kind.params[name].holds(value):
            raise ValueError(f"effect {effect.kind!r}: {name} must be {kind.params[name].words}, got {value:g}")
    if effect.kind == "sensor-lag" and effect.params["order"] != int(effect.params["order"]):
        raise ValueError(f"effect 'sensor-lag': order must be 1, 2 or 3, got {effect.params['order']:g}")
    if effect.kind == "thermostatic-cooling" and not effect.params["closes"] < effect.params["opens"]:
        raise ValueError(
            f"effect 'thermostatic-cooling' must close below where it opens: closes {effect.params['closes']:g}, "
            f"opens {effect.params['opens']:g} degC"
        )


def _check_signals(effect: Effect, kind: EffectKind) -> None:
    known = (*kind.roles, *kind.optional)
    missing = [role for role in kind.roles if not effect.signals.get(role)]
    strange = [role for role in effect.signals if role not in known]
    if missing or strange:
        wrong = f"{missing[0]} is missing" if missing else f"{strange[0]} is unknown"
        roles = [*kind.roles, *(f"{role} (optional)" for role in kind.optional)]
        raise ValueError(f"effect {effect.kind!r} takes signals for {', '.join(roles) or 'nothing'}; {wrong}")


def check_effects(sha: SHA) -> None:
    """Raises ValueError, naming the effect, unless every one can be executed in this automaton."""
    symbols = {edge.symbol for edge in sha.edges}
    seen: set[str] = set()
    for effect in sha.effects:
        try:
            check_effect(effect)
        except ValueError as error:
            raise ValueError(f"SHA {sha.name!r}: {error}") from None
        if effect.event and effect.event not in symbols:
            raise ValueError(
                f"SHA {sha.name!r}: effect {effect.kind!r} counts since the event {effect.event!r}, which no edge has; "
                f"known are {', '.join(sorted(symbols)) or 'none'}"
            )
        if EFFECTS[effect.kind].single and effect.kind in seen:
            raise ValueError(f"SHA {sha.name!r}: the effect {effect.kind!r} stands there twice; one is all it can have")
        seen.add(effect.kind)


def signals_of(sha: SHA, location: str | None = None) -> tuple[str, ...]:
    """The signals that the effects acting in a location (in any, by default) read, each once, in their order."""
    acting = [effect for effect in sha.effects if location is None or acts_in(effect, location)]
    return tuple(dict.fromkeys(signal for effect in acting for signal in effect.signals.values()))


def of_kind(sha: SHA, kind: str) -> Effect | None:
    """The effect of a kind of which there is one at most; None without it."""
    return next((effect for effect in sha.effects if effect.kind == kind), None)


def dead_time(sha: SHA) -> float:
    """Seconds by which events and signals act later; 0 without that effect."""
    effect = of_kind(sha, "dead-time")
    return 0.0 if effect is None else effect.params["delay"]


def sensor_offset(sha: SHA, time: float) -> float:
    """What the sensor reads too much (degC) at an absolute time (s)."""
    return float(sensor_offsets(sha, np.array(time)))


def sensor_offsets(sha: SHA, times: Array) -> Array:
    """What the sensor reads too much (degC) at each of the times (absolute s)."""
    total = np.zeros(times.shape)
    for effect in sha.effects:
        if effect.kind == "sensor-offset-step":
            total = total + np.where(times >= effect.params["at"], effect.params["size"], 0.0)
    return total


def told(effect: Effect) -> str:
    """One line that says all of an effect: kind, parameters, signals, locations and event."""
    parts = [f"{name} {value:g}" for name, value in effect.params.items()]
    parts += [f"{role} {signal}" for role, signal in effect.signals.items()]
    parts += [f"since {effect.event}"] if effect.event else []
    parts += [f"in {', '.join(effect.locations)}"] if effect.locations else []
    return f"{effect.kind}: {'; '.join(parts)}"


def refusal(sha: SHA, what: str) -> str:
    """The sentence by which `what` (such as "the UPPAAL export") declines a model with effects; "" without effects."""
    if not sha.effects:
        return ""
    kinds = ", ".join(dict.fromkeys(effect.kind for effect in sha.effects))
    return f"{what} does not do effects yet, and model {sha.name!r} has {kinds}; use simulation or the filter instead"


def refuse(sha: SHA, what: str) -> None:
    """Raises ValueError with the sentence of `refusal`; nothing without effects."""
    said = refusal(sha, what)
    if said:
        raise ValueError(said)
