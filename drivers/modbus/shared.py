"""The one owner of a Modbus connection: the units behind it get turns, and a silent one holds nobody up.

A driver whose device is alone on its connection has one of these for itself; several drivers with the same host and
port, or the same serial line, have one together (`drivers.connections`), each for its own unit.

A unit that gives no valid reply as often, or for as long, as would end a connection, while another one answers, is
taken to be silent: it is asked one question after `silent_first` seconds, then after twice as long each time up to
`silent_cap`, and not at all in between; all silent ones together once in `silent_first` seconds. Its failures are its
own as long as others answer in between. All other failures are the connection's (`drivers.link`), which is made anew.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress

from pymodbus.pdu import ModbusPDU

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import DeviceException, DriverError, LinkDown, LinkFault, ReplyMismatch, ReplyTimeout
from drivers.link import Backoff, DeadPeer, Link
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.transport import AnyWire, make_transport
from drivers.modbus.turns import AT_ONCE, ReplyTimes, Turns, UnitHealth
from drivers.modbus.wire import WireReply
from drivers.supervision import Supervisor

_NO_WAY_TO_UNIT = frozenset({10, 11})
"""What a gateway answers for a unit that does not (MODBUS Application Protocol V1.1b3, 7)."""
_OF_THE_CONNECTION = (
    "transport", "certificates", "tls_name", "baud", "parity", "stopbits", "echo", "longest_reply", "connect_timeout",
    "one_client", "backoff_first", "backoff_cap", "max_failures", "max_silence",
)  # fmt: skip
_SHORT_PROBE_S = 0.05
"""A silent unit is waited for so long at least."""


class SharedLink:
    """One connection, kept up by a Link while any of its units is open. `join` gives a unit its line.

    `alone`: it will only ever have one unit.
    """

    def __init__(self, settings: ModbusSettings, *, clock: Clock, seed: int, alone: bool) -> None:
        """Raises DriverError for certificates that cannot be used."""
        self._clock, self._seed, self._alone = clock, seed, alone
        self.supervisor = Supervisor()
        self._adopt(settings)
        self.health: dict[int, UnitHealth] = {}
        self.renewing = False
        self._lines: list[UnitLine] = []
        self._turns = Turns(settings.outstanding)
        self._made = asyncio.Event()
        self._last_exchange = float("-inf")
        self._times = ReplyTimes()
        self._next_probe = self._answered_at = 0.0
        self._foreign = 0

    def _adopt(self, settings: ModbusSettings) -> None:
        """Be a connection of this kind. Raises DriverError."""
        self.settings = settings
        self.transport = make_transport(settings, self._clock, None if self._alone else self._late)
        self.link: Link[AnyWire] = Link(
            self._connect,
            self._disconnect,
            connect_deadline=settings.connect_timeout,
            backoff=Backoff(settings.backoff_first, settings.backoff_cap),
            dead_peer=DeadPeer(settings.max_failures, settings.max_silence),
            seed=self._seed,
            supervisor=self.supervisor,
        )

    # ------------------------------------------------------------ its units

    def join(self, settings: ModbusSettings) -> "UnitLine":
        """The line of one more unit, which takes part once it is opened.

        Raises DriverError where it means another kind of connection than the units that are there.
        """
        if not self._lines and settings is not self.settings:
            self._adopt(settings)  # nobody uses it: it may be another kind than it was
        for key in _OF_THE_CONNECTION if self._lines else ():
            ours, theirs = getattr(settings, key), getattr(self.settings, key)
            if ours != theirs:
                raise DriverError(
                    f"{key} is {ours!r} for unit {settings.unit} at {settings.place} and {theirs!r} for unit "
                    f"{self._lines[0].settings.unit} on the same connection; give both the same"
                )
        line = UnitLine(self, settings)
        self.enter(line)
        return line

    def enter(self, line: "UnitLine") -> None:
        """A line is (again) one of those in use."""
        if line not in self._lines:
            self._lines.append(line)
            self.health.setdefault(line.settings.unit, UnitHealth())
            self._turns.outstanding = min(other.settings.outstanding for other in self._lines)

    async def leave(self, line: "UnitLine") -> None:
        """A line is in use no more; the last one closes the connection."""
        if line in self._lines:
            self._lines.remove(line)
        unit = line.settings.unit
        if all(other.settings.unit != unit for other in self._lines):
            self.health.pop(unit, None)
        if not self._lines:
            await self.link.close()

    @property
    def foreign(self) -> int:
        """Replies that answered nothing, on all connections so far."""
        wire = self.link.connection
        return self._foreign + (wire.foreign if wire else 0)

    # ------------------------------------------------------------ one exchange

    async def exchange(
        self, line: "UnitLine", request: ModbusPDU, before_sending: BeforeSending, *, again: bool, urgent: bool
    ) -> WireReply:
        """Send one request once when it is the unit's turn, and note how it went. `again`: see `Wire.ask`."""
        settings = line.settings
        health = self.health.setdefault(settings.unit, UnitHealth())
        self._spare(settings.unit, health, urgent=urgent)
        async with self._turns.turn(settings.unit, urgent=urgent, probe=health.silent):
            # Another driver of the same unit may have asked it while this one waited.
            self._spare(settings.unit, health, urgent=urgent)
            if (rest := self._last_exchange + settings.limits.pause - _now()) > 0.0:
                await asyncio.sleep(rest)
            wire = await self._wire()
            probe, started = health.silent, _now()
            patience = (
                health.probe_patience(settings.timeout, max(_SHORT_PROBE_S, self._times.usual))
                if probe
                else self.link.patience(settings.timeout)
            )
            most_open = 1 if self.link.suspect else 2
            line.counts["requests"] += 1
            try:
                reply = await wire.ask(request, patience, before_sending, again=again, most_open=most_open)
            except (ReplyTimeout, ReplyMismatch) as error:
                line.counts["timeouts" if isinstance(error, ReplyTimeout) else "mismatches"] += 1
                waited = _now() - started
                if not self._is_its_own(settings, health, started):
                    self.link.failed(wire, waited, str(error))
                raise
            except DeviceException as error:
                line.counts["exceptions"] += 1
                self.link.answered(wire)
                if error.code in _NO_WAY_TO_UNIT and len(self.health) > 1:
                    self._answered_at = _now()
                    self._is_its_own(settings, health, started)
                else:
                    self._note_answer(health)
                raise self.transport.explained(error) from None
            except LinkDown as error:
                self.link.lost(wire, str(error))
                raise
            finally:
                self._last_exchange = _now()
            self._times.take(self._last_exchange - started)
            self.link.answered(wire)
            self._note_answer(health)
            return reply

    def _spare(self, unit: int, health: UnitHealth, *, urgent: bool) -> None:
        """Raise LinkDown for a silent unit that is not to be asked now; to a silent one nothing is written."""
        if health.silent_since is None:
            return
        left = 0.0 if health.retry_at == AT_ONCE else max(health.retry_at, self._next_probe) - _now()
        if left <= 0 and not urgent:
            return
        wait = f"asked again in {left:.1f} s" if left > 0 else "asked again with the next reading"
        raise LinkDown(
            f"unit {unit} is silent for {_now() - health.silent_since:.1f} s while others on {self.settings.place} "
            f"answer; {wait}",
            fault=LinkFault.SILENT,
        )

    def _note_answer(self, health: UnitHealth) -> None:
        self._answered_at = _now()
        health.answered(self.link.connects)

    def _is_its_own(self, settings: ModbusSettings, health: UnitHealth, asked_at: float) -> bool:
        """Note that the unit has not answered; True if that is the silent unit's own failure, not the connection's."""
        now = _now()
        health.failed(asked_at, now - asked_at)
        others_answer = self._answered_at > health.doubted_since
        given_up = health.failures >= settings.max_failures or health.waited >= settings.max_silence
        if health.silent or (given_up and others_answer):
            health.avoid(now, settings.silent_first, settings.silent_cap)
            # One short wait in this time for all silent units together, however many they are.
            self._next_probe = now + settings.silent_first
        return health.silent and others_answer

    def _late(self, unit: int) -> None:
        if unit in self.health:
            self.health[unit].heard()

    # ------------------------------------------------------------ the connection

    def give_up(self, wire: AnyWire, reason: str) -> None:
        """End this connection; the next one is waited for, so that it costs the other units nothing but that."""
        if wire is self.link.connection:
            self.renewing = len(self.health) > 1 and self.link.proven
            self._made.clear()
            self.link.lost(wire, reason)

    async def _wire(self) -> AnyWire:
        if self.link.connection is None and self.renewing:
            with suppress(TimeoutError):
                async with asyncio.timeout(self.settings.connect_timeout):
                    await self._made.wait()
            self.renewing = False
        wire = self.link.connection
        if wire is None:
            one = self.settings.one_client
            hint = "; this device serves one client only: is another one connected?" if one else ""
            raise LinkDown(f"not connected: {self.link.reason}{hint}")
        return wire

    async def _connect(self) -> AnyWire:
        wire = self.transport.wire(lambda reason: self.link.lost(wire, reason))
        await wire.connect()
        self.renewing = False
        self._made.set()
        return wire

    def _disconnect(self, wire: AnyWire) -> None:
        self._foreign += wire.foreign
        wire.abandon()


class UnitLine:
    """One unit's part of a connection, as its driver uses it. Made by `SharedLink.join`."""

    def __init__(self, shared: SharedLink, settings: ModbusSettings) -> None:
        self._shared, self.settings = shared, settings
        self.counts = dict.fromkeys(("requests", "timeouts", "mismatches", "exceptions"), 0)

    async def open(self) -> None:
        """Take part, and connect if nobody has yet. Raises LinkDown if the first attempt fails (it goes on trying)."""
        self._shared.enter(self)
        await self._shared.link.open()

    async def close(self) -> None:
        """Take part no more; the last one closes the connection. Never raises; may be called twice."""
        await self._shared.leave(self)

    @property
    def supervisor(self) -> Supervisor:
        """Keeps the connection going."""
        return self._shared.supervisor

    @property
    def connected(self) -> bool:
        """True from the unit's first valid reply on a connection until that is lost, or the unit taken to be silent."""
        health, link = self._health, self._shared.link
        return link.proven and not health.silent and health.connection == link.connects

    @property
    def connects(self) -> int:
        """How many connections have been made: it tells one from the next."""
        return self._shared.link.connects

    @property
    def connection(self) -> AnyWire | None:
        """The connection over which the unit may be asked at once, if there is one."""
        return None if self._health.silent else self._shared.link.connection

    @property
    def suspect(self) -> bool:
        """True while a question shall be asked once and not again: nothing has been answered, or not by this unit."""
        return self._shared.link.suspect or self._health.silent

    @property
    def _health(self) -> UnitHealth:
        return self._shared.health.get(self.settings.unit) or UnitHealth()

    async def ask(
        self, request: ModbusPDU, before_sending: BeforeSending = anyhow, *, again: bool = False, urgent: bool = False
    ) -> WireReply:
        """Send one request once. `again`: see `Wire.ask`; what is `urgent` has its turn before what is not.

        Raises LinkDown, ReplyTimeout, ReplyMismatch or DeviceException.
        """
        try:
            return await self._shared.exchange(self, request, before_sending, again=again, urgent=urgent)
        except LinkDown:
            if urgent or not self._shared.renewing:
                raise
            # Another unit's write has ended the connection under a read, which may be asked again.
            return await self._shared.exchange(self, request, before_sending, again=False, urgent=urgent)

    def give_up(self, wire: AnyWire, reason: str) -> None:
        """End this connection, if it is still the present one."""
        self._shared.give_up(wire, reason)

    def statistics(self) -> Mapping[str, float]:
        """The unit's counters, and those of the connection that it has a part of."""
        link = self._shared.link.statistics()
        return {
            **self.counts,
            "silent": int(self._health.silent),
            "foreign_replies": self._shared.foreign,
            "reconnects": max(0, link["connects"] - 1),
            **link,
        }

    def cautions(self) -> tuple[str, ...]:
        """What works and should not stay as it is, in sentences."""
        return self._shared.transport.cautions()


def _now() -> float:
    return asyncio.get_running_loop().time()
