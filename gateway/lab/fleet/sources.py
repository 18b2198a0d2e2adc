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
from gateway.extras import missing_sentence
from sim.lab.recordings import ColumnMap, files_by_machine, load_traces
from sim.sha import Trace

COLUMNS = ("machine", "time", "tag", "value", "quality")
"""What is read of `samples`, as `decanter historian export` and [[northbound.postgres]] write them."""
URL = ("postgresql://", "postgres://")
TABLE = "fleet.csv"
"""The table of all machines in --out, which may lie in the folder that is read."""
TABLE_HEAD = b"machine,hours,"
"""With which that table begins, whatever else it has."""


@dataclass(frozen=True, slots=True)
class MachineTraces:
    """The `traces` of a machine, and a sentence for each file that was `unread` beside them."""

    traces: list[Trace]
    unread: tuple[str, ...] = ()


class MachineSource(Protocol):
    """The readings of one `machine`: `read` reads them, `content` changes when they do (it need not read them)."""

    @property
    def machine(self) -> str: ...

    def content(self) -> str: ...

    def read(self, column_map: ColumnMap) -> MachineTraces: ...


@dataclass(frozen=True, slots=True)
class TraceFiles:
    """Files that a column map reads."""

    machine: str
    files: tuple[Path, ...]

    def content(self) -> str:
        return _stamps(self.files)

    def read(self, column_map: ColumnMap) -> MachineTraces:
        traces, report = load_traces(list(self.files), column_map)
        return MachineTraces(traces, tuple(report.errors))


@dataclass(frozen=True, slots=True)
class SamplesFile:
    """The rows of a machine in a Parquet file of `samples`."""

    machine: str
    file: Path

    def content(self) -> str:
        return _stamps([self.file])

    def read(self, column_map: ColumnMap) -> MachineTraces:
        arrow = _arrow()
        try:
            own = [("machine", "=", self.machine)]
            table = arrow.parquet.read_table(self.file, columns=list(COLUMNS), filters=own)
            # Not `safe`: pandas writes nanoseconds, and what is lost of them is nothing here.
            stamps = table["time"].cast(arrow.timestamp("us", tz="UTC"), safe=False).cast(arrow.int64())
        except (OSError, arrow.ArrowException) as error:
            raise ValueError(_unreadable(self.file, error)) from None
        for name in ("time", "tag", "quality"):
            if table[name].null_count:
                raise ValueError(
                    f"{self.file}: column {name!r}: {table[name].null_count} of {len(table)} rows of machine "
                    f"{self.machine!r} have none there; give each row its {name}"
                )
        values = table["value"].to_numpy(zero_copy_only=False).astype(float)
        rows = zip(table["tag"].to_pylist(), stamps.to_numpy() / 1e6, values, table["quality"].to_pylist(), strict=True)
        return MachineTraces([build_trace(self.machine, rows, str(self.file))])


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

    def read(self, column_map: ColumnMap) -> MachineTraces:
        query = "SELECT tag, extract(epoch FROM time)::float8, value, quality FROM {} WHERE machine = %s"
        rows = _answers(self.url, self.schema, query, (self.machine,))
        return MachineTraces([build_trace(self.machine, rows, f"{_without_secret(self.url)}, {self.schema}.samples")])


def build_trace(machine: str, rows: Any, origin: str) -> Trace:
    """One trace of rows (tag, time in s UTC, value or None, name of its quality), in any order.

    What was read stands until its tag is heard of again, as the historian leaves out what did not change. A reading
    that was not good is NaN and marked in `bad`; texts are left out. Raises ValueError where there are no rows, and for
    a quality that is none.
    """
    by_tag: dict[str, list[tuple[float, float, bool]]] = {}
    for tag, time, value, quality in rows:
        if quality not in Quality.__members__:
            raise ValueError(
                f"{origin}: column 'quality': {quality!r} of tag {tag!r} of machine {machine!r} is no quality; "
                f"known are {', '.join(Quality.__members__)}"
            )
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


def find_sources(place: str, column_map: ColumnMap, schema: str) -> list[MachineSource]:
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
    found = {
        name: tuple(file for file in files if not _is_fleet_table(file))
        for name, files in files_by_machine(place, column_map).items()
    }
    return [TraceFiles(name, files) for name, files in found.items() if files]


def _is_fleet_table(file: Path) -> bool:
    """Whether it is what an earlier command left there of its own, and no machine's: told by name and first columns."""
    if file.name != TABLE or not file.is_file():
        return False
    with file.open("rb") as stream:
        head = stream.read(len(TABLE_HEAD))
    return head == TABLE_HEAD


def _in_parquet(file: Path) -> list[MachineSource]:
    arrow = _arrow()
    if not file.exists():
        raise ValueError(f"{file}: there is no such file; give the path of an existing one")
    try:
        schema = arrow.parquet.read_schema(file)
        missing = [name for name in COLUMNS if name not in schema.names]
        if missing:
            what = f"it has no column {missing[0]!r}"
            raise ValueError(f"{file}: holds no samples ({what}); write them with `decanter historian export`")
        names = arrow.parquet.read_table(file, columns=["machine"])["machine"]
    except OSError as error:
        raise ValueError(_unreadable(file, error)) from None
    except arrow.ArrowInvalid:
        raise ValueError(f"{file}: is no Parquet file") from None
    if names.null_count:
        row = names.is_null().index(True).as_py() + 1
        raise ValueError(f"{file}: column 'machine': row {row} has none; give each row the name of its machine")
    for name in COLUMNS:
        _check_column(file, name, schema.field(name).type, arrow.types)
    return [SamplesFile(name, file) for name in names.unique().to_pylist()]


def _check_column(file: Path, name: str, kind: Any, types: Any) -> None:
    """Raises ValueError where what the column holds (`kind`, Arrow's type) is not what `samples` has there."""
    if types.is_dictionary(kind):
        kind = kind.value_type  # a column of few different texts, as pandas writes its categories
    if name == "time":
        right, words = types.is_timestamp(kind), "timestamps"
    elif name == "value":
        numbers = types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
        right, words = numbers or types.is_null(kind), "numbers (null for a text)"
    else:
        right, words = types.is_string(kind) or types.is_large_string(kind), "texts"
    if not right:
        raise ValueError(
            f"{file}: column {name!r}: it holds {kind}, and {words} are needed; write the table as "
            "`decanter historian export --table samples` does"
        )


def _unreadable(file: Path, error: Exception) -> str:
    """The sentence for a Parquet file of which the system or Arrow could not read a part."""
    reason = (getattr(error, "strerror", None) or str(error)).splitlines()[0]
    return f"{file}: cannot be read ({reason[:1].lower()}{reason[1:]}); give a whole file that this user can read"


def _arrow() -> Any:
    try:
        import_module("pyarrow.parquet")
        return import_module("pyarrow")
    except ImportError as error:
        raise ValueError(f"Parquet {missing_sentence('parquet', error)}") from None


def _answers(url: str, schema: str, query: str, values: tuple[object, ...]) -> list[tuple[Any, ...]]:
    try:
        psycopg = import_module("psycopg")
    except ImportError as error:
        raise ValueError(f"PostgreSQL {missing_sentence('postgres', error)}") from None
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
