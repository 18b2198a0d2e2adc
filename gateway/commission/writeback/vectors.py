"""The conformance suite of the PLC's side as data: what is written to the block's area, and what must become of it.

A step says what is written (a whole block or a part of one), how long to wait before, whether the write is permitted,
and what must follow: blocks accepted and refused since the step before, the reason, whether the prediction is usable.
The steps are one story, to be put through in their order. A PLC that looks at its memory, and does not see the writes
themselves, can pass them all: no step writes what stands in the memory already.

What a block has to carry of the PLC's session is not known beforehand: a step with a `challenge` is sent with the PLC's
own of that moment, XOR this mask, in the field `challenge`, then with the checksum that fits, then with the bits of
`turned` = (word, mask) turned. A step with `again` sends what the step of that name has sent, word by word.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from random import Random
from typing import Any, Literal

from gateway.machine.writing import SessionWords, Validity, build
from gateway.settings import WritebackLayout

FORMAT = 3
BIT_FLIPS = 24
_USABLE = Validity(31)
_VERSION, _CHECKSUM, _STILL = ("layout version",), ("CRC",), ("heartbeat did not change",)
_CHALLENGE, _WRITER, _SEQUENCE = ("another challenge",), ("another writer",), ("sequence not 1 to 100 ahead",)
FIRST_WRITER, SECOND_WRITER = 4711, 815
"""The numbers of the suite's two writers."""
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
    `renews`: the challenge must be another one afterwards, or must not (None: either); `session_writer` and
    `refused_writer` are the numbers that the PLC must give (None: any). `challenge`, `turned` and `again` as above.
    `block` is which of the PLC's blocks it is put to, from 0; what was sent to one may be sent `again` to another.
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
    challenge: int | None = None
    turned: tuple[int, int] | None = None
    again: str = ""
    renews: bool | None = None
    session_writer: int | None = None
    refused_writer: int | None = None
    block: int = 0


class _Story:
    """Blocks whose sequence and heartbeat go on from one to the next."""

    def __init__(self, layout: WritebackLayout, seed: int) -> None:
        self.layout = layout
        self.index = {field.name: place for place, field in enumerate(layout.fields)}
        self.sequence, self.heartbeat = 40, 1000
        # Repeatable test data, not a secret.
        self.random = Random(seed)  # noqa: S311

    def block(
        self,
        validity: Validity = _USABLE,
        values: Mapping[str, float | None] = _CALM,
        *,
        beat: bool = True,
        writer: int = FIRST_WRITER,
        ahead: int = 1,
    ) -> tuple[int, ...]:
        """The block whose sequence is `ahead` of the last one's; with `beat` False its heartbeat is the last one's."""
        self.sequence = (self.sequence + ahead) & 0xFFFF
        self.heartbeat = self.heartbeat % 0xFFFF + 1 if beat else self.heartbeat
        session = SessionWords(challenge=0, writer=writer, sequence=self.sequence, heartbeat=self.heartbeat)
        return build(self.layout, values, validity, session).words

    def flip(self) -> tuple[tuple[int, int], str]:
        """One bit of a block, and the reason by which a block with it turned is refused."""
        place = self.random.randrange(len(self.layout.fields))
        name = self.layout.fields[place].name
        return (place, 1 << self.random.randrange(16)), {
            "layout_version": "layout version",
            "sequence": "sequence and its copy differ",
            "sequence_copy": "sequence and its copy differ",
        }.get(name, "CRC")


def vectors(layout: WritebackLayout, seed: int = 0, flips: int = BIT_FLIPS) -> tuple[SuiteStep, ...]:
    """The steps for a layout; `flips` turned bits are drawn from `seed`.

    Before each block that is to be refused a whole one is accepted, so that the timer has not run out meanwhile,
    however slowly the PLC is asked.
    """
    story, timeout = _Story(layout, seed), layout.timeout
    steps: list[SuiteStep] = []

    def add_acceptance(name: str, words: tuple[int, ...], *, usable: bool = True, **more: Any) -> None:
        steps.append(SuiteStep(name, words, accepted=1, usable=usable, challenge=0, **more))

    def add_refusal(name: str, words: tuple[int, ...], reasons: tuple[str, ...], **more: Any) -> None:
        given = {"challenge": 0, "renews": False, **more}
        steps.append(SuiteStep(f"{name} is refused", words, refused=1, reasons=reasons, usable=True, **given))
        add_acceptance("a whole block is accepted", story.block())

    def add_replay(name: str, again: str, reasons: tuple[str, ...], *, usable: bool = False) -> None:
        steps.append(SuiteStep(name, again=again, refused=1, reasons=reasons, usable=usable, renews=False))

    steps.append(SuiteStep("once the timer has run out nothing is usable", wait_s=1.3 * timeout, permit=True))
    add_acceptance("a whole new block is accepted", story.block(), session_writer=FIRST_WRITER)
    # Each of the contract's refusals, one by one.
    torn = ("sequence and its copy differ",)
    version = list(story.block())
    version[story.index["layout_version"]] += 1
    add_refusal("another layout version", tuple(version), _VERSION)
    add_refusal("a torn block", story.block(), torn, turned=(story.index["sequence_copy"], 7))
    add_refusal("a changed number", story.block(), _CHECKSUM, turned=(story.index["validity"], 2))
    add_refusal("a wrong checksum", story.block(), _CHECKSUM, turned=(story.index["crc"], 4711))
    add_refusal("the heartbeat of the last block", story.block(beat=False), _STILL)
    part = story.index["crc"] // 2  # in the middle of the block, where none begins
    reasons = ("length or start", *_CHECKSUM, *torn)
    steps.append(SuiteStep("a part of a block is refused", (0x5AA5,), part, refused=1, reasons=reasons, usable=True))
    add_acceptance("a whole block is accepted", story.block())
    # The session: its challenge, its writer, its sequence.
    add_refusal("another challenge", story.block(), _CHALLENGE, challenge=0x5A5A)
    add_refusal(
        "another writer",
        story.block(writer=SECOND_WRITER),
        _WRITER,
        session_writer=FIRST_WRITER,
        refused_writer=SECOND_WRITER,
    )
    add_refusal("writer 0", story.block(writer=0), _WRITER, session_writer=FIRST_WRITER, refused_writer=0)
    add_acceptance("a block 100 ahead is accepted", story.block(ahead=100))
    begun = story.sequence
    for name, ahead in (("a block 101 ahead", 101), ("an older sequence", -2), ("the same sequence", 0)):
        story.sequence = begun
        steps.append(
            SuiteStep(
                f"{name} is refused",
                story.block(ahead=ahead),
                refused=1,
                reasons=_SEQUENCE,
                usable=True,
                challenge=0,
                renews=False,
            )
        )
    story.sequence = begun
    add_acceptance("the first block of a recording", story.block())
    add_acceptance("the second block of a recording", story.block())
    add_replay("a recorded block of this session is refused", "the first block of a recording", _SEQUENCE, usable=True)
    # What makes a block that was accepted unusable: its own validity, and the plant's permit.
    for bits in (0b11110, 0b0010):
        name = f"validity {bits:05b} is accepted and nothing of it is usable"
        add_acceptance(name, story.block(Validity(bits)), usable=False, renews=False)
    add_acceptance(
        "validity 00000 ends the session", story.block(Validity.NONE), usable=False, renews=True, session_writer=0
    )
    add_replay("a recorded block does not begin a session", "the second block of a recording", _CHALLENGE)
    steps.append(
        SuiteStep(
            "writer 0 begins no session",
            story.block(writer=0),
            refused=1,
            reasons=_WRITER,
            challenge=0,
            renews=False,
            session_writer=0,
        )
    )
    add_acceptance(
        "another writer may begin the next session", story.block(writer=SECOND_WRITER), session_writer=SECOND_WRITER
    )
    add_acceptance(
        "and end it", story.block(Validity.NONE, writer=SECOND_WRITER), usable=False, renews=True, session_writer=0
    )
    add_acceptance("a valid block is usable again", story.block(), session_writer=FIRST_WRITER)
    steps.append(SuiteStep("without the permit nothing is usable", permit=False, renews=True, session_writer=0))
    unpermitted = story.block()
    steps.append(
        SuiteStep(
            "a block without the permit is refused",
            unpermitted,
            permit=False,
            refused=1,
            reasons=("no permit",),
            challenge=0,
        )
    )
    add_acceptance("with the permit a new block is usable", story.block(), permit=True)
    steps.append(
        SuiteStep(
            "a recorded block after the permit came back is refused",
            again="a valid block is usable again",
            refused=1,
            reasons=(*_CHALLENGE, *_SEQUENCE),
            usable=True,
            renews=False,
        )
    )
    # The timer: only a whole block restarts it.
    add_acceptance("the timer is restarted by a block", story.block())
    steps.append(SuiteStep("the timer still runs after half its time", wait_s=0.5 * timeout, usable=True))
    steps.append(SuiteStep("the timer has run out after 130 % of its time", wait_s=0.8 * timeout, renews=True))
    add_replay("a recorded block after the timer is refused", "with the permit a new block is usable", _CHALLENGE)
    add_acceptance("a block brings it back", story.block())
    still = SuiteStep(
        "a heartbeat that stands still is refused",
        story.block(beat=False),
        wait_s=0.5 * timeout,
        refused=1,
        reasons=_STILL,
        usable=True,
        challenge=0,
    )
    steps.append(still)
    steps.append(SuiteStep("a refused block does not restart the timer", wait_s=0.8 * timeout, renews=True))
    add_acceptance("the next whole block does", story.block())
    # The ends of what the words can hold, and what a restart of the gateway looks like.
    add_acceptance("numbers that are not known are no fault", story.block(Validity.INPUTS, {}), usable=False)
    numbers = [name for name in _CALM if name not in ("alarms", "model_hash")]
    add_acceptance("the least numbers are accepted", story.block(values=dict.fromkeys(numbers, -1e9)))
    add_acceptance("the greatest numbers are accepted", story.block(values=dict.fromkeys(numbers, 1e9)))
    add_acceptance("a gateway that stops takes back", story.block(Validity.NONE), usable=False, renews=True)
    # Over the end of both words: the sequence goes on at 0, the heartbeat, which is never 0, at 1.
    story.sequence = story.heartbeat = 0xFFFE
    for name in ("sequence 65535", "sequence 0 after 65535", "sequence 1"):
        add_acceptance(f"{name} is accepted", story.block())
    story.sequence, story.heartbeat = 0, 30_000
    restarted = story.block(writer=SECOND_WRITER)
    add_refusal("a gateway that begins anew within the session", restarted, _WRITER, refused_writer=SECOND_WRITER)
    add_acceptance("the session is ended", story.block(Validity.NONE), usable=False, renews=True)
    story.sequence = 0
    add_acceptance(
        "a gateway that begins anew is accepted", story.block(writer=FIRST_WRITER), session_writer=FIRST_WRITER
    )
    # Turned bits at random: what no list of faults thinks of.
    for number in range(1, flips + 1):
        add_acceptance("a whole block is accepted", story.block())
        turned, reason = story.flip()
        steps.append(
            SuiteStep(
                f"one turned bit is refused ({number})",
                story.block(),
                refused=1,
                reasons=(reason,),
                usable=True,
                challenge=0,
                turned=turned,
            )
        )
    add_acceptance("the last whole block is accepted", story.block())
    add_acceptance("a withdrawal is accepted", story.block(Validity.NONE, {}), usable=False, renews=True)
    return tuple(steps)


REPLAY_SESSIONS = 3
"""So many sessions of the other block are tried with a recording: a PLC may count its challenges anew for each."""


def joint_steps(layout: WritebackLayout) -> tuple[SuiteStep, ...]:
    """The steps for a PLC's further blocks beside the first: what is sent to one never makes another one usable."""
    steps: list[SuiteStep] = []
    for other in range(1, layout.blocks):
        first, second = _Story(layout, 0), _Story(layout, 0)

        def add_acceptance(name: str, words: tuple[int, ...], block: int, *, usable: bool = True, **more: Any) -> None:
            steps.append(SuiteStep(name, words, accepted=1, usable=usable, challenge=0, block=block, **more))

        def add_replay(name: str, again: str, block: int, *, usable: bool) -> None:
            steps.append(
                SuiteStep(name, again=again, refused=1, reasons=_CHALLENGE, usable=usable, renews=False, block=block)
            )

        which, begins = f"block {other + 1}", f"block 1 beside block {other + 1} is accepted"
        steps.append(SuiteStep(f"before {which} the timers have run out", wait_s=1.3 * layout.timeout, permit=True))
        steps.append(SuiteStep(f"{which} is not usable either", block=other))
        add_acceptance(begins, first.block(), 0)
        add_replay(f"the block of block 1 is refused as {which}", begins, other, usable=False)
        add_acceptance(f"{which} has a session of its own", second.block(), other)
        add_acceptance(f"block 1 goes on beside {which}", first.block(), 0)
        add_replay(f"the block of {which} is refused as block 1", f"{which} has a session of its own", 0, usable=True)
        add_acceptance(f"{which} goes on beside block 1", second.block(), other)
        add_replay(
            f"the newest of block 1 is refused as {which}", f"block 1 goes on beside {which}", other, usable=True
        )
        ending = f"validity 00000 ends the session of block 1 beside {which}"
        add_acceptance(ending, first.block(Validity.NONE), 0, usable=False, renews=True)
        steps.append(SuiteStep(f"{which} stays usable", block=other, usable=True, renews=False))
        for number in range(1, REPLAY_SESSIONS + 1):
            add_acceptance(
                f"session {number} of {which} is ended", second.block(Validity.NONE), other, usable=False, renews=True
            )
            add_replay(
                f"block 1 is refused as {which} after session {number}",
                begins,
                other,
                usable=False,
            )
    return tuple(steps)


def plain(layouts: Sequence[WritebackLayout], codes: Mapping[str, int]) -> dict[str, Any]:
    """The suite of a PLC's blocks as JSON can carry it, so that another program can put a PLC through it.

    `steps` are for each block by itself, `joint_steps` for all of them.
    """
    layout = layouts[0]
    return {
        "format": FORMAT,
        "layout_version": layout.version,
        "timeout_s": layout.timeout,
        "blocks": [
            {
                "temperature": block.temperature,
                "suffix": block.suffix,
                "words": [
                    {"field": field.name, "address": tag.address}
                    for field, tag in zip(block.fields, block.words, strict=True)
                ],
            }
            for block in layouts
        ],
        "refusals": dict(codes),
        "steps": [asdict(step) for step in vectors(layout)],
        "together": [asdict(step) for step in joint_steps(layout)],
    }


def parse(suite: Mapping[str, Any], key: Literal["steps", "together"] = "steps") -> tuple[SuiteStep, ...]:
    """The steps of a suite that `plain` made and JSON carried. Raises ValueError for another format."""
    if suite.get("format") != FORMAT:
        raise ValueError(f"the suite has format {suite.get('format')!r}, this program reads {FORMAT}")
    return tuple(
        SuiteStep(
            **{
                **step,
                "words": tuple(step["words"]),
                "reasons": tuple(step["reasons"]),
                "turned": None if step["turned"] is None else tuple(step["turned"]),
            }
        )
        for step in suite[key]
    )
