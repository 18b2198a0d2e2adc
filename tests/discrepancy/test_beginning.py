"""A gap that begins half-way is a gap, with the date on which it begins."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from sim.effects import moment_words
from sim.engine import linear_recursion
from sim.lab.discrepancy import GapBeginning, beginning_sentence
from sim.lab.discrepancy.beginning import beginning
from sim.lab.discrepancy.fitting import Fitted, build_frame, build_record, fit, move_frame
from sim.lab.discrepancy.held_out import HeldOutRun, let_run
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from sim.sha import Array
from tests.discrepancy.plants import model, plant

PERIOD, BEGINS, PUT = 60.0, 2.2 * 86400.0, 8.0 / 3600.0
"""Seconds between rows, the time (s) from which the running machine makes more heat, and how much (degC/s)."""


@pytest.fixture(scope="module")
def trial() -> HeldOutRun:
    """Free runs through fifteen cycles of a plant in which nothing is missing."""
    record = build_record(model(), [plant(1, days=5)], ())
    base: Fitted = fit(move_frame(build_frame(record), record))
    return let_run(base, record.by_cycles())


def changed(trial: HeldOutRun, errors: Array) -> HeldOutRun:
    """The runs with so much more error in each cycle while the machine runs."""
    running = trial.record.window_means(trial.record.running) > 0.5
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


def test_what_chance_makes_of_the_cycles_is_drawn_in_little_memory(trial: HeldOutRun) -> None:
    """Ten thousand times; and of the cycles of sixty days one array of all draws is 14 MB."""
    runs = changed(trial, np.where(np.arange(15) >= 8, 1.5, 0.0))
    tracemalloc.start()
    assert beginning((runs,), 0.03, RULES) is not None
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10_000 * 15 * 8


@pytest.fixture(scope="module")
def run_on() -> HeldOutRun:
    """A free run through one run of five days."""
    record = build_record(model(), [plant(1, days=5, runs_on=True)], ())
    return let_run(fit(move_frame(build_frame(record), record), rounds=2), record.by_cycles())


def pieces_of(trial: HeldOutRun) -> tuple[Array, Array]:
    """(number of each window's piece, start of each piece that is shown while the machine runs s)."""
    number = np.unique(trial.record.window_cycle, return_inverse=True)[1]
    return number, np.array([trial.record.times[number == each][0] for each in range(number.max() + 1)])


def test_a_machine_that_runs_on_is_dated_by_stretches_of_its_run(run_on: HeldOutRun) -> None:
    number, starts = pieces_of(run_on)
    count = starts.size
    assert np.unique(run_on.record.window_whole).size < 3 and count > 20
    assert beginning((run_on,), 0.03, RULES) is None
    cut = count // 3
    found = beginning((replace(run_on, residual=run_on.residual + 1.5 * (number >= cut)),), 0.03, RULES)
    assert found is not None and found.running and found.moves == pytest.approx(1.5, abs=0.3)
    assert found.interval[0] <= starts[cut] <= found.interval[1]
    assert found.stretch == pytest.approx(np.median(np.diff(starts)), rel=0.1)
    said = beginning_sentence(found, "°C")
    assert f"stretches of {found.stretch / 3600:.2g} hours" in said and "cycle" not in said


def test_what_fails_in_two_steps_begins_with_the_first(run_on: HeldOutRun) -> None:
    """As the rig's cooler, from 100 to 20 and to 3 %: a line leaves less of it than one step."""
    number, starts = pieces_of(run_on)
    first, second = starts.size // 5, 3 * starts.size // 5
    errors = 2.0 * (number >= first) + 2.0 * (number >= second)
    found = beginning((replace(run_on, residual=run_on.residual + errors),), 0.03, RULES)
    assert found is not None and found.then is not None
    assert abs(found.time - starts[first]) <= found.stretch and abs(found.then[0] - starts[second]) <= found.stretch
    assert found.moves == pytest.approx(2.0, abs=0.4) and found.then[1] == pytest.approx(4.0, abs=0.4)
    assert f"from {moment_words(found.then[0])} on {found.then[1]:.2g} °C warmer" in beginning_sentence(found, "°C")


def test_a_jump_stands_out_of_an_error_that_wanders_as_the_run_goes_on(run_on: HeldOutRun) -> None:
    number, starts = pieces_of(run_on)
    slow = 1.2 * np.sin(np.arange(starts.size) / 6.0)[number]
    assert beginning((replace(run_on, residual=run_on.residual + slow),), 0.03, RULES) is None
    cut = starts.size // 2
    found = beginning((replace(run_on, residual=run_on.residual + slow + 8.0 * (number >= cut)),), 0.03, RULES)
    assert found is not None and abs(found.time - starts[cut]) <= found.stretch


def test_random_walks_of_a_long_run_begin_nowhere(run_on: HeldOutRun) -> None:
    number, starts = pieces_of(run_on)
    rng = np.random.default_rng(5)
    begun = [
        beginning((replace(run_on, residual=np.cumsum(rng.standard_normal(starts.size))[number]),), 0.03, RULES)
        for _ in range(20)
    ]
    assert sum(found is not None for found in begun) == 0


def test_clean_plants_begin_nowhere() -> None:
    for seed in range(20, 28):
        record = build_record(model(), [plant(seed, days=4)], ())
        base = fit(move_frame(build_frame(record), record), rounds=2)
        assert beginning((let_run(base, record.by_cycles()),), 0.03, RULES) is None, seed


def test_an_exchanged_bearing_is_a_gap_with_its_date() -> None:
    trace = plant(6, days=5, exchanged=0.08, period=60.0)
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
    assert found.reasons[0].startswith(f"from {moment_words(found.began.time)} on") and found.verdict == "unexplained"
    assert not any("there is no gap" in reason for reason in found.reasons), found.reasons
    # The picture shows it by itself.
    heat = found.missing_heat
    assert heat is not None
    late = heat.times - trace.times[0] > BEGINS
    more = np.mean(heat.mean[heat.running & late]) - np.mean(heat.mean[heat.running & ~late])
    assert abs(more - 8.0) < 1.5


def test_a_beginning_on_a_clock_without_dates_has_none() -> None:
    began = GapBeginning(
        time=22020.0, interval=(19820.0, 24220.0), before=10, after=40, moves=12.0, running=True, p=1e-4, stretch=2195.0
    )
    said = beginning_sentence(began, "°C")
    assert "the stretch of 6.1 h on the traces' clock" in said and "1970" not in said
