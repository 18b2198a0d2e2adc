"""Readings of the HMI beside those of the PLC: lists of them, whether two agree, and when a tag is proved (pure)."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.codec import encode, other_order, register_count
from drivers.errors import EncodingError
from drivers.tag import DType, Tag, Value
from gateway.commission.encodings import ReadingError, ShownNumber, parse_display
from gateway.commission.files import COLUMNS, ListError, header_key, parse_flag, read_sheet

_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "name": COLUMNS["name"],
    "value": (
        *("valore", "value", "valore hmi", "hmi", "hmi value", "lettura", "reading", "letto", "mostrato", "shown"),
        *("display", "valore letto", "indicazione"),
    ),
    "time": (
        "time",
        "ora",
        "data e ora",
        "date time",
        "timestamp",
        "data ora",
        "orario",
        "datetime",
        "when",
        "istante",
    ),
}
_DATES = ("%d/%m/%Y %H:%M:%S", "%d/%m/%Y %H:%M", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M")
_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?")
_FLOAT_STEP = {DType.FLOAT32: 2.0**-23, DType.FLOAT64: 2.0**-52}


@dataclass(frozen=True, slots=True)
class HmiReading:
    """What the HMI showed for a tag: as text, at a time (s UTC) or now; `where` is its place in the list."""

    tag: str
    text: str
    time: float | None = None
    where: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One comparison. `tolerance` is by how much the two may differ; `definition` says which place the tag had.

    `exact`: rounding or cutting digits off explains what was shown; else the value must have moved meanwhile.
    """

    tag: str
    shown: str
    read: Value | None
    ok: bool
    reason: str
    tolerance: float
    definition: str
    time: float
    exact: bool = True

    @property
    def number(self) -> float | None:
        """The reading as a number; None for text."""
        return None if self.read is None or isinstance(self.read, str) else float(self.read)


def definition_hash(tag: Tag) -> str:
    """A short hash of where and how the tag lies: what was proved for another place is not proved for this one."""
    place = (tag.address, tag.dtype.value, tag.order.value, tag.scale, tag.offset, tag.bit, tag.length)
    # Only where there is one: what was proved before tags could have a factor's register is proved still.
    text = repr((*place, tag.scale_from) if tag.scale_from else place)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


# ---------------------------------------------------------------- lists


def read_hmi_list(path: Path, tags: Sequence[Tag], now: float) -> list[HmiReading]:
    """The readings in a list: one row a reading (tag, value, time if any), or one column a tag.

    Times without a date are of the day of `now`, in this machine's time zone. Raises ListError.
    """
    known = {header_key(tag.name): tag.name for tag in tags}
    readings = []
    try:
        sheet = read_sheet(path, _COLUMNS, ("name", "value"))
    except ListError as error:
        # A list with a column a tag: any one of the tags is enough to know the header by.
        columns = {"time": _COLUMNS["time"], **{tag.name: (header_key(tag.name),) for tag in tags}}
        for tag in tags:
            with suppress(ListError):
                sheet = read_sheet(path, columns, (tag.name,))
                break
        else:
            raise error from None
        for line in sheet.lines:
            when = _time(sheet.where(line, "time"), line.get("time"), now)
            names = [name for name in sheet.columns if name != "time" and line.get(name)]
            readings += [HmiReading(name, line.get(name), when, sheet.where(line, name)) for name in names]
        return readings
    for line in sheet.lines:
        name, text = line.get("name"), line.get("value")
        if header_key(name) not in known:
            raise ListError(
                f"{sheet.where(line, 'name')}: {name!r} is no tag of the device file; give one of its names"
            )
        if text:
            when = _time(sheet.where(line, "time"), line.get("time"), now)
            readings.append(HmiReading(known[header_key(name)], text, when, sheet.where(line, "value")))
    return readings


def _time(where: str, text: str, now: float) -> float | None:
    """Seconds UTC; None for an empty cell. Raises ListError."""
    if not text:
        return None
    if match := _CLOCK.fullmatch(text):
        today = datetime.fromtimestamp(now).astimezone()
        seconds = float((match[3] or "0").replace(",", "."))
        hour, minute = int(match[1]), int(match[2])
        if hour < 24 and minute < 60 and seconds < 60:
            return today.replace(hour=hour, minute=minute, second=0, microsecond=0).timestamp() + seconds
    for form in _DATES:
        try:
            return datetime.strptime(text, form).astimezone().timestamp()
        except ValueError:
            continue
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).astimezone().timestamp()
    except ValueError:
        raise ListError(
            f"{where}: {text!r} is no time; give 14:30:05, 2026-03-01 14:30:05 or 01/03/2026 14:30"
        ) from None


# ---------------------------------------------------------------- comparing


def compare(
    tag: Tag, shown: HmiReading, values: Sequence[Value], now: float, slack: float = 0.0, *, missing: str = ""
) -> Point:
    """Whether the HMI's reading agrees with one of the PLC's, or lies between them while the value moves.

    A number may be off by one step of its last digit (an HMI rounds, or cuts), half a step of the raw value, and
    `slack` in engineering units. `missing` is why there are no values, if it is known. Raises ListError for a text that
    is nothing such a tag shows.
    """
    wanted, tolerance, step = _meaning(tag, shown, slack)
    ok, read, reason = _agreement(wanted, values, tolerance, tag)
    if not values and missing:
        reason = f"{reason}: {missing}"
    numbers = [float(value) for value in values if not isinstance(value, str)]
    exact = True
    if step and numbers:
        # Between two looks the value passed through all between; it may be off by `slack` besides.
        number = float(wanted)
        passed = min(max(number, min(numbers) - slack), max(numbers) + slack)
        display, at = ShownNumber(number, step), np.array([passed])
        exact = bool(display.rounding_mask(at)[0] or display.truncation_mask(at)[0])
    return Point(
        tag=tag.name,
        shown=shown.text,
        read=read,
        ok=ok,
        reason=reason,
        tolerance=tolerance,
        definition=definition_hash(tag),
        time=now,
        exact=exact,
    )


def _meaning(tag: Tag, shown: HmiReading, slack: float) -> tuple[Value, float, float]:
    """What the text says, the tolerance, and what its last digit counts (0 for what is no number)."""
    key = header_key(shown.text)
    if tag.dtype is DType.STRING:
        return shown.text, 0.0, 0.0
    for number, label in tag.labels.items():
        if header_key(label) == key:
            return number, 0.0, 0.0
    if tag.is_switch:
        flag = parse_flag(key)
        if flag is None:
            raise ListError(f"{shown.where or tag.name}: {shown.text!r} is no state; give 1 or 0, on or off")
        return flag, 0.0, 0.0
    try:
        reading = parse_display(shown.text)
    except ReadingError as error:
        raise ListError(f"{shown.where or tag.name}: {error}") from None
    if isinstance(reading, bool):
        raise ListError(f"{shown.where or tag.name}: {shown.text!r} is no number; give it as the HMI shows it")
    # The last digit may be cut off, wrong by up to a whole step of it; the little more is for binary fractions.
    raw = abs(reading.value) * _FLOAT_STEP[tag.dtype] if tag.dtype in _FLOAT_STEP else abs(tag.scale) / 2
    if tag.scale_from:
        raw = 0.0  # what a count is worth stands in the device alone
    return reading.value, reading.step * 1.000001 + raw + slack, reading.step


def _agreement(wanted: Value, values: Sequence[Value], tolerance: float, tag: Tag) -> tuple[bool, Value | None, str]:
    if not values:
        return False, None, "there is no good reading of the PLC at that time"
    if isinstance(wanted, str | bool) or any(isinstance(value, str | bool) for value in values):
        ok = wanted in values
        return ok, wanted if ok else values[-1], "" if ok else f"the PLC has {values[-1]!r}"
    numbers = [float(value) for value in values if not isinstance(value, str)]
    nearest = min(numbers, key=lambda value: abs(value - wanted))
    # Between two looks the value passed through what the HMI showed: anything between them agrees.
    ok = min(numbers) - tolerance <= wanted <= max(numbers) + tolerance
    if ok:
        return True, nearest, ""
    off = f"the PLC has {nearest:.6g} {tag.unit}".rstrip()
    reason = f"{off}, {nearest - wanted:+.4g} off; may be {tolerance:.2g}"
    # What the HMI shows is the best evidence of the order: the same registers in another one may be just that.
    with suppress(EncodingError):
        swapped = other_order(tag, encode(tag, nearest), lambda value: abs(value - wanted) <= tolerance)
        reason += swapped and f"; {swapped}"
    return False, nearest, reason


# ---------------------------------------------------------------- proof


def missing_proof(tag: Tag, points: Sequence[Point]) -> str:
    """What is missing until the tag is proved ("": nothing): two distinct values of a number, both states of a flag.

    A number needs a third one where a register may be a neighbour's: it held the same word at each, or a reading agreed
    within the tolerance only.
    """
    here = [point for point in points if point.tag == tag.name and point.definition == definition_hash(tag)]
    own = [point for point in here if point.ok]
    if not own:
        return f"compared and did not agree: {here[-1].reason}" if here else "not compared yet"
    if tag.dtype is DType.STRING:
        return ""
    if tag.is_switch:
        states = {bool(point.read) for point in own}
        return "" if len(states) == 2 else f"seen {'on' if True in states else 'off'} only"
    distinct: list[Point] = []
    for point in sorted((point for point in own if point.exact), key=_number):
        if not distinct or _number(point) - _number(distinct[-1]) > point.tolerance + distinct[-1].tolerance:
            distinct.append(point)
    if len(distinct) > 2:
        return ""
    at = " and ".join(f"{_number(point):.6g}" for point in distinct)
    if inexact := [point for point in own if not point.exact]:
        off = f"{inexact[0].shown} was shown where it reads {_number(inexact[0]):.6g}"
        return f"{off}: it moved, or a register is a neighbour's: compare {3 - len(distinct)} more values at rest"
    if len(distinct) < 2:
        return f"compared at {at} only"
    words = [encode(tag, _number(point)) for point in distinct] if register_count(tag) > 1 else []
    if any(len(set(word)) == 1 for word in zip(*words, strict=True)):
        return f"compared at {at} only: a register held the same both times and may be a neighbour's: compare a third"
    return ""


def _number(point: Point) -> float:
    return point.number or 0.0


def parse_points(result: Mapping[str, Any]) -> list[Point]:
    """The comparisons in the record of an earlier `verify`; what is none is left out."""
    points = []
    for plain in result.get("points", ()):
        try:
            points.append(Point(**{key: plain[key] for key in Point.__dataclass_fields__ if key in plain}))
        except (KeyError, TypeError):
            continue
    return points
