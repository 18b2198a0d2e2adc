"""Heats that follow a signal: currents, frictions and the room. Each is one line, held while its signal is."""

from collections.abc import Callable, Sequence

import numpy as np

from sim.effects.expressed import compile_held_heat, late_part
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
from sim.phrase import Phrase

REFERENCE = Parameter(unit="of the signal", rescaled="stays")
LAGS = (15.0, 30.0, 60.0, 120.0, 240.0, 480.0)
"""Lags (s) of a heat of the current that a diagnosis begins from; it searches on within `LAG_RANGE`."""
LAG_RANGE = (2.0, 3600.0)
DELAY = Parameter(unit="s", low=0.0, default=0.0, rescaled="stays")
"""After which what comes late begins to come; without a lag there is nothing late."""
DELAYED = ((60.0, 60.0), (150.0, 60.0), (300.0, 100.0), (600.0, 150.0), (1200.0, 240.0))
"""(delay, lag) in s from which a diagnosis begins besides: what is on its way, in a belt, an oil line, a shaft."""


def _knees(log: MachineLog) -> Sequence[Params]:
    on = log.signals["current"][log.running > 0.5]
    return [{"knee": float(np.quantile(on, share))} for share in (0.3, 0.5, 0.65, 0.8, 0.9)] if on.size else []


def about_usual(role: str) -> Callable[[MachineLog], Sequence[Params]]:
    """One shape: about the signal's mean while the machine runs, so that the strength moves no target."""
    return lambda log: [{"reference": max(log.usual(role, running=True), 1e-9)}]


def _friction(
    role: Role, *, name: str, meaning: Phrase, experiment: Phrase, look: str, powers: tuple[float, float]
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
        **compile_held_heat(f"gain * (max({role.name}, 0) ^ power - max(reference, 0) ^ power)"),
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


def _on_the_way(log: MachineLog) -> Sequence[Params]:
    """Late, and after a delay as well."""
    shapes = about_usual("current")(log)
    return [*_lates(log), *({**shape, "delay": delay, "lag": lag} for shape in shapes for delay, lag in DELAYED)]


def _losses(log: MachineLog) -> Sequence[Params]:
    """At once, which has no lag to be refined, and late."""
    return [*about_usual("current")(log), *_lates(log)]


HEATING = (
    EffectKind(
        name="current-heating",
        meaning=Phrase(
            "heat that grows with the current inside a bin of the current",
            it="calore che cresce con la corrente entro una fascia",
            de="Wärme, die innerhalb eines Strombereichs mit dem Strom wächst",
        ),
        parameters={
            "gain": Parameter(unit="degC/s per unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        **compile_held_heat("gain * (current - reference)"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "hold two currents inside one bin for half an hour each",
                it="tenere due correnti della stessa fascia, mezz'ora ciascuna",
                de="zwei Ströme desselben Bereichs je eine halbe Stunde halten",
            ),
            look="the drive's load: what the motor's current is spent on besides turning the bowl",
            shapes=about_usual("current"),
        ),
    ),
    EffectKind(
        name="quadratic-current-heating",
        meaning=Phrase(
            "heat that grows with the square of the current",
            it="calore che cresce con il quadrato della corrente",
            de="Wärme, die mit dem Quadrat des Stroms wächst",
        ),
        parameters={
            "gain": Parameter(unit="degC/s per squared unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
            "lag": Parameter(unit="s", low=0.0, default=0.0, rescaled="stays"),
            "delay": DELAY,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        **compile_held_heat("gain * (current ^ 2 - reference ^ 2)"),
        late=late_part("gain * current ^ 2"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "dwell at three currents or more, each until the temperature settles",
                it="restare a tre o più correnti, ciascuna finché la temperatura si stabilizza",
                de="bei drei oder mehr Strömen bleiben, je bis die Temperatur steht",
            ),
            look="the motor and its cables: losses in copper, loose or hot terminals",
            shapes=_losses,
            refine={"lag": LAG_RANGE},
        ),
    ),
    EffectKind(
        name="late-current-heating",
        meaning=Phrase(
            "heat of the current that comes late",
            it="calore della corrente che arriva in ritardo",
            de="Wärme des Stroms, die verspätet kommt",
        ),
        parameters={
            "gain": Parameter(unit="degC/s per unit of the signal", rescaled="scaled"),
            "reference": REFERENCE,
            "lag": Parameter(unit="s", positive=True, rescaled="stays"),
            "delay": DELAY,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        **compile_held_heat("gain * (current - reference)"),
        late=late_part("gain * current"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "stop from full load, then switch the pump at rest: a lag of the sensor delays both, this only "
                "the first",
                it="fermare da pieno carico, poi azionare la pompa a macchina ferma: un ritardo del sensore "
                "rallenta entrambi, questo solo il primo",
                de="aus voller Last anhalten, dann in Ruhe die Pumpe schalten: eine Trägheit des Sensors "
                "verzögert beides, dies nur das erste",
            ),
            look="the motor and its cables: heat that is made there and reaches the measured part later",
            shapes=_on_the_way,
            refine={"lag": LAG_RANGE, "delay": LAG_RANGE},
            special=("current-heating",),
        ),
    ),
    EffectKind(
        name="current-saturation",
        meaning=Phrase(
            "above some current the heat grows no further with it",
            it="oltre una certa corrente il calore non cresce più",
            de="ab einem Strom wächst die Wärme nicht weiter",
        ),
        parameters={
            "gain": Parameter(unit="degC/s per unit of the signal", rescaled="scaled"),
            "knee": REFERENCE,
        },
        roles=Roles(needed=(CURRENT,)),
        acts="running",
        **compile_held_heat("-gain * max(current - knee, 0)"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "dwell at three currents or more, two of them near the highest",
                it="restare a tre o più correnti, due vicine alla massima",
                de="bei drei oder mehr Strömen bleiben, zwei davon nahe dem höchsten",
            ),
            look="the drive: a current limit or a slipping belt or coupling near full load",
            shapes=_knees,
            refine={"knee": (10.0, 350.0)},
        ),
    ),
    _friction(
        TORQUE,
        name="torque-friction",
        meaning=Phrase(
            "friction heat that follows the torque",
            it="calore d'attrito che segue la coppia",
            de="Reibungswärme, die dem Drehmoment folgt",
        ),
        experiment=Phrase(
            "change the speed at constant torque, then the torque at constant speed",
            it="variare la velocità a coppia costante, poi la coppia a velocità costante",
            de="erst die Drehzahl bei gleichem Moment ändern, dann das Moment bei gleicher Drehzahl",
        ),
        look="gearbox and scroll: oil level, wear, hard solids between scroll and bowl",
        powers=(0.5, 3.0),
    ),
    _friction(
        SPEED,
        name="speed-friction",
        meaning=Phrase(
            "friction heat that follows the speed",
            it="calore d'attrito che segue la velocità",
            de="Reibungswärme, die der Drehzahl folgt",
        ),
        experiment=Phrase(
            "change the speed at constant torque",
            it="variare la velocità a coppia costante",
            de="die Drehzahl bei gleichem Moment ändern",
        ),
        look="the bearings' grease at speed: too much, too stiff, or the wrong kind",
        powers=(1.0, 3.0),  # friction's heat is force times speed: it never grows more slowly than the speed
    ),
    _friction(
        VIBRATION,
        name="vibration-friction",
        meaning=Phrase(
            "heat that follows the vibration",
            it="calore che segue le vibrazioni",
            de="Wärme, die der Schwingung folgt",
        ),
        experiment=Phrase(
            "change the speed at constant torque and watch whether heat goes with the vibration alone",
            it="variare la velocità a coppia costante e vedere se il calore segue solo le vibrazioni",
            de="die Drehzahl bei gleichem Moment ändern und sehen, ob die Wärme allein der Schwingung folgt",
        ),
        look="balance and bearings: deposits in the bowl, worn races, loose feet",
        powers=(0.5, 3.0),
    ),
    EffectKind(
        name="ambient-coupling",
        meaning=Phrase(
            "the measured part follows the room's temperature",
            it="la temperatura segue quella dell'ambiente",
            de="die Temperatur folgt der des Raums",
        ),
        parameters={
            "gain": Parameter(unit="1/s", rescaled="scaled"),
            "reference": Parameter(unit="degC", rescaled="stays"),
        },
        roles=Roles(needed=(AMBIENT,)),
        acts="anywhere",
        **compile_held_heat("gain * (ambient - reference)"),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "log the room for three days, with a night at rest",
                it="registrare l'ambiente per tre giorni, con una notte a macchina ferma",
                de="den Raum drei Tage aufzeichnen, mit einer Nacht in Ruhe",
            ),
            look="the room: ventilation, sun on the housing, a heat source beside the machine",
            shapes=_rooms,
            refine={"at_rest": (0.1, 1.5)},
            widths={"at_rest": 1.0},
            at_rest="at_rest",
        ),
    ),
)
