"""Which alarms a machine has, from its configuration: their limits, delays, bits, and what an operator shall do."""

from collections.abc import Mapping
from itertools import groupby
from types import MappingProxyType
from typing import Any

from drivers.device_file import ACKNOWLEDGE_BITS
from gateway.machine.alarms.states import AlarmCondition
from gateway.machine.reading import STALE_PERIODS
from gateway.settings import ALARM_KINDS, PLANT, AlarmKind, AlarmPlace, Config, merge_settings, parse_suppression

OVER_LIMIT, RISING, DRIFTING = "over limit", "rising", "sensor drifting"
SENSOR_FAULTS = tuple(name for name, kind in ALARM_KINDS.items() if kind.namur)
"""The alarms for what may be wrong with a sensor."""


def acknowledge_words(config: Config) -> dict[str, frozenset[str]]:
    """The tags of the PLC's acknowledge bits, each with the temperatures whose alarms are acknowledged by it."""
    of = {one.model.temperature: one.block_layout for one in config.temperature_configs}
    tags = {name: layout.acknowledge_bits if layout else ACKNOWLEDGE_BITS for name, layout in of.items()}
    return {tag: frozenset(name for name in tags if tags[name] == tag) for tag in tags.values()}


def suppressing_tags(conditions: Mapping[str, AlarmCondition]) -> frozenset[str]:
    """The tags by which alarms are suppressed by design."""
    return frozenset(c.suppressed_by[0] for c in conditions.values() if c.suppressed_by)


def alarm_name(config: Config, name: str, temperature: str) -> str:
    """The name of a model's alarm: that of the first temperature is plain, others have their tag behind it."""
    return name if temperature == config.model.temperature else f"{name} {temperature}"


def on_tag(kind: str, tag: str) -> str:
    """The name of the alarm of a kind that each watched temperature has."""
    return f"{kind} {tag}"


def _alarm_place(config: Config, name: str, kind: AlarmKind, tag: str) -> tuple[str, str]:
    """The name of the alarm of a kind on a tag, and the temperature whose block alone it is in ("": all)."""
    if kind.subject == "predicted":
        return alarm_name(config, name, tag), tag if len(config.temperatures) > 1 else ""
    return (on_tag(name, tag) if tag else name), ""


def _of_kind(config: Config, name: str, kind: AlarmKind, at: AlarmPlace) -> list[AlarmCondition]:
    """The alarm of a kind at a place, with what the plant file says of it; none where it is switched off."""
    own = merge_settings(config.alarm, name, at.tag)
    if not kind.applies(at) or not own.pop("enabled", True):
        return []
    twins = [tag for tag in config.twins if tag != at.tag]
    unit = config.map.by_name[at.tag].unit if at.tag else ""
    alarm, temperature = _alarm_place(config, name, kind, at.tag)
    usual: dict[str, Any] = {
        "name": alarm,
        "tag": at.tag or (PLANT if kind.subject == "plant" and config.several else config.machine),
        "bit": kind.bit,
        "limit": kind.limit(at),
        "on_delay": kind.on_delay,
        "off_delay": config.alarms.off_delay,
        "priority": kind.priority,
        "response": kind.response.format(
            tag=at.tag, twin=" and ".join(twins), limit=f"{at.config.find_limit(at.tag):g}", unit=unit
        ),
        "consequence": str(kind.consequence),
        "temperature": temperature,
        "kind": name,
    }
    if "latch" in own:
        own["latches"] = own.pop("latch")
    if "suppressed_by" in own:
        own["suppressed_by"] = parse_suppression(own["suppressed_by"])
    more = kind.more(at)
    given = "response" in more or "response" in own
    return [AlarmCondition(own_response=given, **{**usual, **more, **own})]


def make_conditions(
    config: Config,
    inputs: tuple[str, ...],
    *,
    complains: bool = False,
    anomaly_levels: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, AlarmCondition]:
    """The alarms by name; their bits are those of the block's alarm word.

    `anomaly_levels` are those of the models' own records, by the temperature that each predicts. A driver that
    `complains` has an alarm of its own for what its device says. What the plant has once is the first machine's to look
    after, and names the plant where there are several.
    """
    stale_after = STALE_PERIODS * config.scan.period
    machine = [AlarmPlace(config=config, inputs=inputs, complains=complains, stale_after=stale_after)]
    places = {
        "watched": [AlarmPlace(config=config, tag=tag) for tag in config.watched_temperatures],
        "predicted": [
            AlarmPlace(config=one, tag=tag, anomaly_level=anomaly_levels.get(tag))
            for one in config.temperature_configs
            for tag in [one.model.temperature]
        ],
        "machine": machine,
        "plant": machine if config.leads else [],
    }
    conditions: list[AlarmCondition] = []
    # All that there is of one tag stands together.
    for subject, rows in groupby(ALARM_KINDS.items(), key=lambda row: row[1].subject):
        kinds = list(rows)
        for at in places[subject]:
            for name, kind in kinds:
                conditions += _of_kind(config, name, kind, at)
    return {condition.name: condition for condition in conditions}
