"""What a free run's residual looks like when nothing is missing: the sensor, the process, and a rough plant's own heat.

A residual r (measured - free run) of a model with the right flows obeys, between windows of readings,

    dx/dt = -k x + h + s dW,    r = x + c w + u + v,    h an Ornstein-Uhlenbeck heat,    c a scatter of each cycle

where k is the location's rate (0 where the flow does not relax), w what the cycle's friction heat does to the reading,
v the sensor's noise; x starts anew with each run. u is an error of the reading that lasts, such a process too: where
readings stand on the steps of their rounding, what hides below a step hides as long as it stands. A recorder knows a
switch to a row only: what the heat did between that and its row's end is a jump of x there (`Grid.late`,
`Grid.shared`). What h does over a step is the law of the model's own disturbance (`sim.effects.disturbance_step`), and
where the given model has one, the fit begins from it. The precision is banded, so that weighing any number of columns
by the inverse covariance costs one banded Cholesky decomposition (Rue & Held 2005, ch. 2), and the scatter of the
cycles is a random effect on top (Woodbury).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sim.effects import DisturbanceStep, disturbance_step
from sim.engine import linear_recursion, matrix_recursion
from sim.lab.discrepancy.fitting.scattering import HalfWeighed, Scattering, Spans, StateBand, column_spans
from sim.lab.learning import Indices
from sim.sha import Array, Mask

DIFFUSE_VARIANCE = 1e4
"""Variance (degC^2) of a run's first deviation: its start temperature is not believed in."""
LEAST_HEAT, LEAST_PROCESS = 1e-7, 1e-5
"""Floors of the heats (degC/s) and of the process noise (degC/sqrt(s)), below anything that a plant has."""
SHORTEST, LONGEST = float(np.log(60.0)), float(np.log(1800.0))
"""The rough heat's memory (log s): longer, it would imitate the slow effects that are looked for. Where the model has
learned a longer one, that is the bound."""
BRIEFEST, SLOWEST = float(np.log(5.0)), float(np.log(120.0))
"""The memory of an error that lasts (log s): longer, it would imitate effects on the sensor and at starts."""
MAX_LOG_SCATTER = float(np.log(0.05))
"""The scatter of a cycle's friction (log): more of it would make up for wrong targets, cycle by cycle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """Standard deviations: `sensor` degC, `process` degC/sqrt(s), `rough` degC/s with the `memory` (s), `cycle` (1).

    `cycle` is the relative scatter of the friction heat from cycle to cycle, `rest` the share of the rough heat that
    acts at rest (0 to 1), `still` how many times the process noise is at rest what it is while the machine runs.
    `lasting` (degC) is u, an error of the reading with the memory `fades` (s); 0: there is none.
    """

    sensor: float
    process: float
    rough: float
    cycle: float
    memory: float = 600.0
    rest: float = 0.5
    still: float = 1.0
    lasting: float = 0.0
    fades: float = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """m windows of R runs, one after the other: `dt` (m,) s since the one before (of no meaning at a run's first).

    `k` (m,) 1/s is the mean rate since then, `running` (m,) the share of that time in which the machine ran, `first`
    (m,) begins a run, `cycle` (m,) numbers the cycles. `heats` (m, cycles) degC is what a scatter of 1 in each cycle
    does to the windows. `late` (m,) degC^2 is the variance of the jumps of x in the step to each window, by starts
    and stops between two rows, each at a time of its own; `shared` (m,) degC is one standard deviation of
    what all of them have in common, `inrush` (m,) degC what the drive of all starts' first seconds does, by which the
    model may be wrong.
    """

    dt: Array
    k: Array
    running: Array
    first: Mask
    cycle: Indices
    heats: Array
    late: Array
    shared: Array
    inrush: Array


def decay_and_pull(k: Array, dt: Array) -> tuple[Array, Array]:
    """(e^{-k dt}, what a constant heat of 1 degC/s adds over dt in degC)."""
    # expm1 keeps the digits that 1 - exp loses at small k dt; below 1e-8 the limit dt is exact to rounding.
    passed = k * dt
    small, lost = passed < 1e-8, -np.expm1(-passed)
    pull = np.where(small, dt, lost / np.where(small, 1.0, k))
    return 1.0 - lost, pull


class Whitener:
    """The inverse covariance of the windows under one `NoiseModel`.

    V = H S H' + sensor^2 + Z Z', with S the covariance of the states (x, h), or (x, h, u), of which only the banded
    inverse is formed, and Z a column a cycle, one for what is shared by all switches between rows, and one for the
    inrush. Both steps are Woodbury's identity; V itself (m x m) is never formed.
    """

    def __init__(
        self, grid: Grid, noise: NoiseModel, rough: DisturbanceStep | None = None, spans: Spans | None = None
    ) -> None:
        """`rough` is the step of the rough heat at the noise's memory, `spans` those of the grid's heats, where they
        are at hand."""
        self.grid, self.noise = grid, noise
        self._rough = disturbance_step(noise.memory, grid.k, grid.dt) if rough is None else rough
        self._plant = _plant_steps(grid)
        self._precision, self._prior_logdet = _precision(grid, noise, self._plant, self._rough)
        factor = scipy.linalg.cholesky_banded(
            _reading_precision(self._precision, noise), lower=True, check_finite=False
        )
        self._band = StateBand(factor, self._precision.shape[0] - 2, 1.0 / noise.sensor**2)
        others = np.column_stack([grid.shared, grid.inrush])
        spans = column_spans(grid.heats) if spans is None else spans
        self._scattering = Scattering(self._band, grid.heats, noise.cycle, others, spans)

    def half_weigh(self, columns: Array) -> HalfWeighed:
        """The columns (m, c) with what their products by V^-1 take, for half of what weighing them costs."""
        halved = self._band.half_solve(columns)
        across = self._scattering.half(self._scattering.cross_products(columns, halved))
        return HalfWeighed(columns, halved, across, self._band.weight)

    def gram(self, columns: Array) -> Array:
        """(c, c) C' V^-1 C of the columns C (m, c)."""
        half = self.half_weigh(columns)
        return half.products(half)

    def weigh(self, columns: Array) -> Array:
        """V^-1 times the columns (m, c)."""
        left, halved, _ = self._unscatter(self.half_weigh(columns))
        return self._band.residual_weights(left, self._band.back_solve(halved))

    def slopes(self, half: HalfWeighed) -> tuple[Array, Array]:
        """(the derivative of ln |V| + the sum of c' V^-1 c over the columns c (m, k) by each coordinate of `vector`;
        (m, coordinates) dV V^-1 times the last column)."""
        # d(c' V^-1 c) = -(V^-1 c)' dV V^-1 c, and the derivative of ln |V| takes the columns of Z so from that of
        # ln |V0|: all of them are V0^-1 times something. In the states X that these stand for, dV0 is -X' dQ X with Q
        # the states' own precision, of whose band alone the products of X are needed.
        grid, noise, band, scattering = self.grid, self.noise, self._band, self._scattering
        others = scattering.others_besides()
        unscattered, halved, strengths = self._unscatter(half)
        dense = np.column_stack([scattering.times(others), unscattered])
        states = band.back_solve(np.column_stack([scattering.halved_times(others), halved]))
        left = band.residual_weights(dense, states)
        size, products = float(np.sum(left**2)), _products(states, states, self._precision.shape[0])
        known = inverse_band(band.factor, band.states)
        # ln |V0| = ln |Q + H' H / sensor^2| - ln |Q| + 2 m ln sensor, by the determinant lemma.
        products += np.vstack([known[:1], 2.0 * known[1:]])
        size -= (grid.dt.size - band.weight * _reading_variance(known, band.states)) / noise.sensor**2
        inverse = scattering.inner_inverse()
        for piece in scattering.solve_cycles():
            mixed = inverse[piece.columns, piece.columns]
            weighed = band.residual_weights(piece.own, piece.states)
            size += float(np.sum(weighed * (weighed @ mixed)))
            rows = slice(band.states * piece.rows.start, band.states * piece.rows.stop)
            products[:, rows] += _products(
                piece.states @ mixed, np.vstack([piece.states, piece.after]), products.shape[0]
            )
        alike = np.diag(inverse) + np.sum(others[: inverse.shape[0]] ** 2, axis=1)
        cycles = np.vstack([strengths[: inverse.shape[0]], np.zeros((others.shape[1], strengths.shape[1]))])
        point = vector(noise)
        out, pulls, forced = np.empty(point.size), np.empty((grid.dt.size, point.size)), np.zeros((states.shape[0], 0))
        of_states = [number for number in range(point.size) if number not in (SENSOR, CYCLE)]
        for number in range(point.size):
            if number == CYCLE:
                out[number] = 2.0 * float(np.sum(1.0 - alike) - np.sum(cycles**2))
                pulls[:, number] = 2.0 * scattering.times(cycles[:, -1:])[:, 0]
                continue
            if number == SENSOR:
                out[number] = -2.0 * noise.sensor**2 * size
                pulls[:, number] = 2.0 * noise.sensor**2 * left[:, -1]
                continue
            (low, low_prior), (high, high_prior) = (
                self._moved_precision(noise_model(point + side * DERIVATIVE_STEP * (np.arange(point.size) == number)))
                for side in (-1.0, 1.0)
            )
            by_step = (high - low) / (2.0 * DERIVATIVE_STEP)
            forced = np.column_stack([forced, _banded_times(by_step, states[:, -1])])
            out[number] = float(np.sum(by_step * products)) - (high_prior - low_prior) / (2.0 * DERIVATIVE_STEP)
        # dV0 V^-1 c = -H Q^-1 dQ X.
        solved = scipy.linalg.solveh_banded(self._precision, forced, lower=True, check_finite=False)
        pulls[:, of_states] = -sum(solved[part :: band.states] for part in range(0, band.states, 2))
        return out, pulls

    def _moved_precision(self, trial: NoiseModel) -> tuple[Array, float]:
        """The states' banded precision under a noise near this one, and its log-determinant."""
        grid, same = self.grid, trial.memory == self.noise.memory
        rough = self._rough if same else disturbance_step(trial.memory, grid.k, grid.dt)
        return _precision(grid, trial, self._plant, rough)

    def _unscatter(self, half: HalfWeighed) -> tuple[Array, Array, Array]:
        """((m, c) columns that V0^-1 weighs as V^-1 weighs the given ones, the same half solved, the strengths of the
        columns of Z that they are without)."""
        scattering = self._scattering
        strengths = scattering.back_solve(half.across)
        left = half.columns - scattering.times(strengths)
        return left, half.halved - scattering.halved_times(strengths), strengths

    @property
    def logdet(self) -> float:
        """ln |V| of the windows."""
        sensor = 2.0 * self.grid.dt.size * np.log(self.noise.sensor)
        banded = 2.0 * np.log(self._band.factor[0]).sum() - self._prior_logdet
        return float(sensor + banded + self._scattering.logdet)

    def smooth(self, residual: Array, weighed: Array | None = None) -> Array:
        """(m,) the residual without the errors of the reading, white and lasting: its mean given all readings, degC.

        `weighed` (m,) is V^-1 times it, where that is at hand.
        """
        noise = self.noise
        weighed = self.weigh(residual[:, None])[:, 0] if weighed is None else weighed
        error = noise.sensor**2 * weighed
        if noise.lasting > 0:
            # What lasts has the covariance lasting^2 e^(-|t - t'| / fades), whose product is a sum from either side.
            keep = _lasting_steps(self.grid, noise)[0]
            earlier = linear_recursion(keep, weighed, 0.0)
            later = linear_recursion(np.append(0.0, keep[:0:-1]), weighed[::-1], 0.0)[::-1]
            error = error + noise.lasting**2 * (earlier + later - weighed)
        return np.asarray(residual - error)

    def heat(self, residual: Array) -> tuple[Array, Array]:
        """(mean, variance) (m,) of the rough heat h at each window, degC/s, given all readings."""
        band, scattering = self._band, self._scattering
        mean = band.back_solve(self._unscatter(self.half_weigh(residual[:, None]))[1])[1 :: band.states, 0]
        # What is not known of the columns' sizes adds to what the states themselves leave open.
        besides = band.back_solve(scattering.halved_times(scattering.others_besides()))[1 :: band.states]
        variance = inverse_band(band.factor, band.states)[0, 1 :: band.states] + np.sum(besides**2, axis=1)
        inverse = scattering.inner_inverse()
        for piece in scattering.solve_cycles():
            heats = piece.states[1 :: band.states]
            variance[piece.rows] += np.einsum("mc,mc->m", heats @ inverse[piece.columns, piece.columns], heats)
        return np.asarray(mean), np.asarray(variance)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """(m, count) residuals of a plant that has nothing but this noise."""
        grid, noise = self.grid, self.noise
        size = (grid.dt.size, count)
        heat, deviation = np.zeros(count), np.zeros(count)
        decay, (variance, heat_step) = self._plant.decay, _steps(grid, noise, self._plant, self._rough)
        into, fresh = heat_step.coupling, np.sqrt(heat_step.dd)
        variance = variance + noise.rough**2 * heat_step.own
        out = np.empty(size)
        for row in range(size[0]):
            if grid.first[row]:
                heat, deviation = noise.rough * rng.standard_normal(count), np.zeros(count)
            else:
                new = noise.rough * fresh[row] * rng.standard_normal(count)
                deviation = decay[row] * deviation + heat_step.carried[row] * heat + into[row] * new
                deviation = deviation + np.sqrt(variance[row]) * rng.standard_normal(count)
                heat = heat_step.keep[row] * heat + new
            out[row] = deviation
        scatter = self._scattering.times(rng.standard_normal((grid.heats.shape[1] + 2, count)))
        return out + scatter + self._draw_error(rng, size) + noise.sensor * rng.standard_normal(size)

    def _draw_error(self, rng: np.random.Generator, size: tuple[int, int]) -> Array | float:
        """Draws of the error that lasts; no draw where there is none."""
        if self.noise.lasting <= 0:
            return 0.0
        keep, fresh = _lasting_steps(self.grid, self.noise)
        return linear_recursion(keep[:, None], np.sqrt(fresh)[:, None] * rng.standard_normal(size), np.zeros(size[1]))


SENSOR, CYCLE, MEMORY, LASTS = 0, 3, 4, 7
"""Places in `vector`; from LASTS on stands the error that lasts."""
DERIVATIVE_STEP = 1e-4
"""By how much a coordinate is moved to either side for the derivatives of the states' banded precision. To one side
alone, the share at rest would have a slope that is several nats off: where hardly anything else acts at rest, it weighs
by its inverse square, in two large parts that nearly cancel."""
LONGEST_STEP, SHORTENED = 1.5, 6
"""How far a step may move a coordinate (a factor of 4 or so), and how often it is made shorter where it leads up."""
NEAR_NATS = 3.0
"""Nats that a step has gained at most where the top is so near that a parabola through both its ends holds."""
MIN_CURVATURE_SHARE = 0.05
"""Of the curvature that the information foresees along a step, the least that is believed of the slopes' change."""
ENOUGH = 0.01
"""Nats that a step must promise: no decision is that fine."""

Derivatives = Callable[[], tuple[Array, Array]]
"""What makes slopes (c,) and information (c, c) of a log-likelihood by the noise's coordinates."""


def _reading_precision(precision: Array, noise: NoiseModel) -> Array:
    """The states' banded precision given the readings: each window is one of its x, or of x + u."""
    posterior, weight = precision.copy(), 1.0 / noise.sensor**2
    posterior[0, :: 3 if noise.lasting > 0 else 2] += weight
    if noise.lasting > 0:
        posterior[2, ::3] += weight
        posterior[0, 2::3] += weight
    return posterior


def _reading_variance(known: Array, states: int) -> float:
    """degC^2 the sum over the windows of the variance of what is read there without the reading's own error, of the
    states' covariance in banded form."""
    read = known[0, 0::states].sum()
    return float(read if states == 2 else read + (2.0 * known[2, 0::3] + known[0, 2::3]).sum())


def _banded_times(band: Array, column: Array) -> Array:
    """(n,) a symmetric band (d + 1, n) in lower form times a column (n,)."""
    out, n = band[0] * column, column.size
    for down in range(1, band.shape[0]):
        part = band[down, : n - down]
        out[: n - down] += part * column[down:]
        out[down:] += part * column[: n - down]
    return np.asarray(out)


def _products(left: Array, right: Array, rows: int) -> Array:
    """(`rows`, n) the sums over columns of left (n, c) times right (n or more, c), 0 to so many rows further down.

    Twice that where it is further down at all: what weighs a symmetric band in lower form.
    """
    out = np.zeros((rows, left.shape[0]))
    for down in range(rows):
        below = right[down : down + left.shape[0]]
        out[down, : below.shape[0]] = (2.0 if down else 1.0) * np.einsum("ij,ij->i", left[: below.shape[0]], below)
    return out


@dataclass(frozen=True, slots=True)
class _PlantSteps:
    """What no noise changes of the step to each window (m,): `decay` of x, and `spread` (s), the variance that white
    noise of 1 degC/sqrt(s) leaves of itself."""

    decay: Array
    spread: Array


def _plant_steps(grid: Grid) -> _PlantSteps:
    return _PlantSteps(np.exp(-grid.k * grid.dt), decay_and_pull(2 * grid.k, grid.dt)[1])


def _steps(grid: Grid, noise: NoiseModel, plant: _PlantSteps, rough: DisturbanceStep) -> tuple[Array, DisturbanceStep]:
    """(variance of the process and of late switches, the rough heat's part of x) of the step to each window."""
    white = grid.running + (1.0 - grid.running) * noise.still**2  # where part of a step ran: by variance
    white = np.maximum(noise.process**2 * white, LEAST_PROCESS**2)
    variance = white * plant.spread + grid.late
    # Of the heat only a share acts at rest: it is what reaches x, and the heat itself goes on as ever.
    share = noise.rest + (1.0 - noise.rest) * grid.running
    step = replace(rough, carried=share * rough.carried, xx=share**2 * rough.xx, xd=share * rough.xd)
    return variance, step


def inverse_band(factor: Array, states: int) -> Array:
    """(b + 1, n) the band of (L L')^-1 in lower form, of a banded Cholesky factor L (b + 1, n) of blocks of `states`.

    The recursion of Takahashi, Fagan and Chin (1973) by blocks: with D_t and B_t those of L on and below the diagonal,
    S_t = (D_t D_t')^-1 + G_t S_t+1 G_t' and S_t,t+1 = G_t S_t+1, where G_t = -(B_t D_t^-1)'. It is linear in what is to
    be known of S_t, so that it is solved at once, and the inverse is never formed.
    """
    width, windows = factor.shape[0] - 1, factor.shape[1] // states
    each = range(states)
    columns = [factor[:, at::states] for at in each]
    nothing = np.zeros(windows)
    below = [[columns[j][states + i - j] if states + i - j <= width else nothing for j in each] for i in each]
    root: list[list[Array]] = [[nothing for _ in each] for _ in each]  # D^-1
    for j in each:
        root[j][j] = 1.0 / columns[j][0]
        for i in range(j + 1, states):
            root[i][j] = -sum(columns[k][i - k] * root[k][j] for k in range(j, i)) * (1.0 / columns[i][0])
    gain: Array = np.array([[-sum(below[c][k] * root[k][a] for k in range(a, states)) for c in each] for a in each])
    gain[:, :, -1] = 0.0
    pairs = [(a, b) for a in each for b in range(a + 1)]
    step, own = np.empty((windows, len(pairs), len(pairs))), np.empty((windows, len(pairs)))
    for row, (a, b) in enumerate(pairs):
        own[:, row] = sum(root[k][a] * root[k][b] for k in range(a, states))
        for column, (c, d) in enumerate(pairs):
            step[:, row, column] = gain[a, c] * gain[b, d] + (gain[a, d] * gain[b, c] if c != d else 0.0)
    found = matrix_recursion(step[::-1], own[::-1], np.zeros(len(pairs)))[::-1]
    blocks = [[found[:, pairs.index((max(a, b), min(a, b)))] for b in each] for a in each]
    out = np.zeros_like(factor)
    for j in each:
        for i in range(j, states):
            out[i - j, j::states] = blocks[i][j]
        for i in each:
            if states + i - j <= width:
                out[states + i - j, j:-states:states] = sum(blocks[i][c][1:] * gain[j, c, :-1] for c in each)
    return out


def _precision(grid: Grid, noise: NoiseModel, plant: _PlantSteps, rough: DisturbanceStep) -> tuple[Array, float]:
    """(4, 2m) the banded precision of the states (x, h) at the windows, lower form, and its log-determinant; (5, 3m)
    with the error that lasts."""
    m = grid.dt.size
    variance, step = _steps(grid, noise, plant, rough)
    heat = max(noise.rough, LEAST_HEAT) ** 2
    # A Markov chain's precision has a block of two rows a window and one to its neighbour: with z' = F z + q, cov q =
    # Q, the step to each window adds Q^-1 to its own block, F' Q^-1 F to the block before, -Q^-1 F between them.
    qx, qh = (
        np.where(grid.first, DIFFUSE_VARIANCE, variance + heat * step.xx),
        np.where(grid.first, heat, heat * step.dd),
    )
    cross = np.where(grid.first, 0.0, heat * step.xd)
    # Q^-1 = (a b; b d), written out: two rows need no solver. In lower form row i of `band` is the i-th subdiagonal.
    determinant = qx * qh - cross**2
    a, b, d = qh / determinant, -cross / determinant, qx / determinant
    f11, f12, f22 = (np.where(grid.first, 0.0, part) for part in (plant.decay, step.carried, step.keep))
    band = np.zeros((4, 2 * m))
    band[0, 0::2] += a
    band[1, 0::2] += b
    band[0, 1::2] += d
    later, before = slice(1, None), slice(0, m - 1)
    a, b, d, f11, f12, f22 = (part[later] for part in (a, b, d, f11, f12, f22))
    band[0, 0::2][before] += f11 * a * f11
    band[1, 0::2][before] += f11 * (a * f12 + b * f22)
    band[0, 1::2][before] += f12 * (a * f12 + b * f22) + f22 * (b * f12 + d * f22)
    band[2, 0::2][before] -= a * f11
    band[3, 0::2][before] -= b * f11
    band[1, 1::2][before] -= a * f12 + b * f22
    band[2, 1::2][before] -= b * f12 + d * f22
    logdet = float(-np.log(determinant).sum())
    return _add_error_state(band, logdet, grid, noise) if noise.lasting > 0 else (band, logdet)


def _add_error_state(band: Array, logdet: float, grid: Grid, noise: NoiseModel) -> tuple[Array, float]:
    """The banded precision of (x, h) with the error that lasts as a third state, which goes its own way."""
    keep, fresh = _lasting_steps(grid, noise)
    own = 1.0 / fresh
    out = np.zeros((5, 3 * grid.dt.size))
    # A window's three entries: what lay within (x, h) moves on by one row where it reaches into the next window.
    out[0, 0::3], out[0, 1::3] = band[0, 0::2], band[0, 1::2]
    out[1, 0::3], out[2, 1::3] = band[1, 0::2], band[1, 1::2]
    out[3, 0::3], out[3, 1::3] = band[2, 0::2], band[2, 1::2]
    out[4, 0::3] = band[3, 0::2]
    out[0, 2::3] = own
    out[0, 2:-3:3] += keep[1:] ** 2 * own[1:]
    out[3, 2:-3:3] = -keep[1:] * own[1:]
    return out, logdet - float(np.log(fresh).sum())


def _lasting_steps(grid: Grid, noise: NoiseModel) -> tuple[Array, Array]:
    """(what is left of the error that lasts, the variance (degC^2) of what comes anew) in the step to each window."""
    keep = np.where(grid.first, 0.0, np.exp(-grid.dt / noise.fades))
    return keep, noise.lasting**2 * -np.expm1(np.where(grid.first, -np.inf, -2.0 * grid.dt / noise.fades))


@dataclass(frozen=True, slots=True)
class WindowBelief:
    """What is believed of the noise before the data: centres and spreads (of logarithms) of sensor .. memory, of still,
    and of lasting and fades where the centre has an error that lasts.

    The sensor's is not below `least` (degC). The process noise is held to what the model states of it, by a factor of
    two or so: a day or two overrule that, while between white and rough heat the data decide late.
    """

    centre: NoiseModel
    spread: tuple[float, float, float, float, float] = (1.0, 0.7, 1.5, 1.5, 0.7)
    still: float = 1.0
    lasts: tuple[float, float] = (2.0, 0.7)
    least: float = 0.0


def vector(noise: NoiseModel) -> Array:
    """Unbounded coordinates: logarithms, of `rest` the logit; those of the error that lasts where there is one."""
    logs = np.log([noise.sensor, noise.process, noise.rough, noise.cycle, noise.memory])
    lasts = np.log([noise.lasting, noise.fades]) if noise.lasting > 0 else np.empty(0)
    return np.concatenate([logs, [np.log(noise.rest / (1.0 - noise.rest)), np.log(noise.still)], lasts])


def noise_model(point: Array) -> NoiseModel:
    """The inverse of `vector`."""
    sensor, process, rough, cycle, memory = np.exp(point[:5]).tolist()
    return NoiseModel(
        sensor=sensor,
        process=process,
        rough=rough,
        cycle=cycle,
        memory=memory,
        rest=float(1.0 / (1.0 + np.exp(-point[5]))),
        still=float(np.exp(point[6])),
        **(dict(zip(("lasting", "fades"), np.exp(point[LASTS:]).tolist(), strict=True)) if point.size > LASTS else {}),
    )


def fit_noise(
    objective: Callable[[NoiseModel], tuple[float, Derivatives]],
    belief: WindowBelief,
    begin: NoiseModel,
    iterations: int = 12,
) -> tuple[NoiseModel, float]:
    """(the noise of least `objective` (minus a log-likelihood) plus the belief's, and that sum), from `begin`.

    The objective comes with what makes its derivatives by the coordinates of `vector`. Newton's steps within bounds,
    with the average information (Gilmour, Thompson & Cullis 1995) for the second derivatives: it is never indefinite,
    and knows at once how far apart the curvatures lie, which a quasi-Newton search has to find out anew in each fit.
    """
    centre = vector(belief.centre)
    spread = np.array([*belief.spread, 1.0, belief.still, *(belief.lasts if centre.size > LASTS else ())])

    def cost(point: Array) -> tuple[float, Derivatives]:
        value, derivatives = objective(noise_model(point))
        return value + 0.5 * float(np.sum(((point - centre) / spread) ** 2)), derivatives

    low, high = centre - 4.0, centre + 4.0
    low[SENSOR] = max(low[SENSOR], float(np.log(max(belief.least, 1e-12))))
    high[CYCLE] = MAX_LOG_SCATTER
    low[MEMORY], high[MEMORY] = SHORTEST, max(LONGEST, centre[MEMORY])
    if centre.size > LASTS:
        low[LASTS + 1], high[LASTS + 1] = BRIEFEST, SLOWEST
    point = np.clip(vector(begin), low, high)
    value, derivatives = cost(point)
    earlier: tuple[Array, Array] | None = None
    # Few iterations are enough, since the fit comes back here with better parameters.
    for _ in range(iterations):
        slopes, information = derivatives()
        slopes, information = slopes + (point - centre) / spread**2, information + np.diag(spread**-2.0)
        if earlier is not None:
            information = _with_secant(information, point - earlier[0], slopes - earlier[1])
        step = _bounded_step(slopes, information, low - point, high - point)
        step *= min(1.0, LONGEST_STEP / max(float(np.max(np.abs(step))), LONGEST_STEP))
        promised = float(slopes @ step)
        if -0.5 * promised < ENOUGH:
            break
        for _shorter in range(SHORTENED):
            moved = np.clip(point + step, low, high)
            after, derivatives = cost(moved)
            if after < value:
                break
            # The lowest point of the parabola through both ends and the slope at the first.
            share = -0.5 * promised / max(after - value - promised, 1e-300) if np.isfinite(after) else 0.1
            share = min(max(share, 0.1), 0.5)
            step, promised = share * step, share * promised
        else:
            break
        # Far from the top the slopes change as no parabola's would: what they say of it there holds nowhere else.
        gained = value - after
        earlier = (point, slopes) if gained < NEAR_NATS else None
        point, value = moved, after
        if gained < ENOUGH:
            break
    return noise_model(point), value


def _bounded_step(slopes: Array, information: Array, least: Array, most: Array) -> Array:
    """Newton's step (c,) within `least` and `most`: where it would leave them it ends there, and the rest is solved
    again beside that (active set: Nocedal & Wright 2006, ch. 16)."""
    free = ~(((least >= 0) & (slopes > 0)) | ((most <= 0) & (slopes < 0)))
    step = np.zeros(slopes.size)
    while free.any():
        rest = slopes[free] + information[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], rest)
        beyond = free & ((step < least) | (step > most))
        if not beyond.any():
            break
        step, free = np.clip(step, least, most), free & ~beyond
    return step


def _with_secant(information: Array, step: Array, change: Array) -> Array:
    """The information that would have foreseen by how much the slopes changed over the last step (Broyden, Fletcher,
    Goldfarb and Shanno's update, 1970).

    The average information has only a half of the curvature, or less, in what is not in these data: the process noise
    at rest beside that while the machine runs. Without the update, steps along that go from side to side of the top.
    """
    foreseen, curvature = information @ step, float(change @ step)
    if curvature <= MIN_CURVATURE_SHARE * float(step @ foreseen):
        return information
    return np.asarray(
        information - np.outer(foreseen, foreseen) / float(step @ foreseen) + np.outer(change, change) / curvature
    )
