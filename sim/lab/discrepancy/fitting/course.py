"""The free run of a model with effects over a record: its mean course in closed steps, its reading, its derivatives.

Over a step the drift is k (target - X) + heat - loss X, so a loss counts to the rate and a heat to the target. Effects
whose heat or loss depends on the course (a housing, a thermostat, radiation) are iterated from the course before until
it stands still; the iteration contracts because what they add is fed back through a relaxation.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dtbtrs

from sim.effects import Structural, effect_kind, heat_lag, is_gradual
from sim.engine import linear_recursion
from sim.lab.discrepancy.fitting.baseline import Frame
from sim.lab.discrepancy.fitting.effects import (
    deviation,
    follows_course,
    heat_and_loss,
    housing_coupling,
    late_inrush,
    on_sensor,
    sense_course,
)
from sim.lab.discrepancy.fitting.named import Named, automaton_effects
from sim.lab.discrepancy.fitting.noise import Grid, decay_and_pull
from sim.lab.discrepancy.fitting.record import Record
from sim.lab.learning import Indices, load, relaxing_rates, steps, targets
from sim.sha import Array, Effect

ITERATIONS, STILL = 60, 1e-6
"""Passes at most, and the change (degC) below which a course stands still."""
TAIL_CYCLES = 4
"""Cycles over which the heat of one is followed, itself included: about a day."""

LATE_TOGETHER, LATE_APART = 0.5, 12.0**-0.5
"""Rows by which all switches are late together, and each by itself (standard deviations): uniform within a row, whose
second moment 1/3 is (1/2)^2 + 1/12. Together, because a recorder that samples is half a row late in the mean, while
one whose rows are the switches' own times is not late at all."""


@dataclass(frozen=True, slots=True)
class CourseState:
    """The free run at one set of parameters: `linear` (p,), `log_rates` (r,), the effects' `strengths` (e,).

    `course` (n,) degC is the bearing at the knots, `mean` (n,) what the sensor would read of it without noise. Of each
    step: `k` (n,) 1/s the flow's own rate (0 where it does not relax), `loss` (n,) what effects add to it, `decay` and
    `target` (n,) those of the flow without effects, `heat` (n,) degC/s what effects heat.
    """

    linear: Array
    log_rates: Array
    named: tuple[Named, ...]
    course: Array
    mean: Array
    decay: Array
    k: Array
    target: Array
    loss: Array
    heat: Array

    @property
    def drive(self) -> Array:
        """(n,) degC/s what moves the temperature in each step, but for what it loses by itself."""
        own = np.where(self.k > 0, self.k * self.target, np.where(self.decay == 1.0, self.target, 0.0))
        return np.asarray(own + self.heat)

    @property
    def parameters(self) -> Array:
        """(p + r + e,) all of them as one vector."""
        return np.concatenate([self.linear, self.log_rates, *(named.point for named in self.named)])


def run_free(
    frame: Frame, linear: Array, log_rates: Array, start: Array, named: Sequence[Named] = (), guess: Array | None = None
) -> CourseState:
    """The mean course from the start temperatures (R,), one for each run; `guess` (n,) is a course to iterate from."""
    runs = frame.record.runs
    first = runs.first
    decay, pull = steps(runs, frame.shape, log_rates)
    target = targets(runs, frame.shape, linear)
    k = relaxing_rates(runs, frame.shape, np.exp(log_rates))
    effects = [effect for each in named for effect in automaton_effects(each, frame.record.model)]
    heating = [effect for effect in effects if not on_sensor(effect)]
    # A run's first row has decay 0, so that one recursion serves all runs: what is pushed there is the start itself.
    push = pull * target
    push[first] = start
    course = linear_recursion(decay, push, 0.0)
    loss, heat = np.zeros(len(runs)), np.zeros(len(runs))
    if heating:
        flow = (decay, np.where(first, start[np.cumsum(first) - 1], push), k)
        course, loss, heat = _drive(frame, heating, flow, course if guess is None else guess)
    mean = _sense(frame, named, course)
    return CourseState(
        linear=linear,
        log_rates=log_rates,
        named=tuple(named),
        course=course,
        mean=mean,
        decay=decay,
        k=k,
        target=target,
        loss=loss,
        heat=heat,
    )


def _drive(
    frame: Frame, effects: Sequence[Effect], flow: tuple[Array, Array, Array], course: Array
) -> tuple[Array, Array, Array]:
    """(course, loss, heat) with the effects; `flow` is (decay, what the flow adds, k) without them."""
    record = frame.record
    runs = record.runs
    first = runs.first
    _, own_push, k = flow
    _, own_pull = decay_and_pull(k, runs.dt)
    # The flow's own push is that of a constant heat over the step, so that heats add up and losses join the rate.
    own_heat = np.where(first, 0.0, own_push / np.maximum(own_pull, 1e-12))
    followed = any(follows_course(effect) for effect in effects)
    for _ in range(ITERATIONS):
        loss, heat = np.zeros(len(runs)), own_heat.copy()
        # Heat that depends on the course is taken at the middle of the step: second order in dt, as the trapezoid is.
        middle = midway(frame, course)
        for effect in effects:
            added, lost = heat_and_loss(record, effect, middle)
            loss += lost
            heat += added
        # A cooling that grows less ends at none: beyond it, in cycles that were never fitted, the course would explode.
        loss = np.maximum(loss, -k)
        decay, pull = decay_and_pull(k + loss, runs.dt)
        before = course
        course = linear_recursion(np.where(first, 0.0, decay), np.where(first, own_push, pull * heat), 0.0)
        if not followed or not np.isfinite(course).all() or np.max(np.abs(course - before)) < STILL:
            break
    return course, loss, heat - own_heat


def midway(frame: Frame, course: Array) -> Array:
    """(n,) degC a course at the middle of each step."""
    return np.where(frame.record.runs.first, course, 0.5 * (course + np.concatenate([course[:1], course[:-1]])))


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowResponse:
    """What pushes (n,) degC at the knots of a linear course do to the means of its windows, without the course itself.

    A window's mean is a sum over its knots, by `share` (n,), and what the temperature at the end of the window before
    leaves there, `carried` (m,); that end is such a sum, too, by `left` (n,), and `kept` (m,). So the recursion is over
    windows alone, once the products within each are known. `begins` (m,) are the windows' first knots.
    """

    begins: Indices
    share: Array
    left: Array
    carried: Array
    kept: Array

    def means(self, pushes: Array) -> Array:
        """(m,) degC."""
        own, end = (np.add.reduceat(pushes[: weight.size] * weight, self.begins) for weight in (self.share, self.left))
        ends = linear_recursion(self.kept, end, 0.0)
        own[1:] += self.carried[1:] * ends[:-1]
        return own


def window_response(record: Record, decay: Array) -> WindowResponse:
    """The response of a course that keeps the share `decay` (n,) of itself over each step."""
    last = record.rows[np.append(record.begins[1:], record.rows.size) - 1]
    begins, knots = np.append(0, last[:-1] + 1), int(last[-1]) + 1  # none after the last reading is in a window
    counts = np.diff(np.append(record.begins, record.rows.size))
    read, ends = np.zeros(knots), np.zeros(knots)
    read[record.rows], ends[last] = 1.0, 1.0
    # From each knot on to the end of its window, backwards: how often what is there is read, and what is left at last.
    onward = np.append(decay[1:knots], 0.0)
    onward[last] = 0.0
    share, left = (linear_recursion(onward[::-1], each[::-1], 0.0)[::-1] for each in (read, ends))
    share = share / np.repeat(counts, np.diff(np.append(begins, knots)))
    return WindowResponse(
        begins=begins,
        share=share,
        left=np.ascontiguousarray(left),
        carried=decay[begins] * share[begins],
        kept=decay[begins] * left[begins],
    )


def heat_response(frame: Frame, state: CourseState) -> Callable[[Array], Array]:
    """What makes of a heat (n,) in degC/s, held over each step, what it adds to the windows' readings (m,) degC."""
    record = frame.record
    runs = record.runs
    decay, pull = decay_and_pull(state.k + state.loss, runs.dt)
    decay, pull = np.where(runs.first, 0.0, decay), np.where(runs.first, 0.0, pull)
    if _reads_late(state):
        return lambda heat: record.window_means(sensor_view(frame, state, linear_recursion(decay, pull * heat, 0.0)))
    response = window_response(record, decay)
    return lambda heat: response.means(pull * heat)


def _reads_late(state: CourseState) -> bool:
    """Whether the sensor shows the temperature later than it is."""
    return any(named.entry.whole for named in state.named)


def window_sensitivity(frame: Frame, state: CourseState, start: Array) -> Array:
    """(m, p + r + e) derivative of the windows' readings by every parameter of the state; the start is held.

    In closed form: the course's own recursion, driven by the change of its coefficients. Only a valve that switches has
    none, since it opens a row earlier or does not; it is told by differences of the simulation itself.
    """
    # Column by column: at the knots all of them together would be most of the memory that a diagnosis takes.
    return np.column_stack(list(_window_sensitivities(frame, state, start)))


def _window_sensitivities(frame: Frame, state: CourseState, start: Array) -> Iterator[Array]:
    """The columns (m,), one parameter after the other."""
    record = frame.record
    effects = [effect for named in state.named for effect in automaton_effects(named, record.model)]
    if any(effect_kind(effect).law == VALVE and not is_gradual(effect) for effect in effects):
        yield from (record.window_means(column) for column in _by_differences(frame, state, start))
        return
    heating = any(not on_sensor(effect) for effect in effects)
    here = _linear_steps(frame, state.log_rates, state.loss if heating else None)
    carried = _carrier(frame, state, effects, here)
    for forcing, read in _forcings(frame, state, here, heating=heating):
        column = carried(forcing)
        yield column if read is None else column + record.window_means(read)


def _forcings(
    frame: Frame, state: CourseState, here: "_LinearSteps", *, heating: bool
) -> Iterator[tuple[Array, Array | None]]:
    """What each parameter changes (n,) of a step's end, and of the reading at once (None: nothing)."""
    p, r = frame.count
    for number in range(p):
        yield here.pull * load(frame.record.runs, frame.shape, number), None
    if r:
        loss = state.loss if heating else None
        group = np.append(frame.shape.rate, -1)[frame.record.runs.place]
        up, down = (_linear_steps(frame, state.log_rates + sign * LOG_RATE_STEP, loss) for sign in (1, -1))
        by_rate = (_step_targets(up, state, state.heat) - _step_targets(down, state, state.heat)) / (2 * LOG_RATE_STEP)
        for number in range(r):
            yield np.where(group == number, by_rate, 0.0), None
    yield from _by_strengths(frame, state, here)


LOG_RATE_STEP = 1e-4
"""By how much a log(rate) is moved for the derivative of a step's coefficients."""
VALVE, HOUSING = Structural("thermostat"), Structural("housing")


@dataclass(frozen=True, slots=True)
class _LinearSteps:
    """Of each step (n,): `decay`, and what a heat of 1 degC/s (`heated`) and a target of 1 degC (`pull`) add."""

    decay: Array
    heated: Array
    pull: Array


def _linear_steps(frame: Frame, log_rates: Array, loss: Array | None) -> _LinearSteps:
    """The steps of `run_free` at other rates, with what effects lose (None: none of them heats)."""
    runs = frame.record.runs
    decay, pull = steps(runs, frame.shape, log_rates)
    if loss is None:
        return _LinearSteps(decay, np.zeros(len(runs)), pull)
    k = relaxing_rates(runs, frame.shape, np.exp(log_rates))
    _, own = decay_and_pull(k, runs.dt)
    decay, heated = decay_and_pull(k + loss, runs.dt)
    decay, heated = np.where(runs.first, 0.0, decay), np.where(runs.first, 0.0, heated)
    return _LinearSteps(decay, heated, heated * pull / np.maximum(own, 1e-12))


def _step_targets(moved: _LinearSteps, state: CourseState, heat: Array) -> Array:
    """(n,) degC to which each step would lead from where the state has it begin; nothing where a run begins."""
    before = np.concatenate([[0.0], state.course[:-1]])
    return np.asarray(moved.decay * before + moved.heated * heat + moved.pull * state.target)


def _by_strengths(frame: Frame, state: CourseState, here: _LinearSteps) -> Iterator[tuple[Array, Array | None]]:
    """What each free parameter of the effects changes (n,) of a step's end, and of the reading at once (None: nothing).

    The temperature along which an effect heats is held: what follows it comes in by `_carrier`.
    """
    record = frame.record
    middle, pushed = midway(frame, state.course), _step_targets(here, state, state.heat)
    for number, named in enumerate(state.named):
        was = _heats(frame, named, middle)
        for place, size in enumerate(_derivative_steps(named)):
            moved = named.with_point([value + size * (place == other) for other, value in enumerate(named.point)])
            heat, loss = (new - old for new, old in zip(_heats(frame, moved, middle), was, strict=True))
            changed, shown = np.zeros(len(record.runs)), None
            if np.any(heat) or np.any(loss):
                trial = _linear_steps(frame, state.log_rates, state.loss + loss) if np.any(loss) else here
                changed = (_step_targets(trial, state, state.heat + heat) - pushed) / size
            if any(on_sensor(effect) for effect in automaton_effects(moved, record.model)):
                chain = [*state.named[:number], moved, *state.named[number + 1 :]]
                shown = (_sense(frame, chain, state.course) - state.mean) / size
            yield changed, shown


def _heats(frame: Frame, named: Named, middle: Array) -> tuple[Array, Array]:
    """(heat, loss) of each step by one effect along a temperature (n,) degC."""
    heat, loss = np.zeros(middle.size), np.zeros(middle.size)
    for effect in automaton_effects(named, frame.record.model):
        if not on_sensor(effect):
            added, lost = heat_and_loss(frame.record, effect, middle)
            heat, loss = heat + added, loss + lost
    return heat, loss


def _sense(frame: Frame, named: Sequence[Named], course: Array) -> Array:
    """(n,) degC what the sensor reads of a course."""
    for effect in (effect for each in named for effect in automaton_effects(each, frame.record.model)):
        if on_sensor(effect):
            course = sense_course(frame.record, effect, course)
    return course


def _carrier(
    frame: Frame, state: CourseState, effects: Sequence[Effect], here: _LinearSteps
) -> Callable[[Array], Array]:
    """What makes of pushes (n,) degC the windows' readings (m,) degC, with what a housing gives back of them."""
    record, runs = frame.record, frame.record.runs
    housings = [effect for effect in effects if effect_kind(effect).law == HOUSING]
    if not housings and not _reads_late(state):
        return window_response(record, here.decay).means
    if not housings:
        return lambda forcing: record.window_means(
            sensor_view(frame, state, linear_recursion(here.decay, forcing, 0.0))
        )
    coupling = sum(housing_coupling(record, effect) for effect in housings)
    # x = decay x' + push (coupling y) + forcing and y = keep y' + (1 - keep) (x + x') / 2, y = x where a run begins:
    # one lower band of the unknowns (x, y) of each knot, with y for a share of x put in at the step's end.
    keep = np.exp(-runs.dt / housings[0].params["tau"])
    half, back = 0.5 * (1.0 - keep), here.heated * coupling
    own = np.where(runs.first, 0.0, half * back)
    bands = np.zeros((4, 2 * len(runs)), order="F")
    bands[0, 0::2], bands[0, 1::2] = 1.0 - own, 1.0
    bands[1, 0::2] = np.where(runs.first, -1.0, -half)
    bands[1, 1:-1:2] = -(back * keep)[1:]
    bands[2, 0:-2:2] = -(here.decay + half * back)[1:]
    bands[2, 1:-2:2] = np.where(runs.first, 0.0, -keep)[1:]
    bands[3, 0:-2:2] = np.where(runs.first, 0.0, -half)[1:]

    def carry(forcing: Array) -> Array:
        right = np.zeros(2 * len(runs))
        right[0::2] = forcing
        solved, _ = dtbtrs(bands, right, uplo="L", overwrite_b=True)
        return record.window_means(sensor_view(frame, state, np.asarray(solved[0::2])))

    return carry


def _by_differences(frame: Frame, state: CourseState, start: Array) -> Iterator[Array]:
    """The sensitivities at the knots by finite differences of the simulation itself."""
    # One more free run each, begun from the course at hand, so that only the change is iterated.
    point = state.parameters
    strengths = [size for named in state.named for size in _derivative_steps(named)]
    for number, size in enumerate(
        [*(1e-3 * frame.shape.spread).tolist(), *[1e-3] * frame.shape.rate_spread.size, *strengths]
    ):
        moved = point.copy()
        moved[number] += size
        trial = run_frame(frame, moved, start, state.named, state.course)
        yield (trial.mean - state.mean) / size


def _derivative_steps(named: Named) -> list[float]:
    """By how much each free parameter of an effect is moved for a derivative: its strength by a share, thresholds in
    degC."""
    return [max(1e-3 * abs(named.strength), 1e-18), *[0.01] * (len(named.free) - 1)]


def run_frame(
    frame: Frame, point: Array, start: Array, named: Sequence[Named], guess: Array | None = None
) -> CourseState:
    """The free run at a vector of all parameters (p + r + e,)."""
    p, r = frame.count
    ends = np.cumsum([p + r, *(len(effect.free) for effect in named)]).tolist()
    moved = [effect.with_point(point[a:b].tolist()) for effect, (a, b) in zip(named, pairwise(ends), strict=True)]
    return run_free(frame, point[:p], point[p : p + r], start, named=moved, guess=guess)


def window_grid(frame: Frame, state: CourseState) -> Grid:
    """The windows of the frame's record as the noise sees them around a state.

    What is rough reaches the reading as late as the rest: heat that came with the start at once, beside one that comes
    late, would be played against it.
    """
    rate, running = (sensor_view(frame, state, column) for column in (state.k + state.loss, frame.record.running))
    late = lateness(frame, state)

    def windows(jumps: Array) -> Array:
        return frame.record.window_means(sensor_view(frame, state, jump_response(frame, state, jumps)))

    return frame.record.grid(
        rate,
        running,
        scatter_response(frame, state),
        jumps=(LATE_APART * late) ** 2,
        shared=windows(LATE_TOGETHER * late),
        inrush=windows(inrush(frame, state)),
    )


def unseen_switches(frame: Frame, state: CourseState, known_s: float, unsure: float) -> Array:
    """(m,) degC^2 the variance of the windows by what turned somewhere in a row and is known from its end on, as far as
    rows that take no longer than `known_s` (s) would not have it too; `unsure` rows are not known of what all are late.
    """
    late = lateness(frame, state, known_s)
    decay, _ = decay_and_pull(state.k + state.loss, frame.record.runs.dt)
    decay = np.where(frame.record.runs.first, 0.0, decay)
    apart = frame.record.window_means(linear_recursion(decay**2, (LATE_APART * late) ** 2, 0.0))
    shared = frame.record.window_means(sensor_view(frame, state, jump_response(frame, state, unsure * late)))
    return np.asarray(apart + shared**2)


def lateness(frame: Frame, state: CourseState, known_s: float = 0.0) -> Array:
    """(n,) degC by which the course would be off from each knot on, had what turned at it (`Record.turned`) come a row
    earlier; of the row's length (its square) without what a row of `known_s` (s) hides as well.

    What changes between two rows is known from the later one on. It happened somewhere in the row, so that the
    temperature there is off by the change of the drift times a time between nothing and the row's length. Only at rows:
    an event with a time of its own is known to it.
    """
    record, runs = frame.record, frame.record.runs
    change = np.append(np.diff(state.drive) - np.diff(state.k + state.loss) * state.course[:-1], 0.0)
    within = record.turned & np.append(~runs.first[1:], False) & ~runs.first & np.isfinite(runs.reading)
    return np.asarray(np.where(within, change * np.sqrt(np.maximum(runs.dt**2 - known_s**2, 0.0)), 0.0))


def inrush(frame: Frame, state: CourseState) -> Array:
    """(n,) degC by which each knot would be off, had the drive of a start's first seconds been that after them.

    A motor that starts draws several times its current, which turns the drum and is no load: what laws of the current
    say of it is known of no model. A row that falls into it has it for the row's whole length besides. What laws say of
    it comes late where their heat does.
    """
    record, runs = frame.record, frame.record.runs
    settled = np.flatnonzero(~record.rushed)
    if not record.rushed.any() or not settled.size:
        return np.zeros(len(runs))
    place = np.searchsorted(settled, np.arange(len(runs)))
    after = settled[np.minimum(place, settled.size - 1)]
    known = record.rushed & (place < settled.size) & (record.running[after] > 0.5) & (runs.run[after] == runs.run)
    effects = [effect for named in state.named for effect in automaton_effects(named, record.model)]
    late = [effect for effect in effects if not on_sensor(effect) and heat_lag(effect) > 0]
    at_once = state.drive - sum((deviation(record, effect) for effect in late), np.zeros(len(runs)))
    beyond = sum((late_inrush(record, effect) for effect in late), np.zeros(len(runs)))
    return np.asarray(np.where(known, at_once - at_once[after], 0.0) * runs.dt + beyond * runs.dt)


def row_later(frame: Frame, state: CourseState) -> Array:
    """(n,) degC by which the reading would be off, had all that turns between two rows turned a row earlier."""
    return sensor_view(frame, state, jump_response(frame, state, lateness(frame, state)))


def jump_response(frame: Frame, state: CourseState, jumps: Array) -> Array:
    """(n,) degC what jumps (n,) of the bearing's temperature at the knots leave of themselves."""
    runs = frame.record.runs
    decay, _ = decay_and_pull(state.k + state.loss, runs.dt)
    return np.asarray(linear_recursion(np.where(runs.first, 0.0, decay), jumps, 0.0))


def scatter_response(frame: Frame, state: CourseState) -> Array:
    """(m, cycles) degC what a scatter of 1 of each cycle's friction heat does to the windows' readings.

    Formed at the knots and through the sensor, as the sensitivities of the parameters are. What is only nearly alike
    would be played against them, to make up for what is missing at starts and stops. What a cycle leaves behind is
    followed through the next ones of TAIL_CYCLES.
    """
    record, runs = frame.record, frame.record.runs
    cycles, order = np.unique(record.cycle, return_inverse=True)
    decay, pull = decay_and_pull(state.k + state.loss, runs.dt)
    heat = np.where(runs.first, 0.0, pull * friction_heat(frame, state))
    # A column for each cycle would cost a recursion each; TAIL_CYCLES of them, each of every TAIL_CYCLES-th cycle, are
    # enough.
    begins = np.diff(order, prepend=-1) != 0
    followed = []
    for group in range(
        TAIL_CYCLES
    ):  # cycles so far apart share a column: what one of them leaves is dropped at the next
        own = order % TAIL_CYCLES == group
        response = linear_recursion(np.where(runs.first | (begins & own), 0.0, decay), np.where(own, heat, 0.0), 0.0)
        followed.append(record.window_means(sensor_view(frame, state, response)))
    age = order[record.rows[record.begins]][:, None] - np.arange(cycles.size)
    columns = np.column_stack(followed)[:, np.arange(cycles.size) % TAIL_CYCLES]
    return np.asfortranarray(np.where((age >= 0) & (age < TAIL_CYCLES), columns, 0.0))


def sensor_view(frame: Frame, state: CourseState, column: Array) -> Array:
    """(n,) degC what the sensor shows of a part (n,) of the bearing's temperature: as late as it shows the whole."""
    model = frame.record.model
    for effect in (effect for named in state.named if named.entry.whole for effect in automaton_effects(named, model)):
        column = sense_course(frame.record, effect, column)
    return column


def friction_heat(frame: Frame, state: CourseState) -> Array:
    """(n,) degC/s by how much more the machine heats than at rest: what a cycle's scatter multiplies."""
    record = frame.record
    rest = (record.running < 0.5) & (state.k > 0)
    floor = float(np.median(state.target[rest])) if rest.any() else float(np.quantile(state.mean, 0.02))
    heat = np.where(state.k > 0, state.k * (state.target - floor), np.where(state.decay == 1.0, state.target, 0.0))
    return np.asarray(np.maximum(heat, 0.0) * record.running)
