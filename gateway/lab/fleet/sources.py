"""Where the readings of each machine of a fleet are: files of traces, exported tables, or a database.

A source is named once and read where the machine's work is done, so that a cluster's workers read their machines' data
themselves: folders must be the same there, a database must answer there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drivers.tag import Quality
from sim.sha import Trace
from sim.traces import ColumnMap, files_by_machine, load_traces

COLUMNS = ("machine", "time", "tag", "value", "quality")
"""What is read of `samples`, as `decanter historian export` and [[northbound.postgres]] write them."""
URL = ("postgresql://", "postgres://")


class MachineSource(Protocol):
    """The readings of one `machine`: `traces` reads them, `content` changes when they do (it need not read them)."""

    @property
    def machine(self) -> str: ...

    def content(self) -> str: ...

    def traces(self, column_map: ColumnMap) -> list[Trace]: ...


@dataclass(frozen=True, slots=True)
class TraceFiles:
    """Files that a column map reads."""

    machine: str
    files: tuple[Path, ...]

    def content(self) -> str:
        return _stamps(self.files)

    def traces(self, column_map: ColumnMap) -> list[Trace]:
        return load_traces(list(self.files), column_map)[0]


@dataclass(frozen=True, slots=True)
class SamplesFile:
    """The rows of a machine in a Parquet file of `samples`."""

    machine: str
    file: Path

    def content(self) -> str:
        return _stamps([self.file])

    def traces(self, column_map: ColumnMap) -> list[Trace]:
        arrow = _arrow()
        table = arrow.parquet.read_table(self.file, columns=list(COLUMNS), filters=[("machine", "=", self.machine)])
        moments = table["time"].cast(arrow.timestamp("us", tz="UTC")).cast(arrow.int64()).to_numpy() / 1e6
        values = table["value"].to_numpy(zero_copy_only=False).astype(float)
        rows = zip(table["tag"].to_pylist(), moments, values, table["quality"].to_pylist(), strict=True)
        return [trace_of(self.machine, rows, str(self.file))]


@dataclass(frozen=True, slots=True)
class SamplesTable:
    """The rows of a machine in the table `samples` of a PostgreSQL database; `url` as libpq takes it.

    The password is libpq's business (PGPASSWORD, ~/.pgpass), so that it stands in no file of ours.
    """

    machine: str
    url: str
    schema: str

    def content(self) -> str:
        query = "SELECT count(*), max(time), sum(value) FROM {} WHERE machine = %s"
        return sha256(repr(_answers(self.url, self.schema, query, (self.machine,))).encode()).hexdigest()

    def traces(self, column_map: ColumnMap) -> list[Trace]:
        query = "SELECT tag, extract(epoch FROM time)::float8, value, quality FROM {} WHERE machine = %s"
        rows = _answers(self.url, self.schema, query, (self.machine,))
        return [trace_of(self.machine, rows, f"{_without_secret(self.url)}, {self.schema}.samples")]


def trace_of(machine: str, rows: Any, origin: str) -> Trace:
    """One trace of rows (tag, time in s UTC, value or None, name of its quality), in any order.

    What was read stands until its tag is heard of again, as the historian leaves out what did not change. A reading
    that was not good is NaN and marked in `bad`; texts are left out. Raises ValueError where there are no rows.
    """
    by_tag: dict[str, list[tuple[float, float, bool]]] = {}
    for tag, time, value, quality in rows:
        good = Quality[quality].is_good
        if good and value is None:
            continue  # the reading of a text
        number = float(value) if good and value is not None else np.nan
        by_tag.setdefault(tag, []).append((float(time), number, good))
    if not by_tag:
        raise ValueError(f"{origin}: there are no samples of machine {machine!r}")
    columns = {tag: np.array(sorted(own, key=lambda row: row[0])) for tag, own in by_tag.items()}
    times = np.unique(np.concatenate([column[:, 0] for column in columns.values()]))
    signals, bad = {}, {}
    for tag, column in columns.items():
        place = np.searchsorted(column[:, 0], times, side="right") - 1
        signals[tag] = np.where(place < 0, np.nan, column[place, 1])
        bad[tag] = (place >= 0) & (column[place, 2] == 0)
    return Trace(machine, times, signals, bad=bad, origin=origin, machine=machine)


def sources_in(place: str, column_map: ColumnMap, schema: str) -> list[MachineSource]:
    """The machines of a fleet, by name: of a database's address, of a Parquet file, else of what the map's files say.

    Raises ValueError where nothing is found.
    """
    if place.startswith(URL):
        query = "SELECT DISTINCT machine FROM {} ORDER BY machine"
        names = [str(name) for (name,) in _answers(place, schema, query, ())]
        found: Sequence[MachineSource] = [SamplesTable(name, place, schema) for name in names]
    elif place.endswith(".parquet"):
        found = _in_parquet(Path(place))
    else:
        found = _in_files(place, column_map)
    if not found:
        raise ValueError(f"{place}: no machine is found there")
    return sorted(found, key=lambda source: source.machine)


def _in_files(place: str, column_map: ColumnMap) -> list[MachineSource]:
    return [TraceFiles(name, tuple(files)) for name, files in files_by_machine(place, column_map).items()]


def _in_parquet(file: Path) -> list[MachineSource]:
    arrow = _arrow()
    try:
        missing = [name for name in COLUMNS if name not in arrow.parquet.read_schema(file).names]
        if missing:
            what = f"it has no column {missing[0]!r}"
            raise ValueError(f"{file}: holds no samples ({what}); write them with `decanter historian export`")
        table = arrow.parquet.read_table(file, columns=["machine"])
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    except arrow.ArrowInvalid:
        raise ValueError(f"{file}: is no Parquet file") from None
    return [SamplesFile(str(name), file) for name in table["machine"].unique().to_pylist()]


def _arrow() -> Any:
    try:
        import_module("pyarrow.parquet")
        return import_module("pyarrow")
    except ImportError:
        raise ValueError(
            "Parquet needs pyarrow, which is not installed; pip install 'decanter-gateway[parquet]'"
        ) from None


def _answers(url: str, schema: str, query: str, values: tuple[object, ...]) -> list[tuple[Any, ...]]:
    try:
        psycopg = import_module("psycopg")
    except ImportError:
        raise ValueError(
            "PostgreSQL needs psycopg, which is not installed; pip install 'decanter-gateway[postgres]'"
        ) from None
    sql = psycopg.sql
    try:
        with psycopg.connect(url, connect_timeout=5, options="-c default_transaction_read_only=on") as connection:
            rows: list[tuple[Any, ...]] = connection.execute(
                sql.SQL(query).format(sql.Identifier(schema, "samples")), values
            ).fetchall()
            return rows
    except psycopg.Error as error:
        reason = (str(error).strip() or repr(error)).splitlines()[0]
        # libpq's words may repeat the address, and an address may have a password in it.
        raise ValueError(f"{_without_secret(url)}: {reason}") from None


def _without_secret(url: str) -> str:
    """The address without whoever logs in: people write passwords there."""
    scheme, _, place = url.partition("://")
    return f"{scheme}://{place.rpartition('@')[2]}"


def _stamps(files: Sequence[Path]) -> str:
    """Changes when a file is written: reading ten thousand machines to see that nothing is new would be the work."""
    stamps: Mapping[str, tuple[int, int]] = {
        str(file): ((known := file.stat()).st_size, known.st_mtime_ns) for file in sorted(files)
    }
    return sha256(repr(stamps).encode()).hexdigest()
