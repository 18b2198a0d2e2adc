"""A gap that begins half-way is a gap, with the date on which it begins."""

from dataclasses import replace

import numpy as np
import pytest

from sim.discrepancy import beginning_sentence
from sim.discrepancy.beginning import beginning
from sim.discrepancy.fitting import Fitted, fit, frame_of, on, record_of
from sim.discrepancy.held_out import HeldOutRun, let_run
from sim.discrepancy.rules import RULES
from sim.discrepancy.workflow import diagnose
from sim.engine import linear_recursion
from sim.sha import Array
from tests.discrepancy.plants import model, plant

PERIOD, BEGINS, PUT = 60.0, 2.2 * 86400.0, 8.0 / 3600.0
"""Seconds between rows, the time (s) from which the running machine makes more heat, and how much (degC/s)."""


@pytest.fixture(scope="module")
def trial() -> HeldOutRun:
    """Free runs through fifteen cycles of a plant in which nothing is missing."""
    record = record_of(model(), [plant(1, days=5)], ())
    base: Fitted = fit(on(frame_of(record), record))
    return let_run(base, record.by_cycles())


def changed(trial: HeldOutRun, errors: Array) -> HeldOutRun:
    """The runs with so much more error in each cycle while the machine runs."""
    running = trial.record.windowed(trial.record.running) > 0.5
    return replace(trial, residual=trial.residual + np.where(running, errors[trial.record.window_whole], 0.0))


@pytest.mark.parametrize("cut", [4, 8, 11])
def test_a_step_is_dated_by_the_cycle_with_which_it_begins(trial: HeldOutRun, cut: int) -> None:
    found = beginning((changed(trial, np.where(np.arange(15) >= cut, 1.5, 0.0)),), 0.03, RULES)
    assert found is not None and found.running
    assert (found.before, found.after) == (cut, 15 - cut)
    starts = trial.record.runs.time[trial.record.runs.first]
    assert found.time == starts[cut] and found.interval[0] <= starts[cut] <= found.interval[1]
    assert found.moves == pytest.approx(1.5, abs=0.4)


def test_what_is_clean_grows_or_wanders_begins_nowhere(trial: HeldOutRun) -> None:
    grows = np.linspace(0.0, 2.5, 15)
    wanders = np.repeat([0.0, 1.5, 0.0, 1.5, 0.0], 3)
    for errors in (np.zeros(15), grows, wanders):
        assert beginning((changed(trial, errors),), 0.03, RULES) is None
    late = np.where(np.arange(15) >= 16 - RULES.beginning_least_cycles, 1.5, 0.0)
    found = beginning((changed(trial, late),), 0.03, RULES)
    assert found is None or found.after >= RULES.beginning_least_cycles


def test_clean_plants_begin_nowhere() -> None:
    for seed in range(20, 28):
        record = record_of(model(), [plant(seed, days=4)], ())
        base = fit(on(frame_of(record), record), rounds=2)
        assert beginning((let_run(base, record.by_cycles()),), 0.03, RULES) is None, seed


def test_an_exchanged_bearing_is_a_gap_with_its_date() -> None:
    trace = plant(6, days=5, exchanged=0.08)
    found = diagnose(model(), [trace], seed=0).diagnosis
    assert found.verdict != "agree" and found.began is not None
    middle = float(trace.times[trace.times.size // 2])
    assert found.began.interval[0] <= middle + 86400.0 / 3 and abs(found.began.time - middle) < 86400.0 / 2
    assert "warmer" in found.sentence or found.effects


def test_a_heat_that_begins_half_way_is_dated_whatever_name_was_tried_for_it() -> None:
    trace = plant(4, days=5, period=PERIOD)
    on, since = trace.signals["MarciaDecanter"] > 0.5, trace.times - trace.times[0]
    keep = np.exp(-PERIOD * np.where(on, 1 / 1500, 1 / 3600))
    added = linear_recursion(keep, PERIOD * np.where(on & (since > BEGINS), PUT, 0.0), 0.0)
    signals = {**trace.signals, "T": np.round(trace.signals["T"] + added, 1)}
    found = diagnose(model(), [replace(trace, signals=signals)], seed=0).diagnosis
    assert found.began is not None and found.began.running and found.began.moves > 1.0
    low, high = found.began.interval
    assert low - trace.times[0] <= BEGINS <= high - trace.times[0]
    assert (found.began.before, found.began.after) == (6, 9)
    assert beginning_sentence(found.began, "°C") in found.sentence
    # The picture shows it by itself.
    heat = found.missing_heat
    assert heat is not None
    late = heat.times - trace.times[0] > BEGINS
    more = np.mean(heat.mean[heat.running & late]) - np.mean(heat.mean[heat.running & ~late])
    assert abs(more - 8.0) < 1.5
