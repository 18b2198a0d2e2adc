"""The Gaussian arithmetic of a belief under effects: mean and covariance of all d states and of m, one step at a time.

It is the Kalman filter where the automaton is linear and the extended one where it is not (Jazwinski 1970, ch. 8):
radiation is linearised about the mean, the thermostat is where the mean's is. `sim.engine.belief` says when a step is
taken; the functions here take beliefs whose `hidden` states belong to the plant.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import floor, inf, log2

import numpy as np

from sim.effects import delay_of, effect_signals, late_jumps, late_source, remaining_share, sensor_offset
from sim.engine.belief_state import Belief, Delayed, Hidden
from sim.engine.cuts import Stays, cuts
from sim.engine.moments_augmented import DrawnMoments, mean_course, start_covariance, start_state
from sim.engine.plant import Plant
from sim.engine.response import drift_matrix, fresh_intensity, respond
from sim.engine.tables import blend_steps
from sim.engine.terms import Segments, held_terms
from sim.engine.tracker import Mode
from sim.sha import Array

MAX_CACHED_STEPS = 512
"""Different steps that are kept; where signals change at every scan, none recurs and they are not worth more."""

_SERIES_ORDERS = np.arange(12)
"""The powers of the series of a steady step: see `_node_spacing`."""


def at_reading(plant: Plant, belief: Belief) -> Belief:
    """The belief with all states at what its temperature says, as uncertain as that, and m independent of them."""
    d = plant.size
    mean, covariance = np.zeros(d + 1), np.zeros((d + 1, d + 1))
    mean[:d] = start_state(plant, belief.x, sensor_offset(plant.sha, belief.time))
    covariance[:d, :d] = start_covariance(plant, belief.xx)
    mean[d], covariance[d, d] = belief.m, belief.mm
    hidden = belief.hidden or Hidden((), (), since=(None,) * len(plant.startups), late=(0.0,) * len(plant.late))
    if plant.machine is not None and hidden.mean:
        # What is known of this machine is known still, whatever its temperature is.
        place = plant.offset_state
        mean[place], covariance[place, place] = hidden.mean[place], hidden.covariance[place][place]
    return _with_states(plant, belief, mean, covariance, hidden)


def machine_offset(plant: Plant, belief: Belief) -> tuple[float, float] | None:
    """(mean, variance) of what this machine's targets lie off the model's (degC, degC^2); None without such a state."""
    if plant.machine is None or belief.hidden is None:
        return None
    place = plant.offset_state
    return belief.hidden.mean[place], belief.hidden.covariance[place][place]


def with_machine_offset(plant: Plant, belief: Belief, mean: float, variance: float) -> Belief:
    """The belief with what was learned earlier of this machine, independent of all the rest."""
    hidden, states, covariance = _states(belief)
    place = plant.offset_state
    states[place], covariance[place, :], covariance[:, place] = mean, 0.0, 0.0
    covariance[place, place] = variance
    return _with_states(plant, belief, states, covariance, hidden)


def move_states(plant: Plant, before: Belief, reading: Belief) -> Belief:
    """`reading`, which has the new temperature, with X and the lags of `before` moved along."""
    hidden, mean, covariance = _states(before)
    moved = np.zeros(plant.size + 1, dtype=np.bool_)
    moved[0], moved[plant.size - plant.lags : plant.size] = True, True
    mean[moved] += reading.x - before.x
    covariance[moved, :] = 0.0
    covariance[:, moved] = 0.0
    covariance[np.ix_(moved, moved)] = reading.xx
    return _with_states(plant, reading, mean, covariance, hidden)


def predict(plant: Plant, belief: Belief, time: float) -> Belief:
    """The belief at a later `time` with no event, input or reading in between."""
    if time == belief.time:
        return belief
    hidden, mean, covariance = _states(belief)
    d = plant.size
    place = plant.places[belief.location]
    if plant.steady_linear:
        moved = _steady_step(plant, place, belief, mean, covariance, time=time)
        if moved is not None:
            return _with_states(plant, belief, *moved, hidden, time)
    # The stretch from the belief's time to `time`, cut where effects demand it; in it nothing begins and nothing is
    # drawn, and the range is looked at once, at its end, as a schedule does at an output.
    starts = tuple(np.array([] if since is None else [since]) for since in hidden.since)
    begin, end, entry = (np.array([at]) for at in (belief.time, time, belief.entered))
    # As if all that comes late had changed just now: the cuts are then fine enough for what is left of it.
    changed = tuple(begin[: int(deviation != 0)] for deviation in hidden.late)
    inner = cuts(plant, Stays(begin, end, entry, np.array([place]), starts=starts, changed=changed))
    marks = np.unique(np.concatenate([[belief.time, time], inner]))
    begins = marks[:-1]
    n = begins.size
    segments = Segments(
        location=np.full(n, place),
        time=begins,
        age=begins - belief.entered,
        dt=np.diff(marks),
        offset=np.full(n, belief.offset),
        signals={name: np.full(n, belief.signals.get(name, np.nan)) for name in effect_signals(plant.sha)},
        since=tuple(begins - (-inf if since is None else since) for since in hidden.since),
        late=tuple(
            deviation * remaining_share(effect, begins - belief.time)
            for effect, deviation in zip(plant.late, hidden.late, strict=True)
        ),
        waiting=np.full(n, sum(jump for each in hidden.pending for jump in each.jumps)),
    )
    nothing, never = np.zeros(n), np.zeros(n, dtype=np.bool_)
    last = never.copy()
    last[-1] = True
    drawn = DrawnMoments(
        mode=np.full(n, mean[d]),
        spread=nothing,
        resampled=never,
        fresh=nothing,
        scatter=nothing,
        entry=never,
        checked=last,
    )
    course = mean_course(plant, segments, drawn, mean[:d], valve=hidden.opened)
    # The covariance along that course, m as one more state that does not move.
    steps = blend_steps(course.steps, course.opened)
    for row in range(course.opened.size):
        transition = np.eye(d + 1)
        transition[:d, :d], transition[:d, d] = steps.phi[row], steps.pull[row]
        covariance = transition @ covariance @ transition.T
        covariance[:d, :d] += steps.noise[row]
    mean[:d] = course.s[-1]
    later = replace(belief, time=time, clamps=belief.clamps + course.clamps)
    # Rounding makes the product slightly unsymmetric, and that grows from step to step.
    covariance = (covariance + covariance.T) / 2.0
    left = tuple(
        deviation * float(remaining_share(effect, np.asarray(time - belief.time)))
        for effect, deviation in zip(plant.late, hidden.late, strict=True)
    )
    return _with_states(plant, later, mean, covariance, replace(hidden, opened=course.valve, late=left))


@dataclass(frozen=True, slots=True)
class _SteadySteps:
    """All steps of the states, m as one more that does not move, whose length is near `length` (s): Taylor's series.

    The rows of `terms` (K, n) are the derivatives by the length, over k!, of one after the other: the transition and
    the noise (d + 1, d + 1), and what a heat of 1 degC/s leaves (d + 1,).
    """

    length: float
    terms: Array
    size: int

    def step_matrices(self, dt: float) -> tuple[Array, Array, Array]:
        """(transition, noise, unit) of the step of `dt` seconds."""
        flat, n = (dt - self.length) ** _SERIES_ORDERS @ self.terms, self.size
        return flat[: n * n].reshape(n, n), flat[n * n : 2 * n * n].reshape(n, n), flat[2 * n * n :]


def _steady_steps(plant: Plant, place: int, loss: float, length: float) -> _SteadySteps:
    """The steps near `length` in a location under a held `loss` (1/s).

    With B the matrix of ds/dt = B s and Q the intensity of the noise, transition, noise and unit follow from
    themselves: T' = B T, N' = B N + N B^T + Q, u' = B u + 1 in X.
    """
    d = plant.size
    couplings = plant.couplings[[place]]
    answer = respond(plant, np.array([loss]), couplings, np.array([length]), 1)
    b, white, unit = np.zeros((d + 1, d + 1)), np.zeros((d + 1, d + 1)), np.zeros(d + 1)
    b[:d, :d], b[0, d] = drift_matrix(plant, np.array([loss]), couplings)[0], plant.drive[place]
    transition, noise = np.eye(d + 1), np.zeros((d + 1, d + 1))
    transition[:d, :d], unit[:d] = answer.phi[0], answer.poly[0, :, 0]
    transition[:d, d] = unit[:d] * plant.drive[place]
    noise[:d, :d], white[0, 0] = answer.noise[0] * plant.noise[place] ** 2, plant.noise[place] ** 2
    if answer.disturbed is not None and plant.disturbance is not None:
        noise[:d, :d] += answer.disturbed[0]
        white[plant.heat_state, plant.heat_state] += fresh_intensity(plant.disturbance)
    heat = np.eye(d + 1)[0]
    rows = []
    for k in range(1, _SERIES_ORDERS.size + 1):
        rows.append(np.concatenate([transition.ravel(), noise.ravel(), unit]))
        transition, drifted, unit = b @ transition / k, b @ noise, (b @ unit + heat) / k
        noise = (drifted + drifted.T + white) / k
        white, heat = np.zeros_like(white), np.zeros_like(heat)
    return _SteadySteps(length, np.array(rows), d + 1)


def _node_spacing(plant: Plant, place: int, loss: float) -> float:
    """How far apart (s, a power of two) the lengths may lie that the others are reached from.

    So near that the largest of the matrices, times the distance, is at most 1/8: the remainder of _SERIES_ORDERS is
    1e-16.
    """
    a = drift_matrix(plant, np.array([loss]), plant.couplings[[place]])
    norm = float(np.abs(a).sum(axis=2).max()) + abs(float(plant.drive[place]))
    return 2.0 ** floor(-2.0 - log2(2.0 * norm)) if norm > 2.0**-40 else 2.0**37


def _steady_step(
    plant: Plant, place: int, belief: Belief, mean: Array, covariance: Array, *, time: float
) -> tuple[Array, Array] | None:
    """(mean (d + 1,), covariance (d + 1, d + 1)) at `time`, if nothing varies until then; None where a limit is met.

    A gateway takes nearly the same step over and over: never quite, as its clock is a real one, so that not steps are
    kept with the plant but the series about a few lengths. Making one costs a hundred times as much as using it.
    """
    loss, heat = float(plant.rate[place]), float(plant.rate[place]) * belief.offset
    for acting in plant.steady:
        if acting.mask[place]:
            signals = {name: np.array(belief.signals.get(name, np.nan)) for name in acting.effect.signals.values()}
            gained, lost = held_terms(acting.effect, signals)
            if np.isfinite(gained) and np.isfinite(lost):
                loss, heat = loss + float(lost), heat + float(gained)
    dt = time - belief.time
    if len(plant.memo) >= MAX_CACHED_STEPS:
        plant.memo.clear()
    spacing = plant.memo.get((place, loss, inf))
    if spacing is None:
        spacing = plant.memo[place, loss, inf] = _node_spacing(plant, place, loss)
    key = (place, loss, spacing * round(dt / spacing))
    steps = plant.memo.get(key)
    if steps is None:
        steps = plant.memo[key] = _steady_steps(plant, *key)
    transition, noise, unit = steps.step_matrices(dt)
    after = transition @ mean + unit * heat
    sha, x = plant.sha, float(after[0])
    if abs(x - float(mean[0])) > sha.max_rate * dt or not sha.low <= x <= sha.high:
        return None
    carried = transition @ covariance @ transition.T + noise
    # Rounding makes the product slightly unsymmetric, and that grows from step to step.
    return after, (carried + carried.T) / 2.0


def update(plant: Plant, belief: Belief, error: float, variance: float) -> Belief:
    """The belief after a reading that was `error` above its prediction, whose variance (sensor included) is given."""
    hidden, mean, covariance = _states(belief)
    shared = covariance[:, plant.sensor_state].copy()
    covariance -= shared[:, None] * shared / variance
    return _with_states(plant, belief, mean + shared / variance * error, covariance, hidden)


def enter_stay(plant: Plant, belief: Belief, mode: Mode) -> Belief:
    """The belief in a stay that begins: m is drawn anew, and X where the location draws it; the other states go on."""
    hidden, mean, covariance = _states(belief)
    drawn = {plant.size: mode.parameter} | ({} if mode.temperature is None else {0: mode.temperature})
    for place, (value, variance) in drawn.items():
        mean[place], covariance[place, :], covariance[:, place] = value, 0.0, 0.0
        covariance[place, place] = variance
    return _with_states(plant, belief, mean, covariance, hidden)


def since_event(plant: Plant, belief: Belief, symbol: str) -> Hidden:
    """The hidden states with the clocks of those start-up effects set that count from the event `symbol`."""
    hidden, _, _ = _states(belief)
    own = [acting.effect.event for acting in plant.startups]
    since = tuple(belief.time if name == symbol else last for name, last in zip(own, hidden.since, strict=True))
    return replace(hidden, since=since)


def hold_signals(plant: Plant, belief: Belief, signals: Mapping[str, float]) -> tuple[Hidden, tuple[Delayed, ...]]:
    """The hidden states when `signals` hold from now on, and what waits: what comes late jumps with its source."""
    hidden, _, _ = _states(belief)
    names = dict.fromkeys(name for effect in plant.late for name in effect.signals.values())
    before, after = ({name: np.array(each.get(name, np.nan)) for name in names} for each in (belief.signals, signals))
    jumps = np.array([late_jumps(late_source(each, before), late_source(each, after)) for each in plant.late])
    delays = np.array([delay_of(effect) for effect in plant.late])
    late = np.array(hidden.late) + np.where(delays > 0, 0.0, jumps)
    waiting = (
        Delayed(belief.time + delay, jumps=tuple(np.where(delays == delay, jumps, 0.0).tolist()))
        for delay in sorted({*delays[(delays > 0) & (jumps != 0)].tolist()})
    )
    return replace(hidden, late=tuple(late.tolist())), tuple(waiting)


def fade_jumps(belief: Belief, jumps: tuple[float, ...]) -> Belief:
    """The belief when jumps of what comes late have waited for their delay."""
    hidden, _, _ = _states(belief)
    late = tuple(deviation + jump for deviation, jump in zip(hidden.late, jumps, strict=True))
    return replace(belief, hidden=replace(hidden, late=late))


def _states(belief: Belief) -> tuple[Hidden, Array, Array]:
    """The hidden states, with copies of their mean and covariance."""
    if belief.hidden is None:
        raise ValueError("the belief was begun with a model that has no effects; start it with this one")
    return belief.hidden, np.array(belief.hidden.mean), np.array(belief.hidden.covariance)


def _with_states(
    plant: Plant, belief: Belief, mean: Array, covariance: Array, hidden: Hidden, time: float | None = None
) -> Belief:
    """The belief with these states, at `time` if it is given; its temperature is what the sensor would read."""
    d, read = plant.size, plant.sensor_state
    time = belief.time if time is None else time
    means, rows = mean.tolist(), covariance.tolist()
    states = Hidden(
        mean=tuple(means),
        covariance=tuple(map(tuple, rows)),
        opened=hidden.opened,
        since=hidden.since,
        pending=hidden.pending,
        late=hidden.late,
    )
    return replace(
        belief,
        time=time,
        x=means[read] + sensor_offset(plant.sha, time),
        m=means[d],
        xx=max(rows[read][read], 0.0),
        xm=rows[read][d],
        mm=max(rows[d][d], 0.0),
        hidden=states,
    )
