"""The ranking: every encoding of `priors` weighed by how well it explains the readings (pure).

For an encoding e, words w and readings r the weight is, in logarithms,

    log P(e) + sum over readings [ log P(r | value of e in w) + log(resolution of e) - sum over e's words log P0(w) ]

P0 is the chance of a register that has nothing to do with the value. The resolution (engineering units between
neighbouring raw numbers) is the chance of just these words given the value: a coarse encoding that hits is believed
sooner than one so fine that it hits somewhere anyway. Floats that are round decimal numbers were most likely rounded
before they were stored, all of them by the same source to the same, and have the resolution of that. Words that stand
still from one reading to the next count once.

An encoding that explains every reading by rounding or cutting is never below one that needs a value that moved; and as
long as another one does too, none is believed by more than MAX_CONTESTED_BELIEF.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from drivers.codec import MEASURABLE_MAGNITUDES, decode, register_count
from drivers.tag import DType, Order, Quality, Tag
from gateway.commission.encodings import priors
from gateway.commission.encodings.reading import ShownNumber

Vector = NDArray[np.float64]

P_ROUNDED, P_TRUNCATED, P_MOVED = 0.9, 0.05, 0.05
"""The HMI rounds; it cuts digits off; the value has moved between the two looks."""
RELATIVE_DRIFT = 0.003
"""How far a value moves meanwhile, as a share of itself, beside one step of the display."""
MAX_DRIFT_WIDTHS = 40.0
"""Widths of that drift (with the tail of a Cauchy law) beyond which it is another value."""
MAX_ENCODINGS, HOPELESS_NATS = 60, 25.0
"""Encodings that are given, and nats behind the best of their layout from which on they are not kept."""
P_ELSEWHERE = 0.05
"""How often a value lies nowhere near the address that was given, so that what fits there fits by chance."""
MAX_CONTESTED_BELIEF = 0.9
"""The greatest share of belief as long as another encoding is as exact, or an inexact one would be likelier but for
that: neighbours are alike in ways not known here."""
_LOG_MIX = math.log(65536.0)


@dataclass(frozen=True, slots=True)
class Observation:
    """Registers of one moment, `words` from PDU address `base` on, and what the HMI showed at that moment."""

    base: int
    words: tuple[int, ...]
    shown: ShownNumber


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodingCandidate:
    """One encoding, its `weight` (log), its share of belief among all (0..1), and its values at the observations.

    `exact`: rounding or cutting digits off explains every reading; else the value must have moved meanwhile.
    """

    address: int
    dtype: DType
    order: Order
    scale: float
    offset: float
    weight: float
    share: float
    exact: bool
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _WeighedEncoding:
    """A layout with a scale and an offset, and what the readings say of it; see EncodingCandidate."""

    layout: _EncodingLayout
    scale: float
    offset: float
    weight: float
    exact: bool
    values: tuple[float, ...]


def rank(observations: Sequence[Observation], address: int) -> list[EncodingCandidate]:
    """The encodings that explain all observations, best first, at most MAX_ENCODINGS; [] where chance explains them
    better.

    `address` is where the value was said to lie. Raises ValueError without observations.
    """
    if not observations:
        raise ValueError("a guess needs at least one reading of the HMI")
    grids = {False: _grid(floats=False), True: _grid(floats=True)}
    weighed: list[_WeighedEncoding] = []
    # Every type and order at every shift that all observations have the words for.
    for (shift, near), (dtype, common) in product(priors.SHIFTS.items(), priors.TYPES.items()):
        width, at = register_count(Tag("", "", dtype)), address + shift
        if not all(seen.base <= at and at + width <= seen.base + len(seen.words) for seen in observations):
            continue
        scales, offsets, weights = grids[dtype in priors.FLOATS]
        for order, usual in (priors.ONE_REGISTER if width == 1 else priors.MORE_REGISTERS).items():
            layout = _EncodingLayout(at, dtype, order, math.log(near * common * usual))
            weighed += _weigh_layout(layout, observations, scales, offsets, weights)
    # That the value lies elsewhere has its share of the belief too; what is less likely than that is not given.
    chance = math.log(P_ELSEWHERE) + sum(math.log(seen.shown.step) for seen in observations)
    weighed = [row for row in weighed if row.weight >= chance]
    if not weighed:
        return []
    # Exact ones first; every inexact one is believed less than any of them, by how much seldomer a value moves.
    floor = min((row.weight for row in weighed if row.exact), default=math.inf) + math.log(P_MOVED / P_ROUNDED)
    contested = any(row.weight > floor for row in weighed if not row.exact)
    weighed = [row if row.exact else replace(row, weight=min(row.weight, floor)) for row in weighed]
    # A stable sort: of equal weights the one that comes first in the tables of priors stays first.
    weighed.sort(key=lambda row: (row.exact, row.weight), reverse=True)
    # Relative to the best (log-sum-exp): the weights are sums of many logarithms, and exp of them would be 0.
    best = weighed[0].weight
    beliefs = [math.exp(row.weight - best) for row in weighed]
    others = sum(beliefs[1:]) + math.exp(chance - best)
    rivalled = len(weighed) > 1 and (contested or weighed[1].exact == weighed[0].exact)
    if rivalled:
        beliefs[0] = min(beliefs[0], others * MAX_CONTESTED_BELIEF / (1.0 - MAX_CONTESTED_BELIEF))
    total = beliefs[0] + others
    return [
        EncodingCandidate(
            address=row.layout.address,
            dtype=row.layout.dtype,
            order=row.layout.order,
            scale=row.scale,
            offset=row.offset,
            weight=row.weight,
            share=min(belief / total, MAX_CONTESTED_BELIEF) if rivalled else belief / total,
            exact=row.exact,
            values=row.values,
        )
        for row, belief in zip(weighed[:MAX_ENCODINGS], beliefs, strict=False)
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


def _weigh_layout(
    layout: _EncodingLayout, observations: Sequence[Observation], scales: Vector, offsets: Vector, weights: Vector
) -> list[_WeighedEncoding]:
    """The layout with every scale and offset that explains all observations."""
    raws = [_raw(layout, seen) for seen in observations]
    if any(raw is None for raw in raws):
        return []
    # A type with more room than any of the numbers needs is less likely to have been chosen.
    chance, low, high = priors.ROOMY.get(layout.dtype, (1.0, 0.0, 0.0))
    numbers = [raw[0] for raw in raws if raw is not None]
    roomy = math.log(chance) if low <= min(numbers) and max(numbers) <= high else 0.0
    # A signed type that is more than half used up, and never by a negative number: an unsigned one was chosen as often.
    full = priors.HALF_FULL.get(layout.dtype, math.inf)
    tight = math.log(priors.P_SIGNED_THOUGH_TIGHT) if min(numbers) >= 0 and max(numbers) > full else 0.0
    total = weights + layout.weight + roomy + tight
    exact = np.ones(total.shape, dtype=np.bool_)
    # Bayes' rule for all scales and offsets at once: log prior + the log likelihood ratio of each observation against
    # registers that have nothing to do with the value. The likelihood of the words is the density of the value over
    # one raw step; words that were read before are no new evidence.
    before: list[tuple[int, ...]] = []
    fresh: list[tuple[float, float]] = []
    for raw, seen in zip(raws, observations, strict=True):
        number, step = raw or (0.0, 1.0)
        words = _covered_words(layout, seen)
        logs, explained = _log_likelihood(number * scales + offsets, seen.shown)
        total, exact = total + logs, exact & explained
        if np.max(total) == -math.inf:  # so it stays, whatever is added
            return []
        if words not in before:
            former = before[-1] if before else None
            total = total + np.log(scales) - _log_background(words, former, layout.dtype)
            fresh.append((number, step))
        before.append(words)
    total = total + _log_resolution(layout, fresh)
    kept = np.flatnonzero(np.isfinite(total) & (total > np.max(total) - HOPELESS_NATS))
    return [
        _WeighedEncoding(
            layout=layout,
            scale=float(scales[at]),
            offset=float(offsets[at]),
            weight=float(total[at]),
            exact=bool(exact[at]),
            values=tuple(float(raw[0] * scales[at] + offsets[at]) for raw in raws if raw is not None),
        )
        for at in kept
    ]


def _raw(layout: _EncodingLayout, seen: Observation) -> tuple[float, float] | None:
    """The raw number and the step to its neighbour; None where the words are no number of this type."""
    tag = Tag("", "", layout.dtype, layout.order)
    value, quality, _ = decode(tag, _covered_words(layout, seen))
    if quality is not Quality.GOOD or isinstance(value, bool | str) or value is None:
        return None
    number = float(value)
    if layout.dtype not in priors.FLOATS:
        return number, 1.0
    # One unit in the last place of the mantissa (IEEE 754), which no measurable number has below that of 1e-30.
    single = layout.dtype is DType.FLOAT32
    return number, 2.0 ** (math.floor(math.log2(max(abs(number), MEASURABLE_MAGNITUDES[0]))) - (23 if single else 52))


def _log_resolution(layout: _EncodingLayout, raws: Sequence[tuple[float, float]]) -> float:
    """log of the product of the raw numbers' resolutions, each number given with the step to its neighbour.

    Of floats the mean over what their source may have rounded them to: numbers that are all the nearest floats to
    multiples of one grain were most likely rounded to it, and one that is not says that the others are so by chance.
    """
    if layout.dtype not in priors.FLOATS:
        return sum(math.log(step) for _, step in raws)
    likelihood = (1.0 - sum(priors.GRAINS.values())) * math.prod(step for _, step in raws)
    for grain, share in priors.GRAINS.items():
        multiples = [round(round(number / grain) * grain, 2) for number, _ in raws]
        if layout.dtype is DType.FLOAT32:
            multiples = [float(np.float32(multiple)) for multiple in multiples]
        if all(number == multiple for (number, _), multiple in zip(raws, multiples, strict=True)):
            likelihood += share * math.prod(max(grain, step) for _, step in raws)
    return math.log(likelihood)


def _covered_words(layout: _EncodingLayout, seen: Observation) -> tuple[int, ...]:
    first = layout.address - seen.base
    return seen.words[first : first + register_count(Tag("", "", layout.dtype))]


def _log_likelihood(values: Vector, shown: ShownNumber) -> tuple[Vector, NDArray[np.bool_]]:
    """log P(the HMI shows this | the value): rounded, cut off, or of a moment earlier; -inf far away.

    With it, for each value, whether rounding or cutting alone explains the reading.
    """
    step, error = shown.step, values - shown.value
    # The value moved between the HMI's refresh and the read: a Cauchy density, whose tails forgive a wide move.
    width = step + RELATIVE_DRIFT * abs(shown.value)
    away = np.maximum(np.abs(error) - 0.5 * step, 0.0) / width
    logs = np.full(values.shape, -math.inf)
    # Few of all values are near, and what is rounded or cut is.
    near = np.flatnonzero(away < MAX_DRIFT_WIDTHS)
    away, rounded, cut = away[near], shown.rounding_mask(values[near]), shown.truncation_mask(values[near])
    moved = P_MOVED * step / (math.pi * width * (1.0 + away**2))
    logs[near] = np.log(P_ROUNDED * rounded + P_TRUNCATED * cut + moved)
    explained = np.zeros(values.shape, dtype=np.bool_)
    explained[near] = rounded | cut
    return logs, explained


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
            still = priors.P_EMPTY_UNCHANGED if former[place] in (0, 0xFFFF) else priors.P_WORD_UNCHANGED
            chance = still * (word == former[place]) + (1.0 - still) * chance
        total += math.log(chance)
    return total


def _stranger(word: int) -> float:
    """Often 0, or 0xFFFF, or the high word of a float; else as likely any number as any order of magnitude."""
    if word == 0:
        return priors.P_ZERO
    if word == 0xFFFF:
        return priors.P_ALL_ONES
    size = min(word, 65536 - word)  # a small negative number is as likely as a small positive one
    any_number = 0.5 / 65536 + 0.25 / (size * (_LOG_MIX - math.log(2.0)))
    low, high = priors.FLOAT_HIGH_WORDS
    top = priors.P_FLOAT_HIGH_WORD / (2 * (high - low)) if low <= word & 0x7FFF < high else 0.0
    return (1.0 - priors.P_ZERO - priors.P_ALL_ONES - priors.P_FLOAT_HIGH_WORD) * any_number + top
