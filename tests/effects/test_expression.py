"""Expressions of a line: read, written, evaluated, differentiated, bounded, each against another way to know it."""

from fractions import Fraction

import numpy as np
import pytest

from sim.effects.expressed import cells, enclosure
from sim.effects.expression.functions import (
    Apply,
    Expression,
    ExpressionName,
    ExpressionNumber,
    bounds,
    compile_expression,
    derivative,
    format_expression,
    problem,
    substitute,
)
from sim.effects.expression.parser import ExpressionError, parse

NAMES = ("a", "b", "c")
LINES = (
    "gain * (feed - reference) * pump",
    "-gain * max(current - knee, 0)",
    "gain * (max(a, 0) ^ power - max(b, 0) ^ power)",
    "a - (b - c) - 2 ^ 3 ^ 2 / (4 * a) * b",
    "-(a + b) ^ 2 * exp(-abs(c) / 3e2)",
)


def made(rng: np.random.Generator, depth: int) -> str:
    """An expression that is defined everywhere, of at most `depth` functions inside one another."""
    if depth == 0 or rng.random() < 0.15:
        return str(rng.choice(NAMES)) if rng.random() < 0.7 else f"{rng.uniform(0.1, 5):.3g}"
    forms = (
        "({} + {})", "({} - {})", "{} * {}", "({}) ^ 2", "-({}) ^ 3", "max({}, {})", "min({}, {})", "abs({})",
        "exp(-abs({}))", "sqrt(max({}, 0.5))", "({}) / (1 + abs({}))", "max({}, 0.2) ^ 1.7", "above({}, {}) * {}",
        "log(max({}, 0.5))",
    )  # fmt: skip
    form = forms[int(rng.integers(len(forms)))]
    return form.format(*(made(rng, depth - 1) for _ in range(form.count("{}"))))


def exact(tree: Expression, values: dict[str, Fraction]) -> Fraction:
    """The value in rational numbers, by the rules of arithmetic and none of the table's."""
    match tree:
        case ExpressionNumber(value):
            return Fraction(value)
        case ExpressionName(name):
            return values[name]
        case Apply(function, arguments):
            parts = [exact(each, values) for each in arguments]
            match function:
                case "+":
                    return parts[0] + parts[1]
                case "-":
                    return parts[0] - parts[1]
                case "*":
                    return parts[0] * parts[1]
                case "/":
                    return parts[0] / parts[1]
                case "neg":
                    return -parts[0]
                case "^":
                    return parts[0] ** int(parts[1])
                case "above":
                    return Fraction(parts[0] > parts[1])
                case _:
                    return {"max": max, "min": min, "abs": lambda x: abs(x)}[function](*parts)


@pytest.mark.parametrize("text", LINES)
def test_what_is_written_is_read_as_it_was(text: str) -> None:
    tree = parse(text)
    assert parse(format_expression(tree)) == tree


def test_values_and_slopes_are_those_of_rational_arithmetic() -> None:
    # d/da of a b^3 / (1 + a^2) and of the bends, worked out by hand.
    line = "a * b ^ 3 / (1 + a ^ 2) - max(a - c, 0) + abs(b) * min(a, c) + above(b, c)"
    slope = "b ^ 3 * (1 - a ^ 2) / (1 + a ^ 2) ^ 2 - above(a, c) + abs(b) * above(c, a)"
    tree, by_a = parse(line), derivative(parse(line), "a")
    rng = np.random.default_rng(4)
    for a, b, c in rng.integers(-6, 7, (60, 3)).tolist():
        if a == c:
            continue  # a bend: its slope is one of two
        values = {"a": Fraction(a, 3), "b": Fraction(b, 2), "c": Fraction(c, 3)}
        floats = {name: np.array(float(value)) for name, value in values.items()}
        assert float(compile_expression(tree)(floats)) == pytest.approx(
            float(exact(tree, values)), rel=1e-14, abs=1e-14
        )
        assert exact(by_a, values) == exact(parse(slope), values)


def test_slopes_are_those_of_small_differences() -> None:
    rng = np.random.default_rng(7)
    compared = 0
    for _ in range(60):
        tree = parse(made(rng, 3))
        points = {name: rng.uniform(-3.0, 3.0, 20) for name in NAMES}
        for name in NAMES:
            slope = np.broadcast_to(compile_expression(derivative(tree, name))(points), (20,))
            sides = [
                np.broadcast_to(compile_expression(tree)({**points, name: points[name] + h}), (20,))
                for h in (-2e-6, -1e-6, 1e-6, 2e-6)
            ]
            near, far = (sides[2] - sides[1]) / 2e-6, (sides[3] - sides[0]) / 4e-6
            smooth = np.abs(near - far) < 1e-6 * (1.0 + np.abs(near))  # no bend or jump between
            np.testing.assert_allclose(slope[smooth], near[smooth], rtol=2e-5, atol=2e-5)
            compared += int(smooth.sum())
    assert compared > 3000


def test_no_sample_leaves_its_bounds() -> None:
    rng = np.random.default_rng(9)
    for _ in range(80):
        tree = parse(made(rng, 3))
        low = {name: rng.uniform(-3.0, 3.0) for name in NAMES}
        high = {name: value + rng.choice([0.0, 1e-9, 0.1, 3.0]) for name, value in low.items()}
        inside = {name: np.append(rng.uniform(low[name], high[name], 300), [low[name], high[name]]) for name in NAMES}
        values = np.broadcast_to(compile_expression(tree)(inside), (302,))
        box = {name: (np.asarray(low[name]), np.asarray(high[name])) for name in NAMES}
        for least, most in (bounds(tree, box), enclosure(tree, {}, box)):
            assert np.all(values >= least) and np.all(values <= most), format_expression(tree)


def test_cells_and_slopes_make_bounds_that_are_nearly_exact() -> None:
    tree = parse("gain * (feed - reference) * pump - gain * feed ^ 2 * 0.02")
    params, ranges = {"gain": 2e-4, "reference": 20.0}, {"feed": (5.0, 60.0), "pump": (0.0, 3.0)}
    low, high = enclosure(tree, params, cells(ranges))
    feed, pump = np.meshgrid(np.linspace(5.0, 60.0, 400), np.linspace(0.0, 3.0, 200))
    values = compile_expression(tree)({**params, "feed": feed, "pump": pump})
    span = float(np.ptp(values))
    assert (
        0.0 <= float(values.min() - low.min()) < 0.05 * span and 0.0 <= float(high.max() - values.max()) < 0.05 * span
    )


def test_an_interval_without_end_is_not_lost() -> None:
    everything = {"a": (np.asarray(-np.inf), np.asarray(np.inf)), "b": (np.asarray(0.0), np.asarray(0.0))}
    assert [float(end) for end in bounds(parse("exp(-abs(a))"), everything)] == pytest.approx([0.0, 1.0])
    assert [float(end) for end in bounds(parse("a * b"), everything)] == pytest.approx([0.0, 0.0])
    assert problem(parse("b / (1 + abs(a))"), everything) == ""
    assert problem(parse("1 / a"), everything) == "the divisor may be 0 in 1 / a"
    assert problem(parse("a ^ 0.5"), everything) == "the base of a power may be negative in a ^ 0.5"
    assert "log may be taken" in problem(parse("log(a)"), everything)
    assert "exp may be larger" in problem(parse("exp(a)"), everything)


def test_constants_are_worked_out() -> None:
    assert derivative(parse("3 * a + 2"), "a") == ExpressionNumber(3.0)
    assert substitute(parse("a * (b + c)"), "a", ExpressionNumber(0.0)) == ExpressionNumber(0.0)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a b", "column 3: 'b' cannot stand here; an operator such as * is needed"),
        ("a +", "column 4: a name, a number or ( is needed, but here is the end"),
        ("(a + b", "column 7: the ( of column 1 is not closed; a ) is needed"),
        ("max(a)", "column 1: max takes 2 arguments, here are 1"),
        ("__import__(a)", "column 1: there is no function '__import__'; known are min"),
        ("a.b", "column 2: '.' is no part of an expression"),
        ("a if b else c", "column 3: 'if' cannot stand here"),
        ("1e999 * a", "column 1: 1e999 is larger than any number can be"),
        ("(" * 60 + "a" + ")" * 60, "is nested more than 40 deep"),
        ("a + " * 100 + "a", "it has 401 characters, and 300 are the most"),
        ("max + 1", "column 1: max is a function; write max(...)"),
        ("", "column 1: a name, a number or ( is needed, but here is the end"),
    ],
)
def test_what_is_no_expression_is_refused_by_its_column(text: str, sentence: str) -> None:
    with pytest.raises(ExpressionError) as error:
        parse(text)
    assert sentence in str(error.value)
