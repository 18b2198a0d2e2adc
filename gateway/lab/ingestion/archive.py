"""The archive of files from elsewhere: a folder for each kind, and a manifest with a row for everything that is in it.

    ARCHIVE/manifest.jsonl          name, kind, SHA-256, size, source, when; of a set its files and what is missing
    ARCHIVE/traces/PLACE/NAME.csv   and so on, by `recognising.PLACES`; PLACE is where it lay in the ingested folder
    ARCHIVE/artefacts/PLACE/BASE/   a set has a folder of its own

A file is copied under a name that begins with a dot, held against the hash of its source, and renamed when it is on the
disk; its row follows, and only then a source that is moved goes. What a kill leaves, the next ingestion of the same
folder finishes: a whole file without a row gets one, a half file is removed.
"""

import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any, Literal

from drivers.named_files import regular, writing
from gateway.lab.ingestion.recognising import PLACES, FileStamps, IngestUnit, RecognisedUnit
from gateway.lab.json_rows import append_row, read_rows
from sim.artefacts.formats import FLOW_FILE, SUFFIXES
from sim.files import at, sync_directory

MANIFEST, LOCK, PART = "manifest.jsonl", ".lock", ".part"
NAMING = (SUFFIXES["source"], SUFFIXES["histogram"])
"""The files that a set is known by."""
COPIED = 1 << 20
"""Bytes that are copied at a time."""

Verdict = Literal["taken", "completed", "there already", "refused"]
VERDICTS: tuple[Verdict, ...] = ("taken", "completed", "there already", "refused")


@dataclass(frozen=True, slots=True)
class IngestOutcome:
    """What became of a unit from `source`: its row of the manifest, or the `sentence` why it was refused."""

    source: Path
    verdict: Verdict
    sentence: str = ""
    row: Mapping[str, Any] = field(default_factory=dict)


class IngestArchive:
    """The archive in `folder`; see `opened_archive`."""

    def __init__(self, folder: Path, *, dry: bool = False) -> None:
        """Read the manifest. Raises ArtefactError for one that is none; nothing is written where `dry`."""
        self.folder, self.dry = folder, dry
        self._rows: dict[str, Mapping[str, Any]] = {}
        # By content, by a trace's readings and by where it came from.
        self._names: dict[tuple[str, str], str] = {}
        for number, row in enumerate(read_rows(folder / MANIFEST), 1):
            if not isinstance(row.get("name"), str) or not isinstance(row.get("sha256"), str):
                raise at(folder / MANIFEST, number, "has no name and sha256; restore the manifest from a backup")
            self._keep(row)

    def _keep(self, row: Mapping[str, Any]) -> None:
        self._rows[row["name"]] = row
        for key in ("sha256", "readings", "source"):
            if row.get(key):
                self._names[key, row[key]] = row["name"]

    def take(self, unit: IngestUnit, known: RecognisedUnit, *, move: bool, when: float) -> IngestOutcome:
        """Copy or move a unit into its place; `when` is in s UTC.

        Raises ArtefactError for one whose content is there under another name, or whose name another content has;
        OSError where nothing can be read or written.
        """
        source, stamp = unit.source, unit.stamp()
        name = Path(PLACES[known.kind], unit.place, source.name).as_posix()
        place = self.folder / name if unit.base else (self.folder / name).parent
        hashes = {path.name: file_hash(path) for path in unit.files}
        former = self._rows.get(name)
        # What a set lacked may come later, and a part of one that is there whole is nothing new.
        files = {**(former["files"] if former is not None else {}), **hashes} if unit.base else {}
        content = _of_set(files) if unit.base else hashes[source.name]
        lacking = [path for path in unit.files if not (place / path.name).is_file()]
        for path in unit.files:
            if path not in lacking and file_hash(place / path.name) != hashes[path.name]:
                said = f"{name} in {self.folder} has this name and another content; rename this one"
                raise at(path, None, said)
        if former is not None and former["sha256"] == content and not lacking:
            verdict: Verdict = "there already"
        else:
            self._refuse_double(source, name, content, known.readings)
            verdict = "taken" if former is None else "completed"
            row = {
                "name": name,
                "kind": known.kind,
                "sha256": content,
                "size": sum(path.stat().st_size for path in unit.files),
                "source": str(source.absolute()),
                "when": datetime.fromtimestamp(when, UTC).isoformat(timespec="seconds"),
                "readings": known.readings,
                "files": files,
                "missing": [missing for missing in known.missing if missing not in files],
                **known.facts,
            }
            if not self.dry:
                for path in lacking:
                    _copy(path, place / path.name, hashes[path.name], self.folder)
                append_row(self.folder / MANIFEST, row)
            self._keep(row)
        if move:
            self._remove(unit, stamp)
        return IngestOutcome(source, verdict, row=self._rows[name])

    def again(self, unit: IngestUnit, *, move: bool) -> IngestOutcome | None:
        """The outcome for a unit that came from the same path before with this content, or a part of it; else None.

        A move that was killed has left such a part, which nothing else would recognise. Raises OSError.
        """
        name = self._names.get(("source", str(unit.source.absolute())))
        if name is None or unit.refusal:
            return None
        row, stamp = self._rows[name], unit.stamp()
        for path in unit.files:
            held = self.folder / row["name"] / path.name if unit.base else self.folder / row["name"]
            if not held.is_file() or file_hash(held) != file_hash(path):
                return None
        if move:
            self._remove(unit, stamp)
        return IngestOutcome(unit.source, "there already", row=row)

    def _remove(self, unit: IngestUnit, stamp: FileStamps) -> None:
        """Remove the sources, which were as `stamp` says when they were hashed. Raises ArtefactError."""
        if self.dry:
            return
        if unit.stamp() != stamp:
            raise at(unit.source, None, "was written after it was copied, so it stays; ingest it again when at rest")
        folder = unit.source.parent
        others = [path for path in folder.glob(f"*{SUFFIXES['source']}") if path not in unit.files]
        # By what is left after a kill the set must still be known: its report goes first, its automaton last. A flow
        # file of several sets goes with the last of them.
        for path in sorted(unit.files, key=lambda path: (path.name.endswith(NAMING), path.name.endswith(NAMING[:1]))):
            if not (unit.base and path.name == FLOW_FILE and others):
                path.unlink()
        sync_directory(folder)

    def _refuse_double(self, source: Path, name: str, content: str, readings: str) -> None:
        for key, value in (("sha256", content), ("readings", readings)):
            other = self._names.get((key, value))
            # What somebody has taken out of the archive may come again.
            if other in (None, name) or not (self.dry or (self.folder / str(other)).exists()):
                continue
            row = self._rows[str(other)]
            same = "is" if key == "sha256" else "has readings that are, in another form,"
            said = f"{same} in {self.folder} already as {other} (from {row['source']}); nothing was taken"
            raise at(source, None, said)


def file_hash(path: Path) -> str:
    """SHA-256 (hex) of a file's content. Raises OSError."""
    with regular(path).open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


def _of_set(hashes: Mapping[str, str]) -> str:
    return sha256("".join(f"{name} {digest}\n" for name, digest in sorted(hashes.items())).encode()).hexdigest()


def _copy(source: Path, target: Path, expected: str, archive: Path) -> None:
    """Copy a file so that it is there whole or not at all. Raises ArtefactError where it changes meanwhile."""
    folder = target.parent
    fresh = [each for each in (folder, *folder.parents) if archive in each.parents and not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.name}{PART}")
    digest = sha256()
    try:
        with writing(target), source.open("rb") as stream, part.open("wb") as out:
            while piece := stream.read(COPIED):
                digest.update(piece)
                out.write(piece)
            out.flush()
            os.fsync(out.fileno())
        if digest.hexdigest() != expected:
            raise at(source, None, "changed while it was copied; ingest it again when nobody writes it any more")
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    for each in (folder, *(each.parent for each in fresh)):
        sync_directory(each)


@contextmanager
def opened_archive(folder: Path, *, dry: bool = False) -> Iterator[IngestArchive]:
    """The archive in `folder`, held by this process alone and made where there is none; as it is now where `dry`.

    Raises ArtefactError where another process holds it or it holds something else, OSError where it cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise at(folder, None, "is a file; give a folder for the archive")
    if folder.is_dir() and not (folder / LOCK).exists() and any(folder.iterdir()):
        raise at(folder, None, "holds other things and is no archive; give a new folder, or an archive")
    if dry:
        yield IngestArchive(folder, dry=True)
        return
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise at(folder, None, "another process is ingesting into this archive; wait for it") from None
        for place in PLACES.values():
            for half in (folder / place).rglob(f".*{PART}"):
                half.unlink()
        yield IngestArchive(folder)
    finally:
        os.close(handle)
