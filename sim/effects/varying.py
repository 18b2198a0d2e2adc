"""Heats that change by themselves while every signal stays: after a start, and with wear."""

from itertools import product

import numpy as np

from sim.effects.kind import (
    ABSOLUTE_SECONDS,
    EffectCandidate,
    EffectKind,
    Parameter,
    Roles,
    TextLaw,
    TextWriter,
    VaryingBound,
    VaryingLaw,
)
from sim.phrase import Phrase
from sim.sha import Array, Effect

_CUT_EXPONENTS = np.array(
    [0.05, 0.15, 0.3, 0.5, 0.75, 1, 1.3, 1.7, 2.1, 2.6, 3.2, 3.9, 4.7, 5.7, 7, 8.5, 10.5, 13, 16.5, 21]
)
"""Where start-up heat is cut, by its exponent: close where the decay bends, and the rest after the last is below 1e-9
of its start."""


def _churning_heat(effect: Effect, _time: Array, since: Array) -> Array:
    """gain exp(-(u / tau)^shape), u the seconds since the event."""
    p = effect.params
    return np.asarray(p["gain"] * np.exp(-((np.maximum(since, 0.0) / p["tau"]) ** p["shape"])))


def _churning_knots(effect: Effect, starts: Array) -> Array:
    if not starts.size:
        return starts
    # The law is a function of its exponent alone, so knots at fixed exponents fit every tau and shape. What lies beyond
    # the next start is of no use: there the clock begins anew.
    after = effect.params["tau"] * _CUT_EXPONENTS ** (1.0 / effect.params["shape"])
    following = np.append(starts[1:], np.inf)
    times = starts[:, None] + after
    return np.asarray(times[times < following[:, None]])


def _churning_text(writer: TextWriter, effect: Effect) -> str:
    gain, tau, shape = (writer.constant(name.upper(), effect.params[name]) for name in ("gain", "tau", "shape"))
    begun, clock = writer.since(effect)
    return f" + {begun} * {gain} * exp(-pow({clock} / {tau}, {shape}))"


def _wear(effect: Effect, time: Array, _since: Array) -> Array:
    """gain max(t - since, 0)."""
    return np.asarray(effect.params["gain"] * np.maximum(time - effect.params["since"], 0.0))


def _wear_text(writer: TextWriter, effect: Effect) -> str:
    gain = writer.constant("GAIN", effect.params["gain"])
    return f" + {gain} * fmax(time - {writer.moment('SINCE', effect.params['since'])}, 0.0)"


VARYING = (
    EffectKind(
        name="startup-churning",
        meaning=Phrase(
            "extra heat after each start that dies away (grease being churned)",
            it="calore in più dopo ogni avviamento, che si smorza (grasso rimescolato)",
            de="zusätzliche Wärme nach jedem Anlauf, die abklingt (gewalktes Fett)",
        ),
        parameters={
            "gain": Parameter(unit="degC/s", rescaled="scaled"),
            "tau": Parameter(unit="s", positive=True, rescaled="stays"),
            "shape": Parameter(unit="1", low=0.2, high=5.0, rescaled="stays"),
        },
        roles=Roles(),
        acts="running",
        law=VaryingLaw(
            heat=_churning_heat,
            knots=_churning_knots,
            speed=lambda effect: 1.0 / effect.params["tau"],
            from_event=True,
        ),
        bound=VaryingBound(
            extremes=lambda effect, _: (min(effect.params["gain"], 0.0), max(effect.params["gain"], 0.0))
        ),
        uppaal=TextLaw(_churning_text),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "start twice within an hour, at the same load",
                it="avviare due volte entro un'ora, con lo stesso carico",
                de="zweimal in einer Stunde anlaufen, bei gleicher Last",
            ),
            look="the grease after a start: amount, age, when it was filled last",
            shapes=lambda _: [
                {"tau": tau, "shape": shape}
                for tau, shape in product((60.0, 120.0, 240.0, 480.0, 960.0), (0.5, 1.0, 2.0))
            ],
            refine={"tau": (20.0, 3000.0), "shape": (0.5, 3.0)},
        ),
    ),
    EffectKind(
        name="wear-drift",
        meaning=Phrase(
            "friction that grows from day to day",
            it="attrito che cresce di giorno in giorno",
            de="Reibung, die von Tag zu Tag wächst",
        ),
        parameters={
            "gain": Parameter(unit="degC/s^2", rescaled="scaled"),
            "since": Parameter(unit=ABSOLUTE_SECONDS, rescaled="stays"),
        },
        roles=Roles(),
        acts="running",
        law=VaryingLaw(
            heat=_wear,
            knots=lambda effect, _: np.array([effect.params["since"]]),
            speed=lambda _: 0.0,
            from_event=False,
        ),
        bound=VaryingBound(
            extremes=lambda effect, horizon: (
                min(effect.params["gain"] * horizon, 0.0),
                max(effect.params["gain"] * horizon, 0.0),
            ),
            grows_from=lambda effect: effect.params["since"],
        ),
        uppaal=TextLaw(_wear_text),
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "compare a reading at long rest before and after: a sensor that moved shows it there, wear does not",
                it="confrontare una lettura a lungo riposo prima e dopo: un sensore spostato lo mostra, l'usura no",
                de="eine Messung in langer Ruhe vorher und nachher vergleichen: ein verrückter Sensor zeigt es "
                "dort, Verschleiß nicht",
            ),
            look="wear: bearing clearance, seals, alignment, and the date of the last overhaul",
            shapes=lambda log: [
                {"since": float(log.time[0]) + share * (float(log.time[-1]) - float(log.time[0]))}
                for share in (0.0, 0.2, 0.4, 0.6)
            ],
        ),
    ),
)
