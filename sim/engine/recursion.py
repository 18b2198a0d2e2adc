"""The recursion x[k] = a[k] * x[k-1] + b[k], over millions of steps at compiled speed."""

import numpy as np
from numpy.typing import ArrayLike

from sim.sha import Array


def linear_recursion(a: ArrayLike, b: ArrayLike, x0: ArrayLike, *, loop: bool = False) -> Array:
    """x[k] = a[k] * x[k-1] + b[k] for k = 0..n-1, where x[-1] is `x0`.

    `a` and `b` have the shape (n,) or (n, p) and broadcast against each other; p is a batch of independent recursions
    (a parameter and its perturbations, say). `x0` is a number or (p,). Returns x with the broadcast shape, (n,) or
    (n, p). Raises ValueError on other shapes.

    It is the forward substitution of a unit lower bidiagonal system (LAPACK's dtbtrs), or with `loop`, for (n,) only, a
    loop over floats, which may differ in the last digit. The operations are those of the plain loop, in its order, and
    no product of many factors is formed: decays of exactly 0, or a million factors far below 1, lose nothing.
    """
    factors, terms = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    if factors.ndim not in (1, 2):
        raise ValueError(f"a linear recursion takes coefficients of shape (n,) or (n, p), got {factors.shape}")
    starts = np.asarray(x0, dtype=float)
    if starts.ndim and starts.shape != factors.shape[1:]:
        raise ValueError(f"x0 must be a number or have the shape {factors.shape[1:]}, got {starts.shape}")
    if factors.ndim == 1:
        return _loop(factors, terms, float(starts)) if loop else _solve(factors, terms, float(starts))
    if factors.size and factors.strides[1] == 0:
        return _solve(factors[:, 0], terms, starts)  # one system, many right sides
    batch = np.empty(factors.shape, order="F")
    for column, start in enumerate(np.broadcast_to(starts, factors.shape[1:]).tolist()):
        batch[:, column] = _solve(factors[:, column], terms[:, column], start)
    return batch


def matrix_recursion(phi: Array, b: Array, x0: Array) -> Array:
    """x[k] = phi[k] @ x[k-1] + b[k] for k = 0..n-1, where x[-1] is `x0` (d,).

    `phi` is (n, d, d), `b` (n, d); returns x (n, d). A short one is a loop, a longer one the same forward substitution,
    of a banded system, in pieces so that its bands (2 d numbers an unknown) stay small.
    """
    n, d = b.shape
    x = np.empty((n, d))
    if n <= MAX_LOOP_STEPS:
        for row in range(n):
            x[row] = x0 = phi[row] @ x0 + b[row]
        return x
    if d == 1:
        return linear_recursion(phi[:, 0, 0], b[:, 0], float(x0[0]))[:, None]
    from scipy.linalg.lapack import dtbtrs

    piece = max(_PIECE_STEPS // (2 * d * d), 1)
    for first in range(0, n, piece):
        factors, right = phi[first : first + piece], b[first : first + piece].copy()
        count = len(right)
        # Unknown (k, j) is column k d + j. Its factor in the equation of (k + 1, i) lies d + i - j below the diagonal,
        # which LAPACK's lower band form stores in row d + i - j, at the unknown's own column.
        bands = np.zeros((2 * d, count * d), order="F")
        bands[0] = 1.0
        for i in range(d):
            for j in range(d):
                bands[d + i - j, j : (count - 1) * d : d] = -factors[1:, i, j]
        right[0] += factors[0] @ x0
        solution, _ = dtbtrs(bands, right.reshape(-1), uplo="L", diag="U")
        x[first : first + piece] = np.asarray(solution, dtype=float).reshape(count, d)
        x0 = x[first + count - 1]
    return x


_PIECE_STEPS = 1 << 18
MAX_LOOP_STEPS = 256
"""Steps of a recursion that is a loop where a running gateway asks for it: in the check of a model at its start, and in
beliefs under effects. So it does without scipy, whose linear algebra is loaded for longer ones."""


def _loop(a: Array, b: Array, x0: float) -> Array:
    x, value = np.empty(b.shape), x0
    for row, (factor, term) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        x[row] = value = factor * value + term
    return x


def _solve(a: Array, b: Array, x0: Array | float) -> Array:
    """x of the shape of `b`, (n,) or (n, p), by the factors `a` (n,), after `x0`."""
    if b.size == 0:
        return np.empty(b.shape)
    from scipy.linalg.lapack import dtbtrs

    bands = np.ones((2, a.size), order="F")
    np.negative(a[1:], out=bands[1, :-1])
    right = np.array(b, dtype=float, order="F")
    right[0] += a[0] * x0
    solution, _ = dtbtrs(bands, right, uplo="L", diag="U", overwrite_b=True)
    return np.asarray(solution, dtype=float).reshape(b.shape, order="F")
