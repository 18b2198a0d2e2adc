"""Heats that follow a signal: currents, frictions and the room. All are held while their signal is."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim.effects.kind import (
    EffectCandidate,
    EffectKind,
    HeatBound,
    HeldLaw,
    MachineLog,
    Parameter,
    Params,
    Role,
    Roles,
    Signals,
    TextLaw,
    TextWriter,
)
from sim.effects.roles import AMBIENT, CURRENT, SPEED, TORQUE, VIBRATION
from sim.sha import Array, Effect

REFERENCE = Parameter(unit="of the signal", rescaled="stays")


def heat_of(heat: Callable[[Mapping[str, float], Array], Array]) -> HeldLaw:
    """The law of a kind that reads one signal and loses nothing, from its heat (degC/s)."""

    def law(effect: Effect, signals: Signals) -> tuple[Array, Array]:
        (name,) = effect.signals.values()
        return np.asarray(heat(effect.params, signals[name])), np.zeros_like(signals[name])

    return HeldLaw(law)


def never_bends(_effect: Effect) -> Sequence[float]:
    """The bends of a heat that is monotone in its signal above and below 0."""
    return ()


def _against_reference(writer: TextWriter, effect: Effect) -> str:
    (role,) = effect.signals
    value, read = writer.read(effect, role)
    gain, reference = (writer.constant(name.upper(), effect.params[name]) for name in ("gain", "reference"))
    return f" + {read} * {gain} * ({value} - {reference})"


def _squares(writer: TextWriter, effect: Effect) -> str:
    value, read = writer.read(effect, "current")
    gain, reference = (writer.constant(name.upper(), effect.params[name]) for name in ("gain", "reference"))
    return f" + {read} * {gain} * ({value} * {value} - {reference} * {reference})"


def _beyond_knee(writer: TextWriter, effect: Effect) -> str:
    value, read = writer.read(effect, "current")
    gain, knee = (writer.constant(name.upper(), effect.params[name]) for name in ("gain", "knee"))
    return f" - {read} * {gain} * fmax({value} - {knee}, 0.0)"


def _powers(writer: TextWriter, effect: Effect) -> str:
    (role,) = effect.signals
    value, read = writer.read(effect, role)
    p = effect.params
    gain, power = writer.constant("GAIN", p["gain"]), writer.constant("POWER", p["power"])
    usual = writer.constant("USUAL", max(p["reference"], 0.0) ** p["power"])
    return f" + {read} * {gain} * (pow(fmax({value}, 0.0), {power}) - {usual})"


def _knees(log: MachineLog) -> Sequence[Params]:
    on = log.signals["current"][log.running > 0.5]
    return [{"knee": float(np.quantile(on, share))} for share in (0.3, 0.5, 0.65, 0.8, 0.9)] if on.size else []


def about_usual(role: str) -> Callable[[MachineLog], Sequence[Params]]:
    """One shape: about the signal's mean while the machine runs, so that the strength moves no target."""
    return lambda log: [{"reference": max(log.usual(role, running=True), 1e-9)}]


def _friction(role: Role, *, name: str, meaning: str, experiment: str, powers: tuple[float, float]) -> EffectKind:
    """Heat gain (s^power - reference^power), a negative signal counting as 0."""

    def heat(p: Mapping[str, float], signal: Array) -> Array:
        reference = max(p["reference"], 0.0) ** p["power"]
        return np.asarray(p["gain"] * (np.maximum(signal, 0.0) ** p["power"] - reference))

    def shapes(log: MachineLog) -> Sequence[Params]:
        return [{**shape, "power": power} for shape in about_usual(role.name)(log) for power in (1.0, 2.0)]

    return EffectKind(
        name=name,
        meaning=meaning,
        parameters={
            "gain": Parameter(unit="degC/s per unit of the power", rescaled="scaled"),
            "reference": REFERENCE,
            "power": Parameter(unit="1", low=0.1, high=5.0, rescaled="stays"),
        },
        roles=Roles(needed=(role,)),
        acts="running",
        law=heat_of(heat),
        bound=HeatBound(never_bends),
        uppaal=TextLaw(_powers),
        candidate=EffectCandidate(
            strength="gain", sign=1.0, experiment=experiment, shapes=shapes, refine={"power": powers}
        ),
    )


HEATING = (
    EffectKind(
        name="current-heating",
        meaning="heat that grows with the current inside a bin of the current",
        parameters={
            "gain": Parameter(unit="degC/s per unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        law=heat_of(lambda p, current: p["gain"] * (current - p["reference"])),
        bound=HeatBound(never_bends),
        uppaal=TextLaw(_against_reference),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="hold two currents inside one bin for half an hour each",
            shapes=about_usual("current"),
        ),
    ),
    EffectKind(
        name="quadratic-current-heating",
        meaning="heat that grows with the square of the current",
        parameters={
            "gain": Parameter(unit="degC/s per squared unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        law=heat_of(lambda p, current: p["gain"] * (current**2 - p["reference"] ** 2)),
        bound=HeatBound(never_bends),
        uppaal=TextLaw(_squares),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="dwell at three currents or more, each until the temperature settles",
            shapes=about_usual("current"),
        ),
    ),
    EffectKind(
        name="current-saturation",
        meaning="above some current the heat grows no further with it",
        parameters={
            "gain": Parameter(unit="degC/s per unit of the signal", rescaled="scaled"),
            "knee": REFERENCE,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        law=heat_of(lambda p, current: -p["gain"] * np.maximum(current - p["knee"], 0.0)),
        bound=HeatBound(lambda effect: (effect.params["knee"],)),
        uppaal=TextLaw(_beyond_knee),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="dwell at three currents or more, two of them near the highest",
            shapes=_knees,
            refine={"knee": (10.0, 350.0)},
        ),
    ),
    _friction(
        TORQUE,
        name="torque-friction",
        meaning="friction heat that follows the torque",
        experiment="change the speed at constant torque, then the torque at constant speed",
        powers=(0.5, 3.0),
    ),
    _friction(
        SPEED,
        name="speed-friction",
        meaning="friction heat that follows the speed",
        experiment="change the speed at constant torque",
        powers=(1.0, 3.0),  # friction's heat is force times speed: it never grows more slowly than the speed
    ),
    _friction(
        VIBRATION,
        name="vibration-friction",
        meaning="heat that follows the vibration",
        experiment="change the speed at constant torque and watch whether heat goes with the vibration alone",
        powers=(0.5, 3.0),
    ),
    EffectKind(
        name="ambient-coupling",
        meaning="the measured part follows the room's temperature",
        parameters={
            "gain": Parameter(unit="1/s", rescaled="scaled"),
            "reference": Parameter(unit="degC", rescaled="stays"),
        },
        roles=Roles(needed=(AMBIENT,)),
        acts="anywhere",
        law=heat_of(lambda p, ambient: p["gain"] * (ambient - p["reference"])),
        bound=HeatBound(never_bends),
        uppaal=TextLaw(_against_reference),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="log the room for three days, with a night at rest",
            shapes=lambda log: [{"reference": log.usual("ambient", running=False)}],
        ),
    ),
)
