"""The conformance suite of the PLC's side as data: what is written to the block's area, and what must become of it.

A step says what is written (a whole block or a part of one), how long to wait before, whether the write is permitted,
and what must follow: blocks accepted and refused since the step before, the reason, whether the prediction is usable.
The steps are one story, to be put through in their order. A PLC that looks at its memory, and does not see the writes
themselves, can pass them all: no step writes what stands in the memory already.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from random import Random
from typing import Any

from gateway.machine.writing import Validity, build, crc
from gateway.settings import WritebackLayout

FORMAT = 1
FLIPS = 24
_USABLE = Validity(31)
_VERSION, _CHECKSUM, _STILL = ("layout version",), ("CRC",), ("heartbeat did not change",)
_CALM: Mapping[str, float | None] = {
    "input_quality": 0.0,
    "age": 0.3,
    "location": 1.0,
    "temperature_now": 45.12,
    "band_low": 44.9,
    "band_high": 45.4,
    "horizon": 900.0,
    "horizon_low": 44.0,
    "horizon_median": 46.0,
    "horizon_high": 48.0,
    "p_limit": 0.0,
    "zone": 1.0,
    "alarms": 0.0,
    "anomaly": 0.2,
    "model_hash": 48879.0,
}


@dataclass(frozen=True, slots=True)
class SuiteStep:
    """One step. `words` empty: nothing is written; `permit` None: as it was.

    `reasons` are the refusals that are right, by the contract's words; `usable` is what the PLC must say at the end.
    """

    name: str
    words: tuple[int, ...] = ()
    offset: int = 0
    wait_s: float = 0.0
    permit: bool | None = None
    accepted: int = 0
    refused: int = 0
    reasons: tuple[str, ...] = ()
    usable: bool = False


class _Story:
    """Blocks whose sequence and heartbeat go on from one to the next."""

    def __init__(self, layout: WritebackLayout, seed: int) -> None:
        self.layout = layout
        self.index = {field.name: place for place, field in enumerate(layout.fields)}
        self.sequence, self.heartbeat = 40, 1000
        # Repeatable test data, not a secret.
        self.random = Random(seed)  # noqa: S311

    def block(
        self, validity: Validity = _USABLE, values: Mapping[str, float | None] = _CALM, *, beat: bool = True
    ) -> tuple[int, ...]:
        """The next whole block; with `beat` False its heartbeat is the last one's."""
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.heartbeat = self.heartbeat % 0xFFFF + 1 if beat else self.heartbeat
        return build(self.layout, values, validity, self.sequence, self.heartbeat).words

    def bent(self, name: str, value: int, *, sealed: bool = False) -> tuple[int, ...]:
        """The next block with another word in one field; `sealed`: with the checksum that fits it."""
        words = list(self.block())
        words[self.index[name]] = value & 0xFFFF
        if sealed:
            words[self.index["crc"]] = crc(words[: self.index["crc"]])
        return tuple(words)

    def flipped(self) -> tuple[tuple[int, ...], str]:
        """The next block with one bit turned, and the reason by which it is refused."""
        words = list(self.block())
        place = self.random.randrange(len(words))
        words[place] ^= 1 << self.random.randrange(16)
        name = self.layout.fields[place].name
        return tuple(words), {
            "layout_version": "layout version",
            "sequence": "sequence and its copy differ",
            "sequence_copy": "sequence and its copy differ",
        }.get(name, "CRC")


def vectors(layout: WritebackLayout, seed: int = 0, flips: int = FLIPS) -> tuple[SuiteStep, ...]:
    """The steps for a layout; `flips` turned bits are drawn from `seed`.

    Before each block that is to be refused a whole one is accepted, so that the timer has not run out meanwhile,
    however slowly the PLC is asked.
    """
    story, timeout = _Story(layout, seed), layout.timeout
    steps: list[SuiteStep] = []

    def accepted(name: str, words: tuple[int, ...], *, usable: bool = True) -> None:
        steps.append(SuiteStep(name, words, accepted=1, usable=usable))

    def refused(name: str, words: tuple[int, ...], reasons: tuple[str, ...]) -> None:
        steps.append(SuiteStep(f"{name} is refused", words, refused=1, reasons=reasons, usable=True))
        accepted("a whole block is accepted", story.block())

    steps.append(SuiteStep("once the timer has run out nothing is usable", wait_s=1.3 * timeout, permit=True))
    accepted("a whole new block is accepted", story.block())
    # Each of the contract's refusals, one by one.
    torn = ("sequence and its copy differ",)
    version = (layout.version + 1) & 0xFFFF
    refused("another layout version", story.bent("layout_version", version, sealed=True), _VERSION)
    refused("a torn block", story.bent("sequence_copy", 7), torn)
    refused("a changed number", story.bent("validity", 29), _CHECKSUM)
    refused("a wrong checksum", story.bent("crc", 4711), _CHECKSUM)
    refused("the heartbeat of the last block", story.block(beat=False), _STILL)
    part = story.index["crc"] // 2  # in the middle of the block, where none begins
    reasons = ("length or start", *_CHECKSUM, *torn)
    steps.append(SuiteStep("a part of a block is refused", (0x5AA5,), part, refused=1, reasons=reasons, usable=True))
    accepted("a whole block is accepted", story.block())
    # What makes a block that was accepted unusable: its own validity, and the plant's permit.
    for bits in (0, 0b11110, 0b0010):
        name = f"validity {bits:05b} is accepted and nothing of it is usable"
        accepted(name, story.block(Validity(bits)), usable=False)
    accepted("a valid block is usable again", story.block())
    steps.append(SuiteStep("without the permit nothing is usable", permit=False))
    steps.append(SuiteStep("a block without the permit is not usable", story.block(), permit=False, accepted=1))
    steps.append(SuiteStep("with the permit it is", permit=True, usable=True))
    # The timer: only a whole block restarts it.
    accepted("the timer is restarted by a block", story.block())
    steps.append(SuiteStep("the timer still runs after half its time", wait_s=0.5 * timeout, usable=True))
    steps.append(SuiteStep("the timer has run out after 130 % of its time", wait_s=0.8 * timeout))
    accepted("a block brings it back", story.block())
    still = SuiteStep(
        "a heartbeat that stands still is refused",
        story.block(beat=False),
        wait_s=0.5 * timeout,
        refused=1,
        reasons=_STILL,
        usable=True,
    )
    steps.append(still)
    steps.append(SuiteStep("a refused block does not restart the timer", wait_s=0.8 * timeout))
    accepted("the next whole block does", story.block())
    # The ends of what the words can hold, and what a restart of the gateway looks like.
    accepted("numbers that are not known are no fault", story.block(Validity.NONE, {}), usable=False)
    numbers = [name for name in _CALM if name not in ("alarms", "model_hash")]
    accepted("the least numbers are accepted", story.block(values=dict.fromkeys(numbers, -1e9)))
    accepted("the greatest numbers are accepted", story.block(values=dict.fromkeys(numbers, 1e9)))
    # Over the end of both words: the sequence goes on at 0, the heartbeat, which is never 0, at 1.
    story.sequence = story.heartbeat = 0xFFFE
    for name in ("sequence 65535", "sequence 0 after 65535", "sequence 1"):
        accepted(f"{name} is accepted", story.block())
    story.sequence, story.heartbeat = 0, 30_000
    accepted("a gateway that begins anew is accepted", story.block())
    # Turned bits at random: what no list of faults thinks of.
    for number in range(1, flips + 1):
        accepted("a whole block is accepted", story.block())
        words, reason = story.flipped()
        name = f"one turned bit is refused ({number})"
        steps.append(SuiteStep(name, words, refused=1, reasons=(reason,), usable=True))
    accepted("the last whole block is accepted", story.block())
    accepted("a withdrawal is accepted", story.block(Validity.NONE, {}), usable=False)
    return tuple(steps)


def plain(layout: WritebackLayout, steps: Sequence[SuiteStep], codes: Mapping[str, int]) -> dict[str, Any]:
    """The suite as JSON can carry it, so that another program can put a PLC through it."""
    words = zip((field.name for field in layout.fields), (tag.address for tag in layout.words), strict=True)
    return {
        "format": FORMAT,
        "layout_version": layout.version,
        "timeout_s": layout.timeout,
        "words": [{"field": name, "address": address} for name, address in words],
        "refusals": dict(codes),
        "steps": [asdict(step) for step in steps],
    }


def parse(suite: Mapping[str, Any]) -> tuple[SuiteStep, ...]:
    """The steps of a suite that `plain` made and JSON carried. Raises ValueError for another format."""
    if suite.get("format") != FORMAT:
        raise ValueError(f"the suite has format {suite.get('format')!r}, this program reads {FORMAT}")
    return tuple(
        SuiteStep(**{**step, "words": tuple(step["words"]), "reasons": tuple(step["reasons"])})
        for step in suite["steps"]
    )
