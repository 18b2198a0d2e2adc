"""Laws written as text: parsed into a tree, from which value, derivative, bounds and UPPAAL's text follow."""

from sim.effects.expression.functions import (
    Expression,
    ExpressionNumber,
    Interval,
    bounds,
    compile_expression,
    crossings,
    derivative,
    jumps,
    names,
    negate,
    problem,
    substitute,
    uppaal_text,
)
from sim.effects.expression.parser import FUNCTIONS_OF_A_LINE, ExpressionError, parse
