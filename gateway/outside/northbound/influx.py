"""InfluxDB's line protocol over HTTP, for servers of version 1 (`/write`) and of version 2 and 3 (`/api/v2/write`).

A point is what it is by its measurement, tags and time: one that comes again replaces itself.
"""

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from http.client import HTTPException
from itertools import pairwise
from math import isfinite
from threading import Event
from typing import Any
from urllib.parse import urlencode, urlsplit

from gateway.network import TimedHttp, failure_reason, make_tls
from gateway.outside.northbound.sink import OutgoingRow, Present, RowsRefused, Sink, SinkContext, SinkUnreachable
from gateway.settings import InfluxRow, NorthboundSecrets
from gateway.store import TABLE_COLUMNS, FollowedRow, row_cells

ANSWER_SECONDS = 10.0
"""Seconds that a connection, and a batch of rows with its answer, may take in all."""
MOST_ANSWER_BYTES = 1 << 20
"""Bytes of an answer that are received."""
TAGS: Mapping[str, Sequence[str]] = {
    "samples": ("machine", "tag"),
    "predictions": ("machine", "temperature"),
    "forecasts": ("machine", "temperature", "horizon"),
    "events": ("machine", "temperature", "symbol"),
    "alarms": ("machine", "condition"),
}
"""The columns that are tags; `node` is one of every measurement, and the others are fields."""
_TAG = str.maketrans({",": r"\,", "=": r"\=", " ": r"\ ", "\n": " ", "\r": " "})
_TEXT = str.maketrans({'"': r"\"", "\\": r"\\", "\n": " ", "\r": " "})


def make_sink(row: InfluxRow, secrets: NorthboundSecrets, _: SinkContext) -> Sink:
    """The sink of a database or a bucket."""
    return InfluxSink(row, secrets.passwords.get(row.name), secrets.tokens.get(row.name))


class InfluxSink:
    """Writes points in the order in which their rows come."""

    dropped = 0

    def __init__(self, row: InfluxRow, password: str | None, token: str | None) -> None:
        self._row = row
        self._connection: TimedHttp | None = None
        keys = {"bucket": row.bucket, "org": row.organization, "precision": "us"}
        self._path = f"/api/v2/write?{urlencode(keys)}"
        self._headers = {"Content-Type": "text/plain; charset=utf-8"}
        if row.database is not None:
            self._path = f"/write?{urlencode({'db': row.database, 'precision': 'u'})}"
            if row.user is not None:
                login = b64encode(f"{row.user}:{password or ''}".encode()).decode()
                self._headers["Authorization"] = f"Basic {login}"
        elif token is not None:
            self._headers["Authorization"] = f"Token {token}"

    def open(self, present: Present) -> None:
        """Connect."""
        self.close()
        parts = urlsplit(self._row.url)
        host, port = parts.hostname or "", parts.port or 8086
        try:
            tls = make_tls(self._row.ca) if parts.scheme == "https" else None
            self._connection = TimedHttp(host, port, tls)
            self._connection.allow(ANSWER_SECONDS, MOST_ANSWER_BYTES)
            self._connection.connect()
        except (OSError, UnicodeError) as error:
            self.close()
            raise SinkUnreachable(f"{self._row.url} cannot be reached: {failure_reason(error)}") from None

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        """Write all at once; where the server will not have some, halves, down to the row that it will not have."""
        status, reason = self._post("\n".join(format_row(one.row, self._row.node) for one in rows).encode())
        if status in (200, 204):
            yield len(rows)
        elif status not in (400, 413, 422):
            raise SinkUnreachable(f"{self._row.url} answers {status}: {reason}")
        elif len(rows) == 1:
            raise RowsRefused(1, f"{self._row.url} answers {status}: {reason}")
        else:
            for begin, end in pairwise((0, len(rows) // 2, len(rows))):
                yield from self.deliver(rows[begin:end])

    def _post(self, lines: bytes) -> tuple[int, str]:
        """The server's status, and its words."""
        if self._connection is None:
            raise SinkUnreachable("there is no connection")
        self._connection.allow(ANSWER_SECONDS, MOST_ANSWER_BYTES)
        try:
            self._connection.request("POST", self._path, lines, self._headers)
            with self._connection.getresponse() as response:
                said = response.read().decode(errors="replace")
        except TimeoutError:
            raise SinkUnreachable(f"{self._row.url} does not answer: no answer in time") from None
        except (OSError, HTTPException) as error:
            raise SinkUnreachable(f"{self._row.url} does not answer: {error!r}") from None
        return response.status, " ".join(said.split())[:300]

    def idle(self, seconds: float, stop: Event) -> None:
        """Wait: a connection that ends meanwhile is noticed by the next rows."""
        stop.wait(seconds)

    def close(self) -> None:
        """Close the connection."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def format_row(row: FollowedRow, node: str) -> str:
    """A row as a line: measurement and tags, fields, the time in microseconds."""
    table = row.stream.table
    cells: dict[str, Any] = {
        column.name: cell for column, cell in zip(TABLE_COLUMNS[table], row_cells(row), strict=True)
    }
    tags = [("node", node), *((name, cells.pop(name)) for name in TAGS[table])]
    if "unit" in cells:
        tags.append(("unit", cells.pop("unit")))
    named = "".join(f",{name}={_tag(value)}" for name, value in tags if value not in ("", None))
    time = round(1e6 * row.time)
    cells.pop("time")
    if table == "forecasts":
        fan = zip(cells.pop("levels"), cells.pop("quantiles"), strict=True)
        cells |= {f"q{100 * level:g}": quantile for level, quantile in fan}
    fields = ",".join(f"{name}={text}" for name, value in cells.items() if (text := _field(value)) is not None)
    return f"{table}{named} {fields} {time}"


def _tag(value: Any) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    # A backslash at the end would take the character behind it with it; without it the point would be another tag's.
    return text.translate(_TAG) + ("\N{REPLACEMENT CHARACTER}" if text.endswith("\\") else "")


def _field(value: Any) -> str | None:
    """A field's value; None for what has none, as line protocol has no null and no NaN."""
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return f"{value}i"
        case float():
            return repr(value) if isfinite(value) else None
        case str():
            return f'"{value.translate(_TEXT)}"'
    return None
