"""The grammar of a line: a sum of products of powers, calls and names, parsed by precedence (Pratt 1973).

An own parser of a page, not a grammar library: the running gateway reads lines in a model, and loads none for it.
"""

import re
from dataclasses import dataclass
from math import isfinite

from sim.effects.expression.functions import FUNCTIONS, Apply, Expression, ExpressionName, ExpressionNumber

LONGEST, DEEPEST = 300, 40
"""Characters of an expression, and brackets inside one another, at most."""
FUNCTIONS_OF_A_LINE = {"min": 2, "max": 2, "abs": 1, "exp": 1, "log": 1, "sqrt": 1, "above": 2}
"""Functions that may be called, and how many arguments each takes; `min` and `max` take more as well."""
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)|(?P<sign>\*\*|[-+*/^(),]))"
)
_BINDING = {"+": 1, "-": 1, "*": 2, "/": 2, "^": 4, "**": 4}
_NEGATION = 3


class ExpressionError(ValueError):
    """What is wrong with an expression, and at which column (from 1)."""


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    column: int


def parse(text: str) -> Expression:
    """The tree of an expression. Raises ExpressionError with the column and what would be right."""
    if len(text) > LONGEST:
        raise ExpressionError(f"it has {len(text)} characters, and {LONGEST} are the most; write it as two effects")
    parser = _Parser(_tokens(text))
    tree = parser.expression(0, 0)
    last = parser.token
    if last.kind != "end":
        raise ExpressionError(f"column {last.column}: {last.text!r} cannot stand here; an operator such as * is needed")
    return tree


def _tokens(text: str) -> list[_Token]:
    tokens, at = [], 0
    end = len(text.rstrip())
    while at < end:
        found = _TOKEN.match(text, at)
        if found is None:
            column = len(text) - len(text[at:].lstrip()) + 1
            raise ExpressionError(
                f"column {column}: {text[column - 1]!r} is no part of an expression; it has names, numbers, "
                f"+ - * / ^ ( ) and {', '.join(FUNCTIONS_OF_A_LINE)}"
            )
        kind = str(found.lastgroup)
        tokens.append(_Token(kind, found[kind], found.start(kind) + 1))
        at = found.end()
    return [*tokens, _Token("end", "", end + 1)]


class _Parser:
    """Reads tokens from left to right; each operator takes as much to its right as binds more tightly."""

    def __init__(self, tokens: list[_Token]) -> None:
        self.tokens, self.place = tokens, 0

    @property
    def token(self) -> _Token:
        return self.tokens[self.place]

    def next(self) -> _Token:
        token = self.token
        self.place += token.kind != "end"
        return token

    def expression(self, binding: int, depth: int) -> Expression:
        if depth > DEEPEST:
            raise ExpressionError(
                f"column {self.token.column}: it is nested more than {DEEPEST} deep; write it flatter"
            )
        left = self.operand(depth)
        while (operator := self.token).text in _BINDING and _BINDING[operator.text] > binding:
            self.next()
            name = "^" if operator.text == "**" else operator.text
            # Powers are taken from the right: 2^3^2 is 2^(3^2).
            right = self.expression(_BINDING[operator.text] - (name == "^"), depth + 1)
            left = Apply(name, (left, right))
        return left

    def operand(self, depth: int) -> Expression:
        token = self.next()
        if token.kind == "number":
            if not isfinite(float(token.text)):
                raise ExpressionError(f"column {token.column}: {token.text} is larger than any number can be")
            return ExpressionNumber(float(token.text))
        if token.kind == "name":
            if self.token.text == "(":
                return self.call(token, depth)
            if token.text in FUNCTIONS_OF_A_LINE:
                raise ExpressionError(f"column {token.column}: {token.text} is a function; write {token.text}(...)")
            return ExpressionName(token.text)
        if token.text == "-":
            inner = self.expression(_NEGATION, depth + 1)
            return ExpressionNumber(-inner.value) if isinstance(inner, ExpressionNumber) else Apply("neg", (inner,))
        if token.text == "(":
            inner = self.expression(0, depth + 1)
            self.close(token)
            return inner
        shown = repr(token.text) if token.text else "the end"
        raise ExpressionError(f"column {token.column}: a name, a number or ( is needed, but here is {shown}")

    def call(self, function: _Token, depth: int) -> Expression:
        if function.text not in FUNCTIONS_OF_A_LINE or function.text not in FUNCTIONS:
            known = ", ".join(FUNCTIONS_OF_A_LINE)
            raise ExpressionError(
                f"column {function.column}: there is no function {function.text!r}; known are {known}"
            )
        bracket = self.next()
        arguments = [self.expression(0, depth + 1)]
        while self.token.text == ",":
            self.next()
            arguments.append(self.expression(0, depth + 1))
        self.close(bracket)
        needed = FUNCTIONS_OF_A_LINE[function.text]
        if len(arguments) < needed or (len(arguments) > needed and function.text not in ("min", "max")):
            raise ExpressionError(
                f"column {function.column}: {function.text} takes {needed} argument{'s' * (needed > 1)}, "
                f"here are {len(arguments)}"
            )
        tree = Apply(function.text, tuple(arguments[:needed]))
        for argument in arguments[needed:]:
            tree = Apply(function.text, (tree, argument))
        return tree

    def close(self, opened: _Token) -> None:
        token = self.next()
        if token.text != ")":
            raise ExpressionError(
                f"column {token.column}: the ( of column {opened.column} is not closed; a ) is needed"
            )
