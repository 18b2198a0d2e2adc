"""Held heats written as expressions: law, bound and UPPAAL text of one line, so that no engine has its own physics.

A heat may be straight in the temperature X: then dX/dt = h(signals, X) = heat - loss X with loss = -dh/dX, found by
symbolic differentiation.
"""

from collections.abc import Mapping
from functools import cache
from itertools import product
from typing import TypedDict

import numpy as np

from sim.effects.expression import (
    Expression,
    ExpressionNumber,
    Interval,
    bounds,
    compile_expression,
    derivative,
    jumps,
    names,
    negate,
    parse,
    substitute,
    uppaal_text,
)
from sim.effects.kind import ExpressedBound, HeldLaw, LatePart, Params, Signals, TextLaw, TextWriter
from sim.sha import Array, Effect

TEMPERATURE, SINCE = "temperature", "since"
"""What X (degC) and the seconds since the machine's last start are called in a line."""
SCALE, SHIFT = "scale", "shift"
"""Parameters by which a line is carried to another scale of X: its `temperature` is (X - shift) / scale."""
CELLS_BY_SIGNALS = {1: 32, 2: 24, 3: 10}
"""Parts of each signal's range in which an expression of so many signals is bounded; beyond that 3."""


class ExpressedLaws(TypedDict):
    """The three parts of a kind that follow from its expression."""

    law: HeldLaw
    bound: ExpressedBound
    uppaal: TextLaw


def compile_held_heat(heat: str) -> ExpressedLaws:
    """Law, bound and text of a held heat written as one line. Raises ExpressionError."""
    return {"law": held_law(heat), "bound": ExpressedBound(parse(heat)), "uppaal": text_law(heat)}


def late_part(heat: str) -> LatePart:
    """The part of a heat that comes after the `delay` and through the `lag`, as one line. Raises ExpressionError."""
    law = held_law(heat).heat_and_loss
    return LatePart(
        lag="lag",
        delay="delay",
        source=lambda effect, signals: law(effect, signals)[0],
        heat=parse(heat),
        text=text_law(heat),
    )


def heat_and_loss(tree: Expression) -> tuple[Expression, Expression]:
    """(heat, loss) of a heat that is straight in the temperature: h = heat - loss temperature."""
    return substitute(tree, TEMPERATURE, ExpressionNumber(0.0)), negate(derivative(tree, TEMPERATURE))


def held_law(text: str) -> HeldLaw:
    """The law of a heat whose names are roles of the effect, parameters, and perhaps the temperature."""
    tree = parse(text)
    heat, loss = (compile_expression(part) for part in heat_and_loss(tree))
    losing = TEMPERATURE in names(tree)

    def law(effect: Effect, signals: Signals) -> tuple[Array, Array]:
        columns = {role: signals[name] for role, name in effect.signals.items()}
        values: dict[str, Array | float] = {**effect.params, **columns}
        gained = np.asarray(heat(values))
        # Said for itself, since a signal that is not read need not make the whole NaN: x^0 is 1 whatever x is.
        unread = np.isnan(sum(columns.values()))
        gained = np.where(unread, np.nan, gained)
        if not losing:
            return gained, np.zeros_like(gained)
        # In the line's own scale X is (T - shift) / scale, and all heat is `scale` times as large in T's.
        lost = np.where(unread, np.nan, loss(values))
        return np.asarray(effect.params.get(SCALE, 1.0) * gained + effect.params.get(SHIFT, 0.0) * lost), lost

    return HeldLaw(law)


def text_law(text: str) -> TextLaw:
    """The term of X's rate: the flags that the signals were read, times the expression."""
    tree = parse(text)

    def term(writer: TextWriter, effect: Effect) -> str:
        read = {role: writer.read(effect, role) for role in effect.signals}
        scale, shift = effect.params.get(SCALE, 1.0), effect.params.get(SHIFT, 0.0)
        texts = {role: value for role, (value, _) in read.items()}
        texts |= {
            name: writer.constant(name.upper(), effect.params[name]) for name in names(tree) if name in effect.params
        }
        own, factor = writer.x, ""
        if TEMPERATURE in names(tree) and (scale, shift) != (1.0, 0.0):
            factor = f"{writer.constant('SCALE', scale)} * "
            own = f"(({writer.x} - {writer.constant('SHIFT', shift)}) / {writer.constant('SCALE', scale)})"
        texts[TEMPERATURE] = own
        written = uppaal_text(tree, texts, lambda value: writer.constant("NUMBER", value))
        flags = " * ".join(dict.fromkeys(flag for _, flag in read.values()))
        return f" + {flags} * {factor}{written}"

    return TextLaw(term)


@cache
def _slope(tree: Expression, name: str) -> Expression:
    return derivative(tree, name)


def enclosure(tree: Expression, params: Params, ranges: Mapping[str, Interval], x: float | None = None) -> Interval:
    """The least and greatest heat (degC/s) in each cell of the roles' `ranges`, at the temperature `x` (degC).

    Where the slope by a signal keeps its sign in a cell, only the end of its range counts (monotonicity test: Moore,
    Kearfott & Cloud 2009), which is exact where each signal's does.
    """
    point = {name: (np.asarray(value), np.asarray(value)) for name, value in params.items()}
    scale = params.get(SCALE, 1.0)
    if x is not None:
        own = np.asarray((x - params.get(SHIFT, 0.0)) / scale)
        point[TEMPERATURE] = np.nextafter(own, -np.inf), np.nextafter(own, np.inf)
    box = {**point, **ranges}
    low, high = bounds(tree, box)
    if not jumps(tree):
        least, most = dict(box), dict(box)
        for role, (left, right) in ranges.items():
            falls, rises = bounds(_slope(tree, role), box)
            up, down = falls >= 0, rises <= 0
            # Where it neither rises nor falls, either end will do, but it must be the same for both sides of the box.
            least[role] = np.where(up, left, np.where(down, right, left)), np.where(up, left, right)
            most[role] = np.where(up, right, left), np.where(up, right, np.where(down, left, right))
        low, high = np.maximum(low, bounds(tree, least)[0]), np.minimum(high, bounds(tree, most)[1])
    return scale * low, scale * high


def cells(ranges: Mapping[str, tuple[float, float]]) -> dict[str, Interval]:
    """The box of the roles' ranges cut into cells: (c,) ends of each role in each cell."""
    parts = CELLS_BY_SIGNALS.get(len(ranges), 3)
    ends = {role: np.linspace(low, high, parts + 1 if high > low else 2) for role, (low, high) in ranges.items()}
    chosen = list(product(*(range(edges.size - 1) for edges in ends.values())))
    places = np.array(chosen, dtype=np.intp).reshape(len(chosen), len(ends))
    return {
        role: (edges[places[:, column]], edges[places[:, column] + 1])
        for column, (role, edges) in enumerate(ends.items())
    }


def steepest_loss(tree: Expression, params: Params, ranges: Mapping[str, Interval]) -> float:
    """1/s: how fast the heat falls with the temperature at most, wherever in the roles' cells."""
    box = {name: (np.asarray(value), np.asarray(value)) for name, value in params.items()} | dict(ranges)
    return max(float(np.max(bounds(negate(_slope(tree, TEMPERATURE)), box)[1])), 0.0)
