"""Figures of forecasts along recordings: each held against what came true, the means of many, differences of two."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isnan, nan
from typing import Any, TypeVar

import numpy as np

from sim.forecast import DENSE_LEVELS
from sim.lab.judge.differences import Paired, compare_pairs, unit_differences
from sim.lab.learning import clean_readings, independent_forecasts
from sim.scores import crps_quantiles
from sim.sha import Array, Trace

Key = TypeVar("Key")
Row = TypeVar("Row")

LOW, MEDIAN, HIGH = (DENSE_LEVELS.index(level) for level in (0.05, 0.5, 0.95))
NOMINAL_COVERAGE = 0.9
"""The share of outcomes that the band from 5 to 95 % should hold."""

MIN_FORECASTS = 8.0
"""Independent forecasts at a horizon below which they say nothing."""

TRACE_PARTS_S: Mapping[str, tuple[float, float]] = {
    "0-3 min": (0.0, 180.0),
    "3-10 min": (180.0, 600.0),
    "10-30 min": (600.0, 1800.0),
    "later": (1800.0, float("inf")),
}
"""Parts of a trace by the seconds since its start: what a method knows before it has seen this unit, and after."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SkillRow:
    """The forecast of one `method` for one `horizon` (s), and the `outcome` (degC; NaN where none was read then).

    `origin` is when it was made (s since the trace's first row), `quantiles` (99,) are its law at the levels
    DENSE_LEVELS.
    """

    machine: str
    trace: str
    method: str
    horizon: float
    origin: float
    outcome: float
    quantiles: Array

    @property
    def read(self) -> bool:
        """Whether it has an outcome."""
        return not isnan(self.outcome)

    @property
    def moment(self) -> tuple[str, str, float, float]:
        """What methods are compared at: machine, trace, origin and horizon."""
        return self.machine, self.trace, self.origin, self.horizon


@dataclass(frozen=True, slots=True, kw_only=True)
class Skill:
    """Means over forecasts: `bias` (median - outcome), `mae`, `crps` and the 90 % band's `half_width` in degC."""

    machines: int
    forecasts: int
    bias: float
    mae: float
    crps: float
    coverage: float
    half_width: float


NO_SKILL = Skill(machines=0, forecasts=0, bias=nan, mae=nan, crps=nan, coverage=nan, half_width=nan)
"""Of no forecasts."""


def skill(rows: Sequence[SkillRow]) -> Skill:
    """The figures of these rows: the mean of the machines' means, each machine counting the same.

    Machines are the independent units: pooled forecasts would give the longest trace the most to say. NaN without rows.
    """
    names = sorted({row.machine for row in rows})
    if not names:
        return NO_SKILL
    place = {name: number for number, name in enumerate(names)}
    machine = np.array([place[row.machine] for row in rows])
    outcome, quantiles = np.array([row.outcome for row in rows]), np.array([row.quantiles for row in rows])
    error = quantiles[:, MEDIAN] - outcome
    inside = (quantiles[:, LOW] <= outcome) & (outcome <= quantiles[:, HIGH])
    half = (quantiles[:, HIGH] - quantiles[:, LOW]) / 2.0
    count = np.bincount(machine)

    def mean(values: Array) -> float:
        return float(np.mean(np.bincount(machine, values) / count))

    return Skill(
        machines=len(names),
        forecasts=len(rows),
        bias=mean(error),
        mae=mean(np.abs(error)),
        crps=mean(crps_quantiles(DENSE_LEVELS, quantiles, outcome)),
        coverage=mean(inside.astype(float)),
        half_width=mean(half),
    )


def figures(
    trace: Trace,
    temperature: str,
    gap: float,
    horizons: Sequence[float],
    made: Iterable[tuple[str, float, Array]],
) -> list[SkillRow]:
    """The rows of what methods forecast along a recording, for the moments that came due within it.

    `made` are (method, absolute s of the origin, (99, H) quantiles in degC for the H `horizons`); over steps longer
    than `gap` (s) nothing is read. Raises ValueError where the trace has no such temperature.
    """
    if temperature not in trace.signals:
        raise ValueError(f"trace {trace.name!r}: has no signal {temperature!r}, which is to be forecast")
    outcomes = clean_readings(trace.times, trace.signals[temperature], gap)
    rows = []
    for method, time, fan in made:
        for column, horizon in enumerate(horizons):
            due = time + horizon
            outcome = outcomes.interpolate(due)
            if due <= trace.times[-1] and np.all(np.isfinite(fan[:, column])):
                rows.append(
                    SkillRow(
                        machine=trace_machine(trace),
                        trace=trace.name,
                        method=method,
                        horizon=horizon,
                        origin=time - float(trace.times[0]),
                        outcome=nan if outcome is None else outcome,
                        quantiles=fan[:, column],
                    )
                )
    return rows


def independent(rows: Iterable[SkillRow]) -> float:
    """How many forecasts that do not overlap the rows of one method and horizon are worth, over machines and traces."""
    traces = group_rows(rows, lambda row: (row.machine, row.trace, row.horizon))
    return sum(
        independent_forecasts(np.sort([row.origin for row in own]), horizon) for (*_, horizon), own in traces.items()
    )


def trace_machine(trace: Trace) -> str:
    """The machine that a trace was measured on: the one that it names, or else its file's name."""
    return trace.machine or trace.name


def means(rows: Iterable[SkillRow], keys: Mapping[str, Callable[[SkillRow], Any]]) -> list[dict[str, Any]]:
    """The figures of the rows that share what the `keys` say of them, beside that: plain values, in their order."""
    groups = group_rows(rows, lambda row: tuple(key(row) for key in keys.values()))
    return [{**dict(zip(keys, group, strict=True)), **asdict(skill(own))} for group, own in groups.items()]


def rows_at_common_moments(rows: Sequence[SkillRow]) -> list[SkillRow]:
    """The rows of those moments at which every method that has read rows has a forecast, read or not.

    A method that came due only where nothing was read has nothing to be compared by.
    """
    methods = {row.method for row in rows if row.read}
    there: dict[tuple[str, str, float, float], set[str]] = {}
    for row in rows:
        there.setdefault(row.moment, set()).add(row.method)
    return [row for row in rows if row.method in methods and methods <= there[row.moment]]


def common(rows: Sequence[SkillRow]) -> list[SkillRow]:
    """The rows of those moments at which every method has a forecast and which have an outcome.

    No method is judged by easier ones.
    """
    return [row for row in rows_at_common_moments(rows) if row.read]


def group_rows(rows: Iterable[Row], key: Callable[[Row], Key]) -> dict[Key, list[Row]]:
    """The rows by what `key` says of each, in the order in which they come."""
    groups: dict[Key, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def stretch(row: SkillRow) -> str:
    """The part of the trace in which a forecast was made: a key of TRACE_PARTS_S."""
    return next(name for name, (begin, end) in TRACE_PARTS_S.items() if begin <= row.origin < end)


def difference(rows: Sequence[SkillRow], others: Sequence[SkillRow], rng: np.random.Generator) -> Paired:
    """What the machines say of the difference in CRPS (degC), `rows` minus `others`, at the moments that both have."""
    theirs = {row.moment: row for row in others}
    by_machine = group_rows((row for row in rows if row.moment in theirs), lambda row: row.machine)
    ours = {machine: skill(own).crps for machine, own in by_machine.items()}
    same = {machine: skill([theirs[row.moment] for row in own]).crps for machine, own in by_machine.items()}
    return compare_pairs(unit_differences(ours, same), rng)
