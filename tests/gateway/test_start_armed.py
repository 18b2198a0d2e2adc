"""What a start makes of the audit log, and each way in which an arming does not come into force."""

import asyncio
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.driver import open_driver
from drivers.settings import ConfigError
from gateway.machine.writing import arming as room
from gateway.machine.writing.arming import (
    ArmingError,
    arm,
    arm_in_log,
    arming_entry,
    disarm_in_log,
    end_by_mode,
    keep_disarming,
    newest_stamp,
    next_start,
    open_writers,
    own_process,
    sign_arming,
    uptime,
)
from gateway.machine.writing.writeback import Arming, Pace, Writer
from gateway.settings import Config
from gateway.store import Audit, AuditEntry, AuditError, load_or_make_key, open_audit
from gateway.store.audit import ARMED, CANCELLED, CONFIRMED, DISARMED, EXPIRED, read
from tests.gateway.support import EPOCH, JumpClock, config_in

FILE = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "run"\nminutes = 60\n'
END = EPOCH + 3600.0


def in_mode(config: Config, mode: str) -> Config:
    return replace(config, writeback=config.writeback.model_copy(update={"mode": mode}))


def words(config: Config) -> list[tuple[str, str, str]]:
    return [(row.entry.kind, row.entry.who, row.entry.reason) for row in read(config.audit)]


def kinds(config: Config) -> list[str]:
    return [kind for kind, _, _ in words(config)]


def appended(path: Path, *entries: AuditEntry) -> None:
    log = open_audit(path)
    assert all(log.record(entry) for entry in entries) and log.close()


# ---------------------------------------------------------------- what a start makes of the log


def test_the_words_of_a_start_in_every_state_of_the_log(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    shadow, path, count = in_mode(config, "shadow"), config.audit, uptime()

    def start(given: Config = shadow, at: float = EPOCH + 5.0) -> room.NextStart:
        return next_start(given, path, at, count)

    off = start(in_mode(config, "off"))
    assert (off.arming, off.sentence, off.ended, off.by) == (None, "writeback.mode is 'off'", None, "")
    assert (start().arming, start().sentence) == (None, "nobody has armed it")
    by_file = start(config, EPOCH)
    assert by_file.arming == Arming("Ada", "run", END) and by_file.sentence == f"{config.path} arms it for 60 minutes"
    assert by_file.file == {"by": "Ada", "reason": "run", "minutes": 60.0, "stamp": config.stamp}

    # A disarming wins over every file that was saved before it, and at the same moment.
    disarm_in_log(path, "Bea", "not today", EPOCH, config.stamp)
    assert (start().arming, start().sentence, start().by) == (None, "Bea disarmed it (not today)", "Bea")
    refused = start(config)
    assert (
        refused.arming is None
        and refused.by == "Bea"
        and refused.sentence
        == (f"Bea disarmed it (not today) after {config.path} was saved; save it anew to arm again")
    )
    assert start(replace(config, stamp=config.stamp + 1.0)).arming is not None
    assert start(replace(config, stamp=config.stamp - 1.0)).arming is None

    # An arming by command goes on, for its configuration and until its end.
    arm_in_log(path, sign_arming("Cai", "loop", 60, EPOCH), EPOCH, armed_for=config.arming_hash)
    going = start()
    assert (going.arming, going.sentence) == (Arming("Cai", "loop", END), "the arming by Cai goes on")
    assert going.file is None and going.ended is None
    assert start(config).arming == going.arming, "a file that was saved before it has no say"
    other = start(replace(shadow, alarms=config.alarms.model_copy(update={"limit": 1.0})))
    assert (other.arming, other.sentence, other.by) == (
        None,
        "the arming by Cai is for another configuration of the machine than the one there is now; look at it, and arm "
        "again",
        "Cai",
    )
    row = read(path, [ARMED])[0]
    assert other.ended is not None and other.ended.id == row.id
    late = start(at=END)
    assert (late.arming, late.sentence, late.by) == (None, "the arming by Cai is over: its time is over", "Cai")
    assert late.ended is not None and late.ended.id == row.id
    appended(path, AuditEntry(EPOCH + 1.0, EXPIRED, "Cai", "it ran out"))
    over = start()
    assert (over.arming, over.sentence, over.by, over.ended) == (
        None,
        "the arming by Cai is over: it ran out",
        "Cai",
        None,
    )

    # One that is not confirmed does not count, and does not hide what was said before it.
    appended(path, arming_entry(Arming("Eve", "forged", END), EPOCH + 2.0, "command"))
    forged = start()
    newest = read(path, [ARMED])[-1]
    assert forged.arming is None and forged.by == "Eve" and forged.ended is not None and forged.ended.id == newest.id
    assert forged.sentence == (
        f"the arming by Eve (row {newest.id}) is not confirmed with this gateway's key, so that it does not count; arm "
        "again if that is wanted"
    )


def test_the_words_of_a_file_arm_once_and_only_while_they_stand_in_it(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    first = next_start(config, config.audit, EPOCH, uptime())
    assert first.arming is not None
    entry = arming_entry(first.arming, EPOCH, "gateway began", file=first.file)
    log = open_audit(config.audit)
    row = log.record(entry)
    assert row is not None
    assert log.record(room.confirmation(row, load_or_make_key(config.audit_key), EPOCH)) and log.close()

    def start(given: Config) -> room.NextStart:
        return next_start(given, config.audit, EPOCH + 5.0, uptime())

    going = start(config)
    assert going.arming is not None and going.sentence == "the arming by Ada goes on" and going.file == first.file
    shadow = start(in_mode(config, "shadow"))
    assert (shadow.arming, shadow.sentence, shadow.by) == (
        None,
        f"the words of {config.path} that armed it are changed",
        "Ada",
    )
    assert shadow.ended is not None and shadow.ended.id == row.id
    for change in ({"reason": "x"}, {"armed_by": "x"}, {"minutes": 61.0}):
        section = config.writeback.model_copy(update=change)
        anew = start(replace(config, writeback=section))
        assert anew.arming is not None and anew.sentence.endswith("minutes"), "another word, which was not used yet"
    assert start(replace(config, stamp=config.stamp + 1.0)).sentence.endswith("arms it for 60 minutes")


@pytest.mark.parametrize(
    ("change", "used"),
    [({}, True), ({"who": "Bea"}, False), ({"reason": "x"}, False), ({"via": "command"}, False), ({"time": -1}, False)],
)
def test_rows_of_earlier_gateways_use_a_files_words_up_too(change: dict[str, Any], used: bool, tmp_path: Path) -> None:
    config = replace(config_in(tmp_path, FILE), stamp=EPOCH)
    arming = Arming(change.get("who", "Ada"), change.get("reason", "run"), END)
    appended(config.audit, arming_entry(arming, EPOCH + change.get("time", 0), change.get("via", "gateway began")))
    start = next_start(config, config.audit, EPOCH + 5.0, uptime())
    assert (start.arming is None) == used


def test_what_disarms_by_a_row_without_a_files_time_is_held_against_its_own(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    disarm_in_log(config.audit, "Bea", "no", EPOCH)
    for stamp, armed in ((EPOCH, False), (EPOCH + 1.0, True)):
        start = next_start(replace(config, stamp=stamp), config.audit, EPOCH + 5.0, uptime())
        assert (start.arming is not None) == armed


# ---------------------------------------------------------------- the running gateway


@dataclass
class Told:
    """A log and a historian that keep what they are told; `flushes` says whether rows are stored."""

    lines: list[tuple[str, str, dict[str, Any]]] = field(default_factory=list)
    rows: list[tuple[str, list[Any]]] = field(default_factory=list)
    flushes: Callable[[], bool] = lambda: True
    failure: str = ""

    def error(self, event: str, **said: Any) -> None:
        self.lines.append(("error", event, said))

    def warning(self, event: str, **said: Any) -> None:
        self.lines.append(("warning", event, said))

    def put(self, table: str, rows: list[Any]) -> None:
        self.rows.append((table, rows))

    def flush(self) -> bool:
        return self.flushes()


SOFT = {"clock": JumpClock().now, "write_map": ()}


def opened(
    config: Config, audit: Audit | None = None, *, told: Told | None = None, driver: Any = None, **more: Any
) -> tuple[tuple[Writer, ...], Told]:
    """The writers of a start at EPOCH, and what was told of it."""
    told = Told() if told is None else told
    log = open_audit(config.audit) if audit is None else audit
    more = {"rng": Random(1), "clock": JumpClock(), **more}
    driver = open_driver("soft", {}, **SOFT) if driver is None else driver
    try:
        writers = open_writers(
            config, config.map.writebacks, driver=driver, historian=told, audit=log, log=told, **more
        )  # type: ignore[arg-type]
    finally:
        log.close()
    return writers, told


def in_shadow(writers: tuple[Writer, ...]) -> bool:
    return all((each.mode, each.driver, each.arming, each.armed_at) == ("shadow", None, None, 0) for each in writers)


def test_a_start_that_arms_has_it_on_record_first_and_one_arming_for_all_blocks(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    driver = open_driver("soft", {}, **SOFT)
    stored: list[list[str]] = []
    told = Told(flushes=lambda: not stored.append(kinds(config)))  # type: ignore[func-returns-value]
    writers, told = opened(config, told=told, driver=driver)
    assert stored == [[]], "the historian first, and nothing else before it"
    assert len(writers) == 2 and kinds(config) == [ARMED, CONFIRMED]
    row = read(config.audit, [ARMED])[0]
    for writer, layout in zip(writers, config.map.writebacks, strict=True):
        assert (writer.layout, writer.mode, writer.driver) == (layout, "armed", driver)
        assert (writer.arming, writer.armed_at) == (Arming("Ada", "run", END), row.id)
        assert writer.pace == Pace(config.blocks_per_second) and writer.max_age == config.block_max_age
        assert writer.subject == config.subject and writer.audit is not None
    assert writers[0].pace is not writers[1].pace
    assert {writer.number for writer in writers} == {Random(1).randint(1, 0xFFFF)}
    assert told.rows == [("audit", [(EPOCH, "armed until 2023-11-14 23:13:20 UTC", "Ada", "run")])]
    assert told.lines == [("warning", "armed", {"by": "Ada", "reason": "run", "until": END})]
    detail = row.entry.detail
    assert (detail["until"], detail["via"], detail["configuration"], detail["speed"]) == (
        END,
        "gateway began",
        config.arming_hash,
        1.0,
    )
    assert detail["file"]["by"] == "Ada"
    again, _ = opened(in_mode(config, "shadow"), clock=JumpClock(EPOCH + 1.0))
    assert in_shadow(again), "those words are no longer in the file"


def test_where_nothing_says_arm_a_start_says_nothing_and_an_armed_file_hears_why(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    writers, told = opened(in_mode(config, "shadow"))
    assert in_shadow(writers) and told.lines == [] == told.rows and kinds(config) == []
    disarm_in_log(config.audit, "Bea", "no", EPOCH, config.stamp)
    writers, told = opened(config)
    why = f"Bea disarmed it (no) after {config.path} was saved; save it anew to arm again"
    assert in_shadow(writers) and told.lines == [("warning", "not armed", {"reason": why})]
    assert told.rows == [("audit", [(EPOCH, "arming is over, shadow", "Bea", why)])]


def test_an_arming_that_is_over_gets_a_row_of_its_own(tmp_path: Path) -> None:
    config = in_mode(config_in(tmp_path, FILE), "shadow")
    arm_in_log(config.audit, sign_arming("Cai", "loop", 1, EPOCH), EPOCH)
    writers, told = opened(config, clock=JumpClock(EPOCH + 60.0))
    why = "the arming by Cai is over: its time is over"
    assert in_shadow(writers) and words(config)[-1] == (EXPIRED, "Cai", why)
    assert told.lines == [("warning", "not armed", {"reason": why})]
    assert told.rows == [("audit", [(EPOCH + 60.0, "arming is over, shadow", "Cai", why)])]
    _, told = opened(config, clock=JumpClock(EPOCH + 61.0))
    assert told.lines == [], "said once"


def test_a_driver_that_cannot_write_is_an_error_only_where_it_shall(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    with pytest.raises(ConfigError) as caught:
        opened(config, driver=SimpleNamespace())
    assert str(caught.value) == (
        f"{config.map.path}: device.driver: {config.map.driver!r} cannot write; set writeback.mode to 'shadow'"
    )
    writers, told = opened(in_mode(config, "shadow"), driver=SimpleNamespace())
    assert in_shadow(writers) and len(writers) == 2 and told.lines == []


def test_what_keeps_a_start_from_arming_is_said_and_leaves_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_in(tmp_path, FILE)
    log = open_audit(config.audit)
    log.failure = "the disk is full"
    writers, told = opened(config, log)
    assert in_shadow(writers) and told.lines == [("error", "not armed", {"reason": "the disk is full"})]

    writers, told = opened(config, obstacle=lambda: "the record is damaged")
    assert in_shadow(writers) and told.lines == [("error", "not armed", {"reason": "the record is damaged"})]

    writers, told = opened(config, told=Told(flushes=lambda: False, failure="its disk is full"))
    unstored = "not armed, as the audit record cannot be stored"
    assert in_shadow(writers) and told.lines == [("error", unstored, {"reason": "its disk is full"})]

    log = open_audit(config.audit)
    undone: list[AuditEntry | None] = []
    monkeypatch.setattr(log, "record", lambda entry, undo=None: undone.append(undo))
    log_failure = Told(flushes=lambda: not setattr(log, "failure", "no answer"))  # type: ignore[func-returns-value]
    writers, told = opened(config, log, told=log_failure)
    assert in_shadow(writers) and told.lines == [("error", unstored, {"reason": "no answer"})]
    (undo,) = undone
    assert undo is not None and (undo.kind, undo.who) == (CANCELLED, "Ada")
    assert undo.reason == "the records could not be stored when the gateway began"
    assert kinds(config) == []

    def damaged(*_: Any, **__: Any) -> Any:
        raise AuditError("row 3 is damaged")

    monkeypatch.setattr(room, "next_start", damaged)
    writers, told = opened(config)
    assert in_shadow(writers) and told.lines == [("error", "not armed", {"reason": "row 3 is damaged"})]


def test_a_word_that_is_given_while_it_begins_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = config_in(tmp_path, FILE)

    def disarmed() -> bool:
        disarm_in_log(config.audit, "Bea", "stop", EPOCH)
        return True

    writers, told = opened(config, told=Told(flushes=disarmed))
    assert in_shadow(writers)
    assert words(config)[-1] == (CANCELLED, "Ada", "not armed: something was said of it while it began")
    assert kinds(config) == [DISARMED, ARMED, CANCELLED]
    why = "somebody armed or disarmed while it began; arm again if that is wanted"
    assert told.lines == [("warning", "not armed", {"reason": why})]

    honest, asked = room._newest_word, []

    def damaged(path: Path, subject: str, before: float = float("inf")) -> int:
        asked.append(before)
        if len(asked) == 2:
            raise AuditError("row 3 is damaged")
        return honest(path, subject, before)

    monkeypatch.setattr(room, "_newest_word", damaged)
    writers, told = opened(replace(config, stamp=EPOCH + 10.0))
    assert in_shadow(writers) and told.lines == [("error", "not armed", {"reason": "row 3 is damaged"})]
    assert words(config)[-1] == (CANCELLED, "Ada", "not armed: the audit log cannot be read")


def running(config: Config, audit: Audit | None) -> tuple[Writer, ...]:
    clock = JumpClock()
    return tuple(
        Writer(layout, clock, "shadow", 7, audit=audit, subject=config.subject) for layout in config.map.writebacks
    )


async def test_arming_by_command_is_stored_then_in_force_then_confirmed(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    audit, driver, key = open_audit(config.audit), open_driver("soft", {}, **SOFT), load_or_make_key(config.audit_key)
    writers = running(config, audit)
    asked = {"by": " Cai ", "reason": "loop", "minutes": 60.0, "key": key, "process": {"pid": 5}, "armed_for": "abc"}
    arming = await arm(writers, driver, **asked)
    assert arming == Arming("Cai", "loop", END) and audit.close()
    row, confirming = read(config.audit)
    assert (row.entry.kind, confirming.entry.kind, confirming.entry.time) == (ARMED, CONFIRMED, EPOCH)
    detail = row.entry.detail
    assert (detail["via"], detail["pid"], detail["configuration"], detail["speed"]) == ("command", 5, "abc", 1.0)
    assert [(each.mode, each.driver, each.arming, each.armed_at) for each in writers] == [
        ("armed", driver, arming, row.id)
    ] * 2


async def test_an_arming_by_command_that_does_not_come_into_force_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_in(tmp_path, FILE)
    driver, key = open_driver("soft", {}, **SOFT), load_or_make_key(config.audit_key)
    asked = {"by": "Cai", "reason": "loop", "minutes": 60.0, "key": key}
    with pytest.raises(ArmingError, match="this driver cannot write"):
        await arm(running(config, None), driver, **asked)
    audit = open_audit(config.audit)
    writers = running(config, audit)
    with pytest.raises(ArmingError, match="this driver cannot write"):
        await arm(writers, SimpleNamespace(), **asked)  # type: ignore[arg-type]
    writers[1].ending = 1
    with pytest.raises(ArmingError, match=r"being disarmed at this moment; arm again once that is done"):
        await arm(writers, driver, **asked)
    audit.failure = "full"
    with pytest.raises(ArmingError, match=r"at this moment, which the audit log does not take \(full\); arm again"):
        await arm(writers, driver, **asked)
    writers[1].ending, audit.failure = 0, ""
    honest = audit.stored

    async def meanwhile(entry: AuditEntry, undo: AuditEntry | None = None) -> Any:
        writers[1].generation += 1
        return await honest(entry, undo=undo)

    monkeypatch.setattr(audit, "stored", meanwhile)
    with pytest.raises(ArmingError, match="not armed: it was disarmed meanwhile; arm again if that is still wanted"):
        await arm(writers, driver, **asked)
    undone: list[AuditEntry | None] = []

    async def never(entry: AuditEntry, undo: AuditEntry | None = None) -> None:
        undone.append(undo)

    monkeypatch.setattr(audit, "stored", never)
    for failure, why in (("", "the disk does not answer"), ("full", "full")):
        audit.failure = failure
        with pytest.raises(ArmingError, match=f"^not armed, as the audit log does not take it: {why}$"):
            await arm(writers, driver, **asked)
    for undo in undone:
        assert undo is not None
        assert (undo.kind, undo.reason) == (CANCELLED, "not armed: the disk did not take it in time")
    audit.failure = ""
    assert audit.close() and in_shadow(writers)
    assert words(config)[1:] == [(CANCELLED, "Cai", "not armed: it was disarmed meanwhile")]


# ---------------------------------------------------------------- without a gateway


@dataclass
class NoDisk:
    """An audit log that takes the first `rows` of what it is given."""

    rows: int
    failure: str = ""
    known: bool = True
    note: str = ""
    undone: list[AuditEntry | None] = field(default_factory=list)
    closed: int = 0

    def record(self, entry: AuditEntry, undo: AuditEntry | None = None) -> Any:
        self.undone.append(undo)
        self.rows -= 1
        return SimpleNamespace(id=1, hash="h", entry=entry) if self.rows >= 0 else None

    def close(self) -> bool:
        self.closed += 1
        return self.known


@pytest.mark.parametrize("rows", [0, 1])
@pytest.mark.parametrize(("failure", "said"), [("", "the disk does not answer"), ("full", "full")])
@pytest.mark.parametrize("known", [True, False])
def test_what_a_disk_does_not_take_arms_nobody(
    rows: int, failure: str, said: str, known: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = NoDisk(rows, failure, known)
    monkeypatch.setattr(room, "open_audit", lambda path: disk)
    arming, doubt = sign_arming("Ada", "run", 5, EPOCH), "whether it has taken it after all cannot be told"
    with pytest.raises(ArmingError) as caught:
        arm_in_log(tmp_path / "audit.sqlite", arming, EPOCH, subject="two")
    assert str(caught.value).startswith(f"nothing has changed, as the audit log does not take it: {said}")
    assert (doubt in str(caught.value)) == (not known) and disk.closed == 1
    late = "the disk did not take it in time"
    assert [(undo.time, undo.kind, undo.who, undo.reason, undo.subject) for undo in disk.undone if undo] == [
        (EPOCH, CANCELLED, "Ada", late, "two"),
        (EPOCH, DISARMED, "", late, "two"),
    ][: rows + 1]
    monkeypatch.setattr(room, "open_or_set_aside", lambda path: NoDisk(0, failure))
    with pytest.raises(ArmingError, match=f"^nothing has changed, as the audit log does not take it: {said}$"):
        disarm_in_log(tmp_path / "audit.sqlite", "Bea", "no", EPOCH)


def test_a_damaged_log_is_disarmed_all_the_same_and_says_what_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_in(tmp_path, FILE)
    disk, said = NoDisk(1, note="it was set aside"), list[str]()

    def damaged(*_: Any, **__: Any) -> Any:
        raise AuditError("row 3")

    monkeypatch.setattr(room, "open_or_set_aside", lambda path: disk)
    monkeypatch.setattr(room, "given_words", damaged)
    assert disarm_in_log(config.audit, "Bea", "no", EPOCH, say=said.append) is None
    assert said == ["whether it was armed is not known: row 3", "it was set aside"]


def test_the_row_of_an_arming_says_by_which_way_it_was_given(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    arm_in_log(config.audit, sign_arming("Cai", "loop", 5, EPOCH), EPOCH, subject="two", armed_for="abc")
    row, confirming = read(config.audit)
    detail = dict(row.entry.detail)
    assert detail.pop("uptime") <= uptime().seconds and detail.pop("boot") == uptime().boot
    assert detail == {
        "until": EPOCH + 300.0,
        "via": "command",
        "speed": 1.0,
        "configuration": "abc",
        "subject": "two",
        **own_process(),
    }
    assert (row.entry.time, confirming.entry.time, confirming.entry.subject) == (EPOCH, EPOCH, "two")


def test_what_the_machines_own_count_has_ended_is_not_in_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = config_in(tmp_path, FILE)
    arm_in_log(config.audit, sign_arming("Cai", "loop", 5, EPOCH), EPOCH)
    real = uptime()
    monkeypatch.setattr(room, "uptime", lambda: room.Uptime("a boot", real.seconds + 600.0))
    assert end_by_mode(config, lambda: NoDisk(1), EPOCH) is not None, "another start of the machine: the clock decides"  # type: ignore[arg-type, return-value]
    monkeypatch.setattr(room, "uptime", lambda: replace(real, seconds=real.seconds + 600.0))
    assert end_by_mode(config, lambda: pytest.fail("it is over"), EPOCH) is None
    assert disarm_in_log(config.audit, "Bea", "no", EPOCH) is None


def test_the_row_of_a_disarming_says_which_program_and_which_file_it_is_against(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    disarm_in_log(config.audit, "Bea", "no", EPOCH, subject="two")
    disarm_in_log(config.audit, "Bea", "no", EPOCH, 5.0)
    first, second = read(config.audit)
    assert first.entry.detail == {**own_process(), "subject": "two"}
    assert second.entry.detail == {**own_process(), "stamp": 5.0}
    assert own_process() == {"uid": os.getuid(), "pid": os.getpid()}


def test_a_machine_whose_mode_is_off_loses_its_arming_for_good(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = in_mode(config_in(tmp_path, FILE), "off")
    assert end_by_mode(config, lambda: pytest.fail("nothing is there"), EPOCH) is None
    arm_in_log(config.audit, sign_arming("Cai", "loop", 5, EPOCH), EPOCH)
    for failure, why in (("", "the disk does not answer"), ("full", "full")):
        with pytest.raises(ArmingError) as caught:
            end_by_mode(config, lambda f=failure: NoDisk(0, f), EPOCH + 1.0)  # type: ignore[misc]
        assert str(caught.value) == f"the arming by Cai stands, as the audit log does not take its end: {why}"
    log = open_audit(config.audit)
    row = end_by_mode(config, lambda: log, EPOCH + 1.0)
    assert row is not None and row.entry.who == "Cai" and log.close()
    newest = read(config.audit)[-1].entry
    assert (newest.time, newest.kind, newest.who, newest.reason) == (
        EPOCH + 1.0,
        EXPIRED,
        "Cai",
        "writeback.mode was set to 'off'",
    )
    assert end_by_mode(config, lambda: pytest.fail("it is over"), EPOCH + 2.0) is None


async def test_a_disarming_of_a_machine_in_mode_off_is_kept_against_its_file(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    log, waits = open_audit(config.audit), list[float]()
    honest = log.keep

    async def kept(entry: AuditEntry, timeout: float) -> None:
        waits.append(timeout)
        await honest(entry, timeout)

    log.keep = kept  # type: ignore[method-assign]
    os.utime(config.path, (EPOCH + 9.0, EPOCH + 9.0))
    await keep_disarming(config, log, EPOCH, by="Bea", reason="no", process={"pid": 5})
    await asyncio.sleep(0)
    assert log.close() and waits == [2.0]
    (row,) = read(config.audit)
    assert (row.entry.time, row.entry.kind, row.entry.who, row.entry.reason) == (EPOCH, DISARMED, "Bea", "no")
    assert row.entry.detail == {"pid": 5, "stamp": EPOCH + 9.0}
    config.path.unlink()
    assert newest_stamp(config) == config.stamp != EPOCH + 9.0


def test_at_most_200_characters_of_a_name_and_480_minutes() -> None:
    assert sign_arming("A" * 200, "b" * 200, 480, 1.0) == Arming("A" * 200, "b" * 200, 28801.0)
    with pytest.raises(ArmingError, match=r"^the reason must be one line of at most 200 characters$"):
        sign_arming("A", "b" * 201, 480, 1.0)
