"""What is held out for the proof is seen by nothing before it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import fit
from sim.lab.discrepancy.layout import SplitCycles, lay_out, split_cycles
from sim.lab.discrepancy.rules import RULES
from sim.sha import Trace
from tests.discrepancy.plants import model, plant

ROLES = {"current": "Assorbimento", "pump": "MarciaPmpFango"}


def split_of(trace: Trace) -> SplitCycles:
    return split_cycles(lay_out(model(), [trace], [], ROLES, RULES), RULES)


@pytest.fixture(scope="module")
def trace() -> Trace:
    return plant(3, days=3, pump=2e-4, period=120.0)


def test_readings_of_the_held_out_cycles_do_not_change_the_refit(trace: Trace) -> None:
    split = split_of(trace)
    held_out = trace.times >= split.held_out.runs.time.min()
    others = np.where(held_out, trace.signals["T"] + 3.0, trace.signals["T"])
    changed = split_of(replace(trace, signals={**trace.signals, "T": others}))
    assert not np.array_equal(changed.held_out.reading, split.held_out.reading)
    first, second = (fit(each.training, rounds=1) for each in (split, changed))
    np.testing.assert_array_equal(first.state.parameters, second.state.parameters)
    assert first.noise == second.noise


def test_each_reading_is_fitted_or_held_out_and_the_last_cycles_are(trace: Trace) -> None:
    split = split_of(trace)
    fitted, held_out = split.training.record.runs.time, split.held_out.runs.time
    assert fitted.max() < held_out.min()
    assert np.unique(split.held_out.window_cycle).size == round(RULES.held_out_share * 9) == 3
