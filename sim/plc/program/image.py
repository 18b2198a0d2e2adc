"""The process image: what is in the PLC's memory, addressed as Modbus addresses it, and what its tags truly are."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

from drivers.tag import DType, Tag, Value
from sim.plc.program.encoding import (
    FLOATS,
    GREATEST_POWER,
    LEAST_POWER,
    Unrepresentable,
    decode,
    encode,
    encode_absent,
    with_power,
)
from sim.plc.program.registers import BIT_TABLES, WORD_TABLES, Place, RegisterMap

Values = Mapping[str, Value | None]
Complain = Callable[[str], None]


class Undefined(LookupError):
    """An address that the image does not have, or that a client may not write."""


class ProcessImage:
    """Four tables of addresses, and the tags in them.

    `truth` is what the PLC's program knows of each tag; the tables are what a client reads. They differ only while a
    tag is frozen or its words are swapped. Everything happens in one synchronous step, so that no client ever sees half
    of an update. Unused registers between two used ones, at most `max_gap` of them, read as 0: that is what the map
    promises of them.

    A tag with a factor in a register (`scale_from`) is true as that register lets it be told. The power of ten there is
    the least by which all that share it fit, and grows with them, as an inverter's does (floats need none).
    """

    def __init__(self, registers: RegisterMap, writable: Iterable[Place] = (), complain: Complain = lambda _: None):
        self.registers = registers
        self.truth: dict[str, Value | None] = {}
        self.version = 0
        self._powers = {
            place: 0 if all(registers.tags[name].dtype in FLOATS for name in names) else LEAST_POWER
            for place, names in registers.factors.items()
        }
        self._scaled = {name: place for place, names in registers.factors.items() for name in names}
        # Tags that are a factor themselves.
        self._own_factors = {name: place for name, place in registers.places.items() if place in self._powers}
        # What was known of a tag before its factor rounded it.
        self._exact: dict[str, Value | None] = {}
        self._served: dict[str, Value | None] = {}
        self._swapped: set[str] = set()
        self._complain = complain
        self._complained: set[str] = set()
        own = [registers.places[name] for name, tag in registers.tags.items() if tag.writable]
        blocks = [block.place for block in registers.blocks]
        self._writable = frozenset(
            (place.table, at) for place in (*own, *blocks, *writable) for at in place.addresses()
        )
        # Several tags may share a register, each with a bit of its own.
        self._owners: dict[tuple[str, int], list[str]] = {}
        for name, place in registers.places.items():
            for address in place.addresses():
                self._owners.setdefault((place.table, address), []).append(name)
        self._tables: dict[str, dict[int, int]] = {table: {} for table in (*WORD_TABLES, *BIT_TABLES)}
        factors = [(place.table, place.address) for place in registers.factors]
        for table, address in (*self._owners, *self._writable, *factors):
            self._tables[table][address] = 0
        for table in self._tables:
            places = (place for place in (*registers.places.values(), *registers.factors) if place.table == table)
            used = sorted({address for place in places for address in place.addresses()})
            for left, right in pairwise(used):
                if 1 < right - left <= registers.max_gap + 1:
                    self._tables[table].update(dict.fromkeys(range(left + 1, right), 0))

    def learn(self, values: Values) -> dict[str, Value | None]:
        """Take in what the program knows; give what changed. The tables stay as they are until `serve`."""
        if self._powers:
            values = {**values, **self._rounded(values)}
        changed = {name: value for name, value in values.items() if self.truth.get(name, _NEVER) != value}
        self.truth |= changed
        self.version += bool(changed)
        return changed

    def _rounded(self, values: Values) -> dict[str, Value | None]:
        """What the tags with a factor, and the factors, are with these values."""
        self._exact |= {name: value for name, value in values.items() if name in self._scaled}
        for name, value in self._exact.items():
            place, tag = self._scaled[name], self.registers.tags[name]
            while self._powers[place] < GREATEST_POWER and not _fits(with_power(tag, self._powers[place]), value):
                self._powers[place] += 1
        rounded = {name: self._told(self._tag(name), value) for name, value in self._exact.items()}
        return rounded | {name: self._powers[place] for name, place in self._own_factors.items()}

    @staticmethod
    def _told(tag: Tag, value: Value | None) -> Value | None:
        """What a client reads where a tag is as it is to be."""
        if value is None:
            return None
        try:
            return decode(tag, encode(tag, value))
        except Unrepresentable as error:
            return decode(tag, error.nearest)

    def _tag(self, name: str) -> Tag:
        """The tag as its factor stands."""
        tag, place = self.registers.tags[name], self._scaled.get(name)
        return tag if place is None else with_power(tag, self._powers[place])

    def serve(
        self, frozen: Callable[[str], bool] = lambda _: False, swapped: Callable[[str], bool] = lambda _: False
    ) -> None:
        """Bring the tables to the truth, but for the tags that are frozen; numbers that are swapped last word first.

        Tags that share a factor with one that is frozen stand with it.
        """
        moved = set[str]()
        for place, names in self.registers.factors.items():
            cell, power = self._tables[place.table], self._powers[place] & 0xFFFF
            if any(map(frozen, names)):
                frozen = _or_one_of(frozen, names)
            elif cell[place.address] != power:
                cell[place.address] = power
                moved.update(names)
        for name, value in self.truth.items():
            turned = swapped(name)
            stands = self._served.get(name, _NEVER) == value and turned == (name in self._swapped) and name not in moved
            if not stands and not frozen(name):
                self._store(self._tag(name), value, swapped=turned)
                self._served[name] = value
                (self._swapped.add if turned else self._swapped.discard)(name)

    @property
    def client_values(self) -> Mapping[str, Value | None]:
        """What a client reads of each tag at present; of a tag that is not in it, zeros."""
        return self._served

    def clear(self) -> None:
        """All addresses to 0, as after a power failure; the next `serve` writes every tag anew."""
        for table in self._tables.values():
            table.update(dict.fromkeys(table, 0))
        self._served.clear()

    def representable(self, tag: Tag, value: Value | None) -> Value | None:
        """The value, or what the PLC takes for one that does not fit: "not available" if it can say so, else the limit.

        The first such value of a tag is complained of.
        """
        if value is None:
            return None
        tag = with_power(tag, GREATEST_POWER)
        try:
            encode(tag, value)
        except Unrepresentable as error:
            if tag.name not in self._complained:
                self._complained.add(tag.name)
                self._complain(f"{error}: served as {'not available' if tag.sentinel is not None else 'its limit'}")
            return None if tag.sentinel is not None else decode(tag, error.nearest)
        return value

    def read(self, table: str, address: int, count: int) -> list[int]:
        """The words or bits of `count` addresses. Raises Undefined if one of them is not there."""
        cells = self._tables[table]
        try:
            return [cells[address + offset] for offset in range(count)]
        except KeyError:
            raise Undefined(f"{table}:{address} and the next {count}") from None

    def may_write(self, table: str, address: int, count: int) -> bool:
        """True if a client may write to all of these addresses."""
        return all((table, address + offset) in self._writable for offset in range(count))

    def write(self, table: str, address: int, values: Sequence[int]) -> dict[str, Value | None]:
        """Store what a client writes; give the tags that it changed. Raises Undefined where it may not."""
        if not self.may_write(table, address, len(values)):
            raise Undefined(f"{table}:{address} and the next {len(values)} are not all writable")
        self._tables[table].update(zip(range(address, address + len(values)), values, strict=True))
        # Whatever tag has a register among them says something else now.
        names = {name for at in range(address, address + len(values)) for name in self._owners.get((table, at), ())}
        changed = {name: self._decode(name) for name in sorted(names)}
        self._served |= changed
        return self.learn(changed)

    def _decode(self, name: str) -> Value | None:
        place = self.registers.places[name]
        return decode(self._tag(name), self.read(place.table, place.address, place.words))

    def _store(self, tag: Tag, value: Value | None, *, swapped: bool) -> None:
        place = self.registers.places[tag.name]
        cells = self._tables[place.table]
        if place.table in BIT_TABLES:
            cells[place.address] = int(bool(value))
        elif tag.bit is not None:
            word = cells[place.address]
            cells[place.address] = word & ~_mask(tag) | (_mask(tag) if value else 0)
        else:
            words = encode_absent(tag) if value is None else encode(tag, value)
            cells.update(
                zip(place.addresses(), words[::-1] if swapped and tag.dtype != DType.STRING else words, strict=True)
            )


_NEVER = object()
"""Equal to no value: None is one that a tag may have."""


def _mask(tag: Tag) -> int:
    """The tag's bit in its register; where the bytes are swapped, bit 0 lies in the high one."""
    bit = tag.bit or 0
    return 1 << ((bit ^ 8) if tag.order in ("BADC", "DCBA") else bit)


def _fits(tag: Tag, value: Value | None) -> bool:
    """Whether the tag can hold the value."""
    try:
        if value is not None:
            encode(tag, value)
    except (Unrepresentable, OverflowError):
        return False
    return True


def _or_one_of(frozen: Callable[[str], bool], names: Sequence[str]) -> Callable[[str], bool]:
    return lambda name: name in names or frozen(name)
