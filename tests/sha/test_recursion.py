"""linear_recursion against the plain loop, at every extreme that decays can reach."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.engine.recursion import linear_recursion, matrix_recursion
from sim.sha.trace import Array


def plain(a: Array, b: Array, x0: float) -> Array:
    x, out = x0, []
    for factor, term in zip(a.tolist(), b.tolist(), strict=True):
        x = factor * x + term
        out.append(x)
    return np.array(out)


@given(
    st.lists(st.tuples(st.floats(0, 1), st.floats(-1e3, 1e3)), min_size=0, max_size=60),
    st.floats(-1e3, 1e3),
)
@settings(max_examples=100, deadline=None)
def test_it_is_the_plain_loop(steps: list[tuple[float, float]], x0: float) -> None:
    a, b = np.array([s[0] for s in steps]), np.array([s[1] for s in steps])
    np.testing.assert_allclose(linear_recursion(a, b, x0), plain(a, b, x0), rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("rate", [1e-9, 1e-2, 30.0, 800.0], ids=["hardly decays", "usual", "k dt large", "underflows"])
def test_a_million_rows_neither_lose_nor_blow_up(rate: float) -> None:
    rng = np.random.default_rng(1)
    a = np.exp(-rate * rng.random(1_000_000))
    b = (1.0 - a) * rng.normal(60.0, 5.0, a.size)
    np.testing.assert_allclose(linear_recursion(a, b, 20.0), plain(a, b, 20.0), rtol=1e-11)


def test_decays_of_zero_and_one_and_beyond_are_taken_as_they_are() -> None:
    a = np.array([0.0, 1.0, 2.0, -0.5, 0.0, 1e-300, 5e-324])
    b = np.arange(7.0)
    np.testing.assert_array_equal(linear_recursion(a, b, 1e9), plain(a, b, 1e9))


def test_the_columns_of_a_batch_are_independent_recursions() -> None:
    rng = np.random.default_rng(2)
    a, b, x0 = rng.random((500, 3)), rng.normal(size=(500, 3)), np.array([1.0, 20.0, -5.0])
    batch = linear_recursion(a, b, x0)
    assert batch.shape == (500, 3)
    for p in range(3):
        np.testing.assert_allclose(batch[:, p], plain(a[:, p], b[:, p], x0[p]), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rows", [1, 256, 257, 600])
def test_a_loop_and_a_banded_system_are_one_recursion(rows: int) -> None:
    rng = np.random.default_rng(rows)
    phi, b, x0 = 0.4 * rng.random((rows, 3, 3)), rng.normal(size=(rows, 3)), np.array([1.0, 20.0, -5.0])
    expected, x = np.empty((rows, 3)), x0
    for row in range(rows):
        expected[row] = x = phi[row] @ x + b[row]
    np.testing.assert_allclose(matrix_recursion(phi, b, x0), expected, rtol=1e-12, atol=1e-12)
    line = plain(phi[:, 0, 0], b[:, 0], 1.0)
    np.testing.assert_array_equal(linear_recursion(phi[:, 0, 0], b[:, 0], 1.0, loop=True), line)
    np.testing.assert_allclose(linear_recursion(phi[:, 0, 0], b[:, 0], 1.0), line, rtol=1e-12, atol=1e-12)


def test_coefficients_broadcast_over_the_batch() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.random(50), rng.normal(size=(50, 4))
    np.testing.assert_array_equal(linear_recursion(a[:, None], b, 2.0)[:, 1], linear_recursion(a, b[:, 1], 2.0))


def test_arguments_are_left_alone_and_no_rows_give_no_rows() -> None:
    a, b = np.full(4, 0.5), np.ones(4)
    linear_recursion(a, b, 3.0)
    assert a.tolist() == [0.5] * 4
    assert b.tolist() == [1.0] * 4
    assert linear_recursion([], [], 1.0).shape == (0,)
    assert linear_recursion(np.empty((0, 3)), 0.0, 1.0).shape == (0, 3)


@pytest.mark.parametrize(
    ("a", "b", "x0"),
    [
        (np.ones((2, 2, 2)), 0.0, 0.0),
        (1.0, 1.0, 0.0),
        (np.ones(3), np.ones(4), 0.0),
        (np.ones(3), np.ones(3), np.ones(3)),
        (np.ones((3, 2)), np.ones((3, 2)), np.ones(3)),
    ],
)
def test_other_shapes_are_refused(a: Array, b: Array, x0: Array) -> None:
    with pytest.raises(ValueError, match=r"shape|broadcast"):
        linear_recursion(a, b, x0)
