"""Heats that follow a signal: currents, frictions and the room. Each is one line, held while its signal is."""

from collections.abc import Callable, Sequence

import numpy as np

from sim.effects.expressed import expressed, late_part
from sim.effects.kind import (
    EffectCandidate,
    EffectKind,
    MachineLog,
    Parameter,
    Params,
    Role,
    Roles,
)
from sim.effects.roles import AMBIENT, CURRENT, SPEED, TORQUE, VIBRATION

REFERENCE = Parameter(unit="of the signal", rescaled="stays")
LAGS = (15.0, 30.0, 60.0, 120.0, 240.0, 480.0)
"""Lags (s) of a heat of the current that a diagnosis begins from; it searches on within `LAG_RANGE`."""
LAG_RANGE = (2.0, 1500.0)


def _knees(log: MachineLog) -> Sequence[Params]:
    on = log.signals["current"][log.running > 0.5]
    return [{"knee": float(np.quantile(on, share))} for share in (0.3, 0.5, 0.65, 0.8, 0.9)] if on.size else []


def about_usual(role: str) -> Callable[[MachineLog], Sequence[Params]]:
    """One shape: about the signal's mean while the machine runs, so that the strength moves no target."""
    return lambda log: [{"reference": max(log.usual(role, running=True), 1e-9)}]


def _friction(
    role: Role, *, name: str, meaning: str, experiment: str, look: str, powers: tuple[float, float]
) -> EffectKind:
    """Heat gain (s^power - reference^power), a negative signal counting as 0."""

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
        **expressed(f"gain * (max({role.name}, 0) ^ power - max(reference, 0) ^ power)"),
        candidate=EffectCandidate(
            strength="gain", sign=1.0, experiment=experiment, look=look, shapes=shapes, refine={"power": powers}
        ),
    )


def _rooms(log: MachineLog) -> Sequence[Params]:
    """About the room's mean, with the same coupling at rest and with a weaker one: what turns fans the air about it."""
    shape = {"reference": log.usual("ambient", running=False)}
    if not 0.0 < np.mean(log.running) < 1.0:
        return [shape]
    return [{**shape, "at_rest": share} for share in (1.0, 0.4)]


def _lates(log: MachineLog) -> Sequence[Params]:
    """About the current's mean, at each of the lags."""
    return [{**shape, "lag": lag} for shape in about_usual("current")(log) for lag in LAGS]


def _losses(log: MachineLog) -> Sequence[Params]:
    """At once, which has no lag to be refined, and late."""
    return [*about_usual("current")(log), *_lates(log)]


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
        **expressed("gain * (current - reference)"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="hold two currents inside one bin for half an hour each",
            look="the drive's load: what the motor's current is spent on besides turning the bowl",
            shapes=about_usual("current"),
        ),
    ),
    EffectKind(
        name="quadratic-current-heating",
        meaning="heat that grows with the square of the current",
        parameters={
            "gain": Parameter(unit="degC/s per squared unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
            "lag": Parameter(unit="s", low=0.0, default=0.0, rescaled="stays"),
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        **expressed("gain * (current ^ 2 - reference ^ 2)"),
        late=late_part("gain * current ^ 2", lag="lag"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="dwell at three currents or more, each until the temperature settles",
            look="the motor and its cables: losses in copper, loose or hot terminals",
            shapes=_losses,
            refine={"lag": LAG_RANGE},
        ),
    ),
    EffectKind(
        name="late-current-heating",
        meaning="heat of the current that comes late",
        parameters={
            "gain": Parameter(unit="degC/s per unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
            "lag": Parameter(unit="s", positive=True, rescaled="stays"),
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        **expressed("gain * (current - reference)"),
        late=late_part("gain * current", lag="lag"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="stop from full load, then switch the pump at rest: a lag of the sensor delays both, this only "
            "the first",
            look="the motor and its cables: heat that is made there and reaches the measured part later",
            shapes=_lates,
            refine={"lag": LAG_RANGE},
            special=("current-heating",),
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
        **expressed("-gain * max(current - knee, 0)"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="dwell at three currents or more, two of them near the highest",
            look="the drive: a current limit or a slipping belt or coupling near full load",
            shapes=_knees,
            refine={"knee": (10.0, 350.0)},
        ),
    ),
    _friction(
        TORQUE,
        name="torque-friction",
        meaning="friction heat that follows the torque",
        experiment="change the speed at constant torque, then the torque at constant speed",
        look="gearbox and scroll: oil level, wear, hard solids between scroll and bowl",
        powers=(0.5, 3.0),
    ),
    _friction(
        SPEED,
        name="speed-friction",
        meaning="friction heat that follows the speed",
        experiment="change the speed at constant torque",
        look="the bearings' grease at speed: too much, too stiff, or the wrong kind",
        powers=(1.0, 3.0),  # friction's heat is force times speed: it never grows more slowly than the speed
    ),
    _friction(
        VIBRATION,
        name="vibration-friction",
        meaning="heat that follows the vibration",
        experiment="change the speed at constant torque and watch whether heat goes with the vibration alone",
        look="balance and bearings: deposits in the bowl, worn races, loose feet",
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
        **expressed("gain * (ambient - reference)"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment="log the room for three days, with a night at rest",
            look="the room: ventilation, sun on the housing, a heat source beside the machine",
            shapes=_rooms,
            refine={"at_rest": (0.1, 1.5)},
            widths={"at_rest": 1.0},
            at_rest="at_rest",
        ),
    ),
)
