"""Months of readings tell the noise of a minute as days do; what is short is looked at as it always was."""

import numpy as np
import pytest

from sim.engine import linear_recursion
from sim.lab.learning.plain import TREND, learn_plain
from sim.lab.learning.runs import free_runs, sample_runs, stretches
from sim.lab.learning.structure import bare_sha
from sim.sha import DECANTER, Trace
from tests.learning.plants import Truth, simulate

HEAT, MEMORY, SENSOR, STEP = 0.003, 100.0, 0.05, 10.0


def wandering(days: int) -> Trace:
    """A reading every 10 s of what an Ornstein-Uhlenbeck heat drives, without anything that holds it."""
    rng, rows = np.random.default_rng(4), int(days * 86_400 / STEP)
    keep = np.full(rows, np.exp(-STEP / MEMORY))
    heat = linear_recursion(keep, HEAT * np.sqrt(1 - keep**2) * rng.normal(size=rows), 0.0)
    reading = 60.0 + np.cumsum(STEP * heat) + SENSOR * rng.normal(size=rows)
    return Trace("wandering", STEP * np.arange(rows), {"T": reading}, synthetic=True)


@pytest.mark.parametrize("days", [1, 20])
def test_a_trend_is_learned_from_a_day_as_from_twenty(days: int) -> None:
    trend = next(member for member in learn_plain([wandering(days)], "T") if member.name == TREND)
    assert trend.memory == MEMORY
    assert trend.heat == pytest.approx(HEAT, rel=0.3)
    # Between readings nine minutes apart, as a long record thinned evenly has them, none of this can be told.
    assert trend.sensor == pytest.approx(SENSOR, rel=0.2)
    assert trend.walk < 0.01


def test_stretches_keep_readings_close_and_span_the_whole_time() -> None:
    traces = simulate(Truth(), 9, cycles=40, rows=1500, period=8.0, hold=100)
    runs = free_runs(traces, bare_sha(DECANTER), "T")
    evenly, close = sample_runs(runs, 1000), stretches(runs, 1000, 60.0)
    assert len(close) <= 1500
    assert np.max(evenly.dt) > 300.0, "thinned over all of the time"
    assert np.max(close.dt) <= 120.0
    assert np.all(np.isfinite(close.reading[close.first])) and np.all(close.dt[close.first] == 0)
    assert set(close.trace.tolist()) >= {0, 39} and len(set(close.trace.tolist())) >= 15
