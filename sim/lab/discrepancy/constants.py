"""What a model has absorbed is still to be seen in its constants: gains that rise from bin to bin are one square.

A model with a target (and a gain) for each bin of the current can write a quadratic heat as three straight lines, and
then nothing is missing; a pump that runs more at high loads stands in the targets as its share of each bin's time. So
the constants themselves are looked at: the law of fewest coefficients from which they differ by no more than chance,
under which the held-out free run is not further off.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from sim.lab.discrepancy.diagnosis import AbsorbedLaw
from sim.lab.discrepancy.fitting import Fitted, Record, hold_signal
from sim.lab.discrepancy.gap import sensor_noise
from sim.lab.discrepancy.held_out import let_run
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import Indices
from sim.sha import RELAXING_FLOWS, Array


@dataclass(frozen=True, slots=True)
class LawTerm:
    """One term of a law: a `function` of a signal, elementwise."""

    signal: str
    function: Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class ConstantsLaw:
    """A law that may stand for the constants: the effects that it is, in `words`, its `terms`, and how many numbers
    were `searched` beside their coefficients."""

    name: str
    words: str
    terms: tuple[LawTerm, ...]
    searched: int = 0

    @property
    def count(self) -> int:
        """Its numbers in all."""
        return len(self.terms) + self.searched


def find_absorbed_law(
    fitted: Fitted, current: str, held_out: Record, rules: DecisionRules, *, pump: str | None = None
) -> AbsorbedLaw | None:
    """The law over the signals that stands for the targets and gains of the bins in which the machine runs; None: none.

    Only among locations of one rate, which together are one heat balance.
    """
    record, shape = fitted.frame.record, fitted.frame.shape
    places = [place for place in running_places(record) if shape.target[place] >= 0]
    kinds = {shape.kinds[place] for place in places}
    if len(places) < 2 or len({int(shape.rate[place]) for place in places}) > 1 or not kinds <= set(RELAXING_FLOWS):
        return None
    targets = np.array([shape.target[place] for place in places])
    gains = np.array([shape.gain[place, record.signals.index(current)] for place in places])
    numbers = np.unique(np.concatenate([targets, gains[gains >= 0]]))
    own = fitted.own
    covariance = fitted.covariance[:own, :own]
    values = fitted.state.linear[numbers]
    # Generalised least squares of the constants on each law, in the metric of what the data know of them.
    weight = np.linalg.pinv(covariance[np.ix_(numbers, numbers)], hermitian=True)
    possible: list[tuple[int, float, ConstantsLaw, Array, Array]] = []
    for law in laws(record, places, current, pump):
        if numbers.size - law.count < rules.absorbed_least_saved:
            continue
        design = np.column_stack([imitate_line(fitted, places, current, numbers, term) for term in law.terms])
        coefficients = np.linalg.lstsq(design.T @ weight @ design, design.T @ weight @ values, rcond=None)[0]
        off = design @ coefficients - values
        misfit = float(off @ weight @ off)
        if scipy.special.chdtrc(numbers.size - law.count, misfit) >= rules.absorbed_least_p:
            possible.append((law.count, misfit, law, coefficients, off))
    before = float(np.sqrt(np.mean(let_run(fitted, held_out).residual ** 2)))
    felt = rules.material_sigmas * sensor_noise(record)
    # The fewest numbers first, and of as many the nearest.
    for count, _, law, coefficients, off in sorted(possible, key=lambda each: each[:2]):
        # The other constants go where they would with these held at the law's: their conditional mean.
        moved = fitted.state.parameters.copy()
        moved[:own] += covariance[:, numbers] @ weight @ off
        linear, rates = moved[: shape.centre.size], moved[shape.centre.size : own]
        trial = replace(fitted, state=replace(fitted.state, linear=linear, log_rates=rates))
        after = float(np.sqrt(np.mean(let_run(trial, held_out).residual ** 2)))
        # Three numbers in place of six are off by some of what the six are uncertain by: worse is what could be felt.
        if after**2 - before**2 < felt**2:
            return AbsorbedLaw(
                name=law.name,
                words=law.words,
                signal=current,
                coefficients=tuple(coefficients.tolist()),
                constants=int(numbers.size),
                instead=count,
                rmse_before=before,
                rmse_after=after,
            )
    return None


def laws(record: Record, places: Sequence[int], current: str, pump: str | None) -> Iterator[ConstantsLaw]:
    """Every law that is held against the constants."""
    level, line, square = (LawTerm(current, function) for function in (np.ones_like, np.positive, np.square))
    linear, quadratic = "current-heating", "quadratic-current-heating"
    yield ConstantsLaw(linear, f"a + b {current}", (level, line))
    yield ConstantsLaw(quadratic, f"a + b {current}^2", (level, square))
    yield ConstantsLaw(quadratic, f"a + b {current} + c {current}^2", (level, line, square))
    column = hold_signal(record, current)
    middles = sorted(float(np.median(column[record.runs.place == place])) for place in places)
    for knee in middles[1:-1]:
        bent = LawTerm(current, partial(np.minimum, knee))
        yield ConstantsLaw("current-saturation", f"a + b min({current}, {knee:.3g})", (level, bent), 1)
    if pump is not None:
        runs = LawTerm(pump, np.positive)
        yield ConstantsLaw(f"{linear} and pump-cooling", f"a + b {current} + c {pump}", (level, line, runs))
        yield ConstantsLaw(f"{quadratic} and pump-cooling", f"a + b {current}^2 + c {pump}", (level, square, runs))


def imitate_line(fitted: Fitted, places: Sequence[int], current: str, numbers: Indices, term: LawTerm) -> Array:
    """(numbers,) the targets and gains of straight lines in each place that come nearest to one term of a law."""
    record, shape = fitted.frame.record, fitted.frame.shape
    column, dt = hold_signal(record, current), record.runs.dt
    of_term = term.function(hold_signal(record, term.signal))
    order = record.signals.index(current)
    rows: dict[int, list[tuple[float, float]]] = {}
    for place in places:
        here = (record.runs.place == place) & (dt > 0)
        x, weight = column[here] - shape.reference[place, order], dt[here]
        y = of_term[here]
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
