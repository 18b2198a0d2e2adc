"""How often `decanter plc guess` puts the right encoding first, after one and after two readings of the HMI.

Random encodings of random signals (type, order, scale, offset, address off by one or not) lie among registers of other
signals, as plants have them: floats are often rounded (to 0.1, 0.5, 1 or 5; whole numbers stored as floats), the
neighbours are often of the same kind and as often constant. The HMI rounds, now and then it cuts digits off, or the
value has moved a little between the two looks. Right
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
from drivers.codec import decode, encode, register_count
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
FLOAT_GRAINS = {0.0: 0.4, 0.1: 0.3, 0.5: 0.1, 1.0: 0.15, 5.0: 0.05}
GRAINS = {0.0: 0.9, 0.5: 0.04, 1.0: 0.04, 5.0: 0.02}
"""To what a signal is rounded before it is stored (engineering units; 0: not at all), as a float and as an integer."""
FEWEST_GRAINS = 20
"""A signal has at least so many values: what is rounded more coarsely is no measurement."""
NEIGHBOURS = {"same kind": 0.5, "any": 0.5}
STANDS = 0.3
"""The share of neighbours that never change; of the others half do between two readings."""
HMI = {"rounded": 0.92, "cut": 0.04, "moved": 0.04}
AROUND = 8
"""Registers of other signals on both sides of the value."""
TRIES = 1000
OVERSURE = 0.9
LATER = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A signal in its encoding: range, decimals on the HMI, how far it moves, and to what it is rounded when stored."""

    tag: Tag
    low: float
    high: float
    decimals: int
    moves: float
    grain: float

    def draw(self, rng: np.random.Generator) -> float:
        """One of the values that it is stored with (engineering units)."""
        return self.rounded(float(rng.uniform(self.low, self.high)))

    def rounded(self, value: float) -> float:
        """The value as its source gives it: the nearest multiple of the grain that lies in the range."""
        if not self.grain:
            return value
        count = min(max(round(value / self.grain), math.ceil(self.low / self.grain)), int(self.high / self.grain))
        return round(count * self.grain, 1)


@dataclass(frozen=True, slots=True)
class Case:
    """A signal in an encoding: where it is said to lie (`told`) and where it lies."""

    signal: "Signal"
    address: int
    told: int


Key = TypeVar("Key")


def draw(rng: np.random.Generator, weights: dict[Key, float]) -> Key:
    """One key by its weight."""
    keys = list(weights)
    share = np.array([weights[key] for key in keys])
    return keys[int(rng.choice(len(keys), p=share / share.sum()))]


def signal(rng: np.random.Generator) -> Signal:
    """A signal with an encoding that can hold its range."""
    while True:
        low, high, decimals, moves = SIGNALS[draw(rng, dict.fromkeys(SIGNALS, 1.0))]
        dtype = draw(rng, TYPES)
        is_float = dtype in (DType.FLOAT32, DType.FLOAT64)
        scale, offset = (1.0, 0.0) if is_float else (draw(rng, SCALES), draw(rng, OFFSETS))
        several = register_count(Tag("", "", dtype)) > 1
        orders = {Order.ABCD: 0.45, Order.CDAB: 0.4, Order.DCBA: 0.08, Order.BADC: 0.07}
        order = draw(rng, orders) if several else draw(rng, {Order.ABCD: 0.96, Order.BADC: 0.04})
        grain = draw(rng, FLOAT_GRAINS if is_float else GRAINS)
        tag = Tag("signal", "holding:0", dtype, order, scale, offset)
        if (scale > (high - low) / 50 and not is_float) or grain > (high - low) / FEWEST_GRAINS:
            continue
        try:
            encode(tag, low), encode(tag, high)
        except EncodingError:
            continue
        return Signal(tag=tag, low=low, high=high, decimals=decimals, moves=moves, grain=grain)


def case(rng: np.random.Generator) -> Case:
    """A random signal, and what the engineer was told of its address."""
    drawn = signal(rng)
    address = int(rng.integers(AROUND, 5000))
    return Case(drawn, address, address - draw(rng, SHIFTS))


class Memory:
    """The registers around one case, which holds its neighbours; some of them move from one reading to the next."""

    def __init__(self, one: Case, rng: np.random.Generator) -> None:
        self.case, self.rng = one, rng
        self.words: dict[int, int] = {}
        self.signals: list[tuple[int, Signal]] = []
        self.moving: list[tuple[int, Signal]] = []
        self.states: list[int] = []
        self.same_kind = draw(rng, NEIGHBOURS) == "same kind"
        width = register_count(one.signal.tag)
        for first, last in (
            (one.address - AROUND, one.address),
            (one.address + width, one.address + width + AROUND),
        ):
            at = first
            while at < last:
                at = self._neighbour(at, last)

    def _neighbour(self, at: int, last: int) -> int:
        """Another signal, a register that is 0 or 0xFFFF, or a word of states; gives the next free address."""
        if self.same_kind:
            drawn = self.case.signal
        else:
            kind = draw(self.rng, {"signal": 0.6, "zero": 0.2, "ones": 0.03, "states": 0.17})
            if kind != "signal":
                states = int(self.rng.integers(0, 1 << int(self.rng.integers(1, 17))))
                self.words[at] = {"zero": 0, "ones": 0xFFFF}.get(kind, states)
                self.states += [at] * (kind == "states")
                return at + 1
            drawn = signal(self.rng)
        width = register_count(drawn.tag)
        if at + width > last:
            return self._neighbour(at, last)
        self.signals.append((at, drawn))
        if self.rng.random() >= STANDS:
            self.moving.append((at, drawn))
        self._put(at, encode(drawn.tag, drawn.draw(self.rng)))
        return at + width

    def _put(self, at: int, words: Sequence[int]) -> None:
        self.words |= {at + place: word for place, word in enumerate(words)}

    def look(self, value: float) -> tuple[Observation, float]:
        """The registers when the signal has this value, with what the HMI shows; and the stored value."""
        one = self.case
        for at, drawn in self.moving:
            if self.rng.random() < 0.5:
                self._put(at, encode(drawn.tag, drawn.draw(self.rng)))
        words = encode(one.signal.tag, value)
        self._put(one.address, words)
        stored = decoded(one.signal.tag, words)
        shown = show(stored, one.signal, self.rng)
        base = min(self.words)
        return Observation(base, tuple(self.words[at] for at in range(base, max(self.words) + 1)), shown), stored

    def moved_on(self, value: float) -> float:
        """The stored value when the signal has this one, and every neighbour, state and signal, another one."""
        for at, drawn in self.signals:
            self._put(at, encode(drawn.tag, drawn.draw(self.rng)))
        for at in self.states:
            self.words[at] = int(self.rng.integers(0, 65536))
        words = encode(self.case.signal.tag, value)
        self._put(self.case.address, words)
        return decoded(self.case.signal.tag, words)


def decoded(tag: Tag, words: Sequence[int]) -> float:
    """The value of words that were encoded before."""
    value, _, _ = decode(tag, words)
    assert isinstance(value, int | float)
    return float(value)


def show(value: float, one: Signal, rng: np.random.Generator) -> ShownNumber:
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
    told, drawn = found.tag(), one.signal
    truth = register_count(drawn.tag)
    first = found.address - one.address
    if first < 0 or first + register_count(told) > truth:
        return False
    for value in (drawn.low, drawn.high, *rng.uniform(drawn.low, drawn.high, 100)):
        words = encode(drawn.tag, float(value))
        said, quality, _ = decode(told, words[first : first + register_count(told)])
        wanted = decoded(drawn.tag, words)
        if quality.is_bad or abs(float(said or 0.0) - wanted) > 1e-6 * max(1.0, abs(wanted)):
            return False
    return True


def reads_right(found: EncodingCandidate, memory: Memory) -> bool:
    """True if it reads as the drawn one at LATER further moments, at which every neighbour has moved on.

    So does one that takes in a register that is 0 whatever happens: of a float that is always whole, the low word or
    its neighbour's make the same number. No reading ever tells such two apart.
    """
    told, signal = found.tag(), memory.case.signal
    width = register_count(told)
    for _ in range(LATER):
        wanted = memory.moved_on(signal.draw(memory.rng))
        words = [memory.words.get(at, -1) for at in range(found.address, found.address + width)]
        value, quality, _ = decode(told, words) if min(words) >= 0 else (None, Quality.NO_DATA, "")
        if quality.is_bad or abs(float(value or 0.0) - wanted) > 1e-6 * max(1.0, abs(wanted)):
            return False
    return True


def second(one: Signal, advice: Advice, rng: np.random.Generator) -> float:
    """A value for the second reading: where the advice asks for one, as far as the signal's range goes there."""
    values = np.array([one.draw(rng) for _ in range(TRIES)])
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

    `reads`: after two the first one reads right whatever comes, though perhaps in part of a neighbour's register;
    `overconfident`: it was sure after one reading, and wrong; `deluded`: after two it believed the wrong one by more
    than OVERSURE.
    """

    one: bool
    two: bool
    reads: bool
    asked: bool
    overconfident: bool
    deluded: bool
    described: str


def verdict(seed: int) -> Verdict:
    """Guess one random encoding."""
    rng = np.random.default_rng(seed)
    problem = case(rng)
    memory = Memory(problem, rng)
    start, _ = memory.look(problem.signal.draw(rng))
    found = rank([start], problem.told)
    advice = advise(found, [start])
    one = bool(found) and is_right(found[0], problem, np.random.default_rng(seed))
    again, _ = memory.look(second(problem.signal, advice, rng))
    both = rank([start, again], problem.told)
    two = bool(both) and is_right(both[0], problem, np.random.default_rng(seed))
    deluded = not two and bool(both) and both[0].share > OVERSURE
    reads = two or (bool(both) and reads_right(both[0], memory))
    t = problem.signal.tag
    shift = problem.address - problem.told
    described = f"{t.dtype} {t.order} *{t.scale:g}{t.offset:+g} {shift:+d}: {start.shown}, {again.shown}"
    described += f" (rounded to {problem.signal.grain:g})" if problem.signal.grain else ""
    if both and not two:
        b = both[0]
        described += (
            f"; said {b.dtype} {b.order} *{b.scale:g}{b.offset:+g} {b.address - problem.told:+d} with {b.share:.1%}"
            f"{' (reads the same)' if reads else ''}"
        )
    return Verdict(
        one=one,
        two=two,
        reads=reads,
        asked=not advice.is_settled,
        overconfident=advice.is_settled and not one,
        deluded=deluded,
        described=described,
    )


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
        Figure("reads right for good, two readings", share * sum(one.reads for one in verdicts), "%", "promised", 99.0),
        Figure("a second reading asked for", share * len(asked), "%"),
        Figure(
            "wrong after two, believed by over 90 %",
            share * sum(one.deluded for one in verdicts),
            "%",
            "promised at most",
            0.1,
        ),
        Figure("sure after one reading and wrong", share * sum(one.overconfident for one in verdicts), "%"),
    ]
    give(f"guess, {count} random encodings, seeds {seed} to {seed + count - 1}", figures, as_json=as_json)


if __name__ == "__main__":
    main()
