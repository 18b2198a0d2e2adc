"""The ranking: every encoding of `priors` weighed by how well it explains the readings (pure).

For an encoding e, words w and readings r the weight is, in logarithms,

    log P(e) + sum over readings [ log P(r | value of e in w) + log(resolution of e) - sum over e's words log P0(w) ]

P0 is the chance of a register that has nothing to do with the value. The resolution (engineering units between
neighbouring raw numbers) is the chance of just these words given the value: a coarse encoding that hits is believed
sooner than one so fine that it hits somewhere anyway. Words that stand still from one reading to the next count once.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from drivers.codec import decode, registers_needed
from drivers.tag import DType, Order, Quality, Tag
from gateway.commission.encodings import priors
from gateway.commission.encodings.reading import ShownNumber

Vector = NDArray[np.float64]

ROUNDED, CUT, MOVED = 0.9, 0.05, 0.05
"""The HMI rounds; it cuts digits off; the value has moved between the two looks."""
DRIFT = 0.003
"""How far a value moves meanwhile, as a share of itself, beside one step of the display."""
FARTHEST = 40.0
"""Widths of that drift (with the tail of a Cauchy law) beyond which it is another value."""
KEPT, HOPELESS = 60, 25.0
"""Encodings that are given, and nats behind the best of their layout from which on they are not kept."""
ELSEWHERE = 0.05
"""How often a value lies nowhere near the address that was given, so that what fits there fits by chance."""
_SLACK, _FAR = 1e-9, 1e30
_LOG_MIX = math.log(65536.0)


@dataclass(frozen=True, slots=True)
class Observation:
    """Registers of one moment, `words` from PDU address `base` on, and what the HMI showed at that moment."""

    base: int
    words: tuple[int, ...]
    shown: ShownNumber


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodingCandidate:
    """One encoding, its `weight` (log), its share of belief among all (0..1), and its values at the observations."""

    address: int
    dtype: DType
    order: Order
    scale: float
    offset: float
    weight: float
    share: float
    values: tuple[float, ...]

    def tag(self, table: str = "holding") -> Tag:
        """The encoding as a tag."""
        return Tag(
            "guess", f"{table}:{self.address}", self.dtype, order=self.order, scale=self.scale, offset=self.offset
        )


@dataclass(frozen=True, slots=True)
class _EncodingLayout:
    """Where and how the raw number lies: everything but scale and offset."""

    address: int
    dtype: DType
    order: Order
    weight: float


def rank(observations: Sequence[Observation], address: int) -> list[EncodingCandidate]:
    """The encodings that explain all observations, best first, at most KEPT; [] where chance explains them better.

    `address` is where the value was said to lie. Raises ValueError without observations.
    """
    if not observations:
        raise ValueError("a guess needs at least one reading of the HMI")
    grids = {False: _grid(floats=False), True: _grid(floats=True)}
    weighed: list[tuple[float, _EncodingLayout, float, float, tuple[float, ...]]] = []
    # Every type and order at every shift that all observations have the words for.
    for (shift, near), (dtype, common) in product(priors.SHIFTS.items(), priors.TYPES.items()):
        width, at = registers_needed(Tag("", "", dtype)), address + shift
        if not all(seen.base <= at and at + width <= seen.base + len(seen.words) for seen in observations):
            continue
        scales, offsets, weights = grids[dtype in priors.FLOATS]
        for order, usual in (priors.ONE_REGISTER if width == 1 else priors.MORE_REGISTERS).items():
            layout = _EncodingLayout(at, dtype, order, math.log(near * common * usual))
            weighed += _weighed(layout, observations, scales, offsets, weights)
    # A stable sort: of equal weights the one that comes first in the tables of priors stays first.
    weighed.sort(key=lambda row: row[0], reverse=True)
    # That the value lies elsewhere has its share of the belief too; where that is the most likely, nothing is given.
    chance = math.log(ELSEWHERE) + sum(math.log(seen.shown.step) for seen in observations)
    if not weighed or chance > weighed[0][0]:
        return []
    # Relative to the best (log-sum-exp): the weights are sums of many logarithms, and exp of them would be 0.
    best = weighed[0][0]
    total = sum(math.exp(row[0] - best) for row in weighed) + math.exp(chance - best)
    return [
        EncodingCandidate(
            address=layout.address,
            dtype=layout.dtype,
            order=layout.order,
            scale=scale,
            offset=offset,
            weight=weight,
            share=math.exp(weight - best) / total,
            values=values,
        )
        for weight, layout, scale, offset, values in weighed[:KEPT]
    ]


def _grid(*, floats: bool) -> tuple[Vector, Vector, Vector]:
    """All scales with all offsets, and their log prior."""
    scales = dict(priors.FLOAT_SCALES if floats else priors.SCALES)
    if not floats:
        each = priors.FULL_SCALE_WEIGHT / (len(priors.FULL_SCALE) * len(priors.SPANS))
        for span in priors.SPANS:
            for counts in priors.FULL_SCALE:
                scales.setdefault(span / counts, each)  # a usual scale keeps its own, greater prior
    offsets = priors.FLOAT_OFFSETS if floats else priors.OFFSETS
    pairs = [(s, o, math.log(p * q)) for s, p in scales.items() for o, q in offsets.items()]
    columns = np.array(pairs, dtype=np.float64).T
    return columns[0], columns[1], columns[2]


def _weighed(
    layout: _EncodingLayout, observations: Sequence[Observation], scales: Vector, offsets: Vector, weights: Vector
) -> list[tuple[float, _EncodingLayout, float, float, tuple[float, ...]]]:
    """The layout with every scale and offset that explains all observations."""
    raws = [_raw(layout, seen) for seen in observations]
    if any(raw is None for raw in raws):
        return []
    # A type with more room than any of the numbers needs is less likely to have been chosen.
    chance, enough = priors.ROOMY.get(layout.dtype, (1.0, 0.0))
    roomy = math.log(chance) if all(abs(raw[0]) <= enough for raw in raws if raw is not None) else 0.0
    total = weights + layout.weight + roomy
    # Bayes' rule for all scales and offsets at once: log prior + the log likelihood ratio of each observation against
    # registers that have nothing to do with the value. The likelihood of the words is the density of the value over
    # one raw step; words that were read before are no new evidence.
    before: list[tuple[int, ...]] = []
    for raw, seen in zip(raws, observations, strict=True):
        number, resolution = raw or (0.0, 1.0)
        words = _covered(layout, seen)
        if abs(number) > _FAR:  # a float's garbage, whose products would overflow
            return []
        total = total + _log_shown(number * scales + offsets, seen.shown)
        if np.max(total) == -math.inf:  # so it stays, whatever is added
            return []
        if words not in before:
            former = before[-1] if before else None
            total = total + np.log(resolution * scales) - _log_background(words, former, layout.dtype)
        before.append(words)
    kept = np.flatnonzero(np.isfinite(total) & (total > np.max(total) - HOPELESS))
    scales, offsets = scales[kept], offsets[kept]
    values = [(raw[0] * scales + offsets).tolist() for raw in raws if raw is not None]
    return [
        (weight, layout, scale, offset, each)
        for weight, scale, offset, each in zip(
            total[kept].tolist(), scales.tolist(), offsets.tolist(), zip(*values, strict=True), strict=True
        )
    ]


def _raw(layout: _EncodingLayout, seen: Observation) -> tuple[float, float] | None:
    """The raw number and the step to its neighbour; None where the words are no number of this type."""
    tag = Tag("", "", layout.dtype, layout.order)
    value, quality, _ = decode(tag, _covered(layout, seen))
    if quality is not Quality.GOOD or isinstance(value, bool | str) or value is None:
        return None
    number = float(value)
    if layout.dtype not in priors.FLOATS:
        return number, 1.0
    # One unit in the last place of the mantissa (IEEE 754); of a subnormal float32, that of the least normal one.
    bits = 23 if layout.dtype is DType.FLOAT32 else 52
    least = struct.unpack(">f", b"\0\x80\0\0")[0]
    return number, float(2.0 ** (math.floor(math.log2(max(abs(number), least))) - bits))


def _covered(layout: _EncodingLayout, seen: Observation) -> tuple[int, ...]:
    first = layout.address - seen.base
    return seen.words[first : first + registers_needed(Tag("", "", layout.dtype))]


def _log_shown(values: Vector, shown: ShownNumber) -> Vector:
    """log P(the HMI shows this | the value): rounded, cut off, or of a moment earlier; -inf far away."""
    step, slack = shown.step, _SLACK * max(1.0, abs(shown.value))
    error = values - shown.value
    # The value moved between the HMI's refresh and the read: a Cauchy density, whose tails forgive a wide move.
    width = step + DRIFT * abs(shown.value)
    away = np.maximum(np.abs(error) - 0.5 * step, 0.0) / width
    logs = np.full(values.shape, -math.inf)
    # Few of all values are near, and what is rounded or cut is.
    near = np.flatnonzero(away < FARTHEST)
    error, away = error[near], away[near]
    rounded = np.abs(error) <= 0.5 * step + slack
    towards_zero = error * (1.0 if shown.value >= 0 else -1.0)
    cut = (towards_zero >= -slack) & (towards_zero < step + slack)
    moved = MOVED * step / (math.pi * width * (1.0 + away**2))
    logs[near] = np.log(ROUNDED * rounded + CUT * cut + moved)
    return logs


def _log_background(words: Sequence[int], former: Sequence[int] | None, dtype: DType) -> float:
    """log P0: registers that are strangers; many of them stand still from one reading to the next.

    An 8-bit type says nothing about the upper byte, which is then no evidence for it.
    """
    if dtype in (DType.INT8, DType.UINT8):
        return max(-math.log(256.0), math.log(_stranger(words[0])))
    total = 0.0
    for place, word in enumerate(words):
        chance = _stranger(word)
        if former is not None:
            still = priors.REMAINS_EMPTY if former[place] in (0, 0xFFFF) else priors.STANDS_STILL
            chance = still * (word == former[place]) + (1.0 - still) * chance
        total += math.log(chance)
    return total


def _stranger(word: int) -> float:
    """Often 0, or 0xFFFF; else as likely any number as any order of magnitude."""
    if word == 0:
        return priors.ZERO
    if word == 0xFFFF:
        return priors.ALL_ONES
    size = min(word, 65536 - word)  # a small negative number is as likely as a small positive one
    return (1.0 - priors.ZERO - priors.ALL_ONES) * (0.5 / 65536 + 0.25 / (size * (_LOG_MIX - math.log(2.0))))
