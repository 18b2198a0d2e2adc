"""The block of a scan: what goes into its fields, whether the PLC may use them, and what became of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from struct import pack
from typing import TYPE_CHECKING

from gateway.machine.model import ZONES, ScanPrediction, block_values
from gateway.machine.reading import Clock, Scan
from gateway.machine.writing.block import Validity, validity
from gateway.machine.writing.writeback import Attempt, Writer
from gateway.settings import Config
from gateway.store import HistorianView
from sim.forecast import Forecast

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


MAX_KEPT_LATENCIES = 10_000


class BlockStage:
    """The stage that writes one block, in shadow or armed; the machine's blocks have one `WritebackStage`.

    What was tried is on record and in the log at once. `attempt` is the newest one, `latencies` (ms) are those of the
    newest blocks that were written.
    """

    def __init__(
        self, config: Config, writer: Writer, *, clock: Clock, historian: HistorianView, log: FilteringBoundLogger
    ) -> None:
        self.config, self.writer = config, writer
        self._clock, self._historian, self._log = clock, historian, log
        self._refusals: Mapping[int, str] = {code: reason for reason, code in config.map.refusals.items()}
        self._refused = ""
        # Of several blocks each line of the log says which one it is of.
        self._which = {"block": writer.layout.temperature} if writer.layout.blocks > 1 else {}
        self.attempt: Attempt | None = None
        self.latencies: deque[float] = deque(maxlen=MAX_KEPT_LATENCIES)

    def take_counts(self, scan: Scan) -> None:
        """Take over what the PLC says of the blocks before this one."""
        refused = self.writer.take_counts(scan, self._refusals)
        # The same refusal of every block is one line; every one is counted, and on record.
        if refused and refused != self._refused and self.writer.armed:
            self._log.warning("the PLC refuses blocks", reason=refused, writer=self.writer.number, **self._which)
        self._refused = refused or self._refused

    async def take(
        self,
        scan: Scan,
        prediction: ScanPrediction | None,
        forecast: Forecast | None,
        *,
        alarms: int,
        model_hash: str = "",
    ) -> None:
        """Offer the block of this scan: `alarms` is its alarm word, `model_hash` the model's, where one predicts."""
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
            self.record(attempt)

    def _values(
        self, scan: Scan, p: ScanPrediction | None, forecast: Forecast | None, model_hash: str
    ) -> dict[str, float | None]:
        """The block's fields; a number that is not known is left out, and the block says so."""
        if p is None:
            bad = any(scan.good(name) is None for name in self.config.watched_temperatures)
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
            self.record(attempt)
        verdict = attempt.verdict if attempt else "off"
        by = self.writer.arming.by if self.writer.arming else ""
        self._historian.put("audit", [(self._clock.now(), f"validity 0: {verdict}", by, why)])

    def record(self, attempt: Attempt) -> None:
        """Put on record what became of a block."""
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
            write_line(
                "write-back", verdict=attempt.verdict, reason=attempt.reason, sequence=block.sequence, **self._which
            )
