"""A query as a tree of plain records: what the parser makes and the checkers read. No text, no evaluation in here.

The language is UPPAAL's for statistical and symbolic queries; docs/checking.md is its reference. Times are in seconds
since the query's start, temperatures in degC.
"""

from dataclasses import dataclass, field
from math import inf
from typing import Literal

Comparison = Literal["<", "<=", "==", "!=", ">=", ">"]
Arithmetic = Literal["+", "-", "*", "/"]


@dataclass(frozen=True, slots=True)
class Number:
    """A constant."""

    value: float


@dataclass(frozen=True, slots=True)
class Quantity:
    """What a run has at each instant: its temperature, the seconds since the start, those since the last entry."""

    kind: Literal["temperature", "time", "age"]


@dataclass(frozen=True, slots=True)
class Operation:
    """`left op right` over numbers and quantities; -x is 0 - x, but for a number, which is then negative itself."""

    op: Arithmetic
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True, slots=True)
class Indicator:
    """1 where a condition holds and 0 elsewhere; in the courses of a simulation only."""

    inner: "Formula"


Expression = Number | Quantity | Operation | Indicator


@dataclass(frozen=True, slots=True)
class Compare:
    """`left op right`, true or false at each instant."""

    op: Comparison
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class At:
    """The run is in the location of this name (the automaton's own name, not its identifier)."""

    location: str


@dataclass(frozen=True, slots=True)
class Constant:
    """True or false throughout."""

    value: bool


@dataclass(frozen=True, slots=True)
class Deadlock:
    """The run is in a location that no edge leaves; in symbolic queries only."""


@dataclass(frozen=True, slots=True)
class Not:
    """The contrary."""

    inner: "Formula"


@dataclass(frozen=True, slots=True)
class Both:
    """`left && right`."""

    left: "Formula"
    right: "Formula"


@dataclass(frozen=True, slots=True)
class Either:
    """`left || right`; an implication is Either(Not(left), right)."""

    left: "Formula"
    right: "Formula"


Formula = Compare | At | Constant | Deadlock | Not | Both | Either


@dataclass(frozen=True, slots=True)
class TimeSpan:
    """The instants from `low` to `high` (s), both included: since the start, or since the cause of a response."""

    low: float = 0.0
    high: float = inf


@dataclass(frozen=True, slots=True)
class Eventually:
    """`inner` holds at some instant of the span."""

    inner: Formula
    span: TimeSpan


@dataclass(frozen=True, slots=True)
class Always:
    """`inner` holds at every instant of the span."""

    inner: Formula
    span: TimeSpan


@dataclass(frozen=True, slots=True)
class Until:
    """`goal` holds at some instant of the span, and `hold` at every instant before that one."""

    hold: Formula
    goal: Formula
    span: TimeSpan


@dataclass(frozen=True, slots=True)
class BoundedResponse:
    """Whenever `cause` holds, `effect` holds at some instant of the span that begins there.

    Every cause up to the bound is judged, for which runs go on beyond it. `weak` is the weak view of a run cut off at
    the bound: a cause whose span reaches beyond it is left out.
    """

    cause: Formula
    effect: Formula
    span: TimeSpan
    weak: bool = False


Path = Eventually | Always | Until | BoundedResponse


@dataclass(frozen=True, slots=True)
class Probability:
    """`Pr[<=bound](path)`: how probable is it? `runs` asks for that many runs instead of a sequential rule."""

    bound: float
    path: Path
    runs: int | None = None


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """`Pr[<=bound](path) >= p` (or <=): decided by a sequential test."""

    question: Probability
    op: Literal["<=", ">="]
    p: float


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """`Pr[...](...) >= Pr[...](...)`: which of the two is more probable, on common random numbers."""

    left: Probability
    right: Probability


@dataclass(frozen=True, slots=True)
class Expectation:
    """`E[<=bound; runs](max: expression)`: the mean over the runs of the greatest (least) value on the way."""

    bound: float
    runs: int
    extreme: Literal["max", "min"]
    expression: Expression


@dataclass(frozen=True, slots=True)
class Simulation:
    """`simulate [<=bound; runs] {e1, e2}`: the courses themselves.

    `labels` are the expressions as written; spelling makes no other query of it, so they are not compared.
    """

    bound: float
    runs: int
    expressions: tuple[Expression, ...]
    labels: tuple[str, ...] = field(compare=False)


@dataclass(frozen=True, slots=True)
class Symbolic:
    """`E<>`, `E[]`, `A<>`, `A[]` of `inner`, or `inner --> then`: decided over the discrete structure, exhaustively."""

    kind: Literal["E<>", "E[]", "A<>", "A[]", "-->"]
    inner: Formula
    then: Formula | None = None


Query = Probability | Hypothesis | PairedComparison | Expectation | Simulation | Symbolic
