"""Texts that are no table of cells between marks: layouts of programs, aligned columns, lines of a protocol, as rows.

Each layout is told by what its first lines say; its rows begin with a header, and what is no row of the table comes as
a row of one cell, which is refused and counted as such.
"""

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import chain, islice

from sim.lab.recordings.load_report import TraceError

Cells = list[str]
ToRows = Callable[[Iterable[str]], Iterator[Cells]]
"""What makes rows, the header first, of the lines of a text. Raises TraceError without the file's name."""
_SHOWN_LINES = 60
_MOST_ABOVE = 30
"""Lines above the names of an aligned table at most."""


def find_layout_of(head: str) -> ToRows | None:
    """What makes rows of a text that begins with `head`; None for one that is a table of cells already, or nothing."""
    lines = head.splitlines()[:_SHOWN_LINES]
    if not lines:
        return None
    first = lines[0].lstrip("\ufeff").strip()
    if first.startswith("LabVIEW Measurement"):
        return _measurement if any(re.fullmatch(r"X_Columns\W+No\s*", line) for line in lines) else None
    if len(lines) > 3 and re.match(r"Name[\t;,]", first) and re.match(r"Starttime of export\W", lines[2]):
        return _scope
    if first.upper() == "ASCII" and len(lines) > 3 and len(lines[1].strip()) == 1 and lines[1].strip() in lines[3]:
        return _fast_load
    told = [line for line in lines[:-1] or lines if line.strip() and not line.startswith("#")]
    if 2 * sum(_POINT.fullmatch(line) is not None for line in told) > len(told):
        return _points
    if any(map(_is_ruler, lines[:_MOST_ABOVE])):
        return _ruled if _is_as_wide(lines) else None
    if {"tag", "unit"} <= {_cells(line)[0].casefold().rstrip(".:") for line in lines} and _recorder_head(lines):
        return _recorder
    return _aligned if _split_by_blanks(lines) else None


def _measurement(lines: Iterable[str]) -> Iterator[Cells]:
    """LabVIEW's measurement without a column of times: each row has the begin of the recording and a constant step."""
    said: dict[str, Cells] = {}
    rows, marks = iter(lines), 0
    mark = "\t"
    for line in rows:
        cells = line.rstrip("\r\n").split(mark)
        if cells[0].startswith("***End_of_Header"):
            marks += 1
            if marks == 2:
                break
        elif (cells[0] == "Separator" and cells[1:2] == ["Comma"]) or line.startswith("Separator,"):
            mark = ","
        if len(cells) > 1:
            said[cells[0]] = [cell.strip() for cell in cells[1:]]
    names = [cell.strip() for cell in next(rows, "").rstrip("\r\n").split(mark)]
    channels = [place for place, name in enumerate(names) if name and name not in ("X_Value", "Comment")]
    steps, starts = (_floats(said.get(key, [])) for key in ("Delta_X", "X0"))
    if len(set(steps)) != 1 or len(set(starts)) > 1 or not {"Time", ""} >= set(said.get("X_Dimension", ["Time"])):
        raise TraceError(
            "its channels have no common time: Delta_X and X0 are not one value; export them with their X columns"
        )
    moment = _moment(said.get("Date", [""])[0], said.get("Time", [""])[0])
    begin, step = starts[0] if starts else 0.0, steps[0]
    head = "X_Value" if moment is None else "Time"
    yield [head if moment is not None else "X_Value (s)", *(names[place] for place in channels)]
    blank = False
    for number, line in enumerate(rows):
        text = line.rstrip("\r\n")
        cells = text.split(mark)
        # LabVIEW writes a header for each time that it was started, or for each packet.
        if cells[0] == "Channels" or cells[0].startswith("***End_of_Header"):
            raise TraceError(
                "its rows go on below another header, with a begin of their own; export them with their X columns"
            )
        if blank and text:
            raise TraceError(
                "a blank line stands among its rows, and whether it took a step cannot be told; export them with "
                "their X columns"
            )
        blank = not text
        if blank:
            continue
        seconds = begin + number * step
        time = f"{seconds:.9g}" if moment is None else _iso(moment + timedelta(seconds=seconds))
        yield [time, *(cells[place].strip() if place < len(cells) else "" for place in channels)]


def _floats(cells: Sequence[str]) -> list[float]:
    return [float(cell.replace(",", ".")) for cell in cells if cell]


def _moment(day: str, time: str) -> datetime | None:
    try:
        return datetime.fromisoformat(f"{day.replace('/', '-')}T{time.replace(',', '.')[:15]}")
    except ValueError:
        return None


def _iso(moment: datetime) -> str:
    return moment.isoformat(sep=" ", timespec="microseconds")


def _scope(lines: Iterable[str]) -> Iterator[Cells]:
    """A TwinCAT Scope: blocks of keys and channels; a column of ms since its start for each channel, or for several."""
    rows = iter(lines)
    above = list(islice(rows, 3))
    mark = next(each for each in "\t;," if above[0].startswith(f"Name{each}"))
    start = above[2].rstrip("\r\n").split(mark)
    if len(start) < 2 or not start[1].isdigit():
        raise TraceError("its line 3 does not say when the export starts, as TwinCAT Scope writes it; export it anew")
    begin = datetime(1601, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(start[1]) // 10)
    said: dict[str, Cells] = {}
    places: list[int] = []
    for line in rows:
        cells = line.rstrip("\r\n").split(mark)
        if cells[0] == "Name" and not places:
            places = [place for place, cell in enumerate(cells) if cell != "Name" or place % 2]
            times = [max(at for at in range(place) if cells[at] == "Name" and at not in places) for place in places]
        if places and cells[0].strip() and cells[0][:1].isdigit():
            rows = chain([line], rows)
            break
        said.setdefault(cells[0], cells)
    if not places:
        raise TraceError("no line names its channels, as TwinCAT Scope writes them; export it anew")
    units = said.get("Unit", [])
    names = [said["Name"][place] + _unit(units[place] if place < len(units) else "") for place in places]
    yield ["Time", "Name", "Value"]
    told = [""] * len(places)
    for line in rows:
        cells = line.rstrip("\r\n").split(mark)
        if len(cells) <= max(places):
            if line.strip() and not line.startswith("EOF"):
                yield [line.strip()]
            continue
        for number, (place, at) in enumerate(zip(places, times, strict=True)):
            # A slower channel's row is there again until its next one.
            if (count := cells[at].strip()) and count != told[number]:
                told[number] = count
                try:
                    moment = _iso(begin + timedelta(milliseconds=float(count.replace(",", "."))))
                except (ValueError, OverflowError):
                    yield [count]
                else:
                    yield [moment, names[number], cells[place]]


def _unit(said: str) -> str:
    """A channel's unit as a header writes it: of "V (Voltage)" the V, nothing of "(None)"."""
    unit = said.partition("(")[0].strip()
    return f" [{unit}]" if unit else ""


def _fast_load(lines: Iterable[str]) -> Iterator[Cells]:
    """A file from which AVEVA's historian is loaded: tag, operation, day, time, kind of value, value, quality."""
    rows = iter(lines)
    mark = list(islice(rows, 3))[1].strip()
    yield ["Time", "TagName", "Value", "Quality"]
    for line in filter(str.strip, rows):
        cells = [cell.strip() for cell in line.split(mark)]
        if len(cells) != len(_FAST_LOAD):
            yield [line.strip()]
            continue
        row = dict(zip(_FAST_LOAD, cells, strict=True))
        yield [f"{row['day'].replace('/', '-')} {row['time']}", row["tag"], row["value"], row["quality"]]


_FAST_LOAD = ("tag", "operation", "day", "time", "kind", "value", "quality")
_ESCAPED = r"(?:\\.|[^\\,= ])+"
_FIELD = rf'{_ESCAPED}=(?:"(?:\\.|[^"\\])*"|[^",= ]+)'
_POINT = re.compile(
    rf"\s*((?:\\.|[^\\, ])+)((?:,{_ESCAPED}={_ESCAPED})*) ({_FIELD}(?:,{_FIELD})*)(?: (-?\d{{10,19}}))\s*"
)
"""A point of InfluxDB's line protocol with its time: measurement, tags, fields."""
_TAG = re.compile(rf"({_ESCAPED})=({_ESCAPED})")
_READ = re.compile(rf'({_ESCAPED})=("(?:\\.|[^"\\])*"|[^",= ]+)')
_NUMBER_KIND = re.compile(r"([-+]?\d+)[iu]")


def _points(lines: Iterable[str]) -> Iterator[Cells]:
    """Points of a time series database: a row each, a column for each tag and each field that one of them has."""
    found: list[tuple[str, str, str, str]] = []
    odd: list[str] = []
    for line in lines:
        if not line.strip() or line.startswith("#"):
            continue
        if (match := _POINT.fullmatch(line.rstrip("\r\n"))) is None:
            odd.append(line.strip())
        else:
            name, tags, fields, time = match.groups()
            found.append((_plain(name), tags, fields, time))
    several = len({name for name, *_ in found}) > 1
    of_tags = list(dict.fromkeys(tag for _, own, *_ in found for tag in _tags(own)))
    of_fields = list(dict.fromkeys(_field(name, key, several) for name, _, own, _ in found for key in _fields(own)))
    yield ["time", *of_tags, *of_fields]
    for name, tags, fields, time in found:
        said = _tags(tags)
        read = {_field(name, key, several): value for key, value in _fields(fields).items()}
        yield [time, *(said.get(tag, "") for tag in of_tags), *(read.get(field, "") for field in of_fields)]
    yield from ([line] for line in odd)


def _field(name: str, key: str, several: bool) -> str:
    return name if key == "value" else f"{name}.{key}" if several else key


def _tags(text: str) -> dict[str, str]:
    """Tags are texts as they stand there: quotation marks and a letter behind digits tell machines apart."""
    return {_plain(key): _plain(value) for key, value in _TAG.findall(text)}


def _fields(text: str) -> dict[str, str]:
    return {_plain(key): _reading(value) for key, value in _READ.findall(text)}


def _plain(text: str) -> str:
    """A name or a tag without the escapes of what would part it; any other backslash is one."""
    return re.sub(r"\\([,= ])", r"\1", text)


def _reading(text: str) -> str:
    """A field's value without its quotation marks, their escapes, and the letter that says whole number."""
    if text.startswith('"'):
        return re.sub(r'\\(["\\])', r"\1", text[1:-1])
    return match[1] if (match := _NUMBER_KIND.fullmatch(text)) else text


def _is_ruler(line: str) -> bool:
    """Whether a line only draws the widths of columns, two at least."""
    return re.fullmatch(r"\s*-{2,}(?: +-{2,})+\s*", line) is not None


def _is_as_wide(lines: Sequence[str]) -> bool:
    """Whether a ruler is as wide as the columns below it, and not as their names, beside which longer cells run on."""
    at = next(number for number, line in enumerate(lines) if _is_ruler(line))
    edges = [match.start() for match in re.finditer(r"-+", lines[at])][1:]
    below = [line for line in lines[at + 1 :] if line.strip()][:_RULED_ROWS]
    fitting = sum(len(line) >= edges[-1] and not any(line[edge - 1].strip() for edge in edges) for line in below)
    # Of a wider gap it cannot be told whose it is.
    return re.search("- {2,}-", lines[at]) is None and 2 * fitting > len(below)


_RULED_ROWS = 5
"""Rows below a ruler that show whether it is theirs: behind a short table stands how many rows it has."""


def _ruled(lines: Iterable[str]) -> Iterator[Cells]:
    """A table whose columns are as wide as the line below their names, as consoles of databases print it."""
    rows = iter(lines)
    names = ""
    for line in rows:
        if _is_ruler(line):
            spans = [match.span() for match in re.finditer(r"-+", line)]
            break
        names = line if line.strip() else names
    # What is wider than its column pushes nothing: the last one goes on to the end.
    edges = [*(begin for begin, _ in spans[1:]), None]
    cuts = list(zip([0, *edges[:-1]], edges, strict=True))
    yield [names[begin:end].strip() for begin, end in cuts]
    for line in rows:
        text = line.rstrip("\r\n")
        if not text.strip() or _is_ruler(text) or text.rstrip() == names.rstrip():
            continue
        # A footer has letters where columns part.
        if any(text[edge - 1 : edge].strip() for edge in edges[:-1] if edge is not None):
            yield [text.strip()]
        else:
            yield [text[begin:end].strip() for begin, end in cuts]


def _cells(line: str) -> Cells:
    """The cells of a line of a recorder's table, which parts them by tabs, semicolons or commas."""
    mark = next((each for each in "\t;," if each in line), ",")
    return [cell.strip() for cell in next(csv.reader([line.rstrip("\r\n")], delimiter=mark), [""])] or [""]


_CLOCK_NAMES = frozenset({"date", "datum", "date time", "date/time", "time", "zeit", "sec"})
_KINDS_OF_VALUE = frozenset({"", "value", "inst", "min", "max", "mean", "avg", "ave", "average"})


def _recorder_head(lines: Sequence[str]) -> int:
    """Where the row of Date and Time stands below a paper recorder's rows of Ch, Tag and Unit; 0 for none."""
    for number, line in enumerate(lines):
        cells = _cells(line)
        if number and cells[0].casefold() in _CLOCK_NAMES and len(cells) > 2:
            # Names of columns there are those of the table.
            if not {cell.casefold() for cell in cells} <= _CLOCK_NAMES | _KINDS_OF_VALUE:
                return 0
            above = {_cells(each)[0].casefold().rstrip(".:") for each in lines[max(number - 6, 0) : number]}
            return number if {"tag", "unit"} <= above else 0
    return 0


def _recorder(lines: Iterable[str]) -> Iterator[Cells]:
    """A paper recorder: its channels, tags and units stand in rows of their own above what tells Min from Max.

    Of the time, its column `sec` has what is below a second.
    """
    rows = iter(lines)
    shown = list(islice(rows, _SHOWN_LINES))
    at = _recorder_head(shown)
    said = {cells[0].casefold().rstrip(".:"): cells for cells in map(_cells, shown[:at])}
    names = _cells(shown[at])
    tags, channels, units = (said.get(key, []) for key in ("tag", "ch", "unit"))
    header = []
    fine = names.index("sec") if "sec" in names[1:] else 0
    for place, own in enumerate(names):
        tag, channel, unit = (row[place] if place < len(row) else "" for row in (tags, channels, units))
        called = (tag or channel) if place and (tag or channel) else ""
        told = own if own.casefold() not in ("value", "inst", "") or not called else ""
        header.append(" ".join(filter(None, (called, told))) + (f" [{unit}]" if unit and called else ""))
    yield header
    for line in chain(shown[at + 1 :], rows):
        if line.strip():
            cells = _cells(line)
            if 0 < fine < len(cells) and cells[fine].strip("0."):
                part = _PART_OF_SECOND.fullmatch(cells[fine])
                cells[fine - 1] += part[1] if part else f" {cells[fine]}"
            yield cells if len(cells) > 1 else [line.strip()]


_PART_OF_SECOND = re.compile(r"0?(\.\d{1,9})")


_SEPARATES = re.compile(r"[;\t|]")


def _split_by_blanks(lines: Sequence[str]) -> Callable[[str], Cells] | None:
    """What gives the cells of a line, one for no row, where blanks alone part columns below names; None elsewhere."""
    told = [line for line in lines if line.strip() and not line.startswith("#")]
    for wide in (True, False):
        cells = [_by_wide_blanks(line) if wide else _by_blanks(line) for line in told]
        widths = [len(row) for row in cells[1:]]
        width = max(set(widths), key=widths.count, default=0)
        if width < 2 or len(told) < 3 or any(_SEPARATES.search(line) for line in told):
            continue
        above = [place for place, row in enumerate(cells[:_MOST_ABOVE]) if len(row) == width and not _has_digits(row)]
        # Commas between names are what parts the cells; in rows they may be decimal ones.
        if not above or any("," in name for name in cells[above[-1]]):
            continue
        split = partial(_below_names, names=told[above[-1]]) if wide else partial(_one_apart, width=width)
        below = [split(line) for line in told[above[-1] + 1 :]]
        if below and sum(len(row) == width for row in below) >= 0.9 * len(below) and all(map(_has_digits, below[:2])):
            return split
    return None


_WIDE_CELL = re.compile(r"\S+(?: \S+)*")
"""A cell where two blanks at least part cells."""


def _below_names(line: str, names: str) -> Cells:
    """The cells of a line, each of which stands below one of the `names`; of a line with a blank one, one cell."""
    own, above = ([found.span() for found in _WIDE_CELL.finditer(text)] for text in (line, names))
    under = len(own) == len(above) and all(
        begin < upper_end and upper < end for (begin, end), (upper, upper_end) in zip(own, above, strict=True)
    )
    return [line[begin:end] for begin, end in own] if under else [line.strip()]


def _by_wide_blanks(line: str) -> Cells:
    return _WIDE_CELL.findall(line)


def _by_blanks(line: str) -> Cells:
    """Cells with one blank between them: where there are more, one is blank or padded, and which cannot be told."""
    cells = line.rstrip("\r\n").split(" ")
    return cells if all(cells) else [line.strip()]


def _one_apart(line: str, width: int) -> Cells:
    cells = _by_blanks(line)
    return cells if len(cells) == width else [line.strip()]


def _has_digits(row: Sequence[str]) -> bool:
    """Whether cells of a row are numbers or times, and no names."""
    return sum(cell[:1].isdigit() or cell[:1] in "+-" for cell in row) * 2 >= len(row)


def _aligned(lines: Iterable[str]) -> Iterator[Cells]:
    """A table whose columns are parted by one blank each, or by two at least, as where a cell has several words."""
    rows = iter(lines)
    shown = list(islice(rows, _SHOWN_LINES))
    if (split := _split_by_blanks(shown)) is None:
        raise TraceError("its columns are not parted by blanks as its first lines are; give a CSV")
    for line in filter(str.strip, chain(shown, rows)):
        yield line.split() if line.startswith("#") else split(line)
