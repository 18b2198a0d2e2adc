"""What begins to act half-way is dated by its own heat, also where no cycle errs by more in the mean."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.beginning import beginning
from sim.lab.discrepancy.diagnosis import GapBeginning
from sim.lab.discrepancy.fitting import Fitted, build_frame, build_record, catalogue, fit
from sim.lab.discrepancy.held_out import let_run
from sim.lab.discrepancy.onset import find_onset
from sim.lab.discrepancy.rules import RULES, DecisionRules
from sim.lab.discrepancy.workflow import diagnose
from sim.sha import Array, Trace
from tests.discrepancy.plants import model, plant

PERIOD, BEGINS, PUT, FADES = 60.0, 2.2 * 86400.0, 15.0 / 3600.0, 300.0
"""Seconds between rows, since when (s) each start heats, by how much (degC/s), and over how long (s) that fades."""
LEAST = 0.03
"""degC that must be moved."""
ROLES = {"current": "Assorbimento", "pump": "MarciaPmpFango", "ambient": "TAmbiente"}


def started(begins: float, seed: int = 4, put: float = PUT) -> Trace:
    """Five days of a plant that each start heats from so many seconds on."""

    def more(times: Array, on: Array, current: Array) -> tuple[Array, Array]:
        row = np.arange(on.size)
        age = PERIOD * (row - np.maximum.accumulate(np.where(np.diff(on, prepend=0.0) > 0, row, 0)))
        return put * on * np.exp(-age / FADES) * (times - times[0] >= begins), np.zeros(on.size)

    return plant(seed, days=5, period=PERIOD, more=more)


def of_all(trace: Trace) -> Fitted:
    record = build_record(model(), [trace], tuple(ROLES.values()))
    return fit(build_frame(record), rounds=2)


def dated(whole: Fitted, rules: DecisionRules = RULES) -> GapBeginning | None:
    return find_onset(whole, catalogue(), ROLES, LEAST, rules)


@pytest.fixture(scope="module")
def half_way() -> Fitted:
    return of_all(started(BEGINS))


def starts_of(whole: Fitted) -> Array:
    runs, cycle = whole.frame.record.runs, whole.frame.record.whole
    return np.array([runs.time[cycle == each][0] for each in np.unique(cycle)])


def test_what_heats_at_starts_is_dated_though_no_cycle_errs_by_more_in_the_mean(half_way: Fitted) -> None:
    assert beginning((let_run(half_way, half_way.frame.record.by_cycles()),), LEAST, RULES) is None
    found, starts = dated(half_way), starts_of(half_way)
    assert found is not None and found.acts == "startup-churning" and found.running and found.moves > 0.0
    begins = int(np.searchsorted(starts, starts[0] + BEGINS))
    assert abs(found.before - begins) <= 1 and found.after == starts.size - found.before
    assert found.interval[0] <= starts[begins] <= found.interval[1] and found.p <= RULES.beginning_most_p
    assert dated(half_way, replace(RULES, beginning_most_p=0.0)) is None


def test_what_acts_all_along_begins_nowhere() -> None:
    whole = of_all(started(0.0))
    assert dated(whole) is None


@pytest.mark.parametrize("seed", [1, 3])
def test_a_sensor_that_drifts_from_the_first_day_on_begins_nowhere(seed: int) -> None:
    trace = plant(seed, days=4, period=PERIOD)
    drifted = trace.signals["T"] + np.linspace(0.0, 1.5, trace.times.size)
    assert dated(of_all(replace(trace, signals={**trace.signals, "T": np.round(drifted, 1)}))) is None


@pytest.mark.parametrize("seed", [20, 21, 22])
def test_a_clean_plant_begins_nowhere(seed: int) -> None:
    assert dated(of_all(plant(seed, days=4, period=PERIOD))) is None


def test_what_one_cycle_made_up_begins_nowhere(half_way: Fitted) -> None:
    whole = of_all(plant(4, days=5, period=PERIOD))
    record = whole.frame.record
    last = record.window_whole == np.unique(record.window_whole)[-RULES.beginning_least_cycles]
    odd = replace(whole, residual=whole.residual + 2.0 * last)
    without = replace(RULES, beginning_carried_share=-np.inf)
    assert dated(odd, without) is not None
    assert dated(odd) is None


def test_a_diagnosis_says_since_when_and_like_what() -> None:
    trace = started(BEGINS)
    found = diagnose(model(), [trace], seed=0).diagnosis
    assert found.verdict != "agree" and found.began is not None and found.began.acts == "startup-churning"
    assert abs(found.began.time - trace.times[0] - BEGINS) < 86400.0 / 2
    assert "most like startup-churning" in found.sentence
