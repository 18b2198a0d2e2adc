"""PostgreSQL as a sink: the historian's tables, each row once, however often it is sent."""

import logging
from collections.abc import Generator, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby
from math import inf
from threading import Event
from time import monotonic
from typing import Any, TypeVar

import psycopg
from psycopg import sql

from gateway.network import remaining_seconds, resolve_host
from gateway.outside.northbound.sink import OutgoingRow, Present, RowsRefused, Sink, SinkContext, SinkUnreachable
from gateway.settings import NorthboundSecrets, PostgresRow
from gateway.store import TABLE_COLUMNS, row_cells

R = TypeVar("R")

TYPES: Mapping[str, str] = {
    "text": "text", "real": "double precision", "whole": "bigint", "flag": "boolean", "moment": "timestamptz",
    "reals": "double precision[]",
}  # fmt: skip
"""PostgreSQL's types of the kinds of columns."""
ANSWER_SECONDS = 10.0
"""Seconds that a session's beginning, and a batch of rows, may take in all."""


class TimedConnection(psycopg.Connection[Any]):
    """A connection that waits for nothing beyond `end` (monotonic s): then TimeoutError is raised.

    The server's own time-outs, which it is asked for too, are kept by a server that is well.
    """

    end = inf

    def wait(self, gen: Any, *given: Any, **keys: Any) -> Any:
        """As a connection's, within the time: psycopg looks again several times a second."""
        return super().wait(self.limit_time(gen), *given, **keys)

    def limit_time(self, gen: Generator[Any, Any, R]) -> Generator[Any, Any, R]:
        """What a generator of psycopg's asks for and gives, for as long as there is time."""
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                remaining_seconds(self.end)
                wanted = gen.send(ready)
        except StopIteration as finished:
            found: R = finished.value
            return found


def make_sink(row: PostgresRow, secrets: NorthboundSecrets, _: SinkContext) -> Sink:
    """The sink of a database."""
    return PostgresSink(row, secrets.passwords.get(row.name))


class PostgresSink:
    """Inserts rows in the order in which they come, each batch in one transaction.

    The primary key is what tells a row apart, so that one that comes again, since nobody heard that it had arrived, is
    passed over.
    """

    dropped = 0

    def __init__(self, row: PostgresRow, password: str | None) -> None:
        self._row, self._password = row, password
        self._connection: TimedConnection | None = None
        self._inserts: dict[str, sql.Composed] = {}
        # The library tells of each rollback that failed a log that nobody has set up; the reason is in the sentences.
        logging.getLogger("psycopg").setLevel(logging.CRITICAL + 1)

    def open(self, present: Present) -> None:
        """Connect, and make the tables that are not there."""
        self.close()
        row, end = self._row, monotonic() + ANSWER_SECONDS
        try:
            self._connection = connection = self._connect(end)
            connection.end = end
            with connection.transaction():
                connection.execute(sql.SQL("CREATE SCHEMA IF NOT EXISTS {}").format(sql.Identifier(row.table_schema)))
                for table in row.tables:
                    connection.execute(self._definition(table))
        except (psycopg.Error, OSError, UnicodeError) as error:
            self.close()
            raise SinkUnreachable(self._sentence(error)) from None

    def _connect(self, end: float) -> TimedConnection:
        """A connection by the first address that takes it until `end` (monotonic s). Raises as psycopg, or OSError."""
        row, answer_ms = self._row, round(1e3 * ANSWER_SECONDS)
        # libpq would look for the name as long as the resolver takes, and have the whole time for each address.
        places: Sequence[str | None] = [None]
        if not row.host.startswith("/"):
            places = list(dict.fromkeys(str(found[4][0]) for found in resolve_host(row.host, row.port, end)))
        failure: Exception = OSError("it has no address")
        for place in places:
            try:
                return TimedConnection.connect(
                    host=row.host,
                    hostaddr=place,
                    port=row.port,
                    dbname=row.database,
                    user=row.user,
                    password=self._password,
                    connect_timeout=max(int(remaining_seconds(end)), 1),
                    application_name=f"decanter {row.node}",
                    options=f"-c statement_timeout={answer_ms} -c lock_timeout={answer_ms}",
                    # A server that is gone without a word is noticed by the kernel.
                    tcp_user_timeout=answer_ms,
                    sslmode="prefer" if row.local else "verify-full",
                    sslrootcert=None if row.local else str(row.ca or "system"),
                )
            except (psycopg.Error, OSError) as error:
                failure = error
        raise failure

    def _name(self, table: str) -> sql.Identifier:
        return sql.Identifier(self._row.table_schema, table)

    def _definition(self, table: str) -> sql.Composed:
        """The statement that makes a table; notes the one that inserts into it."""
        columns = TABLE_COLUMNS[table]
        names = ["node", *(column.name for column in columns)]
        self._inserts[table] = sql.SQL("INSERT INTO {} ({}) VALUES ({}) ON CONFLICT DO NOTHING").format(
            self._name(table),
            sql.SQL(", ").join(map(sql.Identifier, names)),
            sql.SQL(", ").join([sql.Placeholder()] * len(names)),
        )
        types = [("node", "text"), *((column.name, TYPES[column.kind]) for column in columns)]
        parts = [sql.SQL("{} {}").format(sql.Identifier(name), sql.SQL(kind)) for name, kind in types]
        keys = ["node", *(column.name for column in columns if column.key)]
        return sql.SQL("CREATE TABLE IF NOT EXISTS {} ({}, PRIMARY KEY ({}))").format(
            self._name(table), sql.SQL(", ").join(parts), sql.SQL(", ").join(map(sql.Identifier, keys))
        )

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        """Insert all in one transaction; where the server will not have one, each by itself."""
        if self._connection is None:
            raise SinkUnreachable("there is no connection")
        self._connection.end = monotonic() + ANSWER_SECONDS
        try:
            self._insert(rows)
        except (psycopg.DataError, psycopg.IntegrityError) as error:
            if len(rows) == 1:
                raise RowsRefused(1, self._sentence(error)) from None
            half = len(rows) // 2
            yield from self.deliver(rows[:half])
            yield from self.deliver(rows[half:])
            return
        except (psycopg.Error, OSError) as error:
            raise SinkUnreachable(self._sentence(error)) from None
        yield len(rows)

    def _insert(self, rows: Sequence[OutgoingRow]) -> None:
        if self._connection is None:
            return
        with self._connection.transaction(), self._connection.cursor() as cursor:
            for table, own in groupby(rows, key=lambda one: one.row.stream.table):
                kinds = [column.kind for column in TABLE_COLUMNS[table]]
                cursor.executemany(
                    self._inserts[table],
                    [(self._row.node, *map(_to_cell, kinds, row_cells(one.row))) for one in own],
                )

    def _sentence(self, error: Exception) -> str:
        reason = (str(error).strip() or repr(error)).splitlines()[0]
        return f"{self._row.host}:{self._row.port}, database {self._row.database}: {reason}"

    def idle(self, seconds: float, stop: Event) -> None:
        """Wait: a connection that ends meanwhile is noticed by the next rows."""
        stop.wait(seconds)

    def close(self) -> None:
        """Close the connection."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def _to_cell(kind: str, cell: Any) -> Any:
    if kind == "moment":
        return datetime.fromtimestamp(cell, UTC)
    # The one character that PostgreSQL's texts cannot have.
    return cell.replace("\0", "\N{REPLACEMENT CHARACTER}") if isinstance(cell, str) else cell
