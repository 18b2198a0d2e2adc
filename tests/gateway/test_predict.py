"""From scans to predictions: online equals batch, not knowing is said, the open loop is open."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.tag import Quality, Value
from gateway.machine.model.outlook import Outlook
from gateway.machine.model.predict import Predictor, ScanPrediction
from sim.engine.belief import filter_trace
from sim.forecast.calibration import Horizon, PendingForecast
from sim.sha.events import encode
from sim.sha.trace import UNKNOWN, Trace
from tests.gateway.support import CURRENT, EPOCH, RUNNING, TEMPERATURE, config_in, scan_of, two_modes

Reading = tuple[bool | None, float | None, float | None]


def run(
    rows: list[Reading], predictor: Predictor | None = None, start: int = 0
) -> tuple[Predictor, list[ScanPrediction]]:
    predictor = predictor or Predictor(two_modes(), TEMPERATURE)
    found = []
    for second, (running, current, temperature) in enumerate(rows, start):
        values: dict[str, Value | None] = {RUNNING: running, CURRENT: current, TEMPERATURE: temperature}
        found.append(predictor.step(scan_of(values, EPOCH + second)))
    return predictor, found


def as_trace(rows: list[Reading]) -> Trace:
    columns = {
        name: np.array([np.nan if row[place] is None else float(row[place]) for row in rows])
        for place, name in enumerate((RUNNING, CURRENT, TEMPERATURE))
    }
    bad = {name: np.isnan(column) for name, column in columns.items()}
    return Trace("rows", EPOCH + np.arange(len(rows), dtype=float), columns, bad=bad)


rows_of_readings = st.lists(
    st.tuples(
        st.sampled_from([True, False, None]),
        st.sampled_from([None, 50.0, 99.9, 150.0, 250.0, 310.0]),
        st.one_of(st.none(), st.floats(15.0, 60.0)),
    ),
    min_size=1,
    max_size=60,
)


@settings(max_examples=60, deadline=None)
@given(rows_of_readings)
def test_events_and_predictions_online_are_those_of_the_batch(rows: list[Reading]) -> None:
    predictor, found = run(rows)
    trace = as_trace(rows)
    events = encode(trace, predictor.model.alphabet)
    assert tuple(event for p in found for event in p.events) == events
    batch = filter_trace(predictor.tracker, Trace(trace.name, trace.times, trace.signals, events, trace.bad))
    assert tuple(p.location for p in found) == batch.locations
    for online, expected, innovation in zip(found, batch.predicted, batch.innovation, strict=True):
        if np.isfinite(innovation):
            assert online.mean == pytest.approx(expected, abs=1e-9)
    assert predictor.belief is not None and predictor.belief.x == pytest.approx(batch.belief.x, abs=1e-9)


def test_a_reading_that_is_not_good_is_unknown_and_never_stopped_and_corrects_nothing() -> None:
    on: Reading = (True, 150.0, 40.0)
    predictor, _ = run([on] * 5)
    values: dict[str, Value | None] = {RUNNING: False, CURRENT: 0.0, TEMPERATURE: 90.0}
    doubtful = predictor.step(scan_of(values, EPOCH + 5, Quality.LAST_USABLE))
    assert [event.symbol for event in doubtful.events] == [UNKNOWN]
    assert doubtful.reset and not doubtful.known and not doubtful.inputs_good and doubtful.worst == 1
    assert doubtful.measured is None and doubtful.zone == "none"
    assert doubtful.mean == pytest.approx(40.0, abs=1.0)
    _, back = run([on] * 2, predictor, start=6)
    assert [event.symbol for event in back[0].events] == ["W_ON", "A_1"]
    assert back[0].known and back[0].location == "on"


def test_the_age_is_that_of_the_oldest_input_and_infinite_when_one_is_missing() -> None:
    predictor, _ = run([(True, 150.0, 40.0)])
    held = scan_of({RUNNING: True, CURRENT: 150.0, TEMPERATURE: 40.0}, EPOCH + 1)
    late = type(held)(1, EPOCH + 5.5, held.samples, 0, 0.0)
    assert predictor.step(late).age == pytest.approx(4.5)
    assert predictor.step(scan_of({RUNNING: True, CURRENT: 150.0}, EPOCH + 7)).age == float("inf")


def test_the_free_run_is_not_corrected_and_begins_anew_with_a_cycle_and_after_not_knowing() -> None:
    def heating(first: float, seconds: int) -> list[Reading]:
        return [(True, 150.0, first + 0.5 * n) for n in range(seconds)]

    predictor, found = run([(False, 0.0, 30.0)] * 3 + heating(30.0, 20))
    assert found[3].free_run is None, "the cycle's first reading is given, not predicted"
    expected = 50.0 + (30.0 - 50.0) * np.exp(-0.01 * np.arange(1, 20))
    assert [p.free_run for p in found[4:]] == pytest.approx(list(expected))
    _, more = run([(None, 150.0, None), (True, 150.0, 45.0), (True, 150.0, 45.0)], predictor, start=23)
    assert [p.free_run for p in more[:2]] == [None, None]
    assert more[2].free_run == pytest.approx(50.0 - 5.0 * np.exp(-0.01))


def test_a_restored_predictor_goes_on_as_the_one_that_was_saved() -> None:
    rows: list[Reading] = [(True, 150.0, 40.0 + 0.1 * n) for n in range(40)]
    whole, expected = run(rows)
    first, _ = run(rows[:20])
    saved = json.loads(json.dumps(first.snapshot()))
    second = Predictor(two_modes(), TEMPERATURE)
    assert second.restore(saved, EPOCH + 20.0)
    _, found = run(rows[20:], second, start=20)
    assert found == expected[20:]
    assert second.belief == whole.belief


@pytest.mark.parametrize("later", [-1.0, 31.0])
def test_a_saved_state_of_the_future_or_older_than_the_gap_is_not_used(later: float) -> None:
    first, _ = run([(True, 150.0, 40.0)])
    second = Predictor(two_modes(), TEMPERATURE)
    assert not second.restore(json.loads(json.dumps(first.snapshot())), EPOCH + later)
    assert second.belief is None


def test_readings_that_do_not_follow_the_model_turn_the_zone_red() -> None:
    rng = np.random.default_rng(3)

    def zones(drift: float) -> list[str]:
        temperature, rows = 30.0, []
        for _ in range(60):
            temperature += (50.0 - temperature) * 0.01 + drift
            rows.append((True, 150.0, temperature + 0.05 * float(rng.standard_normal())))
        return [p.zone for p in run(rows)[1]]

    assert zones(0.0)[-1] == "green" and zones(0.0)[5] == "none"
    assert "red" in zones(0.4)


def test_a_model_that_is_only_tracked_believes_what_one_that_predicts_believes() -> None:
    said, tracked = (Predictor(two_modes(), TEMPERATURE) for _ in range(2))
    for second in range(60):
        values = {RUNNING: second >= 5, CURRENT: 150.0 if second % 7 else None, TEMPERATURE: 25.0 + 0.1 * second}
        scan = scan_of(values, EPOCH + second)
        prediction = said.step(scan)
        assert tracked.track(scan) == (prediction.known and prediction.inputs_good)
        assert tracked.belief == said.belief
    assert tracked.track(scan_of({RUNNING: True, CURRENT: 150.0}, EPOCH + 60)) is False, "a tag that was not read"


def test_what_bands_await_under_a_clock_that_was_ahead_keeps_no_other_forecast_waiting(tmp_path: Path) -> None:
    """Saved eight years ahead, restored now: what is due now is due, and what was learned stays."""
    config = config_in(tmp_path)
    outlook = Outlook(Predictor(two_modes(), TEMPERATURE), config.forecast, 80.0, scan_period=1.0)
    horizon = min(outlook.calibration.horizons)
    ahead = EPOCH + 2.5e8
    waiting = PendingForecast(due=ahead + horizon, low=40.0, median=41.0, high=42.0)
    saved = json.loads(json.dumps({f"{horizon:g}": Horizon(2.0, last=ahead, pending=(waiting,), matured=7).plain()}))
    outlook.restore(saved, EPOCH)
    found = outlook.calibration.horizons[horizon]
    assert (found.prior, found.matured, found.pending, found.last) == (2.0, 7, (), EPOCH)
    outlook.restore(saved, ahead)
    assert outlook.calibration.horizons[horizon].pending == (waiting,)
