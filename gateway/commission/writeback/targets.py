"""The tools that the PLC's side goes into, and what each asks of the text: names, places of registers, spelling.

The logic is the same text for all of them: a tool that wants another spelling gets it from `PlcTool.spelling`, at the
end. What the tools want was read in their documents; `docs/plc_side.md` says which of them have compiled it here.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Span:
    """Registers `first` to `last` (PDU addresses), of which the first lies at `prefix` and 0."""

    first: int
    last: int
    prefix: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PlcTool:
    """What one tool asks of the text.

    `registers` says how a program gets at them: as variables, each at its location; as two arrays; in a data block.
    `locations` are the prefixes that they may have, the default first. `spans` are where the tool's Modbus server keeps
    holding registers, where that is not one prefix and the address. `bit` is the form of a place of one bit,
    `bit_example` one of them. `names` are those of configuration and resource, where the tool asks for its own.
    `ending` is what the name of a file has to end in for the tool to import it, where that matters.
    """

    tool: str
    template: str
    locations: tuple[str, ...]
    bit: re.Pattern[str]
    bit_example: str
    names: tuple[str, str] | None = None
    spans: tuple[Span, ...] = ()
    registers: Literal["located", "arrays", "data block"] = "located"
    dialect: Literal["IEC", "SCL"] = "IEC"
    spelling: Callable[[str], str] = str
    ending: str = ""

    def prefix(self, asked: str) -> str:
        """The prefix of the block's registers; `asked` is what was given, or "". Raises ValueError."""
        if not asked or asked in self.locations:
            return asked or (self.locations[0] if self.locations else "")
        if not self.locations:
            raise ValueError(f"{asked!r}: {self.tool} keeps the registers in a data block; leave --location out")
        raise ValueError(
            f"{asked!r} is no prefix of a location of registers for {self.tool}; give {' or '.join(self.locations)}"
        )

    def place(self, register: int, prefix: str) -> str:
        """Where a holding register (PDU address) lies. Raises ValueError where the tool has none of this number."""
        for span in self.spans:
            if span.first <= register <= span.last:
                return f"{span.prefix}{register - span.first}"
        if self.spans:
            raise ValueError(
                f"holding:{register}: the Modbus server of {self.tool} has words only up to "
                f"holding:{self.spans[-1].last}; put the tag into a lower register"
            )
        return f"{prefix}{register}"

    def where(self, prefix: str) -> str:
        """One sentence: where the registers lie."""
        if not self.spans:
            return f"Locations are {prefix} followed by the register's PDU address."
        spans = ", ".join(f"{span.first} to {span.last} at {span.prefix}0" for span in self.spans)
        return f"Locations are those of the Modbus server of {self.tool}: registers {spans} and on."

    def permit(self, place: str) -> str:
        """The place of the permit's switch, as it was given. Raises ValueError unless it is one bit."""
        if not place or self.bit.fullmatch(place):
            return place
        raise ValueError(
            f"{place!r} is no location of one bit for {self.tool}, and the permit is one; give one such as "
            f"{self.bit_example}"
        )


_COMMENT = re.compile(r"(\(\*.*?\*\))", re.DOTALL)
_DECLARED = re.compile(r"^ +(\w+)(?: \{[^}]*\})? : ", re.MULTILINE)
_SHIFT = re.compile(r"\b(SHL|ROL)\(([^,]+), (\d+)\)")


def siemens(text: str) -> str:
    """Blocks in the spelling that TIA Portal itself exports: # before local names, a shift's parameters by their names.

    Each block is its declarations, a line BEGIN, and statements.
    """
    blocks = re.split(r"^(END_(?:FUNCTION|DATA)_BLOCK)$", text, flags=re.MULTILINE)
    for number, block in enumerate(blocks):
        declarations, begin, body = block.partition("\nBEGIN\n")
        names = "|".join(_DECLARED.findall(_COMMENT.sub("", declarations)))
        if begin and names:
            local = re.compile(rf'(?<![."#\w])({names})\b')
            pieces = _COMMENT.split(body)
            pieces[::2] = [local.sub(r"#\1", _SHIFT.sub(r"\1(IN := \2, N := \3)", piece)) for piece in pieces[::2]]
            blocks[number] = declarations + begin + "".join(pieces)
    return "".join(blocks)


TARGETS: Mapping[str, PlcTool] = {
    "plain": PlcTool(
        tool="IEC 61131-3",
        template="program.st.j2",
        locations=("%MW", "%QW", "%IW"),
        bit=re.compile(r"%[IQM]X?\d+(\.\d+)*"),
        bit_example="%IX0.0 or %MX10.0",
    ),
    # OpenPLC compiles files of these two names, and its Modbus server keeps 1,024 words of each kind.
    "openplc": PlcTool(
        tool="OpenPLC",
        template="program.st.j2",
        locations=("%QW",),
        bit=re.compile(r"%[IQ]X(\d{1,3}|10[01]\d|102[0-3])\.[0-7]"),
        bit_example="%IX0.0",
        names=("Config0", "Res0"),
        spans=(Span(0, 1023, "%QW"), Span(1024, 2047, "%MW")),
    ),
    "codesys": PlcTool(
        tool="CODESYS",
        template="program_codesys.st.j2",
        registers="arrays",
        locations=("%IW", "%QW", "%MW"),
        bit=re.compile(r"%[IQM]X?\d+\.[0-7]"),
        bit_example="%IX0.0",
    ),
    "tia": PlcTool(
        tool="TIA Portal",
        template="program_tia.scl.j2",
        registers="data block",
        locations=(),
        bit=re.compile(r"%[IQM]\d+\.[0-7]"),
        bit_example="%I0.0",
        dialect="SCL",
        spelling=siemens,
        ending=".scl",
    ),
}
"""By the word of `decanter plc codegen --target`."""
