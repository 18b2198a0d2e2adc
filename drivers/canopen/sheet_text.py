"""The text of a data sheet, object by object: EDS and DCF (CiA 306), and XDD and XDC (CiA 311) as EDS sections.

A slip in one object costs that one. What the driver has no use for ([DeviceInfo], comments, lists of objects) is not
looked at; of an object only the keys that it needs are, each number as a file may write it.
"""

import re
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass, replace
from xml.etree import ElementTree

_OBJECT = re.compile(r"([0-9A-F]{2,4})(?:SUB([0-9A-F]{1,2})|NAME|VALUE)?", re.IGNORECASE)
_KEYS = {
    key.casefold(): key
    for key in (
        *("ParameterName", "ObjectType", "DataType", "AccessType", "PDOMapping", "DefaultValue", "ParameterValue"),
        *("SubNumber", "CompactSubObj", "NrOfEntries", "LowLimit", "HighLimit"),
    )
}
_NUMBERS = ("ObjectType", "DataType", "PDOMapping", "SubNumber", "CompactSubObj", "NrOfEntries")
_ARRAY, _RECORD, _VARIABLE = "0x8", "0x9", "0x7"
_ACCESS = ("ro", "wo", "rw", "rwr", "rww", "const")
_MOST_ENTRIES = 254


@dataclass(frozen=True, slots=True)
class SheetSection:
    """A section: its line (1..) and its keys as `_KEYS` writes them, or numbers as they stand."""

    line: int
    keys: MutableMapping[str, str]


def parse_sections(text: str) -> tuple[dict[str, SheetSection], list[str]]:
    """An EDS's sections of objects by name ("1000", "1018sub1"), and what of them is left out, in words with lines."""
    sections: dict[str, SheetSection] = {}
    problems: list[str] = []
    current: SheetSection | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        plain = line.strip()
        if plain.startswith("["):
            name = _section_name(plain[1:].partition("]")[0].strip())
            current = SheetSection(number, {}) if name else None
            if name and current is not None and sections.setdefault(name, current) is not current:
                problems.append(f"line {number}: section [{name}] is there twice; the first one counts")
                current = None
            continue
        key, equals, value = plain.partition("=")
        if current is None or not equals or plain.startswith(";"):
            continue
        key = _KEYS.get(key.strip().casefold(), key.strip())
        if key in _KEYS.values() or key.isdecimal():
            current.keys.setdefault(key, value.split(" ;")[0].split("\t;")[0].strip())
    good = {}
    for name, section in sections.items():
        try:
            good[name] = _tidy_section(name, section)
        except ValueError as error:
            problems.append(f"line {section.line}: [{name}] is left out: {error}")
    return dict(_expand_arrays(good)), problems


def _section_name(text: str) -> str:
    """A section's name in one spelling; "" for one that is no object's."""
    match = _OBJECT.fullmatch(text)
    if match is None:
        return ""
    index, sub = match[1].upper(), match[2]
    if sub is not None:
        return f"{index}sub{int(sub, 16):X}"
    tail = text[len(index) :].casefold()
    return index + {"name": "Name", "value": "Value"}.get(tail, "")


def _tidy_section(name: str, section: SheetSection) -> SheetSection:
    """Numbers as Python reads them, what may be left out filled in. Raises ValueError naming the key."""
    keys = dict(section.keys)
    if name.endswith(("Name", "Value")):
        return SheetSection(section.line, keys)
    for key in _NUMBERS:
        if key in keys:
            if not keys[key]:
                del keys[key]
                continue
            keys[key] = str(parse_number(keys[key], key))
    kind = keys.setdefault("ObjectType", str(int(_VARIABLE, 16)))
    keys.setdefault("ParameterName", name)
    holds = kind not in (str(int(_ARRAY, 16)), str(int(_RECORD, 16))) or "CompactSubObj" in keys
    if holds:
        if "DataType" not in keys:
            raise ValueError("DataType is missing; give the number of its type, such as 0x0005")
        access = keys.setdefault("AccessType", "ro").casefold()
        if access not in _ACCESS:
            raise ValueError(f"AccessType {keys['AccessType']!r} is none; give one of {', '.join(_ACCESS)}")
    for key in ("DefaultValue", "ParameterValue"):
        if not keys.get(key, "-").strip():
            del keys[key]
        elif key in keys and re.fullmatch(r"[-+]?0+[0-9]+", keys[key]):
            keys[key] = str(int(keys[key]))  # 007: Python reads no noughts before a number
    return SheetSection(section.line, keys)


def parse_number(text: str, key: str) -> int:
    """A whole number as files write it: 7, 007, 0x7, 7h. Raises ValueError naming the key."""
    plain = text.strip().casefold()
    try:
        if plain.endswith("h") and not plain.startswith("0x"):
            return int(plain[:-1], 16)
        return int(plain, 16 if plain.startswith(("0x", "-0x")) else 10)
    except ValueError:
        raise ValueError(f"{key} {text!r} is no number; give one such as 7 or 0x7") from None


def _expand_arrays(sections: Mapping[str, SheetSection]) -> Iterator[tuple[str, SheetSection]]:
    """Every section, and those that a compact array stands for (CiA 306, 4.6.3.2)."""
    for name, section in sections.items():
        keys = section.keys
        count = int(keys.get("CompactSubObj", 0))
        if name.endswith(("Name", "Value")):
            continue
        if not count:
            yield name, section
            continue
        own = {key: value for key, value in keys.items() if key not in ("CompactSubObj", "SubNumber")}
        yield name, SheetSection(section.line, {**keys, "ObjectType": str(int(_ARRAY, 16))} | {"CompactSubObj": ""})
        empty = SheetSection(section.line, {})
        names, values = (sections.get(name + tail, empty).keys for tail in ("Name", "Value"))
        number = {"ParameterName": "NrOfObjects", "ObjectType": "7", "DataType": "5", "AccessType": "ro"}
        yield f"{name}sub0", SheetSection(section.line, number | {"DefaultValue": str(count)})
        for entry in range(1, min(count, _MOST_ENTRIES) + 1):
            title = names.get(str(entry)) or f"{own['ParameterName']}{entry}"
            value = {"ParameterValue": values[str(entry)]} if str(entry) in values else {}
            keys = own | value | {"ParameterName": title, "ObjectType": "7"}
            yield f"{name}sub{entry:X}", SheetSection(section.line, keys)


def format_sections(sections: Mapping[str, SheetSection]) -> str:
    """The sections as an EDS, an object before its members."""
    ordered = sorted(sections.items(), key=lambda item: (item[0][:4], "sub" in item[0]))
    return "\n".join(
        f"[{name}]\n" + "\n".join(f"{key}={value}" for key, value in section.keys.items() if value != "")
        for name, section in ordered
    )


# ---------------------------------------------------------------- XDD


_ACCESS_OF_XDD = {
    **{"readonly": "ro", "writeonly": "wo", "readwrite": "rw", "readwriteinput": "rwr", "readwriteoutput": "rww"},
    **{"read": "ro", "write": "wo"},
}
_MEMBER_OF_XDD = "CANopenSubObject"
_OBJECTS_OF_XDD = ("CANopenObject", _MEMBER_OF_XDD)
_TYPES_OF_XDD = {
    **{"BOOL": "1", "SINT": "2", "INT": "3", "DINT": "4", "USINT": "5", "BYTE": "5", "UINT": "6", "WORD": "6"},
    **{"UDINT": "7", "DWORD": "7", "REAL": "8", "STRING": "9", "WSTRING": "B", "LREAL": "11", "LINT": "15"},
    **{"ULINT": "1B", "LWORD": "1B"},
}
"""Types of IEC 61131-3, of which a parameter is, as numbers of CiA 301 (7.4.7)."""
_MAPPABLE = ("default", "optional", "TPDO", "RPDO")


def sections_of_xml(text: str) -> tuple[dict[str, SheetSection], list[str]]:
    """An XDD's or XDC's objects (CiA 311) as an EDS's sections. Raises ValueError for what is no such file."""
    if re.search(r"<!(?:DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise ValueError("it has a document type, which no XDD has")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without a document type nothing in it expands
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"it is no XML ({error})") from None
    # What a device's profile says of an object may stand in its application process, which the object refers to.
    said = {item.get("uniqueID", ""): _parameter(item) for item in root.iter() if _local(item) == "parameter"}
    lines: list[str] = []
    at: list[int] = []
    places, index = _object_lines(text), ""
    for item in root.iter():
        kind = _local(item)
        if kind not in _OBJECTS_OF_XDD:
            continue
        name = item.get("index", "").upper().removeprefix("0X")
        index = index if kind == _MEMBER_OF_XDD else name
        own = _xdd_section(f"{index}sub{item.get('subIndex', '')}" if kind == _MEMBER_OF_XDD else name, item, said)
        at += [next(places, 0)] * len(own)
        lines += own
    sections, left = parse_sections("\n".join(lines))
    # The lines of the file in the place of those of the sections.
    sections = {name: replace(section, line=at[section.line - 1]) for name, section in sections.items()}
    return sections, [re.sub(r"^line (\d+)", lambda found: f"line {at[int(found[1]) - 1]}", one) for one in left]


def _object_lines(text: str) -> Iterator[int]:
    """The lines of the objects and their members in the order of the file."""
    bare = re.sub(r"<!--.*?-->", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.DOTALL)
    end = line = 0
    for found in re.finditer(r"<(?:[\w.-]+:)?CANopen(?:Sub)?Object\b", bare):
        line += bare.count("\n", end, found.start())
        end = found.start()
        yield line + 1


def _local(item: ElementTree.Element) -> str:
    return item.tag.rpartition("}")[2]


def _parameter(item: ElementTree.Element) -> dict[str, str]:
    """A parameter of an application process, by the attributes that an object may have instead (CiA 311)."""
    parts = {_local(part): part for part in item}
    return {
        "dataType": next((_TYPES_OF_XDD[name] for name in parts if name in _TYPES_OF_XDD), ""),
        "accessType": item.get("access", "read"),
        "defaultValue": parts["defaultValue"].get("value", "") if "defaultValue" in parts else "",
        "actualValue": parts["actualValue"].get("value", "") if "actualValue" in parts else "",
    }


def _xdd_section(name: str, item: ElementTree.Element, said: Mapping[str, Mapping[str, str]]) -> list[str]:
    own = {**said.get(item.get("uniqueIDRef", ""), {}), **item.attrib}
    access = own.get("accessType", "")
    keys = {
        "ParameterName": own.get("name", name),
        "ObjectType": own.get("objectType", "7"),
        "DataType": f"0x{own['dataType']}" if own.get("dataType") else "",
        "AccessType": _ACCESS_OF_XDD.get(access.casefold(), access),
        "PDOMapping": "1" if own.get("PDOmapping") in _MAPPABLE else "0",
        "DefaultValue": own.get("defaultValue", ""),
        "ParameterValue": own.get("actualValue", ""),
    }
    return [f"[{name}]", *(f"{key}={' '.join(value.split())}" for key, value in keys.items() if value)]
