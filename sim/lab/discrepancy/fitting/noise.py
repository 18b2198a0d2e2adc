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
from sim.engine import linear_recursion
from sim.lab.discrepancy.fitting.scattering import Scattering, Spans, StateBand, column_spans
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
        self._precision, self._prior_logdet = _precision(grid, noise, self._rough)
        factor = scipy.linalg.cholesky_banded(
            _reading_precision(self._precision, noise), lower=True, check_finite=False
        )
        self._band = StateBand(factor, self._precision.shape[0] - 2, 1.0 / noise.sensor**2)
        others = np.column_stack([grid.shared, grid.inrush])
        spans = column_spans(grid.heats) if spans is None else spans
        self._scattering = Scattering(self._band, grid.heats, noise.cycle, others, spans)

    def gram(self, columns: Array) -> Array:
        """(c, c) C' V^-1 C of the columns C (m, c), for half of what weighing them costs."""
        halved = self._band.half_solve(columns)
        part = self._scattering.half(self._scattering.cross_products(columns, halved))
        return np.asarray(columns.T @ columns * self._band.weight - halved.T @ halved - part.T @ part)

    def weigh(self, columns: Array) -> Array:
        """V^-1 times the columns (m, c)."""
        left = self._unscatter(columns)
        return self._band.residual_weights(left, self._band.solve(left))

    def slopes(self, columns: Array) -> tuple[Array, Array]:
        """(the derivative of ln |V| + the sum of c' V^-1 c over the columns c (m, k), by each coordinate of `vector`;
        (m, coordinates) dV V^-1 times the last column)."""
        # d(c' V^-1 c) = -(V^-1 c)' dV V^-1 c, and the derivative of ln |V| takes the columns of Z so from that of
        # ln |V0|: all of them are V0^-1 times something. In the states X that these stand for, dV0 is -X' dQ X with Q
        # the states' own precision, of whose band alone the products of X are needed.
        grid, noise, band, scattering = self.grid, self.noise, self._band, self._scattering
        strengths, others = (
            scattering.solve(scattering.cross_products(columns, band.half_solve(columns))),
            scattering.others_besides(),
        )
        unscattered = columns - scattering.times(strengths)
        dense = np.column_stack([scattering.times(others), unscattered])
        states = band.solve(dense)
        left = band.residual_weights(dense, states)
        size, products = float(np.sum(left**2)), _products(states, states, self._precision.shape[0])
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
        cycles = np.vstack([strengths[: inverse.shape[0]], np.zeros((others.shape[1], columns.shape[1]))])
        point, logdet = vector(noise), self._unscattered_logdet(self._precision, self._prior_logdet, noise)
        out, pulls, forced = np.empty(point.size), np.empty((grid.dt.size, point.size)), np.zeros((states.shape[0], 0))
        of_states = [number for number in range(point.size) if number not in (SENSOR, CYCLE)]
        for number in range(point.size):
            if number == CYCLE:
                out[number] = 2.0 * float(np.sum(1.0 - alike) - np.sum(cycles**2))
                pulls[:, number] = 2.0 * scattering.times(cycles[:, -1:])[:, 0]
                continue
            trial = noise_model(point + DERIVATIVE_STEP * (np.arange(point.size) == number))
            if number == SENSOR:
                moved, prior, change = self._precision, self._prior_logdet, -2.0 * noise.sensor**2 * size
                pulls[:, number] = 2.0 * noise.sensor**2 * left[:, -1]
            else:
                rough = self._rough if number != MEMORY else disturbance_step(trial.memory, grid.k, grid.dt)
                moved, prior = _precision(grid, trial, rough)
                by_step = (moved - self._precision) / DERIVATIVE_STEP
                change = float(np.sum(by_step * products))
                forced = np.column_stack([forced, _banded_times(by_step, states[:, -1])])
            out[number] = change + (self._unscattered_logdet(moved, prior, trial) - logdet) / DERIVATIVE_STEP
        # dV0 V^-1 c = -H Q^-1 dQ X.
        solved = scipy.linalg.solveh_banded(self._precision, forced, lower=True, check_finite=False)
        pulls[:, of_states] = -sum(solved[part :: band.states] for part in range(0, band.states, 2))
        return out, pulls

    @staticmethod
    def _unscattered_logdet(precision: Array, prior_logdet: float, noise: NoiseModel) -> float:
        """ln |V0|, without the columns of Z."""
        # The determinant lemma: |A + U U'| = |A| |I + U' A^-1 U|.
        factor = scipy.linalg.cholesky_banded(_reading_precision(precision, noise), lower=True, check_finite=False)
        windows = precision.shape[1] // (precision.shape[0] - 2)
        return float(2.0 * windows * np.log(noise.sensor) + 2.0 * np.log(factor[0]).sum() - prior_logdet)

    def _unscatter(self, columns: Array) -> Array:
        """(m, c) columns that V0^-1 weighs as V^-1 weighs the given ones."""
        scattering = self._scattering
        return columns - scattering.times(
            scattering.solve(scattering.cross_products(columns, self._band.half_solve(columns)))
        )

    @property
    def logdet(self) -> float:
        """ln |V| of the windows."""
        sensor = 2.0 * self.grid.dt.size * np.log(self.noise.sensor)
        banded = 2.0 * np.log(self._band.factor[0]).sum() - self._prior_logdet
        return float(sensor + banded + self._scattering.logdet)

    def smooth(self, residual: Array) -> Array:
        """(m,) the residual without the errors of the reading, white and lasting: its mean given all readings, degC."""
        noise, weighed = self.noise, self.weigh(residual[:, None])[:, 0]
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
        mean = band.solve(self._unscatter(residual[:, None]))[1 :: band.states, 0]
        # What is not known of the columns' sizes adds to what the states themselves leave open.
        besides = band.solve(scattering.times(scattering.others_besides()))[1 :: band.states]
        variance = inverse_diagonal(band.factor)[1 :: band.states] + np.sum(besides**2, axis=1)
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
        decay, variance, heat_step = _steps(grid, noise, self._rough)
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
"""By how much a coordinate is moved for the derivatives of the banded precision and of its determinant."""
LONGEST_STEP, HALVINGS = 1.5, 6
"""How far a step may move a coordinate (a factor of 4 or so), and how often it is halved where it leads up."""
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


def _steps(grid: Grid, noise: NoiseModel, rough: DisturbanceStep) -> tuple[Array, Array, DisturbanceStep]:
    """(decay, variance of the process and of late switches, the rough heat's part of x) of the step to each window."""
    white = grid.running + (1.0 - grid.running) * noise.still**2  # where part of a step ran: by variance
    white = np.maximum(noise.process**2 * white, LEAST_PROCESS**2)
    variance = white * decay_and_pull(2 * grid.k, grid.dt)[1] + grid.late
    # Of the heat only a share acts at rest: it is what reaches x, and the heat itself goes on as ever.
    share = noise.rest + (1.0 - noise.rest) * grid.running
    step = replace(rough, carried=share * rough.carried, xx=share**2 * rough.xx, xd=share * rough.xd)
    return np.exp(-grid.k * grid.dt), variance, step


def inverse_diagonal(factor: Array) -> Array:
    """(n,) the diagonal of (L L')^-1 of a banded Cholesky factor L (b + 1, n) in lower form.

    The recursion of Takahashi, Fagan and Chin (1973): an entry of the inverse within the band takes only such of later
    rows, so that the inverse is never formed.
    """
    width, n = factor.shape[0] - 1, factor.shape[1]
    # Plain floats: a row has a dozen products, and there is nothing to do for whole arrays at once.
    pivots, below = factor[0].tolist(), (factor[1:] / factor[0]).T.tolist()
    band = [[0.0] * (n + width + 1) for _ in range(width + 1)]  # band[d][j] is the entry (j + d, j)
    for j in range(n - 1, -1, -1):
        ratios = below[j]
        for d in range(width, 0, -1):
            band[d][j] = -sum(ratio * band[abs(d - e)][j + min(d, e)] for e, ratio in enumerate(ratios, start=1))
        band[0][j] = pivots[j] ** -2.0 - sum(ratio * band[e][j] for e, ratio in enumerate(ratios, start=1))
    return np.array(band[0][:n])


def _precision(grid: Grid, noise: NoiseModel, rough: DisturbanceStep) -> tuple[Array, float]:
    """(4, 2m) the banded precision of the states (x, h) at the windows, lower form, and its log-determinant; (5, 3m)
    with the error that lasts."""
    m = grid.dt.size
    decay, variance, step = _steps(grid, noise, rough)
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
    f11, f12, f22 = (np.where(grid.first, 0.0, part) for part in (decay, step.carried, step.keep))
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
    # Few iterations are enough, since the fit comes back here with better parameters.
    for _ in range(iterations):
        slopes, information = derivatives()
        slopes, information = slopes + (point - centre) / spread**2, information + np.diag(spread**-2.0)
        free = ~(((point <= low) & (slopes > 0)) | ((point >= high) & (slopes < 0)))
        step = np.zeros(point.size)
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], slopes[free])
        step *= min(1.0, LONGEST_STEP / max(float(np.max(np.abs(step))), LONGEST_STEP))
        if -0.5 * float(slopes @ step) < ENOUGH:
            break
        for _half in range(HALVINGS):
            moved = np.clip(point + step, low, high)
            after, derivatives = cost(moved)
            if after < value:
                break
            step = 0.5 * step
        else:
            break
        point, value = moved, after
    return noise_model(point), value
