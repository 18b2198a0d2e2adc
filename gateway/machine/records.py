"""What was measured and predicted, as rows of the historian: which samples are worth keeping, how a row is written."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.tag import Sample, Tag
from gateway.machine.model import FinishedForecast, ScanPrediction
from gateway.machine.reading import Scan
from gateway.store import HistorianView, Row, storable
from sim.strict_json import json_text


@dataclass(slots=True)
class Keeper:
    """Which samples to keep: changed by more than the tag's deadband, changed in quality, or `max_interval` s old.

    The change is that from the sample kept last, so that no drift adds up: at each scan the newest kept sample differs
    from what was read by the deadband at most, and has its quality.
    """

    tags: Mapping[str, Tag]
    max_interval: float
    left_out: frozenset[str] = frozenset()
    _kept: dict[str, Sample] = field(default_factory=dict)

    def rows(self, scan: Scan) -> list[Row]:
        """The rows of `samples` for this scan."""
        rows: list[Row] = []
        for name, sample in scan.samples.items():
            if name in self.left_out or not self._worth(name, sample, scan.time):
                continue
            good = sample.quality.is_good
            time = sample.time if good else scan.time
            self._kept[name] = sample if good else Sample(name, sample.value, sample.quality, time)
            sent = sample.sent if good else None
            rows.append((name, time, storable(sample.value), int(sample.quality), sent))
        return rows

    def _worth(self, name: str, sample: Sample, now: float) -> bool:
        before = self._kept.get(name)
        if before is None or before.quality != sample.quality or now - before.time >= self.max_interval:
            return True
        if sample.value == before.value:
            return False
        if isinstance(sample.value, str) or isinstance(before.value, str):
            return True
        if sample.value is None or before.value is None:
            return True
        # A NaN compares with nothing: it is kept, and so is what follows it.
        return not abs(sample.value - before.value) <= self.tags[name].deadband


@dataclass(frozen=True, slots=True)
class Records:
    """The stage that stores measurements; alarms and writes are on record where they come about."""

    historian: HistorianView
    keeper: Keeper

    def take(self, scan: Scan) -> None:
        """The rows of one scan."""
        self.historian.put("scans", [(scan.time, scan.duration, scan.missed)])
        self.historian.put("samples", self.keeper.rows(scan))


def prediction_rows(
    scan: Scan, prediction: ScanPrediction, finished: FinishedForecast | None, guards: Mapping[str, Any] | None
) -> dict[str, list[Row]]:
    """The rows, by their tables, of what was predicted for a scan, and of the forecast that was finished before it."""
    p = prediction
    row = (p.time, p.location, int(p.known), p.measured, p.mean, p.low, p.high, p.free_run, p.anomaly, p.zone)
    # The location of an event is the one after all events of the scan.
    rows: dict[str, list[Row]] = {
        "predictions": [row],
        "events": [(event.time, event.symbol, p.location) for event in p.events],
    }
    if finished is not None:
        rows |= {"forecasts": forecast_rows(finished), "guards": [(scan.time, json_text(guards))]}
    return rows


def forecast_rows(finished: FinishedForecast) -> list[Row]:
    """The rows of `forecasts`, one a horizon."""
    forecast, levels = finished.forecast, json.dumps(list(finished.forecast.levels))
    return [
        (
            forecast.time,
            float(horizon),
            levels,
            json.dumps([round(value, 4) for value in forecast.quantiles[:, column].tolist()]),
            forecast.exceedance[column].probability,
            forecast.limit,
            finished.measured,
        )
        for column, horizon in enumerate(forecast.horizons.tolist())
    ]
