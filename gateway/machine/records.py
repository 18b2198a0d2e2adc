"""What goes into the historian, as rows of its tables: which samples are worth keeping, how a record is written."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from struct import pack
from typing import Any

from drivers.tag import Sample, Tag
from gateway.machine.alarms import Alarm
from gateway.machine.predict import Prediction
from gateway.machine.scan import Scan
from gateway.machine.writeback import Attempt
from gateway.store.historian import Row
from sim.forecast.forecast import Forecast
from sim.strict_json import json_text


@dataclass(slots=True)
class Keeper:
    """Which samples to keep: changed by more than the tag's deadband, changed in quality, or `max_interval` s old."""

    tags: Mapping[str, Tag]
    numbers: Mapping[str, int]
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
            self._kept[name] = Sample(name, sample.value, sample.quality, time)
            value = float(sample.value) if isinstance(sample.value, bool) else sample.value
            rows.append((self.numbers[name], time, value, int(sample.quality), sample.sent if good else None))
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
        return abs(sample.value - before.value) > self.tags[name].deadband


def scan_row(scan: Scan) -> Row:
    """A row of `scans`."""
    return (scan.time, scan.duration, scan.missed)


def prediction_row(p: Prediction) -> Row:
    """A row of `predictions`."""
    return (p.time, p.location, int(p.known), p.measured, p.mean, p.low, p.high, p.free_run, p.anomaly, p.zone)


def forecast_rows(made: Forecast, measured: float | None) -> list[Row]:
    """The rows of `forecasts`, one a horizon; `measured` is the last reading when the forecast was made."""
    levels = json.dumps(list(made.levels))
    return [
        (
            made.time,
            float(horizon),
            levels,
            json.dumps([round(value, 4) for value in made.quantiles[:, column].tolist()]),
            made.exceedance[column].probability,
            made.limit,
            measured,
        )
        for column, horizon in enumerate(made.horizons.tolist())
    ]


def event_rows(prediction: Prediction) -> list[Row]:
    """The rows of `events`; the location is the one after all events of the scan."""
    return [(event.time, event.symbol, prediction.location) for event in prediction.events]


def guard_row(now: float, report: Mapping[str, Any] | None) -> Row:
    """A row of `guards`: the report as JSON, numbers that are not finite as null."""
    return (now, json_text(report))


def alarm_row(alarm: Alarm, value: float | None, now: float) -> Row:
    """A row of `alarms`: the state entered at `now`."""
    return (now, alarm.condition, alarm.tag, alarm.priority, alarm.state.value, value, alarm.acknowledged_by)


def write_row(attempt: Attempt) -> Row:
    """A row of `writes`; the words are stored high byte first, as they went on the wire."""
    block = attempt.block
    words = pack(f">{len(block.words)}H", *block.words)
    return (
        attempt.time,
        block.sequence,
        attempt.mode,
        attempt.verdict,
        int(block.validity),
        attempt.latency_ms,
        attempt.reason,
        words,
    )


def percentile(values: Sequence[float], share: float) -> float:
    """The value that `share` of the values do not exceed (nearest rank); NaN for none."""
    ordered = sorted(values)
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)] if ordered else nan
