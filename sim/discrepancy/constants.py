"""What a model has absorbed is still to be seen in its constants: gains that rise from bin to bin are one square.

A model with a target (and a gain) for each bin of the current can write a quadratic heat as three straight lines, and
then nothing is missing. So the constants themselves are looked at: the law of fewest coefficients from which they
differ by no more than chance, under which the held-out free run is not further off.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from sim.discrepancy.diagnosis import AbsorbedLaw
from sim.discrepancy.fitting import Fitted, Record, held
from sim.discrepancy.held_out import let_run
from sim.learning import Indices
from sim.sha import RELAXING, Array

CHANCE, NO_WORSE = 0.01, 1.01
"""The p from which constants differ from a law by chance, and times the held-out error that a law may have."""
LEAST_SAVED = 2
"""Constants that a law must save to be worth a word."""

Basis = Callable[[Array], Array]


def absorbed(fitted: Fitted, signal: str, held_out: Record) -> AbsorbedLaw | None:
    """The law over `signal` that stands for the targets and gains of the bins in which the machine runs; None: none.

    Only among locations of one rate, which together are one heat balance.
    """
    record, shape = fitted.frame.record, fitted.frame.shape
    places = [place for place in running_places(record) if shape.target[place] >= 0]
    kinds = {shape.kinds[place] for place in places}
    if len(places) < 2 or len({int(shape.rate[place]) for place in places}) > 1 or not kinds <= set(RELAXING):
        return None
    signals = record.signals.index(signal)
    targets = np.array([shape.target[place] for place in places])
    gains = np.array([shape.gain[place, signals] for place in places])
    numbers = np.unique(np.concatenate([targets, gains[gains >= 0]]))
    own = fitted.own
    covariance = fitted.covariance[:own, :own]
    block = covariance[np.ix_(numbers, numbers)]
    values = fitted.state.linear[numbers]
    before = float(np.sqrt(np.mean(let_run(fitted, held_out).residual ** 2)))
    for name, words, bases, searched in laws(record, places, signal):
        count = len(bases) + searched
        if numbers.size - count < LEAST_SAVED:
            continue
        design = np.column_stack([imitated(fitted, places, signal, numbers, basis) for basis in bases])
        # Generalised least squares of the constants on the law, in the metric of what the data know of them.
        weight = np.linalg.pinv(block, hermitian=True)
        coefficients = np.linalg.lstsq(design.T @ weight @ design, design.T @ weight @ values, rcond=None)[0]
        off = design @ coefficients - values
        if scipy.special.chdtrc(numbers.size - count, float(off @ weight @ off)) < CHANCE:
            continue
        # The other constants go where they would with these held at the law's: their conditional mean.
        moved = fitted.state.parameters.copy()
        moved[:own] += covariance[:, numbers] @ weight @ off
        linear, rates = moved[: shape.centre.size], moved[shape.centre.size : own]
        trial = replace(fitted, state=replace(fitted.state, linear=linear, log_rates=rates))
        after = float(np.sqrt(np.mean(let_run(trial, held_out).residual ** 2)))
        if after <= NO_WORSE * before:
            return AbsorbedLaw(
                name=name,
                words=words,
                signal=signal,
                coefficients=tuple(coefficients.tolist()),
                constants=int(numbers.size),
                instead=count,
                rmse_before=before,
                rmse_after=after,
            )
    return None


def laws(record: Record, places: Sequence[int], signal: str) -> Iterator[tuple[str, str, tuple[Basis, ...], int]]:
    """(effect, the law in words, its terms, coefficients that were searched beside), the fewest coefficients first."""
    yield "current-heating", f"a + b {signal}", (np.ones_like, np.positive), 0
    yield "quadratic-current-heating", f"a + b {signal}^2", (np.ones_like, np.square), 0
    yield "quadratic-current-heating", f"a + b {signal} + c {signal}^2", (np.ones_like, np.positive, np.square), 0
    column = held(record, signal)
    middles = sorted(float(np.median(column[record.runs.place == place])) for place in places)
    for knee in middles[1:-1]:
        yield "current-saturation", f"a + b min({signal}, {knee:.3g})", (np.ones_like, partial(np.minimum, knee)), 1


def imitated(fitted: Fitted, places: Sequence[int], signal: str, numbers: Indices, basis: Basis) -> Array:
    """(numbers,) the targets and gains of straight lines in each place that come nearest to one term of a law."""
    record, shape = fitted.frame.record, fitted.frame.shape
    column, dt = held(record, signal), record.runs.dt
    order = record.signals.index(signal)
    rows: dict[int, list[tuple[float, float]]] = {}
    for place in places:
        here = (record.runs.place == place) & (dt > 0)
        x, weight = column[here] - shape.reference[place, order], dt[here]
        y = basis(column[here])
        middle, level = np.average(x, weights=weight), np.average(y, weights=weight)
        spread = float(np.sum(weight * (x - middle) ** 2))
        slope = 0.0
        if shape.gain[place, order] >= 0 and spread > 0:
            slope = float(np.sum(weight * (x - middle) * (y - level))) / spread
            rows.setdefault(int(shape.gain[place, order]), []).append((slope, spread))
        rows.setdefault(int(shape.target[place]), []).append((float(level - slope * middle), float(weight.sum())))
    # What places share is learned in proportion to what each tells of it.
    pairs = [np.array(rows[number]) for number in numbers.tolist()]
    return np.array([np.average(each[:, 0], weights=each[:, 1]) for each in pairs])


def running_places(record: Record) -> list[int]:
    """The locations in which the machine runs, by the time that was spent there."""
    place, dt = record.runs.place, record.runs.dt
    return [int(each) for each in np.flatnonzero(np.bincount(place, dt * (record.running - 0.5)) > 0)]
