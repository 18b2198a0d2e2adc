"""The PLC's program: each cycle it moves its heartbeat, reads its signals, watches the gateway's blocks, and answers.

Everything here is synchronous and gets the moment as an argument; the server and the main loop only carry bytes and
time. Time limits (the watchdog, faults) are wall seconds, whatever the speed of the replay.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from drivers.tag import Value
from sim.plc.program import pdu as modbus
from sim.plc.program import writeback
from sim.plc.program.checks import InputError, list_words
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.encoding import (
    GREATEST_POWER,
    Unrepresentable,
    encode,
    is_bool,
    resolution,
    value_at_rest,
    with_power,
)
from sim.plc.program.faults import ALL_TAGS, FaultEffect, OrderedFault, merge_effects, refusal
from sim.plc.program.image import ProcessImage, Undefined
from sim.plc.program.live import LivePlant
from sim.plc.program.pdu import ModbusRefusal, ModbusReply, ModbusRequest
from sim.plc.program.registers import BlockLayout, Place, RegisterMap
from sim.plc.program.replay import TraceReplay
from sim.plc.program.schedule import CycleFaults, FaultSchedule
from sim.plc.program.writeback import Intake


class RecordRow(Protocol):
    """Takes a row of the given kind; `moment` is monotonic."""

    def __call__(self, kind: str, moment: float, row: Mapping[str, object]) -> None: ...


def record_nothing(kind: str, moment: float, row: Mapping[str, object]) -> None:
    """The recorder of a PLC that keeps no record."""


@dataclass(frozen=True, slots=True)
class PlcSettings:
    """What is fixed when the process starts. `unknown_unit` True answers a strange unit with exception 11.

    `challenge` (1..65535) is the first one of the write-back's sessions: one that no earlier run has used.
    `reduced_feed` (0..1) is the share of the feed that is left once the limit is predicted (a live plant only).
    """

    permit: bool = True
    answer_unknown_unit: bool = False
    max_registers: int | None = None
    writable: Sequence[Place] = ()
    seed: int = 0
    challenge: int = 1
    reduced_feed: float = 0.5


class Plc:
    """The state of the PLC, moved on by `cycle` and by the requests that `exchange` answers.

    With a live `plant`, whose table `replay` runs over, the program also acts: it feeds less once a usable block, of
    whichever bearing, says that the limit will be reached, and keeps to that until an operator gives the feed back.
    """

    def __init__(
        self,
        registers: RegisterMap,
        clock: EmulatorClock,
        replay: TraceReplay | None = None,
        settings: PlcSettings | None = None,
        *,
        plant: LivePlant | None = None,
        faults: Sequence[OrderedFault] = (),
        record: RecordRow = record_nothing,
        complain: Callable[[str], None] = lambda _: None,
    ) -> None:
        settings = settings or PlcSettings()
        self.registers, self.clock, self.replay, self.settings = registers, clock, replay, settings
        self.plant, self._trips = plant, 0
        self.image = ProcessImage(registers, settings.writable, complain)
        self.schedule = FaultSchedule(settings.seed)
        # Without a block there is still an account of none.
        self.layouts: tuple[BlockLayout | None, ...] = registers.blocks or (None,)
        self.intakes = [
            writeback.begin_intake(layout, settings.challenge, permit=settings.permit) for layout in self.layouts
        ]
        self.permit = settings.permit
        self.acknowledged = {layout.suffix if layout else "": 0 for layout in self.layouts}
        self.forced: dict[str, Value | None] = {}
        self.heartbeat, self.running = 0, True
        self.usables = [False for _ in self.layouts]
        self.started, self.ended, self.stopping = False, False, False
        self.connections = 0
        self.record = record
        self.max_registers = settings.max_registers or registers.max_registers
        self._faults = tuple(faults)
        self._row: tuple[int, Mapping[str, Value | None]] = (-1, MappingProxyType({}))
        self._at_rest = {name: value_at_rest(tag) for name, tag in registers.tags.items()}
        self._own = {registers.heartbeat, writeback.PERMIT}
        self._own |= {name for name, place in registers.places.items() if place in registers.factors}
        self._own |= {f"{name}{suffix}" for name in writeback.STATUS_TAGS for suffix in self.acknowledged}
        for fault in faults:
            self.check_fault(fault)

    @property
    def intake(self) -> Intake:
        """What has become of the first block."""
        return self.intakes[0]

    @property
    def usable(self) -> bool:
        """The verdict on the first block."""
        return self.usables[0]

    # ---------------------------------------------------------------- the cycle

    def begin(self, now: float, *, hold: bool = False) -> CycleFaults:
        """Record what this process is, and bring the image up; unless `hold`, the replay and the schedule start."""
        trace = None if self.replay is None else str(self.replay.table.path)
        roundings = {name: resolution(tag) for name, tag in self.registers.tags.items()}
        clock = {"epoch": self.clock.epoch, "monotonic": self.clock.start, "speed": self.clock.speed}
        about = {"device": self.registers.device, "trace": trace, "seed": self.settings.seed, "roundings": roundings}
        self.record("run", now, {**clock, **about})
        self._learn(self._at_rest, now)
        if not hold:
            self.start(now)
        return self.cycle(now)

    def start(self, now: float) -> None:
        """Let the replay run; the first time, the schedule of faults runs from here."""
        if self.replay is not None:
            self.replay = self.replay.change(now, held=False)
        for fault in () if self.started else self._faults:
            self.schedule.add(fault, now)
        self.started = True
        self.event("start", now)

    def cycle(self, now: float) -> CycleFaults:
        """One cycle of the program; gives what the faces have to do."""
        begun, over = self.schedule.advance(now)
        for entry in begun:
            self.event("fault began", now, {"number": entry.number, "kind": entry.fault.kind})
        for entry in over:
            self.event("fault ended", now, {"number": entry.number, "kind": entry.fault.kind, "hits": entry.hits})
        effect = self.schedule.standing_effect(now)
        if effect.run != self.running:
            self._switch(effect.run, now)
        if self.running:
            # 1 to 65535 and round to 1: 0 says that the program does not run.
            self.heartbeat = self.heartbeat % 0xFFFF + 1
            self._follow(now)
            self._learn(self._values(now), now)
            self._control(now)
            self.image.serve(
                lambda name: name in effect.frozen or ALL_TAGS in effect.frozen,
                lambda name: name in effect.swapped or ALL_TAGS in effect.swapped,
            )
        return self.schedule.line(begun, now)

    def _control(self, now: float) -> None:
        """Feed less when the limit is predicted, by a block that may be used and by no other; say when it tripped."""
        plant = self.plant
        if plant is None:
            return
        for layout, intake, usable in zip(self.layouts, self.intakes, self.usables, strict=True):
            if usable and plant.feed > self.settings.reduced_feed and writeback.predicts_limit(intake):
                plant.feed = self.settings.reduced_feed
                minutes = intake.block["minutes_median"]
                self.event(
                    "feed reduced", now, {"feed": plant.feed, "minutes_median": minutes, **writeback.block_name(layout)}
                )
        if plant.trips > self._trips:
            self._trips = plant.trips
            self.event("drum tripped", now)

    def _switch(self, run: bool, now: float) -> None:
        """The program stops (memory to 0, nothing is true any more but the heartbeat's 0) or begins anew."""
        self.running = run
        # The counter of sessions survives, as retained memory does in a warm start.
        self.heartbeat = 0
        self.intakes = [
            writeback.end_session(Intake(intake.challenge, intake.number, intake.count, permitted=self.permit))
            for intake in self.intakes
        ]
        self.event("program runs" if run else "program stopped", now)
        dark: dict[str, Value | None] = dict.fromkeys(self.registers.tags)
        if self.registers.heartbeat is not None:
            dark[self.registers.heartbeat] = 0
        self._learn(self._at_rest if run else dark, now)
        self.image.clear()

    def _follow(self, now: float) -> None:
        """Let the sessions of the write-back end where their timer or the permit has ended them."""
        self.intakes = [
            intake if layout is None else writeback.follow_time(layout, intake, now, permit=self.permit)
            for layout, intake in zip(self.layouts, self.intakes, strict=True)
        ]

    def _learn(self, values: Mapping[str, Value | None], now: float) -> None:
        """The record comes first: what a client can see is in the recording already."""
        changed = self.image.learn(values)
        if changed:
            self.record("truth", now, {"version": self.image.version, "values": changed})

    def _values(self, now: float) -> dict[str, Value | None]:
        own: dict[str, Value | None] = {}
        for place, (layout, intake) in enumerate(zip(self.layouts, self.intakes, strict=True)):
            bits = self.acknowledged[layout.suffix if layout else ""]
            own |= writeback.status(self.registers, intake, now, permit=self.permit, acknowledged=bits, layout=layout)
            why = "" if layout is None else writeback.unusable(layout, intake, now, self.permit)
            usable = layout is not None and not why
            if usable != self.usables[place]:
                self.usables[place] = usable
                detail = {**({"reason": why} if why else {}), **writeback.block_name(layout)}
                self.event("prediction usable" if usable else "prediction not usable", now, detail)
        if self.registers.heartbeat is not None:
            own[self.registers.heartbeat] = self.heartbeat
        return {**self._signals(now), **own, **self.forced}

    def _signals(self, now: float) -> Mapping[str, Value | None]:
        if self.replay is None:
            return {}
        row = self.replay.row(now)
        if self.plant is not None:
            self.plant.move(row)
        # A row lasts for many cycles, and its values are checked against the registers once.
        if row != self._row[0]:
            known = {name: value for name, value in self.replay.values(now).items() if self.serves(name)}
            self._row = (row, {name: self._reading(name, value) for name, value in known.items()})
        return self._row[1]

    def _reading(self, name: str, value: float | None) -> Value | None:
        tag = self.registers.tags[name]
        if value is None:
            return self._at_rest[name]
        return bool(value) if is_bool(tag) else self.image.representable(tag, value)

    # ---------------------------------------------------------------- the network

    def exchange(self, request: ModbusRequest, now: float) -> ModbusReply | None:
        """Act on one request and give the reply, as the faults in force have it; None: no reply at all."""
        if request.unit != self.registers.unit:
            code = modbus.exception(request.function, modbus.TARGET_SILENT)
            answered = self.settings.answer_unknown_unit
            reply = ModbusReply(request.transaction, request.unit, code, sent=answered, rtu=request.rtu)
            return self._note_reply(request, reply, (), now)
        struck = list(self.schedule.strike(request.function, now, request.face))
        effect = merge_effects(effect for _, effect in struck)
        pdu = self._answer(request, effect, now)
        reply = ModbusReply(request.transaction, request.unit, pdu, rtu=request.rtu)
        for entry, own in struck:
            # Each fault bends what the one before it has left.
            for alter in (own.answer, own.alter):
                reply = reply if alter is None else alter(request, reply, entry.rng)
        return self._note_reply(request, reply, tuple(entry.fault.kind for entry, _ in struck), now)

    def _answer(self, request: ModbusRequest, effect: FaultEffect, now: float) -> bytes:
        if request.refused is not None:
            return modbus.exception(request.function, request.refused)
        refused = refusal(effect, request, modbus.reads(request.pdu))
        return refused or modbus.answer(request.pdu, _Access(self, request.peer, effect.store, now))

    def _note_reply(
        self, request: ModbusRequest, reply: ModbusReply, faults: Sequence[str], now: float
    ) -> ModbusReply | None:
        address, count = modbus.span(request.pdu)
        plain = reply.sent and reply.raw is None
        refused = reply.pdu[1] if plain and len(reply.pdu) == 2 and reply.pdu[0] & 0x80 else None
        header = {"transaction": request.transaction, "unit": request.unit, "function": request.function}
        what = {
            "peer": request.peer,
            "face": request.face,
            **header,
            "address": address,
            "count": count,
            "pdu": request.pdu.hex(),
        }
        sent = reply.frame()[: reply.cut].hex() if reply.sent else None
        outcome = {"reply": sent, "exception": refused, "delay_s": reply.delay_s, "faults": faults}
        self.record("request", now, {**what, **outcome, "version": self.image.version})
        return reply if reply.sent else None

    def write(self, peer: str, table: str, address: int, values: Sequence[int], now: float) -> None:
        """Store what a client wrote, and judge it if it touches the write-back block. Raises Undefined."""
        changed = self.image.write(table, address, values)
        if changed:
            self.record("truth", now, {"version": self.image.version, "values": changed})
        if not self.running:
            return
        # A write that reaches into several blocks is judged by each of them, and is none to any.
        touched = [
            layout
            for layout in self.registers.blocks
            if table == layout.place.table
            and not set(layout.place.addresses()).isdisjoint(range(address, address + len(values)))
        ]
        if touched:
            # A write comes between two cycles: what has ended since the last one has ended for it.
            self._follow(now)
        for layout in touched:
            intake = self.intakes[layout.number]
            reason = writeback.verdict(layout, intake, address, values)
            taken = self.intakes[layout.number] = writeback.take_write(layout, intake, address, values, now)
            fields = None if reason == writeback.LENGTH else writeback.decode_block(layout, values)
            written = {"peer": peer, "address": address, "words": list(values), "fields": fields}
            written |= writeback.block_name(layout)
            self.record("block", now, {**written, "verdict": reason, "accepted": taken.accepted > intake.accepted})

    # ---------------------------------------------------------------- what others ask

    def serves(self, signal: str) -> bool:
        """True if a signal of the trace has a register that the program does not keep for itself."""
        return signal in self.registers.tags and signal not in self._own

    def ignored_signals(self) -> list[str]:
        """The trace's signals that go nowhere."""
        return [] if self.replay is None else [name for name in self.replay.table.columns if not self.serves(name)]

    def check_fault(self, fault: OrderedFault) -> None:
        """Raises InputError if the fault freezes a tag that is not there, or swaps its words."""
        effect = fault.effect(0.0)
        self._check_tags((effect.frozen | effect.swapped) - {ALL_TAGS})

    def force(self, name: str, value: Value | None) -> None:
        """Hold a tag at a value (None: not available) whatever the trace says. Raises InputError."""
        self._check_tags([name])
        tag = self.registers.tags[name]
        if value is not None and isinstance(value, str) != (tag.dtype == "string"):
            raise InputError(f"{name} cannot hold {value!r}; give {'text' if tag.dtype == 'string' else 'a number'}")
        if value is None and self._at_rest[name] is not None:
            raise InputError(f'{name} has no way to say "not available"; give a value')
        try:
            encode(with_power(tag, GREATEST_POWER), 0 if value is None else value)
        except (Unrepresentable, OverflowError):
            raise InputError(f"{name} cannot hold {value!r}; give a value within its type ({tag.dtype})") from None
        self.forced[name] = bool(value) if is_bool(tag) and value is not None else value

    def release(self, name: str | None, now: float) -> list[str]:
        """Let one forced tag, or all, follow the trace again, or else rest; gives their names."""
        self._check_tags([] if name is None else [name])
        names = [forced for forced in self.forced if name in (None, forced)]
        for forced in names:
            del self.forced[forced]
        # What neither trace nor program drives would stay at the forced value: it goes back to rest.
        followed = {*self._signals(now), *self._own}
        self._learn({forced: self._at_rest[forced] for forced in names if forced not in followed}, now)
        return names

    def _check_tags(self, names: Iterable[str]) -> None:
        if unknown := [name for name in names if name not in self.registers.tags]:
            raise InputError(f"there is no tag {unknown[0]!r}; known are {list_words(tuple(self.registers.tags))}")

    def event(self, what: str, now: float, detail: Mapping[str, object] = MappingProxyType({})) -> None:
        """Record anything else."""
        self.record("event", now, {"event": what, **detail})


@dataclass(frozen=True, slots=True)
class _Access:
    """The image as one request sees it; `store` False confirms writes and forgets them."""

    plc: Plc
    peer: str
    store: bool
    now: float

    @property
    def max_registers(self) -> int:
        """The device's own limit of registers in one request."""
        return self.plc.max_registers

    def read(self, table: str, address: int, count: int) -> list[int]:
        """The words or bits of `count` addresses. Raises Refusal."""
        try:
            return self.plc.image.read(table, address, count)
        except Undefined:
            raise ModbusRefusal(modbus.ILLEGAL_ADDRESS) from None

    def write(self, table: str, address: int, values: Sequence[int]) -> None:
        """Store the values as one step. Raises Refusal."""
        if not self.plc.image.may_write(table, address, len(values)):
            raise ModbusRefusal(modbus.ILLEGAL_ADDRESS)
        if self.store:
            self.plc.write(self.peer, table, address, values, self.now)
