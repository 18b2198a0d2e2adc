"""The library of a machine's cycles: one row for each that the historian had, and the readings of those that are kept.

    LIBRARY/cycles.sqlite   the rows, who excluded which and why, and how far the historian has been cut
    LIBRARY/kept/HASH.npz   readings of a cycle, named by their content: kept beyond the historian's retention

Every change is one transaction, and a file of readings is there before the row that names it: a kill at any moment
leaves a library that the next command goes on with.
"""

import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from gateway.lab.options import Rating
from sim.familiarity import COLUMNS
from sim.files import held_alone, sync_directory
from sim.sha import Array, Trace, content_hash

FILE, KEPT = "cycles.sqlite", "kept"
LAYOUT = 1
NO_LIBRARY = "is no library of cycles; `decanter model version retrain` makes one"
SCHEMA = """
CREATE TABLE facts (name TEXT PRIMARY KEY, content TEXT NOT NULL);
CREATE TABLE cycles (
    name TEXT PRIMARY KEY, begin REAL NOT NULL, until REAL NOT NULL, rows INTEGER NOT NULL, content TEXT NOT NULL,
    region TEXT NOT NULL, rating TEXT NOT NULL, words TEXT NOT NULL, strangeness REAL, error REAL, allowed REAL,
    moved REAL, model TEXT NOT NULL, points TEXT NOT NULL, kept INTEGER NOT NULL DEFAULT 0,
    excluded_by TEXT NOT NULL DEFAULT '', reason TEXT NOT NULL DEFAULT ''
);
CREATE TABLE studies (id INTEGER PRIMARY KEY, settings TEXT NOT NULL, state TEXT NOT NULL);
CREATE TABLE steps (study INTEGER NOT NULL, name TEXT NOT NULL, content TEXT NOT NULL, PRIMARY KEY (study, name));
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleRow:
    """A cycle from `begin` to `until` (s UTC) with `rows` scans, whose readings have the hash `content`.

    `region` is where in operation it was, `rating` and `words` what is remarkable about it, `strangeness` as
    `sim.familiarity` counts it (None: it was not known). `error` is the root mean square of its free run by the model
    with the hash `model`, `allowed` that of the model's own 90 % band, `moved` that of the temperature's departure from
    its first reading (degC; None where it could not be run). `points` are its features. `kept`: its readings are in the
    library. A person who excluded it gave `excluded_by` and `reason`.
    """

    name: str
    begin: float
    until: float
    rows: int
    content: str
    region: str
    rating: Rating
    words: str
    strangeness: float | None
    error: float | None
    allowed: float | None
    moved: float | None
    model: str
    points: Array
    kept: bool = False
    excluded_by: str = ""
    reason: str = ""

    @property
    def is_excluded(self) -> bool:
        """Whether a person has taken it out of everything that is learned or judged."""
        return bool(self.excluded_by)

    def as_plain(self) -> dict[str, Any]:
        """All but the points as plain values."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "points"}


class CycleLibrary:
    """The library in `folder`, of one `machine` and `temperature`; see `open_library`."""

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder = folder
        self._connection = connection

    # ---------------------------------------------------------------- facts

    def fact(self, name: str) -> Any:
        """What is kept under a name, None for nothing."""
        row = self._connection.execute("SELECT content FROM facts WHERE name = ?", (name,)).fetchone()
        return None if row is None else json.loads(row[0])

    def set_fact(self, name: str, content: object) -> None:
        """Keep a plain value under a name."""
        with self._connection:
            self._put_fact(name, content)

    def _put_fact(self, name: str, content: object) -> None:
        self._connection.execute("INSERT OR REPLACE INTO facts VALUES (?, ?)", (name, json.dumps(content)))

    # ---------------------------------------------------------------- cycles

    def cycles(self, *, as_cut: bool = False) -> list[CycleRow]:
        """All cycles in the order of time, or in that in which they were cut, whatever the clock did."""
        names = [each.name for each in fields(CycleRow)]
        order = "rowid" if as_cut else "begin"
        rows = self._connection.execute(f"SELECT {', '.join(names)} FROM cycles ORDER BY {order}")  # noqa: S608
        return [_row(dict(zip(names, row, strict=True))) for row in rows]

    def add(self, cycles: Sequence[CycleRow], cursor: float, *, within: bool = False) -> None:
        """Take cycles, and that the historian has been cut up to `cursor` (s UTC); a cycle that is there stays.

        `within`: the next cycle begins at the cursor, whether the machine starts there or not.
        """
        names = [each.name for each in fields(CycleRow)]
        query = f"INSERT OR IGNORE INTO cycles ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})"  # noqa: S608
        with self._connection:
            for cycle in cycles:
                points = json.dumps([[x if isfinite(x) else None for x in point] for point in cycle.points.tolist()])
                self._connection.execute(query, tuple({**cycle.as_plain(), "points": points}[name] for name in names))
            self._put_fact("cursor", cursor)
            self._put_fact("within", within)

    def exclude(self, name: str, by: str, reason: str) -> None:
        """Take a cycle out of what is learned and judged; without `by` take it in again. Raises ValueError."""
        with self._connection:
            found = self._connection.execute(
                "UPDATE cycles SET excluded_by = ?, reason = ? WHERE name = ?", (by, reason, name)
            ).rowcount
        if not found:
            raise ValueError(f"{self.folder}: has no cycle {name!r}; `decanter model version cycles` lists them")

    def rate(self, name: str, rating: Rating, words: str, strangeness: float) -> None:
        """Rate a cycle anew."""
        query = "UPDATE cycles SET rating = ?, words = ?, strangeness = ? WHERE name = ?"
        with self._connection:
            self._connection.execute(query, (rating, words, strangeness, name))

    # ---------------------------------------------------------------- readings

    def keep(self, name: str, trace: Trace, *, anew: bool = False) -> None:
        """Keep the readings of a cycle beyond the historian's retention; `anew`: in place of a file that is damaged."""
        content = content_hash(trace)
        path = self._file(content)
        if anew or not path.exists():
            path.parent.mkdir(exist_ok=True)
            beside = path.with_name(f".{path.name}")
            with beside.open("wb") as stream:
                stream.write(_pack_trace(trace))
                stream.flush()
                os.fsync(stream.fileno())
            beside.replace(path)
            # Before the row says so: a power cut must not leave a row without its file.
            sync_directory(path.parent)
        with self._connection:
            self._connection.execute("UPDATE cycles SET kept = 1 WHERE name = ?", (name,))

    def readings(self, content: str) -> Trace:
        """The kept readings with that hash, not encoded. Raises ValueError where they are missing or damaged."""
        path = self._file(content)
        try:
            trace = _unpack_trace(path)
        except (OSError, KeyError, ValueError, BadZipFile) as error:
            raise ValueError(f"{path}: cannot be read ({error}); the cycle is lost unless a backup has it") from None
        if content_hash(trace) != content:
            raise ValueError(f"{path}: is not what was kept there (its hash differs); restore it from a backup")
        return trace

    def kept_bytes(self) -> int:
        """What the kept readings take on the disk."""
        folder = self.folder / KEPT
        return sum(path.stat().st_size for path in folder.glob("*.npz")) if folder.is_dir() else 0

    def _file(self, content: str) -> Path:
        return self.folder / KEPT / f"{content}.npz"

    # ---------------------------------------------------------------- studies

    def study(self, settings: Mapping[str, Any]) -> int:
        """The unfinished study of these settings, or a new one; unfinished ones of others are given up."""
        text = json.dumps(settings, sort_keys=True)
        with self._connection:
            open_ones = self._connection.execute("SELECT id, settings FROM studies WHERE state = 'open'").fetchall()
            number = next((int(row[0]) for row in open_ones if row[1] == text), None)
            if number is None:
                self._connection.execute("UPDATE studies SET state = 'given up' WHERE state = 'open'")
                added = self._connection.execute("INSERT INTO studies (settings, state) VALUES (?, 'open')", (text,))
                number = int(added.lastrowid or 0)
        return number

    def step(self, study: int, name: str) -> Any:
        """What a step of a study gave, None where it was not done."""
        query = "SELECT content FROM steps WHERE study = ? AND name = ?"
        row = self._connection.execute(query, (study, name)).fetchone()
        return None if row is None else json.loads(row[0])

    def done(self, study: int, name: str, content: object) -> None:
        """Keep what a step gave, as plain values."""
        with self._connection:
            self._connection.execute(
                "INSERT OR REPLACE INTO steps VALUES (?, ?, ?)", (study, name, json.dumps(content))
            )

    def newest_training(self) -> list[str]:
        """The names of the cycles that the newest finished study learned from; none before one."""
        finished = self.fact("finished")
        sets = None if finished is None else self.step(int(finished["study"]), "sets")
        return [] if sets is None else [str(name) for name, _ in sets["training"]]

    def close_study(self, study: int) -> None:
        """The study is finished: the next one is another."""
        with self._connection:
            self._connection.execute("UPDATE studies SET state = 'done' WHERE id = ?", (study,))


@contextmanager
def open_library(folder: Path, *, machine: str | None = None, temperature: str | None = None) -> Iterator[CycleLibrary]:
    """The library in `folder`, held by this process alone; made where a machine and its temperature are given.

    Raises ValueError where there is none and neither is given, where another process holds it, and where it is of
    another machine or temperature; OSError where it cannot be written.
    """
    file = folder / FILE
    if not file.is_file() and (machine is None or temperature is None):
        raise ValueError(f"{folder}: {NO_LIBRARY}")
    folder.mkdir(parents=True, exist_ok=True)
    busy = ValueError(f"{folder}: another process is working on this library; wait for it")
    with held_alone(folder / ".lock", busy), _connect(file) as (connection, layout):
        if layout == 0:
            # In one transaction: a kill in between leaves an empty file, which is a new one.
            connection.executescript(f"BEGIN;{SCHEMA}PRAGMA user_version = {LAYOUT};COMMIT;")
        library = CycleLibrary(folder, connection)
        for name, value in (("machine", machine), ("temperature", temperature)):
            known = library.fact(name)
            if value is not None and known is None:
                library.set_fact(name, value)
            elif value is not None and known != value:
                raise ValueError(f"{folder}: is of the {name} {known!r}, not of {value!r}; give another --library")
        yield library


@contextmanager
def list_library(folder: Path) -> Iterator[CycleLibrary]:
    """The library in `folder` to be read only: also while another process works on it, and on a disk that is read-only.

    Raises ValueError where there is none, or none that this program can read.
    """
    file = folder / FILE
    if not file.is_file():
        raise ValueError(f"{folder}: {NO_LIBRARY}")
    # Opened as a file that may be written, which SQLite takes for a read-only one where it is: what a kill has left
    # half written is rolled back by whoever opens it so, and by nobody else.
    with _connect(file) as (connection, layout):
        if layout == 0:
            raise ValueError(f"{folder}: {NO_LIBRARY}")
        connection.execute("PRAGMA query_only = ON")
        # No transaction around it: a reader that is stopped in the middle of one would keep a retraining from writing.
        yield CycleLibrary(folder, connection)


@contextmanager
def _connect(file: Path) -> Iterator[tuple[sqlite3.Connection, int]]:
    """A connection and the layout that the file has, 0 for a new one. Raises ValueError for whatever SQLite says."""
    try:
        connection = sqlite3.connect(file)
    except sqlite3.Error as error:
        raise ValueError(f"{file}: cannot be opened as a library of cycles ({error}); give another folder") from None
    try:
        layout = int(connection.execute("PRAGMA user_version").fetchone()[0])
        if layout > LAYOUT:
            raise ValueError(f"{file}: has layout {layout}, and this program knows {LAYOUT}; update it")
        yield connection, layout
    except sqlite3.OperationalError as error:
        raise ValueError(
            f"{file}: cannot be read or written ({error}); make room there, or give a folder that may be written"
        ) from None
    except sqlite3.DatabaseError as error:
        raise ValueError(f"{file}: cannot be used as a library of cycles ({error}); give another folder") from None
    finally:
        connection.close()


def _row(values: dict[str, Any]) -> CycleRow:
    points = np.array(json.loads(values.pop("points")), dtype=float)
    # A library of an earlier program has fewer columns: what it did not know then is not known.
    points = points.reshape(len(points), -1) if points.size else np.empty((0, len(COLUMNS)))
    lacking = max(len(COLUMNS) - points.shape[1], 0)
    points = np.pad(points, ((0, 0), (0, lacking)), constant_values=np.nan)
    return CycleRow(points=points, **{**values, "kept": bool(values["kept"])})


def _pack_trace(trace: Trace) -> bytes:
    """The trace without its events as a compressed .npz of plain arrays."""
    facts = {"name": trace.name, "origin": trace.origin, "machine": trace.machine, "synthetic": trace.synthetic}
    head = {**facts, "signals": list(trace.signals), "bad": list(trace.bad), "units": dict(trace.units)}
    head |= {"held": list(trace.held)}
    arrays: dict[str, Any] = {f"s{number}": column for number, column in enumerate(trace.signals.values())}
    arrays |= {f"b{number}": np.packbits(mask) for number, mask in enumerate(trace.bad.values())}
    arrays |= {f"h{number}": np.packbits(mask) for number, mask in enumerate(trace.held.values())}
    stream = BytesIO()
    np.savez_compressed(stream, allow_pickle=False, head=np.array(json.dumps(head)), times=trace.times, **arrays)
    return stream.getvalue()


def _unpack_trace(path: Path) -> Trace:
    """What `_pack_trace` gave. Raises OSError, KeyError, ValueError or BadZipFile."""
    with np.load(path, allow_pickle=False) as kept:
        head, times = json.loads(str(kept["head"])), kept["times"]
        signals = {name: kept[f"s{number}"] for number, name in enumerate(head["signals"])}
        bad, held = (
            {
                name: np.unpackbits(kept[f"{letter}{number}"], count=times.size).astype(bool)
                for number, name in enumerate(names)
            }
            for letter, names in (("b", head["bad"]), ("h", head.get("held", ())))
        )
    return Trace(
        name=head["name"],
        times=times,
        signals=signals,
        bad=bad,
        origin=head["origin"],
        machine=head["machine"],
        synthetic=head["synthetic"],
        units=head["units"],
        held=held,
    )
