"""What an OPC UA client sees of a machine, as data: the values of its picture by their places in the address space."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal

from drivers.tag import DType, Quality, Tag
from gateway.outside.status import GatewayStatus, TemperatureStatus

PointType = Literal["double", "boolean", "string", "moment"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcUaPoint:
    """A value at a `path` (machine, folder, ..., name); `quality` is its OPC UA status code, `time` its own (s UTC).

    A moment's value is in s UTC. `recorded`: its past is in the historian. `standing`: it has no time of its own, and
    `time` is when it was looked at.
    """

    path: tuple[str, ...]
    kind: PointType
    value: float | bool | str | None
    quality: Quality
    time: float
    unit: str = ""
    recorded: bool = False
    standing: bool = False


def status_points(status: GatewayStatus, tags: Mapping[str, Tag]) -> Iterator[OpcUaPoint]:
    """The values of a machine, of which `tags` are the tags by name."""
    machine = status.machine
    for name, reading in status.values.items():
        kind = _kind(tags.get(name), reading.value)
        measured, quality = (machine, "Measured", name), Quality[reading.quality]
        yield make_point(measured, kind, reading.value, quality, time=reading.time, unit=reading.unit, recorded=True)
    yield from _prediction_points(machine, status, status.time)
    for further in status.further:
        yield from _prediction_points(machine, further, status.time)
    shown = {alarm.name: alarm for alarm in status.alarm_summary}
    for name, state in status.alarms.items():
        alarm = shown.get(name)
        time = status.time if alarm is None else alarm.since
        rows: dict[str, tuple[PointType, float | bool | str | None]] = {
            "state": ("string", state),
            "active": ("boolean", alarm is not None and alarm.active),
            "unacknowledged": ("boolean", alarm is not None and "acknowledge" in alarm.possible),
            # Of an alarm that is normal nothing but that is said.
            "priority": ("double", None if alarm is None else float(alarm.priority)),
            "since": ("moment", None if alarm is None else alarm.since),
        }
        for key, (kind, value) in rows.items():
            path = (machine, "Alarm", name, key)
            yield make_point(path, kind, value, Quality.GOOD, time=time, standing=alarm is None)
    mode = str(status.writeback["mode"])
    yield make_point((machine, "Writeback", "mode"), "string", mode, Quality.GOOD, time=status.time, standing=True)


def _prediction_points(machine: str, one: GatewayStatus | TemperatureStatus, now: float) -> Iterator[OpcUaPoint]:
    """What the model says of one temperature; what it does not say yet waits for its first value."""
    made = one.prediction
    time = now if made is None else made.time
    # A prediction from a state that is not known is not what the plant will do, and no fault of any device either.
    known = Quality.GOOD if made is not None and made.known else Quality.UNCERTAIN
    rows: tuple[tuple[str, PointType, Quality], ...] = (
        ("mean", "double", known),
        ("low", "double", known),
        ("high", "double", known),
        ("free_run", "double", known),
        ("anomaly", "double", known),
        ("location", "string", known),
        ("zone", "string", Quality.GOOD),
        ("known", "boolean", Quality.GOOD),
        ("inputs_good", "boolean", Quality.GOOD),
    )
    for key, kind, quality in rows:
        yield make_point(
            (machine, "Predicted", one.temperature, key),
            kind,
            None if made is None else getattr(made, key),
            Quality.WAITING_FOR_INITIAL_DATA if made is None else quality,
            time=time,
            unit=one.unit if kind == "double" and key != "anomaly" else "",
            recorded=key not in ("inputs_good", "known"),
        )
    familiarity = None if made is None else made.familiarity
    of_cycle: tuple[tuple[str, PointType, str], ...] = (
        ("strangeness", "double", "strangeness"),
        ("familiarity", "string", "zone"),
        ("strange", "string", "sentence"),
    )
    for key, kind, field in of_cycle:
        value = None if familiarity is None else getattr(familiarity, field)
        quality = Quality.WAITING_FOR_INITIAL_DATA if value is None else Quality.GOOD
        yield make_point((machine, "Predicted", one.temperature, key), kind, value, quality, time=time)
    limit = (machine, "Forecast", one.temperature, "limit")
    yield make_point(limit, "double", one.limit, Quality.GOOD, time=now, unit=one.unit, standing=True)
    forecast = one.forecast
    folder, time = (machine, "Forecast", one.temperature), now if forecast is None else forecast.time
    waiting = Quality.WAITING_FOR_INITIAL_DATA
    usable = waiting if forecast is None else Quality.GOOD if forecast.usable else Quality.LAST_USABLE
    fresh = None if forecast is None else forecast.usable
    yield make_point((*folder, "usable"), "boolean", fresh, waiting if forecast is None else Quality.GOOD, time=time)
    for key in ("minutes_low", "minutes_median", "minutes_high"):
        # Without a value: beyond the horizons.
        left = None if forecast is None else forecast.block.get(key)
        yield make_point((*folder, key), "double", left, usable, time=time, unit="min")
    if forecast is None:
        return
    for horizon, fan, chance in zip(forecast.horizons, forecast.quantiles, forecast.p_limit, strict=True):
        at = (*folder, f"{horizon:g} s")
        for level, quantile in zip(forecast.levels, fan, strict=True):
            yield make_point((*at, f"q{100 * level:g}"), "double", quantile, usable, time=time, unit=one.unit)
        yield make_point((*at, "p_limit"), "double", chance, usable, time=time)


def make_point(
    path: tuple[str, ...],
    kind: PointType,
    value: Any,
    quality: Quality,
    *,
    time: float,
    unit: str = "",
    recorded: bool = False,
    standing: bool = False,
) -> OpcUaPoint:
    """A point of a value that may be of another type or missing, which its status says then."""
    value = _convert_value(value, kind)
    if value is None and not quality.is_bad:
        quality = Quality.NO_DATA
    return OpcUaPoint(
        path=path,
        kind=kind,
        value=value,
        quality=quality,
        time=time,
        unit=unit,
        recorded=recorded,
        standing=standing,
    )


def _kind(tag: Tag | None, value: object) -> PointType:
    """A tag's type; of one that the map has no more, its value's."""
    if tag is None:
        return "string" if isinstance(value, str) else "double"
    if tag.dtype is DType.STRING:
        return "string"
    return "boolean" if tag.is_switch else "double"


def _convert_value(value: Any, kind: PointType) -> float | bool | str | None:
    """The value as its type has it; None for one of another type, and for no number."""
    if value is None or isinstance(value, str) != (kind == "string"):
        return None
    if kind == "string":
        return str(value)
    if kind == "boolean":
        return bool(value)
    return float(value) if isfinite(value) else None
