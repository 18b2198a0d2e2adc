"""From the syntax tree to the query: names are looked up, numbers and conditions told apart, limits checked."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import pairwise
from math import isfinite
from types import MappingProxyType
from typing import Literal, cast

from lark import Token, Tree

from sim.checking.query import tree as q
from sim.checking.query.grammar import QueryError, at, shown
from sim.checking.query.names import identifiers
from sim.sha.automaton import SHA

PROCESS = "m_1"
"""The model's process in UPPAAL: `m_1.ON` is the location ON of it, and `ON` alone means the same here."""

Kind = Literal["temperature", "time", "age"]
QUANTITIES: Mapping[str, Kind] = MappingProxyType({"Temp": "temperature", "time": "time", "age": "age"})
"""What a run has at each instant, by the names that the exported model gives it in `m_1`."""

Node = Tree[Token]
_COMPARISONS: Mapping[str, q.Comparison] = MappingProxyType(
    {"LT": "<", "LE": "<=", "EQ": "==", "NE": "!=", "GE": ">=", "GT": ">"}
)
_ARITHMETIC: Mapping[str, q.Arithmetic] = MappingProxyType({"PLUS": "+", "MINUS": "-", "TIMES": "*", "OVER": "/"})


@dataclass(frozen=True, slots=True)
class Names:
    """What may be named: quantities, and locations by their identifiers; `own` are the locations' own names.

    `symbolic`: nothing that changes continuously is. `courses`: a condition is a number too, 0 or 1.
    """

    quantities: Mapping[str, Kind]
    locations: Mapping[str, str]
    own: frozenset[str]
    symbolic: bool = False
    courses: bool = False


def names_of(sha: SHA, temperature: str) -> Names:
    """The names of an automaton. A location called like the temperature's signal keeps the name for itself."""
    given = identifiers([location.name for location in sha.locations])
    locations = {identifier: name for name, identifier in given.items()}
    quantities = dict(QUANTITIES)
    if temperature not in locations:
        quantities.setdefault(temperature, "temperature")
    return Names(quantities, locations, frozenset(given))


def resolve(tree: Node, text: str, names: Names) -> q.Query:
    """The query of a syntax tree. Raises QueryError."""
    form = _only(tree)
    if form.data == "simulation":
        return _simulation(form, text, names)
    return _QUERIES[str(form.data)](form, names)


def _estimate(tree: Node, names: Names) -> q.Query:
    return _probability(_only(tree), names)


def _hypothesis(tree: Node, names: Names) -> q.Query:
    question, sign, number = tree.children
    p = _number(cast(Node, number))
    if not 0.0 <= p <= 1.0:
        raise at(cast(Node, number).meta, f"{p:g} is no probability; write one from 0 to 1, such as 0.9")
    return q.Hypothesis(_probability(cast(Node, question), names), "<=" if _type(sign) == "LE" else ">=", p)


def _comparison(tree: Node, names: Names) -> q.Query:
    left, right = (_probability(part, names) for part in _trees(tree))
    return q.Compared(right, left) if _type(tree.children[1]) == "LE" else q.Compared(left, right)


def _probability(tree: Node, names: Names) -> q.Probability:
    parts = {str(part.data): part for part in _trees(tree)}
    bounds, path = parts.pop("bounds", None), next(reversed(list(_trees(tree))))
    if bounds is not None:
        bound, runs = _bounds(bounds)
        return q.Probability(bound, _path(path, bound, names), runs)
    if path.data == "response" or not any(part.data == "interval" for part in _trees(path)):
        raise at(path.meta, "how long is a run? write Pr[<=444](...)")
    # UPPAAL's MITL form: the interval says how long.
    found = cast("q.Eventually | q.Always | q.Until", _path(path, None, names))
    if not found.span.high > 0:
        raise at(path.meta, "the interval ends at 0, which leaves no time to look at; write one such as [0,60]")
    return q.Probability(found.span.high, found)


def _path(tree: Node, bound: float | None, names: Names) -> q.Path:
    span = next((_interval(part, bound) for part in _trees(tree) if part.data == "interval"), None)
    formulas = [part for part in _trees(tree) if part.data not in ("interval", "within")]
    read = [_formula(part, names) for part in formulas]
    if tree.data == "response":
        return q.Response(read[0], read[1], _answer_time(tree, span, bound))
    if tree.data == "until":
        return q.Until(read[0], read[1], span or q.Span())
    make = q.Eventually if tree.data == "eventually" else q.Always
    return make(read[0], span or q.Span())


def _answer_time(tree: Node, span: q.Span | None, bound: float | None) -> q.Span:
    """The span of a response: by its interval or by `within`, one of them."""
    within = next((part for part in _trees(tree) if part.data == "within"), None)
    if (span is None) == (within is None):
        raise at(tree.meta, "within what time is the answer due? write phi -->[0,60] psi or phi --> psi within 60")
    if within is None:
        return cast(q.Span, span)
    word, number = within.children
    if word != "within":
        raise at(cast(Token, word), f"found {shown(str(word))!r}; right would be 'within' or ')'")
    seconds = _number(cast(Node, number))
    return _span(0.0, seconds, cast(Node, number), bound)


def _interval(tree: Node, bound: float | None) -> q.Span:
    low, high = (_number(part) for part in _trees(tree))
    return _span(low, high, tree, bound)


def _span(low: float, high: float, tree: Node, bound: float | None) -> q.Span:
    if not 0.0 <= low <= high or not isfinite(high):
        raise at(tree.meta, f"[{low:g},{high:g}] is no interval of time; write two finite numbers, as in [0,60]")
    if bound is not None and high > bound:
        raise at(tree.meta, f"{high:g} s is beyond the run, which ends at {bound:g} s; shorten it or raise the bound")
    return q.Span(low, high)


def _bounds(tree: Node) -> tuple[float, int | None]:
    """Seconds and runs. Raises QueryError unless 0 < bound < inf and runs is a whole number from 1."""
    parts = list(_trees(tree))
    bound = _number(parts[0])
    if not bound > 0 or not isfinite(bound):
        raise at(parts[0].meta, f"a run of {bound:g} s cannot be made; the bound is a number of seconds above 0")
    return bound, _runs(parts[1]) if len(parts) > 1 else None


def _runs(tree: Node) -> int:
    written = "".join(str(token) for token in tree.children)
    if not written.isdecimal() or len(written) > 18 or int(written) < 1:
        raise at(tree.meta, f"{shown(written)} is no number of runs; write a whole one from 1, such as 1000")
    return int(written)


def _expectation(tree: Node, names: Names) -> q.Query:
    _, bounds, extreme, expression = tree.children
    bound, runs = _bounds(cast(Node, bounds))
    if runs is None:
        raise at(cast(Node, bounds).meta, f"the mean of how many runs? write E[<={bound:g}; 1000](...)")
    value = _expression(cast(Node, expression), names)
    return q.Expectation(bound, runs, "max" if extreme == "max" else "min", value)


def _simulation(tree: Node, text: str, names: Names) -> q.Query:
    numbers = [part for part in _trees(tree) if part.data == "number"]
    bounds = next(part for part in _trees(tree) if part.data == "bounds")
    bound, runs = _bounds(bounds)
    if numbers and runs is not None:
        raise at(numbers[0].meta, f"the runs are given twice; write simulate [<={bound:g}; {runs}] {{...}}")
    marks = [token for token in tree.children if isinstance(token, Token) and token.type != "SIMULATE"]
    written = [text[left.end_pos : right.start_pos].strip() for left, right in pairwise(marks)]
    items = [part for part in _trees(tree) if part.data not in ("number", "bounds")]
    expressions = tuple(_expression(item, replace(names, courses=True)) for item in items)
    return q.Simulation(bound, _runs(numbers[0]) if numbers else runs or 1, expressions, tuple(written))


def _symbolic(tree: Node, names: Names) -> q.Query:
    who, what, inner = tree.children
    kind = ("E" if _type(who) == "EXISTS" else "A") + ("<>" if _type(what) == "DIAMOND" else "[]")
    formula = _formula(cast(Node, inner), replace(names, symbolic=True))
    return q.Symbolic(cast(Literal["E<>", "E[]", "A<>", "A[]"], kind), formula)


def _leads_to(tree: Node, names: Names) -> q.Query:
    cause, effect = (_formula(part, replace(names, symbolic=True)) for part in _trees(tree))
    return q.Symbolic("-->", cause, effect)


def _formula(tree: Node, names: Names) -> q.Formula:
    """A condition. Raises QueryError for a number."""
    make = _FORMULAS.get(str(tree.data))
    if make is None:
        _expression(tree, names)  # a location's own name without quotes reads like a difference: unknown names go first
        raise at(tree.meta, "a number stands where a condition is needed; compare it, as in Temp > 80")
    return make(tree, names)


def _chain(tree: Node, names: Names) -> q.Formula:
    """`a && b && c` and `a || b imply c`, from the left."""
    total = _formula(cast(Node, tree.children[0]), names)
    for sign, part in zip(tree.children[1::2], tree.children[2::2], strict=True):
        right = _formula(cast(Node, part), names)
        if _type(sign) == "AND":
            total = q.Both(total, right)
        else:
            total = q.Either(q.Not(total) if _type(sign) == "IMPLY" else total, right)
    return total


def _relation(tree: Node, names: Names) -> q.Formula:
    left, sign, right, *more = tree.children
    if more:
        raise at(cast(Token, more[0]), f"found a second comparison {str(more[0])!r}; write a < b && b < c")
    if cast(Node, left).data == "negation":
        raise at(tree.meta, "'!' and 'not' bind tighter than a comparison; write !(a > b)")
    return q.Compare(
        _COMPARISONS[_type(sign)], _expression(cast(Node, left), names), _expression(cast(Node, right), names)
    )


def _negation(tree: Node, names: Names) -> q.Formula:
    return q.Not(_formula(cast(Node, tree.children[1]), names))


def _truth(tree: Node, names: Names) -> q.Formula:
    return q.Constant(_type(tree.children[0]) == "TRUE")


def _deadlock(tree: Node, names: Names) -> q.Formula:
    if not names.symbolic:
        raise at(
            tree.meta,
            "deadlock is a matter of the automaton, not of a run; ask E<> deadlock or A[] !deadlock",
        )
    return q.Deadlock()


def _own_name(tree: Node, names: Names) -> q.Formula:
    token = cast(Token, tree.children[0])
    written = str(token).removeprefix("at").strip()
    name = re.sub(r"\\(.)", r"\1", written[1:-1])
    if name not in names.own:
        raise at(token, f"no location is called {shown(name)!r}; {_near(name, sorted(names.own))}")
    return q.At(name)


def _place(tree: Node, names: Names) -> q.Formula:
    token = cast(Token, tree.children[0])
    name = _plain(token)
    if name in names.locations:
        return q.At(names.locations[name])
    if name in names.quantities:
        raise at(token, f"{token} is a number and a condition is needed; compare it, as in {token} > 80")
    raise _unknown(token, name, names)


def _expression(tree: Node, names: Names) -> q.Expression:
    """A number at each instant. Raises QueryError for a condition."""
    make = _EXPRESSIONS.get(str(tree.data))
    if make is None and names.courses:
        return q.Indicator(_formula(tree, replace(names, courses=False)))
    if make is None:
        raise at(tree.meta, "a condition stands where a number is needed: Temp, time, age, or a sum of such")
    return make(tree, names)


def _arithmetic(tree: Node, names: Names) -> q.Expression:
    total = _expression(cast(Node, tree.children[0]), names)
    for sign, part in zip(tree.children[1::2], tree.children[2::2], strict=True):
        right = _expression(cast(Node, part), names)
        if _type(sign) == "OVER" and right == q.Number(0.0):
            raise at(cast(Node, part).meta, "a division by zero; correct the divisor")
        total = q.Operation(_ARITHMETIC[_type(sign)], total, right)
    return total


def _minus(tree: Node, names: Names) -> q.Expression:
    inner = _expression(cast(Node, tree.children[1]), names)
    return q.Number(-inner.value) if isinstance(inner, q.Number) else q.Operation("-", q.Number(0.0), inner)


def _plus(tree: Node, names: Names) -> q.Expression:
    return _expression(cast(Node, tree.children[1]), names)


def _literal(tree: Node, names: Names) -> q.Expression:
    value = float(cast(Token, tree.children[0]))
    if not isfinite(value):
        raise at(tree.meta, f"{shown(str(tree.children[0]))} is beyond what a number can be; write a finite one")
    return q.Number(value)


def _quantity(tree: Node, names: Names) -> q.Expression:
    token = cast(Token, tree.children[0])
    name = _plain(token)
    if name in names.locations and names.courses:
        return q.Indicator(q.At(names.locations[name]))
    if name in names.locations:
        raise at(token, f"{token} is a location and a number is needed: Temp, time, age, or a sum of such")
    if name not in names.quantities:
        raise _unknown(token, name, names)
    if names.symbolic:
        raise at(
            token,
            f"{token} changes continuously, and over that nothing is decided symbolically; ask Pr[<=T](...), or "
            "`decanter model verify` for a bound under any events",
        )
    return q.Quantity(names.quantities[name])


def _plain(token: Token) -> str:
    """The name without the process; a process other than the model's is refused."""
    process, dot, name = str(token).partition(".")
    if not dot:
        return process
    if process != PROCESS or "." in name:
        raise at(token, f"found {shown(token)!r}; only the model's own names are known, as {PROCESS}.Temp or Temp")
    return name


def _unknown(token: Token, name: str, names: Names) -> QueryError:
    known = [*names.quantities, *names.locations]
    return at(token, f"{shown(token)!r} is not known; {_near(name, known)}")


def _near(name: str, known: Sequence[str]) -> str:
    """The names that were probably meant, or the first of all."""
    folded: dict[str, str] = {}
    for one in known:
        folded.setdefault(one.casefold(), one)
    begins = [one for low, one in folded.items() if low.startswith(name.casefold())]
    close = [folded[low] for low in get_close_matches(name.casefold(), folded, 3)]
    found = list(dict.fromkeys(begins + close))[:3]
    if found:
        return f"did you mean {' or '.join(found)}?"
    return f"known are {', '.join(known[:8])}{' and others' if len(known) > 8 else ''}"


def _number(tree: Node) -> float:
    sign = -1.0 if len(tree.children) > 1 else 1.0
    return sign * float(cast(Token, tree.children[-1]))


def _only(tree: Node) -> Node:
    return cast(Node, tree.children[0])


def _trees(tree: Node) -> Sequence[Node]:
    return [child for child in tree.children if isinstance(child, Tree)]


def _type(child: Token | Node) -> str:
    return cast(Token, child).type


_QUERIES: Mapping[str, Callable[[Node, Names], q.Query]] = MappingProxyType(
    {
        "estimate": _estimate,
        "hypothesis": _hypothesis,
        "comparison": _comparison,
        "expectation": _expectation,
        "symbolic": _symbolic,
        "leads_to": _leads_to,
    }
)
_FORMULAS: Mapping[str, Callable[[Node, Names], q.Formula]] = MappingProxyType(
    {
        "disjunction": _chain,
        "conjunction": _chain,
        "relation": _relation,
        "negation": _negation,
        "truth": _truth,
        "deadlock": _deadlock,
        "own_name": _own_name,
        "name": _place,
    }
)
_EXPRESSIONS: Mapping[str, Callable[[Node, Names], q.Expression]] = MappingProxyType(
    {
        "sum": _arithmetic,
        "product": _arithmetic,
        "minus": _minus,
        "plus": _plus,
        "literal": _literal,
        "name": _quantity,
    }
)
