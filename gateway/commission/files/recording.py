"""Recordings of readings: made by `check soak`, read by `check hmi` and `replay`; a gateway's historian is one too."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from drivers.csv_rows import CsvRowError, numbered_rows, write_rows
from drivers.named_files import name_write_errors, regular
from drivers.tag import Sample, Tag
from gateway.commission.files.cells import ListError
from gateway.store import SQLITE_HEADER
from sim.moments import exact_moments

_WORDS = {"": math.nan, "nan": math.nan, "true": 1.0, "false": 0.0}


@dataclass(frozen=True, slots=True)
class SiteRecording:
    """n rows: `times` (s, rising) and a column of n numbers a tag, NaN where there was no good reading."""

    path: Path
    times: Sequence[float]
    columns: Mapping[str, Sequence[float]]

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return self.times[-1] - self.times[0]


def read_recording(path: Path, start: float = -1e18, end: float = 1e18, *, machine: str | None = None) -> SiteRecording:
    """The readings in a CSV (first column `time`) or a gateway's historian, from `start` to `end` (s).

    Of a historian they are those of one `machine`, None: of the only one. Raises ListError or HistorianError, in one
    sentence, for what cannot be used.
    """
    try:
        with regular(path).open("rb") as stream:
            historian = stream.read(len(SQLITE_HEADER)) == SQLITE_HEADER
        if historian:
            from gateway.store import to_trace

            trace = to_trace(path, path.stem, start, end, machine=machine)
            columns = {name: column.tolist() for name, column in trace.signals.items()}
            recording = SiteRecording(path, trace.times.tolist(), columns)
        else:
            recording = _from_csv(path, start, end)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ListError(f"{path}: cannot be read ({reason}); give a recording (soak --record) or a historian") from None
    except UnicodeDecodeError as error:
        raise ListError(f"{path}: is no text (byte {error.start}); give a recording or a historian") from None
    if not recording.times:
        raise ListError(f"{path}: has no reading in that time; give a longer recording")
    return recording


def _from_csv(path: Path, start: float, end: float) -> SiteRecording:
    names: list[str] = []
    times: list[float] = []
    columns: list[list[float]] = []
    with path.open(encoding="utf-8-sig", newline="") as stream:
        for number, cells in _rows(stream, path):
            where = f"{path}: line {number}"
            if not names:
                header = [cell.strip() for cell in cells]
                if header[0] != "time" or len(header) < 2 or len(set(header)) < len(header) or not all(header):
                    raise ListError(
                        f"{where}: is no header; the first column is 'time', each other one a tag, none twice"
                    )
                names = header[1:]
                columns = [[] for _ in names]
                continue
            if len(cells) != len(names) + 1:
                raise ListError(f"{where}: has {len(cells)} cells for {len(names) + 1} columns; give one a column")
            moment = _time(where, cells[0])
            if times and moment < times[-1]:
                before, then = exact_moments(times[-1], moment)
                raise ListError(f"{where}: the time goes back from {before} to {then}; sort the rows by time")
            if start <= moment <= end:
                times.append(moment)
                for column, name, cell in zip(columns, names, cells[1:], strict=True):
                    word = cell.strip().lower()
                    try:
                        column.append(_WORDS[word] if word in _WORDS else float(word))
                    except ValueError:
                        raise ListError(
                            f"{where}, {name!r}: {cell!r} is no number; give one, or leave it empty"
                        ) from None
    return SiteRecording(path, times, dict(zip(names, columns, strict=True)))


def _rows(stream: Iterable[str], path: Path) -> Iterator[tuple[int, list[str]]]:
    try:
        yield from numbered_rows(stream)
    except CsvRowError as error:
        raise ListError(f"{path}: line {error.line}: is not CSV ({error.reason}); correct that line") from None


def _time(where: str, cell: str) -> float:
    """Seconds, or ISO 8601 (UTC where it names no zone)."""
    try:
        moment = float(cell)
    except ValueError:
        try:
            read = datetime.fromisoformat(cell.strip())
        except ValueError:
            raise ListError(f"{where}: {cell!r} is no time; give seconds, or 2026-03-01T14:30:05") from None
        return (read if read.tzinfo else read.replace(tzinfo=UTC)).timestamp()
    if not math.isfinite(moment):
        raise ListError(f"{where}: {cell!r} is no time; give seconds")
    return moment


class ScanRecorder:
    """Writes one row a scan: time and the value of every tag, nothing where it was not good. Raises OSError."""

    def __init__(self, path: Path, tags: Sequence[Tag]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._stream = path, path.open("w", encoding="utf-8", newline="")
        self._names = [tag.name for tag in tags]
        write_rows(self._stream, [("time", *self._names)])

    def take(self, time: float, samples: Sequence[Sample]) -> None:
        """One scan."""
        by_name = {sample.tag: sample for sample in samples}
        cells = []
        for name in self._names:
            sample = by_name[name]
            value = sample.value
            if not sample.quality.is_good or value is None or isinstance(value, str):
                cells.append("")  # text too is left out: a recording holds numbers only
            else:
                cells.append(str(int(value)) if isinstance(value, bool) else repr(value))
        write_rows(self._stream, [(f"{time:.3f}", *cells)])
        # What was read stands in the file even when the program is killed.
        with name_write_errors(self._path):
            self._stream.flush()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
