"""The calibration correction T' = k T + b of a model, learned from traces and judged on what it was not learned from.

Along a trace an open-loop run is affine in its start temperature: T(t) = D(t) T(0) + M(t), D falling from 1 to 0 as the
start is forgotten. A corrected run starts where the sensor does, T'(0) = y(0), so

    T'(t) = D(t) y(0) + k M(t) + b (1 - D(t)),

which is linear in k and b: they are fitted to y - D y(0), robustly (Huber). Errors of an open loop persist, so readings
of one run are not independent: standard errors are those of a jackknife that leaves out whole traces, and so is the
held-out error. Where there are few traces, long ones are cut into runs that start anew, and those take their place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, nan, sqrt
from typing import Literal

import numpy as np

from sim.engine import errors, mean_outputs, open_loop, open_loop_schedule, readings
from sim.lab.learning.data import resolution, without_spikes
from sim.lab.learning.free_run import HUBER_LIMIT
from sim.lab.learning.held_out import huber_scale
from sim.lab.learning.runs import Indices
from sim.lab.learning.structure import LearningError
from sim.sha import Array, Correction, Model, Trace, content_hash, display_unit, joint_hash

Form = Literal["offset", "gain", "affine"]
FORMS: tuple[Form, ...] = ("gain", "affine")
"""T' = k T, the thesis's form, and T' = k T + b; the simplest first. `offset` is T' = T + b, asked for by name."""

Progress = Callable[[str, float], None]

MIN_CLUSTERS = 8
"""Runs that are left out in turn, at least: with fewer traces long ones are cut."""
MIN_READINGS = 10
MIN_PIECE_READINGS = 60
"""Readings that a run must have, and those below which it is cut no further."""
MAX_READINGS = 400
"""Readings of one run that enter the fit; more are thinned evenly, the held-out error is taken at all of them."""
LEAST_GAIN, MOST_GAIN = 0.5, 2.0
"""Bounds of a gain: beyond them a model is wrong, which no calibration mends."""
MAX_CONDITION = 1e4
"""Of the scaled regressors: above it the traces cannot tell a gain from an offset."""


@dataclass(frozen=True, slots=True)
class CorrectionFit:
    """One form fitted: the `correction`, its standard errors, and the mean absolute error (degC) of held-out runs.

    `before` is the error of the model as it is, `after` that of the corrected one, `improvement` their difference and
    `improvement_error` its standard error, all over `runs` runs that count alike. `accepted`: the improvement is more
    than its standard error and the gain a possible one; `reason` says why or why not.
    """

    form: Form
    correction: Correction
    gain_error: float
    offset_error: float
    before: float
    after: float
    improvement: float
    improvement_error: float
    runs: int
    readings: int
    accepted: bool
    reason: str


@dataclass(frozen=True, slots=True)
class LearnedCorrection:
    """The `correction` to use (the model's own where none was accepted), the `fits` of all forms, and the chosen one.

    `skipped` are the names of traces with too few readings.
    """

    correction: Correction
    fits: tuple[CorrectionFit, ...]
    chosen: Form | None
    skipped: tuple[str, ...]

    @property
    def best(self) -> CorrectionFit:
        """The fit of the chosen form; of the simplest one where none was accepted."""
        return next((fit for fit in self.fits if fit.form == self.chosen), self.fits[0])


@dataclass(frozen=True, slots=True)
class _Regressors:
    """One run: `left` = y - D y(0), and the regressors `gain` = M and `offset` = 1 - D, each (n,)."""

    left: Array
    gain: Array
    offset: Array


def learn_correction(
    model: Model, traces: Sequence[Trace], *, forms: Sequence[Form] = FORMS, progress: Progress | None = None
) -> LearnedCorrection:
    """The correction of `model` that encoded `traces` ask for, which should not be those that it was fitted to.

    It takes the place of the one that the model has. `forms` begin with the simplest: of several accepted ones the
    first is taken that the held-out error does not tell from the best (no worse by more than one standard error).

    Raises LearningError when fewer than two runs are left to learn from and to judge by.
    """
    if not forms:
        raise LearningError("no form of correction was asked for; give gain, affine or both")
    report = progress or (lambda _stage, _share: None)
    runs, skipped = correction_runs(traces, model.temperature)
    if len(runs) < 2:
        raise LearningError(
            f"{len(runs)} usable run(s) of {model.temperature!r} in {len(traces)} traces: a correction is judged by "
            f"runs that it was not learned from, so at least 2 with {MIN_READINGS} readings each are needed"
        )
    report("running the model", 0.0)
    bare = replace(model, correction=Correction())
    rows = [_regressors(bare, run) for run in runs]
    before = np.array([_error(model, run) for run in runs])
    fits: list[tuple[CorrectionFit, Array]] = []
    for number, form in enumerate(forms):
        report(f"fitting {form}", 0.2 + 0.8 * number / len(forms))
        fits.append(_fit_form(form, bare, runs, rows, before))
    report("done", 1.0)
    accepted = [pair for pair in fits if pair[0].accepted]
    chosen: CorrectionFit | None = None
    if accepted:
        # The one-standard-error rule, run by run: the simplest form that is not worse than the best by more than that.
        best, best_errors = min(accepted, key=lambda pair: pair[0].after)
        chosen = best
        for fit, errors_of_runs in accepted:
            gap, error = _mean_and_error(errors_of_runs - best_errors)
            if gap <= error:
                chosen = fit
                break
    correction = chosen.correction if chosen else model.correction
    return LearnedCorrection(correction, tuple(fit for fit, _ in fits), chosen.form if chosen else None, skipped)


def correction_runs(traces: Sequence[Trace], temperature: str) -> tuple[list[Trace], tuple[str, ...]]:
    """The runs, each beginning at its first reading, without isolated spikes; the traces that are left out."""
    runs, skipped = [], []
    for trace in traces:
        column = trace.signals.get(temperature)
        if column is None or np.count_nonzero(np.isfinite(column)) < MIN_READINGS:
            skipped.append(trace.name)
            continue
        cleaned = without_spikes(column, resolution(column))
        runs.append(replace(trace, signals={**trace.signals, temperature: cleaned}))
    while 0 < len(runs) < MIN_CLUSTERS:
        place = max(range(len(runs)), key=lambda number: _readings(runs[number], temperature))
        longest = runs[place]
        if _readings(longest, temperature) < 2 * MIN_PIECE_READINGS:
            break
        # Both halves keep all events and inputs, which say where the automaton is; only the readings are shared out.
        column = longest.signals[temperature]
        middle = np.flatnonzero(np.isfinite(column))[_readings(longest, temperature) // 2]
        early = np.arange(column.size) < middle
        runs[place : place + 1] = [
            replace(
                longest,
                name=f"{longest.name}, part",
                signals={**longest.signals, temperature: np.where(half, column, np.nan)},
            )
            for half in (early, ~early)
        ]
    return runs, tuple(skipped)


def _readings(trace: Trace, temperature: str) -> int:
    return int(np.count_nonzero(np.isfinite(trace.signals[temperature])))


def drop_limits(bare: Model) -> Model:
    """Without limits and clamp, which a course that is affine in its start and its targets cannot have."""
    return replace(bare, sha=replace(bare.sha, max_rate=inf, low=-inf, high=inf))


def fitted_readings(readings: int) -> Indices:
    """The readings of a run that enter a fit: never its first, from which it starts, evenly MAX_READINGS at most."""
    return np.unique(np.linspace(1, readings - 1, min(readings - 1, MAX_READINGS)).astype(np.intp))


def _regressors(bare: Model, run: Trace) -> _Regressors:
    free = drop_limits(bare)
    times, values = readings(run, bare.temperature)
    steps = open_loop_schedule(free, run, "resync")
    # D(t) as the difference between two courses whose starts are one degree apart.
    mean, higher = mean_outputs(steps, [(float(values[0]), 0.0), (float(values[0]) + 1.0, 0.0)])
    forgotten = 1.0 - (higher - mean)
    keep = fitted_readings(times.size)
    row = np.searchsorted(steps.times, times[keep], side="right") - 1
    start = (1.0 - forgotten[row]) * values[0]
    return _Regressors(values[keep] - start, mean[row] - start, forgotten[row])


def _solve(form: Form, rows: Sequence[_Regressors]) -> tuple[float, float] | None:
    """(gain, offset) by iteratively reweighted least squares; None where the runs cannot tell them apart."""
    gain, left = np.concatenate([row.gain for row in rows]), np.concatenate([row.left for row in rows])
    offset = np.concatenate([row.offset for row in rows])
    columns = {"offset": [offset], "gain": [gain], "affine": [gain, offset]}[form]
    left = left - gain if form == "offset" else left
    found = robust_fit(columns, left)
    if found is None:
        return None
    values = found.tolist()
    return (1.0, values[0]) if form == "offset" else (values[0], values[1] if form == "affine" else 0.0)


def robust_fit(columns: Sequence[Array], left: Array) -> Array | None:
    """(p,) the factors of `columns` (each (n,)) in `left`, by Huber's loss; None where they cannot be told apart."""
    scale = np.array([max(float(np.sqrt(np.mean(column**2))), 1e-12) for column in columns])
    X = np.column_stack(columns) / scale
    if not np.any(X) or np.linalg.cond(X) > MAX_CONDITION:
        return None
    weight, solved = np.ones(left.size), np.zeros(len(columns))
    for _ in range(30):
        root = np.sqrt(weight)
        before, solved = solved, np.linalg.lstsq(X * root[:, None], left * root, rcond=None)[0]
        error = np.abs(left - X @ solved)
        limit = HUBER_LIMIT * huber_scale(error)
        weight = np.minimum(1.0, limit / np.maximum(error, limit * 1e-9))
        if np.allclose(before, solved, rtol=1e-9, atol=1e-12):
            break
    return np.asarray(solved / scale)


def jackknife_error(left_out: Array) -> Array:
    """(p,) the standard errors of what was fitted, from the fits that each lack one run, (runs, p)."""
    count = len(left_out)
    return np.asarray(np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0)))


def _fit_form(
    form: Form, bare: Model, runs: Sequence[Trace], rows: Sequence[_Regressors], before: Array
) -> tuple[CorrectionFit, Array]:
    """The fit of a form, and the held-out error of each run."""
    whole = _solve(form, rows)
    parts = [_solve(form, [row for place, row in enumerate(rows) if place != out]) for out in range(len(rows))]
    count, readings = len(runs), sum(row.left.size for row in rows)
    if whole is None or None in parts or not LEAST_GAIN <= whole[0] <= MOST_GAIN:
        reason = "the traces do not tell it" if form == "offset" else "the traces cannot tell a gain from an offset"
        if whole is not None and None not in parts:
            reason = f"a gain of {whole[0]:.3g} is no calibration ({LEAST_GAIN:g} to {MOST_GAIN:g}): learn a new model"
        figures = (nan, nan, float(before.mean()), nan, nan, nan, count, readings)
        return CorrectionFit(form, Correction(), *figures, accepted=False, reason=reason), np.full(count, nan)
    left_out = np.array([part for part in parts if part is not None])
    spread = jackknife_error(left_out)
    # Each run is judged by the fit that lacks it. A fit without one run may lie beyond a possible gain: it is held in.
    held_in = [Correction(min(max(part[0], LEAST_GAIN), MOST_GAIN), part[1]) for part in left_out.tolist()]
    after = np.array([_error(replace(bare, correction=each), run) for each, run in zip(held_in, runs, strict=True)])
    gain, error = _mean_and_error(before - after)
    accepted = gain > error
    better = f"the held-out error falls by {gain:.3g} +- {error:.2g} {display_unit(bare.unit)}"
    fit = CorrectionFit(
        form=form,
        correction=Correction(*whole),
        gain_error=float(spread[0]),
        offset_error=float(spread[1]),
        before=float(before.mean()),
        after=float(after.mean()),
        improvement=gain,
        improvement_error=error,
        runs=count,
        readings=readings,
        accepted=accepted,
        reason=better if accepted else f"{better}, which is not more than its standard error",
    )
    return fit, after


def _error(model: Model, run: Trace) -> float:
    """Mean absolute open-loop error (degC) at the readings of a run."""
    return errors(open_loop(model, run, "resync"), run, model.temperature).at_samples.mae


def _mean_and_error(values: Array) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1)) / sqrt(values.size)


def corrected_model(model: Model, learned: LearnedCorrection, traces: Sequence[Trace], parent: str) -> Model:
    """The model with the correction learned from `traces`; `parent` is what it was derived from.

    Method, traces and data hash stay those of the automaton; the correction's own stand among settings and scores.
    """
    fit = learned.best
    if learned.chosen is None:
        return replace(model, provenance=replace(model.provenance, parent=parent))
    settings = {
        **model.provenance.settings,
        "correction_form": fit.form,
        "correction_data": joint_hash(traces),
        "correction_runs": fit.runs,
    }
    figures = {
        "correction_gain_error": fit.gain_error,
        "correction_offset_error": fit.offset_error,
        "correction_mae_before": fit.before,
        "correction_mae_after": fit.after,
    }
    scores = {**model.provenance.scores, **{name: value for name, value in figures.items() if isfinite(value)}}
    contents = tuple(sorted({*model.provenance.contents, *(content_hash(trace) for trace in traces)}))
    provenance = replace(model.provenance, settings=settings, scores=scores, parent=parent, contents=contents)
    return replace(model, correction=learned.correction, provenance=provenance)
