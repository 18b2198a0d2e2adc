"""The PLC's side of the write-back contract as IEC 61131-3 Structured Text (2nd edition), generated from a device file.

The text holds nothing that a vendor has added: no object, no reference, no comment of two slashes, every conversion by
a standard function. It is matched to the block's layout, so that the PLC's program has no number of its own to keep.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.tag import DType, Order, Tag
from gateway.commission.writeback.fields import ALARM_BITS, ALARM_MEANINGS, ALWAYS_KNOWN, FRAME, described, unknown_word
from gateway.settings import DeviceMap, WritebackLayout

if TYPE_CHECKING:
    from jinja2 import Template


_KEYS: Mapping[str, str] = {
    "accepted": "none",
    "layout": "layout version",
    "torn": "sequence and its copy differ",
    "checksum": "CRC",
    "still": "heartbeat did not change",
    "challenge": "another challenge",
    "writer": "another writer",
    "sequence": "sequence not 1 to 100 ahead",
    "permit": "no permit",
}
"""The template's names of the reasons; a block that looks at its memory knows no length and no start."""
_SWAPPED = (Order.BADC, Order.DCBA)
_REGISTER = re.compile(r"^holding:(\d+)$")
_LOCATION = re.compile(r"^%[IQM][XW]?\d+(\.\d+)*$")
_PREFIX = re.compile(r"^%[IQM]W?$")
_RESERVED = frozenset({"PROGRAM", "TYPE", "VAR", "TASK", "ON", "OR", "AND", "NOT", "MOD", "XOR", "TIME", "WORD"})
# What the program may answer in the PLC's own area, by tag: a truth value, or a number.
_TRUTHS = {"WritePermit": "PermitSwitch", "PredictionUsable": "Gateway.Usable"}
_NUMBERS = {
    "BlocksAccepted": "Gateway.BlocksAccepted",
    "BlocksRefused": "Gateway.BlocksRefused",
    "LastRefusal": "Gateway.LastRefusal",
    "Challenge": "Gateway.Challenge",
    "SessionWriter": "Gateway.SessionWriter",
    "RefusedWriter": "Gateway.RefusedWriter",
}


@dataclass(frozen=True, slots=True)
class Program:
    """What the example program needs to know: where registers lie, the permit's place, the cycle (ms)."""

    prefix: str = "%MW"
    permit_at: str = ""
    cycle: int = 20


def generate(device: DeviceMap, name: str = "", program: Program | None = None) -> str:
    """The function block for a device's write-back area; with `program` also an example that calls it.

    `name` is the block's identifier, made from the device's name by default. Raises ValueError for a device file
    without [writeback], for a name that is no identifier, and for a location that is none of IEC 61131-3.
    """
    layout = device.writeback
    if layout is None:
        raise ValueError(f"{device.path}: has no [writeback] table; there is no block to check")
    name = identifier(name or f"{device.name}_writeback")
    text = _template("function_block.st.j2").render(_block(device, layout, name))
    if program is not None:
        text += _template("program.st.j2").render(_program(device, layout, name, program))
    return text


def identifier(text: str) -> str:
    """The text as an identifier in capitals. Raises ValueError if nothing of it can be one."""
    plain = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", text)).strip("_").upper()
    if not plain or plain in _RESERVED:
        raise ValueError(f"{text!r} makes no identifier; give letters, digits and single underscores")
    return plain if plain[0].isalpha() else f"B_{plain}"


def _template(name: str) -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    # What is made is Structured Text, no page: nothing is to be escaped.
    world = Environment(  # noqa: S701
        loader=PackageLoader("gateway.commission.writeback"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    world.keep_trailing_newline = True
    return world.get_template(name)


def _block(device: DeviceMap, layout: WritebackLayout, name: str) -> dict[str, Any]:
    """All that the function block's template asks for."""
    codes = device.refusals
    index = {field.name: place for place, field in enumerate(layout.fields)}
    outputs = []
    for place, field in enumerate(layout.fields):
        if field.name in FRAME:
            continue
        kind, whole = "INT" if field.signed else "UINT", field.scale == 1.0
        count = f"WORD_TO_{kind}(Words[{place}])"
        outputs.append(
            {
                "name": field.name,
                "index": place,
                "output": _camel(field.name),
                "type": kind if whole else "REAL",
                "expression": count if whole else f"{kind}_TO_REAL({count}) * {_real(field.scale)}",
                "unknown": "" if field.name in ALWAYS_KNOWN else f"{unknown_word(field, layout):04X}",
                "note": described(field.name),
            }
        )
    advice = next((output for output in outputs if output["name"] == "p_limit"), None)
    bits = [
        {"number": bit, "mask": 1 << bit, "output": name, "index": index.get("alarms"), "meaning": ALARM_MEANINGS[name]}
        for bit, name in enumerate(ALARM_BITS)
    ]
    return {
        "name": name,
        "source": _said(device.path.name),
        "digest": hashlib.sha256(device.path.read_bytes()).hexdigest(),
        "version": layout.version,
        "count": len(layout.fields),
        "last": len(layout.fields) - 1,
        "timer": round(layout.timeout * 1000),
        "reasons": ", ".join(f"{codes[reason]} {reason}" for reason in _KEYS.values()),
        "codes": {key: codes[reason] for key, reason in _KEYS.items()},
        **{frame: {"index": index[frame], "output": _camel(frame)} for frame in FRAME},
        "outputs": outputs,
        "alarm_bits": bits if "alarms" in index else [],
        "advises": advice is not None,
        "advice": advice,
    }


def _said(text: str) -> str:
    """Text that a comment can hold: ASCII, and nothing that would end the comment."""
    return text.encode("ascii", "replace").decode().replace("*", "-")


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _real(value: float) -> str:
    """A REAL literal: it needs a point."""
    text = repr(value)
    mantissa, letter, exponent = text.partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{letter.upper()}{exponent}"


# ---------------------------------------------------------------- the example program


def _program(device: DeviceMap, layout: WritebackLayout, name: str, program: Program) -> dict[str, Any]:
    if not _PREFIX.match(program.prefix):
        raise ValueError(f"{program.prefix!r} is no prefix of a location; give one such as %MW, %QW or %IW")
    if program.permit_at and not _LOCATION.match(program.permit_at):
        raise ValueError(f"{program.permit_at!r} is no location; give one such as %IX0.0 or %MX10.0")
    words = [
        {
            "variable": f"Word{place:02d}",
            "field": field.name,
            "address": _said(tag.address),
            "place": _place(tag, program),
        }
        for place, (field, tag) in enumerate(zip(layout.fields, layout.words, strict=True))
    ]
    return {
        "name": name,
        "source": _said(device.path.name),
        "located": all(word["place"] for word in words),
        "prefix": program.prefix,
        "permit_at": program.permit_at,
        "cycle": program.cycle,
        "words": words,
        "registers": list(_registers(device, program)),
    }


def _place(tag: Tag, program: Program) -> str:
    match = _REGISTER.match(tag.address)
    return f" AT {program.prefix}{int(match[1])}" if match else ""


def _registers(device: DeviceMap, program: Program) -> Iterator[dict[str, Any]]:
    """The words of the PLC's own area that the program answers in, each with the tags in it."""
    numbers = {**_NUMBERS, **({device.heartbeat: "Gateway.PlcHeartbeat"} if device.heartbeat else {})}
    answered = [tag for tag in device.tags if tag.name in numbers or tag.name in _TRUTHS]
    for address in dict.fromkeys(tag.address for tag in answered):
        own = [tag for tag in answered if tag.address == address]
        bits, number = [], ""
        for tag in own:
            # The tag's bit is counted after the bytes were put in order; in the PLC's own word they are swapped.
            swapped = tag.order in _SWAPPED
            if tag.name in _TRUTHS:
                bit = tag.bit or 0
                bits.append({"source": _TRUTHS[tag.name], "mask": 1 << (bit ^ 8 if swapped else bit)})
            if tag.name in numbers and not number:
                if tag.dtype is not DType.UINT16 or tag.scale != 1 or tag.offset != 0:
                    raise ValueError(
                        f"{tag.name} is no plain uint16; leave dtype, scale and offset out for the program to fill it"
                    )
                word = f"UINT_TO_WORD({numbers[tag.name]})"
                number = f"ROL({word}, 8)" if swapped else word
        yield {
            "variable": f"Own{identifier(own[0].name).capitalize()}",
            "tags": _said(", ".join(tag.name for tag in own)),
            "address": _said(address),
            "place": _place(own[0], program),
            "bits": bits,
            "number": number,
        }
