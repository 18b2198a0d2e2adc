"""The node: NMT states, boot-up, heartbeat, TPDOs on events and with SYNC, RPDOs, EMCY; frames in, frames out.

Its own state machine after CiA 301, as the library's LocalNode has no event timer, no sending on change, no gating of
PDOs by the NMT state, and no SDO block server. Everything gets the moment (s, monotonic) as an argument.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from sim.plc.canopen.eds import Address
from sim.plc.canopen.objects import NodeLayout, Objects
from sim.plc.canopen.pdo import RPDO, TPDO, ActivePdo
from sim.plc.canopen.sdo import Abort, SdoServer
from sim.plc.program import NodeDisturbance, Plc

Out = tuple[int, bytes]
STOPPED, OPERATIONAL, PRE_OPERATIONAL = 4, 5, 127
_STATES = {1: OPERATIONAL, 2: STOPPED, 128: PRE_OPERATIONAL}
_RESETS = (129, 130)
NMT, SYNC, EMCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700


@dataclass(slots=True)
class _Sent:
    """What a TPDO last said, without the life counter, and when it has to and may speak again."""

    content: bytes | None = None
    due: float = 0.0
    free: float = 0.0
    syncs: int = 0


class CanopenNode:
    """One node over the PLC's process image. `life` is the object whose change alone sends no TPDO."""

    def __init__(self, layout: NodeLayout, plc: Plc) -> None:
        self.id = layout.node
        self.objects = Objects(layout, plc, self._new_beat)
        self.sdo = SdoServer(self.objects.read, self.objects.write)
        self.state = PRE_OPERATIONAL
        self.counts: dict[str, int] = dict.fromkeys(("tpdos", "rpdos", "boots", "syncs"), 0)
        # The object of the PLC's own heartbeat: it moves in every cycle, which is no event.
        holders = (at for at, tags in layout.tags.items() if any(tag.name == plc.registers.heartbeat for tag in tags))
        self._life: Address | None = next(holders, None)
        self._beat_due = 0.0
        self._beat_time = 0.0
        self._sent: dict[int, _Sent] = {}
        self._emergency: tuple[int, int] | None = None

    def boot(self, now: float) -> list[Out]:
        """Power-on or reset: parameters as in the EDS, the boot-up message, then pre-operational."""
        self.objects.reset()
        self.sdo.reset()
        self._sent.clear()
        self._emergency = None
        self.state = PRE_OPERATIONAL
        self.counts["boots"] += 1
        self._beat_time = self.objects.number((0x1017, 0)) / 1000.0
        self._beat_due = now + self._beat_time
        return [(HEARTBEAT + self.id, b"\0")]

    # ---------------------------------------------------------------- once a cycle

    def cycle(self, now: float, disturbance: NodeDisturbance) -> list[Out]:
        """What the node says in this cycle: emergencies, its heartbeat, the TPDOs that are due."""
        out = self._emergencies(disturbance.emergency)
        if self._beat_time and now >= self._beat_due:
            late = now - self._beat_due >= self._beat_time
            self._beat_due = (now if late else self._beat_due) + self._beat_time
            if not disturbance.no_heartbeat:
                out.append((HEARTBEAT + self.id, bytes([self.state])))
        if self.state == OPERATIONAL:
            for pdo in self.objects.pdos(TPDO):
                if pdo.on_event and self._due(pdo, now):
                    out.append(self._frame(pdo, now, disturbance))
        return out

    def next_due(self) -> float:
        """When a timer of the node's runs out next (s, monotonic): heartbeat or event timers; inf where none runs."""
        moments = [self._beat_due] if self._beat_time else []
        if self.state == OPERATIONAL:
            for pdo in self.objects.pdos(TPDO):
                if pdo.on_event and pdo.event_timer > 0.0 and pdo.number in self._sent:
                    sent = self._sent[pdo.number]
                    moments.append(max(sent.due, sent.free))
        return min(moments, default=inf)

    def _due(self, pdo: ActivePdo, now: float) -> bool:
        sent = self._sent.setdefault(pdo.number, _Sent())
        if now < sent.free:
            return False
        timed = pdo.event_timer > 0.0 and now >= sent.due
        return timed or sent.content is None or self._content(pdo) != sent.content

    def _content(self, pdo: ActivePdo) -> bytes:
        """What a TPDO says beside the life counter: a change of it is an event."""
        return b"".join(self.objects.read(place) for place, _ in pdo.objects if place != self._life)

    def _frame(self, pdo: ActivePdo, now: float, disturbance: NodeDisturbance) -> Out:
        sent = self._sent.setdefault(pdo.number, _Sent())
        content = self._content(pdo)
        # On a grid where the event timer ran out, so that being late now and then makes no period longer.
        timed = content == sent.content and 0.0 <= now - sent.due < pdo.event_timer
        sent.due = (sent.due if timed else now) + pdo.event_timer
        sent.content, sent.free = content, now + pdo.inhibit
        self.counts["tpdos"] += 1
        data = b"".join(self.objects.read(place)[:size].ljust(size, b"\0") for place, size in pdo.objects)
        return pdo.cob_id, disturbance.payload(pdo.number, data)

    def _emergencies(self, emergency: tuple[int, int] | None) -> list[Out]:
        if emergency == self._emergency:
            return []
        self._emergency = emergency
        code, register = emergency or (0, 0)
        self.objects.announce(code, register)
        return [(EMCY + self.id, code.to_bytes(2, "little") + bytes([register]) + bytes(5))]

    # ---------------------------------------------------------------- frames that arrive

    def accepts(self, identifier: int) -> bool:
        """True for what `take` makes something of: NMT, SYNC and the RPDOs."""
        return identifier in (NMT, SYNC) or any(pdo.cob_id == identifier for pdo in self.objects.pdos(RPDO))

    def take(self, identifier: int, data: bytes, now: float, disturbance: NodeDisturbance) -> list[Out]:
        """What the node answers to a frame that is no SDO request; nonsense has no answer."""
        if identifier == NMT:
            return self._command(data, now)
        if identifier == SYNC and len(data) <= 1:
            return self._take_sync(now, disturbance)
        if self.state == OPERATIONAL:
            for pdo in self.objects.pdos(RPDO):
                if pdo.cob_id == identifier:
                    self._receive(pdo, data)
        return []

    def answers(self, data: bytes) -> list[bytes]:
        """The SDO server's answers to a request; none while the node is stopped."""
        return [] if self.state == STOPPED else self.sdo.take(data)

    def _command(self, data: bytes, now: float) -> list[Out]:
        if len(data) != 2 or data[1] not in (0, self.id):
            return []
        if data[0] in _RESETS:
            return self.boot(now)
        state = _STATES.get(data[0])
        if state is not None and state != self.state:
            # The new state is told at once, and every TPDO speaks again.
            self.state, self._beat_due = state, now
            self._sent.clear()
        return []

    def _take_sync(self, now: float, disturbance: NodeDisturbance) -> list[Out]:
        self.counts["syncs"] += 1
        out = []
        for pdo in self.objects.pdos(TPDO) if self.state == OPERATIONAL else ():
            sent = self._sent.setdefault(pdo.number, _Sent())
            sent.syncs += 1
            if pdo.transmission == 0:
                due = sent.content is None or self._content(pdo) != sent.content
            else:
                due = pdo.transmission <= 240 and sent.syncs >= pdo.transmission
            if due:
                sent.syncs = 0
                out.append(self._frame(pdo, now, disturbance))
        return out

    def _receive(self, pdo: ActivePdo, data: bytes) -> None:
        """An RPDO of the right length writes its objects, the words of a block among them together."""
        if len(data) != sum(size for _, size in pdo.objects):
            return
        self.counts["rpdos"] += 1
        words: dict[int, dict[int, int]] = {}
        others: dict[Address, bytes] = {}
        offset = 0
        for place, size in pdo.objects:
            part, offset = data[offset : offset + size], offset + size
            word = self.objects.word(place)
            if word is None:
                others[place] = part
            else:
                words.setdefault(word[0], {})[word[1]] = int.from_bytes(part, "little")
        self._store(words, others)

    def _store(self, words: Mapping[int, Mapping[int, int]], others: Mapping[Address, bytes]) -> None:
        for place, part in others.items():
            try:
                self.objects.write(place, part)
            except Abort:
                continue  # nobody waits for an answer to an RPDO
        for number, own in words.items():
            self.objects.put_words(number, own)

    def _new_beat(self, seconds: float) -> None:
        self._beat_time = seconds
        self._beat_due = 0.0
