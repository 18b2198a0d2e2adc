"""The Modbus driver (TCP, TLS, RTU): blocks read under deadlines, refused addresses kept apart, one verified write."""

import asyncio
import random
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

from pymodbus.pdu import ModbusPDU

from drivers.codec import Reading, encoder, reader
from drivers.connections import Connections
from drivers.driver import BeforeSending, Clock, PlanKind, PlanLine, anyhow
from drivers.errors import (
    NO_WAY_TO_UNIT,
    AddressError,
    DeviceException,
    DriverError,
    LinkDown,
    LinkFault,
    NotAsked,
    ReplyMismatch,
    ReplyTimeout,
    WriteForbidden,
    WriteUnverified,
)
from drivers.modbus.address import Area, TagSpan, WideRange, locate
from drivers.modbus.factors import ScaledTag, in_order, scaled_sample, scaled_tag, spans_of
from drivers.modbus.identity import (
    MOST_PARTS,
    PinnedMark,
    identification,
    mark_request,
    object_request,
    server_id_request,
    stranger,
    take_part,
)
from drivers.modbus.plan import (
    AddressBlock,
    Quarantine,
    RefusedRange,
    bisect,
    by_block,
    check_span,
    describe,
    find_refusal,
    plan_spans,
)
from drivers.modbus.quarantine import RefusedAddresses
from drivers.modbus.settings import ModbusSettings, connection_place, read_settings
from drivers.modbus.shared import SharedLink
from drivers.modbus.verify import exception_quality
from drivers.modbus.wire import WireReply, read_request, write_request
from drivers.survey import Raw
from drivers.tag import Quality, Sample, Tag, Value

# A device exception that can be about one address of several. 5, 6, 10, 11 are about the moment or the way there.
_ABOUT_ADDRESSES = frozenset({1, 2, 3, 4})
_BUSY, _NOT_TAKEN = frozenset({5, 6}), frozenset({6})
"""Exceptions after which a read is asked again in its time, and a write sent again: 6 says that nothing was done."""
_ILLEGAL_FUNCTION = 1
_OTHER_FUNCTION = {
    16: "if it takes single registers alone, give write_with = 6",
    6: "if it takes several registers alone, give write_with = 16",
    15: "if it takes single coils alone, give write_with = 5",
    5: "if it takes several coils alone, give write_with = 15",
}
"""What else a refusal of the function that writes may mean, by that function."""
_MOST_ROUNDS = 3
_SAYS_NOTHING = frozenset({1, 2, 3})
"""Refusals by which a device says that it has no such mark."""
IDENTITY_S = 60.0
"""So often a pinned device says who it is, also where nothing has failed."""
_NOT_KNOWN = "it is not known whether this is the pinned device (identity)"
_FIRST_PAUSE_S = 0.02
_LINE_PAUSE_S = 0.05
"""After a gateway has said that its unit gave no reply, until the unit is asked again."""
_MAX_WRITE_BITS = 1968  # 0x07B0 (MODBUS Application Protocol V1.1b3, 6.11)
_LAYOUTS_KEPT = 64
_EARLY_PERIOD_SHARE = 0.05
"""A tag is due so much of its period early: a scan that jitters shall not miss it."""
_SEARCH_S = 30.0
"""A search that has not gone on for so long begins anew."""
_MIN_SILENCES = 2
_ADDRESS_COUNT = 0x10000
_NOTHING: tuple[tuple[int, ...], Reading] = ((), (None, Quality.NO_DATA, ""))


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a block has no values: the quality that its tags get, the sentence, the device's exception code if any.

    `asked`: the device was asked, and not merely waited for.
    """

    quality: Quality
    reason: str
    code: int = 0
    asked: bool = True


class BlockSearch:
    """The search for the refused addresses of a block, over several readings where it must be.

    `part` is asked next, and before it `checks`, of which one must answer before silence is believed. `elsewhere`: one
    that lies outside the block has answered, so that silence to all of the block is no absence.
    """

    def __init__(self, block: AddressBlock, refusal: Failure) -> None:
        self.block, self.refusal, self.latest = block, refusal, refusal
        self.reasons = {(block.start, block.stop): refusal.reason}
        self.checks: list[AddressBlock] = []
        self.part: AddressBlock | None = None
        self.refusals: tuple[RefusedRange, ...] = ()
        self.answered = self.silent = self.elsewhere = False
        self.silences = 0
        self.forgotten_at = 0.0
        self._steps = bisect(block)
        self._begun = False

    def advance(self, *, refused: bool) -> None:
        """The part (at first the block itself) was refused or not: what is to be asked next."""
        self.silences = 0
        try:
            self.part = self._steps.send(refused) if self._begun else next(self._steps)
        except StopIteration as end:
            self.part, self.refusals = None, end.value
        self._begun = True


@dataclass(frozen=True, slots=True)
class _TagLayout:
    """The tags of one call, located or with the reason why not, and the block plan under one quarantine.

    `tags` are held so that their identities, by which layouts are found again, stay theirs. `paced` are those that have
    a period of their own, `scaled` those that have a factor in a register; `apart` are the factors that come in another
    reply than one of their values, each alone.
    """

    tags: tuple[Tag, ...]
    spans: tuple[TagSpan, ...]
    misplaced: tuple[tuple[Tag, str], ...]
    quarantine: Quarantine
    blocks: tuple[AddressBlock, ...]
    paced: tuple[TagSpan, ...]
    scaled: tuple[ScaledTag, ...] = ()
    apart: tuple[AddressBlock, ...] = ()


@dataclass(slots=True)
class PacedTag:
    """A tag with a period of its own: what was read last (None: it is being read), and when it is read again.

    `due` is the loop's time.
    """

    span: TagSpan
    due: float
    sample: Sample | None = None


@dataclass(frozen=True, slots=True)
class _WriteLayout:
    """The block of one write: for each of its spans the place of its value in the call, and how that becomes words.

    `tags` are those of the call, held so that their identities stay theirs.
    """

    tags: tuple[Tag, ...]
    block: AddressBlock
    pieces: tuple[tuple[int, Callable[[Value], list[int]]], ...]


def open_modbus(
    settings: Mapping[str, Any],
    *,
    clock: Clock,
    write_map: Sequence[Tag] = (),
    seed: int = 0,
    connections: Connections | None = None,
    rng: random.Random | None = None,
) -> "ModbusDriver":
    """Make a Modbus driver, not yet opened.

    `transport` is "tcp" (`host`, `port`), "tls" (Modbus/TCP Security: also `certificates`, the folder of ca.pem,
    client.pem and client.key, and `tls_name` where the PLC's certificate has another name than `host`), "rtu" (`serial`
    port, `baud`, `parity`, `stopbits`) or "rtu-tcp" (RTU frames at `host` and `port`). The last two also have `echo`,
    if the adapter gives back what is sent, and `longest_reply`, after which an answer can no longer come.

    Further settings (seconds unless named otherwise): `unit` (0..255; 1..247 on a serial line); `timeout`, the deadline
    of one request (the time that bytes need on a serial line comes on top); `attempts`, how often a read is sent, each
    time with that deadline (a late reply to the same question is its answer);
    `connect_timeout`; `max_registers`, `max_bits`, `max_write_registers`, the most that the device takes in a request;
    `max_gap`, addresses read in vain to save a request; `pause_ms` between requests; `one_client`, if the device serves
    one connection only; `backoff_first` and `backoff_cap`; `max_failures` and `max_silence`, the dead-peer rule;
    `refused_first` and `refused_cap`, when a refused address is asked again.

    With `connections`, units at the same host and port or on the same serial line share one connection in fair turns
    (`drivers.modbus.shared`): at most `outstanding` requests at a time, the least that any of them says; a silent unit
    is asked again after `silent_first` to `silent_cap` seconds.

    `rng` draws the first transaction id, by default unlike that of any start before.

    Raises DriverError for an unknown key (it lists the known ones), a value out of range, certificates that cannot be
    used and settings that do not go with those of others on the connection, AddressError for a tag of the write map
    that cannot be written.
    """
    checked = read_settings(settings)
    return make_modbus(checked, clock=clock, write_map=write_map, seed=seed, connections=connections, rng=rng)


def make_modbus(
    settings: ModbusSettings,
    *,
    clock: Clock,
    write_map: Sequence[Tag] = (),
    seed: int = 0,
    connections: Connections | None = None,
    rng: random.Random | None = None,
) -> "ModbusDriver":
    """`open_modbus` of settings that are checked already."""
    make_shared = partial(SharedLink, settings, clock=clock, seed=seed, alone=connections is None, rng=rng)
    shared = make_shared() if connections is None else connections.obtain(connection_place(settings), make_shared)
    kind = PinnedDriver if settings.identity else ModbusDriver
    return kind(settings, clock=clock, write_map=tuple(write_map), shared=shared)


class ModbusDriver:
    """One Modbus device behind one connection, its own or a shared one; a Driver that Writes. Made by `open_modbus`."""

    def __init__(
        self, settings: ModbusSettings, *, clock: Clock, write_map: tuple[Tag, ...], shared: SharedLink
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._limits = settings.limits
        spans = [_writable(tag, settings.wide_registers) for tag in write_map]
        self._write_map = {span.tag.name: span for span in spans}
        # As a rule: a request asks for what is wanted, and for registers of 16 bits.
        self._plainly = settings.aligned == 1 and not settings.wide_registers
        self._writable_addresses = frozenset(
            (span.area, number) for span in self._write_map.values() for number in range(span.start, span.stop)
        )
        words = max((_words(self._write_map[tag.name] for tag in block) for block in by_block(write_map)), default=0)
        if words > settings.max_write_registers and not settings.singly[0]:
            # Neither WriteForbidden nor AddressError: a block that can never be sent is a mistake in any mode.
            raise DriverError(
                f"the block has {words} words and the device takes {settings.max_write_registers} in one write "
                "(max_write_registers, or else max_registers): leave fields out (decanter plc bind --block ADDRESS "
                "--fields NAMES), or give max_write_registers where the device takes more"
            )
        self._lock = asyncio.Lock()
        self._refused = RefusedAddresses(settings.refused_first, settings.refused_cap)
        self._layouts: dict[tuple[int, ...], _TagLayout] = {}
        # By a tag's identity: how it is read, and what its words were last and meant.
        self._readers: dict[int, Callable[[Sequence[int]], Reading]] = {}
        self._decoded: dict[int, tuple[tuple[int, ...], Reading]] = {}
        self._writes: dict[tuple[int, ...], _WriteLayout] = {}
        # A block that was answered: by it silence to another is told from absence.
        self._known_good: AddressBlock | None = None
        # It has answered, and since then no reading has ended with a gateway's word that it has no way to it.
        self._reached = False
        self._searches: dict[tuple[Area, int, int], BlockSearch] = {}
        # By a tag's identity, of those with a period of their own.
        self._paced: dict[int, PacedTag] = {}
        self._paced_over = 0
        # By a tag's identity, held as long as what is known of their parts; and what factors were read last.
        self._scaled: dict[int, ScaledTag] = {}
        self._factors: dict[int, int] = {}
        self._counts = dict.fromkeys(("retries", "busy", "writes", "late_read_backs", "bisections"), 0)
        self._line = shared.join(settings)
        self.supervisor = shared.supervisor

    # ------------------------------------------------------------ Driver

    async def open(self) -> None:
        """Start the supervisor and try once. Raises LinkDown if the first attempt fails (it goes on trying)."""
        await self._line.open()

    async def close(self) -> None:
        """Stop the supervisor and close the connection. Never raises; may be called twice."""
        await self._line.close()

    @property
    def connected(self) -> bool:
        """True from the first valid reply on a connection until that is lost, or it or the unit is given up as dead."""
        return self._line.connected

    def statistics(self) -> Mapping[str, float]:
        """Counters since the driver was made; `quarantined` counts the addresses' ranges refused at present."""
        return {**self._counts, "quarantined": self._refused.ranges, **self._line.statistics()}

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """Read all tags now; a failure is a Sample of bad quality with the reason. A block's tags share one reply."""
        if self._settings.close_between_scans:
            await self._line.ready()
            try:
                return await self._scan(tags)
            finally:
                self._line.rest()
        return await self._scan(tags)

    async def _in_turn(self, tags: Sequence[Tag], paced: Sequence[TagSpan]) -> list[Sample]:
        """Those tags that are due now, and of the others what was read last."""
        now, line = _now(), self._line
        # Behind another connection there may be another device, unless it says on each who it is.
        comes_and_goes = bool(self._settings.identity) and (self._settings.close_between_scans or line.ends_connections)
        if not comes_and_goes and (line.connection is None or line.connects != self._paced_over):
            self._paced.clear()
        self._paced_over = over = line.connects
        held = {
            id(span.tag): one.sample
            for span in paced
            if (one := self._paced.get(id(span.tag))) is not None
            and one.sample is not None
            and now < one.due - _EARLY_PERIOD_SHARE * span.tag.period
        }
        asked = [tag for tag in tags if id(tag) not in held] if held else tags
        read = await self._read_anew(asked, [span for span in paced if id(span.tag) not in held])
        if held and not comes_and_goes and line.connects != over:
            self._paced_over = line.connects
            read |= await self._read_anew(
                [tag for tag in tags if id(tag) in held], [span for span in paced if id(span.tag) in held]
            )
        return [read[id(tag)] if id(tag) in read else held[id(tag)] for tag in tags]

    async def _read_anew(self, tags: Sequence[Tag], paced: Sequence[TagSpan]) -> dict[int, Sample]:
        """Read the tags, and keep what was read of those with a period."""
        now = _now()
        # Who writes over one of them meanwhile takes it away, and so does who believes the device no more.
        begun = [PacedTag(span, now) for span in paced]
        self._paced |= {id(one.span.tag): one for one in begun}
        read = {id(tag): sample for tag, sample in zip(tags, await self._scan(tags, all_due=True), strict=True)}
        for one in begun:
            key = id(one.span.tag)
            if self._paced.get(key) is one:
                # What was not read is asked for with the next scan.
                due = now + one.span.tag.period if read[key].sent is not None else now
                self._paced[key] = PacedTag(one.span, due, read[key])
        return read

    @property
    def is_searching(self) -> bool:
        """Whether the next reading goes on looking for what the device refuses by silence."""
        return bool(self._searches)

    async def _scan(self, tags: Sequence[Tag], *, all_due: bool = False) -> list[Sample]:
        now = _now()
        self._refused.renew(now, self._line.connects)
        layout = self._layout(tags)
        if layout.paced and not all_due:
            return await self._in_turn(tags, layout.paced)
        samples = {id(tag): self._no(tag, Quality.CONFIGURATION_ERROR, reason) for tag, reason in layout.misplaced}
        trial = self._refused.trial(layout.spans, now)
        for block in layout.apart:
            if (key := id(block.spans[0].tag)) not in self._factors:
                samples |= await self._read_block(block)
                self._note_factor(key, samples)
        for block in layout.blocks:
            samples |= await self._read_block(block)
        if trial:
            samples |= await self._retry_place(trial)
        for span in layout.spans:
            if id(span.tag) not in samples:
                samples[id(span.tag)] = self._no(span.tag, *self._refused.verdict(span, now))
        for part in layout.scaled:
            raw, factor = samples[id(part.raw)], samples[id(part.factor)]
            samples[id(part.tag)] = scaled_sample(part, raw, factor, self._factors.get(id(part.factor)))
        for block in layout.apart:
            self._note_factor(id(block.spans[0].tag), samples)
        return [samples[id(tag)] for tag in tags]

    def _note_factor(self, factor: int, samples: Mapping[int, Sample]) -> None:
        """Keep a factor for the next reading; what has not been read is asked for before that."""
        value = samples[factor].value if factor in samples else None
        if isinstance(value, int):
            self._factors[factor] = value
        else:
            self._factors.pop(factor, None)

    def explain(self, tags: Sequence[Tag]) -> tuple[PlanLine, ...]:
        """The block plan in sentences: what cannot be read and why, each request, the worst-case cycle time."""
        layout = self._layout(tags)
        refused = [(span, find_refusal(span, layout.quarantine)) for span in layout.spans]
        left_out = [reason for _, reason in layout.misplaced]
        left_out += [f"{span.tag.name}: in quarantine: {refusal.reason}" for span, refusal in refused if refusal]
        problems = [PlanLine(line, PlanKind.PROBLEM) for line in left_out]
        return (*problems, *map(PlanLine, describe(layout.blocks, self._limits, self._settings.longest_read)))

    def cautions(self) -> tuple[str, ...]:
        """What works and should not stay as it is, in sentences: a key that others may read, a certificate's end."""
        return self._line.cautions()

    # ------------------------------------------------------------ Writes

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """Write all values with one request (function 16; 15 for coils), sent once, then read back and compare.

        Where the device takes single registers or coils alone (`write_with`), one request for each, in their order.

        Raises WriteForbidden, EncodingError, or AddressError if the tags are not one block (nothing was sent);
        LinkDown, ReplyTimeout, ReplyMismatch (it is not known whether the device took it); DeviceException;
        WriteUnverified. Never retries, a request aside that the device refused as busy, which says that nothing was
        done: whether to write again is the caller's decision.
        """
        if not values:
            return
        layout = self._write_layout([tag for tag, _ in values])
        try:
            await self._write_block(layout, values, before_sending)
        finally:
            self._forget(layout.block)
            if self._settings.close_between_scans:
                self._line.rest()

    def _forget(self, block: AddressBlock) -> None:
        """What was written is not what was read."""
        for key, one in tuple(self._paced.items()):
            span = one.span
            if span.area is block.area and span.start < block.stop and block.start < span.stop:
                del self._paced[key]

    async def _write_block(
        self, layout: _WriteLayout, values: Sequence[tuple[Tag, Value]], before_sending: BeforeSending
    ) -> None:
        block, words = layout.block, [word for place, words in layout.pieces for word in words(values[place][1])]
        async with self._lock:
            if self._settings.close_between_scans:
                await self._line.ready()
            self._counts["writes"] += 1
            until = _now() + self._settings.longest_read
            for request in self._write_requests(block, words):
                await self._once(request, before_sending)
            if self._settings.read_back == "never":
                return
            pause = _FIRST_PAUSE_S
            while True:
                stored: list[int] | None = None
                try:
                    stored = await self._read_words(block)
                except DriverError as error:
                    # One that hangs up after its answers does so under this question too: the next connection has it.
                    hung_up = isinstance(error, LinkDown) and error.fault is LinkFault.CLOSED
                    if not hung_up or _now() + pause > until:
                        raise WriteUnverified(
                            f"the device confirmed the write, but reading back failed: {error}"
                        ) from error
                # A gateway's image, or a PLC that copies its table once a cycle, shows it later.
                if stored is not None and (words == stored or _now() + pause > until):
                    break
                self._counts["late_read_backs"] += 1
                await asyncio.sleep(pause)
                pause *= 2
        wrong = []
        for span in block.spans if words != stored else ():
            part = slice(span.start - block.start, span.stop - block.start)
            if words[part] != stored[part]:
                wrong.append(f"{span.tag.name}: wrote {list(words[part])}, reads back {list(stored[part])}")
        if wrong:
            raise WriteUnverified("the device confirmed the write, but " + "; ".join(wrong))

    def _write_requests(self, block: AddressBlock, words: Sequence[int]) -> Iterator[ModbusPDU]:
        """The one request of a write, or one a word where the device takes no other."""
        unit, area = self._settings.unit, block.area
        registers, coils = self._settings.singly
        if not (coils if area.is_bits else registers):
            yield write_request(area, block.start, words, unit)
            return
        for place, word in enumerate(words, start=block.start):
            yield write_request(area, place, [word], unit, single=True)

    async def _once(self, request: ModbusPDU, before_sending: BeforeSending) -> None:
        """Send a write."""
        try:
            await self._while_busy(lambda: self._line.ask(request, before_sending, urgent=True), _NOT_TAKEN)
        except DeviceException as error:
            if error.code == _ILLEGAL_FUNCTION and (remedy := _OTHER_FUNCTION.get(request.function_code)):
                raise DeviceException(error.code, f"{error}; {remedy}") from None
            raise

    async def _read_words(self, block: AddressBlock) -> list[int]:
        """What the device holds now, in as many requests as its read limit asks for (the lock is held)."""
        words: list[int] = []
        largest = self._limits.largest(block.area)
        for start in range(block.start, block.stop, largest):
            part = AddressBlock(block.area, start, min(largest, block.stop - start), ())
            words += (await self._attempts(part, urgent=True)).words
        return words

    def _write_layout(self, tags: Sequence[Tag]) -> _WriteLayout:
        """The one block of a write of these tags, checked against the write map; worked out once for the same tags."""
        key = tuple(map(id, tags))
        if (known := self._writes.get(key)) is not None:
            return known
        mapped = sorted(((self._find_span(tag), place) for place, tag in enumerate(tags)), key=lambda one: one[0].start)
        spans = tuple(span for span, _ in mapped)
        for left, right in pairwise(spans):
            if left.area is not right.area or left.stop != right.start:
                raise AddressError(
                    f"{left.tag.name} ({left.tag.address}) and {right.tag.name} ({right.tag.address}) are not "
                    "neighbours: one write is one request, so its tags must follow one another without gap or overlap"
                )
        block = AddressBlock(spans[0].area, spans[0].start, spans[-1].stop - spans[0].start, spans)
        largest = _MAX_WRITE_BITS if block.area.is_bits else self._settings.max_write_registers
        if block.count > largest and not self._settings.singly[block.area.is_bits]:
            raise AddressError(f"{block.count} words do not fit in one write request, which takes {largest}")
        if not self._writable_addresses.issuperset((block.area, number) for number in range(block.start, block.stop)):
            raise WriteForbidden(f"{block.area}:{block.start} count {block.count} reaches outside the write map")
        if len(self._writes) >= _LAYOUTS_KEPT:
            self._writes.clear()
        pieces = tuple((place, encoder(span.tag)) for span, place in mapped)
        layout = self._writes[key] = _WriteLayout(tuple(tags), block, pieces)
        return layout

    def _find_span(self, tag: Tag) -> TagSpan:
        span = self._write_map.get(tag.name)
        # The very tag as a rule: to compare two of them field by field takes longer than to encode one.
        if span is None or (span.tag is not tag and span.tag != tag):
            raise WriteForbidden(f"{tag.name} ({tag.address}) is not in the write map; nothing was sent")
        return span

    # ------------------------------------------------------------ reading blocks

    def _layout(self, tags: Sequence[Tag]) -> _TagLayout:
        """Where the tags lie and how they are read, worked out anew only when the quarantine has changed."""
        key = tuple(map(id, tags))
        layout = self._layouts.get(key)
        if layout is None or layout.quarantine is not self._refused.quarantine:
            if len(self._layouts) >= _LAYOUTS_KEPT:
                self._layouts.clear()
                self._decoded.clear()
                self._readers.clear()
                self._scaled.clear()
                self._factors.clear()
            spans: list[TagSpan] = []
            misplaced: list[tuple[Tag, str]] = []
            scaled: list[ScaledTag] = []
            factors: dict[int, TagSpan] = {}
            paced: list[TagSpan] = []
            for tag in tags:
                try:
                    if tag.scale_from:
                        part = self._split(tag)
                        span, factor = spans_of(part, self._limits)
                        scaled.append(part)
                        factors[id(part.factor)] = factor
                    else:
                        span = check_span(locate(tag, self._limits.wide), self._limits)
                except AddressError as error:
                    misplaced.append((tag, str(error)))
                    continue
                spans.append(span)
                if tag.period:
                    paced.append(replace(span, tag=tag))
            spans += factors.values()
            quarantine = self._refused.quarantine
            blocks, apart = in_order(plan_spans(spans, self._limits, quarantine), scaled)
            layout = _TagLayout(
                tuple(tags), tuple(spans), tuple(misplaced), quarantine, blocks, tuple(paced), tuple(scaled), apart
            )
            self._layouts[key] = layout
        return layout

    def _split(self, tag: Tag) -> ScaledTag:
        """What is read of a tag with a factor; the same parts as long as anything is known of them."""
        if (known := self._scaled.get(id(tag))) is not None:
            return known
        factors = {part.factor.address: part.factor for part in self._scaled.values()}
        part = self._scaled[id(tag)] = scaled_tag(tag, factors)
        return part

    async def _read_block(self, block: AddressBlock) -> dict[int, Sample]:
        """The block's samples; if the device refuses it, those of its parts."""
        key = (block.area, block.start, block.count)
        search = self._searches.pop(key, None)
        if search is not None and _now() < search.forgotten_at:
            return await self._continue_search(search)
        outcome = await self._ask(block)
        samples = self._samples(block, outcome)
        if isinstance(outcome, WireReply):
            self._refused.note_answer(block)
            self._known_good, self._reached = block, True
            return samples
        if not (outcome.asked and self._may_refuse(outcome) and self._refused.may_bisect(block, _now())):
            return samples
        silent = outcome.quality is Quality.TIMEOUT
        checks = self._places_to_check(block) if silent else []
        if silent and not checks:
            return samples
        self._counts["bisections"] += 1
        search = BlockSearch(block, outcome)
        if silent:
            search.checks, search.silent = checks, True
            if len(block.spans) == 1:
                search.part, search.silences = block, 1
        else:
            search.advance(refused=True)
        return samples | await self._continue_search(search)

    def _may_refuse(self, failure: Failure) -> bool:
        """Whether it may be about one address of several: a refusal, or silence, by which some devices refuse."""
        return failure.code in _ABOUT_ADDRESSES or failure.quality is Quality.TIMEOUT

    def _places_to_check(self, block: AddressBlock) -> list[AddressBlock]:
        """Where a device that is silent to a block is asked whether it is there: a place that answered, or its ends."""
        ends = (block.spans[0], block.spans[-1]) if len(block.spans) > 1 else ()
        places = [AddressBlock(span.area, span.start, span.count, (span,)) for span in ends]
        if self._known_good is not None and self._known_good != block:
            places.insert(0, self._known_good)
        return places[:2]

    async def _continue_search(self, search: BlockSearch) -> dict[int, Sample]:
        """Go on looking for the refused addresses of a block; the samples of the parts that were asked on the way.

        Where silence is a refusal that takes a reading's time at most, and goes on with the next reading: nothing else
        of the device is read meanwhile.
        """
        block, until = search.block, _now() + self._settings.longest_read
        samples = self._samples(block, search.refusal)
        while search.part is not None or search.checks:
            # Not before a check has been answered: behind two questions that are silent nothing else would be asked.
            if search.silent and not search.checks and _now() > until:
                return self._keep_search(search) | _with_values(samples)
            check = search.checks[0] if search.checks else None
            part = check or search.part
            if part is None:
                return samples
            # One lost reply makes no refusal: a part that cannot be halved is asked as a block is. On a line nothing is
            # asked again before the time of its answer is over: such a part is asked twice.
            alone = check is None and len(part.spans) == 1
            outcome = await self._ask(part, patiently=alone and not self._settings.on_line)
            search.latest = outcome if isinstance(outcome, Failure) else search.latest
            if isinstance(outcome, Failure) and not outcome.asked:
                return self._keep_search(search) | _with_values(samples)
            if check is not None:
                if isinstance(outcome, WireReply) or outcome.code:
                    search.checks, self._known_good = [], check
                    search.elsewhere |= _lies_outside(check, block)
                    if not self._is_to_ask_again(search):
                        search.advance(refused=True)
                else:
                    search.checks = search.checks[1:]
                    if not search.checks:  # it is not there at all, and nothing is concluded
                        self._refused.found(block, (), answered=False, reasons={}, now=_now())
                        return self._samples(block, outcome) | _with_values(samples)
            else:
                found = self._samples(part, outcome)
                if isinstance(outcome, Failure) and not self._may_refuse(outcome):
                    # The link or the device's mood has changed: what was not reached is unknown.
                    return self._samples(block, outcome) | _with_values(samples)
                samples |= found
                if isinstance(outcome, WireReply):
                    search.answered, self._known_good = True, part
                    search.advance(refused=False)
                    continue
                search.reasons[part.start, part.stop] = outcome.reason
                if outcome.quality is not Quality.TIMEOUT:
                    search.advance(refused=True)
                    continue
                search.silent = True
                search.silences += alone
                if self._is_to_ask_again(search):
                    continue
                search.checks = self._places_to_check(part)
                if not search.checks:
                    search.advance(refused=True)
        self._refused.found(
            block,
            search.refusals,
            answered=search.answered or search.elsewhere,
            reasons=search.reasons,
            now=_now(),
            silent=search.silent,
        )
        return samples

    def _is_to_ask_again(self, search: BlockSearch) -> bool:
        """Whether a part that cannot be halved has been silent too seldom.

        On a line each question is asked once; a block of one place has only been silent as any block may be now and
        then, and is asked anew once another place has answered.
        """
        alone = search.part is not None and len(search.part.spans) == 1
        doubted = self._settings.on_line or len(search.block.spans) == 1
        return alone and doubted and search.silences < _MIN_SILENCES

    def _keep_search(self, search: BlockSearch) -> dict[int, Sample]:
        """Keep a search for the next reading; what its block has no values for."""
        if len(self._searches) >= _LAYOUTS_KEPT:
            self._searches.clear()
        search.forgotten_at = _now() + _SEARCH_S
        self._searches[search.block.area, search.block.start, search.block.count] = search
        return self._samples(search.block, search.latest)

    async def _retry_place(self, trial: AddressBlock) -> dict[int, Sample]:
        """Ask a quarantined place again, in a request of its own."""
        outcome = await self._ask(trial, patiently=False)
        if isinstance(outcome, WireReply):
            self._refused.rejoin(trial)
        elif outcome.asked and self._may_refuse(outcome):
            self._refused.again(trial, outcome.reason, _now(), silent=outcome.quality is Quality.TIMEOUT)
        return self._samples(trial, outcome)

    def _samples(self, block: AddressBlock, outcome: WireReply | Failure) -> dict[int, Sample]:
        if isinstance(outcome, Failure):
            return {id(span.tag): self._no(span.tag, outcome.quality, outcome.reason) for span in block.spans}
        samples: dict[int, Sample] = {}
        start, words, received, sent = block.start, outcome.words, outcome.received, outcome.sent
        decoded, readers = self._decoded, self._readers
        for span in block.spans:
            tag, first = span.tag, span.start - start
            key, own = id(tag), words[first : first + span.count]
            # What a tag's words mean depends on nothing else, and from scan to scan most of them are the same.
            before, reading = decoded.get(key, _NOTHING)
            if own != before:
                if (read := readers.get(key)) is None:
                    read = readers[key] = reader(tag) if span.wide is None else _wide_reader(tag)
                reading = read(own)
                decoded[key] = (own, reading)
            value, quality, reason = reading
            samples[key] = Sample(tag.name, value, quality, received, sent, reason=reason)
        return samples

    def _no(self, tag: Tag, quality: Quality, reason: str) -> Sample:
        return Sample(tag.name, None, quality, self._clock(), reason=reason)

    async def _ask(self, block: AddressBlock, *, patiently: bool = True) -> WireReply | Failure:
        """Read one block; what goes wrong is a Failure. Not `patiently`: once, after others that had no answer."""
        async with self._lock:
            try:
                if not patiently:
                    return await self._while_busy(lambda: self._request_block(block, again=True), _BUSY)
                return await self._attempts(block)
            except DeviceException as error:
                self._reached = error.code not in NO_WAY_TO_UNIT
                return Failure(exception_quality(error.code), str(error), error.code)
            except ReplyTimeout as error:
                return Failure(Quality.TIMEOUT, str(error), asked=not isinstance(error, NotAsked))
            except ReplyMismatch as error:
                return Failure(Quality.COMMUNICATION_ERROR, str(error))
            except LinkDown as error:
                return Failure(Quality.NOT_CONNECTED, str(error))

    # ------------------------------------------------------------ one exchange (the lock is held)

    async def _attempts(self, block: AddressBlock, *, urgent: bool = False) -> WireReply:
        """Read a block, again with a new transaction id if no valid reply came; each request has its own deadline."""
        return await self._repeat(lambda again: self._request_block(block, again=again, urgent=urgent))

    async def _repeat(self, ask: Callable[[bool], Awaitable[WireReply]]) -> WireReply:
        """Ask as often as a reading is asked for (`_tries`), and later where the device is busy."""
        return await self._while_busy(lambda: self._tries(ask), _BUSY)

    async def _while_busy(self, ask: Callable[[], Awaitable[WireReply]], codes: frozenset[int]) -> WireReply:
        """Ask again after a pause what the device refuses for the moment, as long as a reading lasts at most.

        V1.1b3, section 7: "the client should retransmit the message later".
        """
        until, pause = _now() + self._settings.longest_read, _FIRST_PAUSE_S
        while True:
            try:
                return await ask()
            except DeviceException as error:
                if error.code not in codes or _now() + pause > until:
                    raise
            self._counts["busy"] += 1
            await asyncio.sleep(pause)
            pause *= 2

    async def _tries(self, ask: Callable[[bool], Awaitable[WireReply]]) -> WireReply:
        """Ask, again with a new transaction id if no valid reply came; `ask` is told whether that is so.

        A gateway's word that its unit gave no reply (exceptions 10 and 11) is no reply, too: the line behind it may
        have been disturbed. A unit that has not answered, or not since a reading that ended so, is asked once.
        """
        again, wire, began = False, self._line.connection, 0.0
        # After a connection that was taken and never answered, the next ones get one question each.
        for _ in range(0 if self._line.suspect else self._settings.attempts - 1):
            try:
                return await ask(again)
            except (ReplyTimeout, ReplyMismatch):
                if self._line.connection is not wire:
                    raise
                self._counts["retries"] += 1
                again = True
            except DeviceException as error:
                began = began or _now()
                rest = self._settings.longest_read - (_now() - began)
                if error.code not in NO_WAY_TO_UNIT or not self._reached or self._line.suspect or rest < _LINE_PAUSE_S:
                    raise
                self._counts["retries"] += 1
                await asyncio.sleep(_LINE_PAUSE_S)
                again = False
        return await ask(again)

    def _request_block(self, block: AddressBlock, *, again: bool, urgent: bool = False) -> Awaitable[WireReply]:
        """Ask for a block once; where the device takes aligned reads alone, for what lies around it too."""
        if self._plainly:
            request = read_request(block.area, block.start, block.count, self._settings.unit)
            return self._line.ask(request, again=again, urgent=urgent)
        wide = block.wide is not None
        if self._settings.aligned > 1 and not wide and not block.area.is_bits:
            return self._request_aligned_block(block, again=again, urgent=urgent)
        request = read_request(block.area, block.start, block.count, self._settings.unit, wide=wide)
        return self._line.ask(request, again=again, urgent=urgent)

    async def _request_aligned_block(self, block: AddressBlock, *, again: bool, urgent: bool) -> WireReply:
        settings = self._settings
        start = block.start // settings.aligned * settings.aligned
        stop = min(-(-block.stop // settings.aligned) * settings.aligned, _ADDRESS_COUNT)
        request = read_request(block.area, start, stop - start, settings.unit)
        reply = await self._line.ask(request, again=again, urgent=urgent)
        return replace(reply, words=reply.words[block.start - start : block.stop - start])

    # ------------------------------------------------------------ by hand

    async def by_hand(self, request: ModbusPDU, deadline: float, *, again: bool = False) -> WireReply:
        """Send one request once over the driver's connection, whatever unit it is for; it fails as it fails."""
        return await self._line.by_hand(request, deadline, again=again)

    def raw(self, tag: Tag, sample: Sample) -> Raw:
        """The reading with the words that it was made of, where it was made of any."""
        decoded = self._decoded.get(id(tag)) if sample.sent is not None else None
        try:
            span = locate(tag, self._limits.wide)
        except AddressError:
            return Raw(tag, sample, tag.address, 0)
        words = decoded[0] if decoded else None
        if words is not None and span.wide is not None:
            words = _words_of_wide(words)
        return Raw(tag, sample, f"{span.area}:{span.start}", span.count, words)

    def allow(self, timeout: float) -> None:
        """Wait so long (s) for an answer from now on: what the device has been seen to need."""
        self._settings = self._line.settings = self._settings.model_copy(update={"timeout": timeout})

    async def who(self, marks: Sequence[PinnedMark], *, urgent: bool = False) -> tuple[str, tuple[int, int]]:
        """Why the device is not the one that has these marks ("" if it is), and the line's `proof` as it answered.

        Raises DriverError where it is not known: it does not answer, or hangs up between its answers.
        """
        for _ in range(_MOST_ROUNDS):
            _, unanswered = self._line.proof
            reason, proofs = await self._marks(marks, urgent=urgent)
            # Answers that came over several connections, or around a silence, may be several devices'. A connection
            # that ended before the first one does not matter: nothing that was asked over it is answered over the next.
            if reason or (len(set(proofs)) == 1 and proofs[0][1] == unanswered):
                return reason, proofs[-1]
        raise ReplyMismatch(
            "the device hangs up, or leaves a question unanswered, before all its marks are told: pin one that tells "
            "it alone"
        )

    async def _marks(self, marks: Sequence[PinnedMark], *, urgent: bool) -> tuple[str, list[tuple[int, int]]]:
        unit, heard, proofs = self._settings.unit, dict[str, str](), list[tuple[int, int]]()
        names = {mark.name for mark in marks}
        said: str | tuple[int, ...] | None
        async with self._lock:
            for mark in marks:
                try:
                    if mark.object < 0:
                        request = mark_request(mark, unit) if mark.count else server_id_request(unit)
                        said = mark.found((await self._request_identity(request, proofs, urgent=urgent)).words)
                    else:
                        if mark.name not in heard:
                            await self._hear(mark, names, heard, proofs, urgent=urgent)
                        said = heard.get(mark.name)
                except DeviceException as error:
                    if error.code not in _SAYS_NOTHING:
                        raise
                    said = None
                if reason := stranger(mark, said, f"{self._settings.place} unit {unit}"):
                    return reason, proofs
        return "", proofs

    async def _hear(
        self,
        mark: PinnedMark,
        names: Set[str],
        heard: dict[str, str],
        proofs: list[tuple[int, int]],
        *,
        urgent: bool,
    ) -> None:
        """Ask for the objects of an identification (function 43) up to the one that is wanted; keep those of `names`.

        Of the others a device may say another thing each time, such as how long it has been on.
        """
        after = 0
        for _ in range(MOST_PARTS):
            request = object_request(self._settings.unit, after, mark.object)
            part, after = identification((await self._request_identity(request, proofs, urgent=urgent)).words)
            take_part(heard, {name: text for name, text in part.items() if name in names})
            if not after or mark.name in heard:
                return

    async def _request_identity(self, request: ModbusPDU, proofs: list[tuple[int, int]], *, urgent: bool) -> WireReply:
        """Ask who the device is, as often as a reading is asked for; `proofs` gets the line's as it has answered."""
        try:
            reply = await self._repeat(lambda again: self._line.ask(request, again=again, urgent=urgent))
        except DeviceException as error:
            self._reached = error.code not in NO_WAY_TO_UNIT
            raise
        finally:
            proofs.append(self._line.proof)
        self._reached = True
        return reply


class PinnedDriver(ModbusDriver):
    """A driver that believes and writes nothing unless the device has said that it is the pinned one (`identity`).

    It is asked on each connection, after each question without an answer, by which a cable that was put elsewhere shows
    on a line, and every IDENTITY_S seconds.
    """

    _proof: tuple[int, int] | None = None
    _proven_at = 0.0
    _stranger = ""

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """As any driver; where the device is not known to be the pinned one all readings are bad.

        One that hangs up after each answer is believed where it is the pinned one before the reading and after it.
        """
        try:
            if (unknown := await self._unproven(urgent=False)) is None:
                # As `super().read` does it, over the connection of the proof.
                samples = await self._scan(tags)
                # What came over a connection that was made meanwhile may be another device's, as what followed a
                # silence.
                if (unknown := await self._unproven(urgent=False)) is None:
                    return samples
            self._paced.clear()  # what was kept of this reading may be another device's
            return [self._no(tag, *unknown) for tag in tags]
        finally:
            if self._settings.close_between_scans:
                self._line.rest()

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """As any driver; raises LinkDown, and nothing is sent, where the device is not known to be the pinned one."""
        if (unknown := await self._unproven(urgent=True)) is not None:
            if self._settings.close_between_scans:
                self._line.rest()
            raise LinkDown(f"{unknown[1]}; nothing was sent")
        proof = self._line.proof

        def to_the_pinned_one() -> None:
            if self._line.proof != proof:
                raise LinkDown("the connection has changed since the device said who it is; nothing (more) was sent")
            before_sending()

        await super().write(values, before_sending=to_the_pinned_one)

    def complaints(self) -> tuple[str, ...]:
        """That another device than the pinned one answers."""
        return (self._stranger,) if self._stranger else ()

    async def _unproven(self, *, urgent: bool) -> tuple[Quality, str] | None:
        """Why the device is not known to be the pinned one, which is asked if need be; None where it is."""
        if self._settings.close_between_scans:
            await self._line.ready()
        if self._proof == self._line.proof and _now() < self._proven_at + IDENTITY_S:
            return None
        self._proof = None
        try:
            self._stranger, proof = await self.who(self._settings.identity, urgent=urgent)
        except ReplyTimeout as error:
            return Quality.TIMEOUT, f"{_NOT_KNOWN}: {error}"
        except LinkDown as error:
            return Quality.NOT_CONNECTED, str(error)
        except DeviceException as error:
            return exception_quality(error.code), f"{_NOT_KNOWN}: {error}"
        except DriverError as error:
            return Quality.COMMUNICATION_ERROR, f"{_NOT_KNOWN}: {error}"
        if self._stranger:
            return Quality.NOT_CONNECTED, self._stranger
        self._proof, self._proven_at = proof, _now()
        return None


# ---------------------------------------------------------------- without state


def _now() -> float:
    return asyncio.get_running_loop().time()


def _with_values(samples: Mapping[int, Sample]) -> dict[int, Sample]:
    return {key: sample for key, sample in samples.items() if sample.value is not None}


def _lies_outside(one: AddressBlock, other: AddressBlock) -> bool:
    return one.area is not other.area or one.stop <= other.start or other.stop <= one.start


def _words(spans: Iterable[TagSpan]) -> int:
    """How many registers of a block follow one another at most: what a write of neighbours can come to."""
    longest, run, before = 0, 0, None
    for number in sorted(number for span in spans if not span.area.is_bits for number in range(span.start, span.stop)):
        run = run + 1 if before is not None and number == before + 1 else 1
        longest, before = max(longest, run), number
    return longest


def _words_of_wide(registers: Sequence[int]) -> tuple[int, ...]:
    """Registers of 32 bits as words of 16, the upper one first: as they come."""
    return tuple(word for register in registers for word in (register >> 16, register & 0xFFFF))


def _wide_reader(tag: Tag) -> Callable[[Sequence[int]], Reading]:
    """As `reader`, of registers of 32 bits."""
    read = reader(tag)
    return lambda registers: read(_words_of_wide(registers))


def _writable(tag: Tag, wide: Sequence[WideRange]) -> TagSpan:
    """The tag's place, if the protocol can write it. Raises AddressError where it cannot."""
    span = locate(tag, wide)
    if span.wide is not None:
        raise AddressError(f"{tag.name}: {tag.address} has 32 bits (wide_registers), and such registers are read alone")
    if not span.area.is_writable:
        raise AddressError(f"{tag.name}: {tag.address} is read-only by protocol: write to holding or coil addresses")
    if tag.bit is not None:
        raise AddressError(f"{tag.name}: one bit of a register cannot be written without touching the other fifteen")
    if tag.scale_from:
        raise AddressError(f"{tag.name}: what is written has a scale of its own; take scale_from out")
    return span
