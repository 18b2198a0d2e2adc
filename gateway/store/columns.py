"""Rows packed as columns: what comes out is exactly what went in, in a fraction of the room.

A packed table is zlib's stream of one line of JSON (the number of rows, and of each column its kind and what is needed
to undo it), followed by the columns' bytes. A column is one of these kinds, the first that gives back every value to
the last bit:

    i   whole numbers of 64 bits
    g   floats that are whole multiples of a step of GRID (what a register of scale 0.1 gives)
    f   floats that a float32 holds, as the whole numbers of its bits
    d   any floats, as the whole numbers of their bits
    w   byte strings of one even length (a block's words), as one column of 16-bit numbers each
    t   anything else: a list of the different values, and which of them each row has

Each kind comes down to whole numbers, and these are stored as differences from one row to the next, less the median
difference (a clock's period), zigzag-coded so that small ones of either sign have few bytes, and the bytes by their
place: first the lowest of all rows, last the highest, which zlib then makes almost nothing of. The method is that of
column stores (delta, zigzag, byte shuffle: Parquet's DELTA_BINARY_PACKED, Blosc).
"""

import json
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cell = int | float | str | bytes | None
Integers = NDArray[np.int64]

GRID: Sequence[tuple[float, float]] = tuple((1.0, 10.0**n) for n in range(7)) + tuple(
    (step, 1.0) for step in (0.5, 0.25, 0.1, 0.05, 0.01, 0.001, 0.0001)
)
"""Steps as (multiply by, divide by): 0.1 times 3 and 3 over 10 are two different floats."""
_MOST = float(1 << 53)


class PackedError(ValueError):
    """Bytes that are no packed table, or a damaged one."""


def pack(columns: Sequence[Sequence[Cell]]) -> bytes:
    """Pack columns of one length. Whole numbers beyond 64 bits are the one thing that cannot be packed (ValueError)."""
    heads, parts = [], []
    for column in columns:
        head, part = _pack_column(column)
        heads.append(head)
        parts.append(part)
    rows = len(columns[0]) if columns else 0
    line = json.dumps([rows, heads], separators=(",", ":")).encode() + b"\n"
    return zlib.compress(line + b"".join(parts), 6)


def unpack(data: bytes) -> list[list[Cell]]:
    """The columns that were packed. Raises PackedError."""
    try:
        line, _, body = zlib.decompress(data).partition(b"\n")
        rows, heads = json.loads(line)
        columns, place = [], 0
        for head in heads:
            column, place = _unpack_column(head, body, place, rows)
            columns.append(column)
    except (zlib.error, ValueError, KeyError, TypeError, IndexError) as error:
        raise PackedError(f"a packed table cannot be read ({error})") from None
    return columns


def _pack_column(column: Sequence[Cell]) -> tuple[dict[str, Any], bytes]:
    missing = np.fromiter((value is None for value in column), dtype=bool, count=len(column))
    head: dict[str, Any] = {}
    own: dict[str, Any]
    parts = []
    if missing.any():
        head["none"] = 1
        parts.append(np.packbits(missing).tobytes())
    present = [value for value in column if value is not None]
    kinds = {type(value) for value in present}
    if kinds == {int} and all(-(1 << 63) <= value < 1 << 63 for value in present):  # type: ignore[operator]
        own, numbers = {"kind": "i"}, [np.array(present, dtype=np.int64)]
    elif kinds == {float}:
        own, whole = _floats(np.array(present, dtype=np.float64))
        numbers = [whole]
    elif kinds == {bytes} and len({len(value) for value in present}) == 1 and present[0] and not len(present[0]) % 2:  # type: ignore[arg-type]
        width = len(present[0]) // 2  # type: ignore[arg-type]
        words = np.frombuffer(b"".join(present), dtype=">u2").reshape(len(present), width)  # type: ignore[arg-type]
        own, numbers = {"kind": "w", "words": width}, list(words.T.astype(np.int64))
    else:
        # By type and text: 1, 1.0 and True are equal to a dict, and so are 0.0 and -0.0.
        places: dict[tuple[type, str], int] = {}
        values: list[list[str]] = []
        which = []
        for value in present:
            key = (type(value), value if isinstance(value, str) else repr(value))
            if key not in places:
                places[key] = len(values)
                values.append(_as_text(value))
            which.append(places[key])
        own, numbers = {"kind": "t", "values": values}, [np.array(which, dtype=np.int64)]
    head |= own
    coded = [_code_integers(one) for one in numbers]
    head["codes"] = [code for code, _ in coded]
    return head, b"".join([*parts, *(data for _, data in coded)])


def _unpack_column(head: dict[str, Any], body: bytes, place: int, rows: int) -> tuple[list[Cell], int]:
    missing = np.zeros(rows, dtype=bool)
    if "none" in head:
        length = (rows + 7) // 8
        missing = np.unpackbits(np.frombuffer(body, np.uint8, length, place), count=rows).astype(bool)
        place += length
    count = rows - int(missing.sum())
    numbers = []
    for code in head["codes"]:
        one, place = _decode_integers(code, body, place, count)
        numbers.append(one)
    present: list[Cell]
    match head["kind"]:
        case "i":
            present = numbers[0].tolist()
        case "g":
            multiply, divide = head["step"]
            present = (numbers[0] * multiply / divide).tolist()
        case "f":
            present = numbers[0].astype(np.uint32).view(np.float32).astype(np.float64).tolist()
        case "d":
            present = numbers[0].view(np.float64).tolist()
        case "w":
            present = [row.tobytes() for row in np.array(numbers).T.astype(">u2")]
        case _:
            values = [_from_text(value) for value in head["values"]]
            present = [values[which] for which in numbers[0].tolist()]
    if count == rows:
        return present, place
    rest = iter(present)
    return [None if gone else next(rest) for gone in missing.tolist()], place


def _floats(values: NDArray[np.float64]) -> tuple[dict[str, Any], Integers]:
    bits = values.view(np.int64)
    if np.isfinite(values).all():
        for multiply, divide in GRID:
            with np.errstate(over="ignore"):
                steps = np.rint(values * (divide / multiply))
            # The bits are compared, not the values: -0.0 equals 0.0 and is another number all the same.
            if np.abs(steps).max() < _MOST and (
                np.array_equal((steps.astype(np.int64) * multiply / divide).view(np.int64), bits)
            ):
                return {"kind": "g", "step": [multiply, divide]}, steps.astype(np.int64)
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    if np.array_equal(single.astype(np.float64).view(np.int64), bits):
        return {"kind": "f"}, single.view(np.uint32).astype(np.int64)
    return {"kind": "d"}, bits


def _code_integers(numbers: Integers) -> tuple[list[int], bytes]:
    """([first, the median difference, bytes a row], the differences' bytes); the arithmetic is modulo 2^64."""
    if not numbers.size:
        return [0, 0, 0], b""
    differences = np.diff(numbers)
    middle = np.int64(np.sort(differences)[differences.size // 2]) if differences.size else np.int64(0)
    left = differences - middle
    zigzag = ((left << 1) ^ (left >> 63)).view(np.uint64)
    width = (int(zigzag.max()).bit_length() + 7) // 8 if zigzag.size else 0
    low_first = zigzag.astype("<u8").view(np.uint8).reshape(zigzag.size, 8)
    return [int(numbers[0]), int(middle), width], low_first[:, :width].T.tobytes()


def _decode_integers(code: Sequence[int], body: bytes, place: int, count: int) -> tuple[Integers, int]:
    first, middle, width = code
    if not count:
        return np.empty(0, dtype=np.int64), place
    length = width * (count - 1)
    low_first = np.zeros((count - 1, 8), dtype=np.uint8)
    low_first[:, :width] = np.frombuffer(body, np.uint8, length, place).reshape(width, count - 1).T
    zigzag = low_first.view("<u8").reshape(count - 1)
    left = (zigzag >> 1).view(np.int64) ^ -(zigzag & 1).view(np.int64)
    numbers = np.empty(count, dtype=np.int64)
    numbers[0] = first
    numbers[1:] = np.int64(first) + np.cumsum(left + np.int64(middle))
    return numbers, place + length


def _as_text(value: Cell) -> list[str]:
    if isinstance(value, bytes):
        return ["bytes", value.hex()]
    return [type(value).__name__, value if isinstance(value, str) else repr(value)]


def _from_text(text: Sequence[str]) -> Cell:
    kind, content = text
    if kind == "str":
        return content
    return bytes.fromhex(content) if kind == "bytes" else int(content) if kind == "int" else float(content)
