"""How much machines differ: the spread of their targets about the model's, from runs of several of them.

Every run tells by how much its machine's targets lie off the model's, with an error. The variance between machines is
what their means scatter beyond those errors (DerSimonian & Laird 1986, the method of moments of a random-effects
meta-analysis). Few machines tell little of the next one: the standard deviation is multiplied by what makes the 90 %
band of a normal law as wide as the prediction interval of Student's t.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from sim.effects import of_machine
from sim.engine import linear_recursion
from sim.forecast import Z90
from sim.lab.learning.correction import learn_correction
from sim.lab.learning.free_run import FitShape, FreeRunFit, steps
from sim.lab.learning.noise import NoiseLevels
from sim.lab.learning.runs import FreeRuns, Indices
from sim.lab.learning.structure import LearningError
from sim.sha import RELAXING_FLOWS, Array, Effect, MachineCorrection, Model, Trace

PRIOR_SCATTER_DEGC = 3.0
"""degC by which the m of stays are believed to differ before any is seen; it counts for one stay."""
MIN_SENSOR_SIGMAS = 2.0
"""Standard errors by which the error must fall: the runs of one machine lie in few days, and share what these had."""
MAX_OFFSET_ERROR_DEGC = 100.0
"""degC: a run whose offset is not known better than this says nothing of its machine."""
MIN_OFFSET_ERROR_DEGC = 1e-3
"""degC: no offset is known better, whatever its runs say."""


@dataclass(frozen=True, slots=True)
class MachineSpread:
    """`offsets` (degC) of the machines in the training by name, `between` their standard deviation beyond errors.

    `sigma` (degC) is that of the next machine's offset as far as so few tell it; 0 where there is only one. `errors`
    (degC) are the standard errors of the offsets. So many machines were `told_apart`; one whose offset is not known has
    none. `has_targets` says whether any flow has a target that could lie off.
    """

    offsets: dict[str, float]
    between: float
    sigma: float
    errors: Mapping[str, float] = field(default_factory=dict)
    told_apart: int = 0
    has_targets: bool = True

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The offset as an automaton has it; nothing where machines are alike, or only one was seen."""
        return (Effect("machine-offset", {"sigma": self.sigma}),) if self.sigma > 0 else ()


def trace_machines(traces: Sequence[Trace], temperature: str) -> tuple[str, ...]:
    """The machine of each trace that has readings of `temperature`: as `free_runs` numbers them."""
    return tuple(trace.machine for trace in traces if np.isfinite(trace.signals.get(temperature, np.empty(0))).any())


def next_stay(scatter: float, stays: int, kind: str) -> float:
    """The sigma of the next stay's m, in the unit of m, where `stays` of them scatter by `scatter` in a flow of `kind`.

    As wide as so few allow (`small_sample`). Where m is a temperature it is drawn towards PRIOR_SCATTER_DEGC as if one
    stay had shown that; of a drift nothing is believed before: three degrees are no drift.
    """
    first = PRIOR_SCATTER_DEGC if kind in RELAXING_FLOWS else scatter
    drawn = np.sqrt((stays * scatter**2 + first**2) / (stays + 1))
    return float(drawn) * small_sample(stays)


def small_sample(count: int) -> float:
    """By how much the sigma of `count` values is widened so that a normal band holds the next value nine times in ten.

    Student's t with `count` degrees of freedom (one of them is that of the prior), and the error of the mean.
    """
    if count < 1:
        return small_sample(1)
    return float(scipy.special.stdtrit(count, 0.95)) / Z90 * float(np.sqrt(1.0 + 1.0 / count))


def machine_spread(
    runs: FreeRuns,
    shape: FitShape,
    fit: FreeRunFit,
    *,
    noise: NoiseLevels,
    groups: Indices,
    machines: Sequence[str],
) -> MachineSpread:
    """The spread of targets between the `machines`, one a trace of the runs (by `FreeRuns.trace`).

    `groups` (L,) numbers the locations that share a process noise.
    """
    names = sorted(set(machines))
    has_targets = any(kind in RELAXING_FLOWS for kind in shape.kinds)
    if len(names) < 2 or not has_targets:
        return MachineSpread({}, 0.0, 0.0, told_apart=len(names), has_targets=has_targets)
    numbers = np.array([names.index(each) for each in machines], dtype=np.intp)
    value, variance = _offsets(runs, shape, fit, noise=noise, groups=groups, machine=numbers)
    return offset_spread(
        dict(zip(names, value.tolist(), strict=True)), dict(zip(names, np.sqrt(variance), strict=True))
    )


def offset_spread(offsets: Mapping[str, float], errors: Mapping[str, float]) -> MachineSpread:
    """The spread of machines whose targets lie by `offsets` off the model's, with standard errors (degC), by name.

    Those of which nothing is known (an error that is no number, or MAX_OFFSET_ERROR_DEGC and more) are left out.
    """
    offset = {name: float(value) for name, value in offsets.items() if errors[name] < MAX_OFFSET_ERROR_DEGC}
    error = {name: max(float(errors[name]), MIN_OFFSET_ERROR_DEGC) for name in offset}
    count = len(offset)
    if count < 2:
        return MachineSpread(offset, 0.0, 0.0, error, len(offsets))
    means, weight = np.array(list(offset.values())), 1.0 / np.square(list(error.values()))
    heterogeneity = float(weight @ (means - np.average(means, weights=weight)) ** 2)
    spread = (heterogeneity - (count - 1)) / (weight.sum() - float(weight @ weight) / weight.sum())
    between = float(np.sqrt(max(spread, 0.0)))
    return MachineSpread(offset, between, between * small_sample(count - 1), error, len(offsets))


def machine_corrections(model: Model, traces: Sequence[Trace], spread: MachineSpread) -> dict[str, MachineCorrection]:
    """What each machine of the training has of its own in the `model` of their type; nothing where they are alike.

    Its targets are the mean of what its runs tell and what the machines' spread lets expect (the normal law's
    posterior). What is left is given to its sensor, k and b, where the error of held-out runs falls by it
    (`learn_correction`).
    """
    own: dict[str, MachineCorrection] = {}
    if spread.between <= 0:
        return own
    for name, offset in spread.offsets.items():
        own[name] = shrink_offset(offset, spread.errors[name], spread.between)
        machine = of_machine(replace(model, machines=own), name)
        try:
            fit = learn_correction(machine, [trace for trace in traces if trace.machine == name])
        except LearningError:
            continue  # too few runs to tell anything more of it
        best = fit.best
        if fit.chosen is not None and best.improvement > MIN_SENSOR_SIGMAS * best.improvement_error:
            own[name] = replace(own[name], gain=fit.correction.gain, offset=fit.correction.offset)
    return own


def shrink_offset(offset: float, error: float, between: float) -> MachineCorrection:
    """A machine's targets, where its runs say `offset` with a standard `error`, of machines `between` apart (degC)."""
    share = between**2 / (between**2 + error**2)
    return MachineCorrection(targets=share * offset, targets_error=float(np.sqrt(share) * error))


def _offsets(
    runs: FreeRuns, shape: FitShape, fit: FreeRunFit, *, noise: NoiseLevels, groups: Indices, machine: Indices
) -> tuple[Array, Array]:
    """(J,) the offset of each machine, and the variance of its error; `machine` (T,) numbers that of each trace.

    Least squares on what the fit leaves, together with corrections of all targets and of each run's start: a machine
    that was often in one location would else have drawn that location's target to itself. Offsets and targets may move
    together, so offsets are drawn to 0 by a hair.
    """
    decay, pull = steps(runs, shape, np.log(fit.rates))
    relaxing = np.array([kind in RELAXING_FLOWS for kind in shape.kinds])[runs.place]
    pull = np.where(relaxing, pull, 0.0)
    first, known = runs.first, np.isfinite(runs.reading)
    run, of_machine = np.cumsum(first) - 1, machine[runs.trace]
    size, machines = int(first.sum()), int(machine.max()) + 1
    seen = np.unique(runs.place[relaxing])
    masks = [runs.place == place for place in seen] + [of_machine == number for number in range(machines)]
    columns = np.column_stack([linear_recursion(decay, np.where(mask, pull, 0.0), 0.0)[known] for mask in masks])
    start, rest, run = (
        linear_recursion(decay, first.astype(float), 0.0)[known],
        (runs.reading - fit.mean)[known],
        run[known],
    )
    # Each run's start is eliminated from everything: what is left of a column is what no start could have made.
    norm = np.maximum(np.bincount(run, start * start, size), 1e-12)
    for column in (*columns.T, rest):
        column -= start * (np.bincount(run, start * column, size) / norm)[run]
    gram, offsets = columns.T @ columns, slice(seen.size, None)
    hair = np.zeros(len(gram))
    hair[offsets] = 1e-4 * np.trace(gram) / len(gram)
    solved = np.linalg.lstsq(gram + np.diag(hair), columns.T @ rest, rcond=None)[0]
    # Readings err together, by the noise of the process gathered in between: all of it counts as one error, run by run.
    walked = np.bincount(np.cumsum(first) - 1, runs.dt * (noise.process[groups[runs.place]] ** 2 + noise.white), size)
    with np.errstate(divide="ignore"):
        own = np.array([np.bincount(run, column * column, size) for column in columns.T[offsets]])
        precision = (own / (noise.sensor**2 + walked)).sum(axis=1)
        return np.asarray(solved[offsets], dtype=float), np.asarray(1.0 / precision, dtype=float)
