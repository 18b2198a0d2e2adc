"""A query's text is read against the names of one model: names are looked up, numbers and conditions told apart.

The grammar (`grammar`) does not know a number from a condition; here it is known which was needed where, so that the
error can say it. Limits on times and runs are checked here too.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import reduce
from itertools import pairwise
from math import isfinite
from types import MappingProxyType
from typing import Literal, cast

from lark import Token, Tree

from sim.lab.checking.language.grammar import QueryError, query_error, quote_part, syntax
from sim.lab.checking.query import PROCESS, QUANTITIES, QuantityKind, identifiers
from sim.lab.checking.query import tree as q
from sim.sha import SHA, Alphabet, Model, SwitchLocations, switch_locations

Node = Tree[Token]
_COMPARISONS: Mapping[str, q.Comparison] = MappingProxyType(
    {"LT": "<", "LE": "<=", "EQ": "==", "NE": "!=", "GE": ">=", "GT": ">"}
)
_ARITHMETIC: Mapping[str, q.Arithmetic] = MappingProxyType({"PLUS": "+", "MINUS": "-", "TIMES": "*", "OVER": "/"})


@dataclass(frozen=True, slots=True)
class Scope:
    """What may be named: quantities, locations by their identifiers, switches by their signals; `own` are the
    locations' own names.

    `symbolic`: nothing that changes continuously is. `courses`: a condition is a number too, 0 or 1.
    """

    quantities: Mapping[str, QuantityKind]
    locations: Mapping[str, str]
    own: frozenset[str]
    switches: Mapping[str, SwitchLocations]
    symbolic: bool = False
    courses: bool = False


def query_scope(sha: SHA, temperature: str, alphabet: Alphabet | None = None) -> Scope:
    """The scope of an automaton. A location called like a signal keeps the name for itself."""
    ids = identifiers([location.name for location in sha.locations])
    locations = {identifier: name for name, identifier in ids.items()}
    quantities = dict(QUANTITIES)
    if temperature not in locations:
        quantities.setdefault(temperature, "temperature")
    switches = switch_locations(sha, alphabet) if alphabet is not None else {}
    names = {signal: where for signal, where in switches.items() if signal not in locations}
    return Scope(quantities, locations, frozenset(ids), names)


def parse_query(text: str, model: Model | SHA, temperature: str = "Temp") -> q.Query:
    """The query that `text` asks of a model; docs/checking.md is the language's reference.

    An automaton alone has no name for its temperature: `temperature` gives it, and is not looked at for a Model.
    Raises QueryError (a ValueError) with the column, what stands there and what would be right.
    """
    if isinstance(model, Model):
        scope = query_scope(model.sha, model.temperature, model.alphabet)
    else:
        scope = query_scope(model, temperature)
    form = cast(Node, syntax(text).children[0])
    match form.data:
        case "estimate":
            return _probability(cast(Node, form.children[0]), scope)
        case "hypothesis":
            question, sign, number = form.children
            p = _number(cast(Node, number))
            if not 0.0 <= p <= 1.0:
                raise query_error(
                    cast(Node, number).meta, f"{p:g} is no probability; write one from 0 to 1, such as 0.9"
                )
            return q.Hypothesis(_probability(cast(Node, question), scope), "<=" if _type(sign) == "LE" else ">=", p)
        case "comparison":
            left, right = (_probability(part, scope) for part in _trees(form))
            # Only >= is kept: `a <= b` asks the same as `b >= a`.
            at_most = _type(form.children[1]) == "LE"
            return q.PairedComparison(right, left) if at_most else q.PairedComparison(left, right)
        case "expectation":
            _, bounds, extreme, expression = form.children
            bound, runs = _bounds(cast(Node, bounds))
            if runs is None:
                raise query_error(
                    cast(Node, bounds).meta, f"the mean of how many runs? write `E[<={bound:g}; 1000](...)`"
                )
            value = _expression(cast(Node, expression), scope)
            return q.Expectation(bound, runs, "max" if extreme == "max" else "min", value)
        case "simulation":
            return _simulation(form, text, scope)
        case "leads_to":
            cause, effect = (_formula(part, replace(scope, symbolic=True)) for part in _trees(form))
            return q.Symbolic("-->", cause, effect)
    who, what, inner = form.children
    kind = ("E" if _type(who) == "EXISTS" else "A") + ("<>" if _type(what) == "DIAMOND" else "[]")
    formula = _formula(cast(Node, inner), replace(scope, symbolic=True))
    return q.Symbolic(cast(Literal["E<>", "E[]", "A<>", "A[]"], kind), formula)


def _probability(tree: Node, scope: Scope) -> q.Probability:
    parts = {str(part.data): part for part in _trees(tree)}
    bounds, path = parts.pop("bounds", None), next(reversed(list(_trees(tree))))
    if bounds is not None:
        bound, runs = _bounds(bounds)
        return q.Probability(bound, _path(path, bound, scope), runs)
    if path.data == "response" or not any(part.data == "interval" for part in _trees(path)):
        raise query_error(path.meta, "how long is a run? write Pr[<=444](...)")
    # UPPAAL's MITL form: the interval says how long.
    own = cast("q.Eventually | q.Always | q.Until", _path(path, None, scope))
    if not own.span.high > 0:
        raise query_error(
            path.meta, "the interval ends at 0, which leaves no time to look at; write one such as [0,60]"
        )
    return q.Probability(own.span.high, own)


def _path(tree: Node, bound: float | None, scope: Scope) -> q.Path:
    parts = {str(part.data): part for part in _trees(tree) if part.data in ("interval", "within", "view")}
    read = [_formula(part, scope) for part in _trees(tree) if part.data not in parts]
    weak = False
    if "view" in parts:
        word = cast(Token, parts["view"].children[0])
        if word != "weak":
            raise query_error(word, f"found {quote_part(str(word))!r}; right would be 'within', 'weak' or ')'")
        weak = True
    span: q.TimeSpan | None = None
    # A cause's answer may be due after the bound, unless such causes are left out.
    latest = None if tree.data == "response" and not weak else bound
    if "interval" in parts:
        low, high = (_number(part) for part in _trees(parts["interval"]))
        span = _span(low, high, parts["interval"], latest)
    if tree.data == "response":
        # The answer is due by the interval or by `within`, one of them.
        if (span is None) == ("within" not in parts):
            raise query_error(
                tree.meta, "within what time is the answer due? write phi -->[0,60] psi or phi --> psi within 60"
            )
        if "within" in parts:
            named, number = parts["within"].children
            if named != "within":
                raise query_error(
                    cast(Token, named), f"found {quote_part(str(named))!r}; right would be 'within', 'weak' or ')'"
                )
            span = _span(0.0, _number(cast(Node, number)), cast(Node, number), latest)
        return q.BoundedResponse(read[0], read[1], cast(q.TimeSpan, span), weak)
    if tree.data == "until":
        return q.Until(read[0], read[1], span or q.TimeSpan())
    make = q.Eventually if tree.data == "eventually" else q.Always
    return make(read[0], span or q.TimeSpan())


def _span(low: float, high: float, tree: Node, bound: float | None) -> q.TimeSpan:
    if not 0.0 <= low <= high or not isfinite(high):
        raise query_error(
            tree.meta, f"[{low:g},{high:g}] is no interval of time; write two finite numbers, as in [0,60]"
        )
    if bound is not None and high > bound:
        raise query_error(
            tree.meta, f"{high:g} s is beyond the run, which ends at {bound:g} s; shorten it or raise the bound"
        )
    return q.TimeSpan(low, high)


def _bounds(tree: Node) -> tuple[float, int | None]:
    """Seconds and runs. Raises QueryError unless 0 < bound < inf and runs is a whole number from 1."""
    parts = list(_trees(tree))
    bound = _number(parts[0])
    if not bound > 0 or not isfinite(bound):
        raise query_error(
            parts[0].meta, f"a run of {bound:g} s cannot be made; the bound is a number of seconds above 0"
        )
    return bound, _runs(parts[1]) if len(parts) > 1 else None


def _runs(tree: Node) -> int:
    written = "".join(str(token) for token in tree.children)
    if not written.isdecimal() or len(written) > 18 or int(written) < 1:
        raise query_error(
            tree.meta, f"{quote_part(written)} is no number of runs; write a whole one from 1, such as 1000"
        )
    return int(written)


def _simulation(tree: Node, text: str, scope: Scope) -> q.Query:
    numbers = [part for part in _trees(tree) if part.data == "number"]
    bounds = next(part for part in _trees(tree) if part.data == "bounds")
    bound, runs = _bounds(bounds)
    if numbers and runs is not None:
        raise query_error(numbers[0].meta, f"the runs are given twice; write simulate [<={bound:g}; {runs}] {{...}}")
    # The expressions as written stand between the marks `{`, `,` and `}`; the tree has lost their spelling.
    marks = [token for token in tree.children if isinstance(token, Token) and token.type != "SIMULATE"]
    written = [text[left.end_pos : right.start_pos].strip() for left, right in pairwise(marks)]
    items = [part for part in _trees(tree) if part.data not in ("number", "bounds")]
    expressions = tuple(_expression(item, replace(scope, courses=True)) for item in items)
    return q.Simulation(bound, _runs(numbers[0]) if numbers else runs or 1, expressions, tuple(written))


def _formula(tree: Node, scope: Scope) -> q.Formula:
    """A condition. Raises QueryError for a number."""
    match tree.data:
        case "conjunction" | "disjunction":  # `a && b && c` and `a || b imply c`, from the left
            total = _formula(cast(Node, tree.children[0]), scope)
            for sign, part in zip(tree.children[1::2], tree.children[2::2], strict=True):
                following = _formula(cast(Node, part), scope)
                if _type(sign) == "AND":
                    total = q.Both(total, following)
                else:
                    total = q.Either(q.Not(total) if _type(sign) == "IMPLY" else total, following)
            return total
        case "relation":
            left, sign, right, *more = tree.children
            if more:
                raise query_error(
                    cast(Token, more[0]), f"found a second comparison {str(more[0])!r}; write a < b && b < c"
                )
            if cast(Node, left).data == "negation":
                raise query_error(tree.meta, "'!' and 'not' bind tighter than a comparison; write !(a > b)")
            first, second = (_expression(cast(Node, side), scope) for side in (left, right))
            return q.Compare(_COMPARISONS[_type(sign)], first, second)
        case "negation":
            return q.Not(_formula(cast(Node, tree.children[1]), scope))
        case "truth":
            return q.Constant(_type(tree.children[0]) == "TRUE")
        case "deadlock":
            if not scope.symbolic:
                wanted = "ask E<> deadlock or A[] !deadlock"
                raise query_error(tree.meta, f"deadlock is a matter of the automaton, not of a run; {wanted}")
            return q.Deadlock()
        case "own_name":
            token = cast(Token, tree.children[0])
            written = str(token).removeprefix("at").strip()
            name = re.sub(r"\\(.)", r"\1", written[1:-1])
            if name not in scope.own:
                raise query_error(
                    token, f"no location is called {quote_part(name)!r}; {_suggestion(name, sorted(scope.own))}"
                )
            return q.At(name)
        case "name":
            token = cast(Token, tree.children[0])
            name = _strip_process(token)
            if name in scope.locations:
                return q.At(scope.locations[name])
            if name in scope.switches:
                return _switched_on(token, scope.switches[name])
            if name in scope.quantities:
                raise query_error(
                    token, f"{token} is a number and a condition is needed; compare it, as in {token} > 80"
                )
            raise _unknown(token, name, scope)
    _expression(tree, scope)  # a location's own name without quotes reads like a difference: unknown names go first
    raise query_error(tree.meta, "a number stands where a condition is needed; compare it, as in Temp > 80")


def _switched_on(token: Token, where: SwitchLocations) -> q.Formula:
    """In one of the locations in which the switch is on. Raises QueryError where a location does not tell it."""
    if where.either:
        raise query_error(
            token,
            f"in location {where.either[0]!r} {token} may be on or off, so the model's locations do not tell it; ask "
            "for locations, or learn the model anew",
        )
    first, *others = (q.At(name) for name in where.on)
    return reduce(q.Either, others, cast(q.Formula, first))


def _expression(tree: Node, scope: Scope) -> q.Expression:
    """A number at each instant. Raises QueryError for a condition."""
    match tree.data:
        case "sum" | "product":
            total = _expression(cast(Node, tree.children[0]), scope)
            for sign, part in zip(tree.children[1::2], tree.children[2::2], strict=True):
                right = _expression(cast(Node, part), scope)
                if _type(sign) == "OVER" and right == q.Number(0.0):
                    raise query_error(cast(Node, part).meta, "a division by zero; correct the divisor")
                total = q.Operation(_ARITHMETIC[_type(sign)], total, right)
            return total
        case "minus":
            inner = _expression(cast(Node, tree.children[1]), scope)
            # A negative number is a number, so that it is printed, and read back, as one.
            return q.Number(-inner.value) if isinstance(inner, q.Number) else q.Operation("-", q.Number(0.0), inner)
        case "plus":
            return _expression(cast(Node, tree.children[1]), scope)
        case "literal":
            value = float(cast(Token, tree.children[0]))
            if not isfinite(value):
                text = quote_part(str(tree.children[0]))
                raise query_error(tree.meta, f"{text} is beyond what a number can be; write a finite one")
            return q.Number(value)
        case "name":
            token = cast(Token, tree.children[0])
            name = _strip_process(token)
            if name in scope.locations and scope.courses:
                return q.Indicator(q.At(scope.locations[name]))
            if name in scope.switches and scope.courses:
                return q.Indicator(_switched_on(token, scope.switches[name]))
            if name in scope.locations:
                raise query_error(
                    token, f"{token} is a location and a number is needed: Temp, time, age, or a sum of such"
                )
            if name in scope.switches:
                raise query_error(
                    token, f"{token} is a switch and a number is needed: Temp, time, age, or a sum of such"
                )
            if name not in scope.quantities:
                raise _unknown(token, name, scope)
            if scope.symbolic:
                raise query_error(
                    token,
                    f"{token} changes continuously, and over that nothing is decided symbolically; ask `Pr[<=T](...)`, "
                    "or `decanter model judge proof` for a bound under any events",
                )
            return q.Quantity(scope.quantities[name])
    if scope.courses:
        return q.Indicator(_formula(tree, replace(scope, courses=False)))
    raise query_error(tree.meta, "a condition stands where a number is needed: Temp, time, age, or a sum of such")


def _strip_process(token: Token) -> str:
    """The name without the process; a process other than the model's is refused."""
    process, dot, name = str(token).partition(".")
    if not dot:
        return process
    if process != PROCESS or "." in name:
        raise query_error(
            token, f"found {quote_part(token)!r}; only the model's own names are known, as {PROCESS}.Temp or Temp"
        )
    return name


def _unknown(token: Token, name: str, scope: Scope) -> QueryError:
    known = [*scope.quantities, *scope.locations, *scope.switches]
    return query_error(token, f"{quote_part(token)!r} is not known; {_suggestion(name, known)}")


def _suggestion(name: str, known: Sequence[str]) -> str:
    """The names that were probably meant, or the first of all."""
    folded: dict[str, str] = {}
    for candidate in known:  # of names that differ in case alone the first is proposed
        folded.setdefault(candidate.casefold(), candidate)
    begins = [candidate for low, candidate in folded.items() if low.startswith(name.casefold())]
    close = [folded[low] for low in get_close_matches(name.casefold(), folded, 3)]
    meant = list(dict.fromkeys(begins + close))[:3]
    if meant:
        return f"did you mean {' or '.join(meant)}?"
    return f"known are {', '.join(known[:8])}{' and others' if len(known) > 8 else ''}"


def _number(tree: Node) -> float:
    sign = -1.0 if len(tree.children) > 1 else 1.0
    return sign * float(cast(Token, tree.children[-1]))


def _trees(tree: Node) -> Sequence[Node]:
    return [child for child in tree.children if isinstance(child, Tree)]


def _type(child: Token | Node) -> str:
    return cast(Token, child).type
