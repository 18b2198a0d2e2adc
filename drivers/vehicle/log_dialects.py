"""Text logs as other programs print them, line by line in the form that python-can's readers take (pure).

What a program prints is known by the first lines of the log. Where they leave open what a time counts from, the log is
refused with what to do; a wrong line of times would make a wrong model.
"""

import base64
import datetime as dt
import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise, takewhile

from drivers.errors import OneLineError

Rewrite = Callable[[str], str]
"""A line in the reader's form, or the line itself where it is no record."""

_PRINTED = re.compile(
    r"\s*(?:\((?P<time>[^()]*)\)\s+)?(?P<bus>[\w.-]+)\s+(?:[RT]X\s+\S\s+\S\s+)?(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"\s+\[(?P<size>\d{1,2})\]\s*(?P<data>remote request|ERRORFRAME|(?:[0-9A-Fa-f]{2}(?:\s+|$))*)(?:'.*')?\s*"
)
_COUNTED = re.compile(r"\s*\((\d{3}\.\d+)\)")
_ASC_BASE = re.compile(r"\s*base\s+(?:hex|dec)\s+timestamps\s+relative\b", re.IGNORECASE)
_ASC_TIME = re.compile(r"(\s*)(\d+\.\d+)(?=\s)")
_BUSMASTER = re.compile(
    r"(?P<h>\d{1,6}):(?P<m>\d{1,2}):(?P<s>\d{1,2}):(?P<part>\d{1,4})\s+[RT]x\s+(?P<bus>\d+)\s+(?P<id>(?:0x)?[0-9A-Fa-f]+)\s+"
    r"(?P<kind>[sx]r?)\s+(?P<size>\d{1,4})\s*(?P<data>.*)"
)
_SESSION_BEGINS = ("***BUSMASTER", "***[START LOGGING SESSION]", "***START DATE AND TIME")
_START = re.compile(
    r"\*\*\*START DATE AND TIME (\d{1,2}):(\d{1,2}):(\d{4}) (\d{1,2}):(\d{1,2}):(\d{1,2})(?::(\d{1,3}))?\b"
)
_MODE = re.compile(r"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE\*\*\*")
_BASE = re.compile(r"\*\*\*(HEX|DEC)\*\*\*")
GVRET_HEADER = "Time Stamp,ID,Extended,"
CANEDGE_HEADER = "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes"
_DAY_S = 86400.0
_LONGEST_STEP_BACK_S = 7200.0
"""So far a time of day is behind another one at most, by order of the buses or a clock that was set; what is further
behind is of the next day."""
WITH_TIMES = "record it with candump -L, or print it with candump -ta"


class LogDialectError(OneLineError, ValueError):
    """What the log's form leaves open (what times count from, where data begin); the message says what to do."""


def of_candump(head: Sequence[str]) -> Rewrite:
    """candump's files (-L, -l) as they are, its printed forms (-ta, -tA, -tz, -x), and BUSMASTER's logs.

    Raises LogDialectError for what is printed without times, or with those of one frame after another (-td).
    """
    if any(line.startswith("***BUSMASTER") for line in head):
        return _Busmaster(head).rewrite
    printed = [match for line in head if (match := _PRINTED.fullmatch(line))]
    if not printed:
        return _as_it_is
    if any(match["time"] is None for match in printed):
        raise LogDialectError(f"candump has printed it without times; {WITH_TIMES}")
    counted = [float(match[1]) for line in head if (match := _COUNTED.match(line))]
    if counted and any(later < earlier for earlier, later in pairwise(counted)):
        raise LogDialectError(f"candump has printed the time from frame to frame (-td); {WITH_TIMES}")

    def rewrite(line: str) -> str:
        match = _PRINTED.fullmatch(line)
        time = _seconds(match["time"] or "") if match else None
        if match is None or time is None:
            return line
        octets, size = "".join(match["data"].split()), int(match["size"])
        if octets == "remoterequest":
            return f"({time:.6f}) {match['bus']} {match['id']}#R{size or ''}\n"
        if octets == "ERRORFRAME" or len(octets) != 2 * size:
            return line if octets != "ERRORFRAME" else f"({time:.6f}) {match['bus']} 20000000#\n"
        return f"({time:.6f}) {match['bus']} {match['id']}#{'#0' if size > 8 else ''}{octets}\n"

    return rewrite


def _seconds(text: str) -> float | None:
    """A time in brackets: seconds, or a date and time, which are taken as UTC."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return dt.datetime.fromisoformat(text).replace(tzinfo=dt.UTC).timestamp()
    except ValueError:
        return None


class _Busmaster:
    """BUSMASTER's log: a time of day, of the measurement, or since the frame before; numbers by the log's own base.

    Times count from the first session's beginning, those of day from its midnight; those of another session in the
    same file from there, too.
    """

    def __init__(self, head: Sequence[str]) -> None:
        self._base, self._mode = 16, "SYSTEM"
        # When the session began, and what the file's times count from, where they say it.
        self._start: dt.datetime | None = None
        self._origin: dt.datetime | None = None
        self._session, self._begun = 0, False
        # Seconds: where a session begins, its newest time, and of relative times their sum.
        self._offset, self._newest, self._total = 0.0, -math.inf, 0.0
        # Seconds of its day at which it began, where it says it.
        self._began_s = 0.0
        for line in takewhile(lambda line: _BUSMASTER.match(line.strip()) is None, head):
            self._take_header(line.strip())

    def rewrite(self, line: str) -> str:
        """See `Rewrite`. Raises LogDialectError for a record of a later session of which nobody knows when it was."""
        line = line.strip()
        if not line or line.startswith("***"):
            self._take_header(line)
            return ""
        match = _BUSMASTER.match(line)
        if match is None:
            return line + "\n"
        if self._session and (self._start is None or self._origin is None):
            raise LogDialectError(
                f"session {self._session + 1} of this file does not say when it began (START DATE AND TIME), or the "
                "first one does not; give each its own file"
            )
        if not self._begun:
            self._begin()
        minutes, seconds = int(match["m"]), int(match["s"])
        time = 3600 * int(match["h"]) + 60 * minutes + seconds + int(match["part"]) / 10 ** len(match["part"])
        if minutes > 59 or seconds > 59 or (self._mode == "SYSTEM" and time >= _DAY_S):
            return line + "\n"
        if self._mode == "RELATIVE":
            # It counts from the line before, whatever that is.
            self._total += time
        record = self._record(match)
        if not record:
            return line + "\n"
        if self._mode == "SYSTEM":
            first = self._newest == -math.inf
            before = self._began_s if first else self._newest
            days = math.ceil((before - _LONGEST_STEP_BACK_S - time) / _DAY_S)
            # No session has a frame of the day before it began.
            time += _DAY_S * (max(days, 0) if first else days)
            self._newest = max(self._newest, time)
        return f"({(self._offset + (self._total if self._mode == 'RELATIVE' else time)):.6f}) {record}\n"

    def _take_header(self, line: str) -> None:
        if line.startswith(_SESSION_BEGINS) and self._begun:
            self._session, self._begun, self._start = self._session + 1, False, None
        if match := _START.match(line):
            day, month, year, hour, minute, second, millisecond = map(int, match.groups("0"))
            try:
                self._start = dt.datetime(year, month, day, hour, minute, second, 1000 * millisecond, dt.UTC)
            except ValueError:
                self._start = None
        elif match := _MODE.match(line):
            self._mode = match[1]
        elif match := _BASE.match(line):
            self._base = 16 if match[1] == "HEX" else 10

    def _begin(self) -> None:
        """The first record of a session: what its times count from."""
        self._begun, self._total, self._newest, self._offset, self._began_s = True, 0.0, -math.inf, 0.0, 0.0
        start = zero = self._start
        if start is not None and self._mode == "SYSTEM":
            zero = start.replace(hour=0, minute=0, second=0, microsecond=0)
            self._began_s = (start - zero).total_seconds()
        if not self._session:
            self._origin = zero
        if zero is not None and self._origin is not None:
            self._offset = (zero - self._origin).total_seconds()

    def _record(self, match: re.Match[str]) -> str:
        """The bus and the frame; "" for what is none."""
        identifier, parts = match["id"], match["data"].split()
        try:
            number = int(identifier, 16 if identifier.startswith("0x") else self._base)
            octets = bytes(int(part, self._base) if part.isalnum() else -1 for part in parts).hex()
        except ValueError:
            return ""
        extended, is_remote, size = match["kind"].startswith("x"), match["kind"].endswith("r"), int(match["size"])
        if number > (0x1FFFFFFF if extended else 0x7FF) or (not is_remote and len(octets) != 2 * size):
            return ""
        data = "R" if is_remote else ("#0" if size > 8 else "") + octets
        return f"{match['bus']} {number:0{8 if extended else 3}X}#{data}"


def of_asc(head: Sequence[str]) -> Rewrite:
    """Vector's ASC: with `timestamps relative` each time counts from the event before, whatever that is."""
    if not any(_ASC_BASE.match(line) for line in head):
        return _as_it_is
    total = 0.0

    def rewrite(line: str) -> str:
        nonlocal total
        match = _ASC_TIME.match(line)
        if match is None:
            return line
        total += float(match[2])
        return f"{match[1]}{total:.6f}{line[match.end() :]}"

    return rewrite


def of_csv(head: Sequence[str]) -> Rewrite:
    """python-can's CSV as it is; that of SavvyCAN (GVRET) and of CANedge's converter in its form."""
    header = next((line.strip().lstrip("\ufeff") for line in head if line.strip()), "")
    if header.startswith(GVRET_HEADER):
        columns = [name.strip().casefold() for name in header.split(",")]
        if "len" not in columns:
            raise LogDialectError(f"its header {header[:60]!r} has no column LEN: nobody knows where data begin")
        return partial(_of_gvret, columns.index("len"))
    return _of_canedge if header == CANEDGE_HEADER else _as_it_is


PYTHON_CAN_HEADER = "timestamp,arbitration_id,extended,remote,error,dlc,data"


def _of_gvret(length_at: int, line: str) -> str:
    if line.strip().lstrip("\ufeff").startswith(GVRET_HEADER):
        return PYTHON_CAN_HEADER + "\n"
    cells = [cell.strip() for cell in line.strip().split(",")]
    try:
        # The time in microseconds; the data after the length, before which newer versions have "Dir" too.
        time, number, extended, size = (
            int(cells[0]) / 1e6,
            int(cells[1], 16),
            cells[2].casefold() == "true",
            int(cells[length_at]),
        )
        data = bytes(int(cell, 16) for cell in cells[length_at + 1 : length_at + 1 + size])
    except (ValueError, IndexError):
        return line
    return _record(time, number, extended=extended, size=size, data=data)


def _of_canedge(line: str) -> str:
    if line.strip().lstrip("\ufeff") == CANEDGE_HEADER:
        return PYTHON_CAN_HEADER + "\n"
    cells = line.strip().split(";")
    try:
        time, number, extended, size = float(cells[0]), int(cells[2], 16), cells[3] == "1", int(cells[5])
        data = bytes.fromhex(cells[9])
    except (ValueError, IndexError):
        return line
    return _record(time, number, extended=extended, size=size, data=data)


def _record(time: float, number: int, *, extended: bool, size: int, data: bytes) -> str:
    """A data frame as python-can's CSV has it."""
    text = base64.b64encode(data).decode()
    return f"{time:.6f},0x{number:x},{int(extended)},0,0,{size},{text}\n"


def _as_it_is(line: str) -> str:
    return line
