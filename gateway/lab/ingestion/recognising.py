"""What a file is, by the rooms that read such files: nothing is taken that its own reader would refuse later."""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from drivers.driver import open_recording
from drivers.errors import RecordingError
from drivers.json_lines import NoObject, parse_object
from drivers.named_files import regular
from gateway.store import SQLITE_HEADER, machines, newest_scan, oldest_scan, reading
from sim.artefacts import MODEL_FILE, STORE_FILE
from sim.files import ArtefactError, check_utf8, file_error
from sim.lab.formats.foreign import FLOW_FILE, file_names, read_artefacts, read_flow_file, read_report
from sim.lab.recordings import ColumnMap, TraceError, load_traces
from sim.lab.suffixes import SUFFIXES
from sim.sha import joint_hash

Kind = Literal["trace", "artefact set", "flow file", "PLC recording", "historian", "CAN log", "plot"]
PLACES: Mapping[Kind, str] = {
    "trace": "traces",
    "artefact set": "artefacts",
    "flow file": "flows",
    "PLC recording": "recordings",
    "historian": "historians",
    "CAN log": "can_logs",
    "plot": "plots",
}
"""The folder of an archive for each kind."""
BESIDE_SQLITE = ("-wal", "-shm", "-journal", ".lock")
PICTURES = {
    ".png": (b"\x89PNG\r\n\x1a\n", b"IEND"),
    ".pdf": (b"%PDF-", b"%%EOF"),
    ".svg": (b"<svg", b"</svg>"),
    ".jpg": (b"\xff\xd8\xff", b"\xff\xd9"),
    ".jpeg": (b"\xff\xd8\xff", b"\xff\xd9"),
}
"""By suffix what such a picture begins with, and what stands at its end."""
CAN_LOGS = (".log", ".asc", ".blf", ".trc", ".mf4")
HEAD_BYTES = 1 << 16
"""Bytes by whose content a file is told: the first row of a PLC recording names all its tags."""
LINK = "is a link; ingest the folder with the file itself"
FOLDER_LINK = "is a link to a folder; ingest that folder itself"
LONGEST_NAME = 200
"""Bytes: file systems take 255, and a file has a longer name while it is written."""
RESERVED = frozenset(("CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(1, 10))))
"""Windows takes these for devices, whatever stands behind a point after them."""


FileStamps = tuple[tuple[str, int, int], ...]
"""Name, size (bytes) and time of change (ns) of each file of a unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestUnit:
    """What is taken together: one file, or the `files` of an artefact set with the base name `base`.

    `place` is the folder that it lies in, relative to the one that is ingested. `refusal` is a sentence for what is not
    even looked into.
    """

    files: tuple[Path, ...]
    place: Path
    base: str = ""
    refusal: str = ""

    @property
    def source(self) -> Path:
        """The path by which the unit is called: of a set its folder with its base name."""
        return self.files[0].parent / self.base if self.base else self.files[0]

    def stamp(self) -> FileStamps:
        """What changes when one of the files is written. Raises OSError."""
        statuses = [(path.name, path.lstat()) for path in self.files]
        return tuple((name, status.st_size, status.st_mtime_ns) for name, status in statuses)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognisedUnit:
    """What a unit is: its `kind`, plain `facts` about it, the names of `missing` files of a set.

    `readings` is the joint hash of a trace's readings by its `column_map`, by which the same trace in another form is
    known; "" and None for others.
    """

    kind: Kind
    facts: Mapping[str, Any] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    readings: str = ""
    column_map: ColumnMap | None = None


def list_units(folder: Path, besides: Path) -> list[IngestUnit]:
    """What is in a folder and those below, in the order of names, but for what lies in `besides` or begins with a dot.

    Raises OSError where the folder cannot be listed.
    """
    units: list[IngestUnit] = []

    def report_folder(error: OSError) -> None:
        if Path(error.filename) == folder:
            raise error
        path = Path(error.filename)
        units.append(_refused_unit(path, folder, f"cannot be listed ({error.strerror}); let this user read it"))

    for parent, names, files in os.walk(folder, onerror=report_folder):
        here = Path(parent)
        names[:] = sorted(name for name in names if name[:1] != "." and (here / name).resolve() != besides.resolve())
        # They are not followed, as one may lead back to a folder above.
        units += [_refused_unit(here / name, folder, FOLDER_LINK) for name in names if (here / name).is_symlink()]
        if any(name in files for name in (MODEL_FILE, STORE_FILE)):
            names.clear()
            said = (
                "is a model of this program, not a file from elsewhere; "
                "`decanter model version promote STORE --add` takes it"
            )
            units.append(_refused_unit(here, folder, said))
            continue
        units += _group_units(here, sorted(name for name in files if name[:1] != "."), folder)
    return units


def _group_units(here: Path, names: Sequence[str], folder: Path) -> list[IngestUnit]:
    units: list[IngestUnit] = []
    place = here.relative_to(folder)
    endings = (SUFFIXES["source"], SUFFIXES["histogram"])
    bases = sorted({name.removesuffix(end) for name in names for end in endings if name.endswith(end)})
    in_sets: set[str] = set()
    for base in bases:
        try:
            own = [name for name in file_names(base).values() if name in names]
        except ArtefactError as error:
            own = [name for name in names if name.startswith(base)]
            units.append(_refused_unit(here / own[0], folder, str(error)))
        else:
            said = next((f"{here / name}: {LINK}" for name in own if (here / name).is_symlink()), "")
            units.append(IngestUnit(files=tuple(here / name for name in own), place=place, base=base, refusal=said))
        in_sets.update(own)
    for name in names:
        path = here / name
        main = next((name.removesuffix(end) for end in BESIDE_SQLITE if name.endswith(end)), None)
        if name in in_sets or main in names:
            continue
        if path.is_symlink():
            units.append(_refused_unit(path, folder, LINK))
        else:
            units.append(IngestUnit(files=(path,), place=place))
    return units


def _refused_unit(path: Path, folder: Path, sentence: str) -> IngestUnit:
    place = path.parent.relative_to(folder) if path != folder else Path()
    return IngestUnit(files=(path,), place=place, refusal=f"{path}: {sentence}")


def check_names(unit: IngestUnit) -> None:
    """Raises ArtefactError unless every name of the unit can be a file's on any system, and a trace's in a table."""
    for path in unit.files:
        for name in (*unit.place.parts, path.name):
            if not re.fullmatch(r"\w[\w .+()\-]*", name) or name.endswith((" ", ".")):
                said = f"{name!r} is no name for an archive; use letters, digits, blanks and _-+.(), a letter first"
                raise file_error(path, None, said)
            if name.partition(".")[0].rstrip().upper() in RESERVED:
                raise file_error(path, None, f"{name!r} is the name of a device on Windows; rename it")
            if len(name.encode()) > LONGEST_NAME:
                raise file_error(
                    path, None, f"its name has {len(name.encode())} bytes, {LONGEST_NAME} are the most; shorten it"
                )


def recognise(unit: IngestUnit, maps: Mapping[str, ColumnMap]) -> RecognisedUnit:
    """What the unit is; a trace is read by the first of the column `maps` that can.

    Raises ValueError (a sentence of the room that would read it) for what is none of `PLACES`, OSError where it cannot
    be read.
    """
    if unit.refusal:
        raise ArtefactError(unit.refusal)
    for path in unit.files:
        check_utf8(path)
    check_names(unit)
    path = unit.files[0]
    if unit.base:
        return _artefact_set(path.parent, unit.base)
    with regular(path).open("rb") as stream:
        head = stream.read(HEAD_BYTES)
        stream.seek(max(path.stat().st_size - HEAD_BYTES, 0))
        tail = stream.read(HEAD_BYTES)
    if not head:
        raise file_error(path, None, "is empty; there is nothing to keep")
    suffix = path.suffix.lower()
    if path.name == FLOW_FILE:
        return RecognisedUnit(kind="flow file", facts={"flows": len(read_flow_file(path).equations)})
    if head.startswith(SQLITE_HEADER):
        return _historian(path)
    if suffix in PICTURES:
        begins, ends = PICTURES[suffix]
        # SVG may begin with a declaration and comments.
        if not (begins in head if suffix == ".svg" else head.startswith(begins)):
            raise file_error(path, None, f"is called {suffix}, but its content is no such picture; correct its name")
        if ends not in tail:
            raise file_error(path, None, "is a picture without its end; copy it again")
        return RecognisedUnit(kind="plot")
    if head.startswith(b"PK") and suffix == ".xlsx":
        raise file_error(path, None, "is a workbook, and traces are read as CSV; save its sheet as .csv")
    if suffix == ".csv":
        return _trace(path, maps)
    if _begins_a_run(head):
        return RecognisedUnit(kind="PLC recording")
    if suffix == ".txt":
        _refuse_lone_report(path)
    if path.name.lower().removesuffix(".gz").endswith(CAN_LOGS):
        return _can_log(path)
    said = (
        f"is none of {', '.join(PLACES)} by name and content; leave it out, or name it as files of its kind are named"
    )
    raise file_error(path, None, said)


def _artefact_set(folder: Path, base: str) -> RecognisedUnit:
    read = read_artefacts(folder, base, ("histogram", "flows"))
    names = file_names(base)
    missing = [names[kind] for kind, part in (("histogram", read.histogram), ("flows", read.flows)) if part is None]
    facts = {"locations": len(read.source.locations), "edges": len(read.source.edges)}
    return RecognisedUnit(kind="artefact set", facts=facts, missing=tuple(missing))


def _refuse_lone_report(path: Path) -> None:
    """Raises ArtefactError, which says what the set lacks, for a learner's report without its automaton."""
    try:
        report = read_report(path)
    except ArtefactError:
        return
    if report.distributions or report.events:
        read_artefacts(path.parent, path.stem, ("histogram", "flows"))


def _historian(path: Path) -> RecognisedUnit:
    log = path.with_name(path.name + BESIDE_SQLITE[0])
    if log.exists() and log.stat().st_size:
        said = f"a gateway may be writing it ({log.name} is beside it); ingest a copy that `decanter keep backup` made"
        raise file_error(path, None, said)
    with reading(path, immutable=True) as connection:
        known = machines(connection)
        spans = {
            name: [oldest_scan(connection, machine=name), newest_scan(connection, machine=name)] for name, _ in known
        }
    return RecognisedUnit(kind="historian", facts={"machines": spans})


def _trace(path: Path, maps: Mapping[str, ColumnMap]) -> RecognisedUnit:
    refusals: list[TraceError] = []
    for name, column_map in maps.items():
        try:
            traces, report = load_traces(path, column_map)
        except TraceError as error:
            refusals.append(error)
            continue
        facts = {"map": name, "traces": len(traces), "rows": report.rows, "used": report.used}
        facts |= {"account": report.account()}
        return RecognisedUnit(kind="trace", facts=facts, readings=joint_hash(traces), column_map=column_map)
    with suppress(RecordingError):
        return _can_log(path)
    # A map whose columns are there says best what is wrong: that there is only a header, say.
    fitting = [each for each in refusals if each.report is not None and any(f.columns for f in each.report.files)]
    reasons = {str(each) for each in fitting or refusals}
    if len(reasons) == 1:
        raise ArtefactError(reasons.pop())
    said = f"no column map reads it (tried {', '.join(maps)}); draft one with `decanter trace map`, give it with --map"
    raise file_error(path, None, said)


def _can_log(path: Path) -> RecognisedUnit:
    """Raises RecordingError for a log without a data frame."""
    log = open_recording("can-log", path, {"log": str(path)}, ())
    for _ in log.samples(lambda what, share: None):
        pass  # it has no tags: reading counts the frames
    counts = log.counts()
    frames = counts["log_frames"]
    # Frames of an error or a request are understood and hold no data. Where a log breaks off, its rest counts as one.
    unread = sum(counts[f"log_{what}"] for what in ("refused", "truncated", "broken"))
    return RecognisedUnit(kind="CAN log", facts={"frames": frames, "lines": frames + unread, "problem": log.problem})


def _begins_a_run(head: bytes) -> bool:
    """Whether a file begins as the software PLC's recorder begins one: with the row of a run."""
    try:
        first = parse_object(head.lstrip().partition(b"\n")[0])
    except NoObject:
        return False
    return first.get("k") == "run" and "n" in first and "t" in first
