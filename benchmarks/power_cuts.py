"""Power cuts at drawn moments: what of the gateway's records a disk still has that loses whatever was not synced.

An armed gateway works against the software PLC; a journal is kept of what it does to its files, from which the disk
after a cut at any moment is made up (`tests.rig.power_cut`). Of each such disk it is asked: does the audit chain
verify, has every block that the PLC had received its row, does SQLite find nothing wrong with the historian, and has it
the row of every block of more than two seconds before? The last is asked with that grace, since blocks come to the
historian with the batch of their second; the audit log has them before they are sent.
"""

import sqlite3
import tempfile
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from struct import pack

import click

from benchmarks.figures import Figure, give
from gateway.machine.writing import WRITE
from gateway.store.audit import AuditError, open_audit, read, verify
from gateway.store.read_back import stored_rows
from sim.plc.record.recording import PlcRecording, read_recording
from tests.rig.pair import make_rig, restless_trace
from tests.rig.power_cut import DiskCall, DiskChange, build, disk_after, environment, read_journal, write_disk

PERIOD = 0.1
GRACE_S = 2.0


@dataclass(frozen=True, slots=True)
class Aftermath:
    """The run that was cut: what the gateway did to the files of `records`, and what the PLC saw of it."""

    records: Path
    changes: Sequence[DiskChange]
    recording: PlcRecording


def worked(folder: Path, seconds: float) -> Aftermath:
    """Let an armed gateway write for so many seconds, and kill it."""
    records = folder / "records"
    records.mkdir()
    journal = folder / "journal"
    rig = make_rig(folder, restless_trace(seconds + 60.0), period=PERIOD, records=records)
    rig = replace(rig, environment=environment(build(folder), records, journal))
    with rig.plc() as plc:
        with rig.gateway(plc) as gateway:
            gateway.wait_for(lambda status: status["writeback"].get("written", 0) > seconds / PERIOD)
        plc.order("stop")
        plc.wait_for("stopped")
    return Aftermath(records, read_journal(journal), read_recording(rig.recording))


def found_wrong(aftermath: Aftermath, moment: float, rng: Random, folder: Path) -> list[str]:
    """What a cut at `moment` (s, monotonic) would leave wrong; nothing, if all is as it should be."""
    write_disk(disk_after(aftermath.changes, moment, rng), aftermath.records, folder)
    return [*_audit(aftermath, moment, folder), *_historian(aftermath, moment, folder)]


def _audit(aftermath: Aftermath, moment: float, folder: Path) -> list[str]:
    sent = {
        pack(f">{len(row.words)}H", *row.words).hex() for row in aftermath.recording.blocks if row.monotonic < moment
    }
    path = folder / "audit.sqlite"
    if not path.exists():
        return ["the audit log is gone"] if sent else []
    try:
        open_audit(path).close()  # as a gateway that starts again
        verdict = verify(path)
        known = {row.entry.detail["words"] for row in read(path, [WRITE])}
    except AuditError as error:
        return [str(error)] if sent else []
    return [
        *([f"the chain: {verdict.problem}"] if verdict.problem else []),
        *(f"a block has no row: {words}" for words in sorted(sent - known)),
    ]


def _historian(aftermath: Aftermath, moment: float, folder: Path) -> list[str]:
    path = folder / "historian.sqlite"
    before = [row for row in aftermath.recording.blocks if row.monotonic < moment - GRACE_S]
    if not path.exists():
        return ["the historian is gone"] if before else []
    try:
        with closing(sqlite3.connect(path)) as connection:
            found = connection.execute("PRAGMA integrity_check").fetchone()[0]
            known = {bytes(words) for _, words in stored_rows(connection, "writes", ("time", "words"))}
    except sqlite3.Error as error:
        return [f"the historian: {error}"] if before else []
    lost = [row for row in before if pack(f">{len(row.words)}H", *row.words) not in known]
    return [
        *([f"the historian: {found}"] if found != "ok" else []),
        *(f"a write of {row.time:.2f} is gone" for row in lost),
    ]


def cuts(aftermath: Aftermath, count: int, seed: int, folder: Path) -> dict[int, list[str]]:
    """What was wrong, by the number of the cut."""
    rng = Random(seed)
    first, last = aftermath.changes[0].time, aftermath.changes[-1].time
    wrong = {}
    for number in range(count):
        where = folder / f"cut{number}"
        where.mkdir()
        if found := found_wrong(aftermath, rng.uniform(first, last), rng, where):
            wrong[number] = found
    return wrong


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="20 cuts of 3 seconds.")
@click.option("--count", default=200, show_default=True, type=click.IntRange(1), help="Cuts.")
@click.option("--seconds", default=20.0, show_default=True, type=click.FloatRange(1.0), help="How long it writes.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of the moments.")
def main(as_json: bool, quick: bool, count: int, seconds: float, seed: int) -> None:
    with tempfile.TemporaryDirectory(prefix="decanter-cuts-") as name:
        aftermath = worked(Path(name), 3.0 if quick else seconds)
        wrong = cuts(aftermath, 20 if quick else count, seed, Path(name))
    for number, sentences in wrong.items():
        click.echo(f"cut {number}: {'; '.join(sentences[:3])}", err=True)
    syncs = sum(change.kind is DiskCall.SYNC for change in aftermath.changes)
    blocks = len(aftermath.recording.blocks)
    figures = [
        Figure("cuts that left something wrong", float(len(wrong)), "", "cuts", float(20 if quick else count)),
        Figure("syncs", float(syncs), "", "blocks", float(blocks)),
        Figure("bytes written a block", sum(len(each.data) for each in aftermath.changes) / blocks, "B"),
    ]
    give("power cuts", figures, as_json=as_json)


if __name__ == "__main__":
    main()
