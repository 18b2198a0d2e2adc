"""The scorecard from a historian with known numbers."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.tag import Tag
from gateway.store.read_back import mature_forecasts
from gateway.store.score import error, scorecard, time_since_start, warning_score
from tests.gateway.support import EPOCH, one_machine

LEVELS = [0.05, 0.25, 0.5, 0.75, 0.95]


def filled(path: Path) -> Path:
    """Measured = 20 + n; one-step is 0.5 too low, the free run 2 too high; forecasts of 10 s say +9 within 1."""
    store, historian = one_machine(path, (Tag("T", "holding:1"),))
    for n in range(60):
        measured = None if n == 30 else 20.0 + n
        row = (EPOCH + n, "on", 1, measured, 19.5 + n, 18.9 + n, 20.1 + n, 22.0 + n if n > 4 else None, 0.1, "green")
        historian.put("predictions", [row])
        historian.put("scans", [(EPOCH + n, 0.01, 0)])
        if n % 10 == 0:
            fan = json.dumps([28.0 + n, 28.5 + n, 29.0 + n, 29.5 + n, 30.5 + n])
            historian.put("forecasts", [(EPOCH + n, 10.0, json.dumps(LEVELS), fan, 0.25, 80.0, measured)])
    historian.put("events", [(EPOCH, "W_ON", "on")])
    for latency in (1.0, 2.0, 3.0, 40.0):
        historian.put("writes", [(EPOCH, 1, "armed", "written", 31, latency, "", b"")])
    historian.put("writes", [(EPOCH, 1, "armed", "failed", 31, None, "no reply", b"")])
    assert store.close()
    return path


def test_errors_forecasts_and_writes_are_those_that_were_put_in(tmp_path: Path) -> None:
    card = scorecard(filled(tmp_path / "h.sqlite"))
    assert (card.scans, card.samples, card.events) == (60, 0, 1)
    assert (card.one_step.rmse, card.one_step.mae, card.one_step.count) == pytest.approx((0.5, 0.5, 59))
    assert (card.free_run.rmse, card.free_run.mae, card.free_run.count) == pytest.approx((2.0, 2.0, 54))
    assert {name: (one.mae, one.count) for name, one in card.by_location.items()} == {"on": (pytest.approx(0.5), 59)}
    assert card.band90 == pytest.approx(1.0)
    (ten,) = card.forecasts
    assert (ten.horizon, ten.count) == (10.0, 4), "one has no reading at its start, one not yet its time"
    assert (ten.mae, ten.persistence_mae, ten.coverage90) == pytest.approx((1.25, 10.25, 0.75))
    assert 0.0 < ten.crps < ten.mae
    assert card.writes.verdicts == {"written": 4, "failed": 1}
    assert (card.writes.p50, card.writes.p99) == (3.0, 40.0)


def test_time_since_a_start_is_known_from_a_start_that_was_seen_until_one_may_have_been_missed() -> None:
    runs = {"low": True, "high": True, "off": False, "either": None}
    told = [("low", 0), ("off", 10), ("either", 20), ("low", 30), ("either", 40), ("high", 50), ("high", 600)]
    told += [("off", 610), ("of another model", 620), ("either", 630), ("low", 640), ("off", 650), ("low", 660)]
    times = np.array([EPOCH + time for _, time in told])
    since = time_since_start(times, [location for location, _ in told], runs)
    nothing, rest = float("nan"), float("-inf")
    seen = [nothing, rest, rest, 0.0, 10.0, 20.0, nothing, rest, nothing, nothing, nothing, rest, 0.0]
    np.testing.assert_array_equal(since, seen)
    assert time_since_start(np.empty(0), [], runs).size == 0
    np.testing.assert_array_equal(time_since_start(times[1:2], ["off"], runs), [rest])


def test_forecasts_are_scored_by_how_long_the_machine_had_been_running(tmp_path: Path) -> None:
    store, historian = one_machine(tmp_path / "h.sqlite", (Tag("T", "holding:1"),))
    for n in range(0, 2400, 5):
        location = "off" if n < 100 else "on"
        row = (EPOCH + n, location, 1, 20.0, 20.0, 19.0, 21.0, 20.0, 0.1, "green")
        historian.put("predictions", [row])
        if n % 100 == 0:
            # In the first three minutes after the start each is 4 too high, at rest and later none.
            wrong = 4.0 if 100 <= n < 280 else 0.0
            fan = json.dumps([each + wrong for each in (19.0, 19.5, 20.0, 20.5, 21.0)])
            historian.put("forecasts", [(EPOCH + n, 10.0, json.dumps(LEVELS), fan, 0.0, 80.0, 20.0)])
    assert store.close()
    card = scorecard(tmp_path / "h.sqlite", runs={"on": True, "off": False})
    found = {
        (one.begin, one.end): [(each.horizon, each.mae, each.coverage90, each.count) for each in one.forecasts]
        for one in card.by_start
    }
    assert found == {
        (None, None): [(10.0, 0.0, 1.0, 1)],
        (0.0, 180.0): [(10.0, 4.0, 0.0, 2)],
        (180.0, 600.0): [(10.0, 0.0, 1.0, 4)],
        (600.0, 1800.0): [(10.0, 0.0, 1.0, 12)],
        (1800.0, None): [(10.0, 0.0, 1.0, 5)],
    }
    for nothing in (None, {}, {"on": None, "off": None}):
        card = scorecard(tmp_path / "h.sqlite", runs=nothing)
        assert card.by_start == (), "nobody said in which locations the machine runs"


def test_a_forecast_is_compared_with_the_first_reading_at_or_after_its_time(tmp_path: Path) -> None:
    found = mature_forecasts(filled(tmp_path / "h.sqlite"))[10.0]
    assert found.outcome.tolist()[:2] == [30.0, 40.0]
    assert found.outcome[2] == 51.0, "the reading at 30 s failed, that of 31 s came"
    assert np.isnan(found.outcome[5])
    assert np.isnan(mature_forecasts(tmp_path / "h.sqlite", tolerance=0.5)[10.0].outcome[2])


def test_no_common_reading_has_no_error() -> None:
    none = error(np.array([np.nan, 1.0]), np.array([1.0, np.nan]))
    assert none.count == 0 and np.isnan(none.rmse)


def test_warnings_are_held_against_what_came_within_the_longest_horizon(tmp_path: Path) -> None:
    store, historian = one_machine(tmp_path / "h.sqlite", (Tag("T", "holding:1"),))
    followed = store.view("decanter", (), "T")

    def raised(seconds: float, condition: str, tag: str = "T") -> None:
        historian.put("alarms", [(EPOCH + seconds, condition, tag, 1, "unacknowledged", 1.0, "")])

    raised(100.0, "predicted over limit")
    raised(400.0, "over limit T")  # 300 s after its warning
    raised(5000.0, "predicted over limit")  # nothing comes of it
    raised(7000.0, "over limit T")  # without one
    raised(7000.0, "over limit U", "U")
    raised(9900.0, "predicted over limit")  # its time is not over
    historian.put("scans", [(EPOCH + 10_000.0, 0.01, 0)])
    followed.put("forecasts", [(EPOCH, 900.0, json.dumps(LEVELS), json.dumps([1.0] * 5), 0.0, 80.0, 1.0)])
    assert store.close()
    score = warning_score(tmp_path / "h.sqlite")
    assert (score.hits, score.misses, score.false_alarms, score.lead) == (1, 1, 1, 300.0)
    early = warning_score(tmp_path / "h.sqlite", machine="decanter", temperature="T", end=EPOCH + 1000.0)
    assert (early.hits, early.misses, early.false_alarms) == (1, 0, 0)


def test_a_scorecard_of_a_stretch_is_of_that_stretch(tmp_path: Path) -> None:
    card = scorecard(filled(tmp_path / "h.sqlite"), start=EPOCH, end=EPOCH + 25.0)
    assert (card.one_step.count, card.forecasts[0].count) == (25, 3), "what came after it is held against its forecasts"
