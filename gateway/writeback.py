"""Writing back: off, shadow or armed; armed for a limited time, only with the PLC's permit, each block at most once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from drivers.driver import Writes
from drivers.errors import DriverError
from gateway.block import Block, Validity, build, next_heartbeat
from gateway.clock import Clock
from gateway.devices import WritebackLayout
from gateway.scan import Scan

Mode = Literal["off", "shadow", "armed"]
Verdict = Literal["shadow", "written", "failed", "not permitted"]


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
    block: Block
    mode: Mode
    verdict: Verdict
    latency_ms: float | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Counters:
    """Blocks by what became of them here, and by what the PLC says of them since the gateway's start.

    `accepted` and `refused` sum the changes of the PLC's wrapping 16-bit counters; one that falls without having been
    near its end was set to zero by a restart of the PLC.
    """

    written: int = 0
    failed: int = 0
    not_permitted: int = 0
    shadow: int = 0
    accepted: int = 0
    refused: int = 0
    last_refusal: str = ""
    plc_accepted: int | None = None
    plc_refused: int | None = None


_COUNTED: Mapping[Verdict, Callable[[Counters], Counters]] = {
    "written": lambda c: replace(c, written=c.written + 1),
    "failed": lambda c: replace(c, failed=c.failed + 1),
    "not permitted": lambda c: replace(c, not_permitted=c.not_permitted + 1),
    "shadow": lambda c: replace(c, shadow=c.shadow + 1),
}


@dataclass(slots=True)
class Writer:
    """The one place from which the gateway writes. `driver` is None where nothing can be written (off, shadow).

    The sequence moves on with every block, so that a block that failed is never sent again.
    """

    layout: WritebackLayout
    clock: Clock
    mode: Mode
    driver: Writes | None = None
    arming: Arming | None = None
    sequence: int = 0
    heartbeat: int = 0
    counters: Counters = field(default_factory=Counters)

    @property
    def armed(self) -> bool:
        """True while blocks are written to the PLC."""
        return self.mode == "armed" and self.driver is not None and self.arming is not None

    def expired(self, now: float) -> bool:
        """True once the arming's time is over: say so to the PLC (`withdraw`), then `disarm`."""
        return self.armed and self.arming is not None and now >= self.arming.until

    def disarm(self) -> None:
        """Fall back to shadow: blocks are computed and stored, and none is written."""
        self.mode, self.arming = "shadow" if self.mode == "armed" else self.mode, None

    async def offer(self, scan: Scan, values: Mapping[str, float | None], validity: Validity) -> Attempt | None:
        """Build the block of this scan and do with it what the mode says; None when the mode is off."""
        if self.mode == "off":
            return None
        attempt = await self._sent(self._next(values, validity), scan)
        self.counters = _COUNTED[attempt.verdict](self.counters)
        return attempt

    async def withdraw(self, scan: Scan, alarms: int = 0) -> Attempt | None:
        """Write a block of validity 0 once, if armed and permitted: of what stands in the PLC only `alarms` is true."""
        values = {"alarms": float(alarms), "zone": 0.0, "input_quality": 2.0}
        return await self.offer(scan, values, Validity.NONE) if self.armed else None

    def heard(self, scan: Scan, refusals: Mapping[int, str]) -> None:
        """Take over what the PLC says of the blocks, as far as this scan read it well."""
        counts, c = (scan.good("BlocksAccepted"), scan.good("BlocksRefused")), self.counters
        if counts[0] is None or counts[1] is None:
            return
        accepted, refused = int(counts[0]), int(counts[1])
        more = _increase(c.plc_refused, refused)
        code = scan.good("LastRefusal")
        why = refusals.get(int(code), f"code {code:g}") if more and code is not None else c.last_refusal
        self.counters = replace(
            c,
            accepted=c.accepted + _increase(c.plc_accepted, accepted),
            refused=c.refused + more,
            last_refusal=why,
            plc_accepted=accepted,
            plc_refused=refused,
        )

    def _next(self, values: Mapping[str, float | None], validity: Validity) -> Block:
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.heartbeat = next_heartbeat(self.heartbeat)
        shadow = validity if self.armed else validity | Validity.SHADOW
        return build(self.layout, values, shadow, self.sequence, self.heartbeat)

    async def _sent(self, block: Block, scan: Scan) -> Attempt:
        if not self.armed or self.driver is None:
            return Attempt(scan.time, block, self.mode, "shadow")
        if not scan.good("WritePermit"):
            return Attempt(scan.time, block, self.mode, "not permitted", reason=_why_not(scan))
        try:
            await self.driver.write(list(zip(self.layout.words, block.words, strict=True)))
        except DriverError as error:
            return Attempt(scan.time, block, self.mode, "failed", reason=str(error))
        latency = (self.clock.now() - scan.time) / self.clock.speed * 1000.0
        return Attempt(scan.time, block, self.mode, "written", latency)


def _why_not(scan: Scan) -> str:
    sample = scan.samples.get("WritePermit")
    if sample is None:
        return "the register map has no WritePermit"
    return "the PLC does not permit it" if sample.quality.is_good else f"WritePermit is not known: {sample.reason}"


def _increase(before: int | None, now: int) -> int:
    if before is None:
        return 0
    if now >= before:
        return now - before
    return now + 0x10000 - before if before > 0xF000 and now < 0x1000 else now
