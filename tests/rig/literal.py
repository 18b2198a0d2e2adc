"""A slow evaluator of the query language, written from docs/checking.md alone, and runs of its own to evaluate.

A course is a list of stays in which the temperature moves along a straight line. In each stay the instants at which a
comparison changes are solved for; between two of them nothing changes, so that one instant stands for all. Each path
is then evaluated word by word: "for every instant ...", "at some instant ...". Times and temperatures are fractions:
whether `age < 9.5` is over at the instant at which the age is 9.5 must not be a matter of rounding.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import asin, sqrt

import numpy as np

from sim.lab.checking.query.tree import (
    Always,
    At,
    Both,
    BoundedResponse,
    Compare,
    Constant,
    Either,
    Eventually,
    Expression,
    Formula,
    Not,
    Number,
    Operation,
    Path,
    Quantity,
    Until,
)
from tests.rig.chain import COMPARED, MarkovChain


@dataclass(frozen=True)
class CourseStay:
    """A stay of a course: its location, when it begins and ends (s), the temperature at its begin and its slope."""

    name: str
    begin: Fraction
    end: Fraction
    start: Fraction
    slope: Fraction

    def value(self, expression: Expression, time: Fraction) -> Fraction:
        """The expression's value at an instant of the stay."""
        match expression:
            case Number(value=value):
                return Fraction(value)
            case Quantity(kind="time"):
                return time
            case Quantity(kind="age"):
                return time - self.begin
            case Quantity():
                return self.start + self.slope * (time - self.begin)
            case Operation(op=op, left=left, right=right):
                a, b = self.value(left, time), self.value(right, time)
                return a + b if op == "+" else a - b if op == "-" else a * b if op == "*" else a / b
        raise ValueError(f"{expression} is no number")

    def true(self, formula: Formula, time: Fraction) -> bool:
        """Whether the formula is true at an instant of the stay."""
        match formula:
            case At(location=location):
                return self.name == location
            case Constant(value=value):
                return value
            case Not(inner=inner):
                return not self.true(inner, time)
            case Both(left=left, right=right):
                return self.true(left, time) and self.true(right, time)
            case Either(left=left, right=right):
                return self.true(left, time) or self.true(right, time)
            case Compare(op=op, left=first, right=second):
                return bool(COMPARED[op](self.value(first, time), self.value(second, time)))
        raise ValueError(f"{formula} is no condition on a run")

    def changes(self, formula: Formula) -> Iterator[Fraction]:
        """The instants of the stay at which a comparison of the formula may change: where its sides are equal."""
        if isinstance(formula, Compare):
            difference = Operation("-", formula.left, formula.right)
            at_begin, at_end = self.value(difference, self.begin), self.value(difference, self.end)
            if at_begin != at_end:
                yield self.begin + (self.end - self.begin) * at_begin / (at_begin - at_end)
            return
        for part in ("inner", "left", "right"):
            if (inner := getattr(formula, part, None)) is not None:
                yield from self.changes(inner)


@dataclass(frozen=True)
class Cell:
    """An instant (`low` = `high`), or all instants strictly between two, in which nothing changes."""

    stay: CourseStay
    low: Fraction
    high: Fraction

    def true(self, formula: Formula) -> bool:
        """Whether the formula is true there."""
        return self.stay.true(formula, (self.low + self.high) / 2)


def cells(course: Sequence[CourseStay], formulas: Sequence[Formula], instants: Sequence[Fraction]) -> list[Cell]:
    """The course's cells in the order of time, cut at `instants` too. A stay's end is its own only in the last stay."""
    found = []
    for stay in course:
        inner = {time for formula in formulas for time in stay.changes(formula)} | set(instants)
        times = sorted({stay.begin, stay.end} | {time for time in inner if stay.begin < time < stay.end})
        for begin, end in pairwise(times):
            found += [Cell(stay, begin, begin), Cell(stay, begin, end)]
        if stay is course[-1] or stay.begin == stay.end:
            found.append(Cell(stay, stay.end, stay.end))
    return found


def holds(path: Path, course: Sequence[CourseStay], bound: Fraction) -> bool:
    """Whether a path holds on a course that is long enough: docs/checking.md, "When a formula holds"."""
    a = Fraction(path.span.low)
    if isinstance(path, BoundedResponse):
        return _responds(path, course, bound, a, Fraction(path.span.high))
    b = Fraction(min(path.span.high, float(bound)))
    formulas = [path.hold, path.goal] if isinstance(path, Until) else [path.inner]
    every = cells(course, formulas, [a, b])
    within = [cell for cell in every if a <= cell.low and cell.high <= b]
    match path:
        case Eventually(inner=inner):
            return any(cell.true(inner) for cell in within)
        case Always(inner=inner):
            return all(cell.true(inner) for cell in within)
    # Before an instant of an open cell there are instants of the same cell.
    return any(
        cell.true(path.goal)
        and all(before.true(path.hold) for before in every[: every.index(cell) + (cell.low < cell.high)])
        for cell in within
    )


def _responds(path: BoundedResponse, course: Sequence[CourseStay], bound: Fraction, a: Fraction, b: Fraction) -> bool:
    formulas = [path.cause, path.effect]
    times = {time for cell in cells(course, formulas, []) for time in (cell.low, cell.high)}
    # Cut where what lies a or b seconds later changes, so that one instant of a cause stands for its whole cell.
    last = bound - b if path.weak else bound
    every = cells(course, formulas, [*(time - shift for time in times for shift in (a, b)), last])
    true = [cell.true(path.effect) for cell in every]
    for number, cell in enumerate(every):
        if cell.high > last or not cell.true(path.cause):
            continue
        instant = (cell.low + cell.high) / 2
        if not any(
            effect
            and (
                instant + a <= other.low <= instant + b
                if other.low == other.high
                else other.low < instant + b and other.high > instant + a
            )
            for other, effect in zip(every[number:], true[number:], strict=True)
        ):
            return False
    return True


def drawn_course(
    chain: MarkovChain, slopes: Sequence[float], start: float, horizon: float, rng: np.random.Generator
) -> list[CourseStay]:
    """A run of the chain up to `horizon` (s), the temperature rising by each location's slope (degC/s)."""
    place, begin, x, course = 0, Fraction(0), Fraction(start), list[CourseStay]()
    while True:
        slope, end = (
            Fraction(slopes[place]),
            min(begin + Fraction(rng.exponential(chain.means[place])), Fraction(horizon)),
        )
        course.append(CourseStay(chain.names[place], begin, end, x, slope))
        if end == horizon:
            return course
        x += slope * (end - begin)
        place, begin = int(rng.choice(len(chain.names), p=chain.to[place])), end


def needed(path: Path, bound: float) -> float:
    """How long (s) a course must be for a path."""
    return bound + path.span.high if isinstance(path, BoundedResponse) and not path.weak else bound


def apart(share: float, runs: int, other: float, others: int) -> float:
    """How many standard errors two shares of runs are apart, on the scale on which a share's variance is 1/n.

    Anscombe 1948: 2 asin(sqrt((x + 3/8) / (n + 3/4))), which does so for few successes too.
    """
    first, second = (asin(sqrt((p * n + 0.375) / (n + 0.75))) for p, n in ((share, runs), (other, others)))
    return 2.0 * abs(first - second) / sqrt(1.0 / runs + 1.0 / others)
