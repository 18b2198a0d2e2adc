"""The historian's layout 1, as the first gateways wrote it: rows under their times, nothing packed."""

import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gateway.store.schema import APPLICATION_ID

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
CREATE TABLE guards (time REAL PRIMARY KEY, content TEXT NOT NULL) WITHOUT ROWID;
"""
NUMBERED = ("events", "alarms", "writes", "audit")


class FormerStore:
    """A file of layout 1, written as its gateway did: one transaction a batch, durable where it has a durable row."""

    def __init__(self, path: Path, tags: Iterable[str]) -> None:
        self.connection = sqlite3.connect(path, isolation_level=None)
        self.connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        self.connection.execute("PRAGMA journal_mode = WAL")
        for statement in TABLES.split(";"):
            self.connection.execute(statement)
        self.connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        self.connection.execute("PRAGMA user_version = 1")
        names = list(tags)
        self.connection.executemany("INSERT INTO tags (name, unit) VALUES (?, '')", [(name,) for name in names])
        self.numbers = {name: number for number, name in enumerate(names, start=1)}

    def numbered(self, table: str, rows: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
        """Rows as they are put now, with the number of a sample's tag instead of its name."""
        return [(self.numbers[row[0]], *row[1:]) if table == "samples" else row for row in rows]

    def commit(self, batch: Mapping[str, Iterable[tuple[Any, ...]]]) -> None:
        """One batch."""
        durable = not {"alarms", "writes", "audit", "runs"}.isdisjoint(batch)
        self.connection.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
        self.connection.execute("BEGIN IMMEDIATE")
        for table, rows in batch.items():
            first = "NULL, " if table in NUMBERED else ""
            for row in rows:
                marks = ", ".join("?" * len(row))
                self.connection.execute(f"INSERT OR REPLACE INTO {table} VALUES ({first}{marks})", row)  # noqa: S608
        self.connection.execute("COMMIT")

    def close(self) -> None:
        """All of it in the main file."""
        self.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self.connection.close()
