"""The year's machinery on a few days: the plant changes as stated, and the loop acts by the product's own code."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from benchmarks.year.arms import Happening, Loop, Once
from benchmarks.year.judge import HORIZONS, DayScore, day_score
from benchmarks.year.kept_days import KeptDays
from benchmarks.year.plant import BEARING, SENSOR, TEMPERATURE, Day, dates_of, day_of, days_before, overheated, plant_on
from gateway.lab.retraining import shadow, study
from gateway.store import newest_scan, reading
from sim.artefacts import current, versions
from sim.lab.judge.comparison import NEW, PRESENT
from sim.lab.tuning import METHODS, Taught
from sim.sha import Trace
from tests.retraining.test_retraining import BEGIN, heated, plant

SEED = 3


def test_the_plant_wears_and_changes_on_its_days() -> None:
    assert plant_on(200.0).idle_heat > plant_on(0.0).idle_heat > plant_on(-20.0).idle_heat
    assert plant_on(BEARING).idle_heat == plant_on(0.0).idle_heat
    assert plant_on(SENSOR).sensor_lag > plant_on(SENSOR - 1.0).sensor_lag
    first, again = days_before(1, seed=SEED)[0], days_before(1, seed=SEED)[0]
    assert np.array_equal(first.signals[TEMPERATURE], again.signals[TEMPERATURE])
    assert first.times[-1] < day_of(dates_of(1, 1)[0], seed=SEED).trace.times[0]
    assert [date.judged for date in dates_of(1, 6, 2)] == [True, False, False, True, False, False]
    assert all(date.judged for date in dates_of(1, 2)) and dates_of(1, 2)[1].number > dates_of(1, 2)[0].number


def test_the_limit_is_counted_once_until_it_is_left() -> None:
    readings = np.repeat([50.0, 56.0, 54.0, 56.0, 50.0, 56.0], 6)
    trace = Trace("heat", np.arange(36.0), {TEMPERATURE: readings})
    assert overheated(trace) == pytest.approx([6.0, 30.0], abs=1.0)


def test_a_day_is_judged_at_every_horizon() -> None:
    day = day_of(dates_of(1, 1)[0], seed=SEED)
    morning = replace(day, trace=day.trace.between(day.trace.times[0], day.trace.times[0] + 5400.0))
    score = day_score("once", heated(50.0), morning, seed=0)
    assert len(score.mae) == len(HORIZONS) and all(0 < value < 30 for value in score.mae)
    assert score.mae[0] < score.mae[-1] and all(0 <= value <= 1 for value in score.coverage)


@pytest.mark.parametrize(("worth", "runs"), [(0.5, "new"), (1.5, "first")])
def test_the_loop_promotes_what_is_better_on_live_cycles_and_nothing_else(
    worth: float, runs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Learning and forecasting are stubbed: on cycles held out the new model is better, on live ones so many times."""
    asked: list[float] = []

    def judged(factor: float) -> Any:
        def judge(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
            asked.append(float(trace.times[-1]))
            present = 1.0 + 0.1 * np.random.default_rng(int(trace.times[0])).random()
            rows = {PRESENT: present, NEW: factor * present}
            return [
                {"trace": trace.name, "horizon": 60.0, "method": name, "crps": crps, "coverage": 0.9}
                for name, crps in rows.items()
            ]

        return judge

    first, new = heated(50.0), heated(60.0)
    learn = replace(METHODS["bins"], learn=lambda *_: Taught(new, {}))
    monkeypatch.setitem(METHODS, "bins", learn)
    monkeypatch.setattr(study, "report_files", lambda *_: {"retraining_report.txt": "drawn in another test"})
    monkeypatch.setattr(study, "score_trace", judged(0.5))
    monkeypatch.setattr(shadow, "score_trace", judged(worth))
    days = [Day(0, float(number), plant(11, BEGIN + 86_400.0 * number)) for number in range(10)]
    earlier = [plant(2, BEGIN - 86_400.0)]
    loop, once = Loop(first, earlier, tmp_path, 0, BEGIN - 1.0), Once(first)
    for day in days:
        loop.evening(day)
        once.evening(day)
        assert all(moment <= day.trace.times[-1] for moment in asked), "nothing of the days to come"
    with reading(tmp_path / "historian.sqlite") as connection:
        assert newest_scan(connection) == pytest.approx(days[-1].trace.times[-1])
    kinds = [each.kind for each in loop.happenings]
    assert "proposal" in kinds and once.model == first
    store = tmp_path / "store"
    if runs == "new":
        assert "promotion" in kinds and "left" not in kinds
        assert current(store) == versions(store)[1] and loop.model.sha == new.sha
        ((before, after),) = loop.promotions().values()
        assert (before.sha, after.sha) == (first.sha, new.sha), "the judge asks what ran before"
    else:
        assert "left" in kinds and "promotion" not in kinds and current(store) == versions(store)[0]


def test_a_year_that_was_ended_goes_on_after_its_last_whole_day(tmp_path: Path) -> None:
    settings = {"months": 1, "seed": 0}
    folder = tmp_path / "loop"
    figures = {"mae": (0.1,), "crps": (0.2,), "coverage": (0.9,), "overheated": 1, "leads": (60.0,)}
    score = DayScore(arm="loop", month=0, day=3.0, false=0, alarms=1, **figures)  # type: ignore[arg-type]
    kept = KeptDays(folder, settings)
    (kept.work / "store").write_text("one", encoding="utf-8")
    kept.scores.append(score)
    kept.happenings.append(Happening(3.0, "promotion", "0002", "better"))
    kept.state, kept.days, kept.seconds = {"candidate": "0002"}, 1, 12.5
    kept.keep()
    # Killed in the next evening, at any of its moments: what the arm has written since then does not count.
    (kept.work / "store").write_text("two", encoding="utf-8")
    for ended in ("in the evening", "while it copied", "between two renamings"):
        if ended == "while it copied":
            (folder / "new").mkdir()
        if ended == "between two renamings":
            (folder / "kept").rename(folder / "before")
        again = KeptDays(folder, settings)
        assert (again.scores, again.happenings, again.state, again.seconds) == (
            [score],
            kept.happenings,
            {"candidate": "0002"},
            12.5,
        ), ended
        assert (again.work / "store").read_text(encoding="utf-8") == "one", ended
    again.scores.append(replace(score, day=18.0))
    again.keep()
    assert [each.day for each in KeptDays(folder, settings).scores] == [3.0, 18.0]
    with pytest.raises(click.ClickException, match="give another --keep"):
        KeptDays(folder, settings | {"seed": 1})
