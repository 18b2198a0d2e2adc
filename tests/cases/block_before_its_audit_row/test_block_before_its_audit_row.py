"""A killed gateway had sent blocks that the audit log did not know: their rows were still on the way to the disk."""

import sqlite3
from pathlib import Path

from drivers.driver import BeforeSending, anyhow
from gateway.store.audit import Audit, AuditEntry, open_audit, read
from tests.cases.refused_arming_took_effect_later.test_refused_arming_took_effect_later import refusing
from tests.gateway.test_writeback import USABLE, Wire, armed, scan


class Witness(Wire):
    """Asks, at the very moment of sending, what a gateway that is killed now would leave behind."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.on_record: list[bool] = []

    async def write(self, values: list[tuple[object, int]], *, before_sending: BeforeSending = anyhow) -> None:
        before_sending()
        words = "".join(f"{value:04x}" for _, value in values)
        self.on_record.append(any(row.entry.detail.get("words") == words for row in read(self.path, ["write"])))
        await super().write(values)


async def test_every_block_is_on_the_disk_before_it_is_on_the_wire(tmp_path: Path) -> None:
    writer, _ = await armed()
    audit = writer.audit = open_audit(tmp_path / "audit.sqlite")
    wire = Witness(audit.path)
    await wire.soft.open()
    assert writer.arming is not None
    writer.arm(wire, writer.arming)
    for _ in range(50):
        await writer.offer(scan(), {}, USABLE)
    await writer.withdraw(scan())
    assert wire.on_record == [True] * 51
    assert audit.close()


async def test_a_disk_that_is_slow_costs_the_block_and_not_the_scan(tmp_path: Path) -> None:
    writer, wire = await armed()
    audit = writer.audit = open_audit(tmp_path / "audit.sqlite")
    with refusing(audit, busy_ms=5000):
        attempt = await writer.offer(scan(), {}, USABLE)
        assert attempt is not None and attempt.verdict == "held back" and "audit log" in attempt.reason
        last = await writer.withdraw(scan())
        assert last is not None and last.verdict == "written", "what takes everything back is not kept by a disk"
    written = await writer.offer(scan(), {}, USABLE)
    assert written is not None and written.verdict == "written"
    assert [block[3] for block in wire.blocks] == [0, 31] and audit.close()
    rows = [(row.entry.kind, row.entry.detail["sequence"]) for row in read(audit.path)]
    assert sorted(rows) == [("write", 1), ("write", 2), ("write refused", 1)], "what did not leave is no write"


def test_rows_that_nobody_waits_for_share_a_commit(tmp_path: Path) -> None:
    audit = open_audit(tmp_path / "audit.sqlite")
    commits: list[str] = []
    audit._connection.set_trace_callback(lambda sql: commits.append(sql) if sql == "BEGIN IMMEDIATE" else None)
    for number in range(200):
        audit.put(AuditEntry(float(number), "write refused"))
    assert audit.close() and len(read(audit.path)) == 200
    assert len(commits) <= 2


def test_a_log_of_before_goes_on_with_its_larger_pages(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    made = open_audit(path)
    assert made.close()
    raw = sqlite3.connect(path, isolation_level=None)
    assert raw.execute("PRAGMA page_size").fetchone() == (1024,)
    raw.execute("PRAGMA journal_mode = DELETE")
    raw.execute("PRAGMA page_size = 4096")
    raw.execute("VACUUM")
    raw.execute("DROP INDEX audit_armings")
    raw.execute("CREATE INDEX audit_by_kind ON audit (kind, id)")
    raw.close()
    audit: Audit = open_audit(path)
    assert audit.record(AuditEntry(1.0, "write")) and audit.close()
