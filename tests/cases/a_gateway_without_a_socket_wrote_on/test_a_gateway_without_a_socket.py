"""A disarming on record reached no gateway that runs: without its control socket nobody could disarm it, or it wrote.

`plc disarm` asked at the socket, and where a lock showed that a gateway runs refused and recorded nothing; where none
showed it said "disarmed". So each commit of the audit log looks for what other programs have taken back, before the
row of a block, and a gateway says there that it has found it. Once the log had been begun anew, whose rows are numbered
from 1, what had been found in the former one took back every arming.
"""

import asyncio
import fcntl
import json
import shutil
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commission.writeback import arm
from gateway.machine.writing.arming import arm_in_log, disarm_in_log, sign_arming
from gateway.plant.app import run
from gateway.settings import Config
from gateway.store.audit import ARMED as ARMED_ROW
from gateway.store.audit import DISARMED, AuditEntry, read
from gateway.store.audit_damage import open_or_set_aside
from gateway.store.durable import DATABASE_SUFFIXES
from sim.plc.record.recording import read_recording
from tests.cases.the_end_of_the_audit_log.test_the_end_of_the_audit_log import appended
from tests.gateway.support import Bench, JumpClock, config_in, two_modes
from tests.rig.memory import folder_in_memory
from tests.rig.pair import make_rig, restless_trace

ARMED: dict[str, Any] = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 480.0,
}
SOONER, LATER = 6, 12


class Interrupted(Bench):
    """A device in whose reading before the scan SOONER something is done to the files."""

    deed: Callable[[], None] = staticmethod(lambda: None)
    before = -1

    async def read(self, tags: Any) -> Any:
        if self.reads == SOONER and self.before < 0:
            self.before = len(self.written)
            await asyncio.to_thread(self.deed)
        return await super().read(tags)


async def interrupted(config: Config, deed: Callable[[Interrupted], None]) -> tuple[dict[str, Any], Interrupted]:
    bench = Interrupted(config, JumpClock(), armed=True, stop_after=LATER)
    bench.deed = lambda: deed(bench)
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0), bench


@pytest.mark.parametrize("without_lock", [False, True], ids=["lock", "no lock"])
async def test_no_usable_block_follows_a_disarming_that_another_program_has_put_on_record(
    tmp_path: Path, without_lock: bool
) -> None:
    with folder_in_memory(tmp_path) as folder:
        config = config_in(folder, model=two_modes(), **ARMED)

        def disarm(bench: Interrupted) -> None:
            if without_lock:
                config.historian.path.with_name(f"{config.historian.path.name}.lock").unlink()
            assert disarm_in_log(config.audit, "Bea", "by hand", bench.clock.now(), subject=config.subject)

        status, bench = await interrupted(config, disarm)
        assert bench.before > 3, "it was armed and wrote"
        assert [block["validity"] for block in bench.written[bench.before :]] in ([0], [])
        assert status["writeback"]["mode"] == "shadow"
        last = [row.entry for row in read(config.audit) if row.entry.kind == DISARMED]
        if not without_lock:
            assert [entry.who for entry in last] == ["Bea", "Ada"] and "Bea took the arming back" in last[-1].reason
        assert "pid" in last[0].detail and "pid" not in last[-1].detail


async def test_what_is_said_of_another_machine_or_before_it_was_armed_is_not_for_it(tmp_path: Path) -> None:
    with folder_in_memory(tmp_path) as folder:
        config = config_in(folder, model=two_modes(), **ARMED)
        disarm_in_log(config.audit, "Bea", "long ago", 0.0, subject=config.subject)
        deed = lambda bench: disarm_in_log(config.audit, "Bea", "another", bench.clock.now(), subject="other") and None  # noqa: E731
        status, bench = await interrupted(config, deed)
        assert status["writeback"]["mode"] == "armed" and len(bench.written) >= LATER - 3


def test_a_gateway_that_cannot_be_asked_is_disarmed_by_its_audit_log(tmp_path: Path) -> None:
    rig = make_rig(tmp_path, restless_trace(60.0), period=0.1)
    sockets = tmp_path / "sockets"
    with rig.plant.open("a", encoding="utf-8") as plant:
        plant.write(f"[control]\npath = {json.dumps(str(sockets / 'gateway.sock'))}\n")
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(lambda status: status["writeback"].get("accepted", 0) > 5)
        # Removed, and another one cannot be made there.
        shutil.rmtree(sockets)
        sockets.write_text("", encoding="utf-8")
        done = CliRunner().invoke(main, ["disarm", "--config", str(rig.plant), "--by", "Bea", "--json"])
        replied = time.time()
        said = json.loads(done.stdout.splitlines()[-1])
        assert done.exit_code == 0 and said["was_armed"], done.output
        assert "has found it in the audit log" in said["said"]
        scans = gateway.status["scan"]["count"]
        status = gateway.wait_for(lambda status: status["scan"]["count"] > scans + 5)
        assert status["writeback"]["mode"] == "shadow"
    usable = [block for block in read_recording(rig.recording).blocks if block.fields and block.fields["validity"]]
    assert usable and all(block.time < replied for block in usable)


@pytest.mark.parametrize("lost", [True, False], ids=["begun anew", "a copy"])
def test_what_was_taken_back_in_a_log_that_is_lost_is_not_held_against_a_new_one(tmp_path: Path, lost: bool) -> None:
    path, copy = tmp_path / "audit.sqlite", tmp_path / "copy"
    audit, deadline = open_or_set_aside(path), time.monotonic() + 60.0
    try:
        assert audit.record(AuditEntry(0.0, ARMED_ROW, "Ada", "test", {"until": 9.0}))
        appended(path, AuditEntry(1.0, DISARMED, "Bea", "by hand"))
        assert audit.record(AuditEntry(2.0, "test", "Ada"))
        found = audit.ended_elsewhere[""]
        assert (found.who, found.row) == ("Bea", 2)
        with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
            source.backup(target)
        for suffix in DATABASE_SUFFIXES:
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        if not lost:
            copy.rename(path)
        while not (row := audit.record(AuditEntry(3.0, "test", "Ada"))):
            assert time.monotonic() < deadline, audit.failure
        assert row.id == (1 if lost else 4)
        assert audit.ended_elsewhere == ({} if lost else {"": found})
    finally:
        audit.close()


def test_where_a_gateway_runs_that_says_nothing_the_command_says_that_it_is_not_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arm, "_TAKEN_S", 0.2)
    monkeypatch.setattr(arm, "_TAKEN_PERIODS", 0.0)
    config = config_in(tmp_path, model=two_modes(), writeback__mode="shadow")
    arm_in_log(config.audit, sign_arming("Ada", "test", 60.0, time.time()), time.time(), key=config.audit_key)
    lock = config.historian.path.with_name(f"{config.historian.path.name}.lock")
    words = ["disarm", "--config", str(config.path), "--by", "Bea"]
    with lock.open("wb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        done = CliRunner().invoke(main, words)
    assert done.exit_code == 1 and "NOT known" in done.output and "disarmed;" not in done.output
    assert [row.entry.who for row in read(config.audit, [DISARMED])] == ["Bea"], "on record all the same"
