"""An electronic data sheet (CiA 306) as the driver needs it: which objects there are, how large, and the PDOs."""

import io
from collections.abc import Callable, Mapping
from configparser import Error as IniError
from dataclasses import dataclass
from pathlib import Path

from canopen import ObjectDictionary
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.objectdictionary.eds import import_eds

from drivers.canopen.pdo import COMMUNICATION, Kind, PdoMapping, from_objects
from drivers.canopen.place import ObjectPlace, from_bytes, object_bytes, parse_place
from drivers.canopen.sheet_text import SheetSection, format_sections, parse_sections, sections_of_xml
from drivers.errors import AddressError, DriverError
from drivers.named_files import contents, decode_text, endless_number
from drivers.tag import Tag

MOST_BYTES = 8 << 20
"""Of an EDS; the largest that are published have one."""


@dataclass(frozen=True, slots=True)
class EdsEntry:
    """One object: its name, bytes (None where they vary: text, domain), access, and the EDS's value (a number)."""

    name: str
    size: int | None
    readable: bool
    writable: bool
    mappable: bool
    value: int | None


@dataclass(frozen=True, slots=True)
class DataSheet:
    """The whole object dictionary of one node, with its node id worked in.

    `left_out` says of each object of the file that cannot be used its line and why.
    """

    origin: str
    objects: Mapping[ObjectPlace, EdsEntry]
    left_out: tuple[str, ...] = ()

    def value(self, place: ObjectPlace) -> int | None:
        """The number that the EDS gives to an object (ParameterValue before DefaultValue); None where it has none."""
        entry = self.objects.get(place)
        return entry.value if entry else None

    def bits(self, place: ObjectPlace) -> int | None:
        """The bits of an object that may be mapped into a PDO; None for any other."""
        entry = self.objects.get(place)
        return 8 * entry.size if entry and entry.mappable and entry.size else None

    def numbers(self, kind: Kind) -> list[int]:
        """The numbers (from 1) of the PDOs that the device has."""
        first = COMMUNICATION[kind]
        return [
            place.index - first + 1 for place in self.objects if place.subindex == 1 and 0 <= place.index - first < 512
        ]

    def pdos(self, kind: Kind) -> tuple[PdoMapping, ...]:
        """The PDOs as the EDS maps them. Raises AddressError for a mapping that no frame can carry."""
        mappings = (from_objects(kind, number, self.value) for number in self.numbers(kind))
        return tuple(pdo for pdo in mappings if pdo is not None)


@dataclass(frozen=True, slots=True)
class Where:
    """The object in which a tag lies; `misplaced`: why it cannot be read from there."""

    place: ObjectPlace
    misplaced: str = ""


def locate(tag: Tag, sheet: DataSheet | None) -> Where:
    """Where a tag lies, held against the EDS as far as that is known."""
    try:
        place = parse_place(tag.address, tag.name)
        needed = object_bytes(tag)
        from_bytes(tag, bytes(needed or 1))
    except AddressError as error:
        return Where(ObjectPlace(0), str(error))
    entry = sheet.objects.get(place) if sheet else None
    if sheet is None or (entry is not None and entry.readable and entry.size in (None, needed, needed or entry.size)):
        return Where(place)
    if entry is None:
        lost = next((problem for problem in sheet.left_out if f"[{place.index:04X}" in problem), "")
        return Where(place, f"{place} is not in the EDS ({lost or sheet.origin})")
    if not entry.readable:
        return Where(place, f"{place} cannot be read")
    return Where(place, f"{place} has {entry.size} bytes, and a {tag.dtype} has {needed}")


def load_sheet(path: Path, node: int) -> DataSheet:
    """The EDS, DCF, XDD or XDC in a file, for this node id. Raises DriverError naming file and reason."""
    try:
        text = decode_text(contents(path, MOST_BYTES))
    except OSError as error:
        raise DriverError(f"canopen: eds: {path} cannot be read ({error.strerror}); give the device's EDS") from None
    return parse_sheet(text, node, str(path))


def parse_sheet(text: str, node: int, origin: str) -> DataSheet:
    """The EDS in a text. Raises DriverError naming `origin` and the reason."""
    if problem := endless_number(text):
        raise DriverError(f"canopen: eds: {origin}: {problem}")
    try:
        sections, left = sections_of_xml(text) if text.lstrip().startswith("<") else parse_sections(text)
    except ValueError as error:
        raise DriverError(
            f"canopen: eds: {origin} is no EDS: {error}; give the device's electronic data sheet"
        ) from None
    # All at once; where that fails, each object by itself.
    try:
        items = list(_read(sections, node).items())
    except _LIBRARY_RAISES:
        items, more = _one_by_one(sections, node)
        left += more
    left_out = tuple(f"canopen: eds: {origin}: {problem}" for problem in left)
    objects: dict[ObjectPlace, EdsEntry] = {}
    for index, item in items:
        members = [item] if isinstance(item, ODVariable) else list(item.values())
        for member in members:
            number = member.default if member.value is None else member.value
            size = len(member) // 8 if member.fixed_size else None
            if not 0 <= member.subindex <= 0xFF:
                raise DriverError(
                    f"canopen: eds: {origin}: object 0x{index:04X} has a sub-index 0x{member.subindex:X}, and 0xFF is "
                    "the highest; correct its section"
                )
            # A number that its own type cannot hold is a slip of the file, and no value. A signed one may be given by
            # its bits.
            bits = 8 * (size or 8)
            fits = isinstance(number, int) and -(1 << bits - 1) <= number < 1 << bits
            objects[ObjectPlace(index, member.subindex)] = EdsEntry(
                name=member.name,
                size=size,
                readable=member.readable,
                writable=member.writable,
                mappable=member.pdo_mappable,
                value=number if fits else None,
            )
    if not objects:
        why = f" ({left[0]})" if left else ""
        raise DriverError(f"canopen: eds: {origin} has no objects{why}; give the device's own")
    return DataSheet(origin, objects, left_out)


# AttributeError: an object without members that others count on, such as a compact array of nothing.
_LIBRARY_RAISES = (IniError, KeyError, ValueError, TypeError, IndexError, AttributeError, OverflowError)


def _read(sections: Mapping[str, SheetSection], node: int) -> ObjectDictionary:
    # The library warns of a missing [DeviceInfo] in a way that is deprecated itself.
    read: Callable[..., ObjectDictionary] = import_eds
    return read(io.StringIO(f"[DeviceInfo]\n{format_sections(sections)}\n"), node)


def _one_by_one(
    sections: Mapping[str, SheetSection], node: int
) -> tuple[list[tuple[int, ODVariable | ODArray | ODRecord]], list[str]]:
    """The objects that can be read, and why the others cannot, in words with lines."""
    items: list[tuple[int, ODVariable | ODArray | ODRecord]] = []
    problems: list[str] = []
    # Types of a device's own, of which objects may be, are sections with numbers of two or three digits.
    types = {name: section for name, section in sections.items() if len(name.partition("sub")[0]) < 4}
    for index in dict.fromkeys(name[:4] for name in sections if name not in types):
        own = {name: section for name, section in sections.items() if name[:4] == index}
        try:
            items += [item for item in _read(types | own, node).items() if item[0] == int(index, 16)]
        except _LIBRARY_RAISES as error:
            line = min(section.line for section in own.values())
            problems.append(f"line {line}: [{index}] is left out: {' '.join(str(error).split())}")
    return items, problems
