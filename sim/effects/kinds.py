"""The table of all kinds of effects, and what is asked of the effects that an automaton has.

docs/effects.md has the equations, how exactly each engine solves them, and how a row is added.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effects.exchange import BENDING, FLOWING, HOUSING
from sim.effects.heating import HEATING
from sim.effects.kind import (
    ABSOLUTE_SECONDS,
    EffectKind,
    Feature,
    Structural,
    VaryingBound,
)
from sim.effects.lines import LineError, kind_of_line
from sim.effects.random import RANDOM
from sim.effects.rivals import RIVAL_KINDS, moment_words
from sim.effects.sensing import SENSING
from sim.effects.varying import VARYING
from sim.sha import SHA, Array, Effect, EffectLine

EFFECTS: dict[str, EffectKind] = {
    kind.name: kind for kind in (*HEATING, *FLOWING, HOUSING, *VARYING, *SENSING, *BENDING, *RANDOM)
}
"""All kinds by name, in the order in which a diagnosis tries them."""

RIVALS: dict[str, EffectKind] = {kind.name: kind for kind in RIVAL_KINDS}
"""Kinds that a diagnosis holds beside the others, and that no engine executes."""

ROLES: dict[str, str] = {
    role.name: role.signal
    for kind in EFFECTS.values()
    for role in (*kind.roles.needed, *(optional.role for optional in kind.roles.optional))
    if role.signal
}
"""The signal of each role at the decanter: of a model or a recording that does not say its own roles."""


def usual_roles(roles: Mapping[str, str] | None) -> Mapping[str, str]:
    """The `roles` that somebody said, the decanter's where nobody did."""
    return ROLES if roles is None else roles


def effect_kind(effect: Effect) -> EffectKind:
    """The kind of an effect, made of its own line where it brings one. Raises ValueError for an unknown one."""
    if effect.line is not None:
        if effect.line.name != effect.kind:
            raise ValueError(
                f"the effect {effect.kind!r} brings a line with the name {effect.line.name!r}; give both one name"
            )
        return own_kind(effect.line)
    kind = EFFECTS.get(effect.kind) or RIVALS.get(effect.kind)
    if kind is None:
        raise ValueError(f"unknown effect {effect.kind!r}: known are {', '.join(EFFECTS)}")
    return kind


def own_kind(line: EffectLine) -> EffectKind:
    """The kind that an engineer's line stands for. Raises LineError, a ValueError, with the key and the reason."""
    if line.name in EFFECTS or line.name in RIVALS:
        raise LineError("name", f"{line.name!r} is a kind of the catalogue already; give the effect another name")
    return kind_of_line(line)


def parameter(effect: Effect, name: str) -> float:
    """The value of a parameter, its kind's default where it is left out."""
    if name in effect.params:
        return effect.params[name]
    default = effect_kind(effect).parameters[name].default
    if default is None:
        raise KeyError(name)
    return default


def heat_lag(effect: Effect) -> float:
    """Seconds by which a part of the effect's heat comes late; 0 where all of it is there at once."""
    late = effect_kind(effect).late
    return 0.0 if late is None else parameter(effect, late.lag)


def delay_of(effect: Effect) -> float:
    """Seconds after which what comes late of the effect's heat begins to come; 0 without such a part."""
    late = effect_kind(effect).late
    return 0.0 if late is None else parameter(effect, late.delay)


def affects_location(effect: Effect, location: str) -> bool:
    """True where the effect acts in the location of that name."""
    return not effect.locations or location in effect.locations


def effect_signals(sha: SHA, location: str | None = None) -> tuple[str, ...]:
    """The signals that the effects acting in a location (in any, by default) read, each once, in their order.

    Those of a heat that comes late are read everywhere, as what comes is known from all of them.
    """
    acting = [
        each for each in sha.effects if location is None or affects_location(each, location) or heat_lag(each) > 0
    ]
    return tuple(dict.fromkeys(signal for effect in acting for signal in effect.signals.values()))


def of_feature(sha: SHA, feature: Feature) -> tuple[Effect, ...]:
    """The effects that engines execute by their code of a feature."""
    laws = [(effect, effect_kind(effect).law) for effect in sha.effects]
    return tuple(effect for effect, law in laws if isinstance(law, Structural) and law.feature == feature)


def drop_features(sha: SHA, *features: Feature) -> SHA:
    """The automaton without the effects that engines execute by their code of these features."""
    gone = [effect for feature in features for effect in of_feature(sha, feature)]
    return replace(sha, effects=tuple(effect for effect in sha.effects if effect not in gone))


def dead_time(sha: SHA) -> float:
    """Seconds by which events and signals act later; 0 without that effect."""
    return sum((effect.params["delay"] for effect in of_feature(sha, "dead time")), 0.0)


def growth_starts(sha: SHA) -> tuple[float, ...]:
    """The moments (absolute s) from which on some effect's heat grows without end."""
    bounds = [(effect, effect_kind(effect).bound) for effect in sha.effects]
    return tuple(
        bound.grows_from(effect)
        for effect, bound in bounds
        if isinstance(bound, VaryingBound) and bound.grows_from is not None
    )


def offset_times(sha: SHA) -> tuple[float, ...]:
    """The moments (absolute s) at which the sensor's offset steps."""
    return tuple(effect.params["at"] for effect in of_feature(sha, "sensor offset"))


def sensor_offset(sha: SHA, time: float) -> float:
    """What the sensor reads too much (degC) at an absolute time (s)."""
    # Written out: a filter asks it at each reading, and arrays of one number cost ten times as much.
    offsets = (effect.params for effect in of_feature(sha, "sensor offset"))
    return sum((each["size"] for each in offsets if time >= each["at"]), 0.0)


def sensor_offsets(sha: SHA, times: Array) -> Array:
    """What the sensor reads too much (degC) at each of the times (absolute s)."""
    total = np.zeros(times.shape)
    for effect in of_feature(sha, "sensor offset"):
        total = total + np.where(times >= effect.params["at"], effect.params["size"], 0.0)
    return total


def parameter_words(kind: str, name: str, value: float, digits: int = 6) -> str:
    """A parameter of an effect as people read it: a moment as its date, a number with so many digits."""
    known = EFFECTS.get(kind) or RIVALS.get(kind)
    meant = None if known is None else known.parameters.get(name)
    return moment_words(value) if meant is not None and meant.unit == ABSOLUTE_SECONDS else f"{value:.{digits}g}"


def effect_summary(effect: Effect) -> str:
    """One line that says all of an effect: kind, parameters, signals, locations and event."""
    parts = [f"{name} {parameter_words(effect.kind, name, value)}" for name, value in effect.params.items()]
    parts += [f"{role} {signal}" for role, signal in effect.signals.items()]
    parts += [f"since {effect.event}"] if effect.event else []
    parts += [f"in {', '.join(effect.locations)}"] if effect.locations else []
    parts += [f"heat {effect.line.heat}"] if effect.line is not None else []
    return f"{effect.kind}: {'; '.join(parts)}"


def refusal(sha: SHA, what: str) -> str:
    """The sentence by which `what` (such as "the UPPAAL export") declines a model with effects; "" without effects."""
    if not sha.effects:
        return ""
    kinds = ", ".join(dict.fromkeys(effect.kind for effect in sha.effects))
    return f"{what} does not do effects yet, and model {sha.name!r} has {kinds}; use simulation or the filter instead"


def refuse(sha: SHA, what: str) -> None:
    """Raises ValueError with the sentence of `refusal`; nothing without effects."""
    sentence = refusal(sha, what)
    if sentence:
        raise ValueError(sentence)
