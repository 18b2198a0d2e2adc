"""The PLC's side of the write-back contract: whether a block is whole and new, and its prediction usable.

An implementation of its own, as the PLC's program would have: it shares nothing with the gateway's side. The PLC
copies a block that it accepts; a refused one changes nothing but the counters, and the timer covers the rest.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from drivers.tag import Value
from sim.plc.program.registers import BlockLayout, RegisterMap

ACCEPTED_REASON = "none"
LAYOUT = "layout version"
TORN = "sequence and its copy differ"
CHECKSUM = "CRC"
STILL = "heartbeat did not change"
LENGTH = "length or start"
CHALLENGE = "another challenge"
WRITER = "another writer"
SEQUENCE = "sequence not 1 to 100 ahead"
NO_PERMIT = "no permit"
REFUSALS = {
    ACCEPTED_REASON: 0,
    LAYOUT: 1,
    TORN: 2,
    CHECKSUM: 3,
    STILL: 4,
    LENGTH: 5,
    CHALLENGE: 6,
    WRITER: 7,
    SEQUENCE: 8,
    NO_PERMIT: 9,
}
PERMIT = "WritePermit"
STATUS_TAGS = (
    "AcknowledgeBits",
    "BlocksAccepted",
    "BlocksRefused",
    "LastRefusal",
    "PredictionUsable",
    "Challenge",
    "SessionWriter",
    "RefusedWriter",
)
"""The names of a block's own tags; those of a further block end in its suffix. The permit is common to all."""
_ALL_USABLE = 1  # bit 0 of the validity word
_PARTS = {2: "its inputs are not good", 4: "it does not know the location", 8: "no fresh forecast", 16: "no model"}
"""What lacks where another bit of the validity word is not set."""
_PREDICTED_OVER_LIMIT = 2  # bit 1 of the alarm word
_MAX_SEQUENCE_STEP = 100  # so many blocks may be lost within a session


@dataclass(frozen=True, slots=True)
class WriterSession:
    """Whose blocks count, and the sequence of the last one."""

    writer: int
    sequence: int


@dataclass(frozen=True, slots=True)
class Intake:
    """What the PLC has made of the blocks so far; `accepted_at` is monotonic, `block` the last accepted one.

    `challenge` (1..65535) is another number after each session, which only the blocks made since then can carry;
    `session` is None between two, `permitted` the permit as the program saw it last. It is intake `number` (from 0) of
    `count` in this PLC.
    """

    challenge: int = 1
    number: int = 0
    count: int = 1
    permitted: bool = False
    session: WriterSession | None = None
    refused_writer: int = 0

    accepted: int = 0
    refused: int = 0
    last_refusal: str = ACCEPTED_REASON
    accepted_at: float | None = None
    block: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


def crc16(words: Sequence[int]) -> int:
    """CRC-16/IBM-3740 (polynomial 0x1021, start 0xFFFF, not reflected) over words, high byte first, bit by bit."""
    register = 0xFFFF
    for octet in struct.pack(f">{len(words)}H", *words):
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    return register


def decode_block(layout: BlockLayout, words: Sequence[int]) -> dict[str, float]:
    """The block's fields in engineering units."""
    return {
        field.name: (word - 0x10000 if field.signed and word & 0x8000 else word) * field.scale
        for field, word in zip(layout.fields, words, strict=True)
    }


def begin_intake(layout: BlockLayout | None, counter: int, *, permit: bool) -> Intake:
    """The state at the start of the program, whose retained counter of challenges stands at `counter` (1..65535)."""
    number, count = (0, 1) if layout is None else (layout.number, layout.count)
    return Intake(_challenge(counter - 1, number, count), number, count, permitted=permit)


def _challenge(turn: int, number: int, count: int) -> int:
    """The challenge of a block's session `turn` (from 0): of `count` blocks each has every count-th number for itself.

    So no two blocks of a PLC ever give the same challenge, and what was made for one is never new to another.
    """
    return turn % (0xFFFF // count) * count + number + 1


def end_session(intake: Intake) -> Intake:
    """The state after the end of a session: the next challenge, so that nothing made before counts any more."""
    turn = (intake.challenge - 1) // intake.count + 1
    return replace(intake, session=None, challenge=_challenge(turn, intake.number, intake.count))


def follow_time(layout: BlockLayout, intake: Intake, now: float, *, permit: bool) -> Intake:
    """The state at the monotonic moment `now`: a session ends with its timer and with the permit."""
    late = intake.session is not None and intake.accepted_at is not None and _late(layout, intake.accepted_at, now)
    if late or permit != intake.permitted:
        return end_session(replace(intake, permitted=permit))
    return intake


def _late(layout: BlockLayout, accepted_at: float, now: float) -> bool:
    return now - accepted_at > layout.timeout_s


def verdict(layout: BlockLayout, intake: Intake, address: int, words: Sequence[int]) -> str:
    """What is wrong with a write into the block's area, or ACCEPTED_REASON."""
    # What is checked first is what the later checks rely on: the fields' places, then their meaning, then the values.
    if address != layout.place.address or len(words) != layout.place.words:
        return LENGTH
    raw = {field.name: word for field, word in zip(layout.fields, words, strict=True)}
    if raw["layout_version"] != layout.version:
        return LAYOUT
    if raw["sequence"] != raw["sequence_copy"]:
        return TORN
    if raw["crc"] != crc16(words[: layout.index("crc")]):
        return CHECKSUM
    if not intake.permitted:
        return NO_PERMIT
    if raw["challenge"] != intake.challenge:
        return CHALLENGE
    session = intake.session
    if raw["writer"] == 0 or (session is not None and raw["writer"] != session.writer):
        return WRITER
    if session is not None and not 1 <= (raw["sequence"] - session.sequence) & 0xFFFF <= _MAX_SEQUENCE_STEP:
        return SEQUENCE
    if session is not None and raw["heartbeat"] == intake.block["heartbeat"]:
        return STILL
    return ACCEPTED_REASON


def take_write(layout: BlockLayout, intake: Intake, address: int, words: Sequence[int], now: float) -> Intake:
    """The state after a write of `words` into the block's area at the monotonic moment `now` (see `follow_time`)."""
    reason = verdict(layout, intake, address, words)
    if reason != ACCEPTED_REASON:
        other = words[layout.index("writer")] if reason == WRITER else intake.refused_writer
        return replace(intake, refused=intake.refused + 1, last_refusal=reason, refused_writer=other)
    block = MappingProxyType(decode_block(layout, words))
    session = WriterSession(words[layout.index("writer")], words[layout.index("sequence")])
    after = replace(intake, accepted=intake.accepted + 1, accepted_at=now, block=block, session=session)
    # A block of validity 0 takes everything back: its session is over.
    return after if words[layout.index("validity")] else end_session(after)


def unusable(layout: BlockLayout, intake: Intake, now: float, permit: bool) -> str:
    """Why the program keeps to its own logic, for whoever looks at the PLC; "" while the prediction may be used."""
    if not permit:
        return "no write permit is given"
    if intake.accepted_at is None:
        return "no block has been accepted yet"
    if _late(layout, intake.accepted_at, now):
        return f"no block has been accepted for {now - intake.accepted_at:.1f} s"
    validity = int(intake.block["validity"])
    if validity == 0:
        return "the gateway has taken its prediction back"
    if intake.session is None:
        return "no session is open"
    if validity & _ALL_USABLE:
        return ""
    lacking = [what for bit, what in _PARTS.items() if not validity & bit]
    return f"the gateway says: {', '.join(lacking) or 'its model does not fit what it reads (zone red)'}"


def usable(layout: BlockLayout, intake: Intake, now: float, permit: bool) -> bool:
    """The PLC's verdict: writes permitted, a session open, its newest block "all usable", and the timer still runs."""
    return not unusable(layout, intake, now, permit)


def block_name(layout: BlockLayout | None) -> dict[str, str]:
    """Which block an event is of; one of the first says nothing of it."""
    return {"block": layout.suffix} if layout is not None and layout.suffix else {}


def predicts_limit(intake: Intake) -> bool:
    """True if the newest accepted block says that the limit will be reached."""
    return bool(int(intake.block["alarms"]) & _PREDICTED_OVER_LIMIT) if intake.block else False


def status(
    registers: RegisterMap,
    intake: Intake,
    now: float,
    *,
    permit: bool,
    acknowledged: int,
    layout: BlockLayout | None = None,
) -> dict[str, Value | None]:
    """The PLC-to-gateway tags of one block (by default the first) that the map has.

    Counters are words and wrap; a refusal's code is its label's.
    """
    layout = layout or registers.block
    values: dict[str, Value | None] = {
        "AcknowledgeBits": acknowledged,
        "BlocksAccepted": intake.accepted & 0xFFFF,
        "BlocksRefused": intake.refused & 0xFFFF,
        "LastRefusal": refusal_code(registers, intake.last_refusal),
        "Challenge": intake.challenge,
        "SessionWriter": 0 if intake.session is None else intake.session.writer,
        "RefusedWriter": intake.refused_writer,
        "PredictionUsable": layout is not None and usable(layout, intake, now, permit),
    }
    own = {f"{name}{layout.suffix if layout else ''}": value for name, value in values.items()}
    return {name: value for name, value in {PERMIT: permit, **own}.items() if name in registers.tags}


def refusal_code(registers: RegisterMap, reason: str) -> int:
    """The number that the map's LastRefusal labels give to a reason; the contract's own where it has no label."""
    tag = registers.tags.get("LastRefusal")
    labels = {label: code for code, label in tag.labels.items()} if tag else {}
    return labels.get(reason, REFUSALS[reason])
