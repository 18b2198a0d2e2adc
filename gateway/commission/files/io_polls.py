"""Lists of programs that poll: modpoll's configuration, and what ioBroker's tables say in their own words."""

import csv
import re
from collections.abc import Iterator, Mapping, Sequence

from gateway.commission.files.cells import ListRow, RowError
from gateway.commission.files.io_templates import ListedUnit

_BEGINS = ("device", "poll", "ref")
_TABLES = {
    "coil": "coil",
    "discrete_input": "discrete",
    "holding_register": "holding",
    "input_register": "input",
}
_ORDERS = {"BE_BE": "ABCD", "BE_LE": "CDAB", "LE_BE": "BADC", "LE_LE": "DCBA"}
_STRING = re.compile(r"string(\d+)")
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_TIMES = re.compile(rf"x\*({_NUMBER})|({_NUMBER})\*x", re.IGNORECASE)
_OVER = re.compile(rf"x/({_NUMBER})", re.IGNORECASE)
_POWER = re.compile(r"x\*math\.pow\(10,([-+]?\d{1,2})\)", re.IGNORECASE)
_FACTOR = re.compile(r"x\*math\.pow\(10,sf\[['\"](\w+)['\"]\]\)", re.IGNORECASE)


def read_polls(text: str) -> list[ListedUnit] | None:
    """The rows of a configuration of modpoll; None for any other text."""
    lines = [(number, cells) for number, cells in enumerate(csv.reader(text.splitlines()), start=1) if any(cells)]
    first = [cells[0].strip().lower() for _, cells in lines]
    if not first or first[0] != "device" or not set(_BEGINS) <= set(first):
        return None
    return list(_refs(lines))


def _refs(lines: Sequence[tuple[int, list[str]]]) -> Iterator[ListedUnit]:
    unit, poll = "", list[str]()
    for number, given in lines:
        cells = [cell.strip() for cell in given] + [""] * 7
        kind = cells[0].lower()
        if kind == "device":
            unit = cells[2]
        elif kind == "poll":
            poll = cells
        elif kind == "ref":
            yield ListedUnit(ListRow(number, {"exact": "1", **_ref(cells, poll)}), unit)
        elif not kind.startswith("#"):
            said = f"begins with {cells[0]!r}, and a line of modpoll with one of {', '.join(_BEGINS)}"
            yield ListedUnit(ListRow(number, {"name": f"line {number}", "refused": said}), unit)


def _ref(cells: Sequence[str], poll: Sequence[str]) -> dict[str, str]:
    """A line `ref,NAME,ADDRESS,TYPE,rw,UNIT,SCALE` under its `poll,TABLE,START,COUNT,ORDER`."""
    row = {"name": cells[1], "unit": cells[5], "scale": cells[6]}
    table = _TABLES.get(poll[1].lower()) if poll else None
    order = _ORDERS.get((poll[4] or "BE_BE").upper()) if poll else None
    if table is None or order is None:
        return row | {"refused": f"stands under a poll of {','.join(poll[1:5])!r}, which is not known here"}
    if cells[4].lower() == "w":
        return row | {"refused": "is written alone, and a tag is read"}
    try:
        address = int(cells[2], 0)
    except ValueError:
        return row | {"refused": f"address {cells[2]!r} is no number"}
    dtype = cells[3].lower()
    if match := _STRING.fullmatch(dtype):
        dtype = f"STRING[{match[1]}]"
    if dtype.startswith("bool") and table in ("holding", "input"):
        return row | {"refused": f"a {dtype} of registers is several bits; give each its own row"}
    return row | {"address": f"{table}:{address}", "table": table, "dtype": dtype, "order": order}


def by_formula(row: ListRow) -> tuple[float | None, str]:
    """(factor, the address of its power of ten) of a row's formula of `x`; (None, "") where it has none.

    Raises RowError for any that is more than a factor.
    """
    text = row.get("formula")
    plain = "".join(text.split())
    if plain in ("", "x"):
        return None, ""
    if match := _FACTOR.fullmatch(plain):
        return None, match[1]
    if match := _POWER.fullmatch(plain):
        return 10.0 ** int(match[1]), ""
    match = _TIMES.fullmatch(plain)
    factor = float(match[1] or match[2]) if match else 0.0
    if (match := _OVER.fullmatch(plain)) and float(match[1]):
        factor = 1.0 / float(match[1])
    if not factor:
        raise RowError("formula", f"{text!r} is more than a factor, such as x * 0.1; give the row by hand")
    return factor, ""


def is_iobroker(headers: set[str]) -> bool:
    """True for the headers of a table that ioBroker exports: its `len` counts registers, and its factors multiply."""
    return {"role", "cw", "isscale"} <= headers


def of_iobroker(cells: Mapping[str, str]) -> dict[str, str]:
    """A row of ioBroker in the words of this reader."""
    row = {**cells, "exact": "1"}
    row["count"] = row.pop("length", "")
    if "string" not in row.get("dtype", ""):
        row.pop("count")  # a number's own, or left as it was by default
    if row.get("formula", "").strip() and (row.get("scale", "1").strip(), row.get("offset", "0").strip()) in (
        ("1", "0"),
        ("", ""),
        ("1", ""),
    ):
        row |= {"scale": "", "offset": ""}
    return row
