"""`decanter trace ingest`: a folder of files from elsewhere into an archive, once or as long as it is watched."""

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass, field
from errno import EDQUOT, ENOSPC, EROFS
from math import inf
from pathlib import Path
from typing import Any

import click

from drivers.errors import DriverError
from gateway.console import CommandResult, Line, Part, conclude, config_dir, progress, shipped_file
from gateway.entry import interruptible, sentence, sentences
from gateway.lab.ingestion.archive import (
    VERDICTS,
    IngestArchive,
    IngestOutcome,
    PassingError,
    open_archive,
    refuse_open,
)
from gateway.lab.ingestion.recognising import FileStamps, IngestUnit, RecognisedUnit, list_units, recognise
from sim.files import check_utf8, file_error, resolve_links
from sim.lab.recordings import ColumnMap, load_map

MAX_KEPT_OUTCOMES = 10_000
"""Outcomes that a watch keeps for its summary: it may run for months."""
TURN_SECONDS = 10.0
"""How long those behind it wait for the reading of a unit."""
MAX_CONCURRENT_UNITS = 2
"""Units that are read beside the others: each takes memory, and its share of the processor."""
NO_ARCHIVE = (ENOSPC, EDQUOT, EROFS)
"""What a system says of a disk that takes no file at all; anything else is about the one file."""


@dataclass(frozen=True, slots=True)
class ReadingUnit:
    """A unit that a thread of its own reads: `known` gives what it is once that is done, or raises as `recognise`.

    It was as `stamp` says when that was begun.
    """

    unit: IngestUnit
    stamp: FileStamps
    known: "Future[RecognisedUnit]"


Beside = dict[Path, ReadingUnit]
"""What is read beside the others, since it takes longer than they wait for it; by the units' sources."""


def _begin_reading(unit: IngestUnit, maps: dict[str, ColumnMap]) -> ReadingUnit:
    """Raises OSError where the unit is not there."""
    known: Future[RecognisedUnit] = Future()

    def read() -> None:
        try:
            known.set_result(recognise(unit, maps))
        except BaseException as error:  # noqa: BLE001 - it is raised where the result is asked for
            known.set_exception(error)

    reading = ReadingUnit(unit, unit.stamp(), known)
    # Of a command that is stopped nobody waits for what it was reading.
    threading.Thread(target=read, name=f"reading {unit.source.name}", daemon=True).start()
    return reading


def ingest_units(
    units: Sequence[IngestUnit],
    archive: IngestArchive,
    maps: dict[str, ColumnMap],
    *,
    move: bool,
    clock: Callable[[], float],
    beside: Beside | None = None,
) -> Iterator[IngestOutcome]:
    """What becomes of each unit, as it comes; `clock` gives s UTC. Raises OSError where the disk takes no file.

    A unit whose reading takes longer than TURN_SECONDS goes on beside those behind it. With `beside`, which has such
    ones of before, what is not done at the end is left there; without it all are waited for.
    """
    waiting = {} if beside is None else beside

    def process(unit: IngestUnit, reading: ReadingUnit | None) -> IngestOutcome | None:
        """What becomes of a unit, or of one that was read; None where it is read beside the others from now on."""
        try:
            if reading is None:
                if not unit.refusal:
                    refuse_open(unit)
                if (there := archive.again(unit, move=move)) is not None:
                    return there
                reading = _begin_reading(unit, maps)
                wait((reading.known,), TURN_SECONDS)
                if not reading.known.done():
                    waiting[unit.source] = reading
                    return None
            known = reading.known.result()
            if unit.stamp() != reading.stamp:
                raise PassingError(f"{unit.source}: changed while it was read; it is read again when it is at rest")
            return archive.take(unit, known, move=move, when=clock())
        except (DriverError, ValueError, OSError) as error:
            if isinstance(error, OSError) and error.errno in NO_ARCHIVE:
                raise
            gone = not all(map(os.path.lexists, unit.files))
            said = f"{unit.source}: has gone meanwhile; nothing is to be done" if gone else sentence(error)
            return IngestOutcome(unit.source, "refused", said, passes=gone or isinstance(error, PassingError))

    def collect(most: int) -> Iterator[IngestOutcome]:
        """What becomes of those beside that are done, and of more, until so many at most are left."""
        while waiting:
            patience = None if len(waiting) > most else 0.0
            done, _ = wait([each.known for each in waiting.values()], patience, FIRST_COMPLETED)
            if not done:
                return
            for source, reading in list(waiting.items()):
                if reading.known in done:
                    del waiting[source]
                    if (outcome := process(reading.unit, reading)) is not None:
                        yield outcome

    for unit in units:
        if unit.source in waiting:
            continue
        if (outcome := process(unit, None)) is not None:
            yield outcome
        yield from collect(MAX_CONCURRENT_UNITS)
    yield from collect(0 if beside is None else MAX_CONCURRENT_UNITS)


@dataclass(slots=True)
class FolderWatch:
    """What has been seen of a folder: units that are at rest for `rest` seconds are due, each once as it is.

    It holds no more than the folder does.
    """

    rest: float
    _since: dict[Path, tuple[FileStamps, float]] = field(default_factory=dict)
    _done: dict[Path, FileStamps] = field(default_factory=dict)

    def due(self, units: Sequence[IngestUnit], now: float) -> list[IngestUnit]:
        """The units to be taken at the monotonic time `now` (s)."""
        ready: list[IngestUnit] = []
        here: set[Path] = set()
        for unit in units:
            key = unit.source
            here.add(key)
            try:
                stamp = unit.stamp()
            except OSError:
                continue  # it has gone since it was listed
            known, since = self._since.get(key, ((), now))
            if known != stamp:
                self._since[key] = stamp, now
            elif now - since >= self.rest and self._done.get(key) != stamp:
                self._done[key] = stamp
                ready.append(unit)
        for seen in (self._since, self._done):
            for key in seen.keys() - here:
                del seen[key]
        return ready

    def again(self, source: Path) -> None:
        """A unit that was due could not be taken yet: it is due at the next look, too."""
        self._done.pop(source, None)


def watch_folder(
    folder: Path,
    archive: Path,
    maps: dict[str, ColumnMap],
    *,
    move: bool,
    every: float,
    rest: float,
    seconds: float,
    show: Callable[[IngestOutcome], None],
    keep: Callable[[IngestOutcome], None],
) -> None:
    """Take what comes into a folder, looking at it `every` so many s, for so many `seconds` or until Ctrl-C.

    Each outcome goes to `show` and to `keep`. What stands in the way and may pass is shown once and tried again at each
    look; what still waits at the end is kept as refused. Raises ArtefactError where the archive is none, OSError where
    its disk takes no file.
    """
    end = time.monotonic() + seconds
    seen = FolderWatch(rest)
    waiting: dict[Path, IngestOutcome] = {}
    here: dict[Path, tuple[Path, ...]] = {}
    beside: Beside = {}
    # Ctrl-C is how a watch ends: what was taken is told, and no file is half there. It is caught here, so that the exit
    # code is that of what was refused and not that of a command that was stopped.
    with suppress(KeyboardInterrupt), interruptible(lambda what, share: None):
        while True:
            units, due, passing = list[IngestUnit](), list[IngestUnit](), list[IngestOutcome]()
            try:
                units = list_units(folder, archive)
                due = seen.due(units, time.monotonic())
                if due or any(reading.known.done() for reading in beside.values()):
                    with open_archive(archive) as opened:
                        for outcome in ingest_units(due, opened, maps, move=move, clock=time.time, beside=beside):
                            if outcome.passes:
                                passing.append(outcome)
                            else:
                                waiting.pop(outcome.source, None)
                                show(outcome)
                                keep(outcome)
            except PassingError as error:
                passing = [IngestOutcome(unit.source, "refused", sentence(error)) for unit in due]
            except OSError as error:
                if folder.exists() and not isinstance(error, FileNotFoundError):
                    raise
                said = f"{folder}: is not there any more, or not whole; it is looked at again ({error.strerror})"
                passing = [IngestOutcome(folder, "refused", said)]
                for unit in due:
                    seen.again(unit.source)
            for outcome in passing:
                seen.again(outcome.source)
                if outcome.sentence not in {each.sentence for each in waiting.values()}:
                    show(outcome)
                waiting[outcome.source] = outcome
            here = {unit.source: unit.files for unit in units} | ({} if folder.exists() else {folder: ()})
            waiting = {source: outcome for source, outcome in waiting.items() if source in here}
            if time.monotonic() + every > end:
                break
            time.sleep(every)
    for source in beside:
        said = f"{source}: is still being read; watch for longer, or ingest it by itself"
        waiting.setdefault(source, IngestOutcome(source, "refused", said))
    for source, outcome in waiting.items():
        # Else it has gone, and nothing of it is left to be taken.
        if source in here and all(map(os.path.lexists, here[source])):
            keep(outcome)


def ingest(
    folder: Path,
    archive: Path,
    map_names: Sequence[str],
    move: bool,
    dry_run: bool,
    watch: bool,
    every: float,
    rest: float,
    seconds: float | None,
    as_json: bool,
) -> None:
    """The work of `trace ingest`."""
    if watch and dry_run:
        raise click.UsageError("--watch takes files, and --dry-run takes none; give one of them")
    if seconds is not None and not watch:
        raise click.UsageError("--for ends a watch; give --watch with it")
    counts: Counter[str] = Counter()
    told: deque[IngestOutcome] = deque(maxlen=MAX_KEPT_OUTCOMES)

    def keep(outcome: IngestOutcome) -> None:
        counts[outcome.verdict] += 1
        counts["unremoved"] += bool(outcome.unremoved)
        told.append(outcome)

    def show(outcome: IngestOutcome) -> None:
        if not as_json:
            _tell(outcome, dry_run)

    with sentences():
        for path in (folder, archive):
            check_utf8(path)
        if not folder.is_dir():
            raise file_error(folder, None, "is no folder; give the one that the files lie in")
        if resolve_links(archive) in (resolve_links(folder), *resolve_links(folder).parents):
            raise file_error(folder, None, f"lies in the archive {archive}; give a folder outside of it")
        chosen = map_names or sorted(path.stem for path in (config_dir() / "traces").glob("*.toml"))
        maps = {name: load_map(shipped_file("traces", name)) for name in chosen}
        if watch:
            watch_folder(
                folder,
                archive,
                maps,
                move=move,
                every=every,
                rest=rest,
                seconds=inf if seconds is None else seconds,
                show=show,
                keep=keep,
            )
        else:
            units = list_units(folder, archive)
            with (
                open_archive(archive, dry=dry_run) as opened,
                progress("ingesting") as bar,
                interruptible(bar) as report,
            ):
                for number, outcome in enumerate(ingest_units(units, opened, maps, move=move, clock=time.time)):
                    report(outcome.source.name, number / len(units))
                    show(outcome)
                    keep(outcome)
    data: dict[str, Any] = {"archive": str(archive), "dry_run": dry_run}
    data |= {"counts": {verdict: counts[verdict] for verdict in VERDICTS}, "unremoved": counts["unremoved"]}
    data |= {"files": [{"source": str(o.source), "verdict": o.verdict, "why": o.sentence, **o.row} for o in told]}
    said = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS)

    def summary() -> Iterator[Part]:
        yield f"{archive}: {said}{' (nothing was written)' if dry_run else ''}"
        if counts["unremoved"]:
            why = next((outcome.unremoved for outcome in told if outcome.unremoved), "no permission").lower()
            files = f"{counts['unremoved']} of them could not be removed from {folder}"
            yield Line(f"{files} ({why}); remove them as a user who may write there", "yellow", aside=True)

    found = CommandResult(data, ok=not (counts["refused"] or counts["unremoved"]))
    conclude(found, lambda _: summary(), as_json=as_json)


def _tell(outcome: IngestOutcome, dry_run: bool) -> None:
    if outcome.verdict == "refused":
        click.secho(f"refused: {outcome.sentence}", fg="yellow", err=True)
    elif outcome.verdict != "there already":
        row = outcome.row
        more = f"; missing of the set: {', '.join(row['missing'])}" if row["missing"] else ""
        if "account" in row:
            more += f"; {row['account']}"
        if row.get("used", 0) < row.get("rows", 0):
            more += f"; {row['used']} of {row['rows']} rows are read, see `decanter trace show`"
        if row.get("frames", 0) < row.get("lines", 0):
            more += f"; {row['frames']} of {row['lines']} lines are read, see `decanter trace can`"
        would = "would be " if dry_run else ""
        click.echo(f"{would}{outcome.verdict}: {outcome.source} as {row['kind']} {row['name']}{more}")
