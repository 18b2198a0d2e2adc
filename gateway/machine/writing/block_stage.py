"""The block of a scan: what goes into its fields, whether the PLC may use them, and what became of it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from random import Random
from struct import pack
from typing import TYPE_CHECKING

from drivers.driver import Driver
from drivers.supervision import Supervisor
from gateway.machine.model import ZONES, ScanPrediction, block_values
from gateway.machine.reading import Clock, Scan
from gateway.machine.writing.arming import ArmingError, arm, open_writer, signed
from gateway.machine.writing.block import Validity, validity
from gateway.machine.writing.witnessing import SIGN_SECONDS, HeadWitnessing, clear_for_arming, obstacle
from gateway.machine.writing.writeback import Arming, Attempt
from gateway.settings import Config, WritebackLayout
from gateway.store import HistorianView, open_or_set_aside, saved_state
from sim.forecast import Forecast

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


LATENCIES = 10_000
STARTS_KEPT = 8
"""So many of the gateway's numbers are kept: one that is killed and killed again knows its own by them."""


class BlockStage:
    """The stage that writes, in shadow or armed; a machine that computes nothing for writing has none.

    What was tried is on record and in the log at once. `attempt` is the newest one, `latencies` (ms) are those of the
    newest blocks that were written. Opening it raises ConfigError or AuditError.
    """

    def __init__(
        self,
        config: Config,
        layout: WritebackLayout,
        *,
        clock: Clock,
        driver: Driver,
        historian: HistorianView,
        supervisor: Supervisor,
        log: FilteringBoundLogger,
        rng: Random,
        log_failure: Callable[[], str] = lambda: "",
        subject: str = "",
    ) -> None:
        self.config = config
        self._clock, self._driver, self._historian, self._log = clock, driver, historian, log
        self._supervisor = supervisor
        self._refusals: Mapping[int, str] = {code: reason for reason, code in config.map.refusals.items()}
        self._refused = ""
        self.attempt: Attempt | None = None
        self.latencies: deque[float] = deque(maxlen=LATENCIES)
        self.audit, damaged = open_or_set_aside(config.audit, supervisor)
        if damaged:
            log.error("the audit log was damaged", reason=damaged)
        self.witnessing = HeadWitnessing(config, historian, log)
        self._signed = clock.now()
        self._signing: asyncio.Task[None] | None = None
        opened = False
        try:
            self.writer = open_writer(
                config,
                layout,
                clock=clock,
                driver=driver,
                historian=historian,
                audit=self.audit,
                log=log,
                rng=rng,
                obstacle=lambda: log_failure() or obstacle(self.witnessing.places)[0],
                subject=subject,
            )
            writers = saved_state(historian, "writers", log)
            formers = [int(number) for number in writers[1].get("numbers", ())] if writers else []
            self.writer.formers = frozenset(formers)
            historian.save("writers", self._signed, {"numbers": [*formers, self.writer.number][-STARTS_KEPT:]})
            self.witnessing.sign(self._signed)
            opened = True
        finally:
            if not opened:
                self.audit.close()

    def _sign(self, now: float) -> None:
        """Sign the newest head in a thread: no scan waits for the disk."""
        self._signed = now
        self._signing = self._supervisor.job("signing", partial(self.witnessing.sign, now))

    def take_counts(self, scan: Scan) -> None:
        """Take over what the PLC says of the blocks before this one."""
        refused = self.writer.take_counts(scan, self._refusals)
        # The same refusal of every block is one line; every one is counted, and on record.
        if refused and refused != self._refused and self.writer.armed:
            self._log.warning("the PLC refuses blocks", reason=refused, writer=self.writer.number)
        self._refused = refused or self._refused

    async def take(
        self,
        scan: Scan,
        prediction: ScanPrediction | None,
        forecast: Forecast | None,
        *,
        alarms: int,
        model_hash: str = "",
        unverified: str = "",
    ) -> None:
        """Offer the block of this scan: `alarms` is its alarm word, `model_hash` the model's, where one predicts.

        `unverified` says why the model must not write ("" if it may): one that does not verify is never armed.
        """
        self.take_counts(scan)
        if scan.time - self._signed >= SIGN_SECONDS:
            self._sign(scan.time)
        # Taking back comes first: no block of an arming that is over may follow it.
        if over := self._disarming(scan.time, unverified):
            await self.disarm("", over, scan, alarms)
        state = Validity.NONE
        if prediction is not None:
            state = validity(
                inputs=prediction.inputs_good,
                location=prediction.known and not prediction.borrowed,
                forecast=forecast is not None,
                model=True,
                familiar=prediction.zone != "red",
            )
        values = self._values(scan, prediction, forecast, model_hash) | {"alarms": float(alarms)}
        attempt = await self.writer.offer(scan, values, state)
        if attempt is not None:
            self._record(attempt)

    def _disarming(self, now: float, unverified: str) -> str:
        """Why the gateway has to disarm itself at this scan; "" if it has not."""
        if not self.writer.armed:
            return ""
        if self.writer.expired(now):
            return "the arming is over"
        return f"the model that runs does not verify: {unverified}" if unverified else ""

    def _values(
        self, scan: Scan, p: ScanPrediction | None, forecast: Forecast | None, model_hash: str
    ) -> dict[str, float | None]:
        """The block's fields; a number that is not known is left out, and the block says so."""
        if p is None:
            bad = any(scan.good(name) is None for name in self.config.watched)
            return {"zone": 0.0, "input_quality": 2.0 if bad else 0.0}
        values = {
            "zone": float(ZONES.index(p.zone)),
            "input_quality": float(p.worst),
            "age": p.age,
            "location": float(p.location_index) if p.known and not p.borrowed else None,
            "temperature_now": p.mean,
            "band_low": p.low,
            "band_high": p.high,
            "anomaly": p.anomaly,
            # A register has 16 bits: the hash's last four digits tell one model from the next, and prove nothing.
            "model_hash": float(int(model_hash[-4:], 16)),
        }
        return values | (block_values(forecast, self.config.block_horizon, scan.time) if forecast else {})

    async def withdraw(self, why: str, scan: Scan, alarms: int) -> None:
        """Tell the PLC once, if armed and permitted, that nothing of ours is to be used any more."""
        if not self.writer.armed:
            return
        attempt = await self.writer.withdraw(scan, alarms)
        if attempt is not None:
            self._record(attempt)
        verdict = attempt.verdict if attempt else "off"
        by = self.writer.arming.by if self.writer.arming else ""
        self._historian.put("audit", [(self._clock.now(), f"validity 0: {verdict}", by, why)])

    async def arm(
        self, by: str, reason: str, minutes: float, *, unverified: str = "", acknowledged: Sequence[str] = ()
    ) -> Arming:
        """Let blocks be written from the next scan on; `acknowledged` are heads of lost rows. Raises ArmingError."""
        if unverified:
            raise ArmingError(f"the model that runs does not verify: {unverified}")
        signed(by, reason, minutes, self._clock.now())  # what is not even signed leaves no row
        witnessing, generation = self.witnessing, self.writer.generation
        key = await asyncio.to_thread(
            clear_for_arming,
            witnessing.places,
            self.audit.record,
            by=by,
            now=self._clock.now(),
            acknowledged=acknowledged,
            sinks=witnessing.sinks,
        )
        if self.writer.generation != generation:
            raise ArmingError("not armed: it was disarmed meanwhile; arm again if that is still wanted")
        arming = await arm(self.writer, self._driver, by=by, reason=reason, minutes=minutes, key=key)
        self._historian.put("audit", [(self._clock.now(), f"armed until {arming.until:.0f}", arming.by, arming.reason)])
        self._log.warning("armed", by=arming.by, reason=arming.reason, until=arming.until)
        await asyncio.to_thread(witnessing.sign, self._clock.now())
        return arming

    async def disarm(self, by: str, reason: str, scan: Scan | None, alarms: int) -> bool:
        """Take back what stands in the PLC, as the last block that leaves, and write no more; False: it was not armed.

        `by` is "" where the gateway disarms itself; `scan` is the newest one.
        """
        now, arming = self._clock.now(), self.writer.arming
        stamp = self.config.path.stat().st_mtime if self.config.path.exists() else self.config.stamp
        attempt = await self.writer.disarm(now, by, reason, scan=scan, alarms=alarms, stamp=stamp)
        if attempt is not None:
            self._record(attempt)
        # A disarming that could be cut off unnoticed would leave the arming before it as the newest word.
        self._sign(now)
        if arming is None:
            return False
        who, verdict = by or arming.by, attempt.verdict if attempt else "off"
        self._historian.put("audit", [(now, f"validity 0: {verdict}", arming.by, reason)])
        if by:
            self._historian.put("audit", [(now, "disarmed", by, reason)])
        self._log.warning("disarmed", by=who, reason=reason)
        return True

    def close(self) -> bool:
        """Store what waits, sign the last head and close the audit log; False if entries had to be given up."""
        complete = self.audit.close()
        if complete:
            self.witnessing.sign(self._clock.now())
        return complete

    def _record(self, attempt: Attempt) -> None:
        before, self.attempt = self.attempt, attempt
        block = attempt.block
        # The words are stored high byte first, as they went on the wire.
        words = pack(f">{len(block.words)}H", *block.words)
        row = (attempt.time, block.sequence, attempt.mode, attempt.verdict, int(block.validity))
        self._historian.put("writes", [(*row, attempt.latency_ms, attempt.reason, words)])
        if attempt.latency_ms is not None:
            self.latencies.append(attempt.latency_ms)
        # Every attempt is on record; the log has a line only where something is another than before.
        if before is None or (before.verdict, before.reason) != (attempt.verdict, attempt.reason):
            write_line = self._log.info if attempt.verdict in ("written", "shadow") else self._log.warning
            write_line("write-back", verdict=attempt.verdict, reason=attempt.reason, sequence=block.sequence)
