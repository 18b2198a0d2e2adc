"""Text logs as other programs print them, line by line in the form that python-can's readers take (pure).

What a program prints is known by the first lines of the log. Where they leave open what a time counts from, the log is
refused with what to do; a wrong line of times would make a wrong model.
"""

import base64
import datetime as dt
import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

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
    r"(?P<h>\d+):(?P<m>\d+):(?P<s>\d+):(?P<part>\d{1,4})\s+[RT]x\s+(?P<bus>\d+)\s+(?P<id>(?:0x)?[0-9A-Fa-f]+)\s+"
    r"(?P<kind>[sx]r?)\s+(?P<size>\d+)\s*(?P<data>.*)"
)
GVRET_HEADER = "Time Stamp,ID,Extended,"
CANEDGE_HEADER = "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes"
_DAY_S = 86400.0
WITH_TIMES = "record it with candump -L, or print it with candump -ta"


class LogDialectError(OneLineError, ValueError):
    """What the log's form leaves open (what times count from, where data begin); the message says what to do."""


def of_candump(head: Sequence[str]) -> Rewrite:
    """candump's files (-L, -l) as they are, its printed forms (-ta, -tA, -tz, -x), and BUSMASTER's logs.

    Raises LogDialectError for what is printed without times, or with those of one frame after another (-td).
    """
    if any(line.startswith("***BUSMASTER") for line in head):
        return _of_busmaster(head)
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


def _of_busmaster(head: Sequence[str]) -> Rewrite:
    """BUSMASTER's log: a time of day, of the measurement, or since the frame before; numbers by the log's own base."""
    relative, base = any("***RELATIVE MODE***" in line for line in head), 16
    if any("***DEC***" in line for line in head):
        base = 10
    total = 0.0
    midnights = 0

    def rewrite(line: str) -> str:
        nonlocal total, midnights
        if not line.strip() or line.startswith("***"):
            return ""
        match = _BUSMASTER.match(line.strip())
        if match is None:
            return line
        time = 3600 * int(match["h"]) + 60 * int(match["m"]) + int(match["s"])
        seconds = time + int(match["part"]) / 10 ** len(match["part"])
        if not relative and total - seconds - midnights * _DAY_S > _DAY_S / 2:
            midnights += 1
        total = total + seconds if relative else seconds + midnights * _DAY_S
        try:
            number = int(match["id"], 16 if match["id"].startswith("0x") else base)
            octets = bytes(int(part, base) for part in match["data"].split()).hex()
        except ValueError:
            return line
        is_remote, size = match["kind"].endswith("r"), int(match["size"])
        if not is_remote and len(octets) != 2 * size:
            return line
        name = f"{number:08X}" if match["kind"].startswith("x") else f"{number:03X}"
        data = "R" if is_remote else ("#0" if size > 8 else "") + octets
        return f"({total:.6f}) {match['bus']} {name}#{data}\n"

    return rewrite


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
