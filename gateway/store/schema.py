"""The historian's tables, how a row gets into each, which of them must survive a power cut, and in what order they go.

Every row has a source: a machine, or one of the temperatures that are followed on it. A row is stored twice in its
life. It is born in a table that is named after what it holds (`samples`, `scans`, ...) and only ever appended to: its
key (`id`) is the order of arrival and never its time, so that a clock that was set back overwrites and hides nothing.
Once a source has enough of them, its oldest are packed as columns into `chunks` (`columns`), and their means go into
`tiers`, which are packed as well when their day is over. Readers go through `read_back`, which knows all places.
"""

from collections.abc import Mapping
from math import nan

VERSION = 3
APPLICATION_ID = 0x6465_6361
"""Marks the file as a decanter historian (SQLite's application_id)."""

COLUMNS: Mapping[str, str] = {
    "sources": "id INTEGER PRIMARY KEY, machine TEXT NOT NULL, temperature TEXT NOT NULL, "
    "UNIQUE (machine, temperature)",
    "tags": "id INTEGER PRIMARY KEY, machine TEXT NOT NULL, name TEXT NOT NULL, unit TEXT NOT NULL, "
    "UNIQUE (machine, name)",
    "runs": "started REAL NOT NULL, temperature TEXT NOT NULL, model TEXT NOT NULL, "
    "period REAL NOT NULL, max_interval REAL NOT NULL, source INTEGER NOT NULL",
    "scans": "id INTEGER PRIMARY KEY, time REAL NOT NULL, duration REAL NOT NULL, missed INTEGER NOT NULL",
    "samples": "id INTEGER PRIMARY KEY, tag INTEGER NOT NULL, time REAL NOT NULL, value, quality INTEGER NOT NULL, "
    "sent REAL",
    "predictions": "id INTEGER PRIMARY KEY, time REAL NOT NULL, location TEXT NOT NULL, known INTEGER NOT NULL, "
    "measured REAL, mean REAL, low REAL, high REAL, free_run REAL, anomaly REAL NOT NULL, zone TEXT NOT NULL",
    "forecasts": "id INTEGER PRIMARY KEY, time REAL NOT NULL, horizon REAL NOT NULL, levels TEXT NOT NULL, "
    'quantiles TEXT NOT NULL, p_limit REAL NOT NULL, "limit" REAL NOT NULL, measured REAL',
    "events": "id INTEGER PRIMARY KEY, time REAL NOT NULL, symbol TEXT NOT NULL, location TEXT NOT NULL",
    "alarms": "id INTEGER PRIMARY KEY, time REAL NOT NULL, condition TEXT NOT NULL, tag TEXT NOT NULL, "
    "priority INTEGER NOT NULL, state TEXT NOT NULL, value REAL, acknowledged_by TEXT NOT NULL, "
    "source INTEGER NOT NULL",
    "writes": "id INTEGER PRIMARY KEY, time REAL NOT NULL, sequence INTEGER NOT NULL, mode TEXT NOT NULL, "
    "verdict TEXT NOT NULL, validity INTEGER NOT NULL, latency_ms REAL, reason TEXT NOT NULL, words BLOB NOT NULL",
    "audit": "id INTEGER PRIMARY KEY, time REAL NOT NULL, what TEXT NOT NULL, who TEXT NOT NULL, reason TEXT NOT NULL, "
    "source INTEGER NOT NULL",
    "guards": "id INTEGER PRIMARY KEY, time REAL NOT NULL, content TEXT NOT NULL",
    "state": "source INTEGER NOT NULL, key TEXT NOT NULL, time REAL NOT NULL, content TEXT NOT NULL, "
    "PRIMARY KEY (source, key)",
    "chunks": "id INTEGER PRIMARY KEY, kind TEXT NOT NULL, tag INTEGER NOT NULL, batch INTEGER NOT NULL, "
    "first REAL NOT NULL, last REAL NOT NULL, rows INTEGER NOT NULL, data BLOB NOT NULL",
    "tiers": "tag INTEGER NOT NULL, width INTEGER NOT NULL, start REAL NOT NULL, count INTEGER NOT NULL, "
    "low REAL NOT NULL, mean REAL NOT NULL, high REAL NOT NULL, PRIMARY KEY (tag, width, start)",
}
"""Times are plant seconds UTC. A sample is kept when it differs from the one kept before it (by more than the tag's
deadband), when its quality changes, and at least every `runs.max_interval` seconds; what lies between equals it. A good
sample bears the moment of its reading, any other the moment of its scan. A `samples.value` is a number, a text, NULL
where there was none, and a BLOB of decimal digits for a whole number beyond SQLite's 64 signed bits.
`forecasts.measured` is the reading at the time the forecast was made: what persistence would have said.

A row of `sources` is a machine (`temperature` is empty) or a temperature followed on it; a `tags.id` is one machine's.
The rows of runs, alarms, audit and state name their source. Those of the tables in PACKED have it in their key
(`first_key`), so that the rows of a source lie side by side in the file, whatever else arrives between them.

A row of `chunks` holds `rows` rows of the table `kind`, or of `samples` of one `tag`, between the times `first` and
`last`; the samples' moments are a chunk `stamps` of the same `batch`. For a kind that is not of one tag `tag` is the
source. A row of `tiers` tells of the good readings of a `tag` at the scans of its machine within `width` s from
`start`: their count, least, mean and greatest value. Packed, these are chunks `tier 60` and `tier 3600`; rows of one
start, packed or not, are parts of one whole (a clock was set back)."""

WITHOUT_ROWID = frozenset({"state", "tiers"})

INDICES = (
    "CREATE INDEX chunks_by_time ON chunks (kind, tag, last, first)",
    "CREATE INDEX chunks_by_batch ON chunks (batch, kind, tag)",
)


def definition(table: str) -> str:
    """The statement that makes a table."""
    return f"CREATE TABLE {table} ({COLUMNS[table]})" + (" WITHOUT ROWID" if table in WITHOUT_ROWID else "")


NAMES: Mapping[str, tuple[str, ...]] = {
    "runs": ("started", "temperature", "model", "period", "max_interval"),
    "scans": ("time", "duration", "missed"),
    "samples": ("tag", "time", "value", "quality", "sent"),
    "predictions": (
        "time", "location", "known", "measured", "mean", "low", "high", "free_run", "anomaly", "zone"
    ),
    "forecasts": ("time", "horizon", "levels", "quantiles", "p_limit", '"limit"', "measured"),
    "events": ("time", "symbol", "location"),
    "alarms": ("time", "condition", "tag", "priority", "state", "value", "acknowledged_by"),
    "writes": ("time", "sequence", "mode", "verdict", "validity", "latency_ms", "reason", "words"),
    "audit": ("time", "what", "who", "reason"),
    "state": ("key", "time", "content"),
    "guards": ("time", "content"),
}  # fmt: skip
"""The columns of a row as it is put, in order; a sample is put with its tag's name, and stored with its number."""


FOLLOWED = ("predictions", "forecasts", "events", "guards", "writes")
"""Tables whose rows are about one followed temperature; those of all others are about the machine."""

SOURCE_BITS = 40
"""The lower bits of a key of a PACKED table number the rows of a source, those above them are the source."""


def first_key(source: int) -> int:
    """The lowest key of the rows of a source in a PACKED table; the next source's ends them."""
    return source << SOURCE_BITS


def _insert(table: str) -> str:
    """The statement that stores a row: its columns as it is put, and its key, or else its source."""
    verb = "INSERT OR REPLACE" if table == "state" else "INSERT"
    marks = ", ".join("?" * (len(NAMES[table]) + 1))
    return f"{verb} INTO {table} ({', '.join(NAMES[table])}, {'id' if table in PACKED else 'source'}) VALUES ({marks})"


DURABLE = frozenset({"alarms", "writes", "audit", "runs"})
"""Tables whose rows are flushed to the disk before they count as committed (synchronous FULL)."""
AT_ONCE = DURABLE - {"writes"}
"""Those that do not wait for the batch of their second. A write is in the audit log before it is sent, so that its row
here may come with the measurements beside it."""

MEASURED = ("samples", "scans", "predictions", "forecasts", "events", "guards")
"""Tables of measurements: the first to go, by age and by size."""
PACKED: Mapping[str, int] = {
    "samples": 20_000, "scans": 2_000, "predictions": 2_000, "forecasts": 2_000, "events": 2_000, "guards": 500,
    "writes": 2_000,
}  # fmt: skip
"""Rows of a source that are packed at a time, once a table has half as many again of it."""

INSERTS: Mapping[str, str] = {table: _insert(table) for table in NAMES}


def storable(value: int | float | str | None) -> int | float | str | bytes | None:
    """A sample's value as SQLite takes it: whole numbers beyond its 64 signed bits as their digits."""
    if isinstance(value, bool):
        return float(value)
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        return str(value).encode()
    return value


def restore_value(value: int | float | str | bytes | None) -> int | float | str | None:
    """The value that `storable` was given."""
    return int(value) if isinstance(value, bytes) else value


def number(value: int | float | str | bytes | None) -> float:
    """A stored value as a number; NaN for a text and for none."""
    return nan if value is None or isinstance(value, str) else float(value)
