"""What the nuisance benchmark counts: announcements of a whole gateway, over stops and starts, by each level."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.nuisance import AT_FLOOR, Source, rate_interval, watch, write_plant
from sim.anomaly import AnomalyRecord
from sim.lab.formats import write_model_directory
from sim.lab.recordings import load_map
from sim.sha import Trace
from tests.gateway.support import CURRENT, ROOT, RUNNING, TEMPERATURE, two_modes

ROW_S, ROWS, STEP_S = 20.0, 540, 2 * 3600.0


def at_rest(step: float) -> Trace:
    """Three hours at rest, after two of which the readings are off by `step` degC from one row to the next."""
    rng, times = np.random.default_rng(0), ROW_S * np.arange(ROWS)
    reading = 20.0 + rng.normal(0.0, 0.05, ROWS) + step * (times >= STEP_S)
    return Trace("rest", times, {RUNNING: np.zeros(ROWS), CURRENT: np.zeros(ROWS), TEMPERATURE: reading})


@pytest.mark.parametrize(("level", "own", "speed"), [(12.0, 1, 1.0), (60.0, 0, 60.0)])
def test_what_was_announced_is_counted_once_and_what_would_have_been_at_the_floor(
    level: float, own: int, speed: float, tmp_path: Path
) -> None:
    record = AnomalyRecord(seconds=86_400.0, units=3, peaks=(), level=level)
    write_model_directory(tmp_path / "model", replace(two_modes(), anomalies=record))
    column_map = load_map(ROOT / "config/traces/decanter.toml")
    plant = write_plant(tmp_path, Source(column_map=column_map, taught=[at_rest(0.0)], ordinary=[]))
    found, seconds = watch(plant, [at_rest(1.0)], speed=speed, seed=1)
    kinds = Counter(each.kind for each in found)
    assert (kinds["anomaly"], kinds[AT_FLOOR]) == (own, 1)
    (at_floor,) = (each.after for each in found if each.kind == AT_FLOOR)
    assert STEP_S <= at_floor < STEP_S + 600.0 and 2 * 3600.0 < seconds <= 3 * 3600.0


def test_the_interval_of_a_rate_is_that_of_a_count() -> None:
    assert rate_interval(0, 2.0) == (0.0, pytest.approx(3.689 / 2.0, abs=1e-3))
    assert rate_interval(3, 1.0) == pytest.approx((0.619, 8.767), abs=1e-3)
