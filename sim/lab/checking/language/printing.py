"""A query as text, in UPPAAL 5's form wherever UPPAAL has one; `parse_query` reads back what is printed here."""

from collections.abc import Mapping

from sim.lab.checking.query import PROCESS, QUANTITIES, identifiers
from sim.lab.checking.query import tree as q
from sim.sha import SHA, Model

MAX_BOUND_S = 2**31 - 1
"""Seconds: UPPAAL's time bounds are 32-bit integers."""

Identifiers = Mapping[str, str]

_NAMES: Mapping[str, str] = {kind: f"{PROCESS}.{name}" for name, kind in QUANTITIES.items()}
_PRECEDENCE: Mapping[str, int] = {"+": 1, "-": 1, "*": 2, "/": 2}


def query_text(query: q.Query, model: Model | SHA) -> str:
    """The query in UPPAAL 5's form: qualified names, ASCII signs, whole seconds without a point, other numbers with.

    `uppaal_refusal` says which queries UPPAAL itself would not read. Raises KeyError for a location that is not the
    model's.
    """
    sha = model.sha if isinstance(model, Model) else model
    ids = identifiers([location.name for location in sha.locations])
    match query:
        case q.Probability():
            return f"Pr({_path(query, ids)})" if _is_mitl(query) else _probability(query, ids)
        case q.Hypothesis(question=question, op=op, p=p):
            return f"{_probability(question, ids)} {op} {float(p)!r}"
        case q.PairedComparison(left=left, right=right):
            return f"{_probability(left, ids)} >= {_probability(right, ids)}"
        case q.Expectation(bound=bound, runs=runs, extreme=extreme, expression=expression):
            return f"E{_bounds(bound, runs)}({extreme}: {_expression(expression, ids)})"
        case q.Simulation(bound=bound, runs=runs, expressions=expressions):
            courses = ", ".join(_expression(expression, ids) for expression in expressions)
            return f"simulate {_bounds(bound, runs)} {{{courses}}}"
    inner = _formula(query.inner, ids)
    return f"{query.kind} {inner}" if query.then is None else f"{inner} --> {_formula(query.then, ids)}"


def uppaal_refusal(query: q.Query) -> str:
    """Why UPPAAL 5 cannot read the printed query, in one sentence; empty when it can."""
    match query:
        case q.Symbolic():
            return ""
        case q.Expectation(bound=bound) | q.Simulation(bound=bound):
            return _bound_refusal(bound)
        case q.Probability():
            if refusal := _bound_refusal(query.bound):
                return refusal
            if isinstance(query.path, q.BoundedResponse):
                return "UPPAAL has no bounded response inside Pr; ask here"
            if query.path.span == q.TimeSpan() or _is_mitl(query):
                return ""
            return (
                "UPPAAL takes an interval only where it ends the run, in whole seconds: Pr(<>[10,60] phi), without runs"
            )
        case q.Hypothesis(question=question):
            if refusal := _bound_refusal(question.bound):
                return refusal
            if isinstance(question.path, q.Eventually | q.Always) and question.path.span == q.TimeSpan():
                return ""
            return "UPPAAL tests and compares only Pr[<=T](<> phi) and Pr[<=T]([] phi); ask here"
    return next(filter(None, (uppaal_refusal(q.Hypothesis(side, ">=", 0.5)) for side in (query.left, query.right))), "")


def _bound_refusal(bound: float) -> str:
    if bound.is_integer() and bound <= MAX_BOUND_S:
        return ""
    return f"UPPAAL takes whole seconds up to {MAX_BOUND_S}, not {_seconds(bound)}; round the bound"


def _is_mitl(query: q.Probability) -> bool:
    """Whether UPPAAL's MITL form says the same: the interval ends the run, in whole seconds."""
    if isinstance(query.path, q.BoundedResponse) or query.runs is not None:
        return False
    span = query.path.span
    return span.high == query.bound and span.low.is_integer() and span.high.is_integer()


def _probability(query: q.Probability, ids: Identifiers) -> str:
    return f"Pr{_bounds(query.bound, query.runs)}({_path(query, ids)})"


def _path(query: q.Probability, ids: Identifiers) -> str:
    path = query.path
    # Nothing for the whole run; a span without an end goes to the run's.
    span = ""
    if isinstance(path, q.BoundedResponse):
        span = f"[{_seconds(path.span.low)},{_seconds(path.span.high)}]"
    elif path.span != q.TimeSpan():
        span = f"[{_seconds(path.span.low)},{_seconds(min(path.span.high, query.bound))}]"
    match path:
        case q.Eventually(inner=inner):
            return f"<>{span} {_formula(inner, ids)}"
        case q.Always(inner=inner):
            return f"[]{span} {_formula(inner, ids)}"
        case q.Until(hold=hold, goal=goal):
            return f"{_formula(hold, ids)} U{span} {_formula(goal, ids)}"
    view = " weak" if path.weak else ""
    return f"{_formula(path.cause, ids)} -->{span} {_formula(path.effect, ids)}{view}"


def _formula(formula: q.Formula, ids: Identifiers, around: int = 0) -> str:
    """`around` is how tightly the operator around binds: 0 there is none, 1 ||, 2 &&, 3 !."""
    match formula:
        case q.Compare(op=op, left=left, right=right):
            return _parenthesise(f"{_expression(left, ids)} {op} {_expression(right, ids)}", around == 3)
        case q.At(location=location):
            return f"{PROCESS}.{ids[location]}"
        case q.Constant(value=value):
            return "true" if value else "false"
        case q.Deadlock():
            return "deadlock"
        case q.Not(inner=inner):
            return f"!{_formula(inner, ids, 3)}"
    own, sign = (2, "&&") if isinstance(formula, q.Both) else (1, "||")
    # The same operator again needs brackets to its right only: both are read from the left.
    last = _formula(formula.right, ids, 3 if type(formula.right) is type(formula) else own)
    return _parenthesise(f"{_formula(formula.left, ids, own)} {sign} {last}", around > own)


def _expression(expression: q.Expression, ids: Identifiers, around: int = 0) -> str:
    match expression:
        case q.Number(value=value):
            return repr(float(value))
        case q.Quantity(kind=kind):
            return _NAMES[kind]
        case q.Indicator(inner=inner):
            return _formula(inner, ids) if isinstance(inner, q.At) or not around else f"({_formula(inner, ids)})"
    own = _PRECEDENCE[expression.op]
    text = f"{_expression(expression.left, ids, own)} {expression.op} {_expression(expression.right, ids, own + 1)}"
    return _parenthesise(text, own < around)


def _parenthesise(text: str, wrap: bool) -> str:
    return f"({text})" if wrap else text


def _bounds(bound: float, runs: int | None) -> str:
    return f"[<={_seconds(bound)}]" if runs is None else f"[<={_seconds(bound)}; {runs}]"


def _seconds(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else repr(float(value))
