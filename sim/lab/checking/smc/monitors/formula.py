"""Boolean formulas over one piece of a run: which temperatures make them true, and whether the path meets them.

In one piece the location is fixed and conditions on clocks alone do not change, so a formula is true on a set of
temperatures. The lines at which its comparisons change divide the temperatures into regions: with k lines those are
numbered 0 (below all) to 2k (above all), the odd ones being the lines themselves. A path is continuous: it visits all
regions from its lowest to its highest.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np

from sim.lab.checking.query import (
    Arithmetic,
    At,
    Both,
    Compare,
    Comparison,
    Constant,
    Deadlock,
    Either,
    Expression,
    Formula,
    Indicator,
    Not,
    Number,
    Operation,
    Quantity,
)
from sim.lab.checking.smc.paths import Indices, Piece
from sim.sha import Array, Mask

Value = float | Array
WatchedLines = tuple[list[tuple[Value, Value]], list[tuple[Value, Value]]]
"""Lines looked at from below and from above, each at both ends of a piece."""

ZERO = Number(0.0)
CLOCK_TOLERANCE = 1e-9
"""Two clocks that differ by less, relative to their size, are equal: sums of floats are not exact."""

_ARITHMETIC: dict[str, Callable[[Value, Value], Value]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: np.divide(a, b),
}
_COMPARISONS: dict[Comparison, Callable[[Value, Value], Mask]] = {
    "<": np.less,
    "<=": np.less_equal,
    "==": np.equal,
    "!=": np.not_equal,
    ">=": np.greater_equal,
    ">": np.greater,
}
_SIGNS: dict[Comparison, tuple[bool, bool, bool]] = {
    "<": (True, False, False),
    "<=": (True, True, False),
    "==": (False, True, False),
    "!=": (True, False, True),
    ">=": (False, True, True),
    ">": (False, False, True),
}
"""Whether a comparison holds where left - right is below 0, 0, above 0."""
_MIRROR: dict[Comparison, Comparison] = {"<": ">", "<=": ">=", "==": "==", "!=": "!=", ">=": "<=", ">": "<"}


def value(expression: Expression, temperature: Value, time: Value, age: Value) -> Value:
    """The expression's value; arguments broadcast. A division by 0 gives an infinite or undefined number.

    Raises ValueError for an indicator, which only a simulation's courses have (`monitor.TrajectoryMonitor`).
    """
    if isinstance(expression, Indicator):
        raise ValueError("a condition stands where a number is needed; only simulate takes it for 0 or 1")
    if isinstance(expression, Number):
        return expression.value
    if isinstance(expression, Quantity):
        return {"temperature": temperature, "time": time, "age": age}[expression.kind]
    left, right = (value(side, temperature, time, age) for side in (expression.left, expression.right))
    return combine(expression.op, left, right)


def combine(op: Arithmetic, left: Value, right: Value) -> Value:
    """`left op right`. A division by 0 gives an infinite or undefined number."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _ARITHMETIC[op](left, right)


def instant_truth(
    formula: Formula,
    *,
    temperature: Value,
    time: Value,
    age: Value,
    location: int | Indices,
    names: tuple[str, ...],
) -> Mask:
    """Whether the formula holds at single instants; arguments broadcast. Raises ValueError as `compile_formulas`."""

    def compare(part: Compare) -> Mask:
        left, right = (value(side, temperature, time, age) for side in (part.left, part.right))
        return np.asarray(_COMPARISONS[part.op](left, right))

    check_formula(formula, names)
    return _truth(formula, compare, lambda place: np.asarray(location == names.index(place)))


def _truth(formula: Formula, compared: Callable[[Compare], Mask], at: Callable[[str], Mask]) -> Mask:
    """The formula's truth, given that of its comparisons and of being in a location."""
    if isinstance(formula, Compare):
        return compared(formula)
    if isinstance(formula, At):
        return at(formula.location)
    if isinstance(formula, Not):
        return np.logical_not(_truth(formula.inner, compared, at))
    if isinstance(formula, Both | Either):
        join = np.logical_and if isinstance(formula, Both) else np.logical_or
        return np.asarray(join(_truth(formula.left, compared, at), _truth(formula.right, compared, at)))
    return np.asarray(isinstance(formula, Constant) and formula.value)


def quantities(expression: Expression) -> set[str]:
    """The kinds of quantities in an expression that has no indicators."""
    if isinstance(expression, Operation):
        return quantities(expression.left) | quantities(expression.right)
    return {expression.kind} if isinstance(expression, Quantity) else set()


def linear_in_temperature(expression: Expression) -> tuple[float, Expression]:
    """(a, h) with expression = a * temperature + h, h without temperature.

    Raises ValueError for an expression that is not linear in the temperature.
    """
    if isinstance(expression, Number) or (isinstance(expression, Quantity) and expression.kind != "temperature"):
        return 0.0, expression
    if isinstance(expression, Quantity):
        return 1.0, ZERO
    if isinstance(expression, Indicator):
        raise ValueError("a condition stands where a number is needed; only simulate takes it for 0 or 1")
    (a, rest), (b, other) = linear_in_temperature(expression.left), linear_in_temperature(expression.right)
    if expression.op in "+-":
        return (a + b if expression.op == "+" else a - b), Operation(expression.op, rest, other)
    if a == b == 0.0:
        return 0.0, expression
    # A product or quotient: one side has the temperature, the other must be a plain number.
    factor, scaled = (expression.right, a) if b == 0.0 else (expression.left, b)
    if quantities(factor) or (expression.op == "/" and b != 0.0):
        raise ValueError(
            "the temperature is multiplied by a clock, by itself, or divides something; a query is answered in "
            "continuous time only where it is linear in the temperature, with constant factors"
        )
    number = float(np.asarray(value(factor, 0.0, 0.0, 0.0)))
    whole = scaled * number if expression.op == "*" else scaled / number
    return whole, Operation(expression.op, rest, other)


def affine(expression: Expression) -> tuple[float, float, float] | None:
    """(c, t, g) with a temperature-free expression = c + t * time + g * age, or None where it is not of that form."""
    # Three corners determine the plane, two more, off any line through those, refute what is none.
    corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (3.0, 5.0), (-7.0, 2.0)]
    values = [float(np.asarray(value(expression, 0.0, time, age))) for time, age in corners]
    c = values[0]
    t, g = values[1] - c, values[2] - c
    size = 1.0 + max(abs(number) for number in values)
    fits = all(
        abs(c + t * time + g * age - height) <= CLOCK_TOLERANCE * size
        for (time, age), height in zip(corners, values, strict=True)
    )
    return (c, t, g) if fits else None


def comparisons(formula: Formula, positive: bool = True) -> Iterator[tuple[Compare, bool]]:
    """The comparisons of a formula, each with whether it stands under an even number of negations."""
    if isinstance(formula, Compare):
        yield formula, positive
    elif isinstance(formula, Not):
        yield from comparisons(formula.inner, not positive)
    elif isinstance(formula, Both | Either):
        yield from comparisons(formula.left, positive)
        yield from comparisons(formula.right, positive)


@dataclass(frozen=True, slots=True)
class ThresholdLine:
    """A temperature (degC) that may move with the clocks: at `level` when it is one number."""

    at: Expression
    level: float | None

    def ends(self, piece: Piece) -> tuple[Value, Value]:
        """Where it is at both ends of a piece."""
        if self.level is not None:
            return self.level, self.level
        later = piece.begin + piece.dt, piece.age + piece.dt
        return value(self.at, 0.0, piece.begin, piece.age), value(self.at, 0.0, *later)


@dataclass(slots=True, kw_only=True)
class CompiledFormulas:
    """Several formulas over common lines; `place` maps each comparison with the temperature to (line, op).

    `watched` are the lines that some formula's coming true depends on: (line, reached from below). `clocks` are the
    comparisons between clocks and numbers; `still` says that no line moves.
    """

    formulas: tuple[Formula, ...]
    names: tuple[str, ...]
    lines: tuple[ThresholdLine, ...]
    place: dict[Compare, tuple[int, Comparison]]
    watched: tuple[tuple[int, bool], ...]
    clocks: tuple[Compare, ...]
    still: bool
    tables: dict[tuple[int, int, tuple[bool, ...]], Mask] = field(default_factory=dict)


def compile_formulas(formulas: tuple[Formula, ...], names: tuple[str, ...]) -> CompiledFormulas:
    """The formulas over common lines; `names` are the automaton's locations in order.

    Raises ValueError for a comparison that is not linear in the temperature, an unknown location, a deadlock.
    """
    place: dict[Compare, tuple[int, Comparison]] = {}
    lines: dict[ThresholdLine, int] = {}
    watched = set()
    every = [compare for formula in formulas for compare, _ in comparisons(formula)]
    for formula in formulas:
        check_formula(formula, names)
        for compare, positive in comparisons(formula):
            factor, rest = linear_in_temperature(Operation("-", compare.left, compare.right))
            if factor == 0.0:
                continue
            at = Operation("/", rest, Number(-factor))
            level = None if quantities(at) else float(np.asarray(value(at, 0.0, 0.0, 0.0)))
            line = ThresholdLine(at if level is None else ZERO, level)
            index = lines.setdefault(line, len(lines))
            op = compare.op if factor > 0 else _MIRROR[compare.op]
            place[compare] = index, op
            # Rising past the line matters where that can make the formula true: true above, under an even number of
            # negations, or false above under an odd one. Touching (==, !=) matters from both sides.
            above = _SIGNS[op][2]
            watched |= {(index, up) for up in (True, False) if op in ("==", "!=") or (above == positive) == up}
    # From below to above; lines that move are ranked anew in each piece (`_ranks`).
    order = sorted(lines, key=lambda line: line.level if line.level is not None else np.inf)
    rank = {lines[line]: new for new, line in enumerate(order)}
    return CompiledFormulas(
        formulas=formulas,
        names=names,
        lines=tuple(order),
        place={compare: (rank[index], op) for compare, (index, op) in place.items()},
        watched=tuple(sorted((rank[index], up) for index, up in watched)),
        clocks=tuple(compare for compare in dict.fromkeys(every) if compare not in place),
        still=all(line.level is not None for line in order),
    )


def check_formula(formula: Formula, names: tuple[str, ...]) -> None:
    """Raises ValueError for a deadlock and for a location that is not among `names`."""
    if isinstance(formula, Deadlock):
        raise ValueError("deadlock belongs to symbolic queries (E<>, A[], A<>, -->): it is decided, not estimated")
    if isinstance(formula, At) and formula.location not in names:
        raise ValueError(f"the model has no location {formula.location!r}; it has {', '.join(names)}")
    for part in ("left", "right", "inner"):
        inner = getattr(formula, part, None)
        if inner is not None and not isinstance(formula, Compare):
            check_formula(inner, names)


def table(compiled: CompiledFormulas, which: int, piece: Piece) -> Mask:
    """(2k + 1,) or (2k + 1, n) whether formula number `which` is true in each region of a piece."""
    clocks: tuple[bool | Mask, ...] = ()
    if compiled.clocks:
        # Clocks are compared half-way through: steps are cut where such a comparison changes, so it is the same in all
        # of the piece (or the piece is a single instant).
        middle = piece.middle, piece.age + 0.5 * piece.dt
        truths: list[bool | Mask] = []
        for compare in compiled.clocks:
            left, right = value(compare.left, 0.0, *middle), value(compare.right, 0.0, *middle)
            difference = np.asarray(left - right)
            equal = np.abs(difference) <= CLOCK_TOLERANCE * (1.0 + np.abs(left))
            below, same, above = _SIGNS[compare.op]
            truth = np.where(equal, same, np.where(difference < 0, below, above) & ~np.isnan(difference))
            truths.append(bool(truth) if truth.ndim == 0 else truth)
        clocks = tuple(truths)
    if (
        not compiled.still
        or not isinstance(piece.location, int)
        or any(isinstance(each, np.ndarray) for each in clocks)
    ):
        return _table(compiled, which, piece, clocks)
    # Lines that stand still and one location for all runs: few tables, each used thousands of times.
    key = which, piece.location, tuple(bool(each) for each in clocks)
    if key not in compiled.tables:
        compiled.tables[key] = _table(compiled, which, piece, clocks)
    return compiled.tables[key]


def table_at_begin(compiled: CompiledFormulas, which: int, piece: Piece) -> Mask:
    """The `table` of the piece's first instant: clocks may compare otherwise there (`time > 5` from 5 s on)."""
    return table(compiled, which, piece.opening() if compiled.clocks else piece)


def _table(compiled: CompiledFormulas, which: int, piece: Piece, clocks: tuple[bool | Mask, ...]) -> Mask:
    k = len(compiled.lines)
    regions = np.arange(2 * k + 1)
    known = dict(zip(compiled.clocks, clocks, strict=True))
    ranks = _ranks(compiled, piece)
    # One column for each run as soon as anything differs between the runs; else one table serves them all.
    differs = ranks.ndim == 2 or any(isinstance(each, np.ndarray) for each in (piece.location, *clocks))
    shape = regions[:, None] if differs else regions

    def compare_part(compare: Compare) -> Mask:
        if compare not in compiled.place:
            return np.asarray(known[compare])
        index, op = compiled.place[compare]
        side = np.sign(shape - (2 * ranks[index] + 1))
        return np.asarray(np.take(_SIGNS[op], side + 1))

    truth = _truth(
        compiled.formulas[which], compare_part, lambda at: np.asarray(piece.location == compiled.names.index(at))
    )
    size = (regions.size,) if shape.ndim == 1 else (regions.size, piece.start.size)
    return np.broadcast_to(truth, size)


def _ranks(compiled: CompiledFormulas, piece: Piece) -> Indices:
    """(k,) or (k, n) the place of each line from below, half-way through the piece."""
    k = len(compiled.lines)
    if compiled.still or k < 2:
        return np.arange(k)
    middles = [0.5 * (low + high) for low, high in (line.ends(piece) for line in compiled.lines)]
    # The argsort of an argsort is the rank; stable, so that lines that meet keep one order.
    return np.argsort(np.argsort(np.stack(np.broadcast_arrays(*middles)), axis=0, kind="stable"), axis=0)


def touches_line(line: ThresholdLine, piece: Piece, *, up: bool, strict: bool) -> Mask:
    """(n,) whether a run touches the line (`strict`: is beyond it) in the piece, from below or from above."""
    first, last = line.ends(piece)
    beyond = (np.greater if strict else np.greater_equal) if up else (np.less if strict else np.less_equal)
    touched = beyond(piece.end, last)
    touched |= beyond(piece.start, first)
    drawn = piece.rise if up else piece.fall
    if drawn is not None:
        rows, e = drawn
        low, high, bridge = (
            part[rows] if isinstance(part, np.ndarray) else part for part in (first, last, piece.bridge)
        )
        # A Brownian bridge from x0 to x1 of variance V crosses a line at distances a, b with probability exp(-2ab/V):
        # it does where an exponential number e is above 2ab/V (`paths.plan`).
        product = (low - piece.start[rows]) * (high - piece.end[rows])
        touched[rows[product < 0.5 * bridge * e]] = True
    return np.asarray(touched)


def exists(compiled: CompiledFormulas, which: int, piece: Piece) -> Mask | bool:
    """(n,) whether formula `which` is true at some instant of the piece; one answer where it is the same for all."""
    truth = table(compiled, which, piece)
    if truth.ndim == 1:
        border = _border(truth.tobytes())
        if isinstance(border, bool):
            return border
        if border is not None:
            line, up, strict = border
            return touches_line(compiled.lines[line], piece, up=up, strict=strict)
    low, high = visited_regions(compiled, piece)
    # A continuous path visits every region from its lowest to its highest; cumulated counts say in one subtraction
    # whether any of those is true.
    counts = np.cumsum(
        np.vstack([np.zeros_like(truth[:1]), truth]) if truth.ndim == 2 else np.append(False, truth), axis=0
    )
    if truth.ndim == 1:
        return np.asarray(counts[high + 1] > counts[low])
    columns = np.arange(truth.shape[1])
    return np.asarray(counts[high + 1, columns] > counts[low, columns])


@lru_cache(maxsize=1024)
def _border(truth: bytes) -> bool | tuple[int, bool, bool] | None:
    """Where a table of regions is true: everywhere or nowhere, or beyond one line (which, above it, without the line
    itself); None where it is more than that."""
    if not any(truth) or all(truth):
        return bool(truth[0])
    changes = sum(left != right for left, right in pairwise(truth))
    if changes > 1:
        return None
    if truth[-1]:
        first = truth.index(1)
        return (first - 1) // 2, True, first % 2 == 0
    last = truth.index(0) - 1
    return last // 2, False, last % 2 == 0


def visited_regions(compiled: CompiledFormulas, piece: Piece) -> tuple[Indices, Indices]:
    """(n,) the lowest and the highest region that each run visits in the piece."""
    low = np.full(piece.start.size, 2 * len(compiled.lines), dtype=np.intp)
    high = np.zeros(piece.start.size, dtype=np.intp)
    for line in compiled.lines:
        high += touches_line(line, piece, up=True, strict=True).astype(np.intp) + touches_line(
            line, piece, up=True, strict=False
        )
        low -= touches_line(line, piece, up=False, strict=True).astype(np.intp) + touches_line(
            line, piece, up=False, strict=False
        )
    return low, high


def region(compiled: CompiledFormulas, piece: Piece, *, at_end: bool) -> Indices:
    """(n,) the region in which each run is at the piece's start or end."""
    x = piece.end if at_end else piece.start
    index = np.zeros(x.size, dtype=np.intp)
    for line in compiled.lines:
        position = line.ends(piece)[int(at_end)]
        index += (x > position).astype(np.intp) + (x >= position)
    return index


def begins_true(compiled: CompiledFormulas, which: int, piece: Piece, rows: Indices) -> Mask:
    """(rows,) whether formula `which` is true where the piece begins, for some of its runs."""
    truth, x = table(compiled, which, piece), piece.start[rows]
    index = np.zeros(rows.size, dtype=np.intp)
    for line in compiled.lines:
        position, _ = line.ends(piece)
        position = position[rows] if isinstance(position, np.ndarray) else position
        index += (x > position).astype(np.intp) + (x >= position)
    return np.asarray(truth[index] if truth.ndim == 1 else truth[index, rows])


def region_truth(truth: Mask, where: Indices) -> Mask:
    """(n,) a formula's truth, by its table (`table`), in the region in which each run is."""
    return np.asarray(truth[where] if truth.ndim == 1 else truth[where, np.arange(where.size)])


def watched_lines(compiled: CompiledFormulas, piece: Piece) -> WatchedLines:
    """Where the lines that make some formula true are at both ends of a piece: those reached from below, from above."""
    ups = [compiled.lines[index].ends(piece) for index, up in compiled.watched if up]
    return ups, [compiled.lines[index].ends(piece) for index, up in compiled.watched if not up]
