"""Blocks that a command writes, under the rules of the gateway: armed, permitted, in the write map, accounted for."""

import asyncio
import fcntl
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from random import Random, SystemRandom
from struct import pack
from typing import Any

import click

from drivers.device_file import STATUS_TAGS
from drivers.driver import Driver, Writes, capabilities
from drivers.errors import DriverError, WriteForbidden, WriteUnverified
from drivers.tag import Sample
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, audit_path
from gateway.commission.writeback.suite import Account, Unable
from gateway.console import CommandResult, Progress, Rows, progress
from gateway.machine.writing import (
    FAILED,
    REFUSED,
    WRITE,
    Arming,
    SessionWords,
    Validity,
    build,
    find_places,
    next_heartbeat,
    obstacle,
    parse_arming,
    uptime,
)
from gateway.settings import DeviceMap, WritebackLayout
from gateway.store import (
    ARMED,
    EXPIRED,
    Audit,
    AuditEntry,
    AuditRow,
    WitnessPlaces,
    armings,
    end_reason,
    find_arming,
    open_audit,
)

PERMIT_S = 1.0
"""How long ago the permit may have been asked for when a block is sent."""
SETTLE_S = 3.0
"""The longest wait for the PLC's program to have looked at what was written."""
_BEATS = 3
_POLL_S = 0.02
_WITHOUT_HEARTBEAT_S = 0.5
NOTHING: Mapping[str, float | None] = {"input_quality": 2.0, "zone": 0.0, "alarms": 0.0}
"""The values of a block that takes everything back."""
Ask = Callable[[str], bool]


def arming_in_force(places: WitnessPlaces, now: float, subject: str = "") -> Arming:
    """The arming of a subject in force. Raises WriteForbidden without one, AuditError, SigningKeyError.

    One on a log that lacks a row whose head was signed is none: what it lacks may be the disarming.
    """
    path = places.audit
    row = find_arming(path, now, uptime(), key=places.key, subject=subject)
    if row is None:
        _note_the_end(places, now, subject)
        raise WriteForbidden(
            f"not armed: nothing is written; arm first: decanter arm --by NAME --reason WHY --minutes N (audit log "
            f"{path})"
        )
    if why := obstacle(places)[0]:
        raise WriteForbidden(f"not armed: nothing is written: {why}")
    return parse_arming(row)


def _note_the_end(places: WitnessPlaces, now: float, subject: str) -> None:
    """Put on record that an arming is over, so that it stays so whatever the clock does after this."""
    path = places.audit
    last = next(armings(path, places.key, subject=subject), None)
    if last is None or last.entry.kind != ARMED:
        return
    if not (why := end_reason(path, last, now, uptime())):
        return
    with closing(open_audit(path)) as audit:
        audit.record(AuditEntry(now, EXPIRED, last.entry.who, why).with_subject(subject))


def require_layouts(site: Site) -> tuple[DeviceMap, tuple[WritebackLayout, ...]]:
    """The device file and its blocks. Raises ValueError where there is none."""
    device = site.target.map
    if device is None:
        raise ValueError("which block? Give the device file (--device FILE) or the plant file (--config FILE)")
    if not device.writebacks:
        raise ValueError(f"{device.path}: has no [writeback] table; there is no block to write")
    return device, device.writebacks


def gateway_runs(historian: Path) -> bool:
    """True while a gateway holds the historian's lock."""
    lock = historian.with_name(historian.name + ".lock")
    if not lock.exists():
        return False
    with lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@dataclass(slots=True)
class BlockWriter:
    """One command that writes the block `layout` as writer `number`; `key` is the gateway's, which confirms armings.

    `ask` asks the person, None where nobody is to be asked.
    `taking_back`: the arming has been taken back already, and the only block left to write is that which says so.
    `subject` is what its arming and its rows of the audit log are about.
    """

    device: DeviceMap
    layout: WritebackLayout
    driver: Driver
    writes: Writes
    audit: Audit
    arming: Arming
    key: Path
    number: int
    ask: Ask | None = None
    taking_back: bool = False
    subject: str = ""
    sequence: int = 0
    heartbeat: int = 0
    written: int = field(default=0, init=False)

    # ---------------------------------------------------------------- writing

    async def send(self, words: Sequence[int], offset: int = 0) -> None:
        """Write words into the block's area, once. Raises WriteForbidden (nothing was sent) or another DriverError."""
        # Asked for each write: the arming may have run out or been taken back since the last one, the permit too.
        asked = time.monotonic()

        def check() -> None:
            self._check_arming()
            if (waited := time.monotonic() - asked) > PERMIT_S:
                raise WriteForbidden(
                    f"the permit was read {waited:.2f} s ago ({PERMIT_S:g} s at most); nothing was sent"
                )

        try:
            self._check_arming()
            if not await self.has_permit():
                raise WriteForbidden("the PLC does not permit writing (WritePermit); nothing was sent")
            # On the disk before it is sent: whatever comes of it, no write is without its row.
            if not await self.audit.stored(self._entry(WRITE, words, "", offset)):
                why = self.audit.failure or "the disk does not answer"
                raise WriteForbidden(f"no audit record could be kept, so nothing was sent: {why}")
            check()
        except WriteForbidden as error:
            await self._note(self._entry(REFUSED, words, str(error), offset))
            raise
        tags = self.layout.words[offset : offset + len(words)]
        try:
            await self.writes.write(list(zip(tags, words, strict=True)), before_sending=check)
        except DriverError as error:
            await self._note(self._entry(FAILED, words, str(error), offset))
            raise
        self.written += 1

    async def block(
        self, values: Mapping[str, float | None] = NOTHING, validity: Validity = Validity.NONE, *, beat: bool = True
    ) -> tuple[int, ...]:
        """Write the next whole block; with `beat` False its heartbeat is the last one's. Raises as `send`."""
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.heartbeat = next_heartbeat(self.heartbeat) if beat else self.heartbeat
        (challenge,) = await self.numbers(self.layout.tag("Challenge"))
        session = SessionWords(
            challenge=challenge, writer=self.number, sequence=self.sequence, heartbeat=self.heartbeat
        )
        words = build(self.layout, values, validity, session).words
        await self.send(words)
        return words

    def _check_arming(self) -> None:
        if self.taking_back:
            return
        now = time.time()
        row = find_arming(self.audit.path, now, uptime(), key=self.key, subject=self.subject)
        if now >= self.arming.until or row is None:
            raise WriteForbidden("the arming is over; nothing was sent")

    async def has_permit(self) -> bool:
        """The PLC's permit, as it reads now; False where it is not known."""
        sample = (await self.read("WritePermit"))[0]
        return sample.quality.is_good and bool(sample.value)

    async def _note(self, entry: AuditEntry) -> None:
        if not await self.audit.stored(entry):
            self.audit.put(entry)

    def _entry(self, kind: str, words: Sequence[int], reason: str, offset: int) -> AuditEntry:
        detail = {"words": pack(f">{len(words)}H", *words).hex(), "offset": offset, "via": "command"}
        if self.layout.suffix:
            detail["block"] = self.layout.suffix
        return AuditEntry(time.time(), kind, self.arming.by, reason, detail).with_subject(self.subject)

    # ---------------------------------------------------------------- reading

    async def read(self, *names: str) -> list[Sample]:
        """The tags by their names. Raises ValueError for one that the device file lacks."""
        known = self.device.by_name
        missing = [name for name in names if name not in known]
        if missing:
            raise ValueError(f"{self.device.path}: has no tag {missing[0]!r}, by which the PLC answers; add it")
        return await self.driver.read([known[name] for name in names])

    async def numbers(self, *names: str) -> list[int]:
        """The tags as whole numbers, once they read well. Raises DriverError if they do not within SETTLE_S."""
        deadline = time.monotonic() + SETTLE_S
        while True:
            samples = await self.read(*names)
            if all(sample.quality.is_good for sample in samples):
                return [int(sample.value) for sample in samples if not isinstance(sample.value, str | None)]
            if time.monotonic() > deadline:
                bad = next(sample for sample in samples if not sample.quality.is_good)
                raise DriverError(f"{bad.tag} cannot be read: {bad.reason}")
            await asyncio.sleep(_POLL_S)

    async def wait_for_scans(self) -> None:
        """Wait until the PLC's program has surely looked at its memory: until its heartbeat has moved some times."""
        beat = self.device.heartbeat
        if beat is None:
            await asyncio.sleep(_WITHOUT_HEARTBEAT_S)
            return
        # A change alone may be of a scan that had begun before the write.
        deadline, seen = time.monotonic() + SETTLE_S, set(await self.numbers(beat))
        while len(seen) <= _BEATS:
            if time.monotonic() > deadline:
                raise DriverError(f"the PLC's heartbeat {beat} has not moved for {SETTLE_S:g} s; its program stands")
            await asyncio.sleep(_POLL_S)
            seen |= set(await self.numbers(beat))

    # ---------------------------------------------------------------- suite.PlcSide

    async def account(self) -> Account:
        """What the PLC says of the blocks, once it has looked at them."""
        await self.wait_for_scans()
        accepted, refused, code, usable, challenge, session, other = await self.numbers(
            *(self.layout.tag(name) for name in STATUS_TAGS)
        )
        return Account(
            accepted=accepted,
            refused=refused,
            last_refusal=code,
            usable=bool(usable),
            challenge=challenge,
            session_writer=session,
            refused_writer=other,
        )

    async def write(self, offset: int, words: Sequence[int]) -> None:
        """`send`, for the suite: what cannot be sent is a step that cannot be put. Raises Unable.

        A link whose device acknowledges accepted blocks alone (CANopen) cannot confirm one that is to be refused: what
        became of it is for the PLC's account to say.
        """
        if len(words) < len(self.layout.words) and capabilities(self.device.driver).block == "frames":
            raise Unable("over this link a block is several frames, and a part of it is no write of its own")
        try:
            with suppress(WriteUnverified):
                await self.send(words, offset)
        except WriteForbidden as error:
            raise Unable(str(error)) from None

    async def wait(self, seconds: float) -> None:
        """Let so much time pass."""
        await asyncio.sleep(seconds)

    async def permit(self, on: bool) -> None:
        """Have a person give or take the permit, unless it is as it has to be. Raises Unable."""
        if await self.has_permit() == on:
            return
        word = "give" if on else "take away"
        if self.ask is None or not self.ask(f"Please {word} the write permit at the PLC. Done?"):
            raise Unable(f"nobody was there to {word} the permit (--ask)")
        await self.wait_for_scans()
        if await self.has_permit() != on:
            raise Unable("the permit has not changed")


@asynccontextmanager
async def open_block_writers(
    site: Site,
    audit_path: Path,
    ask: Ask | None = None,
    *,
    taking_back: AuditRow | None = None,
    rng: Random | None = None,
) -> AsyncIterator[tuple[BlockWriter, ...]]:
    """The writers of one command, one for each block, with one connection.

    At their end a block of validity 0 is written by each that has written any. `taking_back` is the arming that has
    just been taken back, for the one block that says so to the PLC. `rng` draws their number as a writer, by default
    from the system's randomness. Raises WriteForbidden where it is not armed or a gateway runs, AuditError,
    DriverError, ValueError.
    """
    device, layouts = require_layouts(site)
    places, subject = find_places(audit_path, site.target.config), site.target.subject
    # Before the look at the arming: beside a gateway that writes on, the newest record may be later than that look.
    if site.target.config is not None and gateway_runs(site.target.config.historian.path):
        raise ValueError("a gateway runs with this plant file and writes the same block; stop it for this test")
    arming = parse_arming(taking_back) if taking_back is not None else arming_in_force(places, time.time(), subject)
    with closing(open_audit(audit_path)) as audit:
        async with site.driver(device.block_words) as driver:
            if not isinstance(driver, Writes):
                raise WriteForbidden("this driver cannot write")
            begun = int(time.time()) & 0xFFFF  # where the last command left off is not known
            number = (rng or SystemRandom()).randint(1, 0xFFFF)
            writers = tuple(
                BlockWriter(
                    device=device,
                    layout=layout,
                    driver=driver,
                    writes=driver,
                    audit=audit,
                    arming=arming,
                    key=places.key,
                    number=number,
                    ask=ask,
                    taking_back=taking_back is not None,
                    subject=subject,
                    sequence=begun,
                    heartbeat=begun or 1,
                )
                for layout in layouts
            )
            try:
                yield writers
            finally:
                for writer in writers:
                    if writer.written:
                        # The PLC's timer covers a last block that cannot be written; the audit log has the reason.
                        with suppress(DriverError, ValueError):
                            await writer.block()


def with_block_writers(
    given: SharedOptions,
    audit: Path | None,
    title: str,
    work: Callable[[Sequence[BlockWriter], Progress], Awaitable[CommandResult]],
    *,
    ask: bool = False,
) -> Callable[[Site], Awaitable[CommandResult]]:
    """The work with the writers of all blocks, and a bar on a terminal where nobody is asked."""

    async def open_and_work(site: Site) -> CommandResult:
        asked = partial(click.confirm, default=False, err=True) if ask else None
        async with open_block_writers(site, audit_path(audit, given, site.target), asked) as writers:
            if ask:
                return await work(writers, lambda _name, _share: None)
            with progress(title) as report:
                return await work(writers, report)

    return open_and_work


def of_each_block(
    work: Callable[[BlockWriter, Progress], Awaitable[CommandResult]],
) -> Callable[[Sequence[BlockWriter], Progress], Awaitable[CommandResult]]:
    """The work for one block after the other, as one result: all rows, each with its block where there are several."""

    async def work_each(writers: Sequence[BlockWriter], report: Progress) -> CommandResult:
        results = [(writer.layout.temperature or "", await work(writer, report)) for writer in writers]
        return results[0][1] if len(results) == 1 else join_results(results)

    return work_each


def join_results(results: Sequence[tuple[str, CommandResult]]) -> CommandResult:
    """Results of several blocks as one: their rows with the block's name, their counts summed, the first complaint."""
    data: dict[str, Any] = {}
    for _, result in results:
        for key, value in result.data.items():
            is_count = isinstance(value, int) and not isinstance(value, bool)
            data[key] = data.get(key, 0) + value if is_count else data.get(key, value)
    data["rows"] = [{**row, "block": name} for name, result in results for row in result.data["rows"]]
    failed = [f"{name}: {result.complaint}" for name, result in results if result.complaint]
    return CommandResult(data, "; ".join(failed), max(result.code for _, result in results))


def rows_of_test(title: str, data: Mapping[str, Any], cells: Callable[[Mapping[str, Any]], dict[str, Any]]) -> Rows:
    """A test's rows for a person: how each went, of which block where there are several, and its cells by columns."""
    rows = []
    for row in data["rows"]:
        state = "skipped" if row.get("skipped") else "ok" if row["ok"] else "FAILED"
        rows.append({"": state, **({"block": row["block"]} if "block" in row else {}), **cells(row)})
    return Rows(title, list(rows[0]), rows)
