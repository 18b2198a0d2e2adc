"""Killing PLC and gateway again and again at drawn moments corrupts nothing and loses nothing that was committed.

`python -m benchmarks.kills` does it a thousand times.
"""

import random
import signal
import sqlite3
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from benchmarks.fault_matrix import TOLERANCE_S, outside
from gateway.machine.writing.writeback import WRITE
from gateway.settings import load_device
from gateway.store.audit import read, verify
from gateway.store.read_back import samples
from sim.plc.program.writeback import ACCEPTED_REASON, CHALLENGE, WRITER
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import BlockRow, PlcRecording, read_recording
from tests.rig.blocks import old_numbers, unaccounted
from tests.rig.pair import FOLLOWING, MAP, PATIENCE_S, Gateway, Plc, Rig, end, make_rig, restless_trace

KILLS, SEED, PERIOD = 5, 16, 0.1
VICTIMS = ("plc", "gateway", "both")
EARLY = 0.25
"""The share of kills that do not wait for the gateway to be well: they strike while it starts or connects."""
TABLES = ("scans", "samples", "predictions", "forecasts", "events", "alarms", "writes", "audit", "runs")
PACKED = "chunks"
"""Of each table how many rows are packed; there are some once a run on a busy machine was long."""

Rows = dict[str, Counter[tuple[object, ...]]]


def committed(historian: Path) -> Rows:
    """Every row that a reader can see, in all tables but `state`, which is replaced by design."""
    with closing(sqlite3.connect(f"{historian.as_uri()}?mode=ro", uri=True, timeout=10.0)) as connection:
        connection.execute("BEGIN")
        known = {str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        rows = {table: Counter(connection.execute(f"SELECT * FROM {table}")) for table in TABLES if table in known}  # noqa: S608
        packed = "SELECT kind, sum(rows) FROM chunks GROUP BY kind"
        return rows | {PACKED: Counter({(kind,): int(count) for kind, count in connection.execute(packed)})}


def lost(before: Rows, after: Rows) -> dict[str, int]:
    """How many rows of each table are there no more, nor in the chunks into which the historian packs what is older."""
    packed = after.get(PACKED, Counter()) - before.get(PACKED, Counter())
    missing = {
        table: (rows - after.get(table, Counter())).total() - packed[(table,)]
        for table, rows in before.items()
        if table != PACKED
    }
    return {table: count for table, count in missing.items() if count > 0}


def held_on(blocks: Sequence[BlockRow]) -> int:
    """How many blocks carried a challenge that had been refused already: their gateway did not read the new one."""
    refused = Counter(row.fields["challenge"] for row in blocks if row.verdict == CHALLENGE and row.fields is not None)
    return sum(count - 1 for count in refused.values())


@dataclass
class Bench:
    """The pair of processes, how they are killed and brought back, and what was seen on the way."""

    rig: Rig
    plc: Plc
    gateway: Gateway
    seen: Rows = field(default_factory=dict)
    losses: list[dict[str, int]] = field(default_factory=list)
    ended_by_itself: list[str] = field(default_factory=list)

    def busy(self, rows: int) -> None:
        """Wait until more than so many scans and writes are on record: where kills were early there is little else."""
        deadline = time.monotonic() + PATIENCE_S
        while min((kept := committed(self.rig.historian))["scans"].total(), kept["writes"].total()) <= rows:
            assert time.monotonic() < deadline, {table: found.total() for table, found in kept.items()}
            time.sleep(0.2)

    def well(self) -> None:
        """Wait until good readings arrive and blocks are confirmed."""
        self.gateway.wait_for(
            lambda status: status["link"]["alive"] and status["writeback"].get("last_verdict") in ("written", "shadow")
        )

    def check(self) -> None:
        """Compare what is committed now with what was seen before."""
        if self.rig.historian.exists():
            now = committed(self.rig.historian)
            if missing := lost(self.seen, now):
                self.losses.append(missing)
            self.seen = now

    def kill(self, victim: str) -> None:
        """SIGKILL the victims at once, look at the historian, and start them again as they were."""
        self.check()
        gateway = [] if victim == "plc" else [self.gateway.process]
        plc = [] if victim == "gateway" else [self.plc.process]
        for process in (*plc, *gateway):
            if process.poll() is not None:
                self.ended_by_itself.append(f"exit code {process.returncode}")
            with suppress(ProcessLookupError):
                process.send_signal(signal.SIGKILL)
        for process in (*plc, *gateway):
            end(process)
        self.check()
        if plc:
            self.plc = self.rig.start_plc(*self._as_before())
        if gateway:
            self.gateway = self.rig.start_gateway(self.plc)

    def _as_before(self) -> list[str]:
        ready = self.plc.ready
        position = time.monotonic() - ready["monotonic"]
        clock = ["--epoch", repr(ready["epoch"]), "--monotonic", repr(ready["monotonic"])]
        return ["--port", str(ready["port"]), *clock, "--offset", repr(position)]


@dataclass(frozen=True)
class Aftermath:
    """What was left after all kills and a clean stop of both."""

    rig: Rig
    kills: Counter[str]
    losses: list[dict[str, int]]
    ended_by_itself: list[str]
    exit_code: int
    recording: PlcRecording


def many_kills(folder: Path, count: int = KILLS, seed: int = SEED, mode: str = "armed") -> Aftermath:
    """Kill `count` times and start again; then stop both as one should."""
    rng, kills = random.Random(seed), Counter[str]()
    rig = make_rig(folder, restless_trace(40.0 * count), period=PERIOD, mode=mode, noise=FOLLOWING)
    plc = rig.start_plc()
    bench = Bench(rig, plc, rig.start_gateway(plc))
    try:
        for _ in range(count):
            if rng.random() >= EARLY:
                bench.well()
            time.sleep(rng.uniform(0.05, 1.5))  # within a batch of the historian, and beyond it
            victim = rng.choice(VICTIMS)
            kills[victim] += 1
            bench.kill(victim)
        bench.well()
        bench.busy(14 * count)
        code, _ = bench.gateway.stop()
        bench.check()
        bench.plc.order("stop")
        bench.plc.wait_for("stopped")
    finally:
        end(bench.gateway.process)
        end(bench.plc.process)
    return Aftermath(rig, kills, bench.losses, bench.ended_by_itself, code, read_recording(rig.recording))


def assert_they_came_back(aftermath: Aftermath) -> None:
    """None was refused by what a killed one had left, and both stopped cleanly at the end."""
    assert aftermath.kills.total() == KILLS and set(aftermath.kills) == set(VICTIMS)
    assert aftermath.ended_by_itself == [], "none was refused by what a killed one had left (lock, file, port)"
    assert aftermath.exit_code == 0


def assert_nothing_committed_was_lost(aftermath: Aftermath) -> None:
    """Every row that a reader had seen is there, unchanged."""
    assert aftermath.losses == []
    final = committed(aftermath.rig.historian)
    assert final["scans"].total() > 8 * KILLS and final["writes"].total() > 8 * KILLS


def assert_the_historian_is_whole_and_in_order(aftermath: Aftermath) -> None:
    """SQLite finds nothing wrong; ids and times rise together; nothing is there twice."""
    with closing(sqlite3.connect(aftermath.rig.historian)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
        # Of a block that was refused here the number is not used up: the last word, of the same scan, has it again.
        writes = connection.execute("SELECT time, sequence, validity FROM writes ORDER BY id").fetchall()
        events = [row[0] for row in connection.execute("SELECT time FROM events ORDER BY id")]
        runs = connection.execute("SELECT count(*) FROM runs").fetchone()[0]
    assert len(writes) == len(set(writes))
    times = [row[0] for row in writes]
    assert times == sorted(times) and events == sorted(events)
    assert runs > aftermath.kills["gateway"] / 2


def assert_whole_blocks_each_once_and_nothing_outside(aftermath: Aftermath) -> None:
    """No torn block, none twice, no other address; the last word was validity 0."""
    recording = aftermath.recording
    assert outside(recording) == 0
    written = [row for row in recording.requests if row.function == 16]
    assert max(Counter((row.peer, row.transaction, row.pdu) for row in written).values()) == 1
    refused = Counter(block.verdict for block in recording.blocks if not block.accepted)
    ended = aftermath.kills["gateway"] + aftermath.kills["both"]
    # The session of a gateway that was killed stands until the PLC's timer runs out. Where that falls between a scan of
    # the next gateway and its block, the block carries the challenge before; the scan after it reads the new one.
    assert set(refused) <= {WRITER, CHALLENGE}
    timer = load_device(MAP).writeback.timeout  # type: ignore[union-attr]
    assert refused[WRITER] <= ended * (timer / PERIOD + 1)
    assert refused[CHALLENGE] <= ended and held_on(recording.blocks) == 0
    with closing(sqlite3.connect(aftermath.rig.historian)) as connection:
        validity, verdict = connection.execute("SELECT validity, verdict FROM writes ORDER BY id DESC").fetchone()
    assert validity == 0
    # On a computer that stands still the permit may just then be too old to be believed: nothing is sent without it.
    if verdict != "not permitted":
        assert recording.blocks[-1].fields is not None and recording.blocks[-1].fields["validity"] == 0


def assert_no_block_without_its_audit_row(aftermath: Aftermath) -> None:
    """Whatever was killed when: every block that the PLC was sent is in the audit log, word by word, and the chain is
    whole."""
    audit = aftermath.rig.records / "audit.sqlite"
    on_record = {row.entry.detail["words"] for row in read(audit, [WRITE])}
    sent = [row.pdu[6:].hex() for row in aftermath.recording.requests if row.function == 16]
    assert len(sent) > 2 * KILLS and [words for words in sent if words not in on_record] == []
    assert verify(audit).problem == ""


def assert_the_recording_is_readable(aftermath: Aftermath) -> None:
    """It lacks nothing but half a last line for each killed PLC at most."""
    killed = aftermath.kills["plc"] + aftermath.kills["both"]
    assert len(aftermath.recording.runs) == killed + 1
    assert aftermath.recording.damaged <= killed
    assert aftermath.recording.missing == 0


def assert_no_wrong_value_was_good(aftermath: Aftermath) -> None:
    """The PLC's recordings, one after the other, are the judge."""
    read = list(samples(aftermath.rig.historian))
    assert sum(sample.quality.is_good for sample in read) > 80 * KILLS
    assert wrong_good(aftermath.recording, read, TOLERANCE_S) == []


def assert_each_block_has_its_row_and_none_spoke_of_the_past(aftermath: Aftermath) -> None:
    """Also that the check would see it: the same blocks ten seconds later are of the past."""
    recording = aftermath.recording
    assert unaccounted(recording, aftermath.rig.records / "audit.sqlite") == 0
    assert old_numbers(recording) == 0
    assert (
        old_numbers(replace(recording, blocks=[replace(row, time=row.time + 10.0) for row in recording.blocks]))
        > 2 * KILLS
    )


def test_the_check_tells_lost_and_changed_rows_from_new_ones() -> None:
    before: Rows = {"scans": Counter({(1.0, 0): 1, (2.0, 0): 1}), "runs": Counter()}
    assert lost(before, {"scans": Counter({(1.0, 0): 1, (2.0, 0): 1, (3.0, 0): 1})}) == {}
    assert lost(before, {"scans": Counter({(1.0, 0): 1, (2.0, 9): 1})}) == {"scans": 1}
    assert lost(before, {}) == {"scans": 2}


def test_the_check_tells_a_session_that_ended_on_the_way_from_a_gateway_that_goes_on_with_it() -> None:
    def row(challenge: float, verdict: str) -> BlockRow:
        return BlockRow(0.0, 0.0, "", 0, (), {"challenge": challenge}, verdict, verdict == ACCEPTED_REASON)

    assert held_on([row(1, WRITER), row(1, WRITER), row(1, CHALLENGE), row(2, ACCEPTED_REASON), row(2, CHALLENGE)]) == 0
    assert held_on([row(1, ACCEPTED_REASON), row(1, CHALLENGE), row(1, CHALLENGE), row(1, CHALLENGE)]) == 2


@pytest.mark.timeout(1200)
def test_many_kills_of_plc_and_gateway_corrupt_nothing_and_lose_nothing_committed(tmp_path: Path) -> None:
    aftermath = many_kills(tmp_path)
    assert_they_came_back(aftermath)
    assert_nothing_committed_was_lost(aftermath)
    assert_the_historian_is_whole_and_in_order(aftermath)
    assert_whole_blocks_each_once_and_nothing_outside(aftermath)
    assert_no_block_without_its_audit_row(aftermath)
    assert_the_recording_is_readable(aftermath)
    assert_no_wrong_value_was_good(aftermath)
    assert_each_block_has_its_row_and_none_spoke_of_the_past(aftermath)
