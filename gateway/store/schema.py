"""The historian's tables, how a row gets into each, and which of them must survive a power cut."""

from collections.abc import Mapping

VERSION = 1
APPLICATION_ID = 0x6465_6361
"""Marks the file as a decanter historian (SQLite's application_id)."""

TABLES = """
CREATE TABLE tags (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, unit TEXT NOT NULL);
CREATE TABLE runs (started REAL PRIMARY KEY, temperature TEXT NOT NULL, model TEXT NOT NULL, period REAL NOT NULL,
    max_interval REAL NOT NULL);
CREATE TABLE scans (time REAL PRIMARY KEY, duration REAL NOT NULL, missed INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE samples (tag INTEGER NOT NULL, time REAL NOT NULL, value, quality INTEGER NOT NULL, sent REAL,
    PRIMARY KEY (tag, time)) WITHOUT ROWID;
CREATE TABLE predictions (time REAL PRIMARY KEY, location TEXT NOT NULL, known INTEGER NOT NULL, measured REAL,
    mean REAL, low REAL, high REAL, free_run REAL, anomaly REAL NOT NULL, zone TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE forecasts (time REAL NOT NULL, horizon REAL NOT NULL, levels TEXT NOT NULL, quantiles TEXT NOT NULL,
    p_limit REAL NOT NULL, "limit" REAL NOT NULL, measured REAL, PRIMARY KEY (time, horizon)) WITHOUT ROWID;
CREATE TABLE events (id INTEGER PRIMARY KEY, time REAL NOT NULL, symbol TEXT NOT NULL, location TEXT NOT NULL);
CREATE INDEX events_by_time ON events (time);
CREATE TABLE alarms (id INTEGER PRIMARY KEY, time REAL NOT NULL, condition TEXT NOT NULL, tag TEXT NOT NULL,
    priority INTEGER NOT NULL, state TEXT NOT NULL, value REAL, acknowledged_by TEXT NOT NULL);
CREATE TABLE writes (id INTEGER PRIMARY KEY, time REAL NOT NULL, sequence INTEGER NOT NULL, mode TEXT NOT NULL,
    verdict TEXT NOT NULL, validity INTEGER NOT NULL, latency_ms REAL, reason TEXT NOT NULL, words BLOB NOT NULL);
CREATE INDEX writes_by_time ON writes (time);
CREATE TABLE audit (id INTEGER PRIMARY KEY, time REAL NOT NULL, what TEXT NOT NULL, who TEXT NOT NULL,
    reason TEXT NOT NULL);
CREATE TABLE state (key TEXT PRIMARY KEY, time REAL NOT NULL, content TEXT NOT NULL) WITHOUT ROWID;
"""
"""Times are plant seconds UTC. A sample is kept when it differs from the one kept before it (by more than the tag's
deadband), when its quality changes, and at least every `runs.max_interval` seconds; what lies between equals it. A good
sample bears the moment of its reading, any other the moment of its scan. `forecasts.measured` is the reading at the
time the forecast was made: what persistence would have said."""

ADDED = "CREATE TABLE IF NOT EXISTS guards (time REAL PRIMARY KEY, content TEXT NOT NULL) WITHOUT ROWID"
"""A table that files of layout 1 from earlier gateways lack; it is made when one is opened. `content` is JSON."""


def _insert(table: str, columns: int, *, replace: bool = False) -> str:
    verb = "INSERT OR REPLACE" if replace else "INSERT"
    return f"{verb} INTO {table} VALUES ({', '.join('?' * columns)})"


def _append(table: str, columns: str) -> str:
    return f"INSERT INTO {table} ({columns}) VALUES ({', '.join('?' * (columns.count(',') + 1))})"  # noqa: S608


INSERTS: Mapping[str, str] = {
    "runs": _insert("runs", 5, replace=True),
    "scans": _insert("scans", 3, replace=True),
    "samples": _insert("samples", 5, replace=True),
    "predictions": _insert("predictions", 10, replace=True),
    "forecasts": _insert("forecasts", 7, replace=True),
    "events": _append("events", "time, symbol, location"),
    "alarms": _append("alarms", "time, condition, tag, priority, state, value, acknowledged_by"),
    "writes": _append("writes", "time, sequence, mode, verdict, validity, latency_ms, reason, words"),
    "audit": _append("audit", "time, what, who, reason"),
    "state": _insert("state", 3, replace=True),
    "guards": _insert("guards", 2, replace=True),
}

DURABLE = frozenset({"alarms", "writes", "audit", "runs"})
"""Tables whose rows are flushed to the disk before they count as committed (synchronous FULL), and at once."""

_OLDEST = "time IN (SELECT time FROM {table} WHERE time < :moment ORDER BY time LIMIT :rows)"

DELETES: Mapping[str, str] = {
    **{
        table: f"DELETE FROM {table} WHERE {_OLDEST.format(table=table)}"  # noqa: S608
        for table in ("scans", "predictions", "forecasts", "events", "writes", "guards")
    },
    "samples": "DELETE FROM samples WHERE tag = :tag AND time IN "
    "(SELECT time FROM samples WHERE tag = :tag AND time < :moment ORDER BY time LIMIT :rows)",
}
"""How the oldest `rows` rows before a `moment` are deleted. Alarms, audit record and runs stay."""
