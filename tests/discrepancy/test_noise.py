"""The likelihood of a rough plant's residuals against brute force, and its draws against its own covariance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from sim.engine.recursion import linear_recursion
from sim.lab.discrepancy.fitting.noise import (
    DIFFUSE_VARIANCE,
    Derivatives,
    Grid,
    NoiseModel,
    Whitener,
    WindowBelief,
    decay_and_pull,
    fit_noise,
    noise_model,
    vector,
)
from sim.lab.learning.runs import Indices
from sim.sha.trace import Array, Mask

NOISE = NoiseModel(sensor=0.05, process=0.004, rough=0.002, cycle=0.3, memory=500.0, rest=0.4, still=0.3)
LASTING = replace(NOISE, lasting=0.2, fades=80.0)
"""The same with an error of the reading that lasts for a step or two."""
REST = 5
"""The place of the share at rest in `vector`."""


def small_grid(seed: int = 1, size: int = 40) -> Grid:
    rng = np.random.default_rng(seed)
    first = np.zeros(size, dtype=bool)
    first[[0, size // 2]] = True
    running = rng.integers(0, 2, size).astype(float)
    return grid_of(
        rng.uniform(20.0, 200.0, size), np.where(rng.random(size) < 0.2, 0.0, 1e-3), running, 1e-3 * running, first,
        np.cumsum(rng.random(size) < 0.1),
    )  # fmt: skip


def grid_of(dt: Array, k: Array, running: Array, weight: Array, first: Mask, cycle: Indices) -> Grid:
    """A grid whose cycles' heats `weight` (m,) degC/s are held over each step."""
    decay, pull = decay_and_pull(k, dt)
    decay, push = np.where(first, 0.0, decay), np.where(first, 0.0, pull * weight)
    columns = [linear_recursion(decay, np.where(cycle == number, push, 0.0), 0.0) for number in np.unique(cycle)]
    late = 0.01 * np.where(first, 0.0, np.diff(running, prepend=running[0]) ** 2)
    return Grid(
        dt=dt,
        k=k,
        running=running,
        first=first,
        cycle=cycle,
        heats=np.asfortranarray(np.column_stack(columns)),
        late=late,
        shared=linear_recursion(decay, 0.05 * np.sqrt(late), 0.0),
        inrush=linear_recursion(decay, np.where(first, 0.0, 0.3 * (np.arange(first.size) % 7 == 3)), 0.0),
    )


def dense_states(grid: Grid, noise: NoiseModel) -> Array:
    """The covariance of (x, h) of all windows: the stated equation's steps, by matrix exponentials (Van Loan 1978)."""
    size = grid.dt.size
    state = np.zeros((2 * size, 2 * size))
    for row in range(size):
        here = slice(2 * row, 2 * row + 2)
        if grid.first[row]:
            state[here, here] = np.diag([DIFFUSE_VARIANCE, noise.rough**2])
            continue
        share = noise.rest + (1 - noise.rest) * grid.running[row]
        drift = np.array([[-grid.k[row], share], [0.0, -1.0 / noise.memory]])
        process = noise.process**2 * (grid.running[row] + (1 - grid.running[row]) * noise.still**2)
        white = np.diag([process, 2.0 * noise.rough**2 / noise.memory])
        both = expm(np.block([[-drift, white], [np.zeros((2, 2)), drift.T]]) * grid.dt[row])
        move = both[2:, 2:].T
        before = slice(2 * row - 2, 2 * row)
        state[here, :] = move @ state[before, :]
        state[:, here] = state[here, :].T
        state[here, here] = move @ state[before, before] @ move.T + move @ both[:2, 2:] + np.diag([grid.late[row], 0.0])
    return state


def dense(grid: Grid, noise: NoiseModel) -> Array:
    """V from the covariance of the states, the columns of the cycles, and the reading's errors."""
    state, size = dense_states(grid, noise), grid.dt.size
    heats = np.column_stack([grid.heats * noise.cycle, grid.shared, grid.inrush])
    time, run = np.cumsum(np.where(grid.first, 0.0, grid.dt)), np.cumsum(grid.first)
    fades = np.exp(-np.abs(time[:, None] - time) / noise.fades) * (run[:, None] == run)
    error = noise.sensor**2 * np.eye(size) + noise.lasting**2 * fades
    return np.asarray(state[::2, ::2] + heats @ heats.T + error)


@pytest.mark.parametrize("noise", [NOISE, LASTING])
@pytest.mark.parametrize("size", [40, 700], ids=["few", "windows by pieces"])
def test_weighing_and_determinant_are_those_of_the_dense_covariance(noise: NoiseModel, size: int) -> None:
    grid = small_grid(size=size)
    covariance = dense(grid, noise)
    columns = np.random.default_rng(0).standard_normal((grid.dt.size, 3))
    whitener = Whitener(grid, noise)
    weighed = np.linalg.solve(covariance, columns)
    np.testing.assert_allclose(whitener.weigh(columns), weighed, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(whitener.gram(columns), columns.T @ weighed, rtol=1e-6, atol=1e-9)
    assert whitener.logdet == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-6)


@pytest.mark.parametrize("noise", [NOISE, LASTING])
def test_draws_have_the_covariance_that_they_are_weighed_by(noise: NoiseModel) -> None:
    grid = small_grid()
    drawn = Whitener(grid, noise).draw(np.random.default_rng(3), 6000)
    starts = np.flatnonzero(grid.first)
    covariance = dense(grid, noise)
    # A run's first deviation is drawn as 0, the diffuse start being no part of a plant's noise.
    conditional = covariance - sum(
        DIFFUSE_VARIANCE * np.outer(c, c) for c in (_decay_from(grid, int(start)) for start in starts)
    )
    spread = np.sqrt(np.diag(conditional))
    np.testing.assert_allclose(drawn.std(axis=1), spread, rtol=0.06)


def _decay_from(grid: Grid, start: int) -> Array:
    out = np.zeros(grid.dt.size)
    out[start] = 1.0
    for row in range(start + 1, grid.dt.size):
        if grid.first[row]:
            break
        out[row] = out[row - 1] * np.exp(-grid.k[row] * grid.dt[row])
    return out


def test_the_smoothed_residual_is_closer_to_the_truth_than_the_reading() -> None:
    grid = small_grid(size=200)
    rng = np.random.default_rng(5)
    truth = Whitener(grid, NoiseModel(sensor=1e-6, process=0.004, rough=0.002, cycle=0.3, memory=500.0, rest=0.4)).draw(
        rng, 1
    )[:, 0]
    read = truth + 0.05 * rng.standard_normal(truth.size)
    smoothed = Whitener(grid, NOISE).smooth(read)
    assert np.std(smoothed - truth) < 0.9 * np.std(read - truth)


def test_an_error_that_lasts_is_no_part_of_what_is_smoothed() -> None:
    grid = small_grid()
    covariance, residual = dense(grid, LASTING), np.random.default_rng(7).standard_normal(grid.dt.size)
    errors = covariance - dense(grid, replace(LASTING, sensor=0.0, lasting=0.0))
    expected = residual - errors @ np.linalg.solve(covariance, residual)
    np.testing.assert_allclose(Whitener(grid, LASTING).smooth(residual), expected, atol=1e-8)


@pytest.mark.parametrize("noise", [NOISE, LASTING])
def test_the_heat_and_its_band_are_those_of_the_dense_covariance(noise: NoiseModel) -> None:
    grid = small_grid()
    residual = np.random.default_rng(9).standard_normal(grid.dt.size)
    state, covariance = dense_states(grid, noise), dense(grid, noise)
    with_readings = state[1::2, ::2]
    mean, variance = Whitener(grid, noise).heat(residual)
    np.testing.assert_allclose(mean, with_readings @ np.linalg.solve(covariance, residual), rtol=1e-5, atol=1e-9)
    known = np.einsum("ij,ji->i", with_readings, np.linalg.solve(covariance, with_readings.T))
    np.testing.assert_allclose(variance, np.diag(state)[1::2] - known, rtol=1e-5, atol=1e-11)


def test_the_noise_is_found_again_from_its_own_draws() -> None:
    rng = np.random.default_rng(11)
    size = 1500
    running = (np.arange(size) % 100 < 60).astype(float)
    first = np.arange(size) == 0
    grid = grid_of(np.full(size, 60.0), np.full(size, 8e-4), running, 1e-2 * running, first, np.arange(size) // 100)
    truth = NoiseModel(sensor=0.04, process=0.003, rough=0.001, cycle=0.05, memory=400.0, rest=0.2)
    residual = Whitener(grid, truth).draw(rng, 1)

    def cost(trial: NoiseModel) -> tuple[float, Derivatives]:
        whitener = Whitener(grid, trial)
        value = 0.5 * float(residual[:, 0] @ whitener.weigh(residual)[:, 0] + whitener.logdet)

        def derivatives() -> tuple[Array, Array]:
            slopes, pulls = whitener.slopes(whitener.half_weigh(residual))
            return 0.5 * slopes, 0.5 * whitener.gram(pulls)

        return value, derivatives

    begin = NoiseModel(sensor=0.1, process=0.01, rough=3e-4, cycle=0.02)
    found, value = fit_noise(cost, WindowBelief(begin), begin, 8)
    _, least = fit_noise(cost, WindowBelief(begin), found, 40)
    assert value - least < 0.05, "eight steps end at the top"
    assert found.sensor == pytest.approx(truth.sensor, rel=0.15)
    assert found.rough == pytest.approx(truth.rough, rel=0.4)
    assert found.cycle == pytest.approx(truth.cycle, rel=0.7)


@pytest.mark.parametrize("noise", [NOISE, LASTING])
@pytest.mark.parametrize("size", [40, 900])
def test_the_slopes_of_a_likelihood_are_those_of_its_differences(noise: NoiseModel, size: int) -> None:
    grid = small_grid(size=size)
    columns = np.random.default_rng(2).standard_normal((size, 3))
    point, step = vector(noise), 1e-4

    def value(at: Array) -> float:
        whitener = Whitener(grid, noise_model(at))
        return whitener.logdet + float(np.trace(whitener.gram(columns)))

    moves = step * np.eye(point.size)
    expected = [(value(point + move) - value(point - move)) / (2.0 * step) for move in moves]
    whitener = Whitener(grid, noise)
    slopes, _ = whitener.slopes(whitener.half_weigh(columns))
    np.testing.assert_allclose(slopes, expected, rtol=1e-3, atol=1e-3 * np.max(np.abs(expected)))


def test_the_slope_of_the_share_at_rest_holds_where_hardly_anything_else_acts_at_rest() -> None:
    size = 400
    running = (np.arange(size) % 100 < 60).astype(float)
    grid = grid_of(
        np.full(size, 60.0), np.full(size, 8e-4), running, 1e-3 * running, np.arange(size) == 0, np.arange(size) // 100
    )
    columns = np.cumsum(np.random.default_rng(3).standard_normal((size, 1)), axis=0)
    noise = NoiseModel(sensor=0.03, process=0.002, rough=0.002, cycle=0.05, memory=1800.0, rest=0.2, still=0.08)
    point, move = vector(noise), 1e-4 * (np.arange(7) == REST)

    def value(at: Array) -> float:
        whitener = Whitener(grid, noise_model(at))
        return whitener.logdet + float(np.trace(whitener.gram(columns)))

    expected = (value(point + move) - value(point - move)) / 2e-4
    whitener = Whitener(grid, noise)
    assert whitener.slopes(whitener.half_weigh(columns))[0][REST] == pytest.approx(expected, rel=1e-4)


def test_a_fit_goes_straight_to_its_top_though_the_information_has_a_half_of_the_curvature() -> None:
    centre = NoiseModel(sensor=0.1, process=0.01, rough=3e-4, cycle=0.02)
    top = vector(centre) + np.array([0.2, -0.4, 0.3, 0.1, 0.05, -0.3, 0.6])
    curvature = np.diag([4000.0, 25.0, 500.0, 3.0, 50.0, 10.0, 2.0])
    known, asked = np.diag([4000.0, 11.0, 500.0, 3.0, 50.0, 10.0, 0.5]), list[float]()

    def cost(trial: NoiseModel) -> tuple[float, Derivatives]:
        off = vector(trial) - top
        asked.append(0.5 * float(off @ curvature @ off))
        return asked[-1], lambda: (curvature @ off, known)

    fit_noise(cost, WindowBelief(centre, spread=(1e3,) * 5, still=1e3), centre, 12)
    assert min(asked) < 0.02
    assert len(asked) <= 8, "values asked for"


@pytest.mark.parametrize("noise", [NOISE, LASTING])
def test_each_coordinate_pulls_at_a_residual_as_the_dense_covariance_moves(noise: NoiseModel) -> None:
    grid = small_grid()
    residual = np.random.default_rng(4).standard_normal((grid.dt.size, 1))
    point, inverse = vector(noise), np.linalg.inv(dense(grid, noise))
    whitener = Whitener(grid, noise)
    # Weighed, since that is what they are for: where a run begins is not believed in, and has no weight.
    pulls = whitener.weigh(whitener.slopes(whitener.half_weigh(residual))[1])
    for number, move in enumerate(1e-4 * np.eye(point.size)):
        moved = (dense(grid, noise_model(point + move)) - dense(grid, noise_model(point - move))) / 2e-4
        expected = inverse @ moved @ inverse @ residual[:, 0]
        np.testing.assert_allclose(pulls[:, number], expected, rtol=1e-3, atol=1e-3 * np.max(np.abs(expected)))
