"""Which alarms a machine has, from its configuration: their limits, delays, bits, and what an operator shall do."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shlex import join
from typing import Any

from drivers.device_file import ACKNOWLEDGE_BITS
from gateway.machine.alarms.states import AlarmCondition
from gateway.machine.reading import STALE_PERIODS
from gateway.settings import ALARM_KINDS, OF_PLANT, PLANT, Config, settings_of, suppressing

DEVICE = "device"
"""The alarm for what the device itself says is wrong with it."""
RECORDS, PARTS, CLOCK = "records", "parts", "clock"
"""The alarms for records that cannot be relied on, for another part of the gateway that failed (they share a bit), and
for a clock that cannot be relied on."""
INPUTS = "inputs bad"
"""The alarm for readings that a model needs, or that are watched, and that are not good."""
OTHER_WRITER = "another writer"
"""The alarm for what the PLC says of another gateway; it shares the bit of what the device says else."""
LINK, DISK, CERTIFICATE, NOTIFICATION = "link", "disk", "certificate", "notification"
"""The alarms for a machine that is not read, a disk that is nearly full, a certificate that runs out, and messages that
are not delivered."""
NORTHBOUND = "northbound"
"""The alarm for a broker or database that is out of reach."""
CLOCK_SYNC = "clock not steered"
"""The alarm for a clock that no time server steers."""
OVER_LIMIT, RISING = "over limit", "rising"
DRIFTING = "sensor drifting"
UNFAMILIAR = "unfamiliar"
"""The alarm for a cycle whose like the model's training never had; it shares the bit of the anomaly."""
SENSOR_FAULTS = tuple(name for name in ALARM_KINDS if name.startswith("sensor "))
"""The alarms for what may be wrong with a sensor."""
FAULT = 0.5
"""What is found of a sensor beyond this is a fault; what is only yes or no is 1 or 0."""
DRIFT_SINCE = "14d"
"""The span of the historian that a diagnosis is offered for: ten cycles or more of a plant that runs every day."""


def acknowledge_words(config: Config) -> dict[str, frozenset[str]]:
    """The tags of the PLC's acknowledge bits, each with the temperatures whose alarms are acknowledged by it."""
    of = {one.model.temperature: one.block_layout for one in config.followed}
    tags = {name: layout.acknowledge_bits if layout else ACKNOWLEDGE_BITS for name, layout in of.items()}
    return {tag: frozenset(name for name in tags if tags[name] == tag) for tag in tags.values()}


def certificate_folders(config: Config) -> list[Path]:
    """The folders of the certificates without which the machine is not read; of the first one's those of the OPC UA
    server too, which the plant has once."""
    opcua = config.northbound.opcua
    named = [link.settings.get("certificates") for link in config.links]
    named += [opcua.certificates] if opcua.port is not None and config.leads else []
    return [Path(str(each)) for each in named if each]


def suppressing_tags(conditions: Mapping[str, AlarmCondition]) -> frozenset[str]:
    """The tags by which alarms are suppressed by design."""
    return frozenset(c.suppressed_by[0] for c in conditions.values() if c.suppressed_by)


def name_of(config: Config, name: str, temperature: str) -> str:
    """The name of a model's alarm: that of the first temperature is plain, others have their tag behind it."""
    return name if temperature == config.model.temperature else f"{name} {temperature}"


def on_tag(kind: str, tag: str) -> str:
    """The name of the alarm of a kind that each watched temperature has."""
    return f"{kind} {tag}"


def _of_kind(
    config: Config, kind: str, limit: float, *, tag: str = "", about: str = "", **more: Any
) -> list[AlarmCondition]:
    """The alarm of a kind as the table has it, with what the plant file says of it; none where it is switched off.

    It is of the machine where there is no `tag`; `about` is what it names then, the machine by default. One of the
    plant is the first machine's to look after, and names the plant where there are several.
    """
    row, own = ALARM_KINDS[kind], settings_of(config.alarm, kind, tag)
    if not own.pop("enabled", True) or (kind in OF_PLANT and not config.leads):
        return []
    about = PLANT if kind in OF_PLANT and config.several else about
    unit = config.map.by_name[tag].unit if tag else ""
    plain: dict[str, Any] = {
        "name": kind,
        "tag": tag or about or config.machine,
        "bit": row.bit,
        "on_delay": row.on_delay,
        "off_delay": config.alarms.off_delay,
        "priority": row.priority,
        "response": row.response.format(
            tag=" and ".join(config.twins) if kind == DRIFTING else tag, limit=config.limit_of(tag), unit=unit
        ),
        "consequence": row.consequence,
        "kind": kind,
    }
    if "latch" in own:
        own["latches"] = own.pop("latch")
    if "suppressed_by" in own:
        own["suppressed_by"] = suppressing(own["suppressed_by"])
    given = "response" in more or "response" in own
    return [AlarmCondition(limit=limit, own_response=given, **{**plain, **more, **own})]


def _of_model(config: Config) -> list[AlarmCondition]:
    """The alarms of one temperature's model."""
    a, tag = config.alarms, config.model.temperature
    # When the model drifts the operator gets the command that diagnoses the historian's recent cycles.
    command = ["decanter", "diagnose", "--model", str(config.model.path), "--historian", str(config.historian.path)]
    command += ["--machine", config.machine] if config.several else []
    command += ["--since", DRIFT_SINCE, "--out", str(config.historian.path.parent / "diagnosis")]
    drifts = f"the model's free run is beyond its limit on {a.drift_cycles} cycles running"
    offer = f"{drifts}; find out what has changed with: {join(command)}"
    return [
        *_of_kind(config, "predicted over limit", a.p_limit, tag=tag, deadband=a.p_limit / 2),
        *_of_kind(config, "anomaly", a.anomaly, tag=tag, deadband=a.anomaly / 3),
        *_of_kind(config, UNFAMILIAR, a.unfamiliar, tag=tag, deadband=a.unfamiliar / 10),
        *_of_kind(config, "review", 0.5, tag=tag),
        *_of_kind(config, "drift", a.drift_cycles - 0.5, tag=tag, off_delay=0.0, response=offer),
    ]


def make_conditions(config: Config, inputs: tuple[str, ...], *, complains: bool = False) -> dict[str, AlarmCondition]:
    """The alarms by name; their bits are those of the block's alarm word.

    A driver that `complains` has an alarm of its own for what its device says.
    """
    a, several = config.alarms, len(config.temperatures) > 1
    predicted = {row.tag for row in config.temperatures}
    conditions: list[AlarmCondition] = []
    for tag in config.watched:
        limit, name = config.limit_of(tag), on_tag(OVER_LIMIT, tag)
        whose = tag if several and tag in predicted else ""
        over: dict[str, Any] = {"deadband": a.deadband, "on_delay": a.on_delay, "temperature": whose}
        conditions += _of_kind(config, OVER_LIMIT, limit, tag=tag, name=name, **over)
    for one in config.followed:
        if one.model.path is not None:
            own = _of_model(one)
            conditions += (
                [replace(c, name=name_of(config, c.name, c.tag), temperature=c.tag) for c in own] if several else own
            )
    for tag in config.watched:
        if a.trend is not None:
            limit = config.limit_of(tag)
            conditions += _of_kind(config, RISING, limit, tag=tag, name=on_tag(RISING, tag), deadband=a.deadband)
        for kind in SENSOR_FAULTS if a.sensors else ():
            # Which of two that drift apart is wrong they do not say: it is one alarm, and names both.
            if kind == DRIFTING and (not config.twins or tag != config.twins[0]):
                continue
            conditions += _of_kind(config, kind, FAULT, tag=tag, name=on_tag(kind, tag))
    for kind in (RECORDS, PARTS, CLOCK, CLOCK_SYNC, LINK, DISK):
        conditions += _of_kind(config, kind, 0.0 if kind == DISK else 0.5)
    if certificate_folders(config):
        conditions += _of_kind(config, CERTIFICATE, -a.certificate_days)
    if config.notify.to:
        conditions += _of_kind(config, NOTIFICATION, 0.5)
    if config.northbound.sinks:
        conditions += _of_kind(config, NORTHBOUND, 0.5)
    if config.map.writeback is not None and config.writeback.mode != "off":
        conditions += _of_kind(config, OTHER_WRITER, 0.5)
    if complains:
        conditions += _of_kind(config, DEVICE, 0.5)
    # One reading that came late is no alarm: inputs have to be bad for as long as a value may be held.
    delay = STALE_PERIODS * config.scan.period
    conditions += _of_kind(config, INPUTS, 0.5, about=", ".join(inputs), on_delay=delay, off_delay=0.0)
    return {condition.name: condition for condition in conditions}
