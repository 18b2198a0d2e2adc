"""The CANopen face: the node on a CAN bus, the faults that strike it, and the recorder's rows."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any

import can

from sim.plc.can import Station, record
from sim.plc.canopen.node import SDO_ANSWER, SDO_REQUEST, CanopenNode, Out
from sim.plc.canopen.objects import NodeLayout, read_layout
from sim.plc.canopen.pdo import TPDO
from sim.plc.canopen.sdo import GENERAL, abort_frame
from sim.plc.program import (
    BusDisturbance,
    CycleFaults,
    FaultEffect,
    ModbusReply,
    ModbusRequest,
    NodeDisturbance,
    Plc,
    Scheduled,
    disturb_payload,
    face_shows,
    merge_effects,
    together,
)

FIRST_REQUESTS, WRITES = (1, 2, 5, 6), (1, 6)
ABORT_COMMANDS = 0x80
"""Command specifiers of a client's first frames, those of them that write, and the first byte of an abort."""


class CanopenFace:
    """One CANopen node, `name` "canopen"."""

    name = "canopen"

    def __init__(self, plc: Plc, layout: NodeLayout, where: tuple[str, str], complain: Callable[[str], None]) -> None:
        self._plc = plc
        self.node = CanopenNode(layout, plc)
        self._rng = Random(f"{plc.settings.seed}:canopen")  # noqa: S311 - a repeatable bench, not a secret
        self._station = Station(where, self._receive, complain, self._rng)
        self._own_disturbance = NodeDisturbance()
        self._disturbances: Sequence[BusDisturbance] = ()
        self._booted, self._down = False, True
        self._answered = 0.0

    # ---------------------------------------------------------------- Face

    async def open(self) -> None:
        """Join the bus and boot. Raises OSError with a reason."""
        self._station.open()

    async def apply(self, line: CycleFaults) -> None:
        """Once a cycle: the node boots, falls silent or says what is due, as the faults in force have it."""
        now = self._plc.clock.monotonic()
        self._disturbances = [effect.can for _, effect in line.standing if effect.can is not None]
        self._own_disturbance = together(effect.node for _, effect in line.standing if effect.node is not None)
        if not self._station.on_bus(now):
            return
        self._station.disturb(self._disturbances, [pdo.cob_id for pdo in self.node.objects.pdos(TPDO)], now)
        self._down = not line.listen or self._station.off
        reset = any(effect.node is not None and effect.node.reset for _, effect in line.begun)
        # A node that is only cut off goes on where it was; one whose program has stopped boots again.
        self._booted = self._booted and not reset and (line.listen or self._plc.running)
        if self._down:
            return
        if not self._booted:
            self._booted = True
            self._put_all(self.node.boot(now))
        self._cycle()

    def _cycle(self) -> None:
        """What the node has to say now, and a timer for what it has to say before the program's next cycle."""
        now = self._plc.clock.monotonic()
        if self._down or not self._booted or not self._station.on_bus(now):
            return
        self._put_all(self.node.cycle(now, self._own_disturbance))
        self._station.wake(self.node.next_due(), now, self._cycle)

    async def close(self) -> None:
        """Leave the bus."""
        self._station.close()

    def ready(self) -> Mapping[str, object]:
        """Where it is: the bus and the node id."""
        return {"interface": self._station.interface, "channel": self._station.channel, "node": self.node.id}

    # ---------------------------------------------------------------- what the node says

    def _put_all(self, frames: Sequence[Out]) -> None:
        for identifier, data in frames:
            self._say(identifier, data)

    def _say(self, identifier: int, data: bytes) -> None:
        """Send one frame of the node, as far as the faults of the bus let it through."""
        striking = [disturbance for disturbance in self._disturbances if disturbance.strikes(f"0x{identifier:X}")]
        left = disturb_payload(striking, data, None, self._rng)
        record(self._plc, self.name, identifier, left, sent=True)
        if left is not None:
            self._station.put(can.Message(arbitration_id=identifier, is_extended_id=False, data=left))

    # ---------------------------------------------------------------- what arrives

    def _receive(self, message: can.Message) -> None:
        if message.is_error_frame or message.is_remote_frame or message.is_extended_id or message.is_fd:
            return
        if self._down or not self._booted:
            return
        identifier, data, now = message.arbitration_id, bytes(message.data), self._plc.clock.monotonic()
        if identifier == SDO_REQUEST + self.node.id:
            record(self._plc, self.name, identifier, data, sent=False)
            self._answer(data, now)
        elif self.node.accepts(identifier):
            record(self._plc, self.name, identifier, data, sent=False)
            self.node.objects.store = self._find_faults(0, now)[1].store
            before = [intake.accepted for intake in self._plc.intakes]
            self._put_all(self.node.take(identifier, data, now, self._own_disturbance))
            # The acknowledge does not wait for the program's next cycle.
            if [intake.accepted for intake in self._plc.intakes] != before:
                self._put_all(self.node.cycle(now, self._own_disturbance))

    def _find_faults(self, function: int, now: float) -> tuple[list[Scheduled], FaultEffect]:
        """The faults that strike a request of this command specifier (RPDOs: 0), and what they do together."""
        struck = list(self._plc.schedule.strike(function, now, self.name))
        return [entry for entry, _ in struck], merge_effects(effect for _, effect in struck)

    def _answer(self, data: bytes, now: float) -> None:
        function = data[0] >> 5 if data else 0
        entries, effect = self._find_faults(function, now)
        self.node.objects.store = effect.store
        code = effect.abort if effect.abort is not None else GENERAL if effect.code is not None else None
        place = int.from_bytes(data[1:3], "little"), data[3] if len(data) > 3 else 0
        if code is not None and len(data) == 8 and function in FIRST_REQUESTS:
            answers = [abort_frame(place, code)]
        else:
            answers = self.node.answers(data)
        if function in WRITES and answers and answers[0][0] == ABORT_COMMANDS:
            self._plc.event("write refused", now, {"face": self.name, "object": f"0x{place[0]:04X}:{place[1]}"})
        for answer in answers:
            self._reply(answer, entries, now)

    def _reply(self, answer: bytes, entries: Sequence[Scheduled], now: float) -> None:
        """Send one answer as the faults have it, and none before those that came earlier: a server is one queue."""
        request, reply = (
            ModbusRequest("canopen", 0, self.node.id, answer, self.name),
            ModbusReply(0, self.node.id, answer),
        )
        for entry in entries:
            answer_as = entry.effect(now).answer
            if answer_as is not None and face_shows(entry.fault.kind, self.name):
                reply = answer_as(request, reply, entry.rng)
        if not reply.sent:
            return
        data = (reply.pdu if reply.raw is None else reply.raw)[:8]
        self._answered = max(self._answered, now + reply.delay_s)

        def send() -> None:
            for _ in range(reply.copies):
                self._say(SDO_ANSWER + self.node.id, data)

        if self._answered > now:
            asyncio.get_running_loop().call_later(self._answered - now, send)
        else:
            send()


def make(plc: Plc, options: Mapping[str, Any], complain: Callable[[str], None]) -> CanopenFace:
    """The face that the command line asks for. Raises InputError."""
    layout = read_layout(Path(options["canopen"]), plc.registers.tags, plc.registers.blocks, options["node"])
    return CanopenFace(plc, layout, (options["can_interface"], options["can_channel"]), complain)
