"""A command that writes blocks: each is looked at anew (armed? permitted?) and is on record before it is sent."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.device_file import STATUS_TAGS
from drivers.driver import BeforeSending, anyhow
from drivers.errors import DriverError, LinkDown, WriteForbidden, WriteUnverified
from drivers.tag import Quality, Sample, Tag
from gateway.commission.writeback import block_writer as room
from gateway.commission.writeback.block_writer import BlockWriter, arming_in_force, gateway_runs
from gateway.commission.writeback.suite import Unable
from gateway.console import CommandResult
from gateway.machine.writing import (
    Arming,
    Validity,
    arm_in_log,
    countersign,
    read_numbers,
    sign_arming,
    uptime,
    witness_places,
)
from gateway.settings import Config
from gateway.settings.devices import load_device
from gateway.store import AuditEntry, open_historian
from gateway.store.audit import ARMED, EXPIRED, read
from tests.gateway.support import EPOCH, MAP, config_in

DEVICE = load_device(MAP.parent / "decanter_plc.toml")
FIRST, BEHIND = DEVICE.writebacks
END = EPOCH + 300.0


@dataclass
class Bench:
    """Clocks that only the test moves, what the PLC says, and what was put on record and sent, in its order."""

    now: float = EPOCH
    monotonic: float = 100.0
    armed: bool = True
    said: dict[str, tuple[Any, Quality]] = field(default_factory=dict)
    takes: bool = True
    done: list[tuple[str, Any]] = field(default_factory=list)
    meanwhile: Callable[[], None] = anyhow
    on_record: Callable[[], None] = anyhow
    failure: str = ""
    path: Path = Path("audit.sqlite")

    async def read(self, tags: list[Tag]) -> list[Sample]:
        found = (self.said.get(tag.name, (1, Quality.GOOD)) for tag in tags)
        return [Sample(tag.name, value, q, self.now, reason="why") for tag, (value, q) in zip(tags, found, strict=True)]

    async def write(self, values: list[tuple[Tag, int]], *, before_sending: BeforeSending = anyhow) -> None:
        self.meanwhile()
        before_sending()
        self.done.append(("sent", values))

    async def stored(self, entry: AuditEntry) -> bool:
        self.done.append(("stored", entry))
        self.on_record()
        return self.takes

    def put(self, entry: AuditEntry) -> None:
        self.done.append(("put", entry))

    def sent(self) -> list[list[int]]:
        return [[value for _, value in values] for what, values in self.done if what == "sent"]

    def rows(self) -> list[tuple[str, str]]:
        return [(entry.kind, entry.reason) for what, entry in self.done if what != "sent"]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench()
    made.said["WritePermit"] = (True, Quality.GOOD)
    made.said["Challenge"] = (77, Quality.GOOD)
    clock = SimpleNamespace(time=lambda: made.now, monotonic=lambda: made.monotonic)
    monkeypatch.setattr(room, "time", clock)
    asked: list[Any] = []

    def standing(path: Path, now: float, count: object, *, key: Path, subject: str) -> object:
        asked.append((path, now, key, subject))
        assert (path, now, key, subject) == (made.path, made.now, Path("key"), "two")
        return object() if made.armed else None

    monkeypatch.setattr(room, "find_arming", standing)
    return made


def writer(bench: Bench, **more: Any) -> BlockWriter:
    given: dict[str, Any] = {"device": DEVICE, "layout": FIRST, "driver": bench, "writes": bench, "audit": bench}
    given |= {"arming": Arming("Ada", "test", END), "key": Path("key"), "number": 4711, "subject": "two"}
    return BlockWriter(**(given | more))


OVER = "the arming is over; nothing was sent"


@pytest.mark.parametrize("place", ["before", "on record", "on the way"])
@pytest.mark.parametrize("end", ["taken back", "its time", "a moment before its time"])
async def test_nothing_is_sent_once_the_arming_is_over(bench: Bench, place: str, end: str) -> None:
    def over() -> None:
        if end == "taken back":
            bench.armed = False
        else:
            bench.now = END if end == "its time" else END - 0.125

    if place == "before":
        over()
    elif place == "on record":
        bench.on_record = over
    else:
        bench.meanwhile = over
    one = writer(bench)
    if end == "a moment before its time":
        await one.send([1] * 26)
        assert len(bench.sent()) == one.written == 1
        return
    with pytest.raises(WriteForbidden, match=OVER):
        await one.send([1] * 26)
    assert bench.sent() == [] and one.written == 0
    last = "write failed" if place == "on the way" else "write refused"
    assert bench.rows() == [*[("write", "")] * (place != "before"), (last, OVER)]


@pytest.mark.parametrize(
    "permit",
    [(False, Quality.GOOD), (True, Quality.LAST_USABLE), (True, Quality.UNCERTAIN), (None, Quality.TIMEOUT)],
)
async def test_nothing_is_sent_without_a_permit_that_reads_well_now(bench: Bench, permit: tuple[Any, Quality]) -> None:
    bench.said["WritePermit"] = permit
    for one in (writer(bench), writer(bench, taking_back=True)):
        assert not await one.has_permit()
        why = "the PLC does not permit writing (WritePermit); nothing was sent"
        with pytest.raises(WriteForbidden) as caught:
            await one.send([1] * 26)
        assert str(caught.value) == why and bench.rows()[-1] == ("write refused", why)
    assert bench.sent() == []


@pytest.mark.parametrize(("waited", "sent"), [(1.0, True), (1.25, False)])
async def test_a_permit_is_asked_for_within_a_second_of_sending(bench: Bench, waited: float, sent: bool) -> None:
    for place in ("on_record", "meanwhile"):
        bench.on_record = bench.meanwhile = anyhow
        setattr(bench, place, lambda: setattr(bench, "monotonic", bench.monotonic + waited))
        before = len(bench.sent())
        if sent:
            await writer(bench).send([1] * 26)
        else:
            with pytest.raises(WriteForbidden, match=r"^the permit was read 1.25 s ago \(1 s at most\); nothing was"):
                await writer(bench).send([1] * 26)
        assert len(bench.sent()) - before == sent


async def test_what_takes_back_needs_no_arming_any_more(bench: Bench) -> None:
    bench.armed, bench.now = False, END + 10.0
    one = writer(bench, taking_back=True)
    await one.block()
    assert len(bench.sent()) == 1 and bench.rows() == [("write", "")]


@pytest.mark.parametrize(("failure", "said"), [("", "the disk does not answer"), ("full", "full")])
async def test_without_its_row_nothing_is_sent(bench: Bench, failure: str, said: str) -> None:
    bench.takes, bench.failure = False, failure
    why = f"no audit record could be kept, so nothing was sent: {said}"
    with pytest.raises(WriteForbidden, match=f"^{why}$"):
        await writer(bench).send([1] * 26)
    assert bench.sent() == []
    assert [(what, entry.kind) for what, entry in bench.done] == [
        ("stored", "write"),
        ("stored", "write refused"),
        ("put", "write refused"),
    ]


async def test_each_write_is_on_record_before_it_and_a_lost_one_after_it(bench: Bench) -> None:
    one = writer(bench)
    await one.send([0x0102, 3], 5)
    (stored, entry), (sent, values) = bench.done
    assert (stored, sent) == ("stored", "sent")
    assert (entry.time, entry.kind, entry.who, entry.reason) == (EPOCH, "write", "Ada", "")
    assert entry.detail == {"words": "01020003", "offset": 5, "via": "command", "subject": "two"}
    assert values == [(FIRST.words[5], 0x0102), (FIRST.words[6], 3)] and one.written == 1

    def lost() -> None:
        raise LinkDown("the cable is out")

    bench.meanwhile = lost
    behind = writer(bench, layout=BEHIND)
    with pytest.raises(LinkDown):
        await behind.send([7])
    assert bench.rows()[1:] == [("write", ""), ("write failed", "the cable is out")] and behind.written == 0
    assert bench.done[-1][1].detail["block"] == BEHIND.suffix


async def test_blocks_count_on_and_hold_the_challenge_that_is_read(bench: Bench) -> None:
    one = writer(bench, sequence=0xFFFE, heartbeat=0xFFFE)
    words = [await one.block({"zone": 2.0}, Validity(31), beat=beat) for beat in (True, True, False)]
    assert [tuple(block) for block in bench.sent()] == words
    assert [block[1:4] for block in words] == [(0xFFFF, 0xFFFF, 31), (0, 1, 31), (1, 1, 31)]
    assert all(block[22:24] == (77, 4711) for block in words)
    bench.said["Challenge"] = (78, Quality.GOOD)
    assert (await one.block())[22] == 78
    taken = read_numbers(FIRST, bench.sent()[-1])
    assert (taken["input_quality"], taken["zone"], taken["temperature_now"]) == (2.0, 0.0, None)


async def test_a_number_that_does_not_read_well_is_waited_for_and_then_an_error(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, waits = writer(bench), list[float]()

    async def sleep(seconds: float) -> None:
        waits.append(seconds)
        bench.monotonic += 1.0
        if len(waits) == 3:
            bench.said["Challenge"] = (79, Quality.GOOD)

    monkeypatch.setattr(room, "asyncio", SimpleNamespace(sleep=sleep))
    bench.said["Challenge"] = (None, Quality.TIMEOUT)
    assert await one.numbers("Challenge", "WritePermit") == [79, 1] and waits == [0.02] * 3
    bench.said["Challenge"] = (None, Quality.TIMEOUT)
    with pytest.raises(DriverError, match=r"^Challenge cannot be read: why$"):
        await one.numbers("WritePermit", "Challenge")
    assert len(waits) == 7, "three seconds, and once more"
    with pytest.raises(ValueError, match="has no tag 'Nothing', by which the PLC answers; add it"):
        await one.numbers("Nothing")


async def test_of_a_suites_step_what_cannot_be_sent_is_a_step_that_cannot_be_put(bench: Bench) -> None:
    one = writer(bench)
    for offset in (3, 4):
        await one.write(offset, [9, 8])
        assert bench.done[-1] == ("sent", [(FIRST.words[offset], 9), (FIRST.words[offset + 1], 8)])
    assert one.written == 2

    def unverified() -> None:
        raise WriteUnverified("it reads back 7")

    bench.meanwhile = unverified
    await one.write(0, [1] * 26)
    bench.meanwhile, bench.armed = anyhow, False
    with pytest.raises(Unable, match=OVER):
        await writer(bench).write(0, [1] * 26)


@pytest.mark.parametrize(("wanted", "has"), [*product((True, False), repeat=2)])
async def test_a_person_is_asked_only_for_another_permit(
    bench: Bench, wanted: bool, has: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.said["WritePermit"], questions = (has, Quality.GOOD), list[str]()
    if wanted == has:
        await writer(bench, ask=lambda _: pytest.fail("it is so already")).permit(wanted)
        return
    word = "give" if wanted else "take away"
    with pytest.raises(Unable, match=rf"nobody was there to {word} the permit \(--ask\)"):
        await writer(bench).permit(wanted)
    with pytest.raises(Unable, match="nobody was there"):
        await writer(bench, ask=lambda _: False).permit(wanted)

    def done(question: str) -> bool:
        questions.append(question)
        return True

    async def no_wait(_: BlockWriter) -> None:
        questions.append("scans")

    monkeypatch.setattr(BlockWriter, "wait_for_scans", no_wait)
    with pytest.raises(Unable, match="the permit has not changed"):
        await writer(bench, ask=done).permit(wanted)
    assert questions == [f"Please {word} the write permit at the PLC. Done?", "scans"]


async def test_the_plcs_account_is_read_once_its_program_has_moved_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts, beat = iter([1, 1, 2, 3, 3, 4]), DEVICE.heartbeat
    assert beat is not None

    async def sleep(seconds: float) -> None:
        bench.monotonic += 0.5
        bench.said[beat] = (next(counts), Quality.GOOD)
        bench.said["BlocksAccepted"] = (bench.said[beat][0] * 10, Quality.GOOD)

    monkeypatch.setattr(room, "asyncio", SimpleNamespace(sleep=sleep))
    for place, name in enumerate(STATUS_TAGS):
        bench.said[name] = (place + 2, Quality.GOOD)
    bench.said[beat] = (9, Quality.GOOD)
    account = await writer(bench).account()
    assert next(counts) == 3, "the count of before, and three others after it"
    assert (account.accepted, account.refused, account.last_refusal, account.usable) == (30, 3, 4, True)
    assert (account.challenge, account.session_writer, account.refused_writer) == (6, 7, 8)
    assert STATUS_TAGS[:4] == ("BlocksAccepted", "BlocksRefused", "LastRefusal", "PredictionUsable")
    counts = iter([5] * 9)
    with pytest.raises(DriverError, match=f"^the PLC's heartbeat {beat} has not moved for 3 s; its program stands$"):
        await writer(bench).wait_for_scans()


def test_results_of_several_blocks_are_one() -> None:
    first = CommandResult({"sent": 2, "ok": True, "title": "a", "rows": [{"ok": True}]}, "", 0)
    second = CommandResult({"sent": 3, "ok": False, "title": "b", "rows": [{"ok": False}, {"skipped": 1}]}, "no", 1)
    both = room.join_results([("T", first), ("U", second)])
    rows = [{"ok": True, "block": "T"}, {"ok": False, "block": "U"}, {"skipped": 1, "block": "U"}]
    assert both == CommandResult({"sent": 5, "ok": True, "title": "a", "rows": rows}, "U: no", 1)
    shown = room.rows_of_test("Test", both.data, lambda row: {"step": len(row)})
    assert (shown.title, list(shown.columns)) == ("Test", ["", "block", "step"])
    assert [row[""] for row in shown.rows] == ["ok", "FAILED", "skipped"]
    assert list(room.rows_of_test("Test", first.data, lambda _: {"step": 1}).rows[0]) == ["", "step"]


# ---------------------------------------------------------------- by the audit log itself


def test_an_arming_that_is_over_is_put_on_record_by_the_command_that_finds_it(tmp_path: Path) -> None:
    config: Config = config_in(tmp_path, '[writeback]\nmode = "shadow"\n')
    places = witness_places(config)

    def refused(now: float) -> None:
        with pytest.raises(WriteForbidden) as caught:
            arming_in_force(places, now)
        assert str(caught.value) == (
            "not armed: nothing is written; arm first: decanter arm --by NAME --reason WHY --minutes N (audit log "
            f"{config.audit})"
        )

    refused(EPOCH)
    arm_in_log(config.audit, sign_arming("Ada", "run", 5, EPOCH), EPOCH)
    countersign(places, EPOCH)
    assert arming_in_force(places, END - 0.125) == Arming("Ada", "run", END)
    for _ in range(2):
        refused(END)
    refused(EPOCH + 1.0)
    ended = [(row.entry.time, row.entry.who, row.entry.reason) for row in read(config.audit, [EXPIRED])]
    assert ended == [(END, "Ada", "its time is over")] and len(read(config.audit, [ARMED])) == 1
    assert uptime().seconds > 0.0


def test_a_gateway_runs_while_it_holds_the_historian(tmp_path: Path) -> None:
    path = tmp_path / "history.sqlite"
    assert not gateway_runs(path)
    store = open_historian(path)
    assert gateway_runs(path)
    store.close()
    assert not gateway_runs(path)
