"""Kills of small writers of the records, by the thousand: what was promised, and what of it is there.

A writer puts rows into a historian and an audit log as the gateway does, and says of each that it is promised: of an
entry once `Audit.record` has given its row, of measurements and alarms once `Historian.flush` has said that they are
committed. It is killed with SIGKILL at a drawn moment, also while it opens what the one before has left, and after each
kill every promise of all writers of these files is looked up, the chain verified, and SQLite asked for damage.
`benchmarks.kills` kills the whole gateway, which takes longer.
"""

import multiprocessing
import sqlite3
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

import click

from benchmarks.figures import Figure, give
from drivers.tag import Quality, Tag
from gateway.console import progress
from gateway.store import open_historian, reading, stored_rows
from gateway.store.audit import AuditEntry, open_audit, read, verify

TURN = 25
"""Kills of writers of the same files; then others are begun."""
EARLY = 0.25
"""The share of kills that do not wait for a first promise: they strike while the files are opened."""
LONGEST_S = 0.4
"""Seconds for which a writer writes, at most."""
ROWS = 5
"""Rows of measurements before each flush."""
PATIENCE_S = 120.0
_KIND = "block"
_BATCH = 1_000_000
"""Numbers that each writer may use."""
_AUDIT, _HISTORIAN = 0, 1


@dataclass(slots=True)
class Kept:
    """What has been promised of these files, and what was found wrong."""

    kills: int = 0
    entries: set[int] = field(default_factory=set)
    rows: set[int] = field(default_factory=set)
    promised: int = 0
    there: int = 0
    wrong: list[str] = field(default_factory=list)


def write(folder: str, first: int, promises: Connection) -> None:
    """Write until killed, numbers from `first` on, and say each that is promised."""
    path = Path(folder)
    audit, store = open_audit(path / "audit.sqlite"), open_historian(path / "historian.sqlite")
    view = store.view("one", [Tag("t", "holding:0", unit="degC")])
    number = first
    while True:
        for _ in range(ROWS):
            number += 1
            moment = float(number)
            if audit.record(AuditEntry(moment, _KIND, detail={"number": number})) is not None:
                promises.send((_AUDIT, number))
            view.put("scans", [(moment, 0.01, 0)])
            view.put("samples", [("t", moment, moment, int(Quality.GOOD), moment)])
            view.put("alarms", [(moment, "high", "t", 1, "unacknowledged", moment, "")])
        if store.flush():
            promises.send((_HISTORIAN, number))


def missing(folder: Path, kept: Kept) -> list[str]:
    """What is wrong with the files, and which promise they do not keep; counts those that they do."""
    found = []
    audit, historian = folder / "audit.sqlite", folder / "historian.sqlite"
    if kept.entries:
        entries = {int(row.entry.detail["number"]) for row in read(audit, [_KIND])}
        kept.there += len(kept.entries & entries)
        found += [f"entry {number} of the audit log is lost" for number in sorted(kept.entries - entries)]
        if problem := verify(audit).problem:
            found.append(f"the chain: {problem}")
    if kept.rows:
        with closing(sqlite3.connect(historian)) as connection:
            if (said := connection.execute("PRAGMA quick_check").fetchone()[0]) != "ok":
                found.append(f"the historian: {said}")
        with reading(historian) as connection:
            for table in ("scans", "samples", "alarms"):
                times = [int(row[0]) for row in stored_rows(connection, table, ("time",), machine="one")]
                kept.there += len(kept.rows & set(times))
                found += [f"row {number} of {table} is lost" for number in sorted(kept.rows - set(times))]
                if len(times) != len(set(times)):
                    found.append(f"rows of {table} are there twice")
    kept.promised += len(kept.entries) + 3 * len(kept.rows)
    return found


def killed(folder: Path, count: int, rng: Random) -> Kept:
    """Let so many writers write into the same files, one after the other, and kill each of them."""
    kept, context = Kept(), multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    for turn in range(count):
        ours, theirs = context.Pipe(duplex=False)
        first = _BATCH * (turn + 1)
        writer = context.Process(target=write, args=(str(folder), first, theirs), daemon=True)
        writer.start()
        theirs.close()
        late = rng.random() >= EARLY
        if late and not ours.poll(PATIENCE_S):
            kept.wrong.append(f"writer {turn} promised nothing within {PATIENCE_S:g} s")
        time.sleep(rng.uniform(0.0, LONGEST_S))
        if writer.exitcode is not None:
            kept.wrong.append(f"writer {turn} ended by itself with {writer.exitcode}")
        writer.kill()
        writer.join()
        kept.kills += 1
        _take(ours, kept, first)
        kept.wrong += missing(folder, kept)
    return kept


def _take(promises: Connection, kept: Kept, first: int) -> None:
    """All that a writer has promised until its end."""
    with promises:
        while True:
            try:
                what, number = promises.recv()
            except (EOFError, OSError):  # OSError: killed in the middle of a word
                return
            if what == _AUDIT:
                kept.entries.add(number)
            else:
                kept.rows.update(range(first + 1, number + 1))


def total(turns: Sequence[Kept]) -> list[Figure]:
    """The figures of all turns."""
    kills = float(sum(one.kills for one in turns))
    entries, rows = (float(sum(len(getattr(one, key)) for one in turns)) for key in ("entries", "rows"))
    return [
        Figure("what was found wrong", float(sum(len(one.wrong) for one in turns)), "", "kills", kills),
        Figure("promised audit entries", entries, "", "kills", kills),
        Figure("promised scans, readings and alarms", 3 * rows, "", "kills", kills),
        Figure(
            "promises that were there, looked up after each kill", float(sum(one.there for one in turns)), "",
            "looked up", float(sum(one.promised for one in turns)),
        ),
    ]  # fmt: skip


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Ten kills.")
@click.option("--count", default=1000, show_default=True, type=click.IntRange(1), help="Kills.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of the moments.")
def main(as_json: bool, quick: bool, count: int, seed: int) -> None:
    left, rng, turns = 10 if quick else count, Random(seed), list[Kept]()
    with progress("kills") as report:
        for begin in range(0, left, TURN):
            with tempfile.TemporaryDirectory(prefix="decanter-record-kills-") as name:
                turns.append(killed(Path(name), min(TURN, left - begin), rng))
            for sentence in turns[-1].wrong[:3]:
                click.echo(sentence, err=True)
            report("killing", min(begin + TURN, left) / left)
    give("kills of writers of the records", total(turns), as_json=as_json)


if __name__ == "__main__":
    main()
