"""The CANopen driver: TPDOs as they come, SDO for the rest, one group of RPDOs or SDOs for a write that is verified."""

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import can

from drivers.can.bus import open_bus
from drivers.canopen.asking import SdoAnswer, ask
from drivers.canopen.eds import DataSheet, Where, load_sheet, locate
from drivers.canopen.listeners import PdoListener
from drivers.canopen.node import ReceivedPdo, RemoteNode
from drivers.canopen.options import Options, read_options
from drivers.canopen.pdo import PdoMapping, select_pdos
from drivers.canopen.place import ObjectPlace, from_bytes, object_bytes
from drivers.canopen.port import Port
from drivers.canopen.writing import Writing
from drivers.codec import Reading
from drivers.driver import BeforeSending, Clock, PlanKind, PlanLine, anyhow
from drivers.errors import LinkDown
from drivers.link import Backoff, DeadPeer, Link
from drivers.supervision import Supervisor
from drivers.tag import DType, Quality, Sample, Tag, Value

MIN_BLOCK_UPLOAD_BYTES = 64
"""Bytes of text from which a block transfer is tried first."""
PLACES_KEPT = 4096


@dataclass(frozen=True, slots=True)
class Connection:
    """An open bus and what is known of the node on it."""

    port: Port
    node: RemoteNode


def open_canopen(
    settings: Mapping[str, Any], *, clock: Clock, write_map: Sequence[Tag] = (), seed: int = 0
) -> "CanopenDriver":
    """Make a CANopen driver, not yet opened.

    Settings (times in seconds; docs/canopen.md has more): `interface`, `channel`, `bitrate` of the bus; `node` (1..127)
    and its `eds` (without it the device is asked for its own). `listen_only`: nothing is ever sent. `configure`: the
    driver may write PDO parameters and the heartbeat's time, send NMT commands and SYNC; false: it reads by SDO, and
    writes the write map. `timeout` of one SDO answer and of an acknowledge; `connect_timeout` for the node at `open`;
    `heartbeat_time` and `sync_period` to be set or expected; `heartbeat_timeout` and `pdo_timeout`, when not what the
    device's periods make of them; `tpdo`, changes of the EDS's TPDOs; `life`, a counter in the TPDOs; `acknowledge`,
    objects by which the device says that it has taken others; `emcy_ignore`; `backoff_first` and `backoff_cap`.

    Raises DriverError for a setting or an EDS that cannot be used, AddressError for a tag of the write map that is no
    writable object.
    """
    options = read_options(settings)
    sheet = load_sheet(options.eds, options.node) if options.eds else None
    if sheet is not None:
        select_pdos(sheet.pdos("T"), options.tpdo, sheet.bits)
    return CanopenDriver(options, sheet, clock=clock, write_map=tuple(write_map), seed=seed)


class CanopenDriver:
    """One CANopen node; a Driver that Streams and Writes. Made by `open_canopen`."""

    def __init__(
        self, options: Options, sheet: DataSheet | None, *, clock: Clock, write_map: tuple[Tag, ...], seed: int
    ) -> None:
        self._options, self._sheet, self._clock = options, sheet, clock
        self._writing = Writing(write_map, options, sheet)
        self._places: dict[int, tuple[Tag, Where, DataSheet | None]] = {}
        self._listeners: set[PdoListener] = set()
        self._open = False
        self._past: dict[str, float] = {}
        self._counts = dict.fromkeys(("reads", "writes"), 0)
        self.supervisor = Supervisor()
        self._link: Link[Connection] = Link(
            self._connect,
            self._disconnect,
            connect_deadline=options.connect_timeout,
            backoff=Backoff(options.backoff_first, options.backoff_cap),
            dead_peer=DeadPeer(),
            seed=seed,
            supervisor=self.supervisor,
        )
        self._ports: set[Port] = set()

    # ------------------------------------------------------------ Driver

    async def open(self) -> None:
        """Open the bus and wait for the node. Raises LinkDown if it is not up within `connect_timeout`."""
        self._open = True
        await self._link.open()
        connection = self._link.connection
        if connection is None:
            raise LinkDown(self._link.reason)
        try:
            async with asyncio.timeout(self._options.connect_timeout):
                await connection.node.running.wait()
        except TimeoutError:
            if not connection.node.running.is_set():  # it may have come in the same turn of the loop
                raise LinkDown(connection.node.reason) from None

    async def close(self) -> None:
        """Leave the bus; the node is left as it is. Never raises; may be called twice."""
        self._open = False
        await self._link.close()
        for port in tuple(self._ports):
            await port.join()
            self._ports.discard(port)
        for listener in self._listeners:
            listener.wake.set()

    @property
    def connected(self) -> bool:
        """True while the node is up, operational and heard within its heartbeat's limit."""
        connection = self._link.connection
        return connection is not None and connection.node.hindrance(asyncio.get_running_loop().time()) is None

    def statistics(self) -> Mapping[str, float]:
        """Counters since the driver was made: frames, PDOs, SDO requests, heartbeats, restarts, and how they failed."""
        now = _connection_counts(self._link.connection)
        total = {name: value + self._past.get(name, 0) for name, value in now.items()}
        link = self._link.statistics()
        return {**self._counts, **total, "reconnects": max(0, link["connects"] - 1), **link}

    def complaints(self) -> tuple[str, ...]:
        """What the node says is wrong with it (emergencies), and what keeps it from being used; empty: nothing."""
        connection = self._link.connection
        if connection is None:
            return (self._link.reason,) if self._open else ()
        hindrance = connection.node.hindrance(asyncio.get_running_loop().time())
        return (*connection.node.emergencies.sentences(), *([hindrance[1]] if hindrance else []))

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """Every tag: from the last TPDO that carries it (with the time of that frame), else asked for by SDO.

        After one SDO request without an answer the others of this call are not sent.
        """
        self._counts["reads"] += 1
        answers: dict[ObjectPlace, SdoAnswer] = {}
        silent: SdoAnswer | None = None
        samples = []
        self._drain()
        for tag in tags:
            sample = self._known_sample(tag)
            if sample is None:
                place = self._where(tag).place
                if place not in answers:
                    answers[place] = silent or await self._ask(tag, place)
                    self._drain()
                    silent = answers[place] if answers[place].quality is Quality.TIMEOUT else None
                sample = self._answer_sample(tag, answers[place])
            samples.append(sample)
        return samples

    def cautions(self) -> tuple[str, ...]:
        """What of the EDS cannot be used, in sentences."""
        return self._sheet.left_out if self._sheet is not None else ()

    def explain(self, tags: Sequence[Tag]) -> tuple[PlanLine, ...]:
        """Which TPDO brings which tags and when it is late, which tags are asked for, and which lie nowhere."""
        options, maps = self._options, self._tpdos()
        carried: dict[ObjectPlace, PdoMapping] = {}
        for pdo in maps:
            carried |= {mapped.place: pdo for mapped in pdo.objects if mapped.place not in carried}
        here = [(tag, self._where(tag)) for tag in tags]
        lines = [PlanLine(f"{tag.name}: {where.misplaced}", PlanKind.PROBLEM) for tag, where in here if where.misplaced]
        for pdo in maps:
            names = [tag.name for tag, where in here if not where.misplaced and carried.get(where.place) is pdo]
            limit = pdo.timeout(options.pdo_timeout, options.sync_period)
            late = f"late after {limit:g} s" if limit else "without a period of its own"
            kind = PlanKind.HEARD if limit else PlanKind.OTHER
            lines += [PlanLine(f"{pdo.name}, {late}: {', '.join(names)}", kind)] if names else []
        asked = [tag.name for tag, where in here if not where.misplaced and where.place not in carried]
        worst = len(asked) * options.timeout
        if asked:
            lines.append(PlanLine(f"by SDO, worst case {worst:.3g} s a cycle: {', '.join(asked)}"))
        return tuple(lines)

    def validity_seconds(self, tags: Sequence[Tag]) -> Mapping[str, float]:
        """Seconds for which the last TPDO of each tag is good, as its EDS and the settings say."""
        options = self._options
        limits = {
            mapped.place: pdo.timeout(options.pdo_timeout, options.sync_period)
            for pdo in self._tpdos()
            for mapped in pdo.objects
        }
        places = {tag.name: self._where(tag).place for tag in tags if not self._where(tag).misplaced}
        return {name: limits[place] for name, place in places.items() if place in limits}

    # ------------------------------------------------------------ Streams

    async def stream(self, tags: Sequence[Tag]) -> AsyncIterator[Sample]:
        """Yield each tag's sample whenever a TPDO brings it, with the time of the frame, until `close`.

        A tag that becomes unusable (late, malformed, node gone) yields one sample of bad quality. Tags that no TPDO
        carries yield nothing: `read` asks for them.
        """
        listener = PdoListener(tags)
        self._listeners.add(listener)
        try:
            while self._open:
                self._drain()
                for tag in tags:
                    listener.look(self._known_sample(tag))
                for sample in listener.take():
                    yield sample
                await listener.wait()
        finally:
            self._listeners.discard(listener)

    # ------------------------------------------------------------ Writes

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """Write all values: by RPDOs where these carry nothing else, else by SDO; then verify.

        Verified by the object that acknowledges, where one is configured, else by reading back. Raises WriteForbidden,
        EncodingError or AddressError (nothing was sent), LinkDown, ReplyTimeout, ReplyMismatch, DeviceException,
        WriteUnverified. Never retries.
        """
        pieces = self._writing.check(values, self._known_sheet())
        if not pieces:
            return
        self._drain()
        connection = self._link.connection
        if connection is None:
            raise LinkDown(self._link.reason)
        hindrance = connection.node.hindrance(asyncio.get_running_loop().time())
        if hindrance is not None:
            raise LinkDown(hindrance[1])
        self._counts["writes"] += 1
        await self._writing.send(pieces, connection.node, before_sending)

    # ------------------------------------------------------------ samples

    def _known_sample(self, tag: Tag) -> Sample | None:
        """What is known of a tag without asking; None if the device must be asked."""
        now, moment = self._clock(), asyncio.get_running_loop().time()

        def no(quality: Quality, reason: str) -> Sample:
            return Sample(tag.name, None, quality, now, reason=reason)

        where = self._where(tag)
        if where.misplaced:
            return no(Quality.CONFIGURATION_ERROR, where.misplaced)
        connection = self._link.connection
        if connection is None:
            return no(Quality.NOT_CONNECTED, self._link.reason)
        node = connection.node
        if (hindrance := node.hindrance(moment)) is not None:
            return no(*hindrance)
        carrier = node.carrier(where.place)
        if carrier is None:
            reason = f"no TPDO carries {tag.address}, and listen_only forbids to ask for it"
            return no(Quality.CONFIGURATION_ERROR, reason) if self._options.listen_only else None
        # From here on a TPDO answers for the tag, also when it is late or faulty: an SDO read might say what the
        # program's memory holds, but not that the program still runs.
        heard, mapped = carrier
        if late := node.lateness(heard, moment):
            return no(Quality.TIMEOUT, late)
        if heard.fault:
            return no(Quality.COMMUNICATION_ERROR, heard.fault)
        if heard.asleep and node.life is not None and mapped.place != node.life.place:
            return no(Quality.OUT_OF_SERVICE, f"the device's program was not running when it sent {heard.pdo.name}")
        payload = heard.value(mapped)
        if payload is None:  # it has not come since the node is up
            if not self._options.listen_only:
                return None
            return no(Quality.WAITING_FOR_INITIAL_DATA, f"{heard.pdo.name} has not come yet")
        return self._sample(tag, from_bytes(tag, payload), heard.time, None)

    def _sample(self, tag: Tag, reading: Reading, time: float, sent: float | None) -> Sample:
        """The reading as far as the node's own emergencies let it count."""
        value, quality, reason = reading
        connection = self._link.connection
        verdict = connection.node.emergencies.verdict() if connection is not None else None
        if verdict is not None and not quality.is_bad:
            quality, reason = verdict
            value = None if quality.is_bad else value
        return Sample(tag.name, value, quality, time, sent=sent, reason=reason)

    def _answer_sample(self, tag: Tag, answer: SdoAnswer) -> Sample:
        if answer.payload is None:
            return Sample(tag.name, None, answer.quality, answer.time, sent=answer.sent, reason=answer.reason)
        return self._sample(tag, from_bytes(tag, answer.payload), answer.time, answer.sent)

    async def _ask(self, tag: Tag, place: ObjectPlace) -> SdoAnswer:
        connection = self._link.connection
        if connection is None:
            now = self._clock()
            return SdoAnswer(None, now, now, Quality.NOT_CONNECTED, self._link.reason)
        node = connection.node
        entry = node.sheet.objects.get(place) if node.sheet else None
        text = tag.dtype is DType.STRING
        size = entry.size if entry else None if text else object_bytes(tag) or None
        return await ask(node.sdo, place, size, self._clock, block=text and tag.length >= MIN_BLOCK_UPLOAD_BYTES)

    # ------------------------------------------------------------ where tags lie

    def _where(self, tag: Tag) -> Where:
        """The tag's object, or why it has none; worked out once for each tag, and anew with another EDS."""
        sheet = self._known_sheet()
        known = self._places.get(id(tag))
        if known is None or known[0] is not tag or known[2] is not sheet:
            if len(self._places) >= PLACES_KEPT:
                self._places.clear()
            known = self._places[id(tag)] = (tag, locate(tag, sheet), sheet)
        return known[1]

    def _known_sheet(self) -> DataSheet | None:
        connection = self._link.connection
        return (connection.node.sheet if connection is not None else None) or self._sheet

    def _tpdos(self) -> tuple[PdoMapping, ...]:
        """The TPDOs as the device has them, or as the EDS says while it has not been asked."""
        connection = self._link.connection
        if connection is not None and connection.node.brought is not None:
            return connection.node.brought.tpdos
        return () if self._sheet is None else select_pdos(self._sheet.pdos("T"), self._options.tpdo, self._sheet.bits)

    # ------------------------------------------------------------ the bus

    async def _connect(self) -> Connection:
        """Open the bus, in a thread since some interfaces take their time."""
        options = self._options
        opening = asyncio.create_task(
            asyncio.to_thread(open_bus, options.interface, options.channel, options.bitrate), name="open CAN bus"
        )
        try:
            bus = await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_let_go)
            raise
        node: RemoteNode
        port = Port(
            bus,
            self._clock,
            lambda frame: node.take(frame),
            lambda reason: self._report_loss(port, reason),
            supervisor=self.supervisor,
        )
        node = RemoteNode(
            port.send, options, self._sheet, self._on_pdo, catch_up=port.drain, supervisor=self.supervisor
        )
        self._ports.add(port)
        node.start()
        return Connection(port, node)

    def _disconnect(self, connection: Connection) -> None:
        for name, value in _connection_counts(connection).items():
            self._past[name] = self._past.get(name, 0) + value
        connection.node.close(self._link.reason)
        connection.port.close()

    def _drain(self) -> None:
        """Take what waits on the bus: after a pause of this process a frame in the midst of it is no news."""
        if (connection := self._link.connection) is not None:
            connection.port.drain()

    def _report_loss(self, port: Port, reason: str) -> None:
        connection = self._link.connection
        if connection is not None and connection.port is port:
            self._link.lost(connection, reason)

    def _on_pdo(self, node: RemoteNode, heard: ReceivedPdo) -> None:
        """A TPDO has come: the bus works, and whoever streams its tags hears of it."""
        connection = self._link.connection
        if connection is None or connection.node is not node:
            return
        self._link.note_answer(connection)
        if not self._listeners:
            return
        carried = {mapped.place for mapped in heard.pdo.objects}
        for listener in self._listeners:
            for tag in listener.tags:
                if self._where(tag).place in carried and (sample := self._known_sample(tag)) is not None:
                    listener.hear(sample)


def _let_go(opening: "asyncio.Task[can.BusABC]") -> None:
    """A bus that was opened too late is closed again."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().shutdown()


def _connection_counts(connection: Connection | None) -> dict[str, float]:
    if connection is None:
        return {}
    node = connection.node
    life = {"stranger_pdos": node.life.strangers if node.life else 0}
    emergencies = {"emergencies": node.emergencies.heard, "malformed_emergencies": node.emergencies.malformed}
    return {**connection.port.counts, **asdict(node.counts), **node.sdo.counts, **emergencies, **life}
