"""Which alarms a machine has, from its configuration: their limits, delays, bits, and what an operator shall do."""

from dataclasses import replace
from shlex import join

from drivers.device_file import ACKNOWLEDGE_BITS
from gateway.machine.alarms.states import AlarmCondition
from gateway.machine.reading import STALE_PERIODS
from gateway.settings import Config

DEVICE = "device"
"""The alarm for what the device itself says is wrong with it."""
RECORDS, PARTS, CLOCK = "records", "parts", "clock"
"""The alarms for records that cannot be relied on, for another part of the gateway that failed (they share a bit), and
for a clock that cannot be relied on."""
INPUTS = "inputs bad"
"""The alarm for readings that a model needs, or that are watched, and that are not good."""
OTHER_WRITER = "another writer"
"""The alarm for what the PLC says of another gateway; it shares the bit of what the device says else."""
DRIFT_SINCE = "14d"
"""The span of the historian that a diagnosis is offered for: ten cycles or more of a plant that runs every day."""
REVIEW = "the readings lie beyond 3 sigma of the model too often: look at the sensor, then learn or correct the model"


def acknowledge_words(config: Config) -> dict[str, frozenset[str]]:
    """The tags of the PLC's acknowledge bits, each with the temperatures whose alarms are acknowledged by it."""
    of = {one.model.temperature: one.block_layout for one in config.followed}
    tags = {name: layout.acknowledge_bits if layout else ACKNOWLEDGE_BITS for name, layout in of.items()}
    return {tag: frozenset(name for name in tags if tags[name] == tag) for tag in tags.values()}


def name_of(config: Config, name: str, temperature: str) -> str:
    """The name of a model's alarm: that of the first temperature is plain, others have their tag behind it."""
    return name if temperature == config.model.temperature else f"{name} {temperature}"


def _of_model(config: Config) -> list[AlarmCondition]:
    """The alarms of one temperature's model."""
    a, tag, off = config.alarms, config.model.temperature, config.alarms.off_delay
    # When the model drifts the operator gets the command that diagnoses the historian's recent cycles.
    command = ["decanter", "diagnose", "--model", str(config.model.path), "--historian", str(config.historian.path)]
    command += ["--machine", config.machine] if config.several else []
    command += ["--since", DRIFT_SINCE, "--out", str(config.historian.path.parent / "diagnosis")]
    drifts = f"the model's free run is beyond its limit on {a.drift_cycles} cycles running"
    offer = f"{drifts}; find out what has changed with: {join(command)}"
    return [
        AlarmCondition("predicted over limit", tag, bit=1, limit=a.p_limit, deadband=a.p_limit / 2, off_delay=off),
        AlarmCondition("anomaly", tag, bit=2, limit=a.anomaly, deadband=a.anomaly / 3, off_delay=off, priority=3),
        AlarmCondition("review", tag, bit=5, limit=0.5, off_delay=off, priority=3, response=REVIEW),
        AlarmCondition("drift", tag, bit=3, limit=a.drift_cycles - 0.5, priority=3, response=offer),
    ]


def make_conditions(config: Config, inputs: tuple[str, ...], *, complains: bool = False) -> dict[str, AlarmCondition]:
    """The alarms by name; their bits are those of the block's alarm word.

    A driver that `complains` has an alarm of its own for what its device says.
    """
    a, period = config.alarms, config.scan.period
    tags, several = config.map.by_name, len(config.temperatures) > 1
    predicted = {row.tag for row in config.temperatures}
    conditions = [
        AlarmCondition(
            f"over limit {name}",
            name,
            bit=0,
            limit=config.limit_of(name),
            deadband=a.deadband,
            on_delay=a.on_delay,
            off_delay=a.off_delay,
            priority=1,
            response=f"{name} is above {config.limit_of(name):g} {tags[name].unit}: reduce the load and check the "
            "lubrication",
            temperature=name if several and name in predicted else "",
        )
        for name in config.watched
    ]
    for one in config.followed:
        if one.model.path is not None:
            own = _of_model(one)
            conditions += (
                [replace(c, name=name_of(config, c.name, c.tag), temperature=c.tag) for c in own] if several else own
            )
    # One reading that came late is no alarm: inputs have to be bad for as long as a value may be held.
    bad = AlarmCondition(INPUTS, ", ".join(inputs), bit=4, limit=0.5, on_delay=STALE_PERIODS * period)
    lost = "what happens may not be on record: see historian and parts in the status, and make room or mend the disk"
    failed = "a part of the gateway failed and was begun anew: see parts in the status and the log, and report it"
    wrong = "the clock has jumped: set it and start the gateway anew; nothing is deleted by age meanwhile"
    conditions += [
        AlarmCondition(RECORDS, config.machine, 7, 0.5, off_delay=a.off_delay, response=lost),
        AlarmCondition(PARTS, config.machine, 7, 0.5, off_delay=a.off_delay, response=failed),
        AlarmCondition(CLOCK, config.machine, 8, 0.5, off_delay=a.off_delay, priority=3, response=wrong),
    ]
    if config.map.writeback is not None and config.writeback.mode != "off":
        other = (
            "another gateway writes to this PLC: other_writer in the status is its number, writer is "
            "this one's; find it and disarm one of the two"
        )
        conditions.append(
            AlarmCondition(OTHER_WRITER, config.machine, 6, 0.5, off_delay=a.off_delay, priority=1, response=other)
        )
    if complains:
        response = "the device or its bus says that something is wrong: see complaints in the status"
        conditions.append(AlarmCondition(DEVICE, config.machine, 6, 0.5, off_delay=a.off_delay, response=response))
    return {condition.name: condition for condition in (*conditions, bad)}
