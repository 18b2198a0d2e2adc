"""Runs on demand: drawn in chunks of fixed sizes, each from a seed of its own, so that run i is always the same run."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from math import inf

import numpy as np

from sim.lab.checking.query import Expression
from sim.lab.checking.smc.chunks import Threads, chunk_size, in_order
from sim.lab.checking.smc.monitors import (
    ExtremeMonitor,
    PreparedPath,
    ResponseMonitor,
    Totals,
    TrajectoryMonitor,
    affine,
    cuts,
    follow,
    linear_in_temperature,
)
from sim.lab.checking.smc.paths import (
    MAX_PIECE_S,
    Cuts,
    Engine,
    Indices,
    World,
    known_engine,
    semi_markov,
)
from sim.lab.checking.smc.rules import Progress
from sim.sha import Array, Mask

MAX_MOMENTS = 1_000_000
"""Runs whose moment of the goal is kept, for a picture."""


def engine(world: World, where: Cuts) -> Engine:
    """The engine for a world: along its trace's events, or by the semi-Markov law."""
    known = world.trace is not None or world.under_effects
    return known_engine(world, where) if known else semi_markov(world, where)


def generator(seed: int, number: int) -> np.random.Generator:
    """The generator of chunk `number` under a seed."""
    # A spawn key for each chunk: run i is the same run whatever was drawn before it, and no two streams overlap.
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy=seed, spawn_key=(number,))))


@dataclass(frozen=True, slots=True)
class _Chunk:
    """What is kept of a chunk of n runs on p paths: `verdicts` (n, p), `left_out` (n, p), the `moments` (n,) of the
    first path's goal where it has any, how many runs stayed `unclear`, and what happened to them."""

    verdicts: Mask
    left_out: Indices
    moments: Array | None
    unclear: int
    totals: Totals


def _chunk(engine: Engine, paths: Sequence[PreparedPath], seed: int, threads: Threads | None, number: int) -> _Chunk:
    """Chunk `number`. Called by several threads at once: engine and paths are only read."""
    runs = chunk_size(number)
    monitors = [path.start(runs) for path in paths]
    wanted = None if threads is None else threads.wanted
    totals = follow(engine, monitors, runs, generator(seed, number), wanted)
    verdicts = np.stack([path.verdict(seen) for path, seen in zip(paths, monitors, strict=True)], axis=1)
    nothing = np.zeros(runs, dtype=np.intp)
    kept = [each.left_out if isinstance(each, ResponseMonitor) else nothing for each in monitors]
    return _Chunk(
        verdicts=verdicts,
        left_out=np.where(verdicts, np.stack(kept, axis=1), 0),
        moments=paths[0].goal_moment(monitors[0]),
        unclear=sum(getattr(monitor, "unclear", 0) for monitor in monitors),
        totals=totals,
    )


@dataclass(slots=True)
class Sampler:
    """Verdicts of one run after another on some paths, all seen on the same runs (common random numbers).

    `left` are the verdicts of the `chunks` drawn that are not yet handed out; `drawn` counts the runs handed out,
    `when` keeps the moments of the first path's goal, chunk by chunk. `spare` (runs left, paths) and `left_out`
    (paths,) count the causes that a weak response left out, in runs on which it holds: of those not yet handed out, and
    of those handed out.
    """

    engine: Engine
    paths: tuple[PreparedPath, ...]
    seed: int
    chunks: Iterator[_Chunk]
    left: Mask
    spare: Indices
    left_out: Indices
    totals: Totals
    drawn: int = 0
    unclear: int = 0
    when: list[Array] = field(default_factory=list)

    def draw(self, runs: int) -> Mask:
        """(runs, paths) the verdicts of the next runs."""
        parts, missing = [], runs
        while missing > 0:
            if not self.left.shape[0]:
                self._take(next(self.chunks))
            part, self.left = self.left[:missing], self.left[missing:]
            self.left_out += self.spare[:missing].sum(axis=0)
            self.spare = self.spare[missing:]
            parts.append(part)
            missing -= part.shape[0]
        self.drawn += runs
        return np.concatenate(parts)

    def _take(self, chunk: _Chunk) -> None:
        """The runs of the next chunk are those to be handed out."""
        self.left, self.spare = chunk.verdicts, chunk.left_out
        self.totals += chunk.totals
        self.unclear += chunk.unclear
        if chunk.moments is not None and sum(part.size for part in self.when) < MAX_MOMENTS:
            self.when.append(chunk.moments)

    def passages(self) -> Array:
        """The moment (s) of the first path's goal in each run handed out (the first million of them), inf without."""
        return np.concatenate([*self.when, np.empty(0)])[: self.drawn]


def sampler(
    world: World, paths: tuple[PreparedPath, ...], seed: int, threads: Threads | None = None, most: float = inf
) -> Sampler:
    """A sampler of runs long enough for all the paths, of which `most` will be drawn. Raises ValueError as the engines.

    The runs are the same with threads and without.
    """
    none, made = np.zeros((0, len(paths)), dtype=np.intp), engine(world, cuts(paths))
    return Sampler(
        engine=made,
        paths=paths,
        seed=seed,
        chunks=in_order(partial(_chunk, made, paths, seed, threads), threads, most),
        left=none.astype(np.bool_),
        spare=none,
        left_out=none.sum(axis=0),
        totals=Totals(),
    )


@dataclass(frozen=True, slots=True)
class RunStatistics:
    """Mean, sum of squared deviations, least and greatest of `runs` values."""

    runs: int = 0
    mean: float = 0.0
    squares: float = 0.0
    least: float = inf
    greatest: float = -inf

    def add_values(self, values: Array) -> "RunStatistics":
        """With these values too (Chan, Golub & LeVeque 1979)."""
        mean, runs = float(values.mean()), self.runs + values.size
        off = mean - self.mean
        # Sums of squares are joined about their means: sum x^2 - n mean^2 cancels at 80 degC with a scatter of 0.1.
        squares = self.squares + float(np.square(values - mean).sum()) + off**2 * self.runs * values.size / runs
        least, greatest = min(self.least, float(values.min())), max(self.greatest, float(values.max()))
        return RunStatistics(runs, self.mean + off * values.size / runs, squares, least, greatest)


def _check_finite(*columns: Array) -> None:
    if not all(np.isfinite(column).all() for column in columns):
        raise ValueError(
            "an expression of the query is no finite number at some instant of a run: it divides by 0 there"
        )


def extremes(
    world: World,
    expression: Expression,
    *,
    bound: float,
    runs: int,
    seed: int,
    greatest: bool,
    report: Progress,
    threads: Threads | None = None,
) -> tuple[RunStatistics, Totals, tuple[str, ...]]:
    """The greatest (or least) values of an expression on the runs; what happened to them; the engine's notes.

    Raises ValueError for an expression that is not finite everywhere.
    """
    factor, rest = linear_in_temperature(expression)
    bent = affine(rest) is None
    looked = ((0.0, bound),) if factor or bent else ()
    made = engine(world, Cuts(bound, (), (), looked, MAX_PIECE_S if bent else inf))
    sign = 1.0 if greatest else -1.0

    def chunk(number: int) -> tuple[Array, Totals]:
        size = chunk_size(number)
        monitor = ExtremeMonitor(factor, rest, sign, np.full(size, -inf))
        wanted = None if threads is None else threads.wanted
        happened = follow(made, [monitor], size, generator(seed, number), wanted)
        return monitor.best, happened

    statistics, totals, chunks = RunStatistics(), Totals(), in_order(chunk, threads, runs)
    while statistics.runs < runs:
        best, happened = next(chunks)
        totals += happened
        _check_finite(best)
        statistics = statistics.add_values(sign * best[: runs - statistics.runs])
        report("runs", statistics.runs / runs)
    notes = ("what is not linear in the clocks is looked at each 4 s at least, at the ends of steps",) if bent else ()
    return statistics, totals, (*made.notes, *notes)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One run: `times` (p,), s since the start, and `values` (expressions, p); two rows at an instant are a jump."""

    times: Array
    values: Array


MAX_COURSE_STEPS = 1000
"""Steps into which a course is cut for being shown, where its flow does not ask for more."""

MAX_POINTS = 20_000_000
"""Numbers of all courses of one simulation together."""


def trajectories(
    world: World, expressions: Sequence[Expression], bound: float, *, runs: int, seed: int
) -> tuple[tuple[Trajectory, ...], Totals, tuple[str, ...]]:
    """The courses of `runs` runs, at both ends of every step; what happened to them; the engine's notes.

    Raises ValueError for more numbers than fit, and for an expression that is not finite everywhere.
    """
    made = engine(world, Cuts(bound, (), (), ((0.0, bound),), max(MAX_PIECE_S, bound / MAX_COURSE_STEPS)))
    rows = made.clock.size - 1
    if runs * rows * 2 * len(expressions) > MAX_POINTS:
        raise ValueError(
            f"{runs} courses of {rows} steps with {len(expressions)} expressions are too many numbers; "
            f"ask for fewer runs or a shorter bound"
        )
    monitor = TrajectoryMonitor(tuple(expressions), tuple(place.name for place in world.sha.locations))
    totals = follow(made, [monitor], runs, generator(seed, 0))
    _check_finite(*(column for pair in monitor.values for column in pair))
    # The pieces came in the order of time, all runs mixed: a stable sort by run keeps each run's own in that order.
    who = np.concatenate([owner for *_, owner in monitor.times])
    order = np.argsort(who, kind="stable")
    begin = np.concatenate([times for times, *_ in monitor.times])[order]
    stop = np.concatenate([times for _, times, _ in monitor.times])[order]
    first = np.concatenate([values for values, _ in monitor.values], axis=1)[:, order]
    last = np.concatenate([values for _, values in monitor.values], axis=1)[:, order]
    times, values = np.stack([begin, stop], axis=1), np.stack([first, last], axis=2)
    courses = []
    for low, high in pairwise(np.searchsorted(who[order], np.arange(runs + 1)).tolist()):
        instants, course = times[low:high].ravel(), values[:, low:high].reshape(values.shape[0], -1)
        # A piece ends where the next one begins; only at a jump do the two rows of that instant differ.
        same = (np.diff(instants) == 0) & np.all(np.isclose(np.diff(course, axis=1), 0.0, atol=1e-12), axis=0)
        keep = np.concatenate([[True], ~same])
        courses.append(Trajectory(instants[keep], course[:, keep]))
    return tuple(courses), totals, made.notes
