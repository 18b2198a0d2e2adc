"""The node's EDS as the PLC reads it: each object's type, access and value at power-on; a reader of its own."""

import re
import struct
from collections.abc import Mapping
from configparser import Error as IniError
from configparser import RawConfigParser
from dataclasses import dataclass
from pathlib import Path

from sim.plc.program import InputError, read_text

Address = tuple[int, int]
_OBJECT = re.compile(r"([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?")
_FORMATS = {1: "<B", 2: "<b", 3: "<h", 4: "<i", 5: "<B", 6: "<H", 7: "<I", 8: "<f", 0x11: "<d", 0x15: "<q", 0x1B: "<Q"}
_FLOATS = (8, 0x11)
TEXT = 9
_LEAF = ("0x7", "0x2", "7", "2")


@dataclass(frozen=True, slots=True)
class EdsObject:
    """One object: `size` in bytes (None where it varies), and its bytes at power-on."""

    name: str
    access: str
    size: int | None
    mappable: bool
    default: bytes

    @property
    def readable(self) -> bool:
        """True if a client may read it."""
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        """True if a client may write it."""
        return self.access in ("rw", "rww", "rwr", "wo")


def read_eds(path: Path, node: int) -> tuple[Mapping[Address, EdsObject], str]:
    """The objects of an EDS for this node id, and its text. Raises InputError naming file, object and reason."""
    text = read_text(path, "an electronic data sheet such as config/decanter.eds")
    parser = RawConfigParser(inline_comment_prefixes=(";",))
    try:
        parser.read_string(text)
    except IniError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: is no EDS: {reason}; correct that place") from None
    objects: dict[Address, EdsObject] = {}
    for section in parser.sections():
        match = _OBJECT.fullmatch(section)
        if match is None or parser.get(section, "ObjectType", fallback="0x7").lower() not in _LEAF:
            continue
        keys = dict(parser.items(section))
        try:
            kind = int(keys["datatype"], 0)
            form = _FORMATS.get(kind)
            text_of_default = keys.get("defaultvalue", "")
            if form is None:
                default = text_of_default.encode("latin-1")
            else:
                default = struct.pack(form, _number(text_of_default or "0", kind, node))
        except (KeyError, ValueError, struct.error) as error:
            raise InputError(
                f"{path}: [{section}]: cannot be read ({error}); give DataType, and a DefaultValue that fits it"
            ) from None
        objects[int(match[1], 16), int(match[2] or "0", 16)] = EdsObject(
            name=keys.get("parametername", ""),
            access=keys.get("accesstype", "ro").strip().lower(),
            size=struct.calcsize(form) if form else None,
            mappable=keys.get("pdomapping", "0").strip() not in ("0", "0x0"),
            default=default,
        )
    if not objects:
        raise InputError(f"{path}: has no objects; give an electronic data sheet")
    return objects, text


def _number(text: str, kind: int, node: int) -> float | int:
    """A default value: a number, or one that counts from the node id (`$NODEID+0x180`, CiA 306)."""
    compact = text.replace(" ", "").upper()
    if kind in _FLOATS:
        return float(compact)
    relative = "$NODEID" in compact
    number = int(compact.replace("+$NODEID", "").replace("$NODEID+", "").replace("$NODEID", "0"), 0)
    return number + (node if relative else 0)
