"""Recorded CAN logs as frames: candump, ASC, BLF, TRC, CSV and MF4 by python-can's readers, whatever is in them.

What is no frame is counted and skipped; a log that ends in the middle of a record gives what lies before. The readers
of text are fed line by line, so that one bad line costs one line.
"""

import gzip
import logging
import math
import re
import struct
import zlib
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO, TextIO, cast

import can
from can.io.blf import (
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    NO_COMPRESSION,
    OBJ_HEADER_BASE_STRUCT,
    ZLIB_DEFLATE,
    BLFParseError,
)

from drivers.can import CanFrame
from drivers.errors import RecordingError
from drivers.named_files import regular
from drivers.vehicle import log_dialects
from drivers.vehicle.log_dialects import LogDialectError, Rewrite

_LONGEST_LINE = 4096
_HEAD_LINES = 200
"""Lines by which it is told what has written a log."""
UNPACKED_FREE_BYTES, UNPACKED_PER_PACKED = 1 << 25, 64
"""Bytes that a compressed log may unpack to whatever its size, and how many more for each byte of it: a log of a bus
has 5 to 30, and zlib makes a thousand of what says nothing."""
_PARSE_ERRORS = (
    ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, AssertionError, EOFError, OSError,
    struct.error, zlib.error, BLFParseError,
)  # fmt: skip
_MF4_RAISES = (("asammdf.blocks.utils", "MdfException"), ("isal.isal_zlib", "error"), ("zstd", "Error"))
# Classic, remote and FD frames as `candump -L` writes them. The error flag (0x20000000) is looked at separately, as the
# reader takes most error frames for data.
_CANDUMP = re.compile(
    r"\s*\(\d+\.\d+\)\s+\S+\s+(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:#[0-7](?:[0-9A-Fa-f]{2}){0,64}|[Rr][0-8]?|(?:[0-9A-Fa-f]{2}){0,8})(?:\s+[RTrt])?\s*"
)
_CSV = re.compile(r"\s*-?[\d.]+(?:[eE][-+]?\d+)?,(?:0x)?[0-9A-Fa-f]+,[01],[01],[01],\d+,[A-Za-z0-9+/=]*\s*")
_CSV_HEADER = log_dialects.PYTHON_CAN_HEADER
_TRC = re.compile(r"\s*(?:;.*|\d+\)?\s+[\d.]+\s+\S.*)?\s*")

# The readers warn of lines and objects, on the terminal where nobody else listens; what they leave out is counted here.
logging.getLogger("can.io").addHandler(logging.NullHandler())

LineCheck = Callable[[str], str]
"""What a line is: "" for the reader, else the count that it goes to."""


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of log: its reader, whether it is text, what lines it has, and a line to restart the reader with.

    `dialect` looks at its first lines, and gives what makes lines of other programs the reader's.
    """

    reader: Callable[..., can.io.generic.MessageReader]
    text: bool = True
    check: LineCheck = lambda _: ""
    restart: str | None = None
    header: str = ""
    dialect: Callable[[Sequence[str]], Rewrite] = lambda _: str


def _candump_line(line: str) -> str:
    match = _CANDUMP.fullmatch(line)
    if match is None:
        return "" if not line.strip() else "refused"
    return "error_frames" if len(match["id"]) == 8 and int(match["id"], 16) & 0x20000000 else ""


class _Room:
    """How many bytes may still be unpacked of a file of `size` bytes."""

    def __init__(self, size: int) -> None:
        self._most = self.left = UNPACKED_FREE_BYTES + UNPACKED_PER_PACKED * size

    def take(self, count: int) -> None:
        """Take so many. Raises OSError where there are not so many left."""
        self.left -= count
        if self.left < 0:
            raise OSError(f"it unpacks to more than {self._most >> 20} MiB; if it is a log, unpack it before")


class _BoundedGzip(gzip.GzipFile):
    """What a gzip file unpacks to, as far as there is room."""

    def __init__(self, raw: BinaryIO, room: _Room) -> None:
        super().__init__(fileobj=raw, mode="rb")
        self._room = room

    def read(self, size: int | None = -1) -> bytes:
        """As a file's. Raises OSError where there is no room."""
        most = self._room.left + 1
        data = super().read(most if size is None or size < 0 else min(size, most))
        self._room.take(len(data))
        return data

    def readline(self, size: int | None = -1) -> bytes:
        """As a file's. Raises OSError where there is no room."""
        most = self._room.left + 1
        data = super().readline(most if size is None or size < 0 else min(size, most))
        self._room.take(len(data))
        return data


_NO_LENGTH = "an object without a length"


class _CheckedBlf(can.BLFReader):
    """A BLF reader that stops at an object which would keep it in place for ever, or unpacks to more than is taken."""

    def __init__(self, file: BinaryIO, room: _Room) -> None:
        super().__init__(file)
        self._room = room

    def __iter__(self) -> Generator[can.Message, None, None]:
        # As python-can's own, but that gives what a container unpacks to no bound.
        while head := self.file.read(OBJ_HEADER_BASE_STRUCT.size):
            signature, _, _, length, kind = OBJ_HEADER_BASE_STRUCT.unpack(head)
            if signature != b"LOBJ":
                raise BLFParseError
            if length < OBJ_HEADER_BASE_STRUCT.size:
                raise BLFParseError(_NO_LENGTH)
            content = self.file.read(length - OBJ_HEADER_BASE_STRUCT.size)
            self.file.read(length % 4)
            if kind != LOG_CONTAINER:
                continue
            method, _ = LOG_CONTAINER_STRUCT.unpack_from(content)
            data = content[LOG_CONTAINER_STRUCT.size :]
            whole = True
            if method == ZLIB_DEFLATE:
                unpacker = zlib.decompressobj()
                data = unpacker.decompress(data, self._room.left + 1)
                self._room.take(len(data))
                whole = unpacker.eof
            elif method != NO_COMPRESSION:
                raise BLFParseError(f"a container is packed in a way that is not known ({method})")
            yield from self._parse_container(data)
            if not whole:
                raise BLFParseError(f"a container is cut short; {self._announcement}")
        if (size := self.file.tell()) < self.file_size:
            raise BLFParseError(f"it ends after {size} bytes; {self._announcement}")
        self.stop()

    @property
    def _announcement(self) -> str:
        return f"its header announces {self.object_count} objects in {self.file_size} bytes"

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        before = len(self._tail)
        end = _short_object_offset(self._tail + data)
        if end is None:
            yield from super()._parse_container(data)
            return
        yield from super()._parse_container(data[: max(0, end - before)])
        raise BLFParseError(_NO_LENGTH)


def _short_object_offset(data: bytes) -> int | None:
    """Where an object of a container says that it is shorter than its own header, if one does."""
    size, at = OBJ_HEADER_BASE_STRUCT.size, 0
    while (at := data.find(b"LOBJ", at, at + 8)) >= 0 and at + size <= len(data):
        length: int = OBJ_HEADER_BASE_STRUCT.unpack_from(data, at)[3]
        if length < size:
            return at
        at += length
    return None


# ASAM MDF 4: a block has its id (4 bytes), 4 reserved, its length and its number of links (8 each), then links. These
# are the first ones, which asammdf follows from block to block, by what it takes the block behind each for.
_MDF_LISTS = {
    "HD": ("DG", "FH", "CH", "AT", "EV"), "DG": ("DG", "CG", "DL"), "CG": ("CG", "CN"), "CN": ("CN", "CN"),
    "FH": ("FH",), "CH": ("CH", "CH"), "AT": ("AT",), "EV": ("EV",), "DL": ("DL",),
}  # fmt: skip
_MDF_FIRST, _MOST_BLOCKS = 64, 1_000_000


def has_loop(stream: BinaryIO) -> bool:
    """True for an MF4 file one of whose lists comes back to itself: asammdf would follow it without end."""
    open_, done = set[tuple[str, int]](), set[tuple[str, int]]()
    waiting = [(("HD", _MDF_FIRST), False)]
    while waiting and len(done) < _MOST_BLOCKS:
        block, left = waiting.pop()
        if left:
            open_.remove(block)
            done.add(block)
            continue
        if block in open_:
            return True
        if block in done:
            continue
        open_.add(block)
        waiting.append((block, True))
        role, at = block
        stream.seek(at)
        head = stream.read(64)
        # Data itself has no links, and an array of a channel one.
        if len(head) < 32 or (role == "DL" and head[:4] not in (b"##DL", b"##HL", b"##LD")):
            continue
        roles = _MDF_LISTS[role][: 1 if head[:4] == b"##CA" else None]
        size = stream.seek(0, 2)
        for number, below in enumerate(roles):
            link = int.from_bytes(head[24 + 8 * number : 32 + 8 * number], "little")
            if 0 < link < size:
                waiting.append(((below, link), False))
    return bool(waiting)


FORMATS: dict[str, Format] = {
    "candump": Format(can.CanutilsLogReader, check=_candump_line, dialect=log_dialects.of_candump),
    "asc": Format(can.ASCReader, restart="\n", dialect=log_dialects.of_asc),
    "trc": Format(can.TRCReader, check=lambda line: "" if _TRC.fullmatch(line) else "refused"),
    "csv": Format(
        can.CSVReader,
        check=lambda line: "" if _CSV.fullmatch(line) else "refused" if line.strip() else "blank",
        restart=_CSV_HEADER + "\n",
        header=_CSV_HEADER,
        dialect=log_dialects.of_csv,
    ),
    "blf": Format(_CheckedBlf, text=False),
    "mf4": Format(can.MF4Reader, text=False),
}
"""Readers by format; a file's suffix is the format's name, or .log for candump, with .gz where it is compressed."""
_SUFFIXES = {".log": "candump"} | {f".{name}": name for name in FORMATS}


@dataclass(slots=True)
class Log:
    """One log being read. `counts` say what became of its records, `problem` is the first thing wrong, as a sentence.

    `frames` (data frames given), `error_frames`, `remote_frames`, `truncated` (less data than announced), `refused`
    (no record of this format, or one that means nothing), `broken` (1: the log could not be read to its end).
    """

    path: Path
    format: str
    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(
            ("frames", "error_frames", "remote_frames", "truncated", "refused", "broken"), 0
        )
    )
    problem: str = ""
    size: int = 0
    _raw: BinaryIO | None = None

    @property
    def progress(self) -> float:
        """How much of the file has been read, 0..1."""
        if self._raw is None or self._raw.closed or not self.size:
            return 0.0
        return min(1.0, self._raw.tell() / self.size)

    def frames(self) -> Iterator[CanFrame]:
        """The data frames in the order of the log, from its beginning; times as they are logged (finite seconds)."""
        kind = FORMATS[self.format]
        try:
            raw = regular(self.path).open("rb")
        except OSError as error:
            self.note("broken", f"it cannot be read: {error.strerror}")
            return
        with raw:
            self._raw = raw
            room = _Room(self.size)
            stream = _BoundedGzip(raw, room) if self.path.suffix.lower() == ".gz" else raw
            if kind.text:
                messages = self._from_text(kind, cast(BinaryIO, stream))
            else:
                messages = self._from_binary(kind, stream, room)
            for message in messages:
                frame = self._frame(message)
                if frame is not None:
                    self.counts["frames"] += 1
                    yield frame

    def _from_text(self, kind: Format, stream: BinaryIO) -> Iterator[can.Message]:
        try:
            lines = _Lines(stream, kind, self)
        except LogDialectError as error:
            self.note("broken", str(error))
            return
        reader = kind.reader(cast(TextIO, lines))
        while not lines.ended:
            try:
                yield from reader
            except _PARSE_ERRORS as error:
                self.note("refused", f"line {lines.number}: {error}")
                if kind.restart is not None:
                    lines.first = kind.restart
            else:
                return

    def _from_binary(self, kind: Format, stream: "BinaryIO | _BoundedGzip", room: _Room) -> Iterator[can.Message]:
        errors: tuple[type[Exception], ...] = _PARSE_ERRORS
        if self.format == "mf4":
            # asammdf and its decompressors raise errors of their own; they are there if an MF4 is read.
            names = [(module, name) for module, name in _MF4_RAISES if find_spec(module.partition(".")[0]) is not None]
            errors += (RuntimeError, *(getattr(import_module(module), name) for module, name in names))
        if self.format == "mf4" and stream is self._raw and has_loop(self._raw):
            self.note("broken", "after 0 frames: a list of its blocks comes back to itself")
            return
        try:
            # asammdf maps a file of its own; the other reader takes the open one.
            yield from kind.reader(str(self.path)) if self.format == "mf4" else kind.reader(stream, room)
        except errors as error:
            self.note("broken", f"after {self.counts['frames']} frames: {str(error) or type(error).__name__}")

    def _frame(self, message: can.Message) -> CanFrame | None:
        if message.is_error_frame:
            self.counts["error_frames"] += 1
            return None
        if message.is_remote_frame:
            self.counts["remote_frames"] += 1
            return None
        data = bytes(message.data)
        if not message.is_fd and len(data) != message.dlc:
            self.note("truncated", f"a frame {message.arbitration_id:X} has {len(data)} of {message.dlc} bytes")
            return None
        limit = 0x1FFFFFFF if message.is_extended_id else 0x7FF
        if not (math.isfinite(message.timestamp) and 0 <= message.arbitration_id <= limit):
            self.note("refused", f"no frame has the identifier {message.arbitration_id:X} at {message.timestamp}")
            return None
        channel = "" if message.channel is None else str(message.channel)
        return CanFrame(
            time=message.timestamp,
            id=message.arbitration_id,
            extended=message.is_extended_id,
            data=data,
            channel=channel,
            fd=message.is_fd,
        )

    def note(self, what: str, sentence: str) -> None:
        """Count a fault; the first one is remembered."""
        self.counts[what] += 1
        self.problem = self.problem or sentence

    def summary(self) -> str:
        """What was found beside data frames, as words; "" if nothing."""
        others = [
            f"{count} {name.replace('_', ' ')}" for name, count in self.counts.items() if count and name != "frames"
        ]
        return ", ".join(others) + (f" (first: {self.problem})" if self.problem else "")


_NEEDS_ASAMMDF = (
    "MF4 logs need the package asammdf, which is not installed here; install it, or convert the log to BLF, ASC or "
    "candump text"
)


def open_log(path: Path, format_: str | None = None) -> Log:
    """The log at `path`, not yet read; `format_` is a key of FORMATS where the suffix does not say it.

    Raises RecordingError with one sentence for what is no file, is empty or of no known format.
    """
    if format_ is not None and format_ not in FORMATS:
        raise RecordingError(f"{format_!r} is no format of CAN logs; give one of {', '.join(FORMATS)}")
    try:
        size = regular(path).stat().st_size
        if path.is_dir():
            raise RecordingError(f"{path}: is a folder; give one log file")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    if size == 0:
        raise RecordingError(f"{path}: is empty")
    name = path.name.lower().removesuffix(".gz")
    chosen = format_ or _SUFFIXES.get(Path(name).suffix)
    if chosen is None:
        raise RecordingError(
            f"{path}: the suffix does not tell the format; give it as one of {', '.join(FORMATS)} (known suffixes: "
            f"{', '.join(_SUFFIXES)}, each with .gz too)"
        )
    if chosen == "mf4" and find_spec("asammdf") is None:
        raise RecordingError(f"{path}: {_NEEDS_ASAMMDF}")
    return Log(path, chosen, size=size)


def require_frames(log: Log) -> None:
    """Raises RecordingError if the log was read and had not one data frame."""
    if log.counts["frames"] == 0:
        others = log.summary()
        raise RecordingError(
            f"{log.path}: there is no data frame in this {log.format} log" + (f": {others}" if others else "")
        )


class _Lines:
    """A text log's lines as python-can's readers take them: a file that is only iterated and closed."""

    def __init__(self, stream: BinaryIO, kind: Format, log: Log) -> None:
        self._stream = stream
        self._kind = kind
        self._log = log
        self.number = 0
        self.ended = self._broken = False
        self.first: str | None = None
        self._ahead: deque[bytes] = deque()
        while len(self._ahead) < _HEAD_LINES and (octets := self._read_line()):
            self._ahead.append(octets)
        self._rewrite = kind.dialect([octets.decode("utf-8", "replace") for octets in self._ahead])

    def __iter__(self) -> "_Lines":
        return self

    def __next__(self) -> str:
        if self.first is not None:
            line, self.first = self.first, None
            return line
        while True:
            line = self._rewrite(self._line())
            if self.number == 1 and self._kind.header:
                if line.strip().lstrip("\ufeff") != self._kind.header:
                    self._log.note("refused", f"line 1 is not {self._kind.header!r}")
                return line
            verdict = self._kind.check(line)
            if not verdict:
                return line
            if verdict == "refused":
                self._log.note("refused", f"line {self.number} is no {self._log.format} record: {line.strip()[:60]!r}")
            elif verdict in self._log.counts:
                self._log.counts[verdict] += 1

    def close(self) -> None:
        """The reader is done; the file is closed by whom it was opened."""

    def _line(self) -> str:
        """The next line that is text; others are counted. Raises StopIteration at the end."""
        while True:
            octets = self._read()
            if not octets:
                self.ended = True
                raise StopIteration
            self.number += 1
            whole = len(octets) <= _LONGEST_LINE
            if not whole:
                while len(octets) > _LONGEST_LINE and not octets.endswith(b"\n"):
                    octets = self._read()
            text = octets.decode("utf-8", "replace")
            if whole and "\0" not in text and "\ufffd" not in text:
                return text
            self._log.note("refused", f"line {self.number} is not text")

    def _read(self) -> bytes:
        return self._ahead.popleft() if self._ahead else self._read_line()

    def _read_line(self) -> bytes:
        if self._broken:
            return b""
        try:
            return self._stream.readline(_LONGEST_LINE + 1)
        except (OSError, EOFError, zlib.error) as error:
            self._broken = True
            self._log.note("broken", f"after line {self.number}: {error}")
            return b""
