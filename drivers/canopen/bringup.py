"""Bringing a node up: is it the device of the EDS, how does it send, does it have to be configured, started.

Reading is done in any case (unless the driver only listens); what changes the device (PDO parameters, heartbeat time,
NMT commands) only with `configure`, and through `_write_parameter`, which lets nothing else pass.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from drivers.canopen.channel import SdoChannel
from drivers.canopen.eds import DataSheet, parse_sheet
from drivers.canopen.options import IDENTITY, Options
from drivers.canopen.pdo import COMMUNICATION, MAPPING, Kind, PdoMapping, from_objects, select_pdos, writes
from drivers.canopen.place import ObjectPlace
from drivers.canopen.sdo import ABOUT_OBJECTS, SdoAbort
from drivers.errors import DriverError, ReplyTimeout, WriteForbidden

START, ENTER_PRE_OPERATIONAL = 1, 128
OPERATIONAL = 5
HEARTBEAT_TIME, ERROR_REGISTER, NEWEST_ERROR = ObjectPlace(0x1017), ObjectPlace(0x1001), ObjectPlace(0x1003, 1)
STORE_EDS, STORE_FORMAT = ObjectPlace(0x1021), ObjectPlace(0x1022)
VENDOR, PRODUCT = ObjectPlace(0x1018, 1), ObjectPlace(0x1018, 2)
HEARTBEAT_PERIODS_TO_GONE = 2.5
"""Heartbeat periods without a heartbeat after which the node is gone."""
START_TIMEOUT_S = 1.0
"""Seconds within which a started node must say that it is operational."""


@dataclass(frozen=True, slots=True)
class Brought:
    """What is known of a node that is up. `error`: code and register of a standing error; `life`: the life counter."""

    sheet: DataSheet
    tpdos: tuple[PdoMapping, ...]
    rpdos: tuple[PdoMapping, ...]
    heartbeat_timeout: float
    error: tuple[int, int] | None = None
    life: int | None = None
    changed: bool = False


class BringUp:
    """One bringing-up. `command` sends an NMT command, `state` gives the node's NMT state (None: not known).

    Without a `sheet` the device is asked for its own EDS.
    """

    def __init__(
        self,
        sdo: SdoChannel,
        command: Callable[[int], None],
        options: Options,
        sheet: DataSheet | None,
        state: Callable[[], int | None],
    ) -> None:
        self._sdo, self._command, self._options, self._sheet, self._state = sdo, command, options, sheet, state
        self._beats = False

    async def all(self) -> Brought:
        """Everything but the start. Raises DriverError for a device that is another one, refuses or is silent."""
        options = self._options
        if options.listen_only:
            return self._trust_sheet()
        sheet = self._sheet or await self._own_sheet()
        await self._check_identity(sheet)
        present = [*await self._pdos(sheet, "T"), *await self._pdos(sheet, "R")]
        beat = await self._number(HEARTBEAT_TIME, 2) or 0
        changed = False
        if options.configure:
            changed, present = await self._configure(sheet, present)
            beat = await self._set_heartbeat(beat)
        self._beats = beat > 0
        register = await self._number(ERROR_REGISTER, 1) or 0
        code = (await self._number(NEWEST_ERROR, 4) or 0) & 0xFFFF if register else 0
        life = await self._number(options.life[0], 2) if options.life else None
        return Brought(
            sheet=sheet,
            tpdos=tuple(pdo for pdo in present if pdo.kind == "T"),
            rpdos=tuple(pdo for pdo in present if pdo.kind == "R"),
            heartbeat_timeout=options.heartbeat_timeout or HEARTBEAT_PERIODS_TO_GONE * beat / 1000.0,
            # A register that is set while 0x1003 is empty or absent is a generic error, 0x1000 (CiA 301, 7.2.7).
            error=(code or 0x1000, register) if register else None,
            life=life,
            changed=changed,
        )

    async def start(self) -> None:
        """Start the node, if that is allowed and needed, and wait for the heartbeat of one that has one.

        Raises ReplyTimeout for a node that does not say that it is operational (one that may not be started: that it
        lives); an answer by SDO alone does not make up for a heartbeat that is missing.
        """
        options = self._options
        if options.configure and self._state() != OPERATIONAL:
            # The NMT command is not confirmed (CiA 301, 7.2.8.3.1): only the next heartbeat says that it was obeyed.
            self._command(START)
        if not self._beats or options.listen_only:
            return
        deadline = asyncio.get_running_loop().time() + START_TIMEOUT_S
        while self._state() != OPERATIONAL and (options.configure or self._state() is None):
            if asyncio.get_running_loop().time() > deadline:
                what = "it is not operational" if options.configure else "it has sent no heartbeat"
                raise ReplyTimeout(f"{what} within {START_TIMEOUT_S:g} s")
            await asyncio.sleep(0.005)

    def _trust_sheet(self) -> Brought:
        """Who only listens has the EDS's word and no other."""
        if self._sheet is None:
            raise DriverError("listen_only needs an EDS")
        sheet = self._sheet
        beat = (sheet.value(HEARTBEAT_TIME) or 0) / 1000.0
        tpdos = select_pdos(sheet.pdos("T"), self._options.tpdo, sheet.bits)
        return Brought(
            sheet, tpdos, sheet.pdos("R"), self._options.heartbeat_timeout or HEARTBEAT_PERIODS_TO_GONE * beat
        )

    async def _own_sheet(self) -> DataSheet:
        """The EDS that the device keeps itself (0x1021), by block transfer where it can."""
        text = await self._sdo.read(STORE_EDS, block=True)
        if await self._number(STORE_FORMAT, 1):
            raise DriverError("its own EDS (0x1021) is compressed; give the setting eds")
        return parse_sheet(text.decode("utf-8", errors="replace"), self._options.node, "0x1021 of the device")

    async def _check_identity(self, sheet: DataSheet) -> None:
        """Raises DriverError if vendor or product are not those of the EDS (0 in the EDS: any), or what is pinned."""
        for place, what in ((VENDOR, "vendor"), (PRODUCT, "product")):
            expected = sheet.value(place)
            actual = await self._number(place, 4) if expected else None
            if expected and actual is not None and actual != expected:
                raise DriverError(
                    f"it is another device: {what} 0x{actual:08X}, and {sheet.origin} is of 0x{expected:08X}"
                )
        for what, pinned in self._options.identity.items():
            actual = await self._number(ObjectPlace(0x1018, IDENTITY[what]), 4)
            if actual != pinned:
                said = "says nothing of it" if actual is None else f"says 0x{actual:08X}"
                raise DriverError(
                    f"it is another device: of its {what} (0x1018) it {said}, and 0x{pinned:08X} is pinned (identity)"
                )

    async def _pdos(self, sheet: DataSheet, kind: Kind) -> list[PdoMapping]:
        """The PDOs as the device has them now."""
        mappings = []
        for number in sheet.numbers(kind):
            values = {}
            communication, mapping = COMMUNICATION[kind] + number - 1, MAPPING[kind] + number - 1
            for place, size in (
                (ObjectPlace(communication, 1), 4),
                (ObjectPlace(communication, 2), 1),
                (ObjectPlace(mapping, 0), 1),
            ):
                values[place] = await self._number(place, size)
            for place in (ObjectPlace(communication, 3), ObjectPlace(communication, 5)):
                values[place] = await self._number(place, 2) if place in sheet.objects else None
            for sub in range(1, min(values[ObjectPlace(mapping, 0)] or 0, 64) + 1):
                values[ObjectPlace(mapping, sub)] = await self._number(ObjectPlace(mapping, sub), 4)
            pdo = from_objects(kind, number, values.get)
            mappings += [pdo] if pdo else []
        return mappings

    async def _configure(self, sheet: DataSheet, present: list[PdoMapping]) -> tuple[bool, list[PdoMapping]]:
        """Make the device's PDOs those that are wanted; whether anything had to be written."""
        aims = [*select_pdos(sheet.pdos("T"), self._options.tpdo, sheet.bits), *sheet.pdos("R")]
        by_name = {(pdo.kind, pdo.number): pdo for pdo in present}
        steps = [step for aim in aims for step in writes(aim, by_name[aim.kind, aim.number])]
        if not steps:
            return False, aims
        # Between two steps a mapping is half the old and half the new: PDOs rest in pre-operational, while SDO works
        # (CiA 301, 7.3.2.2). A node that has not been heard may be operational.
        if self._state() in (None, OPERATIONAL):
            self._command(ENTER_PRE_OPERATIONAL)
        for place, data in steps:
            await self._write_parameter(place, data)
        # Devices confirm what they round or ignore (an event timer in steps of 10 ms, say): what they kept is asked.
        kept = [*await self._pdos(sheet, "T"), *await self._pdos(sheet, "R")]
        wrong = [aim.name for aim, pdo in zip(aims, kept, strict=True) if writes(aim, pdo)]
        if wrong:
            raise DriverError(f"it has confirmed its configuration and not kept it: {', '.join(wrong)}")
        return True, aims

    async def _set_heartbeat(self, present: int) -> int:
        milliseconds = round(self._options.heartbeat_time * 1000.0)
        if milliseconds and milliseconds != present:
            await self._write_parameter(HEARTBEAT_TIME, milliseconds.to_bytes(2, "little"))
            return milliseconds
        return present

    async def _write_parameter(self, place: ObjectPlace, data: bytes) -> None:
        """Write one communication parameter. Raises WriteForbidden for any other object."""
        if not (self._options.configure and (0x1400 <= place.index < 0x1C00 or place == HEARTBEAT_TIME)):
            raise WriteForbidden(f"{place} is no communication parameter, or configure is false; nothing was sent")
        await self._sdo.write(place, data)

    async def _number(self, place: ObjectPlace, size: int) -> int | None:
        """The object as an unsigned number; None where the device has none."""
        try:
            return int.from_bytes((await self._sdo.read(place, size))[:size], "little")
        except SdoAbort as abort:
            if abort.code in ABOUT_OBJECTS:
                return None
            raise
