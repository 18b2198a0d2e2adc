"""The tree of an expression, and one row for each function in it: value, bounds, slopes, text, and where it is defined.

Every function of the table is total on what `problem` allows, so that an expression that passed it once is finite for
whatever a sensor reads.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import cast

import numpy as np

from sim.sha import Array

Values = Mapping[str, Array | float]
"""What the names stand for: arrays of one shape, or numbers."""
Interval = tuple[Array, Array]
"""(least, greatest), arrays of one shape."""
MAX_EXPONENT = 700.0
"""e to more than that is no float."""
MIN_POSITIVE = 1e-300


@dataclass(frozen=True, slots=True)
class ExpressionNumber:
    """A constant."""

    value: float


@dataclass(frozen=True, slots=True)
class ExpressionName:
    """What a signal, a parameter or the temperature is called."""

    name: str


@dataclass(frozen=True, slots=True)
class Apply:
    """A function of the table FUNCTIONS at its arguments; operators are functions too."""

    function: str
    arguments: tuple["Expression", ...]


Expression = ExpressionNumber | ExpressionName | Apply
ZERO, ONE = ExpressionNumber(0.0), ExpressionNumber(1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Function:
    """One function of an expression.

    `bounds` encloses its values over intervals. `slopes` are its partial derivatives by each argument, as expressions
    (almost everywhere: a bend has that of one of its sides). `text` is UPPAAL's, of the arguments' texts. `wrong` says
    what is not defined where the arguments lie in these intervals, "" where all is. `infix` is the operator, "" for a
    call, `binds` how tightly it holds its arguments.
    """

    value: Callable[..., Array]
    bounds: Callable[..., Interval]
    slopes: Callable[..., tuple[Expression, ...]]
    text: Callable[..., str]
    wrong: Callable[..., str] = lambda *_: ""
    infix: str = ""
    binds: int = 9


# ------------------------------------------------------------------ simplified construction


def add(a: Expression, b: Expression) -> Expression:
    """a + b."""
    if isinstance(a, ExpressionNumber) and isinstance(b, ExpressionNumber):
        return ExpressionNumber(a.value + b.value)
    return b if a == ZERO else a if b == ZERO else Apply("+", (a, b))


def subtract(a: Expression, b: Expression) -> Expression:
    """a - b."""
    if isinstance(a, ExpressionNumber) and isinstance(b, ExpressionNumber):
        return ExpressionNumber(a.value - b.value)
    if a == b:
        return ZERO
    return a if b == ZERO else negate(b) if a == ZERO else Apply("-", (a, b))


def negate(a: Expression) -> Expression:
    """-a."""
    if isinstance(a, ExpressionNumber):
        return ExpressionNumber(-a.value)
    return a.arguments[0] if isinstance(a, Apply) and a.function == "neg" else Apply("neg", (a,))


def multiply(a: Expression, b: Expression) -> Expression:
    """a b."""
    if isinstance(a, ExpressionNumber) and isinstance(b, ExpressionNumber):
        return ExpressionNumber(a.value * b.value)
    if ZERO in (a, b):
        return ZERO
    return b if a == ONE else a if b == ONE else Apply("*", (a, b))


def divide(a: Expression, b: Expression) -> Expression:
    """a / b."""
    return ZERO if a == ZERO else a if b == ONE else Apply("/", (a, b))


def power(a: Expression, b: Expression) -> Expression:
    """a to the power of b."""
    return ONE if b == ZERO else a if b == ONE else Apply("^", (a, b))


SIMPLIFIERS: Mapping[str, Callable[..., Expression]] = {
    "+": add,
    "-": subtract,
    "neg": negate,
    "*": multiply,
    "/": divide,
    "^": power,
}


# ------------------------------------------------------------------ intervals


def _outward(low: Array, high: Array, steps: int = 1) -> Interval:
    """The interval a few floats wider: the ends were rounded, and the library's powers are not the nearest floats."""
    left, right = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    for _ in range(steps):
        left, right = np.nextafter(left, -inf), np.nextafter(right, inf)
    # A sum is 0 only where it is exact, a product where a factor is 0; what underflows to 0 here does so in the program
    # too. Widened, such an end would have another sign, and times infinity none at all.
    return np.where(low == 0.0, 0.0, left), np.where(high == 0.0, 0.0, right)


def _corners(function: Callable[[Array, Array], Array], a: Interval, b: Interval, steps: int = 1) -> Interval:
    """Of a function that is monotone in each argument while the other stays: its extremes lie at corners."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        corners = [np.asarray(function(x, y)) for x in a for y in b]
    # 0 times infinity: one factor is 0 wherever it is reached, the other has no end but is never there.
    corners = [np.where(np.isnan(corner), 0.0, corner) for corner in corners]
    return _outward(np.minimum.reduce(corners), np.maximum.reduce(corners), steps)


def _quotient(a: Interval, b: Interval) -> Interval:
    inverse = _corners(lambda _, y: 1.0 / y, b, b)
    everything = (b[0] <= 0) & (b[1] >= 0)
    reciprocal = np.where(everything, -inf, inverse[0]), np.where(everything, inf, inverse[1])
    return _corners(lambda x, y: x * y, a, reciprocal)


def _powers(a: Interval, b: Interval) -> Interval:
    whole = b[0].size > 0 and bool(np.all((b[0] == b[1]) & (b[0] == np.round(b[0])) & (np.abs(b[0]) < 64)))
    if not whole:
        # x^y of x >= 0 is monotone in x for each y and in y for each x.
        return _corners(np.power, (np.maximum(a[0], 0.0), np.maximum(a[1], 0.0)), b, 4)
    low, high = _corners(np.power, a, (b[0], b[0]), 4)
    across = (a[0] < 0) & (a[1] > 0)
    even = np.asarray(b[0] % 2 == 0)
    low = np.where(across & even & (b[0] > 0), 0.0, low)
    bad = across & (b[0] < 0)
    return np.where(bad & ~even, -inf, np.where(bad, 0.0, low)), np.where(bad, inf, high)


def _monotone(function: Callable[[Array], Array], steps: int = 4) -> Callable[[Interval], Interval]:
    def enclose(a: Interval) -> Interval:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return _outward(np.asarray(function(a[0])), np.asarray(function(a[1])), steps)

    return enclose


def _size(a: Interval) -> Interval:
    across = (a[0] < 0) & (a[1] > 0)
    sizes = np.abs(a[0]), np.abs(a[1])
    return np.where(across, 0.0, np.minimum(*sizes)), np.maximum(*sizes)


def _above_indicator(a: Array, b: Array) -> Array:
    # A signal that was never read is neither above nor below.
    return np.where(np.isnan(a) | np.isnan(b), np.nan, np.greater(a, b).astype(float))


def _certainly_exceeds(a: Interval, b: Interval) -> Interval:
    return np.asarray(a[0] > b[1], dtype=float), np.asarray(a[1] > b[0], dtype=float)


# ------------------------------------------------------------------ where a function is defined


def _no_zero(_: Interval, b: Interval) -> str:
    return "" if bool(np.all((b[0] > 0) | (b[1] < 0))) else "the divisor may be 0"


def _power_error(a: Interval, b: Interval) -> str:
    constant = bool(np.all((b[0] == b[1]) & (b[0] == np.round(b[0])) & (np.abs(b[0]) < 64)))
    if constant and bool(np.all(b[0] >= 0)):
        return ""
    if constant:
        return _no_zero(a, a).replace("divisor", "base of a negative power")
    if bool(np.all(a[0] > 0)) or (bool(np.all(a[0] >= 0)) and bool(np.all(b[0] > 0))):
        return ""
    return "the base of a power may be negative"


def _not_huge(a: Interval) -> str:
    return "" if bool(np.all(a[1] <= MAX_EXPONENT)) else "exp may be larger than any number"


def _positive(a: Interval) -> str:
    return "" if bool(np.all(a[0] > 0)) else "log may be taken of 0 or less"


def _not_negative(a: Interval) -> str:
    return "" if bool(np.all(a[0] >= 0)) else "sqrt may be taken of less than 0"


def _exceeds(a: Expression, b: Expression) -> Expression:
    return Apply("above", (a, b))


def _slopes_of_power(a: Expression, b: Expression) -> tuple[Expression, ...]:
    by_base = multiply(b, power(a, subtract(b, ONE)))
    if isinstance(b, ExpressionNumber):
        return by_base, ZERO
    # a^b log a goes to 0 with a, and a^b is 0 there: the logarithm needs any finite value.
    return by_base, multiply(power(a, b), Apply("log", (Apply("max", (a, ExpressionNumber(MIN_POSITIVE))),)))


FUNCTIONS: Mapping[str, Function] = {
    "+": Function(
        value=np.add,
        bounds=lambda a, b: _outward(a[0] + b[0], a[1] + b[1]),
        slopes=lambda a, b: (ONE, ONE),
        text=lambda a, b: f"({a} + {b})",
        infix="+",
        binds=1,
    ),
    "-": Function(
        value=np.subtract,
        bounds=lambda a, b: _outward(a[0] - b[1], a[1] - b[0]),
        slopes=lambda a, b: (ONE, ExpressionNumber(-1.0)),
        text=lambda a, b: f"({a} - {b})",
        infix="-",
        binds=1,
    ),
    "neg": Function(
        value=np.negative,
        bounds=lambda a: (-a[1], -a[0]),
        slopes=lambda a: (ExpressionNumber(-1.0),),
        text=lambda a: f"(0.0 - {a})",
        infix="-",
        binds=3,
    ),
    "*": Function(
        value=np.multiply,
        bounds=lambda a, b: _corners(np.multiply, a, b),
        slopes=lambda a, b: (b, a),
        text=lambda a, b: f"({a} * {b})",
        infix="*",
        binds=2,
    ),
    "/": Function(
        value=np.divide,
        bounds=_quotient,
        slopes=lambda a, b: (divide(ONE, b), negate(divide(a, multiply(b, b)))),
        text=lambda a, b: f"({a} / {b})",
        wrong=_no_zero,
        infix="/",
        binds=2,
    ),
    "^": Function(
        value=lambda a, b: np.asarray(a**b),
        bounds=_powers,
        slopes=_slopes_of_power,
        text=lambda a, b: f"pow({a}, {b})",
        wrong=_power_error,
        infix="^",
        binds=4,
    ),
    "min": Function(
        value=np.minimum,
        bounds=lambda a, b: (np.minimum(a[0], b[0]), np.minimum(a[1], b[1])),
        slopes=lambda a, b: (_exceeds(b, a), subtract(ONE, _exceeds(b, a))),
        text=lambda a, b: f"fmin({a}, {b})",
    ),
    "max": Function(
        value=np.maximum,
        bounds=lambda a, b: (np.maximum(a[0], b[0]), np.maximum(a[1], b[1])),
        slopes=lambda a, b: (_exceeds(a, b), subtract(ONE, _exceeds(a, b))),
        text=lambda a, b: f"fmax({a}, {b})",
    ),
    "abs": Function(
        value=np.abs,
        bounds=_size,
        slopes=lambda a: (subtract(_exceeds(a, ZERO), _exceeds(ZERO, a)),),
        text=lambda a: f"fmax({a}, 0.0 - {a})",
    ),
    "exp": Function(
        value=np.exp,
        bounds=_monotone(np.exp),
        slopes=lambda a: (Apply("exp", (a,)),),
        text=lambda a: f"exp({a})",
        wrong=_not_huge,
    ),
    "log": Function(
        value=np.log,
        bounds=_monotone(lambda x: np.log(np.maximum(x, 0.0))),
        slopes=lambda a: (divide(ONE, a),),
        text=lambda a: f"ln({a})",
        wrong=_positive,
    ),
    "sqrt": Function(
        value=np.sqrt,
        bounds=_monotone(lambda x: np.sqrt(np.maximum(x, 0.0)), 1),
        slopes=lambda a: (divide(ExpressionNumber(0.5), Apply("sqrt", (a,))),),
        text=lambda a: f"sqrt({a})",
        wrong=_not_negative,
    ),
    "above": Function(
        value=_above_indicator,
        bounds=_certainly_exceeds,
        slopes=lambda a, b: (ZERO, ZERO),
        text=lambda a, b: f"({a} > {b} ? 1.0 : 0.0)",
    ),
}
"""Operators and functions by name. `above(a, b)` is 1 where a > b and 0 elsewhere; its slope leaves out the jump."""


# ------------------------------------------------------------------ what is asked of a tree


def names(tree: Expression) -> tuple[str, ...]:
    """The names in it, each once, in their order."""
    match tree:
        case ExpressionName(name):
            return (name,)
        case Apply(_, arguments):
            return tuple(dict.fromkeys(name for each in arguments for name in names(each)))
    return ()


def jumps(tree: Expression) -> bool:
    """Whether it has a jump somewhere, at which its slope says nothing."""
    return isinstance(tree, Apply) and (tree.function == "above" or any(jumps(each) for each in tree.arguments))


def compile_expression(tree: Expression) -> Callable[[Values], Array]:
    """The expression as a function of what its names stand for."""
    match tree:
        case ExpressionNumber(value):
            constant = value
            return lambda values: np.asarray(constant)
        case ExpressionName(name):
            own = name
            # As it is: numpy raises to a power that is a number faster, and not to the same last bit.
            return lambda values: cast(Array, values[own])
        case Apply(function, arguments):
            value_of = FUNCTIONS[function].value
            # Operators have at most two arguments, and the gateway's filter evaluates them at each reading.
            if len(arguments) == 1:
                only = compile_expression(arguments[0])
                return lambda values: value_of(only(values))
            # A constant exponent stays a Python number: numpy squares by multiplying then.
            first, second = compile_expression(arguments[0]), compile_expression(arguments[1])
            if isinstance(arguments[1], ExpressionNumber):
                number = arguments[1].value
                return lambda values: value_of(first(values), number)
            return lambda values: value_of(first(values), second(values))


def substitute(tree: Expression, name: str, by: Expression) -> Expression:
    """The tree with an expression in the place of a name, simplified where something became constant."""
    match tree:
        case ExpressionName(own) if own == name:
            return by
        case Apply(function, arguments):
            parts = tuple(substitute(each, name, by) for each in arguments)
            return SIMPLIFIERS[function](*parts) if function in SIMPLIFIERS else Apply(function, parts)
    return tree


def derivative(tree: Expression, name: str) -> Expression:
    """The derivative by a name (the chain rule over the table's slopes), simplified where parts are constant."""
    if isinstance(tree, ExpressionName):
        return ONE if tree.name == name else ZERO
    total: Expression = ZERO
    if isinstance(tree, Apply):
        inner = [derivative(argument, name) for argument in tree.arguments]
        if any(part != ZERO for part in inner):
            for slope, part in zip(FUNCTIONS[tree.function].slopes(*tree.arguments), inner, strict=True):
                total = add(total, multiply(slope, part) if part != ZERO else ZERO)
    return total


def bounds(tree: Expression, intervals: Mapping[str, Interval]) -> Interval:
    """An enclosure of all values while each name lies in its interval (natural interval extension, outward rounded)."""
    match tree:
        case ExpressionNumber(value):
            return np.asarray(value), np.asarray(value)
        case ExpressionName(name):
            low, high = intervals[name]
            return np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        case Apply(function, arguments):
            with np.errstate(invalid="ignore"):
                low, high = FUNCTIONS[function].bounds(*(bounds(each, intervals) for each in arguments))
            # inf - inf and the like: nothing is known.
            return np.where(np.isnan(low), -inf, low), np.where(np.isnan(high), inf, high)


def problem(tree: Expression, intervals: Mapping[str, Interval]) -> str:
    """Which part is not defined somewhere in these intervals, in words with its text; "" where all is."""
    if not isinstance(tree, Apply):
        return "" if not isinstance(tree, ExpressionNumber) or isfinite(tree.value) else "a number is not finite"
    for argument in tree.arguments:
        if inner := problem(argument, intervals):
            return inner
    wrong = FUNCTIONS[tree.function].wrong(*(bounds(each, intervals) for each in tree.arguments))
    return f"{wrong} in {format_expression(tree)}" if wrong else ""


def crossings(tree: Expression) -> tuple[Expression, ...]:
    """The expressions at whose zeros the tree bends or jumps."""
    if not isinstance(tree, Apply):
        return ()
    inner = tuple(each for argument in tree.arguments for each in crossings(argument))
    if tree.function in ("min", "max", "above"):
        return (*inner, subtract(*tree.arguments))
    return (*inner, tree.arguments[0]) if tree.function == "abs" else inner


def format_expression(tree: Expression, outside: int = 0) -> str:
    """The expression as it may be read again; `outside` is how tightly what is around it binds."""
    match tree:
        case ExpressionNumber(value):
            text = f"{value:.12g}"
            return f"({text})" if value < 0 and outside > 1 else text
        case ExpressionName(name):
            return name
        case Apply(function, arguments):
            row = FUNCTIONS[function]
            if not row.infix:
                return f"{function}({', '.join(format_expression(each) for each in arguments)})"
            if len(arguments) == 1:
                text = f"-{format_expression(arguments[0], row.binds)}"
            else:
                # Of equals the left one is taken first, but of powers the right one.
                left, right = (row.binds + 1, row.binds) if function == "^" else (row.binds, row.binds + 1)
                text = f"{format_expression(arguments[0], left)} {row.infix} {format_expression(arguments[1], right)}"
            return f"({text})" if row.binds < outside else text


def uppaal_text(tree: Expression, texts: Mapping[str, str], constant: Callable[[float], str]) -> str:
    """The expression in UPPAAL's words; `texts` are those of the names, `constant` writes a number."""
    match tree:
        case ExpressionNumber(value):
            return constant(value)
        case ExpressionName(name):
            return texts[name]
        case Apply(function, arguments):
            return FUNCTIONS[function].text(*(uppaal_text(each, texts, constant) for each in arguments))
