"""Is there a gap at all: how far off the refitted free run is, beside what noise alone makes of it.

The floor is told from times and temperatures: by what the best explanation that was found still errs by on the cycles
it was fitted to, or by how much cycles that are equal differ, where that is less. What the given model states of its
own free runs is the prior of it, and draws down only: a model that was learned without a cause takes it for noise, as
a refit does. The sensor bounds the floor from below.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sim.effects import drop_features
from sim.engine import open_loop
from sim.lab.discrepancy.diagnosis import NoiseFloor
from sim.lab.discrepancy.fitting import (
    GAP_RATIO,
    Fitted,
    NoiseModel,
    Record,
    Whitener,
    averaged_readings,
    move_frame,
    rounding_error,
    unseen_switches,
    window_sensitivity,
)
from sim.lab.discrepancy.heat import since_switch
from sim.lab.discrepancy.held_out import HeldOutRun, let_run, mean_squares
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import Indices
from sim.sha import Array, Model, Trace

MIN_REST_ROWS = 50
"""Rows at rest from which the sensor's noise is told by them alone."""
FLOOR_DRAWS = 200
"""Draws of the noise from which a floor is told."""
NOISE_SIZES = 100
"""Sizes of the noise that each of these is taken at for the floor's interval."""
EQUAL_DRAWS = 60
"""Draws of the noise by which the scatter of equal cycles is judged."""
MIN_READING_ERROR_DEGC = 1e-4
"""degC that no window's mean is nearer to the truth."""
PHASES_S = (240.0, 900.0, 3600.0, 7200.0)
"""Seconds since the last start or stop between which cycles are held against one another."""


@dataclass(frozen=True, slots=True)
class Excess:
    """Of the fitted cycles: the free run's error over the given model's own spread, the median and a lower quantile.

    Roughness that the model has learned counts as its spread, so a rough plant has no excess.
    """

    median: float
    low: float

    def wide(self, rules: DecisionRules) -> bool:
        """True where the model's noise does not cover its errors."""
        return self.median >= rules.wide_median_times and self.low >= rules.wide_low_times

    def words(self) -> str:
        """What is too much, in a sentence."""
        return f"the free run is {self.median:.1f} times as far off as the model's own noise allows"


def noise_floor(stated: Array, explained: Fitted, record: Record, seed: int, rules: DecisionRules) -> NoiseFloor:
    """The floor under free runs over a record cut by cycles (`Record.by_cycles`).

    `stated` (c,) degC is what the given model states of the fitted cycles (`stated_errors`), `explained` the fit with
    the best explanation of them: with no effect where none is beyond chance.
    """
    training = let_run(explained, explained.frame.record.by_cycles())
    trial = let_run(explained, record)
    _, _, known = mean_squares(training)
    _, weights, cycles = mean_squares(trial)
    rng = np.random.default_rng(seed)
    # A fit errs less on what it was fitted to than on other cycles: what it takes from the noise is drawn too.
    whitener = Whitener(explained.grid, explained.noise)
    noise = Whitener(explained.timed_grid, explained.noise).draw(rng, FLOOR_DRAWS)
    precision = whitener.gram(explained.columns) + np.diag(np.maximum(explained.prior, 1e-12))
    taken = np.linalg.solve(precision, whitener.weigh(explained.columns).T @ noise)
    fitted = _rms(noise - explained.columns @ taken)
    beyond = window_sensitivity(move_frame(explained.frame, record), trial.state, trial.start)
    alone = trial.whitener.draw(rng, FLOOR_DRAWS)
    wrong = limit_parameter_errors(trial, beyond @ taken, alone, rules.floor_parameters_most_times)
    own, drawn = predict_errors(trial, cycles, alone - wrong)
    # Each tells how many times the noise of the fit there is; how cycles differ among themselves (how long they are,
    # how much is heated in them) that noise knows.
    told = {
        "what is left of the fitted cycles": _rms(explained.turn_residual) / fitted,
        "what equal cycles differ by": size_by_equal_cycles(training, explained, rng, rules),
    }
    source = min(told, key=lambda name: told[name])
    # The noise itself is known from so many independent pieces: its standard error in logarithms is 1 / sqrt(2 n).
    pieces = np.unique(training.record.window_cycle[np.isin(training.record.window_whole, known)]).size
    expected = _rms(predict_errors(training, known, training.whitener.draw(rng, FLOOR_DRAWS))[0])
    said = _rms(stated) / expected
    size, unsure = believed_size(said, told[source], pieces, rules)
    if size > rules.stated_noise_most_times * said:
        size, source = rules.stated_noise_most_times * said, "the most that the model's own noise can be taken for"
    floor = size * own
    least = read_alone(trial, cycles, sensor_alone(explained), rng)
    source = "the sensor alone" if _rms(floor) < _rms(least) else source
    floor = np.maximum(floor, least)
    error = float(np.sqrt(np.average(floor**2, weights=weights)))
    # Each draw of chance with many of the size that is not known: what is asked is far out.
    wrong_by = np.exp(unsure * rng.standard_normal((NOISE_SIZES, drawn.size)))
    beyond_each = 0.5 * (1.0 - rules.floor_interval_share)
    low, high = np.quantile(drawn / _rms(drawn) * wrong_by, [beyond_each, 1.0 - beyond_each])
    return NoiseFloor(error, (float(error * low), float(error * high)), cycles, floor, source)


def add_leftover(floor: NoiseFloor, left: float, rules: DecisionRules) -> NoiseFloor:
    """The floor with what names leave (degC rms) of held-out cycles that they foresee better.

    What is left of cycles that nothing was fitted to is their noise and what the names' shapes err by: noise alone is
    no more. Before and after err by the same noise, so this bound is nearer than what other cycles' noise tells. Where
    it is more, but no more than chance makes, both tell what noise fell in these cycles, each as well as it is known.
    """
    low, high = floor.interval
    if left > high:
        return floor
    # The fitted cycles as well as the interval says, those that were kept as well as names know an ideal fit's error:
    # normal in logarithms, weighed by their precision.
    beyond = float(scipy.stats.norm.isf(0.5 * (1.0 - rules.floor_interval_share)))
    unsure = float(np.log(high / low)) / (2.0 * beyond)
    weight = unsure**2 / (unsure**2 + rules.left_by_names_log_sd**2)
    error = min(left, max(floor.error, floor.error * (left / floor.error) ** weight))
    scale = error / floor.error
    source = f"what the names leave of {'the held-out' if left <= floor.error else 'all'} cycles"
    interval = low * scale, high * scale
    return replace(floor, error=error, interval=interval, per_cycle=floor.per_cycle * scale, source=source)


def told_by_all(floor: NoiseFloor, error: float, share: float) -> NoiseFloor:
    """The floor where nothing is missing: the held-out cycles' `error` (degC rms) is noise too, `share` of all cycles.

    Five cycles of a plant that scatters err by a quarter more or less than those before them by chance alone, so that
    what ten tell of these five is no better. Each cycle counts as one.
    """
    scale = float(np.sqrt((1.0 - share) + share * (error / floor.error) ** 2))
    low, high = floor.interval
    told = f"{floor.source}, and what the held-out ones err by"
    return replace(
        floor,
        error=floor.error * scale,
        interval=(low * scale, high * scale),
        per_cycle=floor.per_cycle * scale,
        source=told,
    )


def believed_size(stated: float, told: float, pieces: int, rules: DecisionRules) -> tuple[float, float]:
    """(how many times the fit's noise there is, its standard error in logarithms).

    The prior is what the given model states of its own free runs, the evidence what so many independent `pieces` have
    `told`. What is stated beyond that may be a cause that the model was learned without: it is no excuse.
    """
    known, before = 2.0 * pieces, rules.stated_noise_log_sd**-2
    if not 0 < stated < told:
        return told, known**-0.5
    both = known + before
    return float(np.exp((known * np.log(told) + before * np.log(stated)) / both)), both**-0.5


def size_by_equal_cycles(trial: HeldOutRun, explained: Fitted, rng: np.random.Generator, rules: DecisionRules) -> float:
    """By how much equal cycles differ, over what the fit's noise makes of it; infinite where too few can be compared.

    The noise is drawn over the same cycles, with what the fit's parameters take from it.
    """
    scatter = scatter_of_equal_cycles(trial.record, trial.residual, rules)
    if not np.isfinite(scatter):
        return scatter
    columns = window_sensitivity(move_frame(explained.frame, trial.record), trial.state, trial.start)
    noise = trial.whitener.draw(rng, EQUAL_DRAWS)
    precision = trial.whitener.gram(columns) + np.diag(np.maximum(explained.prior, 1e-12))
    left = trial.restart_residual(noise - columns @ np.linalg.solve(precision, trial.whitener.weigh(columns).T @ noise))
    return scatter / scatter_of_equal_cycles(trial.record, left, rules)


def limit_parameter_errors(trial: HeldOutRun, taken: Array, alone: Array, most: float) -> Array:
    """(m, d) degC what a fit's wrong parameters err by, `taken`, made so small in each cycle that the noise `alone` and
    they together are at most `most` times the noise alone (rms over the draws).

    Where held-out cycles show what the fitted ones hardly do, the linear problem would let a parameter go anywhere. One
    share for all draws of a cycle, so that the floor and its interval are told from the same errors.
    """
    cycle = np.unique(trial.record.window_whole, return_inverse=True)[1]
    noise, wrong = trial.restart_residual(alone), trial.restart_residual(taken)
    own, both, by = (
        np.bincount(cycle, np.sum(one * other, axis=1))
        for one, other in ((noise, noise), (noise, wrong), (wrong, wrong))
    )
    # The positive root s of |n - s w|^2 = most^2 |n|^2.
    more = (most**2 - 1.0) * own
    share = (both + np.sqrt(both**2 + by * more)) / np.maximum(by, 1e-300)
    return np.asarray(np.minimum(share, 1.0)[cycle][:, None] * taken)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def stated_errors(model: Model, laid_out: Sequence[Trace], fitted: Fitted) -> Array:
    """(c,) degC rms over the windows of each fitted cycle of the free runs, as the given model states it for itself.

    As it was measured on days of its own, else as its noise says along these cycles (`laid_out` are the encoded traces
    in their order); infinite where it says nothing. What a recorder does not see is no part of that: what its readings
    err by, and what turns between rows that lie further apart than those that the model's alphabet is made for.
    """
    record, sensor = fitted.frame.record, sensor_alone(fitted).sensor
    cycles = np.unique(record.whole)
    stated = model.provenance.scores.get("held_out_rmse", 0.0)
    if stated > 0:
        # Stated of single readings: their noise gives way to that of a window's mean.
        own = np.full(cycles.size, np.sqrt(max(stated**2 - sensor_noise(record) ** 2, 0.0)))
    else:
        own = model_spread(model, laid_out, record, cycles)
    trial = let_run(fitted, record.by_cycles())
    known_s, unsure = record.model.alphabet.gap / GAP_RATIO, fitted.behind[1]
    unseen = unseen_switches(move_frame(fitted.frame, trial.record), trial.state, known_s, unsure)
    place = np.searchsorted(cycles, trial.record.window_whole)
    sums, counts = (np.bincount(place, weights, minlength=cycles.size) for weights in (unseen, None))
    return np.asarray(np.sqrt(own**2 + sensor**2 + sums / np.maximum(counts, 1)))


def read_alone(trial: HeldOutRun, cycles: Indices, sensor: NoiseModel, rng: np.random.Generator) -> Array:
    """(c,) degC rms of each cycle's free run where only the reading errs: in its windows, and at its start."""
    grid = trial.whitener.grid
    sharp = replace(grid, late=0.0 * grid.late, shared=0.0 * grid.shared, inrush=0.0 * grid.inrush)
    return predict_errors(trial, cycles, Whitener(sharp, sensor).draw(rng, FLOOR_DRAWS))[0]


def predict_errors(trial: HeldOutRun, cycles: Indices, drawn: Array) -> tuple[Array, Array]:
    """(degC rms of each cycle (c,), of all of them in each draw (d,)) of free runs that err by residuals drawn (m, d).

    Parametric bootstrap: residuals are begun as measured ones are.
    """
    residual, number = trial.restart_residual(drawn), trial.record.window_whole
    kept = np.isin(number, cycles)
    place = np.searchsorted(cycles, number[kept])
    sums = _sums(residual[kept] ** 2, place)
    counts = np.bincount(place)
    return np.sqrt(sums.mean(axis=1) / counts), np.sqrt(sums.sum(axis=0) / counts.sum())


def sensor_alone(fitted: Fitted) -> NoiseModel:
    """The noise of a plant that is exact but for what is read of it: the sensor's, and its rounding."""
    record = fitted.frame.record
    in_window = sensor_noise(record) / float(np.sqrt(averaged_readings(record)))
    in_window = max(in_window, rounding_error(record.model, record), MIN_READING_ERROR_DEGC)
    return NoiseModel(sensor=in_window, process=0.0, rough=0.0, cycle=0.0)


def scatter_of_equal_cycles(record: Record, residual: Array, rules: DecisionRules) -> float:
    """degC rms by which free runs over equal cycles err differently; infinite where too few cycles can be compared.

    `residual` (m,) or (m, d) degC are their windows' errors, in each of d draws.

    Cells are a location and a time since the last switch. What errs alike in all cycles of a cell is taken out: a
    cause that is missing does the same in equal cycles, and noise does not.
    """
    place = record.runs.place[record.rows[record.begins]]
    phase = np.searchsorted(PHASES_S, record.window_means(since_switch(record)), side="right")
    cell = np.unique(np.column_stack([place, phase]), axis=0, return_inverse=True)[1].ravel()
    cycle = np.unique(record.window_whole, return_inverse=True)[1]
    pairs, member = np.unique(np.column_stack([cell, cycle]), axis=0, return_inverse=True)
    shared = np.bincount(pairs[:, 0])
    comparable = shared[cell] >= rules.equal_least_cycles
    if comparable.mean() < rules.comparable_least_share:
        return float("inf")
    columns, member = residual.reshape(residual.shape[0], -1), member.ravel()
    of_cycle = _sums(columns, member) / np.bincount(member)[:, None]
    left = columns - (_sums(of_cycle, pairs[:, 0]) / shared[:, None])[cell]
    weight = shared[cell] / np.maximum(shared[cell] - 1, 1)
    return _rms((left * np.sqrt(weight)[:, None])[comparable])


def _sums(columns: Array, group: Indices) -> Array:
    """(g, d) the sums of the rows of columns (m, d) that are of one group; no group is without a row."""
    order = np.argsort(group, kind="stable")
    return np.asarray(np.add.reduceat(columns[order], np.flatnonzero(np.diff(group[order], prepend=-1))))


def sensor_noise(record: Record) -> float:
    """degC the standard deviation of a reading, by the second differences of neighbouring rows, at rest if possible.

    What the temperature does over three rows is nearly a straight line, and drops out of them. So would an error that
    lasts over rows: of such a sensor the model's own figure is taken.
    """
    if record.model.sensor_memory:
        return record.model.sensor_sigma
    runs, rows = record.runs, record.rows
    reading, time, run = runs.reading[rows], runs.time[rows], runs.run[rows]
    step = np.diff(time)
    together = (run[2:] == run[:-2]) & (np.abs(step[1:] - step[:-1]) < 0.1 * np.median(step))
    resting = together & (np.maximum(record.running[rows][2:], record.running[rows][:-2]) < 0.5)
    chosen = resting if int(resting.sum()) >= MIN_REST_ROWS else together
    second = (reading[2:] - 2.0 * reading[1:-1] + reading[:-2])[chosen]
    # Var(a - 2 b + c) is 6 of one reading's.
    return float(np.sqrt(np.mean(second**2) / 6.0)) if second.size else 0.0


def excess(stated: Array, fitted: Fitted, rules: DecisionRules) -> Excess | None:
    """The excess of a fit over what the given model states (`stated_errors`); None where it states nothing."""
    if not np.isfinite(stated).all():
        return None
    squares, _, cycles = mean_squares(let_run(fitted, fitted.frame.record.by_cycles()))
    ratio = np.sqrt(squares) / stated[np.isin(np.unique(fitted.frame.record.whole), cycles)]
    return Excess(float(np.median(ratio)), float(np.quantile(ratio, rules.wide_low_share)))


def model_spread(model: Model, traces: Sequence[Trace], record: Record, cycles: Indices) -> Array:
    """(c,) degC rms of the given model's own spread on these cycles, the median of all where it says nothing of one;
    infinite where it says nothing at all."""
    # The fit's targets are those of this machine: what the model allows one machine to lie off is no allowance beside.
    model = replace(model, sha=drop_features(model.sha, "machine offset"))
    spreads = np.full(cycles.size, np.nan)
    for number, pieces in enumerate(_cycles(record, cycles, traces)):
        for piece in pieces:
            readings = piece.signals.get(model.temperature, np.empty(0))
            if np.isfinite(readings).sum() < 2:  # nothing to start from, or nothing after it: no run along this cycle
                continue
            # "resync": an event for which the given model has no edge costs a jump here, and not the whole diagnosis.
            spread = float(np.sqrt(np.mean(open_loop(model, piece, "resync").variance)))
            if np.isfinite(spread) and spread > 0:
                spreads[number] = spread
    seen = np.isfinite(spreads)
    return np.where(seen, spreads, float(np.median(spreads[seen])) if seen.any() else np.inf)


def _cycles(record: Record, cycles: Indices, traces: Sequence[Trace]) -> Iterator[list[Trace]]:
    """The traces' rows in each of these cycles, with all events up to their ends."""
    for number in cycles:
        times = record.runs.time[record.whole == number]
        begin, end = float(times[0]), float(np.nextafter(times[-1], np.inf))
        pieces = [(trace, trace.between(begin, end)) for trace in traces]
        yield [
            replace(piece, events=tuple(event for event in trace.events if event.time < end))
            for trace, piece in pieces
            if piece.times.size
        ]
