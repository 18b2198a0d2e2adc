"""What a linear segment does to the state: its transition, its answer to a heat, and its noise, exactly.

A heat that varies inside a segment is taken as c0 + c1 v + c2 v^2, v from 0 at the start to 1 at the end, and the
answer to each of the three is exact whatever the segment's length.
"""

from dataclasses import dataclass
from math import factorial, inf

import numpy as np

from sim.engine.plant import Indices, Plant
from sim.sha import Array, Effect

_TAYLOR_TERMS = 14
"""Terms of the Taylor series, of matrices whose norm is at most 1/2: the remainder is below 1e-16."""

LENGTH_DIGITS = 6
"""Decimals of a length (s) by which segments count as alike where there are several states: clocks in absolute seconds
have no more, and equal segments are worked out once."""


@dataclass(frozen=True, slots=True)
class SegmentResponse:
    """For n segments of d states: `phi` (n, d, d), `poly` (n, d, q), `noise` (n, d, d).

    `poly` are the states (degC) that heats of 1, v and v^2 degC/s leave behind (q = 1 for the first alone), `noise` the
    covariance (degC^2) left by white heat of unit intensity, `disturbed` that left by what is new in the disturbance
    (None without one).
    """

    phi: Array
    poly: Array
    noise: Array
    disturbed: Array | None = None


def respond(plant: Plant, loss: Array, couplings: Array, dt: Array, powers: int) -> SegmentResponse:
    """The answers of segments with dX/dt = -`loss` X + (its `couplings` (n, 2)) + heat over `dt` seconds, each (n,)."""
    phi, poly = step_answer(plant, loss, couplings, dt, powers)
    if plant.size == 1:
        noise = dt * weights(2.0 * loss * dt, 1)[:, 0]
        return SegmentResponse(phi, poly, noise[:, None, None])
    keys, back = _unique_segments(loss, couplings, dt)
    noise = _noise(plant, keys, 0, 1.0)[back]
    if plant.disturbance is None:
        return SegmentResponse(phi, poly, noise)
    fresh = _noise(plant, keys, plant.heat_state, fresh_intensity(plant.disturbance))[back]
    return SegmentResponse(phi, poly, noise, fresh)


def fresh_intensity(disturbance: Effect) -> float:
    """The intensity of what is new in a disturbance (degC^2/s^3) at which its heat's variance stays sigma^2."""
    p = disturbance.params
    return float(2.0 * p["sigma"] ** 2 / p["memory"])


def step_answer(plant: Plant, loss: Array, couplings: Array, dt: Array, powers: int) -> tuple[Array, Array]:
    """(phi, poly) of the answers alone: a piece of a step needs no noise, and that is the dearer half."""
    if plant.size == 1:
        z = loss * dt
        return np.exp(-z)[:, None, None], (dt[:, None] * weights(z, powers))[:, None, :]
    keys, back = _unique_segments(loss, couplings, dt)
    phi, poly = _transition(plant, keys, powers)
    return phi[back], poly[back]


def _unique_segments(loss: Array, couplings: Array, dt: Array) -> tuple[Array, Indices]:
    """The different segments (loss, couplings, dt), each once, and which of them each segment is."""
    same = np.column_stack([loss, couplings, np.round(dt, LENGTH_DIGITS)])
    if len(same) == 1:  # pieces of a single run's step come one by one, and sorting them would cost more than they do
        return same, np.zeros(1, dtype=np.intp)
    keys, back = np.unique(same, axis=0, return_inverse=True)
    return keys, back.reshape(-1)


def weights(z: Array, powers: int) -> Array:
    """(n, powers) the integrals of exp(-z (1 - v)) v^j over v from 0 to 1, for z >= 0."""
    small = z < 0.5
    if small.all():
        return _series(z, powers)
    # The recursion subtracts numbers that are nearly equal for small z: there the series stands in.
    large = np.maximum(z, 0.5)
    value = -np.expm1(-large) / large
    columns = [value]
    for j in range(1, powers):
        value = (1.0 - j * value) / large
        columns.append(value)
    out = np.stack(columns, axis=1)
    if small.any():
        out[small] = _series(z[small], powers)
    return out


_COEFFICIENTS = np.array(
    [[(-1.0) ** i * factorial(j) / factorial(j + 1 + i) for j in range(3)] for i in range(_TAYLOR_TERMS + 1)]
)


def _series(z: Array, powers: int) -> Array:
    """The sums over i of (-z)^i j! / (j + 1 + i)!, for z < 1/2."""
    return np.asarray(np.vander(z, _TAYLOR_TERMS + 1, increasing=True) @ _COEFFICIENTS[:, :powers])


def drift_matrix(plant: Plant, loss: Array, couplings: Array) -> Array:
    """(n, d, d) the matrix A of ds/dt = A s, the couplings (n, 2) being those to the housing and to the offset."""
    d = plant.size
    a = np.zeros((loss.size, d, d))
    a[:, 0, 0] = -loss
    before = 0
    if plant.housing_tau < inf:
        a[:, 0, 0] -= couplings[:, 0]
        a[:, 0, 1] = couplings[:, 0]
        a[:, 1, 0], a[:, 1, 1] = 1.0 / plant.housing_tau, -1.0 / plant.housing_tau
    if plant.disturbance is not None:
        heat = plant.heat_state
        a[:, 0, heat], a[:, heat, heat] = 1.0, -1.0 / plant.disturbance.params["memory"]
    if plant.machine is not None:
        a[:, 0, plant.offset_state] = couplings[:, 1]
    for place in range(d - plant.lags, d):
        a[:, place, before], a[:, place, place] = plant.lag_rate, -plant.lag_rate
        before = place
    return a


def _transition(plant: Plant, keys: Array, powers: int) -> tuple[Array, Array]:
    """(phi, poly) from one exponential: the heat and its derivatives by v are states of their own (Van Loan 1978).

    The exponential is Taylor's series of the matrix halved until its norm is at most 1/2, squared back (scaling and
    squaring: Moler and Van Loan 2003, method 3).
    """
    loss, dt = keys[:, 0], keys[:, -1]
    d = plant.size
    a = np.zeros((len(keys), d + powers, d + powers))
    a[:, :d, :d] = drift_matrix(plant, loss, keys[:, 1:-1]) * dt[:, None, None]
    a[:, 0, d] = dt
    for j in range(1, powers):
        a[:, d + j - 1, d + j] = 1.0
    halvings = _halvings(a)
    a *= np.exp2(-halvings)[:, None, None]
    total = term = np.broadcast_to(np.eye(d + powers), a.shape)
    for i in range(1, _TAYLOR_TERMS + 1):
        term = a @ term / i
        total = total + term
    for i in range(int(halvings.max(initial=0))):
        on = halvings > i
        total[on] = total[on] @ total[on]
    # The chain of derivatives integrates to v^j / j!: the heat of v^2 is twice what its column says.
    poly = total[:, :d, d:] * np.array([1.0, 1.0, 2.0])[:powers]
    return total[:, :d, :d], poly


def _noise(plant: Plant, keys: Array, state: int, intensity: float) -> Array:
    """The covariance left by white noise in one state, by its own Taylor series over a short piece, doubled.

    C(2h) = C(h) + phi(h) C(h) phi(h)^T.
    """
    loss, dt = keys[:, 0], keys[:, -1]
    a = drift_matrix(plant, loss, keys[:, 1:-1]) * dt[:, None, None]
    halvings = _halvings(2.0 * a)
    scale = np.exp2(-halvings)
    a *= scale[:, None, None]
    term = np.zeros_like(a)
    term[:, state, state] = intensity * dt * scale
    total, phi, power = term.copy(), np.broadcast_to(np.eye(plant.size), a.shape), np.eye(plant.size)
    for i in range(1, 2 * _TAYLOR_TERMS + 1):
        drifted = a @ term
        term = (drifted + drifted.transpose(0, 2, 1)) / (i + 1)
        total += term
        power = a @ power / i
        phi = phi + power
    for i in range(int(halvings.max(initial=0))):
        on = halvings > i
        total[on] += phi[on] @ total[on] @ phi[on].transpose(0, 2, 1)
        phi[on] = phi[on] @ phi[on]
    return np.asarray(total)


def _halvings(a: Array) -> Array:
    """(n,) how often each matrix must be halved until its norm is at most 1/2."""
    norm: Array = np.abs(a).sum(axis=2).max(axis=1, initial=0.0)
    return np.asarray(np.maximum(np.ceil(np.log2(np.maximum(norm, 1e-300) * 2.0)), 0.0))
