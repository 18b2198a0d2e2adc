"""The raw-frame CAN face: messages of a DBC file, cyclic and on change, and the write-back block in frames."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any

import can

from drivers.can.bus import open_bus
from drivers.can.pump import Pump
from drivers.errors import DriverError
from sim.plc.can_bend import CanBend, bent
from sim.plc.can_messages import BlockMemory, Messages, Sender, protected, read_messages
from sim.plc.faults import merged
from sim.plc.image import Undefined
from sim.plc.modbus import Reply, Request
from sim.plc.program import Plc
from sim.plc.schedule import Line

_REOPEN_S = 0.1
_BUS_OFF_EVERY_S = 0.05
_BURST = 400
# linux/can/error.h: classes of error frames.
_BUS_OFF, _RESTARTED = 0x40, 0x100
# Of the faults that strike requests, those that a frame and its echo can show.
_BENDS = frozenset({"silent", "late", "duplicate", "garbage"})
_LAST_FIELD = "sequence_copy"


class CanFace:
    """One node on one bus, `name` "can"."""

    name = "can"

    def __init__(self, plc: Plc, messages: Messages, where: tuple[str, str], complain: Callable[[str], None]) -> None:
        self._plc, self._messages, self._complain = plc, messages, complain
        self._interface, self._channel = where
        # A repeatable bench, not a secret.
        self._rng = Random(f"{plc.settings.seed}:can")  # noqa: S311
        self._pump: Pump | None = None
        self._counters = {sender.message.frame_id: 0 for sender in messages.senders}
        self._bends: Sequence[CanBend] = ()
        self._listens, self._off = True, False
        self._next_open = self._next_off = self._babbled_to = 0.0

    # ---------------------------------------------------------------- Face

    async def open(self) -> None:
        """Join the bus. Raises OSError with a reason."""
        try:
            self._join()
        except DriverError as error:
            raise OSError(0, str(error)) from None

    async def apply(self, line: Line) -> None:
        """Once a cycle: what is due is sent, bent by the faults in force."""
        now = self._plc.clock.monotonic()
        self._listens = line.listen
        self._bends = [effect.can for _, effect in line.standing if effect.can is not None]
        if self._pump is None and not self._rejoined(now):
            return
        self._take_off(now)
        self._babble(now)
        if self._listens and not self._off:
            served = self._plc.image.served
            for sender in self._messages.senders:
                self._tell(sender, sender.payload(served), now)

    async def close(self) -> None:
        """Leave the bus."""
        if self._pump is not None:
            self._pump.close()
            self._pump = None

    def ready(self) -> Mapping[str, object]:
        """Where it is: the bus, and how many payload layouts it sends."""
        return {"interface": self._interface, "channel": self._channel, "messages": len(self._messages.senders)}

    # ---------------------------------------------------------------- the bus

    def _join(self) -> None:
        self._pump = Pump(open_bus(self._interface, self._channel), self._heard, self._lost)

    def _lost(self, reason: str) -> None:
        if self._pump is not None:
            self._pump.close()
            self._pump = None
            self._complain(f"the CAN bus {self._channel} is gone ({reason}); joining again as soon as it is back")

    def _rejoined(self, now: float) -> bool:
        if now < self._next_open:
            return False
        self._next_open = now + _REOPEN_S
        try:
            self._join()
        except DriverError:
            return False
        return True

    def _take_off(self, now: float) -> None:
        """Bus-off for all: said again and again, as a controller that comes back finds the wire as it was."""
        off = any(bend.bus_off for bend in self._bends)
        if off and now >= self._next_off:
            self._next_off = now + _BUS_OFF_EVERY_S
            self._put(can.Message(is_error_frame=True, arbitration_id=_BUS_OFF, dlc=8, data=bytes(8)))
        elif self._off and not off:
            self._put(can.Message(is_error_frame=True, arbitration_id=_RESTARTED, dlc=8, data=bytes(8)))
        self._off = off

    def _babble(self, now: float) -> None:
        """What a strange node sends: random payloads of random lengths, with random ids or with ours."""
        rate = sum(bend.babble for bend in self._bends)
        begun = self._babbled_to or now
        self._babbled_to = now if rate else 0.0
        ours = [sender.message.frame_id for sender in self._messages.senders]
        known = any(bend.known for bend in self._bends)
        for _ in range(min(_BURST, round(rate * (now - begun)))):
            number = self._rng.choice(ours) if known else self._rng.randrange(0x800)
            self._put(_data_frame(number, self._rng.randbytes(self._rng.randrange(9))))

    def _put(self, message: can.Message) -> None:
        if self._pump is None:
            return
        try:
            self._pump.bus.send(message, timeout=0.01)
        except (can.CanError, OSError) as error:
            self._lost(str(error))

    # ---------------------------------------------------------------- what the PLC says

    def _tell(self, sender: Sender, content: bytes, now: float) -> None:
        """Send the message if it is due or has changed; a fault may keep it from the bus or bend it."""
        if content == sender.content and now < sender.due:
            return
        sender.content, sender.due = content, now + sender.cycle
        number = sender.message.frame_id
        data = content
        if sender.data_id is not None:
            self._counters[number] = (self._counters[number] + 1) % 256
            data = protected(sender.data_id, self._counters[number], content)
        bends = [bend for bend in self._bends if bend.strikes(sender.message.name)]
        bent_data = bent(bends, data, sender.wire, self._rng)
        if not any(bend.stale for bend in bends):
            sender.wire = data
        self._record(number, bent_data, sent=True)
        if bent_data is not None:
            self._put(_data_frame(number, bent_data, extended=sender.message.is_extended_frame))

    def _record(self, number: int, data: bytes | None, *, sent: bool) -> None:
        """The recorder's row of a frame; a frame that a fault has kept from the bus has no data."""
        row = {"face": self.name, "sent": sent, "id": number, "data": None if data is None else data.hex()}
        self._plc.record("frame", self._plc.clock.monotonic(), {**row, "version": self._plc.image.version})

    # ---------------------------------------------------------------- what the PLC hears

    def _heard(self, message: can.Message) -> None:
        block = self._messages.block
        if message.is_error_frame or message.is_remote_frame or block is None or not self._listens or self._off:
            return
        same = message.is_extended_id == block.message.is_extended_frame
        if message.arbitration_id == block.message.frame_id and same and self._plc.running:
            self._take(block, bytes(message.data))

    def _take(self, block: BlockMemory, data: bytes) -> None:
        """One frame of the block: stored, answered by its echo; the last one has the block judged."""
        now = self._plc.clock.monotonic()
        self._record(block.message.frame_id, data, sent=False)
        struck = list(self._plc.schedule.strike(0, now, self.name))
        store = merged(effect for _, effect in struck).store
        taken = block.put(data, store=store)
        if taken is None:
            return
        words, echo = taken
        request = Request("can", 0, self._plc.registers.unit, data, self.name)
        reply = Reply(0, self._plc.registers.unit, echo)
        for entry, effect in struck:
            if effect.alter is not None and entry.fault.kind in _BENDS:
                reply = effect.alter(request, reply, entry.rng)
        if store and _LAST_FIELD in words:
            self._judge(block, now)
        if reply.sent:
            self._answer(block, reply)

    def _answer(self, block: BlockMemory, reply: Reply) -> None:
        data = (reply.pdu if reply.raw is None else reply.raw)[:8]
        number = block.echo.frame_id
        frame = _data_frame(number, data, extended=block.echo.is_extended_frame)

        def send() -> None:
            for _ in range(reply.copies):
                self._record(number, data, sent=True)
                self._put(frame)

        if reply.delay_s > 0:
            asyncio.get_running_loop().call_later(reply.delay_s, send)
        else:
            send()

    def _judge(self, block: BlockMemory, now: float) -> None:
        """The whole block as it now stands in the memory, by the same checks as over every other face."""
        layout = self._plc.registers.block
        if layout is None:
            return
        words = [block.words.get(field.name, 0) for field in layout.fields]
        try:
            self._plc.write("can", layout.place.table, layout.place.address, words, now)
        except Undefined:
            self._complain("the write-back block has no place in the register map")


def make(plc: Plc, options: Mapping[str, Any], complain: Callable[[str], None]) -> CanFace:
    """The face that the command line asks for. Raises InputError."""
    messages = read_messages(Path(options["can"]), tuple(plc.registers.tags))
    return CanFace(plc, messages, (options["can_interface"], options["can_channel"]), complain)


def _data_frame(number: int, data: bytes, *, extended: bool = False) -> can.Message:
    return can.Message(arbitration_id=number, is_extended_id=extended, data=data, is_fd=len(data) > 8)
