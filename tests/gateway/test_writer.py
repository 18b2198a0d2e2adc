"""The writer against a clock that only the test moves: each limit on both of its sides, each sentence, each row."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Any

import pytest

from drivers.driver import BeforeSending, anyhow
from drivers.errors import LinkDown
from drivers.tag import Quality, Sample
from gateway.machine.reading.scan import Scan
from gateway.machine.writing.block import Validity
from gateway.machine.writing.writeback import (
    ANOTHER_CHALLENGE,
    ANOTHER_WRITER,
    Arming,
    Attempt,
    Pace,
    Writer,
    disarm_writers,
)
from gateway.settings.devices import load_device
from gateway.store import DISARMED, EXPIRED, AuditEntry
from gateway.store.audit import EndedElsewhere
from tests.gateway.support import EPOCH, MAP, JumpClock, scan_of

LAYOUT, BEHIND = load_device(MAP.parent / "decanter_plc.toml").writebacks
USABLE = Validity(31)
END = EPOCH + 3600.0
NUMBER = 4711
PLACE = {name: place for place, name in enumerate(field.name for field in LAYOUT.fields)}
COUNTS = ("BlocksAccepted", "BlocksRefused", "LastRefusal", "Challenge", "SessionWriter", "RefusedWriter")
REFUSALS = {3: "CRC", 8: ANOTHER_CHALLENGE, 9: ANOTHER_WRITER}


@dataclass
class Ledger:
    """An audit log that keeps its rows in a list; `slow` (s) passes while it stores one."""

    clock: JumpClock
    failure: str = ""
    complaint: str = ""
    takes: bool = True
    slow: float = 0.0
    rows: list[tuple[str, AuditEntry]] = field(default_factory=list)
    ended_elsewhere: dict[str, EndedElsewhere] = field(default_factory=dict)

    def subject_complaint(self, subject: str) -> str:
        return self.complaint

    async def stored(self, entry: AuditEntry, timeout: float) -> bool:
        self.clock.time += self.slow
        self.rows.append((f"stored in {timeout:g} s", entry))
        return self.takes

    async def keep(self, entry: AuditEntry, timeout: float) -> None:
        self.rows.append((f"kept in {timeout:g} s", entry))

    def put(self, entry: AuditEntry) -> None:
        self.rows.append(("put", entry))


@dataclass
class Line:
    """A device that takes what it is sent; `meanwhile` happens right before that."""

    meanwhile: Callable[[], None] = anyhow
    afterwards: Callable[[], None] = anyhow
    blocks: list[list[int]] = field(default_factory=list)

    async def write(self, values: list[tuple[object, int]], *, before_sending: BeforeSending = anyhow) -> None:
        self.meanwhile()
        before_sending()
        self.blocks.append([value for _, value in values])
        self.afterwards()


class Desk:
    """A writer that is armed until END, its clock, line and ledger."""

    def __init__(self, *, speed: float = 1.0, **more: Any) -> None:
        self.clock, self.line = JumpClock(speed=speed), Line()
        self.ledger = Ledger(self.clock)
        arming = Arming("Ada", "test", END)
        given = {"layout": LAYOUT, "audit": self.ledger, **more}
        self.writer = Writer(clock=self.clock, mode="armed", number=NUMBER, driver=self.line, arming=arming, **given)

    def scan(self, *, ago: float = 0.0, duration: float = 0.0, permit_ago: float | None = None, **values: Any) -> Scan:
        """What was read `ago` s before now, the permit `permit_ago`."""
        now = self.clock.now()
        found = scan_of({"WritePermit": True, "Challenge": 77, **values}, now - ago)
        at = now - (ago if permit_ago is None else permit_ago)
        samples = {
            **found.samples,
            "WritePermit": Sample("WritePermit", values.get("WritePermit", True), Quality.GOOD, at),
        }
        return Scan(0, now - ago, samples, 0, duration)

    async def offer(self, scan: Scan | None = None, **values: float | None) -> tuple[str, str]:
        """Verdict and reason of one block."""
        scan = scan or self.scan()
        attempt = await self.writer.offer(scan, values, USABLE)
        assert attempt is not None
        assert (attempt.verdict == "written") == bool(attempt.latency_ms is not None)
        assert attempt.time == scan.time and len(attempt.block.words) == len(LAYOUT.words)
        return attempt.verdict, attempt.reason

    def kinds(self) -> list[str]:
        return [entry.kind for _, entry in self.ledger.rows]


# ---------------------------------------------------------------- what keeps a block from being sent


@pytest.mark.parametrize("speed", [1.0, 8.0])
@pytest.mark.parametrize(("late", "reason"), [(0.0, ""), (0.5, "its readings are 1.50 s old, which may be 1 s")])
async def test_readings_are_as_old_as_the_first_request_for_them(speed: float, late: float, reason: str) -> None:
    # 0.75 s ago the last reply came, 0.25 s before that the first request was made: 1 s is not yet too much.
    desk = Desk(speed=speed)
    scan = desk.scan(ago=0.75 * speed, duration=(0.25 + late) * speed, permit_ago=0.0)
    assert await desk.offer(scan) == (("held back", reason) if reason else ("written", ""))
    assert len(desk.line.blocks) == (not reason)


@pytest.mark.parametrize("speed", [1.0, 8.0])
@pytest.mark.parametrize(("ago", "reason"), [(1.0, ""), (1.25, "WritePermit was read 1.25 s ago, which may be 1 s")])
async def test_a_permit_is_as_old_as_when_it_was_read(speed: float, ago: float, reason: str) -> None:
    desk = Desk(speed=speed)
    assert await desk.offer(desk.scan(permit_ago=ago * speed)) == (("held back", reason) if reason else ("written", ""))


@pytest.mark.parametrize("speed", [1.0, 8.0])
@pytest.mark.parametrize(("wait", "reason"), [(0.25, ""), (0.5, "it waited 0.50 s to be sent, which may be 0.25 s")])
async def test_what_passes_on_the_way_to_the_wire_is_waiting(speed: float, wait: float, reason: str) -> None:
    for place in ("ledger", "line"):
        desk = Desk(speed=speed, max_age=9.0)
        if place == "ledger":
            desk.ledger.slow = wait * speed
        else:
            desk.line.meanwhile = lambda d=desk: setattr(d.clock, "time", d.clock.time + wait * speed)
        assert await desk.offer() == (("held back", reason) if reason else ("written", ""))
        assert desk.kinds() == (["write", "write refused"] if reason else ["write"])
        assert len(desk.line.blocks) == (not reason)


@pytest.mark.parametrize(("before_end", "verdict"), [(0.125, "written"), (0.0, "not permitted"), (-1, "not permitted")])
async def test_an_arming_is_over_at_its_end(before_end: float, verdict: str) -> None:
    desk = Desk()
    desk.clock.time = END - before_end
    assert await desk.offer() == (verdict, "" if verdict == "written" else "the arming is over")
    assert desk.writer.expired(END) and not desk.writer.expired(END - 0.125)
    on_the_way = Desk()
    on_the_way.clock.time = END - 0.125
    on_the_way.line.meanwhile = lambda: setattr(on_the_way.clock, "time", END - before_end)
    assert (await on_the_way.offer())[0] == verdict and len(on_the_way.line.blocks) == (verdict == "written")


@pytest.mark.parametrize("place", ["ledger", "line"])
async def test_what_was_disarmed_on_the_way_is_not_sent_though_it_is_armed_again(place: str) -> None:
    desk = Desk()

    def disarm_and_arm() -> None:
        desk.writer.generation += 1

    if place == "line":
        desk.line.meanwhile = disarm_and_arm
    else:
        desk.ledger.stored = lambda entry, timeout: _after(disarm_and_arm)  # type: ignore[method-assign]
    assert await desk.offer() == ("not permitted", "it was disarmed meanwhile")
    assert desk.line.blocks == [] and desk.kinds()[-1] == "write refused"


async def _after(what: Callable[[], None]) -> bool:
    what()
    return True


@pytest.mark.parametrize(("row", "verdict"), [(6, "written"), (7, "written"), (8, "not permitted")])
async def test_only_an_end_behind_the_armings_own_row_ends_it(row: int, verdict: str) -> None:
    desk = Desk(subject="two")
    assert desk.writer.foreign_end == ""
    desk.ledger.ended_elsewhere = {"": EndedElsewhere(9, "Bea", "enough")}
    assert desk.writer.foreign_end == "", "another block's"
    desk.writer.mode = "shadow"
    desk.writer.arm(desk.line, Arming("Ada", "test", END), 7)
    assert desk.writer.armed
    desk.ledger.ended_elsewhere = {"two": EndedElsewhere(row, "Bea", "enough")}
    said = f"Bea took the arming back in the audit log (row {row}): enough" if verdict == "not permitted" else ""
    assert await desk.offer() == (verdict, said) and desk.writer.foreign_end == said
    assert Writer(LAYOUT, desk.clock, "shadow", 1).foreign_end == ""


async def test_without_an_account_nothing_is_sent() -> None:
    desk = Desk()
    desk.ledger.complaint = "a row is lost"
    assert await desk.offer() == ("not permitted", "no audit record could be kept: a row is lost")
    assert desk.kinds() == ["write refused"]
    desk = Desk()
    desk.ledger.takes = False
    assert await desk.offer() == ("held back", "the audit log has not taken its row within 0.25 s")
    desk.ledger.failure = "the disk is full"
    assert await desk.offer() == ("not permitted", "no audit record could be kept: the disk is full")
    assert desk.line.blocks == [] and desk.writer.sequence == 0
    assert [place for place, _ in desk.ledger.rows] == ["stored in 0.25 s", "put"] * 2


async def test_what_takes_everything_back_is_sent_late_fast_disarmed_and_with_a_full_disk_but_with_a_permit() -> None:
    desk = Desk(pace=Pace(1.0))
    desk.ledger.takes, desk.ledger.slow = False, 5.0
    desk.ledger.failure = desk.ledger.complaint = "the disk is full"
    desk.clock.time = END + 50.0
    desk.writer.pace.allows(desk.clock.time)  # type: ignore[union-attr]
    attempt = await desk.writer.withdraw(desk.scan(ago=20.0, duration=9.0), alarms=5)
    assert attempt is not None and attempt.verdict == "written" and attempt.block.validity is Validity.NONE
    block = desk.line.blocks[0]
    assert (block[PLACE["alarms"]], block[PLACE["zone"]], block[PLACE["input_quality"]]) == (5, 0, 2)
    assert [(place, entry.kind) for place, entry in desk.ledger.rows] == [
        ("stored in 0.25 s", "write"),
        ("put", "write"),
    ]
    refused = await desk.writer.withdraw(desk.scan(WritePermit=False))
    assert refused is not None and (refused.verdict, refused.reason) == ("not permitted", "the PLC does not permit it")
    assert len(desk.line.blocks) == 1


async def test_a_block_that_may_not_be_sent_takes_no_part_of_the_pace_and_no_number() -> None:
    desk = Desk(speed=4.0, pace=Pace(2.0), max_age=9.0)
    for _ in range(5):
        assert (await desk.offer(desk.scan(WritePermit=False)))[0] == "not permitted"
    assert desk.writer.sequence == desk.writer.heartbeat == 0
    assert [(await desk.offer())[0] for _ in range(2)] == ["written"] * 2
    assert await desk.offer() == ("held back", "more than 2 blocks a second")
    assert (desk.writer.sequence, desk.writer.heartbeat) == (2, 2)
    desk.clock.time += 2.0  # half a second of real time: one more
    assert [(await desk.offer())[0] for _ in range(2)] == ["written", "held back"]
    assert [block[1] for block in desk.line.blocks] == [1, 2, 3]
    assert desk.writer.counters.written == 3 and desk.writer.counters.held_back == 2


def test_a_pace_is_a_bucket_that_begins_full_and_holds_no_more() -> None:
    for rate, full in [(0.25, 1), (1.0, 1), (2.0, 2), (4.0, 4)]:
        pace = Pace(rate)
        assert [pace.allows(100.0) for _ in range(full + 1)] == [True] * full + [False]
        # What it is asked in vain takes nothing: a token is there again after 1 / rate, and not before.
        assert not pace.allows(100.0 + 0.5 / rate) and not pace.allows(100.0 + 0.875 / rate)
        assert pace.allows(100.0 + 1.0 / rate) and not pace.allows(100.0 + 1.0 / rate)
        assert [pace.allows(9000.0) for _ in range(full + 1)] == [True] * full + [False], "full, and no more than that"


# ---------------------------------------------------------------- the PLC's permit


@pytest.mark.parametrize(
    ("samples", "reason"),
    [
        ({}, "the register map has no WritePermit"),
        ({"WritePermit": (False, Quality.GOOD, "")}, "the PLC does not permit it"),
        ({"WritePermit": (True, Quality.LAST_USABLE, "old")}, "WritePermit is not known: old"),
        ({"WritePermit": (True, Quality.UNCERTAIN, "odd")}, "WritePermit is not known: odd"),
        ({"WritePermit": (True, Quality.GOOD, "")}, "the register map has no Challenge, which the PLC's side has to"),
        (
            {"WritePermit": (True, Quality.GOOD, ""), "Challenge": (0, Quality.GOOD, "")},
            "the PLC publishes no challenge yet (0)",
        ),
        (
            {"WritePermit": (True, Quality.GOOD, ""), "Challenge": (7, Quality.TIMEOUT, "silent")},
            "Challenge is not known: silent",
        ),
        ({"WritePermit": (True, Quality.GOOD, ""), "Challenge": (65536, Quality.GOOD, "")}, "no challenge yet"),
        ({"WritePermit": (True, Quality.GOOD, ""), "Challenge": (-1, Quality.GOOD, "")}, "no challenge yet"),
        ({"WritePermit": (True, Quality.GOOD, ""), "Challenge": (65535, Quality.GOOD, "")}, ""),
        ({"WritePermit": (1, Quality.GOOD, ""), "Challenge": (1, Quality.GOOD, "")}, ""),
    ],
)
async def test_a_block_needs_a_permit_and_a_challenge_that_are_good(
    samples: Mapping[str, tuple[Any, Quality, str]], reason: str
) -> None:
    desk = Desk()
    read = {name: Sample(name, v, q, EPOCH, reason=why) for name, (v, q, why) in samples.items()}
    verdict, said = await desk.offer(Scan(0, EPOCH, read, 0, 0.0))
    assert (verdict, bool(desk.line.blocks)) == (("not permitted", False) if reason else ("written", True))
    assert reason in said and bool(reason) == bool(said)
    challenge = samples.get("Challenge", (0,))[0]
    assert desk.writer.challenge == (0 if reason else challenge)
    assert reason or desk.line.blocks[0][PLACE["challenge"]] == challenge


async def test_the_second_block_asks_for_its_own_challenge_and_says_which_it_is() -> None:
    desk = Desk(layout=BEHIND, subject="two")
    name = f"Challenge{BEHIND.suffix}"
    assert await desk.offer() == (
        "not permitted",
        f"the register map has no {name}, which the PLC's side has to publish",
    )
    assert (await desk.offer(desk.scan(**{name: 5})))[0] == "written"
    details = [entry.detail for _, entry in desk.ledger.rows]
    assert [detail["block"] for detail in details] == [BEHIND.suffix] * 2
    assert [entry.subject for _, entry in desk.ledger.rows] == ["two"] * 2


# ---------------------------------------------------------------- what is sent, and what is kept of it


async def test_a_block_holds_the_session_and_its_age_counts_on_until_it_is_made() -> None:
    desk = Desk(speed=4.0)
    scan = desk.scan(ago=2.0)
    desk.line.afterwards = lambda: setattr(desk.clock, "time", desk.clock.time + 1.0)
    attempt = await desk.writer.offer(scan, {"age": 1.0, "temperature_now": None}, USABLE)
    assert attempt is not None
    (block,) = desk.line.blocks
    assert attempt == Attempt(scan.time, attempt.block, "armed", "written", 750.0)
    assert list(attempt.block.words) == block
    named = {name: block[place] for name, place in PLACE.items()}
    assert (named["age"], named["temperature_now"], named["validity"]) == (30, 0x8000, 31)
    assert (named["writer"], named["challenge"], named["sequence"], named["heartbeat"]) == (NUMBER, 77, 1, 1)
    ((_, entry),) = desk.ledger.rows
    assert (entry.time, entry.kind, entry.who, entry.reason) == (scan.time, "write", "Ada", "")
    assert entry.detail == {"sequence": 1, "validity": 31, "words": "".join(f"{word:04x}" for word in block)}
    # A clock that was set back makes no reading younger.
    await desk.writer.offer(Scan(0, desk.clock.now() + 5.0, desk.scan().samples, 0, 0.0), {"age": 1.0}, USABLE)
    assert desk.line.blocks[1][PLACE["age"]] == 10


async def test_a_failed_block_keeps_its_number_and_is_on_record_twice() -> None:
    desk = Desk()

    def lost() -> None:
        raise LinkDown("the cable is out")

    desk.line.meanwhile = lost
    assert await desk.offer() == ("failed", "the cable is out")
    desk.line.meanwhile, desk.line.afterwards = anyhow, lost
    assert await desk.offer() == ("failed", "the cable is out")
    desk.line.afterwards = anyhow
    assert (await desk.offer())[0] == "written"
    assert [block[1:3] for block in desk.line.blocks] == [[2, 2], [3, 3]]
    assert desk.kinds() == ["write", "write failed"] * 2 + ["write"]
    assert {entry.who for _, entry in desk.ledger.rows} == {"Ada"}
    assert desk.ledger.rows[1][1].reason == "the cable is out"
    assert desk.ledger.rows[1][1].detail == desk.ledger.rows[0][1].detail


async def test_in_shadow_the_numbers_move_on_and_nothing_is_on_record() -> None:
    desk = Desk()
    for mode, driver, arming in [("shadow", None, None), ("armed", None, Arming("A", "r", END)), ("armed", 1, None)]:
        desk.writer.mode, desk.writer.arming = mode, arming
        desk.writer.driver = desk.line if driver else None
        attempt = await desk.writer.offer(desk.scan(WritePermit=False), {}, USABLE)
        assert attempt is not None and (attempt.verdict, attempt.mode) == ("shadow", mode)
        assert attempt.block.validity == USABLE | Validity.SHADOW
        assert not desk.writer.armed and not desk.writer.expired(END)
        assert await desk.writer.withdraw(desk.scan()) is None
    assert desk.line.blocks == [] == desk.ledger.rows
    assert desk.writer.sequence == desk.writer.heartbeat == desk.writer.counters.shadow == 3


# ---------------------------------------------------------------- what the PLC says


def counted(desk: Desk, *said: Any) -> str:
    return desk.writer.take_counts(desk.scan(**dict(zip(COUNTS, said, strict=False))), REFUSALS)


@pytest.mark.parametrize(
    ("before", "now", "more"),
    [
        (0, 0, 0),
        (5, 9, 4),
        (0xF001, 0x0FFF, 0x1FFE),
        (0xF000, 0x0FFF, 0x0FFF),
        (0xF001, 0x1000, 0x1000),
        (0xFFFF, 0, 1),
        (9, 8, 8),
        (0xFFFF, 0xFFFE, 0xFFFE),
    ],
)
def test_a_counter_wraps_only_near_its_end(before: int, now: int, more: int) -> None:
    desk = Desk()
    counted(desk, before, before, 0)
    assert (desk.writer.counters.accepted, desk.writer.counters.refused) == (0, 0), "counted for a gateway before"
    counted(desk, now, now, 0)
    assert (desk.writer.counters.accepted, desk.writer.counters.refused) == (more, more)
    counted(desk, now, now, 0)
    assert (desk.writer.counters.accepted, desk.writer.counters.refused) == (more, more)


def test_half_an_account_is_none() -> None:
    for said in ((9, None, 3), (None, 9, 3)):
        desk = Desk()
        counted(desk, 0, 0, 0)
        assert counted(desk, *said) == "" and desk.writer.counters.plc_refused == 0 == desk.writer.counters.plc_accepted


def test_a_refusal_is_said_once_and_put_on_record_where_blocks_are_written() -> None:
    desk = Desk(subject="two", layout=LAYOUT)
    desk.writer.sequence = 12
    assert counted(desk, 0, 0, 3) == "" == counted(desk, 3, 0, 3)
    assert counted(desk, 3, 2, 3) == "CRC"
    assert counted(desk, 4, 2, 5) == "" and desk.writer.counters.last_refusal == "CRC"
    assert counted(desk, 4, 3, 5) == "code 5" == desk.writer.counters.last_refusal
    assert counted(desk, 4, 4, None) == "code 5", "not known anew"
    first, *others = [entry for _, entry in desk.ledger.rows]
    assert (first.time, first.kind, first.who, first.reason) == (EPOCH, "refused by the PLC", "PLC", "CRC")
    assert first.detail == {"blocks": 2, "sequence": 12, "subject": "two"} and len(others) == 2
    desk.writer.mode = "shadow"
    assert counted(desk, 4, 5, 3) == "CRC" and len(desk.ledger.rows) == 3
    desk.writer.mode, desk.writer.audit = "armed", None
    assert counted(desk, 4, 6, 3) == "CRC"


@pytest.mark.parametrize(
    ("sent", "read", "sentence"),
    [(5, 6, ""), (5, 5, ANOTHER_CHALLENGE), (0, 6, ANOTHER_CHALLENGE), (5, 0, ""), (5, None, "")],
)
def test_a_session_that_ended_on_the_way_is_no_refusal(sent: int, read: int | None, sentence: str) -> None:
    desk = Desk()
    counted(desk, 0, 0, 0, 5)
    desk.writer.challenge = sent
    assert counted(desk, 0, 1, 8, read) == sentence
    assert desk.writer.counters.sessions_ended == (not sentence) and desk.writer.counters.refused == 1
    assert len(desk.ledger.rows) == bool(sentence)
    assert counted(desk, 0, 1, 8, read) == "" and desk.writer.counters.sessions_ended == (not sentence)
    assert counted(desk, 0, 2, 3, read) == "CRC", "another reason"


@pytest.mark.parametrize("speed", [1.0, 4.0])
@pytest.mark.parametrize(
    ("session", "refused", "who", "role"),
    [
        (NUMBER, 8, "8", "was refused"),
        (8, NUMBER, "8", "has the session"),
        (8, None, "8", "has the session"),
        (NUMBER, None, "unknown", "was refused"),
        (None, NUMBER, "unknown", "has the session"),
    ],
)
def test_of_two_writers_the_other_is_named(
    speed: float, session: int | None, refused: int | None, who: str, role: str
) -> None:
    desk = Desk(speed=speed)
    counted(desk, 0, 0, 0)
    said = counted(desk, 0, 1, 9, 5, session, refused)
    assert said == (
        f"another writer: number {who} {role} at the PLC, this gateway is number {NUMBER}; find the gateway whose "
        "status has that number, and disarm one of the two"
    )
    assert desk.writer.counters.other_writer == (8 if who == "8" else None)
    assert desk.ledger.rows[0][1].reason == said
    now = desk.clock.now()
    assert desk.writer.rival(now + 10.0 * speed) == said and desk.writer.rival(now + 10.25 * speed) == ""
    assert counted(desk, 0, 1, 9, 5, 9, NUMBER) == "", "the count has not moved"
    assert desk.writer.counters.other_writer == (8 if who == "8" else None)
    desk.writer.mode = "shadow"
    assert desk.writer.rival(now) == ""


def test_a_start_before_may_have_the_session_for_ten_seconds() -> None:
    for after, former in product((10.0, 10.25), (8, 9)):
        desk = Desk(speed=4.0, formers=frozenset({former}))
        assert desk.writer.rival(EPOCH) == ""
        counted(desk, 0, 0, 0)
        desk.clock.time = EPOCH + 4.0 * after
        said = counted(desk, 0, 1, 9, 5, 8, NUMBER)
        ours = former == 8 and after == 10.0
        end = "; it is this gateway's start before, whose session the PLC's timer ends"
        assert said.endswith(end) == ours and bool(desk.writer.rival(desk.clock.now())) == (not ours)
        assert desk.writer.counters.other_writer == 8


# ---------------------------------------------------------------- disarming


@pytest.mark.parametrize(
    ("armed", "by", "late", "kind", "who", "why"),
    [
        (True, "Bea", 0.0, DISARMED, "Bea", "enough"),
        (True, "Bea", 5.0, DISARMED, "Bea", "enough"),
        (True, "", -1.0, DISARMED, "Ada", "enough"),
        (True, "", 0.0, EXPIRED, "Ada", "enough"),
        (False, "Bea", 0.0, DISARMED, "Bea", "enough"),
        (False, "", 0.0, "", "", ""),
    ],
)
async def test_of_a_disarming_there_is_one_row(
    armed: bool, by: str, late: float, kind: str, who: str, why: str
) -> None:
    desk, other = Desk(subject="two"), Desk(subject="two", layout=BEHIND)
    if not armed:
        desk.writer.mode = other.writer.mode = "off"
        desk.writer.arming = other.writer.arming = None
    generations = []
    desk.line.meanwhile = lambda: generations.append((desk.writer.generation, other.writer.generation))
    attempts = await disarm_writers(
        [desk.writer, other.writer],
        END + late,
        by,
        "enough",
        alarms=[3, 4],
        audit=desk.ledger,
        scan=desk.scan(**{f"Challenge{BEHIND.suffix}": 5}),
        stamp=7.0 if late else None,
        process={"pid": 1},
    )
    assert [None if each is None else each.verdict for each in attempts] == ["written" if armed else None] * 2
    assert [line[PLACE["alarms"]] for each in (desk, other) for line in each.line.blocks] == ([3, 4] if armed else [])
    assert generations == ([(1, 1)] if armed else []), "before anything else"
    for writer in (desk.writer, other.writer):
        assert (writer.mode, writer.arming) == ("shadow" if armed else "off", None)
        assert (writer.generation, writer.ending) == (1, 0)
    words = [(place, entry) for place, entry in desk.ledger.rows if place == "kept in 2 s"]
    assert [(entry.kind, entry.who, entry.reason, entry.time) for _, entry in words] == (
        [(kind, who, why, END + late)] if kind else []
    )
    for _, entry in words:
        assert entry.detail == {"pid": 1, "subject": "two", **({"stamp": 7.0} if late else {})}


async def test_one_writer_alone_is_disarmed_the_same_way() -> None:
    desk = Desk()
    assert await desk.writer.disarm(EPOCH) is None and desk.line.blocks == []
    assert [(entry.kind, entry.who, entry.reason) for _, entry in desk.ledger.rows] == [
        (DISARMED, "Ada", "the arming is over")
    ]
    desk = Desk()
    attempt = await desk.writer.disarm(EPOCH, "Bea", "enough", scan=desk.scan(), alarms=6, stamp=2.0)
    assert attempt is not None and attempt.block.words[PLACE["alarms"]] == 6
    assert desk.ledger.rows[-1][1].detail == {"stamp": 2.0} and desk.kinds() == ["write", DISARMED]


async def test_it_is_being_disarmed_until_the_word_is_on_record() -> None:
    desk = Desk()

    async def broken(entry: AuditEntry, timeout: float) -> None:
        assert desk.writer.ending == 1
        raise OSError("gone")

    desk.ledger.keep = broken  # type: ignore[method-assign]
    with pytest.raises(OSError, match="gone"):
        await desk.writer.disarm(EPOCH, "Bea", "enough")
    assert desk.writer.ending == 0 and not desk.writer.armed


def test_a_layout_of_the_example_has_the_fields_in_this_order() -> None:
    assert [PLACE[name] for name in ("layout_version", "sequence", "heartbeat", "validity")] == [0, 1, 2, 3]
    assert all(a < b for a, b in pairwise(PLACE.values()))
