"""The one owner of a Modbus connection: the units behind it get turns, and a silent one holds nobody up.

A driver whose device is alone on its connection has one of these for itself; several drivers with the same host and
port, or the same serial line, have one together (`drivers.connections`), each for its own unit.

A unit that gives no valid reply as often, or for as long, as would end a connection, while another one answers, is
taken to be silent: it is asked one question after `silent_first` seconds, then after twice as long each time up to
`silent_cap`, and not at all in between; all silent ones together once in `silent_first` seconds. Its failures are its
own as long as others answer in between. All other failures are the connection's (`drivers.link`), which is made anew.

What waiting for one unit costs the others is bounded (record 0116): the first question without an answer has its whole
deadline, the next ones only what the unit's own replies take; and what a unit wastes beyond one reading's deadlines it
pays back out of its share of the time, resting meanwhile.
"""

import asyncio
import random
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

from pymodbus.pdu import ModbusPDU

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import (
    NO_WAY_TO_UNIT,
    DeviceException,
    DriverError,
    LinkDown,
    LinkFault,
    NotAsked,
    ReplyMismatch,
    ReplyTimeout,
)
from drivers.link import Backoff, DeadPeer, Link
from drivers.modbus.replies import TransactionIds
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.transport import AnyWire, explain, make_transport
from drivers.modbus.turns import RETRY_AT_ONCE_S, ReplyTimes, Stall, Suspect, Turns, UnitHealth
from drivers.modbus.verify import WRITES
from drivers.modbus.wire import WireReply
from drivers.supervision import Supervisor

_UNDER_A_QUESTION = frozenset({LinkFault.CLOSED, LinkFault.FOREIGN, LinkFault.CUT})
"""How a connection ends under a question that is to blame for it: the peer hangs up, what comes is not Modbus, or only
a part of the reply."""
_MAX_HANG_UP_ANSWERS = 8
"""A connection that ends after no more of them was ended by a habit of the device."""
_MAX_OPEN_MANUAL_QUESTIONS = 8
"""Questions without an answer on a connection: somebody looks on, and ends it soon."""
_OF_THE_CONNECTION = (
    "transport", "certificates", "tls_name", "baud", "parity", "stopbits", "echo", "longest_reply", "connect_timeout",
    "one_client", "transaction_id", "answers_as", "pause_after_connect", "close_between_scans", "bytesize",
    "backoff_first", "backoff_cap", "max_failures", "max_silence",
)  # fmt: skip


class SharedLink:
    """One connection, kept up by a Link while any of its units is open. `join` gives a unit its line.

    `alone`: it will only ever have one unit.
    """

    def __init__(
        self, settings: ModbusSettings, *, clock: Clock, seed: int, alone: bool, rng: random.Random | None = None
    ) -> None:
        """Raises DriverError for certificates that cannot be used."""
        self._clock, self._seed, self._alone = clock, seed, alone
        # One for all connections to the place, whatever kind they are.
        self._ids = TransactionIds(rng or random.SystemRandom())
        self.supervisor = Supervisor()
        self._adopt(settings)
        self.health: dict[int, UnitHealth] = {}
        # Questions to each unit, whoever asked, that had no answer of its own; kept while the unit is in no use, too.
        self.unanswered = Counter[int]()
        self.renewing = False
        self._lines: list[UnitLine] = []
        self._turns = Turns(settings.outstanding)
        self._made = asyncio.Event()
        self._last_exchange = float("-inf")
        self._times = ReplyTimes()
        self._next_probe = self._answered_at = 0.0
        self._stall: Stall | None = None
        self._suspect: Suspect | None = None
        self._foreign = 0
        # The connection on which something has been asked.
        self._greeted: AnyWire | None = None
        self._ask_from = 0.0
        # Questions that wait for their answers, answers on this connection, and connections in a row that the peer has
        # ended after a few of them.
        self._under_way = self._answers = self._hang_ups = 0

    def _adopt(self, settings: ModbusSettings) -> None:
        """Be a connection of this kind. Raises DriverError."""
        self.settings = settings
        self.transport = make_transport(settings, self._clock, self._ids, None if self._alone else self._late)
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
        """Send one request once when it is the unit's turn, and note how it went. `again`: see `Wire.ask`.

        A write without an answer ends the connection that it was sent on, so that it cannot be delivered later.
        """
        settings = line.settings
        if (health := self.health.get(settings.unit)) is None:
            health = self.health[settings.unit] = UnitHealth()
        self._raise_if_resting(settings, health, urgent=urgent)
        async with self._turns.turn(settings.unit, urgent=urgent, probe=self._fails_alone(health)) as turn:
            if turn.waited:
                # Another driver of the same unit may have asked it meanwhile.
                self._raise_if_resting(settings, health, urgent=urgent)
            if (
                self.ends_connections
                and self._answers
                and request.function_code in WRITES
                and self.link.connection is not None
            ):
                # It may be hanging up at this moment, and nothing is sent twice: a write has a connection of its own.
                self.end_connection(self.link.connection, "the device ends its connections after a few answers")
                await self.link.renew()
            wire, started = self.link.connection, _now()
            # As a rule it is ready: what `_ready_to_ask` would come to.
            if wire is None or wire is not self._greeted or settings.pause_ms or self._ask_from > started:
                wire = await self._ready_to_ask(settings)
                started = _now()
            if not again:
                health.asked_at = started
            patience = self._patience(settings, health, urgent=urgent)
            most_open = 1 if self.link.suspect else 2
            line.counts["requests"] += 1
            self._under_way += 1
            try:
                reply = await wire.ask(request, patience, before_sending, again=again, most_open=most_open)
            except asyncio.CancelledError:
                self.unanswered[settings.unit] += 1
                raise
            except (ReplyTimeout, ReplyMismatch) as error:
                self.unanswered[settings.unit] += 1
                line.counts["timeouts" if isinstance(error, ReplyTimeout) else "mismatches"] += 1
                waited = _now() - started
                if wire.fault is LinkFault.CUT:
                    self._suspect = self._make_suspect(settings.unit, stalled=False)
                shadowed = isinstance(error, ReplyTimeout) and self._joins_stall(settings.unit, started)
                if shadowed or not self._is_its_own(settings, health, started):
                    with self._note_end(wire):
                        self.link.failed(wire, waited, str(error))
                if request.function_code in WRITES and not isinstance(error, NotAsked):
                    self.end_connection(wire, "a write was not answered: what is left of it must not arrive later")
                raise
            except DeviceException as error:
                line.counts["exceptions"] += 1
                self.unanswered[settings.unit] += error.code in NO_WAY_TO_UNIT
                self.link.note_answer(wire)
                if error.code in NO_WAY_TO_UNIT and len(self.health) > 1:
                    self._note_life(settings)
                    self._is_its_own(settings, health, started)
                else:
                    self._note_answer(settings, health)
                raise explain(error, wire) from None
            except LinkDown as error:
                # What ends the connection under its question again and again is the unit's own, as silence would be.
                if wire.fault in _UNDER_A_QUESTION:
                    self._is_its_own(settings, health, started)
                    self._suspect = self._make_suspect(settings.unit, stalled=False)
                self.end_connection(wire, str(error))
                raise self._explain_end(error, wire) from None
            finally:
                self._under_way -= 1
                self._last_exchange = _now()
            self._times.take(self._last_exchange - started)
            health.times.take(self._last_exchange - health.asked_at)
            self.link.note_answer(wire)
            self._note_answer(settings, health)
            return reply

    async def by_hand(self, line: "UnitLine", request: ModbusPDU, deadline: float, *, again: bool) -> WireReply:
        """Send one request once, of any unit, for somebody who looks on; its silence is held against nobody.

        A connection that has ended is made anew before. `again`: see `Wire.ask`.
        """
        async with self._turns.turn(request.dev_id, urgent=True, probe=False):
            if self.link.connection is None:
                await self.link.renew()
            wire = await self._ready_to_ask(line.settings)
            line.counts["requests"] += 1
            try:
                reply = await wire.ask(request, deadline, again=again, most_open=_MAX_OPEN_MANUAL_QUESTIONS)
            except asyncio.CancelledError:
                self.unanswered[request.dev_id] += 1
                raise
            except DeviceException as error:
                line.counts["exceptions"] += 1
                self.unanswered[request.dev_id] += error.code in NO_WAY_TO_UNIT
                self.link.note_answer(wire)
                self._answered_at = _now()
                raise explain(error, wire) from None
            except (ReplyTimeout, ReplyMismatch) as error:
                self.unanswered[request.dev_id] += 1
                line.counts["timeouts" if isinstance(error, ReplyTimeout) else "mismatches"] += 1
                raise
            except LinkDown as error:
                self.end_connection(wire, str(error))
                raise self._explain_end(error, wire) from None
            finally:
                self._last_exchange = _now()
            self.link.note_answer(wire)
            self._answered_at = _now()
            return reply

    def _explain_end(self, error: LinkDown, wire: AnyWire) -> LinkDown:
        """The end of a connection; what it may mean where nothing has been answered on any."""
        if self._answered_at or wire.fault is not LinkFault.CLOSED:
            return error
        return LinkDown(
            f"{error} before it answered anything: it may be busy with another client (some devices serve one at a "
            "time), or it does not accept this machine's address",
            fault=wire.fault,
        )

    async def _ready_to_ask(self, settings: ModbusSettings) -> AnyWire:
        """The connection, as long after its making and after the last request as the device needs. Raises LinkDown."""
        if settings.pause_ms and (rest := self._last_exchange + settings.pause_ms / 1000 - _now()) > 0.0:
            await asyncio.sleep(rest)
        wire = self.link.connection or await self._wire()
        if wire is not self._greeted:
            self._greeted = wire
            pause = max(self.settings.pause_after_connect, self.link.hesitation)
            self.link.hesitate(pause)
            self._ask_from = _now() + pause
        # Every turn waits for it: the one that begins the pause may be given up in it.
        if (rest := self._ask_from - _now()) > 0.0:
            await asyncio.sleep(rest)
            if self.link.connection is not wire:
                raise LinkDown(f"not connected: {self.link.reason}")
        return wire

    async def ready(self) -> None:
        """Have a connection again after `rest`. What comes of it the next exchange tells."""
        if self.link.connection is None:
            await self.link.renew()

    def rest(self) -> None:
        """Leave the connection to others until the next exchange, unless a unit is being asked."""
        if not self._turns.busy:
            self.link.rest()

    @property
    def _share(self) -> float:
        """The part of the connection's time that is each unit's."""
        return 1.0 / max(1, len(self.health))

    def _raise_if_resting(self, settings: ModbusSettings, health: UnitHealth, *, urgent: bool) -> None:
        """Raise LinkDown for a unit that is not to be asked now; to a silent one nothing is written."""
        unit = settings.unit
        if self.suspects(unit):
            raise LinkDown(
                f"the last connection to {self.settings.place} ended with a question to unit {unit}; it is asked again "
                "after another unit",
                fault=LinkFault.SILENT,
            )
        several = len(self.health) > 1
        if health.silent_since is None and not several:
            return
        rest, now = 0.0, _now()
        if several and not urgent and self._answered_at > health.failing_since:
            rest = health.wasted.rest(now, self._share, settings.longest_read)
        if health.silent_since is None:
            if rest > 0.0:
                raise LinkDown(
                    f"unit {unit} has held up the others on {self.settings.place} for {health.wasted.level:.2f} s; "
                    f"asked again in {rest:.1f} s",
                    fault=LinkFault.SILENT,
                )
            return
        left = max(rest, 0.0 if health.retry_at == RETRY_AT_ONCE_S else max(health.retry_at, self._next_probe) - now)
        if left <= 0 and not urgent:
            return
        wait = f"asked again in {left:.1f} s" if left > 0 else "asked again with the next reading"
        raise LinkDown(
            f"unit {unit} is silent for {now - health.silent_since:.1f} s while others on {self.settings.place} "
            f"answer; {wait}",
            fault=LinkFault.SILENT,
        )

    def _fails_alone(self, health: UnitHealth) -> bool:
        """True for a unit whose last question failed while others answered."""
        return health.silent or (health.failures > 0 and self._answered_at > health.failing_since)

    def _patience(self, settings: ModbusSettings, health: UnitHealth, *, urgent: bool) -> float:
        """The deadline of a question: the unit's own, of a reading less where it fails while others answer."""
        if not urgent and self._fails_alone(health):
            return health.patience(settings.timeout, settings.longest_read, self._times.usual)
        return self.link.patience(settings.timeout)

    def _note_answer(self, settings: ModbusSettings, health: UnitHealth) -> None:
        if self._answered_at > health.failing_since and health.wasted.connection == self.link.connects:
            self._charge(settings, health)
        health.wasted.waited = 0.0
        self._note_life(settings)
        health.note_answer(self.link.connects)

    def _note_life(self, settings: ModbusSettings) -> None:
        """Something has been answered: the connection lives."""
        self._answered_at, self._stall = _now(), None
        self._answers += 1
        if self._answers > _MAX_HANG_UP_ANSWERS:
            self._hang_ups = 0
        if self._suspect is not None and self._suspect.stalled and self._suspect.unit != settings.unit:
            # The others answer on the new connection. Whoever was asked when the last one stalled may have been the
            # cause: it is asked again as a silent one is.
            self._avoid(self._suspect.unit)
        self._suspect = None

    def _is_its_own(self, settings: ModbusSettings, health: UnitHealth, asked_at: float) -> bool:
        """Note that the unit has not answered; True if that is the silent unit's own failure, not the connection's."""
        now = _now()
        health.failed(asked_at, now - asked_at)
        health.wasted.wait(now - asked_at, self.link.connects)
        others_answer = self._answered_at > health.failing_since
        if others_answer:
            self._charge(settings, health)
        given_up = health.failures >= settings.max_failures or health.waited >= settings.max_silence
        if health.silent or (given_up and others_answer):
            self._avoid(settings.unit)
        return health.silent and others_answer

    def _avoid(self, unit: int) -> None:
        """Take the unit to be silent, and ask it rarely."""
        if (health := self.health.get(unit)) is not None:
            now = _now()
            health.avoid(now, self.settings.silent_first, self.settings.silent_cap)
            # One short wait in this time for all silent units together, however many they are.
            self._next_probe = now + self.settings.silent_first

    def _charge(self, settings: ModbusSettings, health: UnitHealth, seconds: float = 0.0) -> None:
        share = self._share
        health.wasted.fill(_now(), share, settings.longest_read + share * settings.silent_cap, seconds)

    def _joins_stall(self, unit: int, started: float) -> bool:
        """Whether a question has had no answer because an earlier one, to another unit, has stopped the connection."""
        if self._answered_at > started:
            return False
        if self._stall is None:
            self._stall = Stall(unit, _now())
        if self._stall.unit == unit:
            return False
        self._stall.others = True
        return True

    def _late(self, unit: int, there: bool) -> None:
        """A reply has come too late for its question; `there`: the unit itself has given it, and no gateway for it."""
        health, stall = self.health.get(unit), self._stall
        self._stall = None
        if health is None:
            return
        now = _now()
        if stall is not None and stall.unit == unit and (stall.others or self._turns.busy):
            # The others were kept waiting for longer than anybody waited for this unit.
            self._charge(self.settings, health, now - stall.since)
        if there:
            health.times.take(now - health.asked_at)
            health.note_late_answer()

    # ------------------------------------------------------------ the connection

    def end_connection(self, wire: AnyWire, reason: str) -> None:
        """End this connection; the next one is waited for, so that it costs the other units nothing but that."""
        with self._note_end(wire):
            self.link.lost(wire, reason, wire.fault)

    @contextmanager
    def _note_end(self, wire: AnyWire) -> Iterator[None]:
        """If this ends the connection: the next is waited for, and the unit that stalled it is asked after another."""
        present, proven = wire is self.link.connection, self.link.proven
        yield
        if not present or self.link.connection is not None:
            return
        if proven and wire.fault is LinkFault.CLOSED and self._answers <= _MAX_HANG_UP_ANSWERS:
            self._hang_ups += 1
        # A device that hangs up between two questions takes the next call, and so does one that has a habit of it.
        hangs_up = wire.fault is LinkFault.CLOSED and (not self._under_way or self.ends_connections)
        self.renewing = proven and (len(self.health) > 1 or hangs_up)
        self._made.clear()
        if self._stall is not None and self._stall.others:
            self._suspect = self._make_suspect(self._stall.unit, stalled=True)
        self._stall = None

    @property
    def ends_connections(self) -> bool:
        """True for a peer that has a habit of ending connections after a few answers."""
        return self._hang_ups > 1

    def suspects(self, unit: int) -> bool:
        """True for the unit with whose question the last connection ended, until another one has been asked."""
        return self._suspect is not None and self._suspect.unit == unit and _now() < self._suspect.until

    def _make_suspect(self, unit: int, *, stalled: bool) -> Suspect | None:
        patience = self.settings.connect_timeout + self.settings.timeout
        return Suspect(unit, _now() + patience, stalled) if len(self.health) > 1 else None

    async def _wire(self) -> AnyWire:
        if self.link.connection is None and self.renewing:
            with suppress(TimeoutError):
                async with asyncio.timeout(self.settings.connect_timeout):
                    await self._made.wait()
            self.renewing = False
        if self.link.connection is None and self.settings.close_between_scans:
            await self.link.renew()
        wire = self.link.connection
        if wire is None:
            one = self.settings.one_client
            hint = "; this device serves one client only: is another one connected?" if one else ""
            raise LinkDown(f"not connected: {self.link.reason}{hint}", fault=self.link.fault)
        return wire

    async def _connect(self) -> AnyWire:
        wire = self.transport.wire(lambda reason: self.end_connection(wire, reason))
        await wire.connect()
        self.renewing, self._answers = False, 0
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
            written = request.function_code in WRITES
            next_call = self._shared.renewing or self._shared.ends_connections
            if written or not next_call or self._shared.suspects(self.settings.unit):
                raise
            # Another unit has ended the connection under a read, by a write or by what came, or the device has hung up:
            # it is asked again.
            return await self._shared.exchange(self, request, before_sending, again=False, urgent=urgent)

    async def by_hand(self, request: ModbusPDU, deadline: float, *, again: bool = False) -> WireReply:
        """Send one request once, of any unit (see `SharedLink.by_hand`)."""
        return await self._shared.by_hand(self, request, deadline, again=again)

    async def ready(self) -> None:
        """Have a connection again after `rest`."""
        await self._shared.ready()

    def rest(self) -> None:
        """Leave the connection to others until the next exchange."""
        self._shared.rest()

    @property
    def proof(self) -> tuple[int, int]:
        """It changes with each connection, and with each question to the unit, whoever's, that has had no answer."""
        return self._shared.link.connects, self._shared.unanswered[self.settings.unit]

    @property
    def ends_connections(self) -> bool:
        """Whether the device is known to end the connection after its answers."""
        return self._shared.ends_connections

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
