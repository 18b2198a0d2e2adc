"""Figures of forecasts against laws whose answer is known, and the comparison of methods at the same moments."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtri

from benchmarks.skill import ratio
from gateway.lab.judging.figures import missing_horizons
from sim.forecast.ensemble import DENSE_LEVELS
from sim.lab.judge.past import persistence
from sim.lab.judge.rows import NO_SKILL, SkillRow, common, difference, skill, stretch
from sim.lab.judge.skill_picture import draw_skill
from sim.lab.judge.worth import tables
from sim.scores import crps_gaussian
from sim.sha.trace import Array, Trace

NORMAL = ndtri(np.array(DENSE_LEVELS))


def row(outcome: float, law: Array = NORMAL, **changes: object) -> SkillRow:
    made = SkillRow(
        machine="A", trace="A", method="ours", horizon=60.0, origin=0.0, outcome=outcome, quantiles=np.asarray(law)
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def test_a_right_law_has_its_closed_crps_and_covers_ninety_per_cent() -> None:
    outcomes = 3.0 * np.random.default_rng(1).standard_normal(4000) + 50.0
    found = skill([row(float(outcome), 3.0 * NORMAL + 50.0) for outcome in outcomes])
    assert found.crps == pytest.approx(float(crps_gaussian(50.0, 3.0, outcomes).mean()), rel=0.005)
    assert found.coverage == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / outcomes.size))
    assert found.half_width == pytest.approx(3.0 * 1.6449, rel=1e-3)
    assert found.mae == pytest.approx(3.0 * np.sqrt(2 / np.pi), rel=0.05)


def test_every_machine_counts_the_same_however_long_its_trace() -> None:
    point = np.zeros(len(DENSE_LEVELS))
    found = skill([row(1.0, point)] * 3 + [row(5.0, point, machine="B")])
    assert (found.machines, found.forecasts) == (2, 4)
    assert (found.bias, found.mae, found.crps) == pytest.approx((-3.0, 3.0, 3.0))
    assert found.coverage == 0.0
    assert skill([]) is NO_SKILL


def test_why_a_horizon_has_no_figure_is_that_it_was_too_long_or_that_nothing_was_read() -> None:
    trace = Trace("a", np.arange(0.0, 4000.0, 10.0), {})
    made = [row(np.nan), row(1.0, horizon=300.0)]
    (unread,) = missing_horizons(trace, made, (60.0, 300.0))
    assert unread.startswith("a: no forecast for 60 s has an outcome: nothing was read")
    short, _ = missing_horizons(trace, made, (60.0, 300.0, 9000.0))
    assert short == "a: no forecast for 9000 s came due; it lasts 3990 s"


def test_methods_are_compared_only_at_the_moments_that_all_have() -> None:
    both, alone = row(0.0), row(0.0, origin=30.0)
    other = replace(both, method="other")
    assert common([both, alone, other]) == [both, other]
    assert common([]) == []
    apart = difference(
        [row(1.0, np.zeros(len(DENSE_LEVELS))), alone], [replace(other, outcome=1.0)], np.random.default_rng(0)
    )
    assert apart.n == 1
    assert apart.mean == pytest.approx(1.0 - float(crps_gaussian(0.0, 1.0, 1.0)), rel=0.01)


def test_the_tables_speak_by_horizon_machine_and_time_and_name_the_best_other_method() -> None:
    good, bad = np.zeros(len(DENSE_LEVELS)), np.full(len(DENSE_LEVELS), 4.0)
    rows = [
        row(1.0, law, method=method, machine=machine, origin=origin)
        for method, law in (("ours", good), ("near", good - 1.0), ("far", bad))
        for machine in ("A", "B")
        for origin in (0.0, 1800.0, 4000.0)
    ]
    found = tables(rows, ["ours"])
    assert [line["method"] for line in found["by horizon"]] == ["ours", "near", "far"]
    assert {(line["machine"], line["method"]) for line in found["by machine"]} == {
        (machine, method) for machine in "AB" for method in ("ours", "near", "far")
    }
    assert [line["since start"] for line in found["by time"] if line["method"] == "far"] == [
        "0-3 min",
        "later",
    ]
    (line,) = found["differences"]
    assert (line["best other"], line["machines"]) == ("near", 2)
    assert (line["ratio"], line["difference"]) == pytest.approx((0.5, -1.0))
    assert stretch(row(0.0, origin=1799.9)) == "10-30 min"


def test_the_ratio_to_the_best_other_method_has_an_interval_over_machines() -> None:
    rng = np.random.default_rng(2)
    rows = []
    for machine in "ABCDEF":
        for outcome in rng.standard_normal(40):
            origin = float(len(rows))
            for method, law in (("bins", 2.0 * NORMAL), ("right", NORMAL), ("shifted", NORMAL + 3.0)):
                rows.append(row(float(outcome), law, method=method, machine=machine, origin=origin))
    found = ratio(rows, "bins")
    assert found is not None and (found.best, found.machines) == ("right", 6)
    assert found.low < found.crps < found.high and found.low > 1.0
    assert (found.mae, found.width) == pytest.approx((1.0, 2.0))
    assert ratio([one for one in rows if one.method == "bins"], "bins") is None


def test_a_machine_that_stands_still_is_no_reason_to_say_nothing_of_the_others() -> None:
    still, off = np.zeros(len(DENSE_LEVELS)), np.full(len(DENSE_LEVELS), 1.0)
    rows = [
        row(0.0, law, method=method, machine=machine)
        for machine in "ABCDEF"
        for method, law in (("bins", off), ("lsha", still), ("persistence", still))
    ]
    found, exact = ratio(rows, "bins"), ratio(rows, "lsha")
    assert found is not None and (found.mae, found.crps) == (np.inf, np.inf) and np.isnan(found.low)
    assert exact is not None and (exact.mae, exact.crps) == (1.0, 1.0)


def test_persistence_is_the_last_reading_with_the_changes_so_far() -> None:
    times = np.arange(0.0, 1000.0, 10.0)
    ramp = 20.0 + 0.01 * times
    fan = persistence(times, ramp, [60.0, 5000.0], DENSE_LEVELS)
    assert fan is not None
    middle = DENSE_LEVELS.index(0.5)
    np.testing.assert_allclose(fan[middle], ramp[-1])
    np.testing.assert_allclose(fan[:middle, 0], ramp[-1] - 0.6, atol=1e-9)
    np.testing.assert_allclose(fan[middle + 1 :, 0], ramp[-1] + 0.6, atol=1e-9)
    # Half of the past is 495 s; the change over it grows with the root of the time, as a random walk's does.
    half = persistence(times, ramp, [495.0], DENSE_LEVELS)
    assert half is not None
    assert fan[-1, 1] - ramp[-1] == pytest.approx((half[-1, 0] - ramp[-1]) * np.sqrt(5000 / 495), rel=1e-6)
    assert persistence(times, np.full(times.shape, np.nan), [60.0], DENSE_LEVELS) is None
    single = persistence(times[:1], ramp[:1], [60.0], DENSE_LEVELS)
    assert single is not None and np.all(single == ramp[0])


def test_a_picture_is_drawn_also_of_a_trace_that_does_not_move(tmp_path: Path) -> None:
    still = np.zeros(len(DENSE_LEVELS))
    rows = [row(0.0, still, method=method) for method in ("ours", "persistence")]
    picture = draw_skill(
        {"still": rows, "moving": [row(1.0), row(1.0, method="persistence")]}, tmp_path / "a" / "s.png"
    )
    assert picture.stat().st_size > 10_000
    with pytest.raises(ValueError, match=r"s\.txt: cannot be a picture; give a name that ends in \.png"):
        draw_skill({}, tmp_path / "s.txt")
