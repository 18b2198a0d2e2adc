"""What lies between the heat and the reading: a dead time, a lag, an offset of the sensor."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from sim.effects.kind import ABSOLUTE_SECONDS, EffectCandidate, EffectKind, Parameter, Params, Roles, Structural
from sim.phrase import Phrase
from sim.sha import Array

BLUR_LAGS = 2
"""First-order lags that a blurred delay is followed by."""
JUMPS, JUMP_APART = 16, 5
"""Moments at which an offset is looked for besides the regular ones, and windows between them."""


def _blur(shape: Params) -> tuple[str, Mapping[str, float]] | None:
    """What flows through mixed vessels comes late and blurred: the blur is a lag in the automaton."""
    tau = shape.get("blur", 0.0) * shape["delay"]
    return ("sensor-lag", {"tau": tau, "order": float(BLUR_LAGS)}) if tau > 0 else None


def _jumps(times: Array, score: Array) -> Sequence[Params]:
    """The moments from which an offset would lower the misfit most: extremes of the score summed to the end."""
    # An offset from `at` on raises every reading after it alike: its score is the sum of theirs. Neighbouring moments
    # have nearly the same sum, so they are kept apart, or all would crowd about one extreme.
    summed = np.abs(np.cumsum(score[::-1])[::-1])
    places: list[int] = []
    for place in np.argsort(-summed, kind="stable").tolist():
        if all(abs(place - other) > JUMP_APART for other in places):
            places.append(place)
        if len(places) == JUMPS:
            break
    return [{"at": float(times[place])} for place in places]


SENSING = (
    EffectKind(
        name="dead-time",
        # events and signals act `delay` s later
        meaning=Phrase(
            "heat reaches the sensor only after a dead time",
            it="il calore arriva al sensore solo dopo un tempo morto",
            de="Wärme erreicht den Sensor erst nach einer Totzeit",
        ),
        parameters={"delay": Parameter(unit="s", low=0.0, rescaled="stays")},
        roles=Roles(),
        acts="everywhere",
        law=Structural("dead time"),
        bound=Structural("dead time"),
        uppaal=Structural("dead time"),
        candidate=EffectCandidate(
            strength="delay",
            sign=1.0,
            experiment=Phrase(
                "one sharp step of the current, logged at 1 Hz",
                it="un gradino netto della corrente, registrato ogni secondo",
                de="ein scharfer Sprung des Stroms, jede Sekunde aufgezeichnet",
            ),
            look="how the reading comes here: averaging in the PLC, a slow bus, a sensor far from the heat",
            shapes=lambda _: [
                {"delay": delay, "blur": blur}
                for delay, blur in product((10.0, 20.0, 40.0, 80.0, 160.0, 320.0), (0.0, 0.7, 1.4))
            ],
            either={"blur": (0.0, 0.7, 1.4)},
            refine={"delay": (1.0, 600.0)},
            once=True,
            besides=_blur,
        ),
    ),
    EffectKind(
        name="sensor-lag",
        # the sensor reads the last of `order` first-order lags of tau/order each, driven by X
        meaning=Phrase(
            "the sensor follows what it measures with a lag",
            it="il sensore segue in ritardo ciò che misura",
            de="der Sensor hinkt dem nach, was er misst",
        ),
        parameters={
            "tau": Parameter(unit="s", positive=True, rescaled="stays"),
            "order": Parameter(unit="1", low=1, high=3, whole=True, rescaled="stays"),
        },
        roles=Roles(),
        acts="everywhere",
        law=Structural("sensor lag"),
        bound=Structural("sensor lag"),
        uppaal=Structural("sensor lag"),
        candidate=EffectCandidate(
            strength="tau",
            sign=1.0,
            experiment=Phrase(
                "one sharp step of the current, logged at 1 Hz",
                it="un gradino netto della corrente, registrato ogni secondo",
                de="ein scharfer Sprung des Stroms, jede Sekunde aufgezeichnet",
            ),
            look="the sensor's seat: paste, a loose well, air between probe and metal",
            shapes=lambda _: [
                {"tau": tau, "order": order}
                for tau, order in product((15.0, 30.0, 60.0, 120.0, 240.0, 480.0), (1.0, 2.0))
            ],
            either={"order": (1.0, 2.0)},
            refine={"tau": (2.0, 1500.0)},
            once=True,
        ),
    ),
    EffectKind(
        name="sensor-offset-step",
        # the sensor reads X + size from t >= at on
        meaning=Phrase(
            "from some moment on the sensor reads higher or lower by a constant",
            it="da un certo momento il sensore legge di più o di meno, di un valore costante",
            de="von einem Zeitpunkt an misst der Sensor um einen festen Wert zu hoch oder zu tief",
        ),
        parameters={
            "size": Parameter(unit="degC", rescaled="scaled"),
            "at": Parameter(unit=ABSOLUTE_SECONDS, rescaled="stays"),
        },
        roles=Roles(),
        acts="everywhere",
        law=Structural("sensor offset"),
        bound=Structural("sensor offset"),
        uppaal=Structural("sensor offset"),
        candidate=EffectCandidate(
            strength="size",
            sign=0.0,
            experiment=Phrase(
                "a reading at long rest, against a second thermometer",
                it="una lettura a lungo riposo, contro un secondo termometro",
                de="eine Messung in langer Ruhe, gegen ein zweites Thermometer",
            ),
            look="the sensor: its plug, its seat, whether it was exchanged or calibrated",
            shapes=lambda log: [
                {"at": float(log.time[int(share * log.time.size)])} for share in np.arange(0.05, 0.96, 0.1).tolist()
            ],
            scan=_jumps,
            burden=7.5,
        ),
    ),
)
