"""From which anomaly score on a model's alarm comes: by the peaks of that score on data that were held out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.anomaly import DEADBAND_SHARE, MIN_PEAK, AnomalyRecord, ScorePeaks
from sim.lab.learning.anomaly_level import MAX_LEVEL, WEEK_S, record_scores, weekly_level
from sim.lab.learning.bins.candidates import BinsCandidate
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.learning.calibrate import HeldOutScores
from sim.sha.events import DECANTER
from tests.learning.plants import Truth, simulate


def peaks_of(scores: list[float]) -> list[float]:
    found = ScorePeaks()
    for score in scores:
        found.take(score)
    found.end()
    return found.peaks


def raised(scores: list[float], limit: float) -> int:
    """How often an alarm at this limit, with its deadband, is raised along the scores."""
    count, stands = 0, False
    for score in scores:
        if not stands and score > limit:
            count, stands = count + 1, True
        elif stands and score <= limit * (1.0 - DEADBAND_SHARE):
            stands = False
    return count


def test_peaks_are_what_an_alarm_with_a_deadband_tells_apart() -> None:
    # Falls by less than a third, a slow fall after a peak, and what is low begin none.
    assert peaks_of([0.0, 5.0, 4.0, 6.0, 3.9, 3.0, 1.0, 1.9, 0.5, 9.0]) == [6.0, 9.0]
    assert peaks_of([40.0, 26.0, 17.0, 11.0, 16.0, 17.0, 11.0]) == [40.0, 17.0]
    assert peaks_of([]) == peaks_of([1.0, 1.9, 0.0]) == []


@given(st.lists(st.floats(0.0, 99.0), max_size=60), st.floats(MIN_PEAK * 1.5, 99.0))
def test_no_alarm_is_raised_more_often_than_peaks_pass_its_limit(scores: list[float], limit: float) -> None:
    assert raised(scores, limit) <= sum(peak > limit for peak in peaks_of(scores))


def test_the_level_is_passed_at_most_once_a_week_on_the_weeks_that_follow() -> None:
    # 20 peaks a day above 2 with a mean excess of 3, of which a record has eight days of their own.
    rng, weeks, passed = np.random.default_rng(0), 400, list[float]()
    for _ in range(50):
        level = weekly_level(sorted(MIN_PEAK + rng.exponential(3.0, 160), reverse=True), 8 * 86_400.0, 8)
        passed.append(float(np.count_nonzero(MIN_PEAK + rng.exponential(3.0, 140 * weeks) > level)) / weeks)
    assert np.median(passed) < 0.5 and np.mean(np.array(passed) <= 1.0) > 0.75
    # That is no level at which nothing is ever found.
    assert level < 40.0


def test_fewer_units_and_a_shorter_record_ask_for_a_higher_level() -> None:
    peaks = sorted(MIN_PEAK + np.random.default_rng(1).exponential(2.0, 60), reverse=True)
    by_units = [weekly_level(peaks, 3 * 86_400.0, units) for units in (1, 2, 5, 15)]
    assert by_units == sorted(by_units, reverse=True) and by_units[0] > 1.5 * by_units[-1]
    assert weekly_level(peaks, WEEK_S / 7, 5) > weekly_level(peaks, WEEK_S, 5) > weekly_level(peaks, 10 * WEEK_S, 5)
    # A quiet record and one without a peak ask for nothing: the alarm begins where it does without one.
    assert weekly_level([2.5, 2.2], 40 * WEEK_S, 20) < 3.0 and weekly_level([], 3600.0, 1) == MIN_PEAK


def test_a_record_has_an_upper_end_and_there_is_none_of_nothing() -> None:
    record = record_scores([98.0, 95.0, 60.0, 30.0, 12.0, 11.0], 3600.0, 1)
    assert record is not None and record.level == MAX_LEVEL and record.peaks[:2] == (98.0, 95.0)
    assert record_scores([], 0.0, 1) is record_scores([5.0], 60.0, 0) is None
    with pytest.raises(ValueError, match="at least one unit"):
        AnomalyRecord(seconds=1.0, units=0, peaks=(), level=2.0)


def test_a_learned_model_keeps_what_its_score_did_on_the_traces_that_were_held_out() -> None:
    traces = simulate(Truth(), 2, cycles=6, rows=120)
    record = learn_bins(traces, DECANTER, "T", seed=0, candidates=[BinsCandidate("constant")]).model.anomalies
    assert record is not None and record.units == len(traces) == 6
    assert record.seconds == pytest.approx(sum(float(trace.times[-1] - trace.times[0]) for trace in traces))
    assert MIN_PEAK <= record.level <= MAX_LEVEL and list(record.peaks) == sorted(record.peaks, reverse=True)


def test_days_of_one_named_machine_are_units_and_of_several_the_machines_are() -> None:
    def units(*traces: tuple[str, str]) -> int:
        scores = HeldOutScores(seconds=3600.0, traces=set(traces))
        assert scores.record is not None
        return scores.record.units

    assert units(("", "monday"), ("", "tuesday")) == units(("north", "monday"), ("north", "tuesday")) == 2
    assert units(("north", "monday"), ("north", "tuesday"), ("south", "monday"), ("south", "friday")) == 2
