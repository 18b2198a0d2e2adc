"""How often `decanter plc guess` puts the right encoding first, after one and after two readings of the HMI.

Random encodings of random signals (type, order, scale, offset, address off by one or not) lie among registers of other
signals. The HMI rounds, now and then it cuts digits off, or the value has moved a little between the two looks. Right
is the encoding that was drawn, or one that decodes every value of the signal's range exactly as it does (uint16 for
int16 where nothing is negative). The second reading is drawn from the signal's range too, and from that part of it that
the tool asks for, where the range has such a part.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure, give
from drivers.codec import decode, encode, registers_needed
from drivers.errors import EncodingError
from drivers.tag import DType, Order, Quality, Tag
from gateway.commission.encodings.advice import Advice, advise
from gateway.commission.encodings.reading import ShownNumber
from gateway.commission.encodings.scoring import EncodingCandidate, Observation, rank

TYPES = {
    DType.INT16: 0.25,
    DType.UINT16: 0.25,
    DType.FLOAT32: 0.25,
    DType.INT32: 0.08,
    DType.UINT32: 0.08,
    DType.BCD16: 0.03,
    DType.FLOAT64: 0.03,
    DType.BCD32: 0.01,
    DType.INT64: 0.01,
    DType.UINT64: 0.01,
}
SCALES = {
    1.0: 0.25,
    0.1: 0.3,
    0.01: 0.2,
    0.001: 0.04,
    10.0: 0.03,
    0.5: 0.06,
    0.05: 0.03,
    0.2: 0.03,
    0.25: 0.03,
    2.0: 0.03,
}
OFFSETS = {0.0: 0.8, -40.0: 0.06, -50.0: 0.05, -100.0: 0.03, -273.15: 0.04, -20.0: 0.02}
SHIFTS = {0: 0.6, -1: 0.22, 1: 0.18}
SIGNALS = {
    "temperature": (-20.0, 150.0, 1, 0.001),
    "bearing": (10.0, 110.0, 1, 0.001),
    "current": (0.0, 350.0, 1, 0.005),
    "power": (0.0, 90.0, 2, 0.005),
    "speed": (0.0, 3600.0, 0, 0.001),
    "pressure": (0.0, 16.0, 2, 0.002),
    "vibration": (0.0, 25.0, 2, 0.005),
    "level": (0.0, 100.0, 1, 0.001),
    "torque": (-150.0, 150.0, 1, 0.005),
    "flow": (0.0, 1200.0, 1, 0.002),
    "hours": (0.0, 60_000.0, 0, 0.0),
    "energy": (0.0, 4_000_000.0, 0, 0.0),
}
"""Range in engineering units, decimals on the HMI, and how far it moves between two looks (a share of the range)."""
HMI = {"rounded": 0.92, "cut": 0.04, "moved": 0.04}
AROUND = 8
"""Registers of other signals on both sides of the value."""
TRIES = 1000


@dataclass(frozen=True, slots=True)
class Case:
    """A signal in an encoding: where it is said to lie (`told`) and where it lies, its range and its decimals."""

    tag: Tag
    address: int
    told: int
    low: float
    high: float
    decimals: int
    moves: float


Key = TypeVar("Key")


def draw(rng: np.random.Generator, weights: dict[Key, float]) -> Key:
    """One key by its weight."""
    keys = list(weights)
    share = np.array([weights[key] for key in keys])
    return keys[int(rng.choice(len(keys), p=share / share.sum()))]


def encoding(rng: np.random.Generator) -> tuple[Tag, float, float, int, float]:
    """A signal with an encoding that can hold its range: tag, low, high, decimals on the HMI, how far it moves."""
    while True:
        low, high, decimals, moves = SIGNALS[draw(rng, dict.fromkeys(SIGNALS, 1.0))]
        dtype = draw(rng, TYPES)
        is_float = dtype in (DType.FLOAT32, DType.FLOAT64)
        scale, offset = (1.0, 0.0) if is_float else (draw(rng, SCALES), draw(rng, OFFSETS))
        several = registers_needed(Tag("", "", dtype)) > 1
        orders = {Order.ABCD: 0.45, Order.CDAB: 0.4, Order.DCBA: 0.08, Order.BADC: 0.07}
        order = draw(rng, orders) if several else draw(rng, {Order.ABCD: 0.96, Order.BADC: 0.04})
        tag = Tag("signal", "holding:0", dtype, order, scale, offset)
        if scale > (high - low) / 50 and not is_float:
            continue
        try:
            encode(tag, low), encode(tag, high)
        except EncodingError:
            continue
        return tag, low, high, decimals, moves


def case(rng: np.random.Generator) -> Case:
    """A random encoding, and what the engineer was told of its address."""
    tag, low, high, decimals, moves = encoding(rng)
    address = int(rng.integers(AROUND, 5000))
    return Case(tag, address, address - draw(rng, SHIFTS), low, high, decimals, moves)


class Memory:
    """The registers around one case; strangers move on from one reading to the next, half of them."""

    def __init__(self, one: Case, rng: np.random.Generator) -> None:
        self.case, self.rng = one, rng
        self.words: dict[int, int] = {}
        self.strangers: list[tuple[int, Tag, float, float]] = []
        width = registers_needed(one.tag)
        for first, last in (
            (one.address - AROUND, one.address),
            (one.address + width, one.address + width + AROUND),
        ):
            at = first
            while at < last:
                at = self._stranger(at, last)

    def _stranger(self, at: int, last: int) -> int:
        """Another signal, a register that is 0 or 0xFFFF, or a word of states; gives the next free address."""
        kind = draw(self.rng, {"signal": 0.6, "zero": 0.2, "ones": 0.03, "states": 0.17})
        if kind != "signal":
            states = int(self.rng.integers(0, 1 << int(self.rng.integers(1, 17))))
            self.words[at] = {"zero": 0, "ones": 0xFFFF}.get(kind, states)
            return at + 1
        tag, low, high, _, _ = encoding(self.rng)
        width = registers_needed(tag)
        if at + width > last:
            return self._stranger(at, last)
        self.strangers.append((at, tag, low, high))
        self._put(at, encode(tag, float(self.rng.uniform(low, high))))
        return at + width

    def _put(self, at: int, words: Sequence[int]) -> None:
        self.words |= {at + place: word for place, word in enumerate(words)}

    def look(self, value: float) -> tuple[Observation, float]:
        """The registers when the signal has this value, with what the HMI shows; and the stored value."""
        one = self.case
        for at, tag, low, high in self.strangers:
            if self.rng.random() < 0.5:
                self._put(at, encode(tag, float(self.rng.uniform(low, high))))
        words = encode(one.tag, value)
        self._put(one.address, words)
        stored = decoded(one.tag, words)
        shown = show(stored, one, self.rng)
        base = min(self.words)
        return Observation(base, tuple(self.words[at] for at in range(base, max(self.words) + 1)), shown), stored


def decoded(tag: Tag, words: Sequence[int]) -> float:
    """The value of words that were encoded before."""
    value, quality, reason = decode(tag, words)
    assert quality is Quality.GOOD, reason
    assert isinstance(value, int | float)
    return float(value)


def show(value: float, one: Case, rng: np.random.Generator) -> ShownNumber:
    """What the HMI shows of a stored value."""
    step = 10.0**-one.decimals
    how = draw(rng, HMI)
    if how == "cut":
        return ShownNumber(math.trunc(value / step + 1e-9) * step, step)
    if how == "moved":
        value += float(rng.normal(0.0, one.moves)) * (one.high - one.low)
    return ShownNumber(round(round(value / step) * step, one.decimals), step)


def is_right(found: EncodingCandidate, one: Case, rng: np.random.Generator) -> bool:
    """True if the encoding decodes every value of the range as the one that was drawn.

    One that reads other registers than the signal's own is wrong, unless it reads a part of them and the rest is never
    anything but 0 (a counter of 32 bits that stays below 65536).
    """
    told, truth = found.tag(), registers_needed(one.tag)
    first = found.address - one.address
    if first < 0 or first + registers_needed(told) > truth:
        return False
    for value in (one.low, one.high, *rng.uniform(one.low, one.high, 100)):
        words = encode(one.tag, float(value))
        said, quality, _ = decode(told, words[first : first + registers_needed(told)])
        wanted = decoded(one.tag, words)
        if quality is not Quality.GOOD or abs(float(said or 0.0) - wanted) > 1e-6 * max(1.0, abs(wanted)):
            return False
    return True


def second(one: Case, advice: Advice, rng: np.random.Generator) -> float:
    """A value for the second reading: where the advice asks for one, as far as the signal's range goes there."""
    values = rng.uniform(one.low, one.high, TRIES)
    ties = beyond(values, advice.below, advice.above)
    twins = beyond(values, advice.twins_below, advice.twins_above)
    wanted = next((part for part in (ties & twins, ties, twins) if part.any()), np.ones(TRIES, dtype=np.bool_))
    return float(values[wanted][0])


def beyond(values: NDArray[np.float64], below: float | None, above: float | None) -> NDArray[np.bool_]:
    """Which values are below the one limit or above the other; none without limits."""
    low, high = -math.inf if below is None else below, math.inf if above is None else above
    return np.asarray((values <= low) | (values >= high), dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class Verdict:
    """One case: whether the first was right after one and after two readings, and whether the tool asked for more.

    `overconfident`: it was sure after one reading, and wrong.
    """

    one: bool
    two: bool
    asked: bool
    overconfident: bool
    described: str


def verdict(seed: int) -> Verdict:
    """Guess one random encoding."""
    rng = np.random.default_rng(seed)
    problem = case(rng)
    memory = Memory(problem, rng)
    start, _ = memory.look(float(rng.uniform(problem.low, problem.high)))
    found = rank([start], problem.told)
    advice = advise(found, [start])
    one = bool(found) and is_right(found[0], problem, np.random.default_rng(seed))
    again, _ = memory.look(second(problem, advice, rng))
    both = rank([start, again], problem.told)
    two = bool(both) and is_right(both[0], problem, np.random.default_rng(seed))
    t = problem.tag
    shift = problem.address - problem.told
    described = f"{t.dtype} {t.order} *{t.scale:g}{t.offset:+g} {shift:+d}: {start.shown}, {again.shown}"
    if both and not two:
        b = both[0]
        described += f"; said {b.dtype} {b.order} *{b.scale:g}{b.offset:+g} {b.address - problem.told:+d}"
    return Verdict(one, two, not advice.settled, advice.settled and not one, described)


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="A fifth of the encodings.")
@click.option("--cases", default=500, show_default=True, type=click.IntRange(1), help="Random encodings.")
@click.option("--seed", default=1, show_default=True, help="The encodings are drawn with the seeds from this one on.")
@click.option("--misses", is_flag=True, help="Also list the encodings that were not found after two readings.")
def main(as_json: bool, quick: bool, cases: int, seed: int, misses: bool) -> None:
    count = cases // 5 if quick else cases
    verdicts = [verdict(seed + number) for number in range(count)]
    for number, one in enumerate(verdicts):
        if misses and not one.two:
            click.echo(f"seed {seed + number}: {one.described}", err=True)
    asked = [one for one in verdicts if one.asked]
    share = 100.0 / count
    figures = [
        Figure("right encoding first, one reading", share * sum(one.one for one in verdicts), "%", "promised", 90.0),
        Figure("right encoding first, two readings", share * sum(one.two for one in verdicts), "%", "promised", 99.0),
        Figure("a second reading asked for", share * len(asked), "%"),
        Figure("sure after one reading and wrong", share * sum(one.overconfident for one in verdicts), "%"),
    ]
    give(f"guess, {count} random encodings, seeds {seed} to {seed + count - 1}", figures, as_json=as_json)


if __name__ == "__main__":
    main()
