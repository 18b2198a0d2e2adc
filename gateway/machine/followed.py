"""One temperature that a machine follows: perhaps a model of it, perhaps a block that is written back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gateway.machine.model import FinishedForecast, ModelUnit, ScanPrediction
from gateway.machine.reading import Scan
from gateway.machine.records import prediction_rows
from gateway.machine.writing import BlockStage
from gateway.settings import Config

if TYPE_CHECKING:
    from gateway.store import HistorianView
    from sim.forecast import Forecast


class FollowedTemperature:
    """What a machine has for each of its temperatures; `model` is None without one, `block` where none is computed.

    `config` is the machine's with this temperature's model and limit, `historian` its own rows. In a scan the methods
    are called in their order here; what `predict` found is kept until the next scan.
    """

    def __init__(self, config: Config, historian: HistorianView, model: ModelUnit | None) -> None:
        self.config, self.historian, self.model = config, historian, model
        self.block: BlockStage | None = None
        self._begin(None)

    @property
    def tag(self) -> str:
        """The temperature's tag."""
        return self.config.model.temperature

    def _begin(self, prediction: ScanPrediction | None) -> None:
        """Of this scan nothing is known yet but perhaps the prediction."""
        self.prediction = prediction
        self._forecast: Forecast | None = None
        self._finished: FinishedForecast | None = None
        self._guards: Mapping[str, Any] | None = None

    def begin_scan(self) -> None:
        """Forget the scan before: a stage that fails leaves nothing of it behind."""
        self._begin(None)

    def predict(self, scan: Scan, wrong_since: float | None = None) -> dict[str, float | None]:
        """Follow a scan with the model; gives what its alarms look at, nothing without a model.

        `wrong_since` (plant s): the sensor was found out, and its readings from then on were wrong.
        """
        if self.model is None:
            return {}
        self.prediction = self.model.follow(scan, wrong_since)
        if (finished := self.model.settle(self.prediction)) is not None:
            self._finished, self._guards = finished, self.model.guard_report()
        self._forecast = self.model.usable(self.prediction)
        return self.model.findings(self.prediction, self._forecast)

    async def write(self, scan: Scan, alarms: int) -> None:
        """Offer the block of this scan, with the alarm word of all alarms of the scan."""
        if self.block is not None:
            await self.block.take(
                scan,
                self.prediction,
                self._forecast,
                alarms=alarms,
                model_hash=self.model.loaded.hash if self.model else "",
            )

    def keep(self, scan: Scan) -> None:
        """Put on record what was predicted for this scan."""
        if self.prediction is not None:
            for table, rows in prediction_rows(scan, self.prediction, self._finished, self._guards).items():
                self.historian.put(table, rows)

    def foresee(self, scan: Scan) -> None:
        """Begin the next forecast if one is due."""
        if self.model is not None and self.prediction is not None:
            self.model.foresee(scan, self.prediction)

    @property
    def unverified_reason(self) -> str:
        """Why nothing of the model may be written; "" if it may."""
        return self.model.unverified_reason if self.model else ""

    def note_run(self, now: float) -> None:
        """Put on record whose rows follow."""
        config, model = self.config, self.model.loaded.hash if self.model else ""
        self.historian.put("runs", [(now, self.tag, model, config.scan.period, config.historian.max_interval)])
