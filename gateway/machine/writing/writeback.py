"""Writing back: off, shadow or armed; armed for a limited time, only with the PLC's permit, each block at most once.

What is given to the wire, and what was refused on the way there, goes into the audit log: a block's row is on the disk
before the block is sent, and one that failed or was stopped after that gets a second row. What cannot be accounted for
is not written; the one exception is the block that takes everything back, which a disk may delay and not prevent.

Check and send are one step, under one lock. What lets a block go is looked at again as the very last thing before the
wire (`drivers.driver.BeforeSending`): the arming's generation, its end, the permit, how old the readings are. What no
program can see is a stop of its own process between that look and the system's call that sends: some microseconds.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from struct import pack
from typing import Any, Literal

from drivers.driver import Writes
from drivers.errors import DriverError, WriteForbidden
from gateway.machine.reading import Clock, Scan
from gateway.machine.writing.block import SessionWords, Validity, Values, WritebackBlock, block_builder, next_heartbeat
from gateway.settings import WritebackLayout
from gateway.store import DISARMED, EXPIRED, NO_PROCESS, Audit, AuditEntry, subject_detail

Mode = Literal["off", "shadow", "armed"]
Verdict = Literal["shadow", "written", "failed", "not permitted", "held back"]

WRITE, FAILED, REFUSED, REFUSED_BY_PLC = "write", "write failed", "write refused", "refused by the PLC"
"""Kinds of the audit log's rows."""

ANOTHER_CHALLENGE, ANOTHER_WRITER = "another challenge", "another writer"
"""The contract's reasons by which a PLC refuses a block of no session, or of another writer than the session's."""
SENDING_SECONDS = 0.25
"""The longest (real time) from counting a block's age until it is sent, the wait for its audit row included."""
RIVAL_SECONDS = 10.0
"""For so long (real time) another writer is one that writes now; and so long after a start, the start before may have
the session still: a PLC's timer ends it within 5 s."""
DISARMED_SECONDS = 2.0
"""The longest wait for the disk to take the row of a disarming; then it goes on being tried without anybody waiting."""


@dataclass(frozen=True, slots=True)
class Arming:
    """Who armed the gateway and why; it ends at `until` (plant seconds UTC), whatever happens."""

    by: str
    reason: str
    until: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """What became of one block. `latency_ms` (real time) runs from the scan's last reply to the confirmed write."""

    time: float
    block: WritebackBlock
    mode: Mode
    verdict: Verdict
    latency_ms: float | None = None
    reason: str = ""


@dataclass(slots=True)
class Counters:
    """Blocks by what became of them here, and by what the PLC says of them since the gateway's start.

    `accepted` and `refused` sum the changes of the PLC's wrapping 16-bit counters; one that falls without having been
    near its end was set to zero by a restart of the PLC. `other_writer` is the number of the newest other writer that
    this PLC has named. `sessions_ended`: blocks refused because their session had ended on the way, which is normal.
    """

    written: int = 0
    failed: int = 0
    not_permitted: int = 0
    held_back: int = 0
    shadow: int = 0
    accepted: int = 0
    refused: int = 0
    last_refusal: str = ""
    other_writer: int | None = None
    sessions_ended: int = 0
    plc_accepted: int | None = None
    plc_refused: int | None = None

    def count(self, verdict: Verdict) -> None:
        """Count a block by what became of it here."""
        name = verdict.replace(" ", "_")
        setattr(self, name, getattr(self, name) + 1)


@dataclass(slots=True)
class Pace:
    """The most blocks a second: a bucket of `rate` tokens that fills at `rate` a second, real time."""

    rate: float
    _tokens: float = field(default=0.0, init=False)
    _at: float | None = field(default=None, init=False)

    def allows(self, moment: float) -> bool:
        """True, and a token less, if a block may be sent at `moment` (real seconds)."""
        # Token bucket. It begins full, and holds one token at least: with a rate below one block a second a bucket of
        # `rate` would never fill up to the one that a block costs.
        most = max(1.0, self.rate)
        gained = most if self._at is None else (moment - self._at) * self.rate
        self._tokens, self._at = min(most, self._tokens + gained), moment
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


@dataclass(slots=True)
class Writer:
    """The one place from which the gateway writes the block `layout`.

    `driver` is None where nothing can be written (off, shadow).

    The sequence moves on with every block that may have been sent, so that one that failed is never sent again.
    `number` (1..65535, drawn anew at each start) tells this writer from another; `challenge` is the PLC's that the
    newest block on the wire carried, 0 before the first. `pace` bounds the blocks a second, `audit` takes an
    account of every one. `max_age` (real s) is how old the readings of a block may be, and its permit, when it is
    sent. `armed_at` is its arming's row of the audit log, `generation` counts the disarmings, `ending` those that are
    under way. `formers` are the numbers of this gateway's starts before. `subject` is what its rows of the audit log
    are about.
    """

    layout: WritebackLayout
    clock: Clock
    mode: Mode
    number: int
    driver: Writes | None = None
    arming: Arming | None = None
    sequence: int = 0
    heartbeat: int = 0
    counters: Counters = field(default_factory=Counters)
    pace: Pace | None = None
    audit: Audit | None = None
    max_age: float = 1.0
    formers: frozenset[int] = frozenset()
    subject: str = ""
    challenge: int = field(default=0, init=False)
    armed_at: int = field(default=0, init=False)
    generation: int = field(default=0, init=False)
    ending: int = field(default=0, init=False)
    _sending: asyncio.Lock = field(default_factory=asyncio.Lock, init=False)
    _build: Callable[[Values, Validity, SessionWords], WritebackBlock] = field(init=False)
    _began: float = field(init=False)
    _rival: tuple[float, str] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._build, self._began = block_builder(self.layout), self.clock.now()

    def rival(self, now: float) -> str:
        """The PLC's word of another writer that writes now, and what to do about it; "" where there is none."""
        if not self.armed or self._rival is None or (now - self._rival[0]) / self.clock.speed > RIVAL_SECONDS:
            return ""
        return self._rival[1]

    @property
    def armed(self) -> bool:
        """True while blocks are written to the PLC."""
        return self.mode == "armed" and self.driver is not None and self.arming is not None

    def expired(self, now: float) -> bool:
        """True once the arming's time is over: say so to the PLC (`withdraw`), then `disarm`."""
        return self.armed and self.arming is not None and now >= self.arming.until

    def arm(self, driver: Writes, arming: Arming, row: int = 0) -> None:
        """From now on blocks are written; the audit log has it, as this row (`gateway.machine.writing.arming`)."""
        self.mode, self.driver, self.arming, self.armed_at = "armed", driver, arming, row

    @property
    def foreign_end(self) -> str:
        """That another program has taken the arming back in the audit log, as a sentence; "" if none has."""
        ended = None if self.audit is None else self.audit.ended_elsewhere.get(self.subject)
        if ended is None or ended.row <= self.armed_at:
            return ""
        return f"{ended.who} took the arming back in the audit log (row {ended.row}): {ended.reason}"

    async def disarm(
        self,
        now: float = 0.0,
        by: str = "",
        reason: str = "",
        *,
        scan: Scan | None = None,
        alarms: int = 0,
        stamp: float | None = None,
    ) -> Attempt | None:
        """Fall back to shadow; with the newest `scan` a block of validity 0 is the last that leaves, and its attempt.

        It is `disarm_writers` of this writer alone.
        """
        return (
            await disarm_writers([self], now, by, reason, scan=scan, alarms=[alarms], audit=self.audit, stamp=stamp)
        )[0]

    async def offer(self, scan: Scan, values: Mapping[str, float | None], validity: Validity) -> Attempt | None:
        """Build the block of this scan and do with it what the mode says; None when the mode is off.

        The `age` in `values` is that at the scan's time; it is counted on until the block is sent.
        """
        if self.mode == "off":
            return None
        async with self._sending:
            return await self._attempt(values, validity, scan, self.arming)

    async def take_back(self, former: Arming | None, scan: Scan | None, alarms: int) -> Attempt | None:
        """Write a block of validity 0 as the last one of `former`, an arming that is taken back already."""
        async with self._sending:  # also where none is to be written: a block that is under way ends first
            if former is None or scan is None:
                return None
            return await self._attempt(_withdrawal_values(alarms), Validity.NONE, scan, former, last=True)

    async def withdraw(self, scan: Scan, alarms: int = 0) -> Attempt | None:
        """Write a block of validity 0 once, if armed and permitted: of what stands in the PLC only `alarms` is true."""
        async with self._sending:  # also where nothing is armed any more: a disarming that is under way ends first
            if not self.armed:
                return None
            return await self._attempt(_withdrawal_values(alarms), Validity.NONE, scan, self.arming, last=True)

    def take_counts(self, scan: Scan, refusals: Mapping[int, str]) -> str:
        """Take over what the PLC says of the blocks, as far as this scan read it well.

        Gives the sentence of a refusal that a person has to know of, "" where there is none.
        """
        tag, c = self.layout.tag, self.counters
        taken, rejected = scan.good(tag("BlocksAccepted")), scan.good(tag("BlocksRefused"))
        # Both or neither: the two are an account of the same blocks.
        if taken is None or rejected is None:
            return ""
        accepted, refused = int(taken), int(rejected)
        more = _increase(c.plc_refused, refused)
        # LastRefusal stands until the next one; it says something new only if the count has moved since.
        code = scan.good(tag("LastRefusal"))
        why = refusals.get(int(code), f"code {code:g}") if more and code is not None else c.last_refusal
        # A session may end (timer, permit, restart) between the scan that read its challenge and the block that
        # follows: that block is refused once, and the next scan's challenge opens another session. This is no attack.
        challenge = _word(scan, tag("Challenge"))
        ended = bool(more) and why == ANOTHER_CHALLENGE and self.challenge not in (0, challenge)
        other, sentence = c.other_writer, why if more and not ended else ""
        if more and why == ANOTHER_WRITER:
            session, refused_writer = _word(scan, tag("SessionWriter")), _word(scan, tag("RefusedWriter"))
            # Of the two the PLC names, the other is the one that is not this gateway's.
            theirs = refused_writer if session == self.number else session
            other = theirs or other
            role = "was refused" if session == self.number else "has the session"
            sentence = f"{why}: number {theirs or 'unknown'} {role} at the PLC, this gateway is number {self.number}"
            if theirs in self.formers and (scan.time - self._began) / self.clock.speed <= RIVAL_SECONDS:
                sentence += "; it is this gateway's start before, whose session the PLC's timer ends"
            else:
                sentence += "; find the gateway whose status has that number, and disarm one of the two"
                self._rival = scan.time, sentence
        if sentence and self.armed:
            detail = {"blocks": more, "sequence": self.sequence, **self._which}
            self._note(AuditEntry(scan.time, REFUSED_BY_PLC, "PLC", sentence, detail))
        c.accepted += _increase(c.plc_accepted, accepted)
        c.refused += more
        c.last_refusal, c.other_writer, c.sessions_ended = why, other, c.sessions_ended + ended
        c.plc_accepted, c.plc_refused = accepted, refused
        return sentence

    async def _attempt(
        self,
        values: Mapping[str, float | None],
        validity: Validity,
        scan: Scan,
        arming: Arming | None,
        *,
        last: bool = False,
    ) -> Attempt:
        """Build one block, send it if it may be sent, and keep account of what became of it (the lock is held).

        `last`: the block that takes everything back is neither too late nor too fast, nor waits for a full disk.
        """
        sequence, heartbeat = (self.sequence + 1) & 0xFFFF, next_heartbeat(self.heartbeat)
        driver, by = self.driver, arming.by if arming else ""
        armed = arming is not None and driver is not None
        generation, built = self.generation, self.clock.now()
        if (age := values.get("age")) is not None:
            values = {**values, "age": age + max(0.0, built - scan.time)}
        marked = validity if armed else validity | Validity.SHADOW
        challenge = _word(scan, self.layout.tag("Challenge"))
        session = SessionWords(challenge=challenge, writer=self.number, sequence=sequence, heartbeat=heartbeat)
        block = self._build(values, marked, session)

        def objection() -> tuple[Verdict, str] | None:
            """Why the block must not be sent now, and what that counts as."""
            now = self.clock.now()
            if last:
                return self._permit_obstacle(scan)
            if self.generation != generation:
                return "not permitted", "it was disarmed meanwhile"
            if ended := self.foreign_end:
                return "not permitted", ended
            if arming is not None and now >= arming.until:
                return "not permitted", "the arming is over"
            if self.audit is not None and (complaint := self.audit.subject_complaint(self.subject)):
                return "not permitted", f"no audit record could be kept: {complaint}"
            if unpermitted := self._permit_obstacle(scan):
                return unpermitted
            # From the first request on: a device may have looked at its memory long before its reply was complete.
            old = (now - scan.time + scan.duration) / self.clock.speed
            if old > self.max_age:
                return "held back", f"its readings are {old:.2f} s old, which may be {self.max_age:g} s"
            read = (now - scan.samples["WritePermit"].time) / self.clock.speed
            if read > self.max_age:
                return "held back", f"WritePermit was read {read:.2f} s ago, which may be {self.max_age:g} s"
            waited = (now - built) / self.clock.speed
            if waited > SENDING_SECONDS:
                return "held back", f"it waited {waited:.2f} s to be sent, which may be {SENDING_SECONDS:g} s"
            return None

        refused: tuple[Verdict, str] | None = None

        def before_sending() -> None:
            nonlocal refused
            if (refused := objection()) is not None:
                raise WriteForbidden(refused[1])

        if armed:
            refused = objection()
            # The pace comes last, since asking takes a token: a block that is refused anyway must not use one up.
            asked = self.clock.now() / self.clock.speed
            if refused is None and not last and self.pace is not None and not self.pace.allows(asked):
                refused = "held back", f"more than {self.pace.rate:g} blocks a second"
            if refused is None and self.audit is not None:
                # Its subject from the beginning: an entry that is made is looked through for what no row may hold.
                entry = AuditEntry(scan.time, WRITE, by, "", subject_detail(self.subject, self._plain(block)))
                if not await self.audit.stored(entry, SENDING_SECONDS):
                    if last:
                        self.audit.put(entry)
                    elif self.audit.failure:
                        refused = "not permitted", f"no audit record could be kept: {self.audit.failure}"
                    else:
                        refused = "held back", f"the audit log has not taken its row within {SENDING_SECONDS:g} s"
        if refused is None:
            # A number that may have been given to the wire is never given again. One that was not is: a PLC takes no
            # block that is more than 100 ahead, and a fast gateway would be beyond that after a second without permit.
            self.sequence, self.heartbeat = sequence, heartbeat
        if not armed or driver is None:
            attempt = Attempt(scan.time, block, self.mode, "shadow")
        elif refused is not None:
            attempt = Attempt(scan.time, block, "armed", refused[0], reason=refused[1])
        else:
            self.challenge = challenge
            try:
                words = list(zip(self.layout.words, block.words, strict=True))
                await driver.write(words, before_sending=before_sending)
            except DriverError as error:
                # Never sent again: the device may have taken it, and the next scan brings a newer block anyway.
                failed: tuple[Verdict, str] = ("failed", str(error))
                verdict, reason = refused or failed
                attempt = Attempt(scan.time, block, "armed", verdict, reason=reason)
            else:
                # Both moments are the plant's; divided by the clock's speed they are real time, also in a replay.
                latency = (self.clock.now() - scan.time) / self.clock.speed * 1000.0
                attempt = Attempt(scan.time, block, "armed", "written", latency)
        self.counters.count(attempt.verdict)
        if attempt.verdict in ("failed", "not permitted", "held back"):
            kind = FAILED if attempt.verdict == "failed" else REFUSED
            self._note(AuditEntry(scan.time, kind, by, attempt.reason, self._plain(block)))
        return attempt

    def _permit_obstacle(self, scan: Scan) -> tuple[Verdict, str] | None:
        """Why the PLC would not use a block, as this scan read it: no permit, or no challenge to make the block with.

        One of doubtful quality is none.
        """
        if scan.good("WritePermit"):
            # By the challenge the PLC knows a block as made after its session began: without one it would refuse it.
            name = self.layout.tag("Challenge")
            if _word(scan, name):
                return None
            sample = scan.samples.get(name)
            if sample is None:
                return "not permitted", f"the register map has no {name}, which the PLC's side has to publish"
            if sample.quality.is_good:
                return "not permitted", "the PLC publishes no challenge yet (0)"
            return "not permitted", f"{name} is not known: {sample.reason}"
        permit = scan.samples.get("WritePermit")
        if permit is None:
            return "not permitted", "the register map has no WritePermit"
        if permit.quality.is_good:
            return "not permitted", "the PLC does not permit it"
        return "not permitted", f"WritePermit is not known: {permit.reason}"

    @property
    def _which(self) -> dict[str, str]:
        """Which block it is, for the audit log; a row of the first one says nothing of it."""
        return {"block": self.layout.suffix} if self.layout.suffix else {}

    def _plain(self, block: WritebackBlock) -> dict[str, Any]:
        """The block as the audit log keeps it: its words high byte first, as they go on the wire."""
        words = pack(f">{len(block.words)}H", *block.words).hex()
        return {"sequence": block.sequence, "validity": int(block.validity), "words": words, **self._which}

    def _note(self, entry: AuditEntry) -> None:
        if self.audit is not None:
            self.audit.put(entry.with_subject(self.subject))


async def disarm_writers(
    writers: Sequence[Writer],
    now: float,
    by: str = "",
    reason: str = "",
    *,
    alarms: Sequence[int],
    audit: Audit | None,
    scan: Scan | None = None,
    stamp: float | None = None,
    process: Mapping[str, int] = NO_PROCESS,
) -> list[Attempt | None]:
    """Let the writers of one arming fall back to shadow; with the newest `scan` each one's last block has validity 0.

    Gives what became of these blocks; `alarms` are their alarm words. When this returns nothing usable leaves any more,
    and the row is on record; also where nothing was armed, so that the newest word of a person is known. `stamp` is the
    plant file's time of change, where there is one, `process` the program by which a person asks.
    """
    formers = [writer.arming for writer in writers]
    former = next((arming for arming in formers if arming is not None), None)
    # The generations go first, without waiting: what is on its way to the wire is stopped there, whichever block it is.
    for writer in writers:
        writer.mode, writer.arming = "shadow" if writer.mode == "armed" else writer.mode, None
        writer.generation += 1
        writer.ending += 1
    try:
        attempts = await asyncio.gather(
            *(
                writer.take_back(arming, scan, word)
                for writer, arming, word in zip(writers, formers, alarms, strict=True)
            )
        )
        if audit is not None and (former is not None or by):
            over = former is not None and not by and now >= former.until
            who, why = by or (former.by if former else ""), reason or "the arming is over"
            detail = {**process, **({} if stamp is None else {"stamp": stamp})}
            entry = AuditEntry(now, EXPIRED if over else DISARMED, who, why, detail)
            await audit.keep(entry.with_subject(writers[0].subject), DISARMED_SECONDS)
        return attempts
    finally:
        for writer in writers:
            writer.ending -= 1


def _withdrawal_values(alarms: int) -> dict[str, float | None]:
    return {"alarms": float(alarms), "zone": 0.0, "input_quality": 2.0}


def _word(scan: Scan, name: str) -> int:
    """A number of the PLC's own area, as this scan read it well; 0 where it did not, which says "none" there."""
    value = scan.good(name)
    return int(value) if value is not None and 0 <= value <= 0xFFFF else 0


def _increase(before: int | None, now: int) -> int:
    if before is None:
        return 0  # the first look: what stands there was counted for a gateway before this one
    if now >= before:
        return now - before
    # It fell: near its end a 16-bit counter has wrapped, anywhere else the PLC began anew and counts from 0.
    return now + 0x10000 - before if before > 0xF000 and now < 0x1000 else now
