"""`<NAME>_histogram_values.txt`: the raw parameter values behind each distribution: `D_0:`, then one float a line.

The public learner opens this file for appending while it overwrites the report, so a file holds a block of headers for
each run of the learner, and the report belongs to the last one. One real file (HRI_SIM_3b) has 556 headers: 119 runs,
of which 10 are different, over up to 7 distributions; 28 runs are the very one that the report describes. The numbers
of the distributions start again in every run, so D_1 of one run need not be D_1 of another. Hence runs are kept apart,
equal ones count once, and pooling several is only right where their means say so (see `evidence`). Within a run the
learner repeats values too (each of 2 values 6 times); mean and standard deviation here do not change with that.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import fsum, sqrt
from pathlib import Path

from sim.files import file_error, read_text
from sim.lab.formats.foreign.grammar import finite_number
from sim.lab.formats.foreign.report import ReportedLaw

Values = Mapping[str, tuple[float, ...]]
"""The values of each distribution, by its name."""

PRINT_TOLERANCE = 1e-6
"""Tolerance of the cross-check, absolute and relative: the report prints six decimals."""


@dataclass(frozen=True, slots=True)
class Histogram:
    """The appended runs, in the file's order."""

    runs: tuple[Values, ...] = ()


@dataclass(frozen=True, slots=True)
class ParameterFit:
    """Mean and standard deviation (divisor n) of `count` values, `distinct` of which are different."""

    mean: float
    sigma: float
    count: int
    distinct: int


@dataclass(frozen=True, slots=True)
class HistogramEvidence:
    """The values to fit from, each run counted once, and how they were chosen.

    `origin` says it in words; `disagreements` has one sentence per distribution whose mean is not the report's.
    """

    values: Values
    runs: int
    distinct: int
    origin: str
    disagreements: tuple[str, ...] = ()


def read_histogram(path: Path) -> Histogram:
    """The runs of a histogram file. Raises ArtefactError with file and line."""
    return parse_histogram(read_text(path), path)


def parse_histogram(text: str, file: str | Path = "histogram") -> Histogram:
    """As `read_histogram`, from the text itself. A header that the current run already has begins the next run."""
    runs: list[dict[str, list[float]]] = []
    current: list[float] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        header = re.fullmatch(r"([^\W\d]\w*)\s*:", line.strip())
        if header:
            # A header cannot belong to the run if it is there already, or if its number is below the last one's.
            name, run = header[1], runs[-1] if runs else {}
            if not runs or name in run or (run and _number(name) < _number(next(reversed(run)))):
                runs.append({})
            current = runs[-1].setdefault(header[1], [])
        elif line.strip():
            if current is None:
                raise file_error(
                    file, number, f"a value, {line.strip()!r}, stands before any header; begin with a line D_0:"
                )
            current.append(finite_number(line.strip(), file, number, "the value"))
    return Histogram(tuple({name: tuple(values) for name, values in run.items()} for run in runs))


def _number(name: str) -> int:
    digits = re.search(r"\d+$", name)
    return int(digits[0]) if digits else 0


def histogram_text(histogram: Histogram) -> str:
    """The text of the file; every float in its shortest exact form."""
    return "".join(
        f"{name}:\n" + "".join(f"{float(value)!r}\n" for value in values)
        for run in histogram.runs
        for name, values in run.items()
    )


def distinct_runs(histogram: Histogram) -> tuple[Values, ...]:
    """The different runs, in the order of their first appearance; the order of values within a run does not count."""
    seen: dict[tuple[tuple[str, tuple[float, ...]], ...], Values] = {}
    for run in histogram.runs:
        seen.setdefault(tuple((name, tuple(sorted(values))) for name, values in sorted(run.items())), run)
    return tuple(seen.values())


def merge(histogram: Histogram) -> Values:
    """All values by distribution, each different run once."""
    merged: dict[str, tuple[float, ...]] = {}
    for run in distinct_runs(histogram):
        for name, values in run.items():
            merged[name] = merged.get(name, ()) + values
    return merged


def fit_values(values: tuple[float, ...]) -> ParameterFit:
    """Mean and standard deviation. Raises ValueError without values."""
    if not values:
        raise ValueError("nothing can be fitted without values")
    # fsum rounds once, so that the mean does not depend on the order of the values.
    mean = fsum(values) / len(values)
    return ParameterFit(
        mean, sqrt(fsum((value - mean) ** 2 for value in values) / len(values)), len(values), len(set(values))
    )


def disagreements(values: Values, laws: tuple[ReportedLaw, ...], tolerance: float = PRINT_TOLERANCE) -> tuple[str, ...]:
    """One sentence per distribution where the values and the report differ, or that only one of them has.

    Means may differ by tolerance * max(1, |mean|), variances (where reported) likewise.
    """
    reported = {law.name: law for law in laws}
    sentences = [f"{name} has values but is not in the report" for name in values if name not in reported]
    for name, law in reported.items():
        if not values.get(name):
            sentences.append(f"{name} is in the report but has no values")
            continue
        fitted = fit_values(values[name])
        if abs(fitted.mean - law.mean) > tolerance * max(1.0, abs(law.mean)):
            sentences.append(
                f"{name}: the mean of its {fitted.count} values is {fitted.mean:.6g}, the report says {law.mean:.6g} "
                f"(tolerance {tolerance:g})"
            )
        elif law.variance is not None and abs(fitted.sigma**2 - law.variance) > tolerance * max(1.0, abs(law.variance)):
            sentences.append(
                f"{name}: the variance of its {fitted.count} values is {fitted.sigma**2:.6g}, the report says "
                f"{law.variance:.6g} (tolerance {tolerance:g})"
            )
    return tuple(sentences)


def evidence(
    histogram: Histogram, laws: tuple[ReportedLaw, ...], tolerance: float = PRINT_TOLERANCE
) -> HistogramEvidence:
    """The values that the report was made from: the run, or the pool of different runs, with the report's means.

    Tried in this order: the last run (the report was written with it), earlier runs from the newest, all different runs
    pooled. Where none agrees it is the last run, and the disagreements are given.
    """
    distinct = distinct_runs(histogram)
    if not histogram.runs:
        return HistogramEvidence({}, 0, 0, "there are no values", disagreements({}, laws, tolerance))
    candidates = [(histogram.runs[-1], "the last run")]
    candidates += [(run, "an earlier run, which the report describes") for run in reversed(distinct)]
    candidates.append((merge(histogram), f"{len(distinct)} different runs pooled"))
    for values, origin in candidates:
        if not disagreements(values, laws, tolerance):
            return HistogramEvidence(values, len(histogram.runs), len(distinct), origin)
    last = histogram.runs[-1]
    origin = "the last run, though no run agrees with the report"
    return HistogramEvidence(
        last, len(histogram.runs), len(distinct), origin, disagreements=disagreements(last, laws, tolerance)
    )
