"""`flow_conditions.txt`: a line with the flow's number, then a line with its equation.

Read are the forms of the public learner (`(x0)' = 0.004 1 + -0.004 x0`: a blank multiplies) and of UPPAAL
(`F'==0.004*1-0.004*F`), with sums, products, whole powers, brackets and quotients. A grammar gives
the terms, as a quotient of two polynomials with exact rational coefficients.

Two names have a meaning of their own in what this project writes: `m` is the location's mode parameter, drawn from its
distribution, and `u`, where it stands in a denominator or in `exp(-u / tau)`, the seconds since the location was
entered. The six flows:

    constant     (T)' = 0
    linear       (T)' = m
    exponential  (T)' = 0.004 (m - T)
    driven       (T)' = 0.004 (m + 0.05 (Assorbimento - 150.0) - T)
    logarithmic  (T)' = m / (12.0 + u)
    transient    (T)' = m exp(-u / 8.0) / 8.0

A number in place of m is a parameter that is fixed. A name with blanks or signs stands in backquotes. Noise has no
place in this file; the report's locations carry it.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from pathlib import Path

from lark import Lark, Token, Tree

from sim.files import file_error, read_text
from sim.lab.formats.foreign.grammar import finite_number, parse_text, tokens, trees
from sim.lab.formats.foreign.polynomial import Polynomial, add, constant, degree, multiply, scale, variable

FLOW_FILE = "flow_conditions.txt"
MAX_DEGREE = 6
MAX_TERMS = 500
PARAMETER, AGE = "m", "u"
FUNCTIONS = ("sin", "cos", "tan", "tanh", "exp", "log", "ln", "sqrt", "abs", "min", "max")

GRAMMAR = r"""
start: _NL? flow*
flow: ID _NL equation+
equation: (derivative | discrete) EQUALS sum _NL
derivative: "(" NAME ")" "'" | NAME "'"
discrete: "(" NAME ")" INDEX | NAME INDEX
sum: _signed (_tail)*
_tail: PLUS product | MINUS product
_signed: product
product: _unary (TIMES _unary | OVER _unary | power)*
_unary: power | negative | "+" _unary
negative: "-" _unary
power: atom (POWER WHOLE)?
atom: NUMBER | NAME | "(" sum ")"

ID: /(?:f_)?\d+(?=[ \t\r]*(?:\n|$))/
INDEX: /\[k\+1\]/
EQUALS: "==" | "="
PLUS: "+"
MINUS: "-"
TIMES: "*"
OVER: "/"
POWER: "^" | "**"
WHOLE: /\d+/
NUMBER: /(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?/
NAME: /[^\W\d][\w.]*|`[^`\n]+`/
_NL: /(?:[ \t\r]*\n)+[ \t]*/
%ignore /[ \t\r]+/
"""
EXPECTED_TEXT = "a line with the flow's number must be followed by its equation, like (x0)' = 0.004 1 + -0.004 x0"


@dataclass(frozen=True, slots=True)
class Equation:
    """The time derivative of `state` as numerator / denominator, in the state's unit per second.

    `references` keeps the r of each written (signal - r), which the expanded terms alone would not give back.
    """

    text: str
    state: str
    numerator: Polynomial
    denominator: Polynomial
    references: Mapping[str, Fraction] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FlowFile:
    """The equations by the flow's number, in the file's order."""

    equations: Mapping[int, Equation]


@dataclass(frozen=True, slots=True)
class _Quotient:
    top: Polynomial
    bottom: Polynomial


@dataclass(frozen=True, slots=True)
class _ParseContext:
    """Where an equation stands, for messages, and the references found in it so far."""

    file: str | Path
    line: int
    references: dict[str, Fraction]


ONE = constant(Fraction(1))


@cache
def _parser() -> Lark:
    return Lark(GRAMMAR, parser="lalr", propagate_positions=True)


def read_flow_file(path: Path) -> FlowFile:
    """The flows' equations. Raises ArtefactError with file and line."""
    return parse_flow_file(read_text(path), path)


def parse_flow_file(text: str, file: str | Path = FLOW_FILE) -> FlowFile:
    """As `read_flow_file`, from the text itself; `file` is the name for messages."""
    lines = text.split("\n")
    equations: dict[int, Equation] = {}
    for flow in trees(parse_text(_parser(), text + "\n", file, EXPECTED_TEXT)):
        number = tokens(flow)[0]
        key = int(str(number).removeprefix("f_"))
        if key in equations:
            raise file_error(file, number.line, f"flow {key} stands here a second time; keep one of them")
        several = []
        for tree in trees(flow):
            left, right = trees(tree)
            line = tree.meta.line
            if left.data == "discrete":
                wanted = "a derivative is needed, like (x0)' = ..."
                raise file_error(file, line, f"this is a step from one sample to the next ([k+1]); {wanted}")
            reading = _ParseContext(file, line, {})
            try:
                value = _sum(right, reading)
            except RecursionError:
                reason = "the brackets or signs are nested too deeply; write the equation out"
                raise file_error(file, line, reason) from None
            state = str(tokens(left)[0]).strip("`")
            several.append(Equation(lines[line - 1].strip(), state, value.top, value.bottom, reading.references))
        if len(several) > 1:
            states = ", ".join(equation.state for equation in several)
            raise file_error(
                file, number.line, f"flow {key} has {len(several)} equations ({states}); one state is supported"
            )
        equations[key] = several[0]
    return FlowFile(equations)


def parse_equation(text: str, file: str | Path = "equation") -> Equation:
    """One equation. Raises ArtefactError."""
    return parse_flow_file(f"0\n{text}", file).equations[0]


def flow_file_text(flow_file: FlowFile) -> str:
    """The text of the file; each equation as it was written."""
    return "".join(f"{number}\n{equation.text}\n" for number, equation in flow_file.equations.items())


def _sum(tree: Tree[Token], reading: _ParseContext) -> _Quotient:
    total, sign = _Quotient({}, ONE), Fraction(1)
    for part in tree.children:
        if isinstance(part, Token):
            sign = Fraction(-1 if part.type == "MINUS" else 1)
        else:
            total = _plus(total, _times(_Quotient(constant(sign), ONE), _product(part, reading)))
    # Where the sum is exactly `signal - r`, r is remembered: the expanded terms alone would not give it back.
    names = [monomial for monomial in total.top if monomial]
    if len(names) == 1 and degree(total.top) == 1 and total.bottom == ONE and total.top[names[0]] == 1:
        reading.references.setdefault(names[0][0][0], -total.top.get((), Fraction(0)))
    return total


def _product(tree: Tree[Token], reading: _ParseContext) -> _Quotient:
    total, divide = _Quotient(ONE, ONE), False
    parts = iter(tree.children)
    for part in parts:
        if isinstance(part, Token):
            divide = part.type == "OVER"
            continue
        factor = _exponential(next(parts, None), reading) if _is_name(part, "exp") else _factor(part, reading)
        if divide and not factor.top:
            raise file_error(reading.file, reading.line, "the equation divides by zero; correct the denominator")
        total = _check_size(_times(total, _Quotient(factor.bottom, factor.top) if divide else factor), reading)
        divide = False
    return total


def _is_name(tree: Tree[Token], name: str) -> bool:
    """Whether a factor is this word alone."""
    inner = trees(tree)
    return tree.data == "power" and len(tree.children) == 1 and inner[0].children == [name]


def _exponential(argument: Tree[Token] | Token | None, reading: _ParseContext) -> _Quotient:
    """exp(-u / tau) as a variable of its own, by the name that `decay_rate` reads; what fades is all that is known."""
    value = _factor(argument, reading) if isinstance(argument, Tree) else _Quotient({}, ONE)
    rate = -value.top.get(((AGE, 1),), Fraction(0))
    if rate <= 0 or len(value.top) != 1 or value.bottom != ONE:
        wanted = f"exp is known of -{AGE} / tau alone, {AGE} being the seconds since entry and tau a positive number"
        raise file_error(reading.file, reading.line, wanted)
    return _Quotient(variable(f"`exp(-{rate} {AGE})`"), ONE)


def decay_rate(name: str) -> Fraction | None:
    """The rate (1/s) if a variable stands for exp(-rate u), else None: no name of a file keeps its backquotes."""
    found = re.fullmatch(rf"`exp\(-(\S+) {AGE}\)`", name)
    return Fraction(found[1]) if found else None


def _factor(tree: Tree[Token], reading: _ParseContext) -> _Quotient:
    if tree.data == "negative":
        return _times(_Quotient(constant(Fraction(-1)), ONE), _factor(trees(tree)[0], reading))
    value = _atom(trees(tree)[0], reading)
    written = next((token for token in tokens(tree) if token.type == "WHOLE"), "1")
    power = int(written) if len(written) <= 3 else MAX_DEGREE + 1
    if power > MAX_DEGREE:
        raise file_error(
            reading.file, reading.line, f"the power {written} is above {MAX_DEGREE}; no flow here needs one"
        )
    total = _Quotient(ONE, ONE)
    for _ in range(power):
        total = _check_size(_times(total, value), reading)
    return total


def _check_size(value: _Quotient, reading: _ParseContext) -> _Quotient:
    """The value itself, if it is of a size that an equation of a plant can have: brackets multiply out fast."""
    if max(degree(value.top), degree(value.bottom)) > MAX_DEGREE:
        raise file_error(reading.file, reading.line, f"a term has a degree above {MAX_DEGREE}; no flow here needs one")
    if max(len(value.top), len(value.bottom)) > MAX_TERMS:
        raise file_error(
            reading.file, reading.line, f"the equation has more than {MAX_TERMS} terms when multiplied out"
        )
    return value


def _atom(tree: Tree[Token], reading: _ParseContext) -> _Quotient:
    child = tree.children[0]
    if isinstance(child, Tree):
        return _sum(child, reading)
    if child in FUNCTIONS:
        raise file_error(
            reading.file, reading.line, f"the function {child} is not known here; write sums, products and powers"
        )
    if child.type == "NAME" and child.lower() not in ("nan", "inf", "infinity"):
        return _Quotient(variable(child.strip("`")), ONE)
    return _Quotient(constant(exact(str(child), reading.file, reading.line)), ONE)


def exact(text: str, file: str | Path, line: int | None) -> Fraction:
    """The written number as a fraction; what a float cannot tell from zero is zero. Raises ArtefactError."""
    return Fraction(text) if finite_number(text, file, line, "a coefficient") else Fraction(0)


def _plus(left: _Quotient, right: _Quotient) -> _Quotient:
    if left.bottom == right.bottom:
        return _Quotient(add(left.top, right.top), left.bottom)
    tops = add(multiply(left.top, right.bottom), multiply(right.top, left.bottom))
    return _Quotient(tops, multiply(left.bottom, right.bottom))


def _times(left: _Quotient, right: _Quotient) -> _Quotient:
    """The product; a constant denominator is divided out."""
    top, bottom = multiply(left.top, right.top), multiply(left.bottom, right.bottom)
    if bottom.keys() <= {()} and bottom != ONE:
        return _Quotient(scale(1 / bottom[()], top), ONE)
    return _Quotient(top, bottom)
