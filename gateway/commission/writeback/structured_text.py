"""The PLC's side of the write-back contract as IEC 61131-3 Structured Text (2nd edition), generated from a device file.

The text holds nothing that a vendor has added: no object, no reference, no comment of two slashes, every conversion by
a standard function. It is matched to the block's layout, so that the PLC's program has no number of its own to keep.
What single tools want of names, places and spelling is in `targets`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.tag import DType, Order, Tag
from gateway.commission.writeback.fields import (
    ALARM_BITS,
    ALARM_MEANINGS,
    ALWAYS_KNOWN,
    FRAME,
    describe_field,
    unknown_word,
)
from gateway.commission.writeback.targets import TARGETS, PlcTool
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
_REGISTER = re.compile(r"^(holding|input):(\d+)$")
# What the language and its library have taken, by the annexes of IEC 61131-3; further forms are in `_FORMS`.
_RESERVED = frozenset(
    """
    ABS ACOS ACTION ADD AND ANDN ANY ARRAY ASIN AT ATAN BOOL BY BYTE CAL CALC CALCN CASE CD CLK CONCAT
    CONFIGURATION CONSTANT COS CTD CTU CTUD CU DATE DATE_AND_TIME DELETE DINT DIV DO DT DWORD ELSE ELSIF EN ENO
    EQ ET EXIT EXP EXPT FALSE FIND FOR FROM FUNCTION FUNCTION_BLOCK F_EDGE F_TRIG GE GT IF IN INITIAL_STEP
    INSERT INT INTERVAL JMP JMPC JMPCN LD LDN LE LEFT LEN LIMIT LINT LN LOG LREAL LT LWORD MAX MID MIN MOD MOVE
    MUL MUX NE NON_RETAIN NOT OF ON OR ORN PRIORITY PROGRAM PT PV Q QD QU R READ_ONLY READ_WRITE REAL REPEAT
    REPLACE RESOURCE RET RETAIN RETC RETCN RETURN RIGHT ROL ROR RS RTC R_EDGE R_TRIG S SEL SEMA SHL SHR SIN
    SINGLE SINT SQRT SR ST STEP STN STRING STRUCT SUB TAN TASK THEN TIME TIME_OF_DAY TO TOD TOF TON TP
    TRANSITION TRUE TRUNC TYPE UDINT UINT ULINT UNTIL USINT VAR WHILE WITH WORD WSTRING XOR XORN
    """.split()  # noqa: SIM905 - a list of so many words is read as a text
)
_FORMS = re.compile(r"^(END|VAR)_\w+$|_TO_|_TRUNC_")
_VARIABLE = re.compile(r"^ +(\w+)(?: AT \S+)?(?: \{[^}]*\})? : ", re.MULTILINE)
_PERMIT, _USABLE = "WritePermit", "PredictionUsable"
_NUMBERS = ("BlocksAccepted", "BlocksRefused", "LastRefusal", "Challenge", "SessionWriter", "RefusedWriter")
"""The tags that the program answers with, by the function block's outputs of the same names."""


@dataclass(frozen=True, slots=True)
class Program:
    """What the example program needs to know: where registers lie ("": the target's own), the permit's place, the cycle
    (ms)."""

    prefix: str = ""
    permit_at: str = ""
    cycle: int = 20


def generate(
    device: DeviceMap, name: str = "", program: Program | None = None, target: PlcTool = TARGETS["plain"]
) -> str:
    """The function block for a device's write-back areas; with `program` also an example with an instance for each.

    `name` is the block's identifier, made from the device's name by default. Raises ValueError for a device file
    without [writeback], for a name that is no identifier or one of the text's own, and for a location that the target
    does not have.
    """
    layout = device.writeback
    if layout is None:
        raise ValueError(f"{device.path}: has no [writeback] table; there is no block to check")
    name = identifier(name or f"{device.name}_writeback")
    block = {**_block(device, layout, name), "dialect": target.dialect}
    text = _template("function_block.st.j2").render(block)
    if program is not None:
        text += _template(target.template).render(_program(device, name, program, target))
    if name in {own.upper() for own in _VARIABLE.findall(text)}:
        raise ValueError(f"{name!r} is a variable within the text; give the block another name")
    return target.spelling(text)


def identifier(text: str) -> str:
    """The text as an identifier in capitals. Raises ValueError if nothing of it can be one."""
    plain = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", text)).strip("_").upper()
    if not plain:
        raise ValueError(f"{text!r} makes no identifier; give letters, digits and single underscores")
    if plain in _RESERVED or _FORMS.search(plain):
        raise ValueError(f"{text!r} makes no identifier: {plain} is a word of IEC 61131-3; give another name")
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
                "note": describe_field(field.name),
            }
        )
    advice = next((output for output in outputs if output["name"] == "p_limit"), None)
    bits = [
        {"number": bit, "mask": 1 << bit, "output": name, "index": index.get("alarms"), "meaning": ALARM_MEANINGS[name]}
        for bit, name in enumerate(ALARM_BITS)
    ]
    return {
        "name": name,
        "source": _comment_text(device.path.name),
        "digest": hashlib.sha256(device.path.read_bytes()).hexdigest(),
        "version": layout.version,
        "blocks": layout.blocks,
        "turns": 0x10000 // layout.blocks - 1,  # the last of them gives no challenge beyond 65535
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


def _comment_text(text: str) -> str:
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


def _program(device: DeviceMap, name: str, program: Program, target: PlcTool) -> dict[str, Any]:
    """All that an example program's template asks for. `declared` rows are variables of their own in the program."""
    prefix = target.prefix(program.prefix)
    configuration, resource = target.names or (f"{name}_CONFIGURATION", "MainResource")
    instances: list[dict[str, Any]] = [
        {
            "suffix": layout.suffix,
            "place": layout.place,
            "speaks_of": _comment_text(f", for {layout.temperature}") if layout.blocks > 1 else "",
            "words": [
                {
                    "variable": f"Word{layout.suffix}{place:02d}",
                    "field": field.name,
                    "address": _comment_text(tag.address),
                    "tag": tag,
                }
                for place, (field, tag) in enumerate(zip(layout.fields, layout.words, strict=True))
            ],
        }
        for layout in device.writebacks
    ]
    words: list[dict[str, Any]] = [word for instance in instances for word in instance["words"]]
    answers = list(_answers(device))
    located = all(_register(word["tag"]) is not None for word in words)
    content = {
        "name": name,
        "source": _comment_text(device.path.name),
        "located": located,
        "permit_at": target.permit(program.permit_at),
        "cycle": program.cycle,
        "configuration": configuration,
        "resource": resource,
        "blocks": len(instances),
        "instances": instances,
        "words": words,
        "answers": answers,
    }
    for row in (*words, *answers):
        row |= {"place": "", "declared": True}
    # What the gateway writes may lie in the PLC's inputs; no program can answer in them, so that answers are outputs.
    answering = prefix.replace("%I", "%Q")
    if target.registers == "located":
        content["where"] = target.where(prefix)
        for rows, area in ((words, prefix), (answers, answering)):
            for row in rows:
                if (register := _register(row["tag"])) is not None:
                    row["place"] = f" AT {target.place(register, area)}"
    elif target.registers == "data block":
        served = [row for row in (*words, *answers) if _register(row["tag"]) is not None]
        for row in served:
            row |= {"variable": f'"{name}_REGISTERS".Holding[{_register(row["tag"])}]', "declared": False}
        content["highest"] = max((_register(row["tag"]) or 0 for row in served), default=0)
    else:
        served = [row for row in answers if _register(row["tag"], ("holding", "input")) is not None]
        numbers = [_register(row["tag"], ("holding", "input")) or 0 for row in served]
        first = min(numbers, default=0)
        for row, number in zip(served, numbers, strict=True):
            row |= {"variable": f"Answers[{number - first}]", "declared": False}
        content |= {
            "first": first,
            "last": max(numbers) - first if numbers else None,
            "answers_at": f" AT {answering}0",
            "moved": any(_register(row["tag"]) is not None for row in answers),
        }
        begin = _register(words[0]["tag"]) or 0
        for instance in instances:
            # The first area is where the server's registers begin; another one as far behind as in the map.
            behind = (_register(instance["words"][0]["tag"]) or 0) - begin
            instance["area_at"] = f" AT {prefix}{max(behind, 0)}" if located else ""
    return content


def _register(tag: Tag, tables: tuple[str, ...] = ("holding",)) -> int | None:
    """The PDU address of a tag that is a register of one of the tables."""
    match = _REGISTER.match(tag.address)
    return int(match[2]) if match and match[1] in tables else None


def _answers(device: DeviceMap) -> Iterator[dict[str, Any]]:
    """The words of the PLC's own area that the program answers in, each with the tags in it."""
    numbers = {device.heartbeat: "Gateway.PlcHeartbeat"} if device.heartbeat else {}
    truths = {_PERMIT: "PermitSwitch"}
    for layout in device.writebacks:
        truths[layout.tag(_USABLE)] = f"Gateway{layout.suffix}.Usable"
        numbers |= {layout.tag(name): f"Gateway{layout.suffix}.{name}" for name in _NUMBERS}
    answered = [tag for tag in device.tags if tag.name in numbers or tag.name in truths]
    for address in dict.fromkeys(tag.address for tag in answered):
        own = [tag for tag in answered if tag.address == address]
        bits, number = [], ""
        for tag in own:
            # The tag's bit is counted after the bytes were put in order; in the PLC's own word they are swapped.
            swapped = tag.order in _SWAPPED
            if tag.name in truths:
                bit = tag.bit or 0
                bits.append({"source": truths[tag.name], "mask": 1 << (bit ^ 8 if swapped else bit)})
            if tag.name in numbers and not number:
                if tag.dtype is not DType.UINT16 or tag.scale != 1 or tag.offset != 0:
                    raise ValueError(
                        f"{tag.name} is no plain uint16; leave dtype, scale and offset out for the program to fill it"
                    )
                word = f"UINT_TO_WORD({numbers[tag.name]})"
                number = f"ROL({word}, 8)" if swapped else word
        yield {
            "variable": f"Own{identifier('Own' + own[0].name)[3:].capitalize()}",
            "tag": own[0],
            "tags": _comment_text(", ".join(tag.name for tag in own)),
            "address": _comment_text(address),
            "bits": bits,
            "number": number,
        }
