"""A bound of the drift dX/dt that never rises with X, in pieces a - b X, and where a temperature goes under it.

Under such a bound a temperature runs one way in time, a higher start gives a higher end, and no step drives two starts
apart: what `reach` needs of a location. A loss whose strength is not known pulls with its least strength above its sink
and with its greatest one below, so that the pieces meet at the sink; a thermostat's piece ends where it must be open.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import expm1, inf, isinf, log1p

Pair = tuple[float, float]
"""a (degC/s) and b (1/s, at least 0) of a piece a - b X."""

MIN_LOSS_PER_S = 1e-300
"""1/s: below it a loss times a time is a subnormal number, of whose digits few or none are left; it moves nothing."""


@dataclass(frozen=True, slots=True)
class DriftBound:
    """The pieces from left to right, `pairs[i]` between the ascending `knots` i - 1 and i; it may fall at a knot.

    `rest` has the least and the greatest X at which a run stays: below it rises, above it falls. It is infinite where
    that never ends.
    """

    knots: tuple[float, ...]
    pairs: tuple[Pair, ...]
    rest: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        low, high = inf, -inf
        # From left to right the drift only falls, smoothly or by a jump at a knot: X rests from the first place where
        # it is no longer positive to the last one where it is not yet negative.
        for left, right, (a, b) in zip((-inf, *self.knots), (*self.knots, inf), self.pairs, strict=True):
            level = b == 0 and a == 0
            root = a / b if b > 0 else inf if a > 0 else -inf
            # A root left of its piece means that the drift jumps across 0 at the knot: X rests there.
            if low == inf and (root <= right or level) and not (root == right == inf):
                low = max(left, root)
            if level or (root >= left and root > -inf):
                high = right if level else min(right, root)
        object.__setattr__(self, "rest", (low, high))  # the class is frozen

    def find_piece(self, x: float) -> Pair:
        """The piece of a temperature; at a knot the one to its right."""
        return self.pairs[bisect_right(self.knots, x)]

    def shift(self, by: float) -> "DriftBound":
        """That of X + `by` (degC)."""
        if by == 0.0:
            return self
        return DriftBound(tuple(knot + by for knot in self.knots), tuple((a + b * by, b) for a, b in self.pairs))

    def mirror(self) -> "DriftBound":
        """That of -X."""
        return DriftBound(
            tuple(-knot for knot in reversed(self.knots)), tuple((-a, b) for a, b in reversed(self.pairs))
        )

    def advance(self, x: float, dt: float, rate: float) -> float:
        """X after `dt` s (perhaps infinite) from `x`, no faster than `rate` (degC/s).

        A rise has the whole way of a free step or that of the rate, whichever is less, as the simulator's steps have.
        """
        low, high = self.rest
        if dt == 0 or low <= x <= high:
            return x
        if isinf(dt):
            return low if x < low else high
        if isinf(x):
            return x
        if x < low:
            return min(self._rise(x, dt, low), x + rate * dt)
        return self._fall(x, dt, high, rate)

    def _rise(self, x: float, dt: float, low: float) -> float:
        place = bisect_right(self.knots, x)
        while dt > 0 and x < low:
            (a, b), knot = self.pairs[place], self.knots[place] if place < len(self.knots) else inf
            needed = _seconds(a, b, x, min(knot, low))
            if needed > dt:
                return _move(a, b, x, dt)
            x, dt, place = min(knot, low), dt - needed, place + 1
        return x

    def _fall(self, x: float, dt: float, high: float, rate: float) -> float:
        place = bisect_left(self.knots, x)
        while dt > 0 and x > high:
            (a, b), knot = self.pairs[place], max(self.knots[place - 1] if place else -inf, high)
            if a - b * x < -rate:
                # A fall at the maximum rate comes first: it lasts until the free fall is no faster (or to the knot).
                slow = max(knot, (a + rate) / b) if b > 0 else knot
                needed = (x - slow) / rate
                if needed > dt:
                    return x - rate * dt
                x, dt = slow, dt - needed
                if x <= knot:
                    place -= 1
                    continue
            needed = _seconds(a, b, x, knot)
            if needed > dt:
                return _move(a, b, x, dt)
            x, dt, place = knot, dt - needed, place - 1
        return x


def add_bounds(parts: Iterable[DriftBound]) -> DriftBound:
    """The sum of bounds."""
    drifts = tuple(parts)
    knots = tuple(sorted({knot for each in drifts for knot in each.knots}))
    pairs = []
    for left in (-inf, *knots):
        pieces = [each.find_piece(left) if left > -inf else each.pairs[0] for each in drifts]
        pairs.append((sum(a for a, _ in pieces), sum(b for _, b in pieces)))
    return DriftBound(knots, tuple(pairs))


def _seconds(a: float, b: float, x: float, end: float) -> float:
    """Seconds from `x` to `end` under a - b X, which leads there; inf where it only comes near."""
    speed = a - b * x
    if speed == 0:
        return 0.0  # it is there, but for rounding
    if b < MIN_LOSS_PER_S:
        return (end - x) / speed
    # x(t) = x + speed (1 - e^-bt) / b solved for t; log1p keeps the digits where b (end - x) is small beside the speed.
    share = b * (end - x) / speed
    return -log1p(-share) / b if share < 1 else inf


def _move(a: float, b: float, x: float, dt: float) -> float:
    # expm1: 1 - e^-bt would lose all digits where b dt is small.
    return x + (a - b * x) * (dt if b < MIN_LOSS_PER_S else -expm1(-b * dt) / b)
