"""What error goes with a strangeness, and the classes that are cut from it.

The curve rises with strangeness and is measured on cycles that the model was not fitted to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sim.error_limits import RED, YELLOW
from sim.sha import Array

ErrorClass = Literal["green", "yellow", "red"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCurve:
    """The expected relative error at each `strangeness` (K,), ascending in both, from `cycles` of them.

    The relative error is the root mean square of a cycle's free run over that of its departure from its first reading:
    1 is as bad as to say that nothing will change. Beyond the last strangeness nothing was measured.
    """

    strangeness: Array
    error: Array
    cycles: int

    def expected_error(self, strangeness: float) -> float:
        """The relative error to be expected; that of the strangest cycles beyond them."""
        return float(np.interp(strangeness, self.strangeness, self.error))

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values for JSON."""
        return {"strangeness": self.strangeness.tolist(), "error": self.error.tolist(), "cycles": self.cycles}


def parse_curve(plain: Mapping[str, Any]) -> ErrorCurve:
    """What `as_plain` gave. Raises KeyError, TypeError or ValueError for anything else."""
    strangeness, error = np.array(plain["strangeness"], dtype=float), np.array(plain["error"], dtype=float)
    if strangeness.shape != error.shape or not strangeness.size:
        raise ValueError("the curve needs as many errors as strangenesses")
    return ErrorCurve(strangeness=strangeness, error=error, cycles=int(plain["cycles"]))


def error_curve(strangeness: Sequence[float], error: Sequence[float]) -> ErrorCurve:
    """The curve of least squares among those that never fall (pool adjacent violators, Ayer et al. 1955).

    Raises ValueError without a cycle.
    """
    order = np.argsort(np.asarray(strangeness, dtype=float), kind="stable")
    x, y = np.asarray(strangeness, dtype=float)[order], np.asarray(error, dtype=float)[order]
    if not x.size:
        raise ValueError("no cycle tells an error")
    blocks: list[tuple[float, int]] = []
    for value in y.tolist():
        mean, count = value, 1
        while blocks and blocks[-1][0] >= mean:
            before, many = blocks.pop()
            mean, count = (before * many + mean * count) / (many + count), many + count
        blocks.append((mean, count))
    fitted = np.repeat([mean for mean, _ in blocks], [count for _, count in blocks])
    return ErrorCurve(strangeness=x, error=fitted, cycles=int(x.size))


def classify_error(error: float, yellow: float = YELLOW, red: float = RED) -> ErrorClass:
    """The class of an expected relative error."""
    return "green" if error < yellow else "yellow" if error < red else "red"


@dataclass(frozen=True, slots=True)
class ClassFigures:
    """The class that was expected of so many `cycles`, and the mean relative error that they had (None without any)."""

    name: ErrorClass
    cycles: int
    error: float | None


def measured_classes(
    cycles: Sequence[tuple[float, float]], yellow: float = YELLOW, red: float = RED
) -> list[ClassFigures]:
    """What classes are worth on cycles, each (strangeness, relative error) by a model that was not fitted to it.

    The curve that expects a cycle's error is that of the others: no class is judged by its own cycle.
    """
    found: dict[ErrorClass, list[float]] = {"green": [], "yellow": [], "red": []}
    for place, (strangeness, error) in enumerate(cycles):
        others = [*cycles[:place], *cycles[place + 1 :]]
        if others:
            curve = error_curve([one for one, _ in others], [one for _, one in others])
            found[classify_error(curve.expected_error(strangeness), yellow, red)].append(error)
    return [
        ClassFigures(name, len(errors), float(np.mean(errors)) if errors else None) for name, errors in found.items()
    ]
