"""The numbers that a historian's file has given: of sources and tags, and of the newest row of each source.

They are looked up and given within the transaction that stores the rows that need them, so that a file has the numbers
of what is in it, whichever file that is: one that was there at the start, or one that took its place while the gateway
ran. After a transaction that was taken back they are read anew.
"""

import sqlite3
from collections import defaultdict

from gateway.store.schema import first_key
from gateway.store.sqlite_file import key_bounds, key_range

Source = tuple[str, str]
"""A machine's name and the temperature that is followed on it ("": the machine itself)."""


class FileNumbers:
    """The numbers in one file; `waiting` counts the rows of each PACKED table and source that are not packed yet."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        query = "SELECT id, machine, temperature FROM sources"
        self.sources: dict[Source, int] = {(row[1], row[2]): int(row[0]) for row in connection.execute(query)}
        query = "SELECT id, machine, name FROM tags"
        self.tags: dict[tuple[str, str], int] = {(row[1], row[2]): int(row[0]) for row in connection.execute(query)}
        self._newest: dict[tuple[str, int], int] = {}
        self.waiting: dict[str, dict[int, int]] = defaultdict(dict)

    def recount(self, connection: sqlite3.Connection, table: str, source: int) -> None:
        """Count the rows of a source anew: some were packed or deleted."""
        keys = key_bounds(connection, table, source)
        self.waiting[table][source] = keys[1] - keys[0] + 1 if keys else 0
        # Not below what was given before: what is numbered once more would be taken for what was there.
        before = self._newest.get((table, source), first_key(source))
        self._newest[table, source] = max(keys[1], before) if keys else before

    def source(self, connection: sqlite3.Connection, source: Source) -> int:
        """The number of a source, given if it has none."""
        number = self.sources.get(source)
        if number is None:
            number = 1 + max(self.sources.values(), default=-1)
            connection.execute("INSERT INTO sources VALUES (?, ?, ?)", (number, *source))
            self.sources[source] = number
        return number

    def tag(self, connection: sqlite3.Connection, machine: str, name: str, unit: str) -> int:
        """The number of a machine's tag, given if it has none."""
        number = self.tags.get((machine, name))
        if number is None:
            number = 1 + max(self.tags.values(), default=0)
            connection.execute("INSERT INTO tags VALUES (?, ?, ?, ?)", (number, machine, name, unit))
            self.tags[machine, name] = number
        return number

    def next_key(self, connection: sqlite3.Connection, table: str, source: int) -> int:
        """The key of the next row of a source in a PACKED table."""
        if (table, source) not in self._newest:
            self.recount(connection, table, source)
        return self._newest[table, source] + 1

    def took(self, table: str, source: int, rows: int) -> None:
        """So many rows of a source were appended to a PACKED table."""
        self._newest[table, source] += rows
        self.waiting[table][source] += rows


def newest_scan_time(connection: sqlite3.Connection, machine: str) -> float | None:
    """The time (s UTC) of a machine's scan that was stored last, whatever the clock said before; None without one."""
    query = "SELECT id FROM sources WHERE machine = ? ORDER BY temperature"
    for (source,) in connection.execute(query, (machine,)).fetchall():
        query = "SELECT time FROM scans WHERE id BETWEEN ? AND ? ORDER BY id DESC LIMIT 1"
        row = connection.execute(query, key_range(source)).fetchone()
        if row is not None:
            return float(row[0])
    return None
