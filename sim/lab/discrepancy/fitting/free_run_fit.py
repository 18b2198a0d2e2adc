"""The model's parameters, the effects' strengths and the plant's noise of greatest likelihood on a record.

Steps of Gauss and Newton on the free run, the residuals weighed by the noise's inverse covariance; between them the
noise is fitted with the model's own parameters taken out (restricted likelihood: Harville 1974). The likelihoods of two
fits on the same record can be compared: the same parameters are integrated out under the same belief in both, and the
strengths of the effects are maximised.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sim.effects import of_feature
from sim.engine import repeat_factor
from sim.lab.discrepancy.fitting.baseline import TARGET_SPREAD, Frame
from sim.lab.discrepancy.fitting.course import LATE_TOGETHER, CourseState, run_frame, window_grid, window_sensitivity
from sim.lab.discrepancy.fitting.named import Named, model_effects
from sim.lab.discrepancy.fitting.noise import (
    LEAST_HEAT,
    Derivatives,
    Grid,
    NoiseModel,
    Whitener,
    WindowBelief,
    fit_noise,
    vector,
)
from sim.lab.discrepancy.fitting.record import Record
from sim.lab.discrepancy.fitting.scattering import column_spans
from sim.sha import Array, Model

ROUNDS, NEWTON = 4, 8
LARGEST_TARGET, LARGEST_SHARE = 15.0, 0.7
"""A step of Newton's is shortened to this: degC of a target (other parameters in proportion to their belief), and the
share of itself by which a strength may change."""
MAX_THRESHOLD_STEP_DEGC = 2.0
"""degC by which such a step may move a threshold."""
ENOUGH_SQUARES = 0.02
"""By which a step must make the penalised squares less: a hundredth of a nat, and no decision is that fine."""
RUNAWAY, SOFTENED = 20.0, 12
"""Times the range of the readings (and 1 degC) from which a free run has run away, and how often the strengths that it
begins with are halved then."""
REST_HEAT_SHARE = 0.95
"""The share of a model's own heat with a memory that acts at rest: all of it, as near as a share can be fitted."""
SLIGHT_HEAT_DEGC_PER_S = 3e-4
"""degC/s of rough heat: that of a slightly rough plant. A model's own heat that is less says nothing of what acts at
rest."""
MIN_REST_NOISE_RATIO = 0.02
"""Times the process noise while the machine runs that is believed of it at rest at least."""
MOVING_SHARE = 0.5
"""The share of readings that differ from the one before, up to which a course is a staircase."""
MIN_SCATTER = 1e-5
"""The relative scatter of the friction below which there is none."""
LIKELIER_NATS = 6.0
"""By which an earlier round of a fit is likelier than the last one where it is the fit."""
SETTLED_LOG_STEP = 0.05
"""The fit ends when no part of the noise moves by more than this (log)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """A fit: the free run `state`, the `noise` under which it is judged, and the linear problem around it.

    `residual` (m,) degC is measured - free run in windows, `columns` (m, p + r + e) the sensitivities there, `prior`
    (p + r + e,) the precision of the belief in each parameter, `off` how far the state lies from the belief's centre,
    `covariance` that of the parameters. `behind` is by how many rows what turns is known late, all of it together, and
    the standard error of that. `likelihood` is the restricted log-likelihood with the noise's belief.
    """

    frame: Frame
    state: CourseState
    start: Array
    noise: NoiseModel
    grid: Grid
    residual: Array
    columns: Array
    prior: Array
    off: Array
    covariance: Array
    behind: tuple[float, float]
    likelihood: float

    @property
    def turn_residual(self) -> Array:
        """(m,) degC the residual of a free run in which what turns between two rows turns `behind` the later one."""
        return self.residual - self.behind[0] / LATE_TOGETHER * self.grid.shared

    @property
    def timed_grid(self) -> Grid:
        """The grid with no more in it of what is late together than is not known of it."""
        return replace(self.grid, shared=self.behind[1] / LATE_TOGETHER * self.grid.shared)

    @property
    def own(self) -> int:
        """How many parameters are the model's own: p + r."""
        return sum(self.frame.count)

    def strength(self, name: str) -> tuple[float, float]:
        """(strength, standard error) of the effect of that name. Raises ValueError where the fit has none."""
        place = self.own
        for named in self.state.named:
            if named.entry.name == name:
                return named.strength, float(np.sqrt(max(self.covariance[place, place], 0.0)))
            place += len(named.free)
        raise ValueError(f"the fit has no effect {name!r}")

    @property
    def sensor_sigma(self) -> float:
        """degC the standard deviation of a single reading."""
        return float(self.noise.sensor * np.sqrt(averaged_readings(self.frame.record)))


def averaged_readings(record: Record) -> float:
    """How many readings the windows' means are worth in the mean square over all windows, the short ones after a switch
    among them; fewer where the sensor's error lasts."""
    count = np.diff(np.append(record.begins, record.rows.size))
    memory = record.model.sensor_memory
    if not memory:
        return 1.0 / float(np.mean(1.0 / count))
    # The variance of the mean of n readings whose neighbours are correlated by r (Bartlett 1946), as a share of one's:
    # repeat_factor / n for many of them, 1 for a single one.
    between = float(np.median(np.diff(record.runs.time[record.rows])))
    r, factor = np.exp(-max(between / memory, 1e-3)), repeat_factor(memory, between)
    share = (factor - 2.0 * r * (1.0 - r**count) / (count * (1.0 - r) ** 2)) / count
    return 1.0 / float(np.mean(share))


def readings_in_window(record: Record) -> float:
    """How many readings that err by themselves a usual window's mean is worth: fewer where the sensor's error lasts."""
    count = float(np.median(np.diff(np.append(record.begins, record.rows.size))))
    memory = record.model.sensor_memory
    between = float(np.median(np.diff(record.runs.time[record.rows]))) if memory else 0.0
    return count / repeat_factor(memory, between) if memory else count


def first_noise(model: Model, record: Record) -> NoiseModel:
    """The belief's centre: the given model's sensor, process and heat with a memory.

    A model without such heat is taken for that of a slightly rough plant, which it holds for white noise.
    """
    white, at_rest = stated_process(record)
    sensor = max(model.sensor_sigma, 0.02) / np.sqrt(readings_in_window(record))
    step = rounding_error(model, record)
    sensor = max(float(sensor), step)
    heats = of_feature(model.sha, "disturbance")
    still = min(max(at_rest / white, MIN_REST_NOISE_RATIO), 1.0)
    if not heats:
        return NoiseModel(
            sensor=sensor, process=white / 2, rough=SLIGHT_HEAT_DEGC_PER_S, cycle=0.01, still=still, lasting=step
        )
    learned = heats[0].params  # an automaton has one at most
    return NoiseModel(
        sensor=sensor,
        process=white,
        rough=max(learned["sigma"], LEAST_HEAT),
        cycle=0.01,
        memory=learned["memory"],
        rest=REST_HEAT_SHARE if learned["sigma"] >= SLIGHT_HEAT_DEGC_PER_S else 0.5,
        still=still,
        lasting=step,
    )


def window_belief(record: Record) -> WindowBelief:
    """What is believed of the noise before a record's windows are looked at."""
    return WindowBelief(first_noise(record.model, record), least=rounding_error(record.model, record))


def begin_noise(centre: NoiseModel) -> NoiseModel:
    """Where the search for the noise begins: at the belief's centre, but never from next to no rough heat.

    What is too little to be seen has no slope: the process noise would take all that a rough plant does.
    """
    return (
        centre
        if centre.rough >= SLIGHT_HEAT_DEGC_PER_S
        else replace(centre, rough=SLIGHT_HEAT_DEGC_PER_S, process=centre.process / 2)
    )


def with_reading_error(noise: NoiseModel, centre: NoiseModel) -> NoiseModel:
    """The noise of a fit of other cycles, with an error of the reading that lasts where these have one (`centre`)."""
    # Whether readings stand on the steps of their rounding is asked of each record: some of its cycles may, all do not.
    if (noise.lasting > 0) == (centre.lasting > 0):
        return noise
    return replace(noise, lasting=centre.lasting, fades=centre.fades)


def stated_process(record: Record) -> tuple[float, float]:
    """(while the machine runs, at rest) degC/sqrt(s): the process noise that the model states, the mean square over the
    steps of each; where it states none, or none of these steps are such, the other's."""
    locations = record.model.sha.locations
    # A constant flow holds a temperature of which nothing is known: its noise is that of not knowing.
    told = [location.flow.params.get("noise", 0.0) * (location.flow.kind != "constant") for location in locations]
    stated, running = np.array(told)[record.runs.place], record.running > 0.5
    found = []
    for those in (running, ~running):
        those = those & (stated > 0) & ~record.runs.first
        found.append(
            float(np.sqrt(np.average(stated[those] ** 2, weights=record.runs.dt[those]))) if those.any() else 0.0
        )
    white, at_rest = found
    white = white or at_rest or 0.006
    return white, at_rest or white


def rounding_error(model: Model, record: Record) -> float:
    """degC that rounding alone is off by in the mean of a window: 0 where the sensor's noise blurs the steps.

    Readings that stand on one step for a window's length are all wrong by the same; their mean is no better than one.
    """
    change = np.abs(np.diff(record.runs.reading[record.rows]))
    moves = change[change > 0]
    if moves.size == 0 or moves.size > MOVING_SHARE * change.size:
        return 0.0
    step = float(np.median(moves))
    # A rounding error spread evenly over one step has the standard deviation step / sqrt(12).
    return step / float(np.sqrt(12.0)) if model.sensor_sigma < step / 2.0 else 0.0


@dataclass(frozen=True, slots=True)
class _Tangent:
    """The linear problem around one state."""

    state: CourseState
    grid: Grid
    residual: Array
    columns: Array
    off: Array


def _tangent(frame: Frame, state: CourseState, start: Array, reading: Array, grid: Grid | None = None) -> _Tangent:
    """The linear problem around a state; `grid` is one that stands for the state's."""
    record = frame.record
    own = sum(frame.count)
    off = np.concatenate([state.parameters[:own] - frame.centre, np.zeros(state.parameters.size - own)])
    return _Tangent(
        state,
        window_grid(frame, state) if grid is None else grid,
        reading - record.window_means(state.mean),
        window_sensitivity(frame, state, start),
        off,
    )


def fit(
    frame: Frame,
    named: Sequence[Named] = (),
    begin: Fitted | None = None,
    *,
    moved: Array | None = None,
    rounds: int = ROUNDS,
    iterations: int = 12,
    hopeless: float = -np.inf,
) -> Fitted:
    """The fit with the effects `named`, from another fit on the same frame or from the belief.

    `moved` (p + r,) is by how much the other fit's own parameters are moved before. A fit that is no likelier than
    `hopeless` ends with the first round that is worse than the one before it.
    """
    record = frame.record
    reading = record.reading
    start = reading[record.window_first] if begin is None else begin.start
    own = frame.centre if begin is None else begin.state.parameters[: begin.own]
    own = own if moved is None else own + moved
    added = [value for effect in named for value in effect.point]
    prior = np.concatenate([frame.prior, np.zeros(len(added))])
    # Parameters under fixed noise, then the noise under fixed parameters, until the noise stands still: a wrong target
    # looks like a rough plant, and a rough plant hides a wrong target, so that neither is right after one round.
    belief = window_belief(record)
    noise = begin_noise(belief.centre) if begin is None else with_reading_error(begin.noise, belief.centre)
    first = _clip_strengths(named, np.concatenate([own, added]))
    point = _tangent(frame, run_frame(frame, first, start, named), start, reading)
    # The linear problem knows no end of a loss: where less of it than none was asked for, less of the effect is begun
    # with.
    for _ in range(SOFTENED):
        if not _diverges(point.residual, reading):
            break
        first = _clip_strengths(named, np.concatenate([own, _halve_strengths(named, first[own.size :])]))
        point = _tangent(frame, run_frame(frame, first, start, named), start, reading)
    cost, best = np.inf, None
    for _ in range(rounds):
        moved_point = _newton_steps(frame, point, start=start, reading=reading, noise=noise, prior=prior)
        fitted_noise, moved_cost = fit_local_noise(moved_point, frame, belief, noise, iterations)
        # Where the linear problem does not describe the plant, further rounds only lead further astray.
        if moved_cost > cost > -hopeless:
            break
        settled = largest_change(noise, fitted_noise) < SETTLED_LOG_STEP
        point, noise, cost = moved_point, fitted_noise, moved_cost
        if best is None or cost < best[2]:
            best = point, noise, cost
        if settled:
            break
    # Steps under a noise that is wrong may lead away, and the noise then follows: what was likelier by far stays.
    if best is not None and cost > best[2] + LIKELIER_NATS:
        point, noise, cost = best
    return _finish_fit(frame, point, start=start, noise=noise, prior=prior, cost=cost)


def given_model_fit(fitted: Fitted) -> Fitted:
    """The given model's own numbers on the same record, none of them fitted; the noise is that of greatest likelihood
    beside them."""
    frame, named = fitted.frame, model_effects(fitted.frame.record.model)
    record = frame.record
    numbers = np.concatenate([frame.centre, *(np.array(each.point) for each in named)])
    prior = np.concatenate([frame.prior, np.zeros(numbers.size - frame.centre.size)])
    point = _tangent(frame, run_frame(frame, numbers, fitted.start, named), fitted.start, record.reading)
    belief = window_belief(record)
    noise, cost = fit_local_noise(point, frame, belief, fitted.noise, 12)
    return _finish_fit(frame, point, start=fitted.start, noise=noise, prior=prior, cost=cost)


def without_last(fitted: Fitted) -> Fitted:
    """The linear problem at a fit's parameters and noise without the last of its effects; nothing of it is fitted."""
    frame, named = fitted.frame, fitted.state.named[:-1]
    numbers = fitted.state.parameters[: fitted.state.parameters.size - len(fitted.state.named[-1].free)]
    state = run_frame(frame, numbers, fitted.start, named)
    point = _tangent(frame, state, fitted.start, frame.record.reading)
    prior = fitted.prior[: numbers.size]
    return _finish_fit(frame, point, start=fitted.start, noise=fitted.noise, prior=prior, cost=np.inf)


def slim(fitted: Fitted) -> Fitted:
    """The fit without what its free run gives again (`restore_fit`): of many fits of a long record, most of the
    memory."""
    state, nothing = fitted.state, np.empty(0)
    bare = replace(state, mean=nothing, decay=nothing, k=nothing, target=nothing, loss=nothing, heat=nothing)
    return replace(fitted, state=bare, grid=replace(fitted.grid, heats=np.empty((0, 0))))


def restore_fit(fitted: Fitted) -> Fitted:
    """A fit that may be `slim`, whole."""
    before = fitted.state
    if before.mean.size:
        return fitted
    state = run_frame(fitted.frame, before.parameters, fitted.start, before.named, before.course)
    return replace(fitted, state=state, grid=window_grid(fitted.frame, state))


def _finish_fit(frame: Frame, point: _Tangent, *, start: Array, noise: NoiseModel, prior: Array, cost: float) -> Fitted:
    gram = Whitener(point.grid, noise).gram(np.column_stack([point.grid.shared, point.residual, point.columns]))
    covariance = np.asarray(np.linalg.inv(gram[2:, 2:] + np.diag(np.maximum(prior, 1e-12))), dtype=float)
    return Fitted(
        frame=frame,
        state=point.state,
        start=start,
        noise=noise,
        grid=point.grid,
        residual=point.residual,
        columns=point.columns,
        prior=prior,
        off=point.off,
        covariance=covariance,
        behind=_turn_delay(gram, covariance),
        likelihood=-cost,
    )


def _turn_delay(gram: Array, covariance: Array) -> tuple[float, float]:
    """(rows by which what turns is known late together, the standard error), of the Gram matrix of what it does if it
    is as believed, of the residual and of the parameters."""
    # The mean of a standard normal strength given the residual; its variance is what the readings leave open, and what
    # the parameters, which are not sure either, do to it.
    size = float(gram[0, 1])
    open_ = max(1.0 - float(gram[0, 0]) + float(gram[0, 2:] @ covariance @ gram[2:, 0]), 0.0)
    # No recorder knows what turns before it does, nor later than at the row that shows it.
    return float(np.clip(LATE_TOGETHER * size, 0.0, 1.0)), LATE_TOGETHER * float(np.sqrt(open_))


def fit_local_noise(
    point: _Tangent, frame: Frame, belief: WindowBelief, noise: NoiseModel, iterations: int
) -> tuple[NoiseModel, float]:
    """(the noise of greatest restricted likelihood around a point, minus that likelihood), searched from `noise`."""
    # Only the model's own parameters are integrated out. The strengths of the effects are maximised, so that fits with
    # different effects have the same integral and their likelihoods differ by what the effects explain.
    own = sum(frame.count)
    columns, prior, off = point.columns[:, :own], frame.prior, point.off[:own]
    grid, spans = point.grid, column_spans(point.grid.heats)

    def cost(trial: NoiseModel) -> tuple[float, Derivatives]:
        value, derivatives = restricted_likelihood(
            Whitener(grid, trial, spans=spans), columns, point.residual, prior, off
        )
        return -value, derivatives

    return fit_noise(cost, belief, noise, iterations)


def with_heats(before: Fitted, heats: Array, iterations: int = 8) -> Fitted:
    """The fit with further random heats in its noise, which is fitted anew; its course stays.

    `heats` (m, c) degC is what a heat of one standard deviation of each does to the windows, at the noise's `cycle`:
    they scatter together with the cycles' friction.
    """
    columns = np.column_stack([before.grid.heats, heats / max(before.noise.cycle, MIN_SCATTER)])
    # In the order in which they begin, as the cycles are.
    begins = np.where((columns != 0.0).any(axis=0), np.argmax(columns != 0.0, axis=0), columns.shape[0])
    grid = replace(before.grid, heats=columns[:, np.argsort(begins, kind="stable")])
    frame, record = before.frame, before.frame.record
    belief = window_belief(record)
    point = _Tangent(before.state, grid, before.residual, before.columns, before.off)
    noise, cost = fit_local_noise(point, frame, belief, before.noise, iterations)
    return replace(before, grid=grid, noise=noise, likelihood=-cost)


def with_column(before: Fitted, column: Array, rounds: int = 2) -> tuple[Fitted, float]:
    """(The fit with `column` (m,) degC, times its likeliest strength, taken out of its residual; that strength).

    The noise is fitted anew, the parameters make room in the linear problem, and the course stays.
    """
    frame, record = before.frame, before.frame.record
    belief = window_belief(record)
    noise, strength, cost = before.noise, 0.0, 0.0
    prior, off = np.append(np.maximum(before.prior, 1e-12), 0.0), np.append(before.off, 0.0)
    columns = np.column_stack([before.residual, before.columns, column])
    for _ in range(rounds):
        gram = Whitener(before.grid, noise).gram(columns)
        strength = float(np.linalg.solve(gram[1:, 1:] + np.diag(prior), gram[1:, 0] - prior * off)[-1])
        point = _Tangent(before.state, before.grid, before.residual - strength * column, before.columns, before.off)
        noise, cost = fit_local_noise(point, frame, belief, noise, 8)
    return replace(before, residual=point.residual, noise=noise, likelihood=-cost), strength


def largest_change(before: NoiseModel, after: NoiseModel) -> float:
    """The change of the part that moved most, in logarithms; the share at rest (a logit) is not asked."""
    pairs = zip(
        (before.sensor, before.process, before.rough, before.cycle, before.memory),
        (after.sensor, after.process, after.rough, after.cycle, after.memory),
        strict=True,
    )
    lasts = [(before.lasting, after.lasting), (before.fades, after.fades)] if after.lasting > 0 else []
    return max(abs(float(np.log(new / old))) for old, new in (*pairs, *lasts))


def _newton_steps(
    frame: Frame, point: _Tangent, *, start: Array, reading: Array, noise: NoiseModel, prior: Array
) -> _Tangent:
    """A few damped Gauss-Newton steps (Nocedal & Wright 2006, ch. 10): a step limit, then backtracking.

    The penalised squares r' V^-1 r + (b - b0)' P (b - b0) go down with every step that is taken. Second derivatives are
    left out: the free run is linear in most parameters, and its residual is small where it matters. The covariance is
    that of the windows around the first state, or no square could be held against another.
    """
    first, whitener = point.state, Whitener(point.grid, noise)
    for _ in range(NEWTON):
        state = point.state
        gram = whitener.gram(np.column_stack([point.residual, point.columns]))
        normal = gram[1:, 1:] + np.diag(np.maximum(prior, 1e-12))
        root = lower_root(normal)
        if root is None:
            break
        score = gram[1:, 0] - prior * point.off
        step = scipy.linalg.cho_solve((root, True), score)
        # Newton's decrement (Boyd & Vandenberghe 2004, section 9.5.1): by so much the squares would go down.
        if float(score @ step) < ENOUGH_SQUARES:
            break
        # The whole step is shortened, not single parts of it: it must stay a descent direction.
        strengths = [size for named in state.named for size in _longest(named)]
        longest = np.concatenate([LARGEST_TARGET / TARGET_SPREAD / np.sqrt(frame.prior), strengths])
        step = step * min(1.0, 1.0 / float(np.max(np.abs(step) / longest, initial=1.0)))
        # Backtracking, five lengths at most. If none helps, the linear problem does not describe the plant here.
        before = float(gram[0, 0] + point.off @ (prior * point.off))
        for _half in range(5):
            moved = run_frame(
                frame, _clip_strengths(state.named, state.parameters + step), start, state.named, state.course
            )
            residual = reading - frame.record.window_means(moved.mean)
            off = point.off + np.where(np.arange(step.size) < sum(frame.count), step, 0.0)
            # Squares of what has run away would overflow.
            lost, after = _diverges(residual, reading), np.inf
            if not lost:
                after = float(whitener.gram(residual[:, None])[0, 0] + off @ (prior * off))
                lost = not np.isfinite(after)
            if not lost and after <= before + 1e-6:
                break
            step = 0.5 * step
        if lost or after > before:
            break
        point = _tangent(frame, moved, start, reading, point.grid)
        if before - after < ENOUGH_SQUARES:
            break
    return point if point.state is first else replace(point, grid=window_grid(frame, point.state))


def _diverges(residual: Array, reading: Array) -> bool:
    """Whether a free run has left the readings as no plant does: a sign in front of a loss that is less than none."""
    return not bool(np.max(np.abs(residual), initial=0.0) <= RUNAWAY * (np.ptp(reading) + 1.0))


def _halve_strengths(effects: Sequence[Named], point: Array) -> Array:
    """The parameters of effects with half of each strength."""
    out, number = point.copy(), 0
    for named in effects:
        out[number] *= 0.5
        number += len(named.free)
    return out


def _longest(named: Named) -> list[float]:
    """How far a step of Newton's may move the free parameters of an effect."""
    return [max(LARGEST_SHARE * abs(named.strength), 1e-15), *[MAX_THRESHOLD_STEP_DEGC] * (len(named.free) - 1)]


def _clip_strengths(effects: Sequence[Named], point: Array) -> Array:
    """The point with strengths of the wrong sign put to a tiny one of the right sign: a loss below 0 runs away."""
    out = point.copy()
    number = point.size - sum(len(named.free) for named in effects)
    # A strength at 0 or beyond would stay there: the sensitivity to an effect that is off tells nothing of its shape.
    for named in effects:
        least = 1e-3 * abs(named.strength)
        if named.entry.sign > 0:
            out[number] = min(max(out[number], least), named.entry.candidate.most)
        number += len(named.free)
    return out


def lower_root(matrix: Array) -> Array | None:
    """The lower Cholesky factor of a symmetric matrix; None where it is not positive definite (LAPACK's `potrf`)."""
    if not np.isfinite(matrix).all():
        return None
    root, failed = scipy.linalg.lapack.dpotrf(matrix, lower=True)
    return None if failed else np.asarray(root)


def restricted_likelihood(
    whitener: Whitener, columns: Array, residual: Array, prior: Array, off: Array
) -> tuple[float, Derivatives]:
    """The log-likelihood with the parameters integrated out around the free run (their belief included), and what makes
    the slopes of minus that by the noise's coordinates (`noise.vector`), with its average information."""
    # Laplace's integral, exact for the linear problem around the free run: with N = C' V^-1 C + P the parameters'
    # posterior precision and g the score at the state, -2 ln L = ln |V| + ln |N| - ln |P| + misfit - g' N^-1 g.
    half = whitener.half_weigh(np.column_stack([residual, columns]))
    gram = half.products(half)
    score = gram[1:, 0] - prior * off
    root = lower_root(gram[1:, 1:] + np.diag(prior))
    if root is None:
        # A candidate that has run away (less cooling than none at all: the free run grows) explains nothing.
        size = vector(whitener.noise).size
        return -np.inf, lambda: (np.zeros(size), np.eye(size))
    best = scipy.linalg.cho_solve((root, True), score)
    misfit = float(gram[0, 0] + off @ (prior * off) - score @ best)
    determinant = 2.0 * float(np.log(np.diag(root)).sum()) - float(np.log(prior).sum())

    def derivatives() -> tuple[Array, Array]:
        # d ln |N| = tr(N^-1 C' dV^-1 C): the columns C R^-T, with N = R R', each weighed by itself. The misfit's
        # derivative is that of the residual left by the best parameters, which are where it does not change with them.
        mixing = np.zeros((1 + best.size, best.size + 1))
        mixing[1:, :-1] = scipy.linalg.solve_triangular(root, np.eye(best.size), lower=True, trans="T")
        mixing[:, -1] = np.append(1.0, -best)
        mixed = half.mix(mixing)
        slopes, pulls = whitener.slopes(mixed)
        # The average of observed and expected information needs no trace: D' P D / 2 of the pulls D = dV P r, with P
        # the inverse covariance that has the parameters taken out.
        pulled = whitener.half_weigh(pulls)
        with_columns = pulled.products(mixed)[:, :-1]
        return 0.5 * slopes, 0.5 * (pulled.products(pulled) - with_columns @ with_columns.T)

    return -0.5 * (whitener.logdet + determinant + misfit), derivatives
