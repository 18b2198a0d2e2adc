"""The bands of a learned model cover what they say, on traces of the same plant that it never saw."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from gateway.lab.learning.learn import coverage_rows
from sim.lab.learning.bins.candidates import BinsCandidate
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.learning.calibrate import HORIZONS_S, Scored, calibrate, horizon_coverage, score_forecasts
from sim.sha import Array, Model, Trace, encode_trace
from sim.sha.events import DECANTER
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, two_modes
from tests.learning.plants import Truth, simulate
from tests.rig.no_bands import without_bands

CONSTANT, DRIVEN = BinsCandidate("constant"), BinsCandidate("driven", "shared", "location")
"""What the plants are; that the learner finds it is asked elsewhere."""


def scored(z: np.ndarray, horizon: float = 60.0, every: float = 60.0) -> list[Scored]:
    return [Scored(horizon, every * number, float(value), 0.0) for number, value in enumerate(z)]


def test_a_band_that_is_too_narrow_is_widened_by_as_much() -> None:
    z = 1.7 * np.abs(np.random.default_rng(0).normal(size=2000))
    (one,) = horizon_coverage(scored(z))
    assert one.factor == pytest.approx(1.7, rel=0.07)
    assert one.covered < 0.75


def test_an_honest_band_stays_as_it_is() -> None:
    (one,) = horizon_coverage(scored(np.abs(np.random.default_rng(1).normal(size=2000))))
    assert one.factor == pytest.approx(1.0, abs=0.05)
    assert one.covered == pytest.approx(0.9, abs=0.03)


def test_overlapping_forecasts_count_for_the_time_they_span() -> None:
    (one,) = horizon_coverage(scored(np.ones(100), horizon=900.0, every=9.0))
    assert one.forecasts == 100
    assert one.independent == pytest.approx(1 + 99 * 9 / 900)


def test_little_evidence_leaves_the_factor_near_its_cautious_start() -> None:
    (one,) = horizon_coverage(scored(np.zeros(1)))
    assert 0.9 < one.factor < 1.25
    assert horizon_coverage([]) == ()


def test_a_table_for_people_has_no_hashes_of_moments() -> None:
    coverage = horizon_coverage(scored(np.ones(3)))
    assert coverage[0].units
    (row,) = coverage_rows(coverage)
    assert row["forecasts"] == 3 and all(isinstance(value, (int, float)) for value in row.values())


def test_a_cycle_of_a_recording_has_the_same_name_whatever_else_was_read_and_whichever_model_forecast_it() -> None:
    model = two_modes(gap=150.0)
    times = 1.7e9 + np.arange(0.0, 2 * 86_400.0, 60.0)
    on = times // 7200.0 % 2
    signals = {RUNNING: on, CURRENT: 150.0 * on, TEMPERATURE: 20.0 + 20.0 * on}
    more = {**signals, "Feed": on}

    def units(
        own: Model, columns: Mapping[str, Array], origins: int = 48, most_rows: int = 10_000
    ) -> list[dict[str, str]]:
        trace = encode_trace(Trace("export", times, columns), own.alphabet)
        found = score_forecasts(
            own, [trace], [float(times[0])], np.random.default_rng(0), origins=origins, most_rows=most_rows
        )
        return [{name: unit.moments for name, unit in row.units.items()} for row in horizon_coverage(found)]

    every, other = units(model, signals), units(replace(model, sensor_sigma=1.0), more)
    assert every == other and len(every) == 3 and all(len(names) > 6 for names in every)
    # From other moments, or of a belief that has read fewer rows, it is the same cycle and another sample of it.
    for apart in (units(model, signals, origins=24), units(model, signals, most_rows=1_000)):
        for one, of_it in zip(every, apart, strict=True):
            shared = one.keys() & of_it.keys()
            assert shared and all(one[name] != of_it[name] for name in shared)
    assert every != units(model, {**signals, TEMPERATURE: 20.5 + 20.0 * on})


def test_only_forecasts_after_the_given_moment_count(monkeypatch: pytest.MonkeyPatch) -> None:
    # The model's own bands, for which it would be fitted three times more, are left aside when forecasts are scored.
    without_bands(monkeypatch)
    trace = simulate(Truth(), 1, cycles=1)[0]
    model = learn_bins(simulate(Truth(), 2, cycles=3, rows=120), DECANTER, "T", seed=0, candidates=[CONSTANT]).model
    since = float(trace.times[120])
    due = [one.due for one in score_forecasts(model, [trace], [since], np.random.default_rng(0), origins=30)]
    assert due
    assert min(due) >= since + 60
    assert set(calibrate(model, [trace], np.random.default_rng(0))) == set(HORIZONS_S)


@pytest.mark.parametrize(
    ("truth", "candidate", "seed"),
    [(Truth(), CONSTANT, 11), (Truth(gain=0.1, noise=0.02), DRIVEN, 12)],
    ids=["smooth", "driven and rough"],
)
def test_ninety_per_cent_bands_cover_ninety_per_cent_of_unseen_cycles(
    truth: Truth, candidate: BinsCandidate, seed: int
) -> None:
    traces = simulate(truth, seed, cycles=14, rows=200)
    model = learn_bins(traces[:7], DECANTER, "T", seed=seed, candidates=[candidate]).model
    begins = [float(trace.times[0]) for trace in traces[7:]]
    found = score_forecasts(model, traces[7:], begins, np.random.default_rng(seed))
    judged = horizon_coverage(found)
    assert [one.horizon for one in judged] == list(HORIZONS_S)
    for one in judged:
        z = np.array([each.z for each in found if each.horizon == one.horizon]) / model.calibration[one.horizon]
        share, spread = float(np.mean(z <= 1.6449)), np.sqrt(0.09 / one.independent)
        # Binomial error of the independent forecasts, and as much again for that of the factor.
        assert abs(share - 0.9) < 2.6 * np.sqrt(2) * spread, (one, share)
