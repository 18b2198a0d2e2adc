"""How noisy the plant is: sensor, process and scatter of the mode parameters, so that forecasts at every horizon fit.

The means are given (free-run fit). The exact Kalman filter on (X, m) is run over the readings, and its predictions are
scored one step ahead and at 60, 300 and 900 s (events and inputs known): a composite likelihood with equal weights
(Varin, Reid & Firth 2011). One-step likelihood alone would choose the noise by what happens between two readings, and
the bands at 15 minutes would be whatever comes out of it. Errors beyond three standard deviations count linearly.

Heat may have a memory (`sim.effects`, heat-disturbance), and so may the sensor's error (`Model.sensor_memory`). Whether
they have, and which, is decided on data that the noise was not fitted to: one half of the chunks is fitted, the other
scored, and the other way round.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import inf, log, sqrt

import numpy as np
import scipy

from sim.effects import DisturbanceStep, disturbance_step
from sim.engine import repeat_factor
from sim.lab.learning.data import resolution
from sim.lab.learning.free_run import FitShape, FreeRunFit, loads, plain_steps, relaxing_rates
from sim.lab.learning.runs import FreeRuns, Indices, sample_runs, stretches
from sim.sha import Array, Effect, Mask, Trace

HORIZONS_S = (60.0, 300.0, 900.0)
CHUNK_KNOTS = 150
"""Knots of a chunk at most: the filter's loop has so many rounds, however long the runs are."""
MAX_PAIRS = 400
"""Pairs of readings by which each horizon is judged, at most."""
LONG_STEP_S = 150.0
"""s between the readings that are looked at, on average, from which on a record is long: the horizon of 300 s has less
than two of them, and that of 60 s none. What the flows do not describe adds up over such a step, and would be taken for
noise of every second."""
CLOSE_STEP_S = 60.0
"""s between the readings from which the noise of a long record is told: the shortest horizon."""
GRADIENT_STEP = 1e-4
"""Of the logarithms, for the gradient by forward differences."""
MIN_GAIN_NATS = 2.0
"""Nats of held-out log-likelihood, in all independent looks, that a memory must gain."""
UNKNOWN_OFFSET_SIGMA = 10.0
"""degC by which m is taken to be unknown while memories of the sensor's error are compared. In the training each m is
known from all the rest; a gateway on another machine learns it from minutes of readings, and there it counts whether
these err together."""
INITIAL_HEAT_DEGC_PER_S = 1e-3
"""degC/s with which the search for a disturbance begins."""
SCAN_STEPS = 12
"""Steps of the searches that only compare memories."""
SLOPE_SPAN_S = 900.0
"""A slope (degC/s) counts as the degrees that it makes in so many seconds, the longest horizon: what is believed of the
scatters of m, and their bounds, are in degC, and the least of them, 0.05, would as degC/s be 180 degC in an hour."""
DRIFT_SPAN_S = 300.0
"""The changes over so many seconds set the noise of locations in which nothing is known."""


@dataclass(frozen=True, slots=True)
class Memories:
    """The memories (s) that are tried, of the disturbance of heat and of the sensor's error; none is always tried."""

    heat: tuple[float, ...] = (100.0, 400.0, 1600.0, 6400.0)
    sensor: tuple[float, ...] = (5.0, 15.0, 45.0)


def observable_memories(traces: Sequence[Trace], temperature: str) -> Memories | None:
    """The memories that traces can tell: None for any; none where part of the course is drawn between what was stored.

    A line between two values errs for as long as it lasts, which a disturbance of heat would be made of.
    """
    return Memories(heat=(), sensor=()) if any(temperature in trace.held for trace in traces) else None


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """`sensor` (degC); `process` (G,), degC/sqrt(s), by group of locations; `scatter` (L,), the sigma of each m.

    `score` is the mean log-likelihood per reading of the one-step predictions and of those at each of HORIZONS_S.
    `heat` (degC/s) is the disturbance's standard deviation, 0 without one, and `memory` (s) how long it lasts;
    `sensor_memory` (s) is how long the sensor's error lasts, 0 where each reading errs by itself.
    """

    sensor: float
    process: Array
    scatter: Array
    score: Mapping[float, float]
    heat: float = 0.0
    memory: float = inf
    sensor_memory: float = 0.0

    @property
    def memories(self) -> Memories:
        """The memories that were found, for noise that is fitted anew to a part of the data."""
        return Memories(
            heat=(self.memory,) if self.heat else (), sensor=(self.sensor_memory,) if self.sensor_memory else ()
        )

    @property
    def white(self) -> float:
        """The white noise (degC^2/s) that the disturbance is over times longer than its memory."""
        return self.heat**2 * 2.0 * self.memory if self.heat else 0.0

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The disturbance as an automaton has it; nothing without one."""
        return (Effect("heat-disturbance", {"sigma": self.heat, "memory": self.memory}),) if self.heat else ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _KnotSteps:
    """Every knot's affine step: X' = decay X + pull (m - mu) + drift, variance = density * process^2.

    `k` (1/s) is the rate at which X forgets, 0 where it does not; `heat` the disturbance's step (None without one);
    `repeats` by how much a reading's variance counts that errs like the one before it (`repeat_factor`).
    """

    decay: Array
    pull: Array
    drift: Array
    density: Array
    place: Indices
    group: Indices
    stay: Indices
    time: Array
    reading: Array
    run: Indices
    dt: Array
    k: Array
    repeats: Array
    heat: DisturbanceStep | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ahead:
    """Predictions from K origins: mean = decay X + own (m - mu) + drift; variance weights of the noises after it.

    `heated` is the weight of the origin's disturbance, `disturbed` that of what is new in it after the origin.
    """

    horizon: float
    origin: Indices
    outcome: Array
    decay: Array
    own: Array
    drift: Array
    process: Array
    scatter: Array
    heated: Array
    disturbed: Array


def _steps(runs: FreeRuns, shape: FitShape, fit: FreeRunFit, groups: Indices) -> _KnotSteps:
    decay, pull, density = plain_steps(runs, shape, fit.rates)
    return _KnotSteps(
        decay=decay,
        pull=pull,
        drift=pull * (loads(runs, shape) @ fit.linear),
        density=density,
        place=runs.place,
        group=groups[runs.place],
        stay=runs.stay,
        time=runs.time,
        reading=runs.reading,
        run=runs.run,
        dt=runs.dt,
        k=relaxing_rates(runs, shape, fit.rates),
        repeats=np.ones(len(runs)),
    )


def _chunks(steps: _KnotSteps) -> Indices:
    """(J, C) knot numbers of the chunks, filtered side by side; -1 beyond a chunk's end. Each begins at a reading."""
    columns: list[Indices] = []
    first = np.flatnonzero(np.diff(steps.run, prepend=-1) != 0)
    for low, high in zip(first, [*first[1:], steps.run.size], strict=True):
        begin = int(low)
        while begin < high - 1:
            end = min(begin + CHUNK_KNOTS, int(high))
            known = np.flatnonzero(np.isfinite(steps.reading[begin:end]))
            if known.size < 2:
                break
            # A chunk ends at its last reading, where the next one begins: that knot belongs to both.
            end = begin + int(known[-1]) + 1
            columns.append(np.arange(begin, end))
            begin = end - 1
    # The longest first: those that go on are then always the first columns of a row.
    columns.sort(key=lambda column: (-column.size, column[0]))
    table = np.full((columns[0].size if columns else 0, len(columns)), -1, dtype=np.intp)
    for number, column in enumerate(columns):
        table[: column.size, number] = column
    return table


@dataclass(frozen=True, slots=True)
class _Filtered:
    """What the filter found for n knots and Q sets of noises, each thing once: `slot` (n, Q) says where it stands.

    `score` (F,) are log-likelihoods, `state` (9, F) what is known after a knot; the last of both is NaN, for knots
    outside all chunks.
    """

    slot: Indices
    score: Array
    state: Array


def _own_pairs(
    steps: _KnotSteps, table: Indices, *, sensor: Array, process: Array, scatter: Array, rough: Array
) -> tuple[Indices, Indices]:
    """(chunk, set) (P,) of what has to be filtered: the first set, and each that differs from it in the chunk.

    A gradient takes a set for each location's scatter, and most chunks pass few of the locations.
    """
    own = np.empty((table.shape[1], sensor.size), dtype=np.bool_)
    own[:] = (sensor != sensor[0]) | (rough != rough[0])
    own[:, 0] = True
    other_scatter, other_process = scatter != scatter[:, :1], process != process[:, :1]
    for chunk, column in enumerate(table.T):
        knots = column[column >= 0][1:]
        own[chunk] |= other_scatter[np.unique(steps.place[knots])].any(axis=0)
        own[chunk] |= other_process[np.unique(steps.group[knots])].any(axis=0)
    chunks, sets = np.nonzero(own)
    return chunks, sets


def _filter_knots(
    steps: _KnotSteps, table: Indices, *, sensor: Array, process: Array, scatter: Array, rough: Array
) -> _Filtered:
    """Log-likelihood and state after each knot for Q sets of `sensor` (Q,), `process` (G, Q), ...

    The Kalman filter on X, m - mu and the disturbance D, vectorised twice: over the chunks, which begin at a reading
    and so need nothing of one another, and over the Q sets of noises that a gradient takes. A state is the means of X,
    m - mu and D, then xx, xm, mm, xd, md and dd of their covariance; without a disturbance all of D is 0.
    """
    n, width = steps.run.size, sensor.size
    if table.shape[0] < 2:
        return _Filtered(np.zeros((n, width), dtype=np.intp), np.full(1, np.nan), np.full((9, 1), np.nan))
    chunks, sets = _own_pairs(steps, table, sensor=sensor, process=process, scatter=scatter, rough=rough)
    # All that does not depend on the state is made for all knots at once, in the order in which the loop meets them:
    # its rounds are many and their arrays small, so that what counts there is the number of operations and their
    # overhead. The longest chunks are the first, so that those which go on are the first pairs of a row.
    longest = np.searchsorted(chunks, (table[1:] >= 0).sum(axis=1))
    ends = np.cumsum(longest)
    begins = ends - longest
    pair = np.arange(ends[-1]) - np.repeat(begins, longest)
    knots, column = table[1:][np.repeat(np.arange(longest.size), longest), chunks[pair]], sets[pair]
    a, p, drift, reading = steps.decay[knots], steps.pull[knots], steps.drift[knots], steps.reading[knots]
    aa, ap, pp = a * a, 2 * a * p, p * p
    noise = sensor**2
    added = steps.density[knots] * (process**2)[steps.group[knots], column]
    drawn, sensed = (scatter**2)[steps.place[knots], column], noise[column]
    counted = steps.repeats[knots] * sensed
    # A new stay draws its m anew, and so does a chunk's first step: what the stay before it knew is given up.
    fresh = steps.stay[knots] != steps.stay[knots - 1]
    fresh[: ends[0]] = True
    known = np.isfinite(reading)
    heat = steps.heat
    if heat is not None:
        keep, carry = heat.keep[knots], heat.carried[knots]
        new_xx, new_xd, new_dd = (part[knots] * (rough**2)[column] for part in (heat.xx, heat.xd, heat.dd))
        twice, squared, kept = 2.0 * carry, carry * carry, keep * keep
    innovation, variance = np.empty(knots.size), np.empty(knots.size)
    after = np.full((9, knots.size + 1), np.nan)
    anew = np.logical_or.reduceat(fresh, begins).tolist()
    full = np.logical_and.reduceat(known, begins).tolist()
    x, m, d, xx, xm, mm, xd, md, dd = state = np.zeros((9, chunks.size))
    x[:], xx[:], dd[:] = steps.reading[table[0, chunks]], noise[sets], (rough**2)[sets]
    for begin, end, some_fresh, all_known in zip(begins.tolist(), ends.tolist(), anew, full, strict=True):
        at = slice(begin, end)
        if len(x) != end - begin:
            x, m, d, xx, xm, mm, xd, md, dd = state = state[:, : end - begin]
        if some_fresh:
            # A fresh m is independent of X: mean 0, variance that of its location, no covariance with what was before.
            new = fresh[at]
            np.copyto(mm, drawn[at], where=new)
            for gone in (m, xm, md):
                np.copyto(gone, 0.0, where=new)
        # The prediction, by the step's own closed form; its innovation is scored before the reading is taken in.
        carried, pulled = a[at], p[at]
        xx *= aa[at]
        xx += ap[at] * xm
        xx += pp[at] * mm
        xx += added[at]
        xm *= carried
        xm += pulled * mm
        x *= carried
        x += pulled * m
        x += drift[at]
        if heat is not None:
            # D's covariances with X and m come before the step here: `xd` is at first that of D with the rest of X'.
            moved, left = carry[at], keep[at]
            xd *= carried
            xd += pulled * md
            xx += twice[at] * xd
            xx += squared[at] * dd
            xx += new_xx[at]
            x += moved * d
            xm += moved * md
            xd += moved * dd
            xd *= left
            xd += new_xd[at]
            d *= left
            md *= left
            dd *= kept[at]
            dd += new_dd[at]
        error = np.subtract(reading[at], x, out=innovation[at])
        # Scored is what the reading was expected to be; what it corrects counts the memory of the sensor's error.
        variance[at] = xx
        total = xx + counted[at]
        # The scalar update needs no inverse.
        gain, turn = xx / total, xm / total
        if not all_known:
            # Without a reading gain and turn are 0, and the prediction stands.
            gain, turn = np.where(known[at], gain, 0.0), np.where(known[at], turn, 0.0)
            error = np.where(known[at], error, 0.0)
        rest = 1.0 - gain
        if heat is not None:
            warm = xd / total if all_known else np.where(known[at], xd / total, 0.0)
            d += warm * error
            md -= turn * xd
            dd -= warm * xd
            xd *= rest
        x += gain * error
        m += turn * error
        mm -= turn * xm
        xx *= rest
        xm *= rest
        after[:, at] = state
    slot, place = np.full((n, width), knots.size, dtype=np.intp), np.arange(knots.size)
    first = column == 0
    slot[knots[first]] = place[first][:, None]
    slot[knots, column] = place
    return _Filtered(slot, np.append(_log_score(innovation, variance + sensed), np.nan), after)


def _log_score(error: Array, variance: Array) -> Array:
    # Linear beyond three standard deviations (Huber): one wrong reading must not set the noise of a plant.
    z = np.abs(error) / np.sqrt(variance)
    return np.asarray(-0.5 * np.log(2 * np.pi * variance) - np.where(z < 3, 0.5 * z * z, 3 * z - 4.5))


def _aheads(
    steps: _KnotSteps, heats: Sequence[DisturbanceStep | None], horizon: float, groups: int, places: int
) -> list[_Ahead]:
    """The predictions over `horizon`, one for each of `heats` (None: no disturbance); none when no two readings are so
    far apart.

    They are made for MAX_PAIRS pairs at most of readings of one run, `horizon` to 1.2 times as far apart.
    """
    known = np.flatnonzero(np.isfinite(steps.reading))
    of_runs: list[Indices] = []
    for run in np.unique(steps.run[known]):
        of_run = known[steps.run[known] == run]
        outcome = np.searchsorted(steps.time[of_run], steps.time[of_run] + horizon)
        inside = outcome < of_run.size
        of_runs.append(np.column_stack([of_run[inside], of_run[outcome[inside]]]))
    pairs = np.concatenate(of_runs)
    # After a gap the next reading may come much later: that would be another horizon.
    pairs = pairs[steps.time[pairs[:, 1]] - steps.time[pairs[:, 0]] <= 1.2 * horizon]
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), MAX_PAIRS)).astype(np.intp))
    # Those with most knots before them first: those that go on are then always the first of all.
    chosen = chosen[np.argsort(pairs[chosen, 0] - pairs[chosen, 1], kind="stable")]
    origin, end = pairs[chosen, 0], pairs[chosen, 1]
    size, rounds = origin.size, end - origin
    if not size:
        return []
    decay, own, drift, fresh = np.ones(size), np.zeros(size), np.zeros(size), np.zeros(size)
    process, scatter = np.zeros((size, groups)), np.zeros((size, places))
    # The disturbances, a row each: the weight of the origin's own in X and what is left of it, and of what is new since
    # then the variance in X, its covariance with D, and D's variance, all for a sigma of 1. Without one all are 0.
    some = [heat for heat in heats if heat is not None]
    keeps, carries, new_xx, new_xd, new_dd = (
        np.array([getattr(heat, name) for heat in some]).reshape(len(some), steps.time.size)
        for name in ("keep", "carried", "xx", "xd", "dd")
    )
    kept = np.ones((len(some), size))
    heated, vx, vxd, vd = np.zeros((4, len(some), size))
    # All origins walk on together, one knot a round, until each is at its outcome. The m of the stay in which an
    # origin lies is the filter's (`own`, while `still`); each later stay has one of its own, whose weight on X is
    # `fresh` while it lasts and which then goes, squared, to the scatter of its location.
    still, every = np.ones(size, dtype=bool), np.arange(size)
    for past in range(int(rounds.max())):
        go = int(np.searchsorted(-rounds, -past))
        knots = origin[:go] + past + 1
        a, p = steps.decay[knots], steps.pull[knots]
        left = np.flatnonzero(steps.stay[knots] != steps.stay[knots - 1])
        if left.size:
            ended = left[~still[left]]
            scatter[ended, steps.place[knots[ended] - 1]] += fresh[ended] ** 2
            fresh[left] = 0.0
            still[left] = False
        for weight, with_own in ((own[:go], still[:go]), (fresh[:go], ~still[:go])):
            weight *= a
            weight += np.where(with_own, p, 0.0)
        decay[:go] *= a
        drift[:go] *= a
        drift[:go] += steps.drift[knots]
        squared = (a**2)[:, None]
        process[:go] *= squared
        process[every[:go], steps.group[knots]] += steps.density[knots]
        scatter[:go] *= squared
        if some:
            keep, carry = keeps[:, knots], carries[:, knots]
            of_heat, of_rest = vd[:, :go].copy(), vxd[:, :go].copy()
            heated[:, :go] = a * heated[:, :go] + carry * kept[:, :go]
            kept[:, :go] *= keep
            vx[:, :go] = a * a * vx[:, :go] + 2.0 * a * carry * of_rest + carry * carry * of_heat + new_xx[:, knots]
            vxd[:, :go] = keep * (a * of_rest + carry * of_heat) + new_xd[:, knots]
            vd[:, :go] = keep * keep * of_heat + new_dd[:, knots]
    scatter[every, steps.place[end]] += fresh**2
    order = np.argsort(chosen)
    plain = _Ahead(
        horizon=horizon,
        origin=origin[order],
        outcome=steps.reading[end][order],
        decay=decay[order],
        own=own[order],
        drift=drift[order],
        process=process[order],
        scatter=scatter[order],
        heated=np.zeros(size),
        disturbed=np.zeros(size),
    )
    of_heats = iter(zip(heated, vx, strict=True))
    made = []
    for heat in heats:
        weights, variance = (
            (plain.heated, plain.disturbed) if heat is None else (part[order] for part in next(of_heats))
        )
        made.append(replace(plain, heated=weights, disturbed=variance))
    return made


def _known_mean(scores: Array) -> Array:
    """(Q,) the mean of the rows (n, Q) that are known; 0, which prefers nothing, where none is."""
    return np.asarray(np.nansum(scores, axis=0) / np.maximum(np.sum(~np.isnan(scores), axis=0), 1))


@dataclass(frozen=True, slots=True)
class _Objective:
    """What the likelihood needs, and the floors and counts of its parameters; the last one is the disturbance's sigma.

    Theta has scatters in degC; `units` (S,) are those of the m of the `seen` locations, for each degC. `memory` (s) is
    that of the disturbance, None without one; `sensor_memory` (s) is in the steps' `repeats`.
    """

    steps: _KnotSteps
    table: Indices
    aheads: tuple[_Ahead, ...]
    groups: int
    seen: Indices
    units: Array
    places: int
    floor: float
    memory: float | None = None
    sensor_memory: float = 0.0

    @property
    def scatters(self) -> slice:
        """Where theta has the scatters."""
        return slice(1 + self.groups, 1 + self.groups + self.seen.size)

    def unpack(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """(sensor (Q,), process (G, Q), scatter (L, Q), rough (Q,)) from theta (P, Q) of logarithms."""
        values = np.exp(theta)
        scatter = np.zeros((self.places, theta.shape[1]))
        scatter[self.seen] = values[self.scatters] * self.units[:, None]
        rough = np.zeros(theta.shape[1]) if self.memory is None else values[-1]
        return values[0], values[1 : 1 + self.groups], scatter, rough

    def scores(self, theta: Array) -> list[Array]:
        """(Q,) the mean log-likelihood one step ahead, then at each horizon."""
        sensor, process, scatter, rough = self.unpack(theta)
        found = _filter_knots(self.steps, self.table, sensor=sensor, process=process, scatter=scatter, rough=rough)
        scores = [_known_mean(found.score[found.slot])]
        for ahead in self.aheads:
            # An origin outside all chunks has no state: NaN, which the mean leaves out.
            x, m, d, xx, xm, mm, xd, md, dd = found.state[:, found.slot[ahead.origin]]
            a, own, warm = ahead.decay[:, None], ahead.own[:, None], ahead.heated[:, None]
            mean = a * x + own * m + warm * d + ahead.drift[:, None]
            variance = a * a * xx + 2 * a * own * xm + own * own * mm
            variance = variance + warm * (2.0 * (a * xd + own * md) + warm * dd) + ahead.disturbed[:, None] * rough**2
            variance = variance + ahead.process @ process**2 + ahead.scatter @ scatter**2 + sensor**2
            scores.append(_known_mean(_log_score(ahead.outcome[:, None] - mean, variance)))
        return scores

    def loss(self, theta: Array, weight: float) -> Array:
        """(Q,) minus the composite log-likelihood and the log-prior.

        The scatters are shrunk towards their common geometric mean (factor 1.6): a location that was entered three
        times says little about its own.
        """
        logs = theta[self.scatters]
        shrink = np.sum((logs - logs.mean(axis=0)) ** 2, axis=0) / (2 * 0.5**2) if logs.size else 0.0
        vague = np.sum((theta - self.start()[:, None]) ** 2, axis=0) / (2 * 3.0**2)
        return np.asarray(shrink + vague - weight * np.sum(self.scores(theta), axis=0))

    def start(self) -> Array:
        """Where the search begins and the vague prior lies: 0.005 degC/sqrt(s) and 2 degC, sensor by differences."""
        reading = self.steps.reading[np.isfinite(self.steps.reading)]
        # White noise in second differences has 1 + 4 + 1 = 6 times its variance; a slow course nearly vanishes in them.
        rough = 1.4826 * float(np.median(np.abs(np.diff(reading, 2)))) / sqrt(6.0) if reading.size > 2 else 0.0
        logs = [log(max(rough, self.floor) * 1.01), *[log(0.005)] * self.groups, *[log(2.0)] * self.seen.size]
        return np.array(logs if self.memory is None else [*logs, log(INITIAL_HEAT_DEGC_PER_S)])

    def bounds(self) -> list[tuple[float, float]]:
        """Of the logarithms: no sensor is better than its rounding, no plant without noise."""
        sensor = (log(self.floor), log(max(50.0, 2 * self.floor)))
        bounds = [sensor, *[(log(1e-4), log(1.0))] * self.groups, *[(log(0.05), log(60.0))] * self.seen.size]
        return bounds if self.memory is None else [*bounds, (log(1e-7), log(1.0))]

    def fit_theta(
        self, weight: float, begin: Array | None = None, *, iterations: int = 60, free: Mask | None = None
    ) -> Array:
        """(P,) the theta of least loss, from `begin` (P,); only what is `free` (P,) moves."""
        theta = self.start() if begin is None else begin
        free = np.ones(theta.size, dtype=np.bool_) if free is None else free
        bounds = [each for each, moves in zip(self.bounds(), free.tolist(), strict=True) if moves]
        search = scipy.optimize.minimize(
            _value_and_slope,
            theta[free],
            args=(self, weight, theta, free),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": iterations, "ftol": 1e-7},
        )
        best = theta.copy()
        best[free] = search.x
        return best

    def half(self, parity: int) -> "_Objective":
        """The task of every other chunk, and of the origins that lie in them."""
        table = self.table[:, parity::2]
        table = table[(table >= 0).any(axis=1)]
        inside = np.zeros(self.steps.run.size, dtype=np.bool_)
        inside[table[table >= 0]] = True
        return replace(self, table=table, aheads=tuple(_of_origins(ahead, inside) for ahead in self.aheads))


def _of_origins(ahead: _Ahead, inside: Mask) -> _Ahead:
    rows = inside[ahead.origin]
    return replace(
        ahead, **{each.name: getattr(ahead, each.name)[rows] for each in fields(ahead) if each.name != "horizon"}
    )


def fit_noise(
    runs: FreeRuns,
    shape: FitShape,
    fit: FreeRunFit,
    groups: Indices,
    *,
    budget: int = 2500,
    whole: FreeRuns | None = None,
    floor: float = 1e-3,
    memories: Memories | None = None,
) -> NoiseLevels:
    """The noise of greatest composite likelihood, the means given by `fit`.

    `groups` (L,) numbers the locations that share one process noise. `floor` is the least sensor sigma (degC); the
    sensor's own rounding, step/sqrt(12), is taken where that is more. Rows are sampled to about `budget` knots; where
    those are LONG_STEP_S apart, so many knots of `whole` are taken that are close together: the runs before they were
    thinned for the means (default: `runs`). Of disturbances and errors of the sensor with one of the `memories` the
    likeliest is taken, if it is worth it on data held out.
    """
    return fit_noises(runs, shape, fit, groups, budget=budget, whole=whole, floor=floor, memories=memories)[-1]


def fit_noises(
    runs: FreeRuns,
    shape: FitShape,
    fit: FreeRunFit,
    groups: Indices,
    *,
    budget: int,
    whole: FreeRuns | None = None,
    floor: float = 1e-3,
    memories: Memories | None = None,
) -> list[NoiseLevels]:
    """The noise without a disturbance and, where one is worth it, the noise with it (`fit_noise`)."""
    memories = memories or Memories()
    few = sample_runs(runs, budget)
    if few.dt.sum() > LONG_STEP_S * len(few):
        few = stretches(runs if whole is None else whole, budget, CLOSE_STEP_S)
    steps = _steps(few, shape, fit, groups)
    floor = max(floor, resolution(runs.reading) / sqrt(12.0))
    task, *heated = _tasks(steps, groups, shape, floor, (None, *memories.heat))
    # As many independent looks as the data have stretches of 300 s, spread over one step and the horizons.
    weight = max(float(few.dt.sum()) / 300.0, 10.0)
    best = task.fit_theta(weight)
    if task.table.shape[1] < 2:
        return [_levels(task, best)]  # nothing could be held out
    # The sensor's error first: one that lasts looks like heat with a short memory.
    strange = best.copy()
    strange[task.scatters] = log(UNKNOWN_OFFSET_SIGMA)
    lasting = [
        replace(task, steps=replace(steps, repeats=_repeats(steps, memory)), sensor_memory=memory)
        for memory in memories.sensor
    ]
    # The search is only worth its time where some memory is likelier already, before anything else has moved with it.
    losses = [float(trial.loss(strange[:, None], weight)[0]) for trial in (task, *lasting)]
    if min(losses) == losses[0]:
        lasting = []
    if (found := _worth_it(task, strange, lasting, strange, weight)) is not None:
        task = found[0]
        best = task.fit_theta(weight, best)
    levels = [_levels(task, best)]
    heated = [
        replace(one, steps=replace(task.steps, heat=one.steps.heat), sensor_memory=task.sensor_memory) for one in heated
    ]
    if (found := _worth_it(task, best, heated, np.append(best, log(INITIAL_HEAT_DEGC_PER_S)), weight)) is not None:
        trial, theta = found
        levels.append(_levels(trial, trial.fit_theta(weight, theta)))
    return levels


def _worth_it(
    task: "_Objective", best: Array, trials: Sequence["_Objective"], begin: Array, weight: float
) -> tuple["_Objective", Array] | None:
    """The likeliest of the `trials` and its theta, sought from `begin`; None where `task`, from `best`, is as good."""
    if not trials:
        return None
    # What a memory explains was taken for noise of the process or of the sensor: those move with it, while the
    # scatter of the stays is left for the last fit.
    free = np.ones(begin.size, dtype=np.bool_)
    free[task.scatters] = False
    scored = []
    for trial in trials:
        half = trial.half(0)
        theta = half.fit_theta(weight / 2.0, begin, iterations=SCAN_STEPS, free=free)
        scored.append((float(half.loss(theta[:, None], weight / 2.0)[0]), trial, theta))
    _, trial, theta = min(scored, key=lambda each: each[0])
    own = free[: best.size]
    plain = task.half(0).fit_theta(weight / 2.0, best, iterations=SCAN_STEPS, free=own)
    gain = _score_halves(trial, theta, begin, free, weight) - _score_halves(task, plain, best, own, weight)
    return (trial, theta) if weight * gain > MIN_GAIN_NATS else None


def _repeats(steps: _KnotSteps, memory: float) -> Array:
    """(n,) `repeat_factor` of each knot's reading, by the time since the one before it in its run; 1 for the first."""
    known = np.flatnonzero(np.isfinite(steps.reading))
    repeats = np.ones(steps.time.size)
    same = steps.run[known[1:]] == steps.run[known[:-1]]
    since = np.diff(steps.time[known])[same]
    repeats[known[1:][same]] = [repeat_factor(memory, each) for each in since.tolist()]
    return repeats


def _levels(task: _Objective, theta: Array) -> NoiseLevels:
    """The noise at theta (P,)."""
    sensor, process, scatter, heat = task.unpack(theta[:, None])
    horizons = [0.0, *(ahead.horizon for ahead in task.aheads)]
    score = {horizon: float(value[0]) for horizon, value in zip(horizons, task.scores(theta[:, None]), strict=True)}
    return NoiseLevels(
        sensor=float(sensor[0]),
        process=process[:, 0],
        scatter=scatter[:, 0],
        score=score,
        heat=float(heat[0]),
        memory=inf if task.memory is None else task.memory,
        sensor_memory=task.sensor_memory,
    )


def _tasks(
    steps: _KnotSteps, groups: Indices, shape: FitShape, floor: float, memories: Sequence[float | None]
) -> list[_Objective]:
    """A task for each memory (s) of the disturbance, None without one; what does not depend on it is made once."""
    heats = [None if memory is None else disturbance_step(memory, steps.k, steps.dt) for memory in memories]
    count = int(groups.max()) + 1
    aheads = [_aheads(steps, heats, horizon, count, groups.size) for horizon in HORIZONS_S]
    table, seen = _chunks(steps), np.flatnonzero(shape.target >= 0)
    return [
        _Objective(
            steps=replace(steps, heat=heat),
            table=table,
            aheads=tuple(of_horizon[number] for of_horizon in aheads if of_horizon),
            groups=count,
            seen=seen,
            units=np.array([1.0 / SLOPE_SPAN_S if shape.kinds[place] == "linear" else 1.0 for place in seen]),
            places=groups.size,
            floor=floor,
            memory=memory,
        )
        for number, (memory, heat) in enumerate(zip(memories, heats, strict=True))
    ]


def _score_halves(task: _Objective, first: Array, begin: Array, free: Mask, weight: float) -> float:
    """The composite score, per look, of each half of the chunks under the noise fitted to the other.

    `first` is the one fitted to the first half; that of the second is searched from `begin`.
    """
    other = task.half(1)
    second = other.fit_theta(weight / 2.0, begin, iterations=SCAN_STEPS, free=free)
    judged = ((other, first), (task.half(0), second))
    return 0.5 * sum(float(np.sum(half.scores(theta[:, None]), axis=0)[0]) for half, theta in judged)


def _value_and_slope(point: Array, task: _Objective, weight: float, theta: Array, free: Mask) -> tuple[float, Array]:
    """The loss and its gradient by forward differences, all perturbations in one pass of the filter.

    `point` are the free ones of `theta`. In logarithms of standard deviations a step of 1e-4 is a hundredth of a
    percent: small against what the loss curves by, large against its rounding.
    """
    trials = np.repeat(theta[:, None], point.size + 1, axis=1)
    trials[free] = point[:, None] + GRADIENT_STEP * np.eye(point.size, point.size + 1, 1)
    values = task.loss(trials, weight)
    return float(values[0]), (values[1:] - values[0]) / GRADIENT_STEP


def drift_noise(runs: FreeRuns) -> float:
    """The random walk, degC/sqrt(s), whose changes over 300 s are as large as the readings' own (or over a shorter
    time, when no run lasts so long)."""
    time, reading = (column[np.isfinite(runs.reading)] for column in (runs.time, runs.reading))
    run = runs.run[np.isfinite(runs.reading)]
    squares: list[float] = []
    # A random walk's variance grows with time, so a squared change counts by the second that it took.
    for number in np.unique(run):
        of_run = run == number
        at, value = time[of_run], reading[of_run]
        span = min(DRIFT_SPAN_S, float(at[-1] - at[0]))
        later = np.minimum(np.searchsorted(at, at + span), at.size - 1)
        whole = at[later] - at >= span
        if span > 0:
            squares += ((value[later] - value)[whole] ** 2 / (at[later] - at)[whole]).tolist()
    return float(max(np.sqrt(np.mean(squares)) if squares else 0.0, 1e-3))
