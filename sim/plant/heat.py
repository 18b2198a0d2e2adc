"""A decanter under heavy sludge: its gearbox bearing runs to the limit unless somebody feeds it less in time.

The machine of `decanter.py` with tighter bearings and a warmer hall. Most of the time its load leaves the bearing well
below the limit; where the sludge is heavy (above 300 A) it runs hot, and on reaching the limit the PLC trips the drum.
The feed bearing has no gear beside it: it warms less with the same load, without the oil, and stays below the limit.
Such heats are in the history; the day that is shown is another one, with draws of its own.
"""

import numpy as np

from sim.plant.decanter import SIGNALS, DecanterPlant, LiveDecanter, Phase, Weather
from sim.plant.scenarios import EPOCH_S
from sim.sha import Trace

PLANT = DecanterPlant(heat_per_ampere=0.00046, feed_side_share=0.67)
WEATHER = Weather(mean=24.0, swing=3.0, slurry=22.0)
TRIP_REST_S = 1800.0
"""Seconds that the drum stands after a trip, until an operator starts it again."""
BEFORE_S, SHOWN_S = 240.0, 2940.0
"""Seconds of the day that is shown: before the richer feed, and altogether."""
HISTORY_PERIOD_S, PERIOD_S = 10.0, 2.0
"""Seconds between two rows: in the history and on the day that is shown."""


def _feed(seconds: float, load: float, rng: np.random.Generator) -> Phase:
    return Phase(seconds, running=True, load=load, swing=float(rng.uniform(5, 12)), memory=60.0)


def _calm(rng: np.random.Generator) -> float:
    return float(rng.uniform(125, 180))


def _rich(rng: np.random.Generator) -> float:
    return float(rng.uniform(205, 250))


def _heavy(rng: np.random.Generator) -> float:
    return float(rng.uniform(318, 338))


def heat_history(seed: int, *, days: int = 3, limit: float = 80.0) -> list[Trace]:
    """Days of production, one row every HISTORY_PERIOD_S, in which the sludge is heavy now and then.

    The PLC trips at `limit` (degC).
    """
    traces = []
    for day in range(days):
        rng = np.random.default_rng([seed, day, 1])
        phases = [Phase(5.5 * 3600 + 1800 * rng.random(), running=False, pump=False)]
        while sum(phase.seconds for phase in phases) < 21 * 3600:
            for _ in range(3):
                load = _calm(rng) if rng.random() < 0.5 else _rich(rng)
                phases.append(_feed(float(rng.uniform(900, 3000)), load, rng))
            if rng.random() < 0.6:
                phases.append(_feed(float(rng.uniform(1200, 3600)), _heavy(rng), rng))
            if rng.random() < 0.4:
                phases.append(Phase(float(rng.uniform(900, 4800)), running=False, pump=False))
        phases.append(Phase(86400.0, running=False, pump=False))
        start = EPOCH_S - EPOCH_S % 86400 + 86400.0 * day
        decanter = LiveDecanter(
            phases,
            times=np.arange(0.0, 86400.0, HISTORY_PERIOD_S),
            start=start,
            bearing=WEATHER.ambient(0.0),
            weather=WEATHER,
            plant=PLANT,
            rng=rng,
            step=2.0,
            trip_at=limit,
            trip_rest=TRIP_REST_S,
        )
        traces.append(_trace(decanter, f"history_day{day + 1}", seed))
    return traces


def heat_day(seed: int, *, limit: float = 80.0) -> LiveDecanter:
    """Forty-nine minutes of another day, to be moved on by whoever controls the feed.

    The machine has been running for hours; the feed becomes richer, which heats the bearing and is harmless, and then
    heavy, which is not. The PLC trips at `limit` (degC).
    """
    rng = np.random.default_rng([seed, 2])
    warm = float(rng.uniform(2.5, 3.5)) * 3600
    rich, heavy = float(rng.uniform(700, 900)), _heavy(rng)
    phases = [
        Phase(1800.0, running=False, pump=False),
        _feed(warm, _calm(rng), rng),
        _feed(rich, _rich(rng), rng),
        _feed(7200.0, heavy, rng),
    ]
    begin = 1800.0 + warm - BEFORE_S
    decanter = LiveDecanter(
        phases,
        times=np.concatenate([np.arange(0.0, begin, 10.0), begin + np.arange(0.0, SHOWN_S, PERIOD_S)]),
        start=EPOCH_S + 86400.0 * 7,
        bearing=WEATHER.ambient(0.0),
        weather=WEATHER,
        plant=PLANT,
        rng=rng,
        step=1.0,
        trip_at=limit,
    )
    return decanter.advance(begin)


def uncontrolled_heat_day(seed: int, *, limit: float = 80.0) -> Trace:
    """The same day with nobody who feeds less: what the machine does on its own, until it trips."""
    return _trace(heat_day(seed, limit=limit), "heat_day", seed)


def _trace(decanter: LiveDecanter, name: str, seed: int) -> Trace:
    rows = np.array([decanter.row() for _ in decanter.times])
    return Trace(
        name=name,
        times=decanter.start + decanter.times,
        signals={signal: rows[:, column].copy() for column, signal in enumerate(SIGNALS)},
        origin=f"simulated decanter {name}, seed {seed}",
        synthetic=True,
    )
