"""Sparkplug B payloads: the protobuf message of the specification, and the historian's rows as its metrics.

Field numbers and types are those of Sparkplug 3.0.0 (chapter 6.4; Eclipse Tahu's sparkplug_b.proto),
as far as they are used: protobuf's reader passes over fields that it does not know.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from drivers.tag import DType, Tag
from gateway.store import FollowedRow

INT32, INT64, DOUBLE, BOOLEAN, STRING = 3, 4, 10, 11, 12
"""Sparkplug's data types that are used here."""
GOOD, STALE, BAD = 192, 500, 0
"""Values of the property `Quality`."""
LONGEST_NAME, MOST_COMMANDS, MOST_STATE = 300, 100, 1_000
"""Characters of an alarm's name, metrics of one command, and bytes of a host's state, that are heard."""

_FIELDS: Mapping[str, Sequence[tuple[int, str, str]]] = {
    "PropertyValue": (
        (1, "type", "uint32"), (2, "is_null", "bool"), (3, "int_value", "uint32"), (4, "long_value", "uint64"),
        (6, "double_value", "double"), (7, "boolean_value", "bool"), (8, "string_value", "string"),
    ),
    "PropertySet": ((1, "keys", "string*"), (2, "values", "PropertyValue*")),
    "Metric": (
        (1, "name", "string"), (2, "alias", "uint64"), (3, "timestamp", "uint64"), (4, "datatype", "uint32"),
        (5, "is_historical", "bool"), (7, "is_null", "bool"), (9, "properties", "PropertySet"),
        (10, "int_value", "uint32"), (11, "long_value", "uint64"), (13, "double_value", "double"),
        (14, "boolean_value", "bool"), (15, "string_value", "string"),
    ),
    "Payload": ((1, "timestamp", "uint64"), (2, "metrics", "Metric*"), (3, "seq", "uint64")),
}  # fmt: skip
"""The messages: (number, name, type), `*` for a list."""


def _messages() -> dict[str, Any]:
    """The classes of the messages by their names, in a pool of their own: another program's may have the same names."""
    field = descriptor_pb2.FieldDescriptorProto
    types = {
        "uint32": field.TYPE_UINT32, "uint64": field.TYPE_UINT64, "double": field.TYPE_DOUBLE, "bool": field.TYPE_BOOL,
        "string": field.TYPE_STRING,
    }  # fmt: skip
    file = descriptor_pb2.FileDescriptorProto(name="sparkplug.proto", package="sparkplug", syntax="proto2")
    for name, rows in _FIELDS.items():
        message = file.message_type.add(name=name)
        for number, key, kind in rows:
            plain = kind.rstrip("*")
            label = field.LABEL_REPEATED if kind.endswith("*") else field.LABEL_OPTIONAL
            added = message.field.add(name=key, number=number, label=label)
            if plain in types:
                added.type = types[plain]
            else:
                added.type, added.type_name = field.TYPE_MESSAGE, f".sparkplug.{plain}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"sparkplug.{name}")) for name in _FIELDS}


Payload = _messages()["Payload"]
"""The class of a payload: `Payload(timestamp=..., seq=...)`, `metrics.add(...)`, `SerializeToString()`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SparkplugMetric:
    """One value of a `datatype` at a `time` (s UTC); None: there is none. `quality` is Sparkplug's."""

    name: str
    datatype: int
    value: float | bool | str | None
    time: float
    quality: int = GOOD
    unit: str = ""


@dataclass(frozen=True, slots=True)
class SparkplugCommand:
    """One metric of a command: its name, and what it says as a truth and as a text."""

    name: str
    is_true: bool
    text: str


def parse_commands(payload: bytes) -> list[SparkplugCommand]:
    """What a command asks for; nothing where its bytes make no sense. Whoever may publish may send anything."""
    try:
        metrics = Payload.FromString(payload).metrics
    except DecodeError:
        return []
    # protobuf gives a text that is no UTF-8 as its bytes.
    return [
        SparkplugCommand(one.name, one.boolean_value, one.string_value)
        for one in metrics[:MOST_COMMANDS]
        if isinstance(one.name, str) and isinstance(one.string_value, str)
        if one.string_value.isprintable() and len(one.string_value) <= LONGEST_NAME
    ]


@dataclass(frozen=True, slots=True)
class HostState:
    """What a host application says of itself (Sparkplug 3.0, 6.4.2): whether it is online, and since when (ms UTC)."""

    online: bool
    timestamp: int


def host_state(payload: bytes) -> HostState | None:
    """The state in a STATE message; None where its bytes make no sense."""
    try:
        plain = json.loads(payload[:MOST_STATE])
        online, timestamp = plain["online"], plain["timestamp"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if not isinstance(online, bool) or isinstance(timestamp, bool) or not isinstance(timestamp, int):
        return None
    return HostState(online, timestamp)


def row_metrics(row: FollowedRow, tags: Mapping[str, Tag]) -> Iterator[SparkplugMetric]:
    """What a row says, as metrics of the machine's; `tags` are the machine's own."""
    values, time, of = row.values, row.time, row.stream.temperature
    match row.stream.table:
        case "samples":
            tag, value, quality = tags.get(values["tag"]), values["value"], values["quality"]
            datatype = _datatype(tag, value)
            yield SparkplugMetric(
                name=f"Measured/{values['tag']}",
                datatype=datatype,
                value=_convert_value(value, datatype),
                time=time,
                quality=GOOD if quality.is_good else BAD if quality.is_bad else STALE,
                unit=values["unit"],
            )
        case "predictions":
            unit = tags[of].unit if of in tags else ""
            # Without a reading and without a zone it is the model's alone, in place of a bad sensor.
            alone = values["measured"] is None and values["zone"] == "none"
            quality = GOOD if values["known"] and not alone else STALE
            for key in ("mean", "low", "high", "free_run", "anomaly"):
                yield SparkplugMetric(
                    name=f"Predicted/{of}/{key}",
                    datatype=DOUBLE,
                    value=values[key],
                    time=time,
                    quality=quality,
                    unit="" if key == "anomaly" else unit,
                )
            for key in ("location", "zone"):
                yield SparkplugMetric(
                    name=f"Predicted/{of}/{key}", datatype=STRING, value=values[key], time=time, quality=quality
                )
            known = bool(values["known"])
            yield SparkplugMetric(name=f"Predicted/{of}/known", datatype=BOOLEAN, value=known, time=time)
        case "forecasts":
            unit, name = (tags[of].unit if of in tags else ""), f"Forecast/{of}/{values['horizon']:g} s"
            for level, quantile in zip(json.loads(values["levels"]), json.loads(values["quantiles"]), strict=True):
                yield SparkplugMetric(
                    name=f"{name}/q{100 * level:g}", datatype=DOUBLE, value=quantile, time=time, unit=unit
                )
            for key in ("p_limit", "limit"):
                yield SparkplugMetric(name=f"{name}/{key}", datatype=DOUBLE, value=values[key], time=time)
        case "events":
            yield SparkplugMetric(name=f"Event/{of}", datatype=STRING, value=values["symbol"], time=time)
        case _:
            name = f"Alarm/{values['condition']}"
            yield SparkplugMetric(name=name, datatype=STRING, value=values["state"], time=time)


def _datatype(tag: Tag | None, value: object) -> int:
    """A tag's type; of one that the machine has no more, its value's."""
    if tag is None:
        return STRING if isinstance(value, str) else DOUBLE
    if tag.dtype is DType.STRING:
        return STRING
    return BOOLEAN if tag.is_switch else DOUBLE


def _convert_value(value: Any, datatype: int) -> float | bool | str | None:
    """The value as its type has it; None for one of another type, as before the map was changed."""
    if value is None or isinstance(value, str) != (datatype == STRING):
        return None
    if datatype == STRING:
        return str(value)
    return bool(value) if datatype == BOOLEAN else float(value)


def milliseconds(time: float) -> int:
    """Sparkplug's time of a moment (s UTC)."""
    return max(round(1000 * time), 0)


def add_metric(payload: Any, metric: SparkplugMetric, *, alias: int, birth: bool, historical: bool = False) -> None:
    """Append a metric: in a birth by name, type and unit, elsewhere by its alias."""
    added = payload.metrics.add(alias=alias, timestamp=milliseconds(metric.time), datatype=metric.datatype)
    if birth:
        added.name = metric.name
    if historical:
        added.is_historical = True
    if birth or metric.quality != GOOD:
        _add_property(added, "Quality", INT32, int_value=metric.quality)
    if birth and metric.unit:
        _add_property(added, "engUnit", STRING, string_value=metric.unit)
    match metric.value:
        case None:
            added.is_null = True
        case bool(value):
            added.boolean_value = value
        case str(value):
            added.string_value = value
        case value:
            added.double_value = value


def _add_property(metric: Any, key: str, datatype: int, **value: Any) -> None:
    metric.properties.keys.append(key)
    metric.properties.values.add(type=datatype, **value)
