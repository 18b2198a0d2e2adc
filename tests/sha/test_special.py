"""The special functions of the running gateway against scipy's, and against what defines them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import special as reference
from scipy import stats

from sim.special import beta_quantile, chi_square_tail, log_normal_cdf, normal_quantile_of_log


def test_the_normal_tails_logarithm_is_scipys() -> None:
    z = np.concatenate([np.linspace(-40.0, 8.0, 48_001), -np.logspace(1.0, 7.0, 601), [0.0, -np.inf, np.inf]])
    assert_allclose(log_normal_cdf(z), reference.log_ndtr(z), rtol=1e-12, atol=1e-190)


def test_the_normal_quantile_of_a_logarithm_is_scipys() -> None:
    s = np.concatenate(
        [-np.logspace(-16.0, 12.0, 28_001), np.log(np.linspace(1e-6, 1.0 - 1e-6, 10_001)), [0.0, -np.inf]]
    )
    assert_allclose(normal_quantile_of_log(s), reference.ndtri_exp(s), rtol=1e-12, atol=1e-12)


@given(st.floats(-1e6, 8.0))
def test_the_quantile_is_the_inverse_of_the_tail(z: float) -> None:
    # Above 0 the tail's logarithm is -P(Z > z), whose last digits are the coarser the nearer it is to 0.
    assert float(normal_quantile_of_log(log_normal_cdf(z))) == pytest.approx(z, rel=1e-11, abs=1e-11)


def test_they_take_any_shape() -> None:
    for shape in ((), (3,), (2, 3), (0,)):
        values = np.full(shape, -1.5)
        assert log_normal_cdf(values).shape == normal_quantile_of_log(values).shape == shape


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 5, 20, 21, 60, 61, 500, 1001])
def test_the_chi_square_tail_is_scipys(degrees: int) -> None:
    squares = np.concatenate(
        [[0.0, 1e-300, 1e-9], np.logspace(-6.0, 3.0, 91), degrees * np.linspace(0.5, 2.0, 31), [np.inf]]
    )
    # scipy's own sum is exact to some 1e-12 in the far tail.
    expected = stats.chi2.sf(squares, degrees)
    assert_allclose([chi_square_tail(each, degrees) for each in squares.tolist()], expected, rtol=5e-12, atol=1e-290)


@pytest.mark.parametrize("runs", [1, 2, 5, 20, 256, 1000, 100_000, 1_000_000])
@pytest.mark.parametrize("tail", [0.005, 0.025, 0.45])
def test_the_beta_quantile_is_scipys(runs: int, tail: float) -> None:
    parts = np.array([1e-9, 1e-6, 1e-3, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0 - 1e-6])
    successes = np.concatenate([parts * runs, parts, np.arange(1, min(runs, 30))])
    for a in successes[(successes > 0) & (successes < runs)].tolist():
        for first, second in ((a, runs - a + 1.0), (runs - a, a + 1.0)):
            expected = float(reference.betaincinv(first, second, tail))
            assert beta_quantile(first, second, tail) == pytest.approx(expected, rel=1e-10, abs=1e-16)


def test_a_beta_quantile_has_its_probability() -> None:
    for a, b in ((0.3, 256.7), (12.5, 244.5), (250.0, 7.0), (1.0, 1.0), (3.0, 1.0)):
        for p in (1e-6, 0.025, 0.5):
            assert float(reference.betainc(a, b, beta_quantile(a, b, p))) == pytest.approx(p, rel=1e-10)
