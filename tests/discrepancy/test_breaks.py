"""What is changed at a machine is changed while nobody logs: a break of the record is no running time."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects import MachineLog
from sim.lab.discrepancy.fitting import build_frame, build_record, fit, move_frame, rivals, with_priors
from sim.lab.discrepancy.fitting.candidates import catalogue_entry
from sim.lab.discrepancy.naming import step
from sim.lab.discrepancy.rules import RULES
from sim.sha.events import encode
from sim.sha.trace import Array, Trace
from tests.discrepancy.plants import ALPHABET, model, plant

ROWS, PERIOD = 2880, 60.0
FAILS = (int(0.22 * ROWS), int(0.66 * ROWS))
"""Rows, one each `PERIOD` s, and those with which a cooler fails in two steps."""


def failing(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Less cooling from the one row on, and less again from the other."""
    row = (time - time[0]) / PERIOD
    return 0.0 * time, -1e-4 * sum(1.0 * (row >= each) for each in FAILS)


def broken_off(trace: Trace, hours: float) -> Trace:
    """The trace with a break of so many hours where the cooler fails, and without what was read for an hour after."""
    times = trace.times + 3600.0 * hours * sum(np.arange(ROWS) >= each for each in FAILS)
    kept = np.ones(ROWS, dtype=bool)
    for each in FAILS:
        kept[each : each + 60] = False
    signals = {name: column[kept] for name, column in trace.signals.items()}
    rows = replace(trace, times=times[kept], signals=signals, events=())
    return replace(rows, events=encode(rows, ALPHABET))


@pytest.mark.parametrize("hours", [1.0, 30.0])
def test_a_cooler_that_fails_while_nobody_logs_is_no_wear(hours: float) -> None:
    trace = broken_off(plant(2, days=2, runs_on=True, period=PERIOD, more=failing), hours)
    record = build_record(model(), [trace], ())
    cooling = [entry for entry in rivals() if entry.name in ("less-cooling", "less-cooling-twice")]
    base = fit(with_priors(move_frame(build_frame(record), record)))
    found = step(base, [catalogue_entry("wear-drift"), *cooling], {}, rules=RULES)
    assert found.best is not None and found.best.entry.name == "less-cooling-twice"
    breaks = np.flatnonzero(np.diff(trace.times) > 1800.0)
    moments = [found.best.shape.params[name] for name in ("at", "again")]
    for row, moment in zip(breaks, moments, strict=True):
        assert trace.times[row] < moment < trace.times[row + 1]


def test_a_record_without_a_step_has_its_moments() -> None:
    """Rows that each begin a run of their own: no time passes in any step."""
    rows = np.zeros(3)
    log = MachineLog(time=np.array([0.0, 4e3, 9e3]), dt=rows, running=rows + 1.0, smooth=rows, signals={})
    for entry in rivals():
        shapes = entry.candidate.shapes(log) if not entry.needs else []
        assert all(np.isfinite(value) for shape in shapes for value in shape.values())
