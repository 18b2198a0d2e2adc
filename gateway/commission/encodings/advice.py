"""Which second reading removes the ties: what the rivals would show if the best encoding were right (pure)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.codec import decode, encode, register_count
from drivers.errors import EncodingError
from gateway.commission.encodings.scoring import EncodingCandidate, Observation

MIN_RIVAL_RELATIVE_SHARE = 0.01
"""A rival with less of the belief than this, relative to the best, is not worth another look at the HMI."""
SETTLED_SHARE = 0.97
"""The share of belief from which no further reading is asked for."""
_MAX_RATIO, _MAX_TWIN_RATIO = 4.0, 1000.0
_STEPS = 12


@dataclass(frozen=True, slots=True)
class Advice:
    """Whether another reading is needed, and which: `below` or `above` a value; `ties` are the rivals.

    `twins` are rivals that agree with the best for values of the same sign, from a quarter up to four times as much (an
    unsigned type instead of a signed one, a wider one): they matter only if the signal goes below `twins_below` or
    above `twins_above`.
    """

    ties: tuple[EncodingCandidate, ...] = ()
    below: float | None = None
    above: float | None = None
    twins: tuple[EncodingCandidate, ...] = ()
    twins_below: float | None = None
    twins_above: float | None = None

    @property
    def is_settled(self) -> bool:
        """True if no rival is left that another ordinary reading would tell apart."""
        return not self.ties

    @property
    def sentences(self) -> tuple[str, ...]:
        """What to do next, and what does not matter unless the signal goes farther."""
        lines = []
        if self.ties:
            rivals = "1 other encoding explains" if len(self.ties) == 1 else f"{len(self.ties)} others explain"
            lines.append(
                f"{rivals} this too: give a second reading when the HMI shows clearly another value"
                f"{_target_sentence(' (', self.below, self.above, ')')}"
            )
        if self.twins:
            names = ", ".join(dict.fromkeys(f"{twin.dtype} at {twin.address}" for twin in self.twins))
            limits = _target_sentence("", self.twins_below, self.twins_above, "")
            unless = f" unless it goes {limits}: if it can, read it there too" if limits else ""
            lines.append(f"{names} would read the same{unless}")
        return tuple(lines)


def _target_sentence(before: str, below: float | None, above: float | None, after: str) -> str:
    limits = [f"{word} {value:.6g}" for word, value in (("below", below), ("above", above)) if value is not None]
    return f"{before}{' or '.join(limits)}{after}" if limits else ""


def advise(candidates: Sequence[EncodingCandidate], observations: Sequence[Observation]) -> Advice:
    """What is left to find out."""
    if not candidates:
        return Advice()
    best, last = candidates[0], observations[-1]
    ties: dict[int, tuple[float, float]] = {}
    twins: dict[int, tuple[float, float]] = {}
    rivals = {
        index: one
        for index, one in enumerate(candidates)
        if index and one.share >= MIN_RIVAL_RELATIVE_SHARE * best.share
    }
    for index, rival in rivals.items():
        near = _both_sides(best, rival, last, (1.0 / _MAX_RATIO, _MAX_RATIO))
        if min(near) < math.inf:
            ties[index] = near
        else:
            twins[index] = _both_sides(best, rival, last, (-_MAX_RATIO, _MAX_TWIN_RATIO))
    same = tuple(rivals[index] for index in twins)
    limits = (_separation_bound(last, -1, twins), _separation_bound(last, 1, twins))
    if not ties or best.share + sum(twin.share for twin in same) >= SETTLED_SHARE:
        return Advice((), None, None, same, *limits)
    # Only one side is advised where a reading on the other would leave a rival that it removes.
    complete = [max(near[side] for near in ties.values()) < math.inf for side in (0, 1)]
    below = _separation_bound(last, -1, ties) if complete[0] or not complete[1] else None
    above = _separation_bound(last, 1, ties) if complete[1] or not complete[0] else None
    return Advice(tuple(rivals[index] for index in ties), below, above, same, *limits)


def _separation_bound(last: Observation, side: int, apart: Mapping[int, tuple[float, float]]) -> float | None:
    """The value on one side from which on no rival agrees any more that ever differs there; None where none does."""
    known = [distances[side > 0] for distances in apart.values() if distances[side > 0] < math.inf]
    return last.shown.value + side * max(known) if known else None


def _both_sides(
    best: EncodingCandidate, rival: EncodingCandidate, last: Observation, factors: tuple[float, float]
) -> tuple[float, float]:
    """How far below and above the last reading the rival first shows something else."""
    less, more = (_nearest(best, rival, last, factor) for factor in factors)
    return (less, more) if last.shown.value >= 0 else (more, less)


def _nearest(best: EncodingCandidate, rival: EncodingCandidate, last: Observation, farthest: float) -> float:
    """How far from the last reading the rival first shows something else, on the way to `farthest` times its value.

    Infinite where it never does.
    """
    start = last.shown.value or 100.0 * last.shown.step  # a reading of 0 has no multiples
    agreed = start
    for step in range(1, _STEPS + 1):
        share = step / _STEPS
        # In equal ratios, as values range over orders of magnitude; through 0 to the other sign in equal steps.
        factor = farthest**share if farthest > 0 else 1.0 + share * (farthest - 1.0)
        if _differ(best, rival, last, start * factor):
            # Bisection between the last value at which they agreed and this one; it ends on the side where they differ.
            same, other = agreed, start * factor
            for _ in range(_STEPS):
                middle = (same + other) / 2.0
                if _differ(best, rival, last, middle):
                    other = middle
                else:
                    same = middle
            return abs(other - start)
        agreed = start * factor
    return math.inf


def _differ(best: EncodingCandidate, rival: EncodingCandidate, last: Observation, value: float) -> bool:
    """Whether the rival would show something else if the best were right and the value were this one.

    A value that only the rival can hold tells them apart too.
    """
    try:
        fresh = encode(best.tag(), value)
    except EncodingError:
        try:
            encode(rival.tag(), value)
        except EncodingError:
            return False  # neither holds it: such a value cannot come, and tells nothing
        return True
    # The registers as they would be: the neighbours stay, which a rival at another address or wider reads with them.
    words = list(last.words)
    first = best.address - last.base
    words[first : first + len(fresh)] = fresh
    own, other = (_value(each, words, last.base) for each in (best, rival))
    return own is None or other is None or abs(own - other) > 0.5 * last.shown.step


def _value(candidate: EncodingCandidate, words: Sequence[int], base: int) -> float | None:
    tag, first = candidate.tag(), candidate.address - base
    value, quality, _ = decode(tag, words[first : first + register_count(tag)])
    return float(value) if not quality.is_bad and isinstance(value, int | float) else None
