"""Rivals with known answers: constant, linear, AR(1) and driven temperatures; and nothing of the future is used."""

import warnings
from dataclasses import replace
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest

from sim.lab.judge.direct_rivals import feature_table
from sim.lab.judge.past import interpolate_temperature
from sim.lab.judge.rivals import FittedRival, Past, Persistence, Rival, rivals
from sim.lab.judge.univariate_rivals import Univariate

HORIZONS = (60.0, 300.0)
LEVELS = (0.05, 0.5, 0.95)
UNIVARIATE = ("damped trend", "AutoETS", "AutoARIMA", "AutoTheta")
ALL = ("persistence", *UNIVARIATE, "ARX, direct", "boosted trees")


def rival(name: str) -> Rival:
    if name in UNIVARIATE and find_spec("statsmodels") is None:
        pytest.skip("the extra `bench` (statsmodels) is not installed")
    found = {each.name: each for each in rivals(seed=0)}[name]
    return replace(found, origins=6) if isinstance(found, Univariate) else found


def past(temperature: np.ndarray, every: float = 5.0, **inputs: np.ndarray) -> Past:
    return Past(np.arange(temperature.size) * every, temperature, inputs)


def driven(seed: int, rows: int = 540) -> Past:
    """First order with a time constant of 200 s under a load that switches at random, 5 s rows."""
    rng = np.random.default_rng(seed)
    load = np.repeat(rng.choice([0.0, 10.0, 20.0], rows // 60), 60)
    temperature = np.empty(rows)
    now = 30.0
    for row in range(rows):
        now += 5.0 / 200.0 * (30.0 + 2.0 * load[row] - now) + rng.normal(0.0, 0.02)
        temperature[row] = now
    return past(temperature, Load=load)


@cache
def fitted_on_driven(name: str) -> FittedRival:
    return rival(name).fit([driven(1), driven(2)], HORIZONS)


def errors(fitted: FittedRival, machine: Past) -> np.ndarray:
    """(H,) mean absolute errors of the median at an origin each 100 s."""
    found = []
    for origin in np.arange(400.0, machine.times[-1] - max(HORIZONS), 100.0):
        quantiles = fitted.forecast(machine.truncate(origin), HORIZONS, LEVELS)
        found.append(
            np.abs(
                quantiles[1] - interpolate_temperature(machine.times, machine.temperature, origin + np.array(HORIZONS))
            )
        )
    return np.asarray(np.mean(found, axis=0))


@pytest.mark.parametrize("name", ALL)
def test_a_constant_temperature_stays(name: str) -> None:
    fitted = rival(name).fit([past(np.full(400, 50.0)), past(np.full(400, 70.0))], HORIZONS)
    quantiles = fitted.forecast(past(np.full(300, 60.0)), HORIZONS, LEVELS)
    assert quantiles.shape == (3, 2)
    assert quantiles == pytest.approx(60.0, abs=0.3)
    assert np.all(np.diff(quantiles, axis=0) >= 0)


@pytest.mark.parametrize("name", ALL)
def test_nothing_after_the_origin_is_used(name: str) -> None:
    fitted = fitted_on_driven(name)
    machine = driven(3)
    spoiled = Past(machine.times.copy(), machine.temperature.copy(), {"Load": machine.inputs["Load"].copy()})
    later = spoiled.times > 2000.0
    spoiled.temperature[later] = 1e6
    spoiled.inputs["Load"][later] = np.nan
    expected = fitted.forecast(machine.truncate(2000.0), HORIZONS, LEVELS)
    assert np.array_equal(fitted.forecast(spoiled.truncate(2000.0), HORIZONS, LEVELS), expected)


@pytest.mark.parametrize("name", ALL)
def test_a_past_without_a_reading_gives_no_forecast_and_no_warning(name: str) -> None:
    fitted = fitted_on_driven(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.all(np.isnan(fitted.forecast(past(np.full(10, np.nan)), HORIZONS, LEVELS)))
        assert np.all(np.isfinite(fitted.forecast(past(np.array([50.0])), HORIZONS, LEVELS)))


@pytest.mark.parametrize("name", ["damped trend", "AutoETS", "AutoARIMA", "ARX, direct"])
def test_a_linear_trend_goes_on(name: str) -> None:
    rng = np.random.default_rng(0)
    ramps = [past(20.0 + 0.02 * 5.0 * np.arange(400) + rng.normal(0.0, 0.01, 400)) for _ in range(3)]
    quantiles = rival(name).fit(ramps[:2], HORIZONS).forecast(ramps[2].truncate(1200.0), HORIZONS, LEVELS)
    assert quantiles[1, 0] == pytest.approx(44.0 + 0.02 * 60.0, abs=0.2)


def test_arima_and_regression_find_how_fast_an_ar1_returns() -> None:
    def machine(seed: int) -> Past:
        rng = np.random.default_rng(seed)
        away = np.zeros(1000)
        for row in range(1, 1000):
            away[row] = 0.8 * away[row - 1] + rng.normal(0.0, 0.3)
        return past(50.0 + away, every=10.0)

    jumped = machine(3)
    jumped.temperature[-1] = 54.0
    for name in ("ARX, direct", "AutoARIMA"):
        median = rival(name).fit([machine(1), machine(2)], HORIZONS).forecast(jumped, HORIZONS, LEVELS)[1]
        assert median == pytest.approx(50.0 + 4.0 * 0.8 ** (np.array(HORIZONS) / 10.0), abs=0.8)


@pytest.mark.parametrize("name", ["ARX, direct", "boosted trees"])
def test_who_sees_the_load_beats_persistence_on_a_driven_machine(name: str) -> None:
    machine = driven(3)
    # Over 60 s; over 300 s the load has changed, which nobody can know.
    assert errors(fitted_on_driven(name), machine)[0] < 0.8 * errors(fitted_on_driven("persistence"), machine)[0]


def test_the_band_of_persistence_holds_the_share_that_it_says() -> None:
    def walk(seed: int) -> Past:
        return past(50.0 + np.cumsum(np.random.default_rng(seed).normal(0.0, 0.1, 3000)))

    fitted, machine = Persistence().fit([walk(1), walk(2)], HORIZONS), walk(3)
    inside = []
    for origin in np.arange(2000.0, machine.times[-1] - 60.0, 60.0):
        low, median, high = fitted.forecast(machine.truncate(origin), (60.0,), LEVELS)[:, 0]
        assert median == pytest.approx(machine.truncate(origin).temperature[-1])
        inside.append(
            low <= interpolate_temperature(machine.times, machine.temperature, np.array([origin + 60.0]))[0] <= high
        )
    assert np.mean(inside) == pytest.approx(0.9, abs=0.06)


def test_a_feature_knows_no_later_row_and_no_later_one_is_needed() -> None:
    machine = driven(4)
    origins = np.array([300.0, 1500.0, 2500.0])
    whole = feature_table(machine, origins, ("Load", "Absent"))
    for row, origin in enumerate(origins):
        alone = feature_table(machine.truncate(origin), origins[row : row + 1], ("Load", "Absent"))
        assert alone[0] == pytest.approx(whole[row], nan_ok=True)
    assert whole[1, 0] == pytest.approx(machine.temperature[300])
    assert np.all(np.isnan(whole[:, -3:]))


def test_what_cannot_be_is_said_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="was asked for"):
        Persistence().fit([driven(1)], (60.0,)).forecast(driven(1), (90.0,), LEVELS)
    with pytest.raises(ValueError, match="longer than the horizon of 300 s"):
        rival("ARX, direct").fit([past(np.full(20, 50.0))], (300.0,))
    with pytest.raises(ValueError, match="shape"):
        Past(np.arange(3.0), np.zeros(2), {})
    monkeypatch.setattr("sim.lab.judge.univariate_rivals.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"decanter-gateway\[bench\]"):
        Univariate("AutoETS", "auto_ets").fit([driven(1)], HORIZONS)
