"""Plain members of an ensemble: what the last minutes say by themselves, without events, inputs or targets.

Persistence is a random walk from the last reading: a mean of the last ones would lag behind on a day that is livelier
than the training. A damped trend is a walk under heat with a memory, filtered. Both are automata of one location, so
that they are drawn and mixed like any model. A learned model carries them (`Model.plain`), since their noise is learned
from the same traces.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.lab.learning.free_run import FitShape, FreeRunFit
from sim.lab.learning.noise import HORIZONS_S, NoiseLevels, fit_noises
from sim.lab.learning.runs import free_runs, sample_runs
from sim.sha import SHA, Flow, Location, PlainMember, Trace

PERSISTENCE, TREND = "persistence", "damped trend"
"""What a member is called, and so whatever else forecasts by the last reading."""
MAX_KNOTS = 2500
"""Knots to which the readings are sampled."""


def learn_plain(traces: Sequence[Trace], temperature: str) -> tuple[PlainMember, ...]:
    """The plain members for `temperature`, by the composite likelihood that learns a model's noise (`fit_noises`).

    The trend is left out where no memory of heat is worth it on data held out.
    """
    anywhere = SHA("plain", (Location("any", Flow("constant", {"noise": 0.0}), entry="none"),), (), "any")
    whole = free_runs([replace(trace, events=()) for trace in traces], anywhere, temperature)
    runs = sample_runs(whole, MAX_KNOTS)
    none, nothing = np.full(1, -1, dtype=np.intp), np.zeros(0)
    shape = FitShape(
        kinds=("constant",),
        rate=none,
        target=none,
        gain=np.zeros((1, 0), dtype=np.intp),
        reference=np.zeros((1, 0)),
        centre=nothing,
        spread=nothing,
        rate_centre=nothing,
        rate_spread=nothing,
    )
    fit = FreeRunFit(
        linear=nothing,
        rates=nothing,
        covariance=np.zeros((0, 0)),
        sigma=1.0,
        correlation=1.0,
        mean=runs.reading,
        start=nothing,
    )
    group = np.zeros(1, dtype=np.intp)
    walk, *trends = fit_noises(runs, shape, fit, group, budget=MAX_KNOTS, whole=whole)
    return (
        PlainMember(PERSISTENCE, 0.0, _walk_between_readings(walk)),
        *(
            PlainMember(
                TREND,
                noise.sensor,
                float(noise.process[0]),
                heat=noise.heat,
                memory=noise.memory,
                sensor_memory=noise.sensor_memory,
            )
            for noise in trends[:1]
        ),
    )


def _walk_between_readings(noise: NoiseLevels) -> float:
    """The walk (degC/sqrt(s)) whose changes are those between two readings over HORIZONS_S, both of which err."""
    over = np.array(HORIZONS_S)
    return float(np.exp(np.mean(0.5 * np.log(noise.process[0] ** 2 + 2.0 * noise.sensor**2 / over))))
