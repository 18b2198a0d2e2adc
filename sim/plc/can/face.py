"""The raw-frame CAN face: messages of a DBC file, cyclic and on change, and the write-back blocks in frames."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from math import inf
from pathlib import Path
from random import Random
from typing import Any

import can

from sim.plc.can.messages import BlockMemory, Messages, Sender, protect_payload, read_messages
from sim.plc.can.station import Station, record
from sim.plc.program import (
    BusDisturbance,
    CycleFaults,
    ModbusReply,
    ModbusRequest,
    Plc,
    Undefined,
    disturb_payload,
    face_shows,
    merge_effects,
)

_LAST_FIELD = "sequence_copy"


class CanFace:
    """One node on one bus, `name` "can"."""

    name = "can"

    def __init__(self, plc: Plc, messages: Messages, where: tuple[str, str], complain: Callable[[str], None]) -> None:
        self._plc, self._messages, self._complain = plc, messages, complain
        # A repeatable bench, not a secret.
        self._rng = Random(f"{plc.settings.seed}:can")  # noqa: S311
        self._station = Station(where, self._receive, complain, self._rng)
        self._counters = {sender.message.frame_id: 0 for sender in messages.senders}
        self._disturbances: Sequence[BusDisturbance] = ()
        self._layouts = {layout.suffix: layout for layout in plc.registers.blocks}
        self._listens = True

    # ---------------------------------------------------------------- Face

    async def open(self) -> None:
        """Join the bus. Raises OSError with a reason."""
        self._station.open()

    async def apply(self, line: CycleFaults) -> None:
        """Once a cycle: what has changed or is due is sent, as the faults in force have it."""
        now = self._plc.clock.monotonic()
        self._listens = line.listen
        self._disturbances = [effect.can for _, effect in line.standing if effect.can is not None]
        if not self._station.on_bus(now):
            return
        self._station.disturb(self._disturbances, tuple(self._counters), now)
        if self._listens and not self._station.off:
            served = self._plc.image.client_values
            for sender in self._messages.senders:
                self._send_if_due(sender, sender.payload(served), now)
            self._wake(now)

    async def close(self) -> None:
        """Leave the bus."""
        self._station.close()

    def ready(self) -> Mapping[str, object]:
        """Where it is: the bus, and how many payload layouts it sends."""
        station = self._station
        return {"interface": station.interface, "channel": station.channel, "messages": len(self._messages.senders)}

    # ---------------------------------------------------------------- what the PLC says

    def _wake(self, now: float) -> None:
        self._station.wake(min((sender.due for sender in self._messages.senders), default=inf), now, self._send_due)

    def _send_due(self) -> None:
        """Between two cycles: the messages whose time has come."""
        now = self._plc.clock.monotonic()
        if not self._listens or self._station.off or not self._station.on_bus(now):
            return  # the next cycle goes on with it
        for sender in self._messages.senders:
            if now >= sender.due:
                self._send_if_due(sender, sender.payload(self._plc.image.client_values), now)
        self._wake(now)

    def _send_if_due(self, sender: Sender, content: bytes, now: float) -> None:
        """Send the message if it is due or has changed; a fault may keep it from the bus or change it."""
        if content == sender.content and now < sender.due:
            return
        # What is sent by the clock is due on a grid, so that being late now and then makes no period longer.
        timed = content == sender.content and sender.due + sender.cycle > now
        sender.content, sender.due = content, (sender.due if timed else now) + sender.cycle
        number = sender.message.frame_id
        data = content
        if sender.data_id is not None:
            self._counters[number] = (self._counters[number] + 1) % 256
            data = protect_payload(sender.data_id, self._counters[number], content)
        striking = [disturbance for disturbance in self._disturbances if disturbance.strikes(sender.message.name)]
        wire_data = disturb_payload(striking, data, sender.wire, self._rng)
        if not any(disturbance.stale for disturbance in striking):
            sender.wire = data
        record(self._plc, self.name, number, wire_data, sent=True)
        if wire_data is not None:
            self._station.put(_data_frame(number, wire_data, extended=sender.message.is_extended_frame))

    # ---------------------------------------------------------------- what the PLC hears

    def _receive(self, message: can.Message) -> None:
        if message.is_error_frame or message.is_remote_frame or not self._listens or self._station.off:
            return
        for block in self._messages.blocks if self._plc.running else ():
            same = message.is_extended_id == block.message.is_extended_frame
            if message.arbitration_id == block.message.frame_id and same:
                self._take(block, bytes(message.data))

    def _take(self, block: BlockMemory, data: bytes) -> None:
        """One frame of the block: stored, answered by its echo; the last one has the block judged."""
        now = self._plc.clock.monotonic()
        record(self._plc, self.name, block.message.frame_id, data, sent=False)
        struck = list(self._plc.schedule.strike(0, now, self.name))
        store = merge_effects(effect for _, effect in struck).store
        taken = block.put(data, store=store)
        if taken is None:
            return
        words, echo = taken
        request = ModbusRequest("can", 0, self._plc.registers.unit, data, self.name)
        reply = ModbusReply(0, self._plc.registers.unit, echo)
        for entry, effect in struck:
            if effect.answer is not None and face_shows(entry.fault.kind, self.name):
                reply = effect.answer(request, reply, entry.rng)
        if store and _LAST_FIELD in words:
            self._judge(block, now)
        if reply.sent:
            self._answer(block, reply)

    def _answer(self, block: BlockMemory, reply: ModbusReply) -> None:
        data = (reply.pdu if reply.raw is None else reply.raw)[:8]
        number = block.echo.frame_id
        frame = _data_frame(number, data, extended=block.echo.is_extended_frame)

        def send() -> None:
            for _ in range(reply.copies):
                record(self._plc, self.name, number, data, sent=True)
                self._station.put(frame)

        if reply.delay_s > 0:
            asyncio.get_running_loop().call_later(reply.delay_s, send)
        else:
            send()

    def _judge(self, block: BlockMemory, now: float) -> None:
        """The whole block as it now stands in the memory, by the same checks as over every other face."""
        layout = self._layouts.get(block.suffix)
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
