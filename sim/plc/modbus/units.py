"""Several machines behind one port or line, told apart by their unit numbers, as behind a serial device server."""

from collections.abc import Callable, Mapping
from typing import Protocol

from sim.plc.program import CycleFaults, EmulatorClock, ModbusReply, ModbusRequest, Plc


class ServedProgram(Protocol):
    """What a Modbus face serves: one program, or several behind it."""

    clock: EmulatorClock
    connections: int

    def exchange(self, request: ModbusRequest, now: float) -> ModbusReply | None: ...

    def event(self, what: str, now: float, detail: Mapping[str, object] = ...) -> None: ...


class UnitsBehind:
    """The programs behind one port. The `front` one's keeps it: its faults strike the port, and its record has what
    concerns no unit. A request for a unit that nobody has is answered as the front one answers it."""

    def __init__(self, front: Plc) -> None:
        self.front, self.clock = front, front.clock
        self._by_unit = {front.registers.unit: front}
        self._away: set[int] = set()

    @property
    def connections(self) -> int:
        """The clients of the port."""
        return self.front.connections

    @connections.setter
    def connections(self, count: int) -> None:
        self.front.connections = count

    def add(self, plc: Plc) -> bool:
        """Put one more program behind the port; False if its unit is taken."""
        return self._by_unit.setdefault(plc.registers.unit, plc) is plc

    def listen(self, unit: int, *, listens: bool) -> None:
        """Whether a unit hears anything: what refuses connections to a machine with a port is silence behind one."""
        (self._away.discard if listens else self._away.add)(unit)

    def exchange(self, request: ModbusRequest, now: float) -> ModbusReply | None:
        """The reply of the unit that is asked."""
        if request.unit in self._away:
            return None
        return self._by_unit.get(request.unit, self.front).exchange(request, now)

    def event(self, what: str, now: float, detail: Mapping[str, object] | None = None) -> None:
        """What concerns the port and no unit."""
        self.front.event(what, now, detail or {})


class BehindFace:
    """The face of a machine behind another one's port; `ready` says where that one serves."""

    name = "tcp"

    def __init__(self, plc: Plc, units: UnitsBehind, place: Callable[[], Mapping[str, object]]) -> None:
        self._unit, self._units, self.ready = plc.registers.unit, units, place

    async def open(self) -> None:
        """The port is the other machine's."""

    async def apply(self, line: CycleFaults) -> None:
        """The unit is silent while the machine must not be reachable."""
        self._units.listen(self._unit, listens=line.listen)

    async def close(self) -> None:
        """It is silent from now on."""
        self._units.listen(self._unit, listens=False)
