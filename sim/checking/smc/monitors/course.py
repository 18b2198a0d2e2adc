"""Courses: the values of expressions along the runs, for being shown and written."""

from dataclasses import dataclass, field

import numpy as np

from sim.checking.query.tree import Expression, Indicator, Operation
from sim.checking.smc.monitors.formula import Value, combined, holds_at, value
from sim.checking.smc.monitors.monitor import Watched
from sim.checking.smc.paths.plan import Indices, Piece
from sim.sha.trace import Array, Mask


@dataclass(slots=True)
class Courses:
    """The values of some expressions at both ends of every piece: (begin, end, who), (values at begin, at end).

    `names` are the automaton's locations in order. A condition counts 1 where it holds and 0 elsewhere.
    """

    expressions: tuple[Expression, ...]
    names: tuple[str, ...]
    times: list[tuple[Array, Array, Indices]] = field(default_factory=list)
    values: list[tuple[Array, Array]] = field(default_factory=list)

    def watch(self, piece: Piece, who: Indices) -> Watched:
        """Nothing: courses are shown at the ends of pieces."""
        return [], []

    def see(self, piece: Piece, who: Indices) -> None:
        """Keep both ends."""
        begin, stop = (
            np.broadcast_to(np.asarray(one, dtype=float), who.shape) for one in (piece.begin, piece.begin + piece.dt)
        )
        self.times.append((begin, stop, who))
        self.values.append((self._at(piece, begin, at_end=False), self._at(piece, stop, at_end=True)))

    def _at(self, piece: Piece, time: Array, *, at_end: bool) -> Array:
        x, age = (piece.end, piece.age + piece.dt) if at_end else (piece.start, piece.age)
        found = [_value(one, x, time, age, piece.location, self.names) for one in self.expressions]
        return np.stack([np.broadcast_to(one, x.shape) for one in found])

    def open(self) -> Mask | None:
        """All."""
        return None


def _value(
    expression: Expression, x: Array, time: Array, age: Value, location: int | Indices, names: tuple[str, ...]
) -> Value:
    """The expression's value at one instant of the runs, conditions as 0 and 1."""
    if isinstance(expression, Indicator):
        return np.asarray(holds_at(expression.inner, x, time, age, location, names), dtype=float)
    if not isinstance(expression, Operation):
        return value(expression, x, time, age)
    left, right = (_value(side, x, time, age, location, names) for side in (expression.left, expression.right))
    return combined(expression.op, left, right)
