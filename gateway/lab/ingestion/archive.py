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
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from errno import EACCES, EAGAIN, EPERM, EROFS
from hashlib import file_digest, sha256
from pathlib import Path
from signal import SIGURG
from typing import Any, Literal

from drivers.named_files import name_write_errors, regular
from gateway.lab.ingestion.recognising import BESIDE_SQLITE, PLACES, FileStamps, IngestUnit, RecognisedUnit
from gateway.lab.json_rows import RowKeys, append_row, check_row, read_rows
from sim.files import ArtefactError, file_error, held_alone, sync_directory
from sim.lab.formats.foreign import FLOW_FILE
from sim.lab.recordings import TraceError, unread_hash
from sim.lab.suffixes import SUFFIXES

MANIFEST, LOCK, PART = "manifest.jsonl", ".lock", ".part"
NAMING = (SUFFIXES["source"], SUFFIXES["histogram"])
"""The files that a set is known by."""
COPY_BYTES = 1 << 20
"""Bytes that are copied at a time."""
NOT_OURS = (EACCES, EPERM, EROFS)
"""What a system says of a source that this user may read and not remove."""

Verdict = Literal["taken", "completed", "there already", "refused"]
VERDICTS: tuple[Verdict, ...] = ("taken", "completed", "there already", "refused")


class ManifestRow(RowKeys):
    """What ingestion uses of a row of the manifest; its reader's facts are only there for some kinds."""

    name: str
    kind: str
    sha256: str
    source: str
    files: dict[str, str]
    missing: list[str]
    readings: str = ""
    rows: int = 0
    used: int = 0
    frames: int = 0
    lines: int = 0


class PassingError(ArtefactError):
    """What stands in the way now and need not at the next look: another process that holds a file or the archive."""


@dataclass(frozen=True, slots=True)
class IngestOutcome:
    """What became of a unit from `source`: its row of the manifest, or the `sentence` why it was refused.

    `passes` where the reason of a refusal may be gone at the next look. `unremoved` is the system's word why a source
    that was to be moved is still there, though its content is in the archive.
    """

    source: Path
    verdict: Verdict
    sentence: str = ""
    row: Mapping[str, Any] = field(default_factory=dict)
    passes: bool = False
    unremoved: str = ""


class IngestArchive:
    """The archive in `folder`; see `open_archive`."""

    def __init__(self, folder: Path, *, dry: bool = False) -> None:
        """Read the manifest. Raises ArtefactError for one that is none; nothing is written where `dry`."""
        self.folder, self.dry = folder, dry
        self._rows: dict[str, Mapping[str, Any]] = {}
        # By content, by a trace's readings, by where it came from, and by name whatever the case of its letters.
        self._names: dict[tuple[str, str], list[str]] = {}
        for number, row in enumerate(read_rows(folder / MANIFEST), 1):
            check_row(folder / MANIFEST, number, row, ManifestRow)
            self._keep(row)

    def _keep(self, row: Mapping[str, Any]) -> None:
        self._rows[row["name"]] = row
        for key, value in (*row.items(), ("folded", row["name"].casefold())):
            if key in ("sha256", "readings", "source", "folded") and value:
                self._names.setdefault((key, value), []).append(row["name"])

    def _find_names(self, key: str, value: str) -> list[str]:
        """The names of what is in the archive with this key, the newest first."""
        names = dict.fromkeys(reversed(self._names.get((key, value), [])))
        # What somebody has taken out of the archive may come again.
        return [name for name in names if self.dry or (self.folder / name).exists()]

    def take(self, unit: IngestUnit, known: RecognisedUnit, *, move: bool, when: float) -> IngestOutcome:
        """Copy or move a unit into its place; `when` is in s UTC.

        Raises ArtefactError for one whose content is there under another name, or whose name another content has, and
        where its place cannot be; OSError where nothing can be read or written.
        """
        source, stamp = unit.source, unit.stamp()
        name = Path(PLACES[known.kind], unit.place, source.name).as_posix()
        self._check_place(unit, name)
        place = self.folder / name if unit.base else (self.folder / name).parent
        hashes = {path.name: file_hash(path) for path in unit.files}
        former = self._rows.get(name)
        # What a set lacked may come later, and a part of one that is there whole is nothing new.
        files = {**(former["files"] if former is not None else {}), **hashes} if unit.base else {}
        content = _set_hash(files) if unit.base else hashes[source.name]
        lacking = [path for path in unit.files if not (place / path.name).is_file()]
        for path in unit.files:
            if path not in lacking and file_hash(place / path.name) != hashes[path.name]:
                said = f"{name} in {self.folder} has this name and another content; rename this one"
                raise file_error(path, None, said)
        if former is not None and former["sha256"] == content and not lacking:
            verdict: Verdict = "there already"
        else:
            self._refuse_double(source, name, content, known)
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
        outcome = IngestOutcome(source, verdict, row=self._rows[name])
        return replace(outcome, unremoved=self._remove(unit, stamp)) if move else outcome

    def again(self, unit: IngestUnit, *, move: bool) -> IngestOutcome | None:
        """The outcome for a unit that came from the same path before with this content, or a part of it; else None.

        A move that was killed has left such a part, which nothing else would recognise. Raises OSError.
        """
        names = self._names.get(("source", str(unit.source.absolute())))
        if names is None or unit.refusal:
            return None
        row, stamp = self._rows[names[-1]], unit.stamp()
        for path in unit.files:
            held = self.folder / row["name"] / path.name if unit.base else self.folder / row["name"]
            if not held.is_file() or file_hash(held) != file_hash(path):
                return None
        outcome = IngestOutcome(unit.source, "there already", row=row)
        return replace(outcome, unremoved=self._remove(unit, stamp)) if move else outcome

    def _check_place(self, unit: IngestUnit, name: str) -> None:
        """Raises ArtefactError where something else stands at the place of the unit, on this system or on another."""
        place = self.folder / name
        wanted = {each: False for each in (place, *place.parents) if self.folder in each.parents}
        wanted |= {place / path.name: True for path in unit.files} if unit.base else {place: True}
        for each, is_file in wanted.items():
            if each.exists() and each.is_file() != is_file:
                said = f"{each} is a {'folder' if is_file else 'file'}, where this one needs a " + (
                    "file" if is_file else "folder"
                )
                raise file_error(unit.source, None, f"{said}; rename one of them")
        other = next((other for other in self._find_names("folded", name.casefold()) if other != name), None)
        if other is not None:
            said = f"{other} in {self.folder} has this name but for capitals, which not every system tells apart"
            raise file_error(unit.source, None, f"{said}; rename this one")

    def _remove(self, unit: IngestUnit, stamp: FileStamps) -> str:
        """Remove the sources, which were as `stamp` says when they were hashed; the system's word where it does not.

        Raises ArtefactError.
        """
        if self.dry:
            return ""
        refuse_open(unit)
        if unit.stamp() != stamp:
            raise file_error(
                unit.source, None, "was written after it was copied, so it stays; ingest it again when at rest"
            )
        folder = unit.source.parent
        others = [path for path in folder.glob(f"*{SUFFIXES['source']}") if path not in unit.files]
        # By what is left after a kill the set must still be known: its report goes first, its automaton last. A flow
        # file of several sets goes with the last of them.
        for path in sorted(unit.files, key=lambda path: (path.name.endswith(NAMING), path.name.endswith(NAMING[:1]))):
            if not (unit.base and path.name == FLOW_FILE and others):
                try:
                    path.unlink()
                except OSError as error:
                    if error.errno not in NOT_OURS:
                        raise
                    return str(error.strerror)
        sync_directory(folder)
        return ""

    def _refuse_double(self, source: Path, name: str, content: str, known: RecognisedUnit) -> None:
        """Raises ArtefactError for what is in the archive under another name, as it is or in another form."""
        same = dict.fromkeys(self._find_names("sha256", content), "is")
        for other in self._find_names("readings", known.readings):
            held = self.folder / other
            if other not in same and self._same_cells(
                source, held if held.exists() else self._rows[other]["source"], known
            ):
                same[other] = "has readings that are, in another form,"
        for other, what in same.items():
            if other != name:
                said = f"{what} in {self.folder} already as {other} (from {self._rows[other]['source']})"
                raise file_error(source, None, f"{said}; nothing was taken")

    @staticmethod
    def _same_cells(source: Path, held: str | Path, known: RecognisedUnit) -> bool:
        """Whether two traces with the same readings are the same in what their map does not read, too."""
        if known.column_map is None:
            return True
        try:
            return unread_hash(source, known.column_map) == unread_hash(Path(held), known.column_map)
        except (TraceError, OSError):
            return False  # another map has read the one that is held, so it has other columns


def file_hash(path: Path) -> str:
    """SHA-256 (hex) of a file's content. Raises OSError."""
    with regular(path).open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


def refuse_open(unit: IngestUnit) -> None:
    """Raises PassingError for a unit of which another process has a file open for writing, as far as that can be known.

    Raises OSError for a file that is gone or cannot be read.
    """
    for path in unit.files:
        handle = os.open(regular(path), os.O_RDONLY | os.O_CLOEXEC)
        try:
            # The system gives a lease for reading (fcntl(2)) on a file that nobody has open for writing, to its owner
            # and to root. It is given back at once. Who opens the file meanwhile waits so long, and this process gets a
            # signal, which by default would end it: another one is asked for that is passed over.
            fcntl.fcntl(handle, fcntl.F_SETSIG, SIGURG)
            fcntl.fcntl(handle, fcntl.F_SETLEASE, fcntl.F_RDLCK)
            fcntl.fcntl(handle, fcntl.F_SETLEASE, fcntl.F_UNLCK)
        except OSError as error:
            # Of another's file, and where there are no leases, it cannot be known: what changes is seen by its stamp.
            if error.errno == EAGAIN:
                database = any(path.with_name(path.name + end).exists() for end in BESIDE_SQLITE)
                remedy = "ingest a copy that `decanter keep backup` made" if database else "close it first"
                raise PassingError(f"{path}: is open for writing by another process; {remedy}") from None
        finally:
            os.close(handle)


def _set_hash(hashes: Mapping[str, str]) -> str:
    return sha256("".join(f"{name} {digest}\n" for name, digest in sorted(hashes.items())).encode()).hexdigest()


def _copy(source: Path, target: Path, expected: str, archive: Path) -> None:
    """Copy a file so that it is there whole or not at all. Raises ArtefactError where it changes meanwhile."""
    folder = target.parent
    fresh = [each for each in (folder, *folder.parents) if archive in each.parents and not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.name}{PART}")
    digest = sha256()
    try:
        with name_write_errors(target), source.open("rb") as stream, part.open("wb") as out:
            while piece := stream.read(COPY_BYTES):
                digest.update(piece)
                out.write(piece)
            out.flush()
            os.fsync(out.fileno())
        if digest.hexdigest() != expected:
            raise file_error(
                source, None, "changed while it was copied; ingest it again when nobody writes it any more"
            )
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    for each in (folder, *(each.parent for each in fresh)):
        sync_directory(each)


@contextmanager
def open_archive(folder: Path, *, dry: bool = False) -> Iterator[IngestArchive]:
    """The archive in `folder`, held by this process alone and made where there is none; as it is now where `dry`.

    Raises PassingError where another process holds it, ArtefactError where it holds something else, OSError where it
    cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise file_error(folder, None, "is a file; give a folder for the archive")
    if folder.is_dir() and not (folder / LOCK).exists() and any(folder.iterdir()):
        raise file_error(folder, None, "holds other things and is no archive; give a new folder, or an archive")
    if dry:
        yield IngestArchive(folder, dry=True)
        return
    folder.mkdir(parents=True, exist_ok=True)
    busy = PassingError(f"{folder}: another process is ingesting into this archive; wait for it")
    with held_alone(folder / LOCK, busy):
        for place in PLACES.values():
            for half in (folder / place).rglob(f".*{PART}"):
                half.unlink()
        yield IngestArchive(folder)
