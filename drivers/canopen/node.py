"""One node on one open bus: heard, brought up, watched; its PDOs as they last came, and what keeps them from use."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from drivers.can.bus import AttendedSilence, pause_between_looks
from drivers.canopen.bringup import ENTER_PRE_OPERATIONAL, BringUp, Brought
from drivers.canopen.channel import DEVICE_TYPE, SdoChannel
from drivers.canopen.eds import DataSheet
from drivers.canopen.emergency import Emergencies
from drivers.canopen.options import Options
from drivers.canopen.pdo import Mapped, PdoMapping
from drivers.canopen.place import ObjectPlace
from drivers.canopen.port import StampedFrame
from drivers.errors import DriverError
from drivers.supervision import Supervisor
from drivers.tag import Quality

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
STATES = {BOOT_UP: "booting", STOPPED: "stopped", OPERATIONAL: "operational", PRE_OPERATIONAL: "pre-operational"}
RETRY_S = 0.25
"""Seconds between two attempts at a node that is not there or cannot be brought up."""
ERROR_REGISTER_POLL_S = 1.0
"""Seconds between two looks at the error register while an emergency stands: its end may have been missed."""
SYNC, EMCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x080, 0x080, 0x580, 0x600, 0x700


@dataclass(slots=True)
class ReceivedPdo:
    """A TPDO and its last frame: `time` by the driver's clock, `moment` by the loop's, `fault` why it means nothing.

    `asleep`: the device's program did not run when it was sent, by the life counter in it.
    """

    pdo: PdoMapping
    data: bytes | None = None
    time: float = 0.0
    moment: float = 0.0
    fault: str = ""
    asleep: bool = False

    def value(self, mapped: Mapped) -> bytes | None:
        """An object's bytes in the last frame; None if there is none that can be used."""
        return None if self.data is None or self.fault else mapped.cut(self.data)


@dataclass(slots=True)
class Counts:
    """What the node has sent, by what became of it."""

    pdos: int = 0
    malformed_pdos: int = 0
    heartbeats: int = 0
    malformed_heartbeats: int = 0
    boots: int = 0
    node_losses: int = 0
    starts: int = 0


class RemoteNode:
    """The node of one open bus. `send` puts a frame on it; `heard` is told of each usable or faulty TPDO.

    `drain` gives all frames that have come by now.

    All methods are called in the event loop. `closed` is the reason that the bus was given up, "" while it is open.
    """

    def __init__(
        self,
        send: Callable[[int, bytes], None],
        options: Options,
        sheet: DataSheet | None,
        heard: Callable[["RemoteNode", ReceivedPdo], None],
        *,
        catch_up: Callable[[], None],
        supervisor: Supervisor,
    ) -> None:
        self.options, self.send, self._on_pdo, self._catch_up = options, send, heard, catch_up
        self._supervisor = supervisor
        self.sdo = SdoChannel(lambda data: send(SDO_REQUEST + options.node, data), options.timeout)
        self.emergencies = Emergencies(options.emcy_ignore)
        self.counts = Counts()
        self.running = asyncio.Event()
        self.brought: Brought | None = None
        self.sheet = sheet
        self.state: int | None = None
        self.life = options.new_life()
        self.reason = f"node {options.node} has not been heard yet"
        self._tpdos: dict[int, ReceivedPdo] = {}
        self._carriers: dict[ObjectPlace, list[tuple[ReceivedPdo, Mapped]]] = {}
        self._beat: float | None = None
        self._news, self._pdo_news = asyncio.Event(), asyncio.Event()
        self._rebooted = False
        self._loop = asyncio.get_running_loop()
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin to look for the node."""
        self._tasks = [self._supervisor.task("node", self._live)]

    def close(self, reason: str) -> None:
        """Give the node up: the bus is gone."""
        self.sdo.close(reason)
        self._lose(reason)
        for task in self._tasks:
            task.cancel()

    # ------------------------------------------------------------ frames

    def take(self, frame: StampedFrame) -> None:
        """A frame of the bus; what is not this node's is nobody's business here."""
        node = self.options.node
        tpdo = self._tpdos.get(frame.id)
        if tpdo is not None:
            self._take_pdo(tpdo, frame)
        elif frame.id == SDO_ANSWER + node:
            self.sdo.receive(frame.data)
        elif frame.id == HEARTBEAT + node:
            self._take_heartbeat(frame)
        elif frame.id == EMCY + node:
            self.emergencies.take(frame.data)

    def _take_pdo(self, heard: ReceivedPdo, frame: StampedFrame) -> None:
        pdo, length, since = heard.pdo, len(frame.data), (frame.time, frame.moment)
        self.counts.pdos += 1
        if length != pdo.length:
            self.counts.malformed_pdos += 1
            heard.fault = f"{pdo.name} came with {length} bytes, and {pdo.length} are mapped"
        else:
            count = self._count(pdo, frame)
            if self.life is not None and count is not None:
                if not self.life.own(count, frame.time, frame.moment):
                    return  # another node sends under this identifier: nothing of it is used
                # A repeated count brings nothing newer than the first frame with it: the value's age begins there.
                since = self.life.since
            heard.data, heard.fault, heard.asleep = frame.data, "", count == 0
        heard.time, heard.moment = since
        self._on_pdo(self, heard)
        self._pdo_news.set()

    def _count(self, pdo: PdoMapping, frame: StampedFrame) -> int | None:
        """The life counter in a frame; None where there is none."""
        place = self.life.place if self.life is not None else None
        counter = next((mapped for mapped in pdo.objects if mapped.place == place), None)
        return None if counter is None else int.from_bytes(counter.cut(frame.data), "little")

    def _take_heartbeat(self, frame: StampedFrame) -> None:
        state = frame.data[0] & 0x7F if len(frame.data) == 1 else -1
        if state not in STATES:
            self.counts.malformed_heartbeats += 1
            return
        self.counts.heartbeats += 1
        if state == BOOT_UP:
            self.counts.boots += 1
            # After boot-up a node is pre-operational without saying so (CiA 301, 7.3.2.2.1), and its parameters are
            # those of power-on again: what it was configured to counts no more.
            self._rebooted, state = True, PRE_OPERATIONAL
            self._forget()
        self._beat, self.state = frame.moment, state
        self._news.set()

    async def next_pdo(self) -> None:
        """Wait for the next TPDO, whichever."""
        self._pdo_news.clear()
        await self._pdo_news.wait()

    # ------------------------------------------------------------ what can be used

    def value(self, place: ObjectPlace) -> bytes | None:
        """An object's bytes in the last TPDO that carries it; None where none does, or none that can be used."""
        carrier = self.carrier(place)
        return None if carrier is None else carrier[0].value(carrier[1])

    def carrier(self, place: ObjectPlace) -> tuple[ReceivedPdo, Mapped] | None:
        """The TPDO that has brought the object last and whole, and where it lies in it; None if no TPDO carries it."""
        carriers = self._carriers.get(place)
        return max(carriers, key=lambda carrier: (not carrier[0].fault, carrier[0].moment)) if carriers else None

    def hindrance(self, moment: float) -> tuple[Quality, str] | None:
        """Why nothing of the node can be used at this moment (by the loop's clock); None if nothing stands against."""
        node = self.options.node
        if not self.running.is_set() or self.brought is None:
            return Quality.NO_COMMUNICATION, self.reason
        if self._rebooted:
            return Quality.NO_COMMUNICATION, f"node {node} has restarted"
        limit = self.brought.heartbeat_timeout
        if limit and self._beat is not None and moment - self._beat > limit:
            return Quality.TIMEOUT, f"node {node}: no heartbeat for {moment - self._beat:.2f} s (limit {limit:g} s)"
        if self.state not in (None, OPERATIONAL):
            return Quality.OUT_OF_SERVICE, f"node {node} is {STATES[self.state or BOOT_UP]}"
        return None

    def lateness(self, heard: ReceivedPdo, moment: float) -> str:
        """Why the last frame of a TPDO is too old or faulty at this moment; empty if it may be used."""
        options = self.options
        limit = heard.pdo.timeout(options.pdo_timeout, options.sync_period)
        silent = moment - heard.moment
        what = "is silent" if self.life is None else "has brought no new count"
        return f"{heard.pdo.name} {what} for {silent:.2f} s (limit {limit:g} s)" if limit and silent > limit else ""

    # ------------------------------------------------------------ the node's life

    async def _live(self) -> None:
        """Wait for the node, bring it up, watch it; from the beginning whenever it goes or restarts."""
        while True:
            await self._present()
            if self.running.is_set():
                self.reason = f"node {self.options.node} has restarted or is not operational, and is brought up"
                self.running.clear()
            else:
                what = "answers" if self.state is None else f"is {STATES[self.state]}"
                self.reason = f"node {self.options.node} {what}, and is not up yet"
            self._rebooted = False
            try:
                await self._bring_up()
            except DriverError as error:
                self._lose(f"node {self.options.node} cannot be brought up: {error}")
                await self._pause(RETRY_S)
            else:
                await self._watch()

    async def _present(self) -> None:
        """Return when the node has shown that it is there: by a heartbeat, or by an answer if it may be asked."""
        while not self._alive():
            self._news.clear()
            if self.options.listen_only:
                await self._pause(RETRY_S)
                continue
            with suppress(DriverError):
                await self.sdo.read(DEVICE_TYPE, 4)
                return
            await self._pause(RETRY_S)

    def _alive(self) -> bool:
        return self._beat is not None and self._loop.time() - self._beat <= (self._heartbeat_limit() or RETRY_S)

    def _heartbeat_limit(self) -> float:
        return self.brought.heartbeat_timeout if self.brought else self.options.heartbeat_timeout

    async def _bring_up(self) -> None:
        if self.options.configure and self.state == STOPPED:
            self._command(ENTER_PRE_OPERATIONAL)  # a stopped node answers nothing
        bringing = BringUp(self.sdo, self._command, self.options, self.sheet, lambda: self.state)
        brought = await bringing.all()
        self.sheet, self.brought = brought.sheet, brought
        now = self._loop.time()
        enabled = [pdo for pdo in brought.tpdos if pdo.enabled and pdo.objects]
        self._tpdos = {pdo.cob_id: ReceivedPdo(pdo, moment=now) for pdo in enabled}
        self._carriers = {}
        for heard in self._tpdos.values():
            for mapped in heard.pdo.objects:
                self._carriers.setdefault(mapped.place, []).append((heard, mapped))
        if brought.error is not None:
            self.emergencies.stands(*brought.error)
        if self.life is not None and brought.life is not None:
            self.life.anchor(brought.life, self._loop.time())
        if brought.heartbeat_timeout and self._beat is None:
            self._beat = self._loop.time()
        await bringing.start()
        self.counts.starts += 1
        self.reason = ""
        self.running.set()

    async def _watch(self) -> None:
        """Return when the node must be brought up anew: gone, restarted, or no longer operational and ours to start."""
        beside = [self._supervisor.task("SYNC", self._sync)] if self._produces_sync() else []
        if not self.options.listen_only:
            beside.append(self._supervisor.task("error register", self._confirm_errors))
        attended = AttendedSilence(self._loop.time())
        try:
            while True:
                self._news.clear()
                limit, now = self._heartbeat_limit(), self._loop.time()
                pause = pause_between_looks(limit, RETRY_S) if limit else RETRY_S
                if attended.look(self._silence(now), now, pause) >= limit > 0.0:
                    self._catch_up()
                if self._rebooted or (self.options.configure and self.state not in (None, OPERATIONAL)):
                    return
                silent = self._silence(self._loop.time())
                if min(attended.seconds, silent) >= limit > 0.0:
                    self.counts.node_losses += 1
                    self._lose(f"node {self.options.node} is gone: no heartbeat for {silent:.2f} s")
                    return
                await self._pause(min(pause, limit - attended.seconds + 0.001) if limit else pause)
        finally:
            for task in beside:
                task.cancel()

    def _silence(self, moment: float) -> float:
        """Seconds since the node's last heartbeat; 0 where none is waited for."""
        return 0.0 if self._beat is None else moment - self._beat

    async def _pause(self, seconds: float) -> None:
        """Until the next heartbeat, or so many seconds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._news.wait()

    def _produces_sync(self) -> bool:
        return self.options.configure and self.options.sync_period > 0.0

    async def _sync(self) -> None:
        due = self._loop.time()
        while True:
            with suppress(DriverError):
                self.send(SYNC, b"")
            due = max(due + self.options.sync_period, self._loop.time())
            await asyncio.sleep(due - self._loop.time())

    async def _confirm_errors(self) -> None:
        """While an emergency stands, ask for the error register: 0 says that the end of it was missed."""
        while True:
            await asyncio.sleep(ERROR_REGISTER_POLL_S)
            if self.emergencies.active:
                with suppress(DriverError):
                    if not any(await self.sdo.read(ObjectPlace(0x1001), 1)):
                        self.emergencies.active.clear()

    def _command(self, code: int) -> None:
        """An NMT command to this node."""
        self.send(0x000, bytes([code, self.options.node]))

    def _lose(self, reason: str) -> None:
        self.reason, self.state, self._beat = reason, None, None
        self.running.clear()
        self._forget()

    def _forget(self) -> None:
        """Nothing that the node has said counts any more."""
        self.emergencies.active.clear()
        if self.life is not None:
            self.life.forget()
        for heard in self._tpdos.values():
            heard.data, heard.fault, heard.moment = None, "", self._loop.time()
