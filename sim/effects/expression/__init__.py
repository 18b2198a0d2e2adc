"""Laws written as text: parsed into a tree, from which value, derivative, bounds and UPPAAL's text follow."""

from sim.effects.expression.functions import (
    Apply,
    Expression,
    ExpressionName,
    ExpressionNumber,
    Interval,
    bounds,
    compiled,
    crossings,
    derivative,
    jumps,
    names,
    negate,
    problem,
    substituted,
    uppaal_text,
    written,
)
from sim.effects.expression.parser import FUNCTIONS_OF_A_LINE, ExpressionError, parse

__all__ = [
    "FUNCTIONS_OF_A_LINE",
    "Apply",
    "Expression",
    "ExpressionError",
    "ExpressionName",
    "ExpressionNumber",
    "Interval",
    "bounds",
    "compiled",
    "crossings",
    "derivative",
    "jumps",
    "names",
    "negate",
    "parse",
    "problem",
    "substituted",
    "uppaal_text",
    "written",
]
