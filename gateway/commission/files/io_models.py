"""SunSpec's published models (JSON) as register lists: each point a row, its factor by the register that has it.

A model lies where the device has it, so that its addresses are counted from its first register, the model's number.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.errors import OneLineError
from gateway.commission.files.cells import ListRow

_TYPES: Mapping[str, tuple[str, str]] = {
    "int16": ("int16", "0x8000"),
    "uint16": ("uint16", "0xFFFF"),
    "acc16": ("uint16", ""),
    "enum16": ("uint16", "0xFFFF"),
    "bitfield16": ("uint16", "0xFFFF"),
    "raw16": ("uint16", ""),
    "count": ("uint16", "0xFFFF"),
    "int32": ("int32", "0x80000000"),
    "uint32": ("uint32", "0xFFFFFFFF"),
    "acc32": ("uint32", ""),
    "enum32": ("uint32", "0xFFFFFFFF"),
    "bitfield32": ("uint32", "0xFFFFFFFF"),
    "int64": ("int64", str(-(1 << 63))),
    "uint64": ("uint64", str((1 << 64) - 1)),
    "acc64": ("uint64", ""),
    "bitfield64": ("uint64", str((1 << 64) - 1)),
    "float32": ("float32", ""),
    "float64": ("float64", ""),
    "string": ("string", ""),
}
"""Type -> ours and the raw number for "not implemented" (SunSpec Information Model Specification, 4.3); of floats NaN
is it, and an accumulator has none but 0, which it may also hold."""
_WIDTHS = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "int64": 4, "uint64": 4, "float32": 2, "float64": 4}
_FACTOR, _FILLER = "sunssf", "pad"
_HEAD = ("ID", "L")
MOST_REPEATS = 200


class ModelError(OneLineError, ValueError):
    """The file is no SunSpec model, in words."""


@dataclass(slots=True)
class _Reading:
    """A model as it is read: where the next point lies, the factors that are in sight, and what was found."""

    number: int
    repeats: Mapping[str, int]
    at: int = 0
    rows: list[ListRow] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    unknown: str = ""

    def add(self, cells: Mapping[str, str]) -> None:
        self.rows.append(ListRow(len(self.rows) + 1, cells))


def read_model(text: str, repeats: Mapping[str, int]) -> tuple[list[ListRow], list[str]]:
    """(the rows of a model, its points that are no tags); `repeats`: how often a group is there, by its name.

    Raises ModelError.
    """
    try:
        content = json.loads(text)
        group, number = content["group"], content["id"]
        points = group["points"]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ModelError(
            f"is no SunSpec model ({type(error).__name__}); give one of github.com/sunspec/models, as model_103.json"
        ) from None
    if type(number) is not int or not isinstance(points, list):
        raise ModelError("is no SunSpec model: it has no number or no points")
    reading = _Reading(number, repeats)
    try:
        _read_group(reading, group, f"{number}_", {}, counted={})
    except (TypeError, KeyError, AttributeError, ValueError, RecursionError) as error:
        raise ModelError(f"is a SunSpec model whose group or point {error} is not as its schema says") from None
    return reading.rows, reading.left_out


def _read_group(
    reading: _Reading, group: Mapping[str, Any], prefix: str, factors: Mapping[str, int], *, counted: Mapping[str, int]
) -> None:
    """The points of a group, then the groups in it. What follows a group of unknown length has no known place."""
    points, known = group.get("points", ()), dict(factors)
    at = reading.at
    for point in points:
        if point["type"] == _FACTOR:
            known[point["name"]] = at
        at += int(point["size"])
    counted = dict(counted)
    for point in points:
        _read_point(reading, point, prefix, known)
        if type(point.get("value")) is int:
            counted[point["name"]] = point["value"]
    for inner in group.get("groups", ()):
        name = inner["name"]
        count, how = _repeats(reading, inner, counted)
        if count is None:
            reading.unknown = reading.unknown or f"{name!r}, which is there {how}"
            sentence = f"the group {name!r} is there {how}: give --repeat {name}=N"
            reading.add({"name": f"{prefix}{name}", "refused": sentence})
            continue
        for place in range(1, count + 1):
            _read_group(reading, inner, f"{prefix}{name}{place if count > 1 else ''}_", known, counted=counted)


def _repeats(reading: _Reading, group: Mapping[str, Any], counted: Mapping[str, int]) -> tuple[int | None, str]:
    """(how often a group is there, why that is not known)."""
    given = reading.repeats.get(group["name"])
    if given is not None:
        return given, ""
    count = group.get("count", 1)
    if isinstance(count, str):
        if reading.repeats.get(count) is not None:
            return reading.repeats[count], ""
        return counted.get(count), f"as often as the device's point {count!r} says"
    if type(count) is not int or not 0 <= count <= MOST_REPEATS:
        raise ValueError(group["name"])
    return (count, "") if count else (None, "as often as the device's own length has room for it")


def _read_point(reading: _Reading, point: Mapping[str, Any], prefix: str, factors: Mapping[str, int]) -> None:
    name, kind, size, at = point["name"], point["type"], int(point["size"]), reading.at
    if not 1 <= size <= 0x10000:
        raise ValueError(name)
    reading.at += size
    if kind in (_FACTOR, _FILLER) or (name in _HEAD and at < 2):
        reading.left_out.append(f"{prefix}{name}")
        return
    cells = {"name": f"{prefix}{name}", "address": f"holding:{at}", "table": "holding", "order": "ABCD", "exact": "1"}
    if reading.unknown:
        cells["refused"] = f"its place is not known before that of {reading.unknown}"
    elif kind not in _TYPES:
        cells["refused"] = f"a {kind} is no number and no text"
    else:
        dtype, sentinel = _TYPES[kind]
        cells |= {"dtype": f"STRING[{2 * size}]" if dtype == "string" else dtype, "sentinel": sentinel}
        if dtype != "string" and size != _WIDTHS[dtype]:
            cells["refused"] = f"a {kind} has {_WIDTHS[dtype]} registers, and the model says {size}"
        cells |= {"unit": str(point.get("units") or "")}
        factor = point.get("sf")
        if type(factor) is int:
            cells["scale"] = f"{10.0**factor:.12g}" if factor else ""
        elif factor is not None and factor in factors:
            cells["scale_from"] = f"holding:{factors[factor]}"
        elif factor is not None:
            cells["refused"] = f"its factor {factor!r} is no point of the model"
    reading.add(cells)
