"""Writing within the closed write map: by RPDOs that carry nothing else, else by SDO; verified, and never repeated."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.canopen.eds import DataSheet
from drivers.canopen.node import RemoteNode
from drivers.canopen.options import Options
from drivers.canopen.pdo import PdoMapping
from drivers.canopen.place import ObjectPlace, parse_place, to_bytes
from drivers.driver import BeforeSending
from drivers.errors import AddressError, DriverError, WriteForbidden, WriteUnverified
from drivers.tag import Tag, Value


@dataclass(frozen=True, slots=True)
class WritePiece:
    """One object to be written, and its bytes."""

    place: ObjectPlace
    data: bytes
    name: str


class Writing:
    """The closed write map, and how what it allows gets to the device.

    Raises AddressError for a tag of the map that is no object, or one that the EDS calls read-only.
    """

    def __init__(self, write_map: Sequence[Tag], options: Options, sheet: DataSheet | None) -> None:
        self._options = options
        self._map = {tag.name: (tag, parse_place(tag.address, tag.name)) for tag in write_map}
        self._places = frozenset(place for _, place in self._map.values())
        self._lock = asyncio.Lock()
        for name, (_, place) in self._map.items():
            entry = sheet.objects.get(place) if sheet else None
            if sheet is not None and (entry is None or not entry.writable):
                what = "is not in the EDS" if entry is None else "is read-only"
                raise AddressError(f"{name}: {place} {what} ({sheet.origin}); the write map needs an object to write")

    def check(self, values: Sequence[tuple[Tag, Value]], sheet: DataSheet | None) -> list[WritePiece]:
        """The objects of the values, in their order. Raises WriteForbidden, EncodingError or AddressError."""
        for tag, _ in values:
            known = self._map.get(tag.name)
            if known is None or known[0] != tag:
                raise WriteForbidden(f"{tag.name} ({tag.address}) is not in the write map; nothing was sent")
        if values and self._options.listen_only:
            raise WriteForbidden("listen_only: this driver sends nothing")
        pieces = [self._piece(tag, value, sheet) for tag, value in values]
        doubled = {piece.place for piece in pieces if sum(other.place == piece.place for other in pieces) > 1}
        if doubled:
            raise AddressError(f"{', '.join(map(str, sorted(doubled)))} would be written twice; nothing was sent")
        return pieces

    def _piece(self, tag: Tag, value: Value, sheet: DataSheet | None) -> WritePiece:
        place = self._map[tag.name][1]
        entry = sheet.objects.get(place) if sheet else None
        return WritePiece(place, to_bytes(tag, value, entry.size if entry else None), tag.name)

    async def send(self, pieces: Sequence[WritePiece], node: RemoteNode, before_sending: BeforeSending) -> None:
        """Send the pieces, each once, and verify that the device has taken them. Raises as `Writes.write` says."""
        async with self._lock:
            waiting = self._acknowledges(pieces, node)
            carriers = self._carriers(pieces, node)
            carried = {mapped.place for pdo in carriers for mapped in pdo.objects}
            for piece in pieces:
                if piece.place not in carried:
                    before_sending()
                    await node.sdo.write(piece.place, piece.data)
            data = {piece.place: piece.data for piece in pieces}
            for pdo in carriers:
                number = 0
                for mapped in pdo.objects:
                    number |= int.from_bytes(data[mapped.place], "little") << mapped.offset
                before_sending()
                node.send(pdo.cob_id, number.to_bytes(pdo.length, "little"))
            if waiting is None:
                await self._verify(pieces, node)
            else:
                await self._await_acknowledgement(*waiting, node)

    def _carriers(self, pieces: Sequence[WritePiece], node: RemoteNode) -> list[PdoMapping]:
        """The RPDOs that carry pieces and nothing else, the one with the last piece last."""
        order = {piece.place: number for number, piece in enumerate(pieces)}
        sizes = {piece.place: 8 * len(piece.data) for piece in pieces}
        carriers: list[PdoMapping] = []
        taken: set[ObjectPlace] = set()
        for pdo in node.brought.rpdos if node.brought else ():
            places = [mapped.place for mapped in pdo.objects]
            fits = all(sizes.get(mapped.place) == mapped.bits for mapped in pdo.objects)
            # An RPDO that carries an object from outside the write map is never sent, whatever is written.
            if pdo.enabled and places and fits and self._places.issuperset(places) and taken.isdisjoint(places):
                carriers.append(pdo)
                taken.update(places)
        return sorted(carriers, key=lambda pdo: max(order[mapped.place] for mapped in pdo.objects))

    def _acknowledges(self, pieces: Sequence[WritePiece], node: RemoteNode) -> tuple[ObjectPlace, bytes] | None:
        """The object that will tell, and what it has to say; None if there is none or it says so already."""
        for piece in pieces:
            place = self._options.acknowledge.get(piece.place)
            if place is not None and node.carrier(place) is not None:
                return None if node.value(place) in (None, piece.data) else (place, piece.data)
        return None

    async def _await_acknowledgement(self, place: ObjectPlace, expected: bytes, node: RemoteNode) -> None:
        try:
            async with asyncio.timeout(self._options.timeout):
                while node.value(place) != expected:
                    await node.next_pdo()
        except TimeoutError:
            reason = f"{place} has not acknowledged it within {self._options.timeout:g} s"
            raise WriteUnverified(f"sent, and {reason}") from None

    async def _verify(self, pieces: Sequence[WritePiece], node: RemoteNode) -> None:
        for piece in pieces:
            try:
                stored = await node.sdo.read(piece.place, len(piece.data))
            except DriverError as error:
                raise WriteUnverified(f"sent, but reading {piece.place} back failed: {error}") from error
            if stored[: len(piece.data)] != piece.data:
                raise WriteUnverified(
                    f"{piece.name}: {piece.place} was written as 0x{piece.data[::-1].hex()} and reads back as "
                    f"0x{stored[::-1].hex()}"
                )
