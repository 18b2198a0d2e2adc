"""What a twin bearing tells of a bad sensor: learned from changes of both, right where they warm alike, honest else."""

import json

import numpy as np
import pytest

from gateway.machine.model.twin import LAGS, TwinBearing, TwinEstimate, combine
from gateway.machine.model.virtual_sensor import LOOK_BACK_SECONDS

TWIN = "TCuscinettiAlimentazione"
STEP = 30.0


def pair(hours: float, seed: int, *, slope: float = 1.2, apart: float = 0.004) -> tuple[np.ndarray, ...]:
    """(times, own, twin): a bearing that warms `slope` times as much as its twin, but for a random walk."""
    rng, rows = np.random.default_rng(seed), int(hours * 3600.0 / STEP)
    times = STEP * np.arange(rows)
    other = 45.0 + 12.0 * np.sin(times / 3000.0) + 5.0 * np.sin(times / 800.0 + seed)
    walk = np.cumsum(apart * np.sqrt(STEP) * rng.standard_normal(rows))
    noise = 0.05 * rng.standard_normal((2, rows))
    return times, 5.0 + slope * other + walk + noise[0], other + noise[1]


def taught(hours: float = 200.0, *, slope: float = 1.2, apart: float = 0.004) -> TwinBearing:
    twin = TwinBearing(TWIN)
    for time, own, other in zip(*(column.tolist() for column in pair(hours, 0, slope=slope, apart=apart)), strict=True):
        twin.take(time, own, other)
    return twin


def test_a_twin_tells_the_temperature_with_a_band_that_holds_and_grows() -> None:
    times, own, other = pair(400.0, 7)
    twin, hits, sigmas, late = TwinBearing(TWIN), list[bool](), dict[float, list[float]](), 7200.0
    for row, time in enumerate(times.tolist()):
        twin.take(time, own[row], other[row])
        if time < 200.0 * 3600.0 or row % 120 or time + late > times[-1]:
            continue
        for after in (300.0, late):
            then = row + int(after / STEP)
            told = twin.estimate(float(times[then]), time, float(other[then]))
            assert told is not None
            hits.append(abs(told.mean - own[then]) <= 1.645 * told.sigma)
            sigmas.setdefault(after, []).append(told.sigma)
    assert len(hits) > 200 and 0.8 <= np.mean(hits) <= 0.99
    assert np.mean(sigmas[late]) > 2.0 * np.mean(sigmas[300.0])
    # The walk alone is 0.004 sqrt(7200) = 0.34 degC by then.
    assert 0.25 < np.mean(sigmas[late]) < 0.55


def test_nothing_is_told_before_enough_is_learned_nor_without_a_reading_of_both() -> None:
    assert taught(0.5).estimate(1800.0, 1740.0, 45.0) is None
    twin = taught()
    last = 200.0 * 3600.0 - STEP
    assert twin.estimate(last + 300.0, last, None) is None
    assert twin.estimate(last + 300.0, last - 5.0 * 86_400.0, 45.0) is None, "nobody knows what was read then"
    assert twin.estimate(last + 300.0, last, 45.0) is not None


def test_beyond_the_longest_lag_the_band_goes_on_growing() -> None:
    twin = taught()
    last = 200.0 * 3600.0 - STEP
    at, beyond = (twin.estimate(last + hours * LAGS[-1], last, 45.0) for hours in (1.0, 4.0))
    assert at is not None and beyond is not None
    assert beyond.sigma == pytest.approx(2.0 * at.sigma, rel=0.05)


def test_what_a_sensor_showed_that_was_found_out_has_taught_nothing() -> None:
    honest, fooled = taught(), taught()
    last = 200.0 * 3600.0 - STEP
    for step in range(1, int(0.9 * LOOK_BACK_SECONDS / STEP)):
        fooled.take(last + step * STEP, 99.0, 45.0 + 0.1 * step)
    fooled.forget_readings(last + STEP)
    now = last + 1800.0
    before, after = honest.estimate(now, last, 50.0), fooled.estimate(now, last, 50.0)
    assert before is not None and after is not None
    assert after.mean == pytest.approx(before.mean, abs=0.01) and after.sigma == pytest.approx(before.sigma, rel=0.02)


def test_what_was_learned_goes_on_after_a_restart_and_is_refused_where_it_makes_no_sense() -> None:
    twin, again = taught(), TwinBearing(TWIN)
    again.restore(json.loads(json.dumps(twin.to_plain())))
    last = 200.0 * 3600.0 - STEP
    again.take(last, 60.0, 45.0)
    told, kept = again.estimate(last + 600.0, last, 46.0), twin.estimate(last + 600.0, last, 46.0)
    assert told is not None and kept is not None and told.sigma == pytest.approx(kept.sigma, rel=0.05)
    other = TwinBearing("another")
    other.restore(twin.to_plain())
    other.take(last, 60.0, 45.0)
    assert other.estimate(last + 60.0, last, 45.0) is None, "it was learned of another bearing"
    with pytest.raises(ValueError, match="cannot be used"):
        again.restore(twin.to_plain() | {"sums": [[1.0, 2.0]]})


def test_two_opinions_make_a_narrower_band_unless_they_contradict_each_other() -> None:
    agreed = combine(50.0, 2.0, TwinEstimate(50.5, 0.5))
    assert agreed.sigma < 0.5 and 50.4 < agreed.mean < 50.5
    apart = combine(50.0, 2.0, TwinEstimate(70.0, 0.5))
    assert apart.sigma > 4.0 and 68.0 < apart.mean < 70.0
