"""Rivals on the same cases: one-step regression with BIC, and sparse regression (pysindy's STLSQ, alone and ensemble).

All three regress the rate of change of block means on the baseline's own terms and on candidate columns. Their settings
were chosen on the development set alone (docs/discrepancy.md says how), once, for all strata.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.discrepancy.bearings import family_of
from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.rival_data import (
    Blocks,
    Column,
    Log,
    averaged,
    baseline,
    blocks,
    candidates,
    free_run,
    read_log,
)
from benchmarks.discrepancy.runner import Case, Outcome

RIDGE = 0.01
"""Ridge of the sparse regressions, as a share of the columns' own squares."""
AT_MOST = 3
"""Names that a rival may give, as the tool under test may."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What was tuned: `block` (s) of the differences; `margin`: times the BIC penalty of a name; `threshold`: least
    share of the rate's scatter that a sparse term must carry; `inclusion`: least share of ensemble members with it."""

    block: float = 120.0
    margin: float = 3.0
    threshold: float = 0.1
    inclusion: float = 0.8


TUNED: Mapping[str, Settings] = {
    "one-step-bic": Settings(block=300.0, margin=16.0),
    "sindy-stlsq": Settings(block=300.0, threshold=0.4),
    "sindy-ensemble": Settings(block=300.0, threshold=0.3),
}
"""By method, as `python -m benchmarks.discrepancy tune` chose them."""
Chosen = list[tuple[str, Column]]


@dataclass(frozen=True, slots=True)
class Problem:
    """A regression: `rate` and the baseline's columns at the fitted pairs, and the candidates' alternatives there."""

    log: Log
    cut: Blocks
    own: list[Column]
    rate: Array
    base: Array
    offered: Mapping[str, list[tuple[Column, Array]]]


def problem(case: Case, settings: Settings) -> Problem:
    """The regression of a case: the first 70 % of its time, cut into blocks."""
    log = read_log(case.traces)
    cut = blocks(log, settings.block)
    own = baseline(log, family_of(case.model))
    fitted = cut.fitted
    rate = cut.differences(np.nan_to_num(log.temperature))[fitted]
    base = np.stack([averaged(log, cut, one)[fitted] for one in own], axis=1)
    weights = np.linalg.lstsq(base, rate, rcond=None)[0]
    heat = sum((w * one.constant for w, one in zip(weights, own, strict=True)), np.zeros(log.times.size))
    offered = {
        name: [(one, averaged(log, cut, one)[fitted]) for one in columns]
        for name, columns in candidates(log, heat).items()
    }
    left = rate - base @ weights
    offered["sensor-offset-step"] = [_jump(log, cut, left)]
    return Problem(log, cut, own, rate, base, offered)


def _jump(log: Log, cut: Blocks, left: Array) -> tuple[Column, Array]:
    """A step of the reading between the two blocks where the residual rate is most extreme."""
    at = int(np.argmax(np.abs(left)))
    place = cut.pairs[cut.fitted][at]
    column = np.zeros(left.size)
    column[at] = 1.0 / cut.seconds
    row = int(np.argmax(cut.number > place))
    constant = np.zeros(log.times.size)
    constant[row] = 1.0 / max(log.times[min(row + 1, log.times.size - 1)] - log.times[row], 1.0)
    return Column(constant, np.zeros(log.times.size), 0, 1), column


def one_step_bic(given: Problem, settings: Settings) -> Chosen:
    """Forward selection by BIC over the candidates' alternatives, each with the sign that makes sense."""
    offers = [(name, *one) for name, alternatives in given.offered.items() for one in alternatives]
    values = np.stack([column for *_, column in offers], axis=1)
    sign = np.array([column.sign for _, column, _ in offers])
    penalty = settings.margin * np.log(given.rate.size) * (1.0 + np.array([column.extra for _, column, _ in offers]))
    kept, rate = _without(given.base, values), _without(given.base, given.rate[:, None])[:, 0]
    usable = np.linalg.norm(kept, axis=0) > 0.02 * np.linalg.norm(values - values.mean(axis=0), axis=0)
    chosen: Chosen = []
    while len(chosen) < AT_MOST and usable.any():
        length = np.maximum(np.linalg.norm(kept, axis=0), 1e-300)
        weight = kept.T @ rate / length
        share = np.clip(weight**2 / (rate @ rate), 0.0, 1 - 1e-12)
        gain = -rate.size * np.log1p(-share) - penalty
        gain[~usable | ((sign != 0) & (np.sign(weight) != sign))] = -np.inf
        best = int(np.argmax(gain))
        if not gain[best] > 0:
            break
        chosen.append((offers[best][0], offers[best][1]))
        taken = kept[:, [best]]
        kept, rate = _without(taken, kept), _without(taken, rate[:, None])[:, 0]
        usable &= np.array([name != offers[best][0] for name, *_ in offers])
    return chosen


def _without(columns: Array, values: Array) -> Array:
    """(rows, k) `values` with the span of `columns` taken out."""
    basis, _ = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    return np.asarray(values - basis @ (basis.T @ values))


def _library(given: Problem) -> tuple[list[tuple[str, Column]], Array, Array]:
    """(labels, columns, rate) with the baseline taken out of all, in units of their own scatter.

    Of the alternatives of a name the library has the one that says most about the rate: a library with all of them is
    so collinear that sparse regression plays them off against one another.
    """
    offers = [(name, *one) for name, alternatives in given.offered.items() for one in alternatives]
    raw = np.stack([values for *_, values in offers], axis=1)
    both = _without(given.base, np.column_stack([raw, given.rate]))
    spread = both.std(axis=0)
    seen = spread[:-1] > 0.02 * np.maximum(raw.std(axis=0), 1e-300)
    scaled = both / np.maximum(spread, 1e-300)
    told = np.where(seen, np.abs(scaled[:, :-1].T @ scaled[:, -1]), -1.0)
    names = [name for name, *_ in offers]
    best = [max((n for n, one in enumerate(names) if one == name), key=lambda n: told[n]) for name in given.offered]
    kept = [n for n in best if seen[n]]
    return [(offers[n][0], offers[n][1]) for n in kept], scaled[:, kept], scaled[:, -1]


def _strongest(labels: Sequence[tuple[str, Column]], weights: Array) -> Chosen:
    """The strongest alternative of each name with a weight of the right sign, strongest name first."""
    best: dict[str, tuple[float, Column]] = {}
    for (name, column), weight in zip(labels, weights, strict=True):
        right = weight != 0 and (column.sign == 0 or np.sign(weight) == column.sign)
        if right and abs(weight) > best.get(name, (0.0, column))[0]:
            best[name] = (abs(float(weight)), column)
    order = sorted(best, key=lambda name: -best[name][0])
    return [(name, best[name][1]) for name in order[:AT_MOST]]


def stlsq(given: Problem, settings: Settings) -> Chosen:
    """pysindy's sequentially thresholded least squares on the library; what survives is named."""
    import pysindy

    labels, columns, rate = _library(given)
    optimizer = pysindy.STLSQ(threshold=settings.threshold, alpha=RIDGE * rate.size, max_iter=50)
    with _nothing_is_an_answer():
        found = optimizer.fit(columns, rate[:, None])
    return _strongest(labels, found.coef_[0])


def ensemble(given: Problem, settings: Settings) -> Chosen:
    """pysindy's ensemble of STLSQ over bags of rows; a term is named when most members keep it."""
    import pysindy

    labels, columns, rate = _library(given)
    inner = pysindy.STLSQ(threshold=settings.threshold, alpha=RIDGE * rate.size, max_iter=50)
    np.random.seed(0)  # pysindy draws its bags from the global generator
    with _nothing_is_an_answer():
        outer = pysindy.EnsembleOptimizer(inner, bagging=True, n_models=20).fit(columns, rate[:, None])
    members = np.array([np.asarray(one)[0] for one in outer.coef_list])
    often = np.mean(members != 0, axis=0) >= settings.inclusion
    return _strongest(labels, np.where(often, np.median(members, axis=0), 0.0))


@contextmanager
def _nothing_is_an_answer() -> Iterator[None]:
    """pysindy warns when the threshold leaves no term: here that says "nothing is missing"."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparsity parameter is too big")
        yield


METHODS: Mapping[str, Callable[[Problem, Settings], Chosen]] = {
    "one-step-bic": one_step_bic,
    "sindy-stlsq": stlsq,
    "sindy-ensemble": ensemble,
}


@dataclass(frozen=True, slots=True)
class Rival:
    """A rival as the runner calls it: same answer format as the tool, errors of the same kind."""

    method: str
    settings: Settings | None = None

    def __call__(self, case: Case, limit: float) -> Outcome:
        """Diagnose a case; `limit` is not needed, a regression takes seconds."""
        from threadpoolctl import threadpool_limits

        del limit
        began = perf_counter()
        try:
            with threadpool_limits(1):
                settings = self.settings or TUNED[self.method]
                given = problem(case, settings)
                diagnosis = _diagnosis(given, METHODS[self.method](given, settings))
        except (ValueError, np.linalg.LinAlgError) as error:
            return Outcome(case.name, "error", perf_counter() - began, message=f"{type(error).__name__}: {error}")
        return Outcome(case.name, "done", perf_counter() - began, diagnosis)


def _diagnosis(given: Problem, chosen: Chosen) -> dict[str, Any]:
    """The answer in the tool's own format, with free-run errors of the refitted terms before and after."""
    before = _held_out(given, [])
    after = _held_out(given, [column for _, column in chosen]) if chosen else before
    return {
        "verdict": "named" if chosen else "agree",
        "effects": [{"name": name, "class": [name]} for name, _ in chosen],
        "held_out": {"rmse_before": before, "rmse_after": after},
    }


def _held_out(given: Problem, added: list[Column]) -> float:
    columns = [*given.own, *added]
    fitted = given.cut.fitted
    values = np.stack([averaged(given.log, given.cut, one)[fitted] for one in columns], axis=1)
    scale = np.maximum(np.linalg.norm(values, axis=0), 1e-300)
    weights = np.linalg.lstsq(values / scale, given.rate, rcond=1e-10)[0] / scale
    square, _ = free_run(given.log, columns, weights)
    return float(np.sqrt(square))
