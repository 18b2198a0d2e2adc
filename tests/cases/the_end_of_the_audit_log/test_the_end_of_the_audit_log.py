"""A cut tail, an emptied log and a chain computed anew passed; a damaged log kept the gateway from starting."""

import asyncio
import json
import os
import shutil
import sqlite3
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from time import sleep
from typing import Any

import pytest
import structlog
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.machine.writing import ArmingError, clear_for_arming, countersign, witness_places
from gateway.machine.writing.witnessing import HeadWitnessing
from gateway.outside.status import ControlError, connect
from gateway.plant.app import run
from gateway.settings import Config
from gateway.store import default_places, examine, open_audit
from gateway.store.audit import ARMED, CONFIRMED, AuditEntry, read, verify
from gateway.store.signing import SigningKeyError, load_key, load_or_make_key, public_path
from gateway.store.witness import ACKNOWLEDGED
from tests.gateway.support import EPOCH, Bench, JumpClock, config_in, logged, one_machine
from tests.rig.patient_loop import PatientLoop

ARMED_BY_FILE: dict[str, Any] = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
}


async def go(config: Config, clock: JumpClock, reads: int = 15) -> tuple[dict[str, Any], Bench]:
    bench = Bench(config, clock, armed=True)
    bench.stop_after = reads
    status = await asyncio.wait_for(run(config, clock=clock, stop=bench.stop, driver=bench), 300.0)
    return status, bench


def raw(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            connection.execute(f"DROP TRIGGER {name}")
        for statement in statements:
            connection.execute(statement)
        connection.commit()


def appended(path: Path, *entries: AuditEntry) -> None:
    """What anybody can do who may write to the file: each row is well formed, each hash right."""
    audit = open_audit(path)
    assert all(audit.record(entry) for entry in entries) and audit.close()


def computed_anew(path: Path) -> None:
    """The whole chain once more, with one name another: each hash is right."""
    entries = [row.entry for row in read(path)]
    raw(path, "DELETE FROM audit")
    changed = [AuditEntry(e.time, e.kind, "Eve" if e.who else "", e.reason, e.detail) for e in entries]
    appended(path, *changed)


def begun_anew(path: Path) -> None:
    for suffix in ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    open_audit(path).close()


MANIPULATIONS: dict[str, Any] = {
    "changed row": lambda path: raw(path, "UPDATE audit SET who = 'Eve' WHERE id = 3"),
    "removed row": lambda path: raw(path, "DELETE FROM audit WHERE id = 3"),
    "cut tail": lambda path: raw(path, "DELETE FROM audit WHERE id > 5"),
    "last row cut": lambda path: raw(path, "DELETE FROM audit WHERE id = (SELECT max(id) FROM audit)"),
    "emptied": lambda path: raw(path, "DELETE FROM audit"),
    "computed anew": computed_anew,
    "begun anew": begun_anew,
}


def audit_command(config: Config, *options: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["audit", *options, "--json"])
    return done.exit_code, done.output


def plant(config: Config) -> list[str]:
    return ["--config", str(config.path)]


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """The folder of a plant whose gateway was armed, wrote and stopped, and the moment of that."""
    folder = tmp_path_factory.mktemp("before")
    config, clock = config_in(folder, **ARMED_BY_FILE), JumpClock()
    with asyncio.Runner(loop_factory=PatientLoop) as runner:
        _, bench = runner.run(go(config, clock))
    assert len(bench.written) > 10
    whole = examine(witness_places(config))
    assert whole.problem == "" and whole.witnessed == whole.rows > 10, "a stop leaves nothing unwitnessed"
    assert all("signed heads" in sentence for sentence in whole.witnesses.values()) and len(whole.witnesses) == 3
    return folder, clock.time


@pytest.mark.parametrize("manipulation", MANIPULATIONS)
@pytest.mark.parametrize("witness", ["heads file", "historian", "log"])
async def test_each_witness_finds_each_manipulation_alone_and_nobody_arms_on_it(
    tmp_path: Path, before: tuple[Path, float], manipulation: str, witness: str
) -> None:
    shutil.copytree(before[0], tmp_path, dirs_exist_ok=True)
    config, clock = config_in(tmp_path, **ARMED_BY_FILE), JumpClock(before[1])
    assert len(examine(witness_places(config)).witnesses) == 3
    assert audit_command(config, *plant(config))[0] == 0
    MANIPULATIONS[manipulation](config.audit)
    if witness != "heads file":
        config.audit_heads.unlink()
    if witness != "historian":
        with closing(sqlite3.connect(config.historian.path)) as connection, connection:
            connection.execute("DELETE FROM state WHERE key = 'audit head'")
    if witness != "log":
        (tmp_path / "gateway.jsonl").unlink()
    code, output = audit_command(config, *plant(config))
    assert code == 1 and "Traceback" not in output, output
    clock.time += 1.0
    status, bench = await go(config, clock)
    assert status["writeback"]["mode"] == "shadow" and bench.written == []
    assert any(row["event"] == "not armed" for row in logged(tmp_path))


def test_a_lost_head_is_acknowledged_by_name_and_only_then_the_gateway_arms(tmp_path: Path) -> None:
    config = config_in(tmp_path, writeback__mode="shadow")
    places = witness_places(config)
    audit = open_audit(config.audit)
    assert all(audit.record(AuditEntry(EPOCH + n, "write", "Ada")) for n in range(20))
    countersign(places, EPOCH)
    audit.close()
    begun_anew(config.audit)
    audit = open_audit(config.audit)
    lost = examine(places).lost
    assert lost is not None and lost.row == 20

    def clear(*heads: str) -> None:
        clear_for_arming(places, audit.record, by="Bea", now=EPOCH + 50, acknowledged=heads)

    for wrong in ((), (lost.head[:15],), ("0" * 64,), ("",)):
        with pytest.raises(ArmingError, match=f"--acknowledge-head {lost.head}"):
            clear(*wrong)
    assert read(config.audit) == []
    clear(lost.head[:16].upper())
    row, _ = read(config.audit)
    assert row.entry.kind == ACKNOWLEDGED and row.entry.who == "Bea" and row.entry.detail["head"] == lost.head
    verdict = examine(places)
    assert verdict.problem == "" and "Bea has acknowledged" in verdict.notes[0]
    clear()
    # What is acknowledged is that one chain's loss, not the next one's.
    assert audit.record(AuditEntry(EPOCH + 60, "write", "Ada"))
    countersign(places, EPOCH + 60)
    audit.close()
    raw(config.audit, "DELETE FROM audit WHERE id = 3")
    audit = open_audit(config.audit)
    with pytest.raises(ArmingError, match="row 3 was signed"):
        clear(lost.head)
    audit.close()


def test_an_acknowledgement_that_nobody_signed_for_excuses_nothing(tmp_path: Path) -> None:
    places = default_places(tmp_path / "audit.sqlite")
    audit = open_audit(places.audit)
    assert all(audit.record(AuditEntry(EPOCH + n, "write")) for n in range(5))
    countersign(places, EPOCH)
    audit.close()
    lost = examine(places)
    begun_anew(places.audit)
    forged = {"head": lost.head, "row": 5, "begin": json.loads(places.heads.read_text())["begin"]}
    appended(places.audit, AuditEntry(EPOCH, ACKNOWLEDGED, "Eve", "lost", forged))
    assert "row 5" in examine(places).problem
    # The gateway that runs signs a head each hour over whatever stands there, and vouches for no word by it.
    countersign(places, EPOCH + 3600.0)
    assert "row 5" in examine(places).problem


@pytest.mark.parametrize("harm", ["garbage", "cut", "one page", "mark", "short"])
async def test_a_damaged_log_is_set_aside_the_gateway_runs_and_does_not_arm(tmp_path: Path, harm: str) -> None:
    config, clock = config_in(tmp_path, **ARMED_BY_FILE), JumpClock()
    await go(config, clock, 40)
    with closing(sqlite3.connect(config.audit)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    data = bytearray(config.audit.read_bytes())
    page = int.from_bytes(data[16:18], "big")
    if harm == "garbage":
        data[:] = os.urandom(len(data))
    elif harm == "cut":
        del data[len(data) // 2 :]
    elif harm == "one page":
        data[3 * page : 4 * page] = b"\xa5" * page
    elif harm == "mark":
        data[68:72] = b"\0\0\0\0"
    else:
        del data[60:]
    config.audit.write_bytes(data)
    clock.time += 1.0
    status, bench = await go(config, clock)
    assert status["scan"]["count"] >= 14 and bench.written == [] and status["writeback"]["mode"] == "shadow"
    aside = [path for path in tmp_path.glob("audit.sqlite.damaged-*") if path.suffix not in ("-wal", "-shm")]
    assert [path.read_bytes() for path in aside] == [bytes(data)], "nothing of it is lost"
    (line,) = [row for row in logged(tmp_path) if row["event"] == "the audit log was damaged"]
    assert aside[0].name in line["reason"] and "\n" not in line["reason"]
    assert any(row["event"] == "not armed" and "--acknowledge-head" in row["reason"] for row in logged(tmp_path))
    # And again: the next start has a whole log, and still nobody has acknowledged anything.
    clock.time += 1.0
    assert (await go(config, clock))[0]["writeback"]["mode"] == "shadow"


def test_the_command_arms_with_the_acknowledgement_where_no_gateway_runs(tmp_path: Path) -> None:
    config, clock = config_in(tmp_path, **ARMED_BY_FILE), JumpClock()
    asyncio.run(go(config, clock))
    newest = examine(witness_places(config)).head
    begun_anew(config.audit)
    words = ["arm", *plant(config), "--by", "Ada", "--reason", "r", "--minutes", "5"]
    words += ["--records", str(tmp_path / "records.jsonl"), "--json"]
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code != 0 and newest in refused.output and "Traceback" not in refused.output
    assert not any(row.entry.kind == ARMED for row in read(config.audit))
    done = CliRunner().invoke(main, [*words, "--acknowledge-head", newest])
    assert done.exit_code == 0, done.output
    assert [row.entry.kind for row in read(config.audit)] == [ACKNOWLEDGED, CONFIRMED, ARMED, CONFIRMED]
    assert examine(witness_places(config)).witnessed == 4


def test_without_a_witness_it_is_said_that_the_end_is_not_witnessed(tmp_path: Path) -> None:
    places = default_places(tmp_path / "audit.sqlite")
    audit = open_audit(places.audit)
    audit.record(AuditEntry(EPOCH, "write"))
    audit.close()
    done = CliRunner().invoke(main, ["audit", "--audit", str(places.audit)])
    assert done.exit_code == 0 and "the end is not witnessed" in done.output and "is not there" in done.output
    countersign(places, EPOCH)
    done = CliRunner().invoke(main, ["audit", "--audit", str(places.audit)])
    assert "rows 1 to 1 are witnessed" in done.output and "1 signed heads" in done.output
    places.audit.unlink()
    gone = CliRunner().invoke(main, ["audit", "--audit", str(places.audit), "--last", "0"])
    assert gone.exit_code == 1 and "there is no audit log, and row 1 of one was signed" in gone.output


def test_a_key_that_others_could_use_is_refused_and_the_public_key_is_enough(tmp_path: Path) -> None:
    places = default_places(tmp_path / "audit.sqlite")
    audit = open_audit(places.audit)
    audit.record(AuditEntry(EPOCH, "write"))
    audit.close()
    countersign(places, EPOCH)
    assert places.key.stat().st_mode & 0o777 == 0o600
    elsewhere = tmp_path / "copy.pub"
    shutil.copy(public_path(places.key), elsewhere)
    command = ["audit", "--audit", str(places.audit)]
    for mode in (0o640, 0o604, 0o666):
        places.key.chmod(mode)
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 2 and f"mode {mode:04o}" in done.output and "--public-key" in done.output
        with pytest.raises(ArmingError, match="mode"):
            clear_for_arming(places, lambda _: None, by="Ada", now=EPOCH)
    assert CliRunner().invoke(main, [*command, "--public-key", str(elsewhere)]).exit_code == 0
    places.key.chmod(0o600)
    if os.geteuid() == 0:
        os.chown(places.key, 12345, 12345)
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 2 and "belongs to user 12345" in done.output
    places.key.unlink()
    done = CliRunner().invoke(main, [*command, "--public-key", str(elsewhere)])
    assert done.exit_code == 0 and "rows 1 to 1 are witnessed" in done.output
    load_or_make_key(tmp_path / "other.key")
    done = CliRunner().invoke(main, [*command, "--public-key", str(tmp_path / "other.pub")])
    assert "by another key" in done.output and "the end is not witnessed" in done.output
    for text in ("", "no key", "-----BEGIN PUBLIC KEY-----\nAAAA\n-----END PUBLIC KEY-----\n"):
        elsewhere.write_text(text)
        done = CliRunner().invoke(main, [*command, "--public-key", str(elsewhere)])
        assert done.exit_code == 2 and "holds no public key" in done.output
    places.key.write_text("no key")
    places.key.chmod(0o600)
    with pytest.raises(SigningKeyError, match="holds no private key"):
        load_key(places.key)
    places.key.unlink()
    places.key.symlink_to(tmp_path / "other.key")
    with pytest.raises(SigningKeyError):
        load_key(places.key)


def test_a_torn_line_of_heads_is_no_harm_and_a_changed_one_shows(tmp_path: Path) -> None:
    places = default_places(tmp_path / "audit.sqlite")
    audit = open_audit(places.audit)
    for number in range(3):
        audit.record(AuditEntry(EPOCH + number, "write"))
        countersign(places, EPOCH + number)
    audit.close()
    whole = places.heads.read_text()
    places.heads.write_text(whole[:-40])
    assert examine(places).problem == "" and examine(places).witnessed == 2
    countersign(places, EPOCH + 3)
    verdict = examine(places)
    assert verdict.witnessed == 3 and "1 heads are not signed rightly" in verdict.problem
    places.heads.write_text(whole.replace('"row": 2', '"row": 1'))
    assert "not signed rightly" in examine(places).problem


HOURS = {**ARMED_BY_FILE, "writeback__minutes": 480.0, "scan__period": 600.0}


class SigningClock(JumpClock):
    """A clock that does not jump while a head is being signed."""

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        while any(task.get_name() == "signing" for task in asyncio.all_tasks()):
            await asyncio.sleep(0.001)
        await super().sleep_until(moment, stop)


async def test_heads_are_signed_every_hour(tmp_path: Path) -> None:
    config, clock = config_in(tmp_path, **HOURS), SigningClock()
    await go(config, clock, 30)
    times = [json.loads(line)["time"] for line in config.audit_heads.read_text().splitlines()]
    gaps = [later - before for before, later in pairwise(times)]
    assert len(times) >= 6 and max(gaps) <= 4200.0


async def test_heads_come_one_after_the_other_where_the_clock_jumps_while_one_is_signed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = HeadWitnessing.sign

    asked: list[float] = []

    def slowly(self: HeadWitnessing, now: float, turn: int | None = None) -> None:
        # The hourly ones and that of the disarming are signed in threads, which may come late; the last one is not.
        sleep(0.05 if turn is not None and len(asked) % 2 else 0.0)
        asked.append(now)
        real(self, now, turn)

    monkeypatch.setattr(HeadWitnessing, "sign", slowly)
    config = config_in(tmp_path, **HOURS)
    await go(config, JumpClock(), 100)
    times = [json.loads(line)["time"] for line in config.audit_heads.read_text().splitlines()]
    assert len(times) >= 3 and times == sorted(times) and times[-1] == max(asked)


async def test_a_head_that_comes_late_is_left_to_the_later_one_also_where_the_clock_was_set_back(
    tmp_path: Path,
) -> None:
    """A thread that was late at the stop wrote its head of an hour ago behind the last one."""
    config = config_in(tmp_path, **ARMED_BY_FILE)
    await go(config, JumpClock())
    store, view = one_machine(config.historian.path)
    witnessing = HeadWitnessing(config, view, structlog.get_logger())
    first, second, third = (witnessing.turn() for _ in range(3))
    before = len(config.audit_heads.read_text().splitlines())
    for now, turn in ((EPOCH + 7200.0, second), (EPOCH + 3600.0, first), (EPOCH + 60.0, third), (EPOCH, first)):
        witnessing.sign(now, turn)
    assert store.close()
    times = [json.loads(line)["time"] for line in config.audit_heads.read_text().splitlines()[before:]]
    assert times == [EPOCH + 7200.0, EPOCH + 60.0]
    assert examine(witness_places(config)).problem == ""


@pytest.mark.parametrize("bad", ["a\nb", "a\x1b[2Jb", "a\u2028b", "a\x9bb", "a\ud800b"])
def test_no_control_character_reaches_the_audit_log(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "audit.sqlite"
    audit = open_audit(path)
    assert audit.record(AuditEntry(EPOCH, bad, bad, bad, {"x": bad, bad: [bad]})), "a row that can be stored"
    audit.close()
    with closing(sqlite3.connect(path)) as connection:
        (row,) = connection.execute("SELECT kind, who, reason, detail FROM audit").fetchall()
    assert all(text.isprintable() for text in row) and verify(path).problem == ""


async def test_a_running_gateway_takes_the_acknowledgement_over_its_socket(tmp_path: Path) -> None:
    config, clock = config_in(tmp_path, **ARMED_BY_FILE), JumpClock()
    await go(config, clock)
    newest = examine(witness_places(config)).head
    begun_anew(config.audit)
    clock.time += 1.0
    bench = Bench(config, clock, armed=True)
    running = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))

    async def asked(**keys: Any) -> dict[str, Any]:
        line = await asyncio.to_thread(connect, config.control_socket)
        assert line is not None
        try:
            return await asyncio.to_thread(line.ask, "arm", by="Bea", reason="r", minutes=5.0, **keys)
        finally:
            line.close()

    try:
        while bench.reads < 5:
            await asyncio.sleep(0.01)
        with pytest.raises(ControlError, match=f"--acknowledge-head {newest}"):
            await asked()
        with pytest.raises(ControlError, match="acknowledge"):
            await asked(acknowledge=newest)
        assert bench.written == []
        assert (await asked(acknowledge=[newest]))["by"] == "Bea"
        reads = bench.reads
        while bench.reads < reads + 10:
            await asyncio.sleep(0.01)
        assert bench.written
    finally:
        bench.stop.set()
        await asyncio.wait_for(running, 30.0)
    assert examine(witness_places(config)).problem == ""
