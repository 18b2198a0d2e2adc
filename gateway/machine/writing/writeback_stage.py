"""All blocks of one machine: one audit log with its witnesses, one arming, one number, and a stage for each block."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from drivers.driver import Driver
from drivers.supervision import Supervisor
from gateway.machine.reading import Clock, Scan
from gateway.machine.writing.arming import ArmingError, arm, newest_stamp, open_writers, sign_arming
from gateway.machine.writing.block_stage import BlockStage
from gateway.machine.writing.witnessing import SIGN_SECONDS, HeadWitnessing, clear_for_arming, obstacle
from gateway.machine.writing.writeback import Arming, disarm_writers
from gateway.settings import Config, WritebackLayout
from gateway.store import NO_PROCESS, Audit, HistorianView, ReliedFiles, open_or_set_aside, saved_state
from sim.moments import exact_moment

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


LONGEST_REASON = 300
"""Characters of why the gateway disarms itself."""
STARTS_KEPT = 8
"""So many of the gateway's numbers are kept: one that is killed and killed again knows its own by them."""


@dataclass(frozen=True, slots=True)
class AuditTrail:
    """The audit log and its witnesses: opened once, for all blocks whose writes it accounts for."""

    audit: Audit
    witnessing: HeadWitnessing

    def close(self, now: float) -> bool:
        """Store what waits, sign the last head and close the audit log; False if entries had to be given up."""
        complete = self.audit.close()
        if complete:
            self.witnessing.sign(now)
        return complete


def open_audit_trail(
    config: Config,
    *,
    historian: HistorianView,
    supervisor: Supervisor,
    log: FilteringBoundLogger,
    files: ReliedFiles | None = None,
) -> AuditTrail:
    """The audit log of a plant file; a damaged one is set aside. `files` are those that the gateway relies on."""
    audit = open_or_set_aside(config.audit, supervisor, files)
    if audit.note:
        log.error("the audit log was damaged", reason=audit.note)
    return AuditTrail(audit, HeadWitnessing(config, historian, log, audit.files))


class WritebackStage:
    """The stage that writes, in shadow or armed; a machine that computes nothing for writing has none.

    `blocks` are in the order of `layouts`, and so are `of_blocks`, the historian as their rows are kept in it, and the
    alarm words that the methods take. The caller closes `trail`.
    Opening it raises ConfigError or AuditError.
    """

    def __init__(
        self,
        config: Config,
        layouts: Sequence[WritebackLayout],
        trail: AuditTrail,
        *,
        clock: Clock,
        driver: Driver,
        historian: HistorianView,
        of_blocks: Sequence[HistorianView],
        supervisor: Supervisor,
        log: FilteringBoundLogger,
        rng: Random,
        log_failure: Callable[[], str] = lambda: "",
    ) -> None:
        self.config, self.audit, self.witnessing = config, trail.audit, trail.witnessing
        self._clock, self._driver, self._historian, self._log = clock, driver, historian, log
        self._supervisor = supervisor
        self._files, self._taken = trail.audit.files, trail.audit.files.taken
        self._asked, self._settled = 0, asyncio.Event()
        self._settled.set()
        self._signed = clock.now()
        self._signing: asyncio.Task[None] | None = None
        self._writers = open_writers(
            config,
            layouts,
            clock=clock,
            driver=driver,
            historian=historian,
            audit=trail.audit,
            log=log,
            rng=rng,
            obstacle=lambda: self._files.look() or log_failure() or obstacle(self.witnessing.places)[0],
        )
        self.blocks = tuple(
            BlockStage(config, writer, clock=clock, historian=own, log=log)
            for writer, own in zip(self._writers, of_blocks, strict=True)
        )
        saved = saved_state(historian, "writers", log)
        formers = [int(number) for number in saved[1].get("numbers", ())] if saved else []
        for writer in self._writers:
            writer.formers = frozenset(formers)
        historian.save("writers", self._signed, {"numbers": [*formers, self._writers[0].number][-STARTS_KEPT:]})
        self.witnessing.sign(self._signed)

    @property
    def armed(self) -> bool:
        """True while blocks are written to the PLC."""
        return any(writer.armed for writer in self._writers)

    @contextmanager
    def _count_request(self) -> Iterator[None]:
        """A person's word, or the gateway's own, is being carried out meanwhile."""
        self._asked += 1
        self._settled.clear()
        try:
            yield
        finally:
            self._asked -= 1
            if not self._asked:
                self._settled.set()

    async def settle(self) -> None:
        """Wait until all that was said about the arming is carried out: it is on record then, or waits to be.

        Each has deadlines of its own.
        """
        await self._settled.wait()

    def rival(self, now: float) -> str:
        """The PLC's word of another writer that writes one of the blocks now; "" where there is none."""
        return next((word for writer in self._writers if (word := writer.rival(now))), "")

    def _sign(self, now: float) -> None:
        """Sign the newest head in a thread: no scan waits for the disk."""
        self._signed = now
        self._signing = self._supervisor.job("signing", partial(self.witnessing.sign, now, self.witnessing.turn()))

    async def begin(self, scan: Scan, alarms: Sequence[int], unverified: str = "") -> None:
        """What comes before the blocks of a scan: the PLC's account of those before, the hourly head, a due disarming.

        `unverified` says why a model must not write ("" if all may): one that does not verify is never armed.
        """
        for block in self.blocks:
            block.take_counts(scan)
        # One after the other: where a disk is slow, or the clock jumps, heads come later.
        signing = self._signing is not None and not self._signing.done()
        if scan.time - self._signed >= SIGN_SECONDS and not signing:
            self._sign(scan.time)
        # Taking back comes first: no block of an arming that is over may follow it.
        if over := self._disarm_reason(scan.time, unverified):
            await self.disarm("", over, scan, alarms)

    def _disarm_reason(self, now: float, unverified: str) -> str:
        """Why the gateway has to disarm itself at this scan; "" if it has not."""
        if not self.armed:
            return ""
        if any(writer.expired(now) for writer in self._writers):
            return "the arming is over"
        if ended := next((word for writer in self._writers if (word := writer.foreign_end)), ""):
            return ended[:LONGEST_REASON]
        if self._files.taken != self._taken:
            return f"a file that it relies on was taken away: {self._files.note}"[:LONGEST_REASON]
        return f"the model that runs does not verify: {unverified}" if unverified else ""

    async def withdraw(self, why: str, scan: Scan, alarms: Sequence[int]) -> None:
        """Tell the PLC once, if armed and permitted, that nothing of ours is to be used any more."""
        for block, word in zip(self.blocks, alarms, strict=True):
            await block.withdraw(why, scan, word)

    async def arm(
        self,
        by: str,
        reason: str,
        minutes: float,
        *,
        unverified: str = "",
        acknowledged: Sequence[str] = (),
        process: Mapping[str, int] = NO_PROCESS,
    ) -> Arming:
        """Let blocks be written from the next scan on; `acknowledged` are heads of lost rows. Raises ArmingError."""
        if unverified:
            raise ArmingError(f"the model that runs does not verify: {unverified}")
        sign_arming(by, reason, minutes, self._clock.now())  # what is not even signed leaves no row
        with self._count_request():
            return await self._arm(by, reason, minutes, acknowledged, process)

    async def _arm(
        self, by: str, reason: str, minutes: float, acknowledged: Sequence[str], process: Mapping[str, int]
    ) -> Arming:
        witnessing, generations = self.witnessing, [writer.generation for writer in self._writers]
        taken = self._files.taken
        key = await asyncio.to_thread(
            clear_for_arming,
            witnessing.places,
            self.audit.record,
            by=by,
            now=self._clock.now(),
            acknowledged=acknowledged,
            sinks=witnessing.sinks,
        )
        if [writer.generation for writer in self._writers] != generations:
            raise ArmingError("not armed: it was disarmed meanwhile; arm again if that is still wanted")
        self._taken = taken
        arming = await arm(
            self._writers,
            self._driver,
            by=by,
            reason=reason,
            minutes=minutes,
            key=key,
            process=process,
            armed_for=self.config.arming_hash,
        )
        said = f"armed until {exact_moment(arming.until)}"
        self._historian.put("audit", [(self._clock.now(), said, arming.by, arming.reason)])
        self._log.warning("armed", by=arming.by, reason=arming.reason, until=arming.until)
        await asyncio.to_thread(witnessing.sign, self._clock.now(), witnessing.turn())
        return arming

    async def disarm(
        self,
        by: str,
        reason: str,
        scan: Scan | None,
        alarms: Sequence[int],
        *,
        process: Mapping[str, int] = NO_PROCESS,
    ) -> bool:
        """Take back what stands in the PLC, as the last blocks that leave, and write no more; False: it was not armed.

        `by` is "" where the gateway disarms itself; `scan` is the newest one.
        """
        with self._count_request():
            return await self._disarm(by, reason, scan, alarms, process)

    async def _disarm(
        self, by: str, reason: str, scan: Scan | None, alarms: Sequence[int], process: Mapping[str, int]
    ) -> bool:
        now, arming = self._clock.now(), next((writer.arming for writer in self._writers if writer.arming), None)
        stamp = newest_stamp(self.config)
        attempts = await disarm_writers(
            self._writers, now, by, reason, scan=scan, alarms=alarms, audit=self.audit, stamp=stamp, process=process
        )
        for block, attempt in zip(self.blocks, attempts, strict=True):
            if attempt is not None:
                block.record(attempt)
        # A disarming that could be cut off unnoticed would leave the arming before it as the newest word.
        self._sign(now)
        if arming is None:
            return False
        for attempt in attempts:
            self._historian.put(
                "audit", [(now, f"validity 0: {attempt.verdict if attempt else 'off'}", arming.by, reason)]
            )
        if by:
            self._historian.put("audit", [(now, "disarmed", by, reason)])
        self._log.warning("disarmed", by=by or arming.by, reason=reason)
        return True
