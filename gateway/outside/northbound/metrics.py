"""What Prometheus scrapes: the gateway's machines, alarms, records and sinks, as they are when it asks.

`METRICS` is the one list of what there is; the Grafana dashboard (config/grafana) speaks of these names.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from gateway.outside.status import AlarmStatus, FamiliarityStatus, GatewayStatus, TemperatureStatus

Labelled = tuple[Sequence[str], float | None]
"""The values of a metric's labels after the machine's, and the metric's own."""


@dataclass(frozen=True, slots=True)
class MachineMetric:
    """A metric of each machine: `read` gives a row for each set of `labels`; a row without a value is left out."""

    name: str
    kind: Literal["gauge", "counter"]
    meaning: str
    labels: Sequence[str]
    read: Callable[[GatewayStatus], Iterable[Labelled]]


class FeedFigures(Protocol):
    """What is counted of a sink's feed (`gateway.outside.northbound.feed.SinkFeed`)."""

    name: str
    delivered: int
    refused: int
    lost: int
    connected: bool

    @property
    def dropped(self) -> int: ...

    @property
    def waiting(self) -> int: ...


def _one(value: Callable[[GatewayStatus], float | None]) -> Callable[[GatewayStatus], Iterable[Labelled]]:
    return lambda status: [((), value(status))]


def _temperatures(status: GatewayStatus) -> Iterator[GatewayStatus | TemperatureStatus]:
    yield status
    yield from status.further


def _prediction_values(key: str) -> Callable[[GatewayStatus], Iterable[Labelled]]:
    return lambda status: [
        ((one.temperature,), getattr(one.prediction, key))
        for one in _temperatures(status)
        if one.prediction is not None
    ]


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _familiarity(status: GatewayStatus) -> Iterator[tuple[GatewayStatus | TemperatureStatus, FamiliarityStatus]]:
    for one in _temperatures(status):
        if one.prediction is not None and one.prediction.familiarity is not None:
            yield one, one.prediction.familiarity


def _quantiles(status: GatewayStatus) -> Iterator[Labelled]:
    for one in _temperatures(status):
        if one.forecast is not None and one.forecast.usable:
            for horizon, fan in zip(one.forecast.horizons, one.forecast.quantiles, strict=True):
                for level, value in zip(one.forecast.levels, fan, strict=True):
                    yield (one.temperature, f"{horizon:g}", f"{level:g}"), value


def _chances(status: GatewayStatus) -> Iterator[Labelled]:
    for one in _temperatures(status):
        if one.forecast is not None and one.forecast.usable:
            for horizon, chance in zip(one.forecast.horizons, one.forecast.p_limit, strict=True):
                yield (one.temperature, f"{horizon:g}"), chance


def _alarms(value: Callable[[AlarmStatus], bool]) -> Callable[[GatewayStatus], Iterable[Labelled]]:
    """A row for each alarm that is not normal; the others have none, as Prometheus keeps what there once was."""
    return lambda status: [((alarm.name, str(alarm.priority)), float(value(alarm))) for alarm in status.alarm_summary]


METRICS: Sequence[MachineMetric] = (
    MachineMetric(
        "decanter_link_up", "gauge", "Whether good readings arrive.", (), _one(lambda s: float(s.link.alive))
    ),
    MachineMetric(
        "decanter_link_outages_total", "counter", "Outages of the link.", (), _one(lambda s: s.link.outage_count)
    ),
    MachineMetric("decanter_scans_total", "counter", "Scans of the machine.", (), _one(lambda s: s.scan.count)),
    MachineMetric(
        "decanter_scans_missed_total", "counter", "Scans that were skipped.", (), _one(lambda s: s.scan.missed)
    ),
    MachineMetric("decanter_scan_age_seconds", "gauge", "Age of the newest scan.", (), _one(lambda s: s.scan.age)),
    MachineMetric("decanter_scan_period_seconds", "gauge", "Time between scans.", (), _one(lambda s: s.scan.period)),
    MachineMetric("decanter_events_total", "counter", "Events that were recognized.", (), _one(lambda s: s.events)),
    MachineMetric(
        "decanter_failures_total",
        "counter",
        "Scans that ended in an error of the gateway.",
        (),
        _one(lambda s: s.failures),
    ),
    MachineMetric(
        "decanter_value",
        "gauge",
        "A tag's reading, while it is good.",
        ("tag", "unit"),
        lambda s: [((tag, one.unit), _number(one.value)) for tag, one in s.values.items() if one.quality == "GOOD"],
    ),
    MachineMetric(
        "decanter_value_good",
        "gauge",
        "Whether a tag's reading is good.",
        ("tag",),
        lambda s: [((tag,), float(one.quality == "GOOD")) for tag, one in s.values.items()],
    ),
    MachineMetric(
        "decanter_predicted",
        "gauge",
        "What the model expected of the newest scan.",
        ("temperature",),
        _prediction_values("mean"),
    ),
    MachineMetric(
        "decanter_predicted_low", "gauge", "The lower end of its band.", ("temperature",), _prediction_values("low")
    ),
    MachineMetric(
        "decanter_predicted_high", "gauge", "The upper end of its band.", ("temperature",), _prediction_values("high")
    ),
    MachineMetric(
        "decanter_anomaly",
        "gauge",
        "How unlike the model the readings are.",
        ("temperature",),
        _prediction_values("anomaly"),
    ),
    MachineMetric(
        "decanter_state_known",
        "gauge",
        "Whether the model's state is known.",
        ("temperature",),
        _prediction_values("known"),
    ),
    MachineMetric(
        "decanter_sensor_bad",
        "gauge",
        "Whether the model stands for a bad sensor, or would if it could: nothing is measured.",
        ("temperature",),
        lambda s: [
            ((one.temperature,), float(one.prediction.virtual is not None))
            for one in _temperatures(s)
            if one.prediction is not None
        ],
    ),
    MachineMetric(
        "decanter_zone",
        "gauge",
        "1 for the zone of trust in the model: green, yellow or red.",
        ("temperature", "zone"),
        lambda s: [((one.temperature, one.prediction.zone), 1.0) for one in _temperatures(s) if one.prediction],
    ),
    MachineMetric(
        "decanter_strangeness",
        "gauge",
        "How unlike its training the present cycle is: 1 as the strangest twentieth of it; none where not known.",
        ("temperature",),
        lambda s: [((one.temperature,), f.strangeness) for one, f in _familiarity(s)],
    ),
    MachineMetric(
        "decanter_familiarity_zone",
        "gauge",
        "1 for the zone of the present cycle: green, yellow or red, unknown without a reference.",
        ("temperature", "zone"),
        lambda s: [((one.temperature, f.zone), 1.0) for one, f in _familiarity(s)],
    ),
    MachineMetric(
        "decanter_unfamiliar",
        "gauge",
        "1 while the present cycle is beyond the limit, with what is strange of it.",
        ("temperature", "sentence"),
        lambda s: [((one.temperature, f.sentence), 1.0) for one, f in _familiarity(s) if f.outside],
    ),
    MachineMetric(
        "decanter_limit",
        "gauge",
        "A temperature's alarm limit.",
        ("temperature",),
        lambda s: [((one.temperature,), one.limit) for one in _temperatures(s)],
    ),
    MachineMetric(
        "decanter_forecast", "gauge", "Quantiles of a usable forecast.", ("temperature", "horizon", "level"), _quantiles
    ),
    MachineMetric(
        "decanter_forecast_limit_probability",
        "gauge",
        "Probability that the limit is reached within the horizon (s).",
        ("temperature", "horizon"),
        _chances,
    ),
    MachineMetric(
        "decanter_forecasts_postponed_total",
        "counter",
        "Forecasts that waited since scans were skipped when they were due.",
        ("temperature",),
        lambda s: [((one.temperature,), one.forecast.postponed) for one in _temperatures(s) if one.forecast],
    ),
    MachineMetric(
        "decanter_alarm_active",
        "gauge",
        "Whether an alarm that is not normal stands.",
        ("alarm", "priority"),
        _alarms(lambda one: one.active),
    ),
    MachineMetric(
        "decanter_alarm_waiting",
        "gauge",
        "Whether an alarm that is not normal waits for its acknowledgement.",
        ("alarm", "priority"),
        _alarms(lambda one: "acknowledge" in one.possible),
    ),
    MachineMetric(
        "decanter_armed",
        "gauge",
        "Whether predictions are written to the PLC.",
        (),
        _one(lambda s: float(s.writeback["mode"] == "armed")),
    ),
    MachineMetric(
        "decanter_records_complete",
        "gauge",
        "Whether the records can be relied on.",
        (),
        _one(lambda s: float(not s.historian.complaint)),
    ),
    MachineMetric(
        "decanter_rows_lost_total",
        "counter",
        "Rows that the historian has lost.",
        (),
        _one(lambda s: s.historian.dropped + s.historian.refused),
    ),
)
"""The metrics of a machine."""


class GatewayCollector(Collector):
    """Gives the metrics of these `statuses`, and of the `feeds` of the sinks."""

    def __init__(self, statuses: Mapping[str, GatewayStatus], feeds: Sequence[FeedFigures]) -> None:
        self._statuses, self._feeds = statuses, feeds

    def collect(self) -> Iterator[Metric]:
        """All of them; one without rows too, so that what there may be is seen."""
        for metric in METRICS:
            family = _family(metric.kind, metric.name, metric.meaning, ("machine", *metric.labels))
            for machine, status in self._statuses.items():
                for labels, value in metric.read(status):
                    if value is not None:
                        family.add_metric([machine, *labels], float(value))
            yield family
        rows: Sequence[tuple[str, Literal["gauge", "counter"], str, Callable[[FeedFigures], float]]] = (
            ("decanter_northbound_connected", "gauge", "Whether a sink is reached.", lambda feed: feed.connected),
            ("decanter_northbound_rows_total", "counter", "Rows that a sink has.", lambda feed: feed.delivered),
            ("decanter_northbound_rows_waiting", "gauge", "Rows that wait for a sink.", lambda feed: feed.waiting),
            ("decanter_northbound_rows_lost_total", "counter", "Rows too old for a sink.", lambda feed: feed.lost),
            ("decanter_northbound_rows_refused_total", "counter", "Rows a sink refused.", lambda feed: feed.refused),
            (
                "decanter_northbound_dropped_total",
                "counter",
                "Messages left out: too many at a time, or not asked for.",
                lambda feed: feed.dropped,
            ),
        )
        for name, kind, meaning, read in rows:
            family = _family(kind, name, meaning, ("sink",))
            for feed in self._feeds:
                family.add_metric([feed.name], float(read(feed)))
            yield family


def _family(kind: str, name: str, meaning: str, labels: Sequence[str]) -> Any:
    return (GaugeMetricFamily if kind == "gauge" else CounterMetricFamily)(name, meaning, labels=list(labels))
