"""Writing back: off, shadow or armed; armed for a limited time, only with the PLC's permit, each block at most once.

What is given to the wire, and what was refused on the way there, goes into the audit log: a block's row is under way to
the disk before the block is sent, and one that failed gets a second row. What cannot be accounted for is not written.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from struct import pack
from typing import Any, Literal

from drivers.driver import Writes
from drivers.errors import DriverError
from gateway.machine.reading import Clock, Scan
from gateway.machine.writing.block import SessionWords, Validity, WritebackBlock, build, next_heartbeat
from gateway.settings import WritebackLayout
from gateway.store import DISARMED, EXPIRED, Audit, AuditEntry

Mode = Literal["off", "shadow", "armed"]
Verdict = Literal["shadow", "written", "failed", "not permitted", "held back"]

WRITE, FAILED, REFUSED, REFUSED_BY_PLC = "write", "write failed", "write refused", "refused by the PLC"
"""Kinds of the audit log's rows."""

ANOTHER_CHALLENGE, ANOTHER_WRITER = "another challenge", "another writer"
"""The contract's reasons by which a PLC refuses a block of no session, or of another writer than the session's."""


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


@dataclass(frozen=True, slots=True)
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


_COUNTED: Mapping[Verdict, Callable[[Counters], Counters]] = {
    "written": lambda c: replace(c, written=c.written + 1),
    "failed": lambda c: replace(c, failed=c.failed + 1),
    "not permitted": lambda c: replace(c, not_permitted=c.not_permitted + 1),
    "held back": lambda c: replace(c, held_back=c.held_back + 1),
    "shadow": lambda c: replace(c, shadow=c.shadow + 1),
}


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
    """The one place from which the gateway writes. `driver` is None where nothing can be written (off, shadow).

    The sequence moves on with every block, so that a block that failed is never sent again. `number` (1..65535, drawn
    anew at each start) tells this writer from another; `challenge` is the PLC's that the newest block on the wire
    carried, 0 before the first. `pace` bounds the blocks a second, `audit` takes an account of every one.
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
    challenge: int = field(default=0, init=False)

    @property
    def armed(self) -> bool:
        """True while blocks are written to the PLC."""
        return self.mode == "armed" and self.driver is not None and self.arming is not None

    def expired(self, now: float) -> bool:
        """True once the arming's time is over: say so to the PLC (`withdraw`), then `disarm`."""
        return self.armed and self.arming is not None and now >= self.arming.until

    def arm(self, driver: Writes, arming: Arming) -> None:
        """From now on blocks are written; the audit log has to have it already (`gateway.machine.writing.arming`)."""
        self.mode, self.driver, self.arming = "armed", driver, arming

    def disarm(self, now: float = 0.0, by: str = "", reason: str = "") -> None:
        """Fall back to shadow: blocks are computed and stored, and none is written."""
        arming = self.arming
        if arming is not None:
            over = now >= arming.until
            self._note(AuditEntry(now, EXPIRED if over else DISARMED, by or arming.by, reason or "the arming is over"))
        self.mode, self.arming = "shadow" if self.mode == "armed" else self.mode, None

    async def offer(self, scan: Scan, values: Mapping[str, float | None], validity: Validity) -> Attempt | None:
        """Build the block of this scan and do with it what the mode says; None when the mode is off."""
        if self.mode == "off":
            return None
        return await self._attempt(values, validity, scan)

    async def withdraw(self, scan: Scan, alarms: int = 0) -> Attempt | None:
        """Write a block of validity 0 once, if armed and permitted: of what stands in the PLC only `alarms` is true."""
        values = {"alarms": float(alarms), "zone": 0.0, "input_quality": 2.0}
        return await self._attempt(values, Validity.NONE, scan, last=True) if self.armed else None

    def take_counts(self, scan: Scan, refusals: Mapping[int, str]) -> str:
        """Take over what the PLC says of the blocks, as far as this scan read it well.

        Gives the sentence of a refusal that a person has to know of, "" where there is none.
        """
        taken, rejected, c = scan.good("BlocksAccepted"), scan.good("BlocksRefused"), self.counters
        # Both or neither: the two are an account of the same blocks.
        if taken is None or rejected is None:
            return ""
        accepted, refused = int(taken), int(rejected)
        more = _increase(c.plc_refused, refused)
        # LastRefusal stands until the next one; it says something new only if the count has moved since.
        code = scan.good("LastRefusal")
        why = refusals.get(int(code), f"code {code:g}") if more and code is not None else c.last_refusal
        # A session may end (timer, permit, restart) between the scan that read its challenge and the block that
        # follows: that block is refused once, and the next scan's challenge opens another session. This is no attack.
        challenge = _word(scan, "Challenge")
        ended = bool(more) and why == ANOTHER_CHALLENGE and self.challenge not in (0, challenge)
        other, sentence = c.other_writer, why if more and not ended else ""
        if more and why == ANOTHER_WRITER:
            session, refused_writer = _word(scan, "SessionWriter"), _word(scan, "RefusedWriter")
            # Of the two the PLC names, the other is the one that is not this gateway's.
            theirs = refused_writer if session == self.number else session
            other = theirs or other
            role = "was refused" if session == self.number else "has the session"
            sentence = f"{why}: number {theirs or 'unknown'} {role} at the PLC, this gateway is number {self.number}"
        if sentence and self.armed:
            detail = {"blocks": more, "sequence": self.sequence}
            self._note(AuditEntry(scan.time, REFUSED_BY_PLC, "PLC", sentence, detail))
        self.counters = replace(
            c,
            accepted=c.accepted + _increase(c.plc_accepted, accepted),
            refused=c.refused + more,
            last_refusal=why,
            other_writer=other,
            sessions_ended=c.sessions_ended + ended,
            plc_accepted=accepted,
            plc_refused=refused,
        )
        return sentence

    async def _attempt(
        self, values: Mapping[str, float | None], validity: Validity, scan: Scan, *, last: bool = False
    ) -> Attempt:
        """Build one block, send it if it may be sent, and keep account of what became of it.

        `last`: the block that takes everything back is neither too late nor too fast, nor waits for a full disk.
        """
        # The sequence moves on before anything can fail: a number that was given to the wire is never given again.
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.heartbeat = next_heartbeat(self.heartbeat)
        marked = validity if self.armed else validity | Validity.SHADOW
        challenge = _word(scan, "Challenge")
        session = SessionWords(
            challenge=challenge, writer=self.number, sequence=self.sequence, heartbeat=self.heartbeat
        )
        block = build(self.layout, values, marked, session)
        if not self.armed or self.driver is None:
            attempt = Attempt(scan.time, block, self.mode, "shadow")
        elif (refused := self._refusal(scan, last=last)) is not None:
            attempt = Attempt(scan.time, block, self.mode, refused[0], reason=refused[1])
        else:
            # Its row is under way to the disk before the block is on the wire; one that fails gets a second row.
            self._note(AuditEntry(scan.time, WRITE, self._by, "", _plain(block)))
            self.challenge = challenge
            try:
                await self.driver.write(list(zip(self.layout.words, block.words, strict=True)))
            except DriverError as error:
                # Never sent again: the device may have taken it, and the next scan brings a newer block anyway.
                attempt = Attempt(scan.time, block, self.mode, "failed", reason=str(error))
            else:
                # Both moments are the plant's; divided by the clock's speed they are real time, also in a replay.
                latency = (self.clock.now() - scan.time) / self.clock.speed * 1000.0
                attempt = Attempt(scan.time, block, self.mode, "written", latency)
        self.counters = _COUNTED[attempt.verdict](self.counters)
        if attempt.verdict in ("failed", "not permitted", "held back"):
            kind = FAILED if attempt.verdict == "failed" else REFUSED
            self._note(AuditEntry(scan.time, kind, self._by, attempt.reason, _plain(block)))
        return attempt

    def _refusal(self, scan: Scan, *, last: bool) -> tuple[Verdict, str] | None:
        """Why a block is not sent, and what that counts as; None if it may be."""
        now = self.clock.now()
        if not last and self.expired(now):
            return "not permitted", "the arming is over"
        if not last and self.audit is not None and self.audit.complaint:
            return "not permitted", f"no audit record could be kept: {self.audit.complaint}"
        # The permit counts as this scan read it: one of doubtful quality is none.
        if not scan.good("WritePermit"):
            permit = scan.samples.get("WritePermit")
            if permit is None:
                return "not permitted", "the register map has no WritePermit"
            if permit.quality.is_good:
                return "not permitted", "the PLC does not permit it"
            return "not permitted", f"WritePermit is not known: {permit.reason}"
        # By the challenge the PLC knows a block as made after its session began: without one it would refuse it.
        if not _word(scan, "Challenge"):
            sample = scan.samples.get("Challenge")
            if sample is None:
                return "not permitted", "the register map has no Challenge, which the PLC's side has to publish"
            if sample.quality.is_good:
                return "not permitted", "the PLC publishes no challenge yet (0)"
            return "not permitted", f"Challenge is not known: {sample.reason}"
        # The pace comes last, since asking takes a token: a block that is refused anyway must not use one up.
        if not last and self.pace is not None and not self.pace.allows(now / self.clock.speed):
            return "held back", f"more than {self.pace.rate:g} blocks a second"
        return None

    @property
    def _by(self) -> str:
        return self.arming.by if self.arming else ""

    def _note(self, entry: AuditEntry) -> None:
        if self.audit is not None:
            self.audit.put(entry)


def _plain(block: WritebackBlock) -> dict[str, Any]:
    """The block as the audit log keeps it: its words high byte first, as they go on the wire."""
    words = pack(f">{len(block.words)}H", *block.words).hex()
    return {"sequence": block.sequence, "validity": int(block.validity), "words": words}


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
