"""The kinds of alarms a machine may have, in one table, and what a plant file may say of each."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from drivers.errors import did_you_mean
from drivers.settings import Line, Section

MOST_URGENT, LEAST_URGENT = 1, 4
"""The priorities: 1 is the most urgent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmKind:
    """One kind: its bit in the block's alarm word (None: none), and its defaults, which a plant file may change.

    `subject` is what there is one of for each: the plant, a machine, a watched temperature of it, a predicted one.
    `namur` is the category of NAMUR NE 107 for what is wrong with a sensor: failure, out of specification or
    maintenance required. Delays are plant seconds. `{tag}`, `{limit}` and `{unit}` in `response` stand for the alarm's.
    """

    subject: Literal["plant", "machine", "watched", "predicted"]
    watches: str
    response: str
    consequence: str
    bit: int | None = None
    priority: int = 2
    on_delay: float = 0.0
    namur: str = ""


_LOOK_AT_SENSOR = "compare {tag} with a hand-held thermometer, then look at the sensor, its cable and its input"

ALARM_KINDS: Mapping[str, AlarmKind] = {
    "over limit": AlarmKind(
        subject="watched", bit=0, priority=1,
        watches="the measured temperature, against `alarms.limit`; it needs no model",
        response="{tag} is above {limit:g} {unit}: reduce the load and check the lubrication",
        consequence="the bearing is damaged within minutes to hours",
    ),
    "predicted over limit": AlarmKind(
        subject="predicted", bit=1,
        watches="the chance that the limit is passed within the block's horizon, against `alarms.p_limit`",
        response="{tag} will pass its limit: look at load and lubrication while there is time",
        consequence="the limit is reached, and the load has to be thrown off",
    ),
    "rising": AlarmKind(
        subject="watched",
        watches="where a straight line through the last minutes reaches `alarms.trend` s ahead, against the limit; it "
        "needs no model",
        response="{tag} rises towards {limit:g} {unit}: look at load and lubrication while there is time",
        consequence="the limit is reached, and the load has to be thrown off",
    ),
    "anomaly": AlarmKind(
        subject="predicted", bit=2, priority=3,
        watches="how unlikely the newest readings are by the model (out of distribution), against `alarms.anomaly`",
        response="the readings of {tag} do not fit the model: look at the machine and at its sensors",
        consequence="what is predicted is not to be relied on, and what the machine does is not what it used to do",
    ),
    "unfamiliar": AlarmKind(
        subject="predicted", bit=2, priority=3,
        watches="how strange the present cycle is to the model's training, against `alarms.unfamiliar`; only with a "
        "model that knows its training",
        response="the present cycle of {tag} is unlike the model's training: see familiarity in the status for what is "
        "strange, and do not rely on the forecast alone",
        consequence="the forecast is made for what nobody has seen, and its band may be too narrow",
    ),
    "drift": AlarmKind(
        subject="predicted", bit=3, priority=3,
        watches="the error of the model's free run, cycle by cycle (`alarms.drift`, `alarms.drift_cycles`)",
        response="the model's free run is beyond its limit on several cycles running; find out what has changed",
        consequence="the forecast is wrong by more than it says, in one direction",
    ),
    "inputs bad": AlarmKind(
        subject="machine", bit=4,
        watches="whether the readings that a model needs, or that are watched, are good",
        response="readings are old or bad: see values and link in the status, then look at PLC and cable",
        consequence="nothing is predicted, and a temperature over its limit may not be seen",
    ),
    "review": AlarmKind(
        subject="predicted", bit=5, priority=3,
        watches="how often readings lie outside 3 sigma of the model",
        response="the readings lie beyond 3 sigma of the model too often: look at the sensor, then learn or correct "
        "the model",
        consequence="the bands of the forecast are too narrow",
    ),
    "sensor out of range": AlarmKind(
        subject="watched", namur="failure", on_delay=5.0,
        watches="readings beyond the tag's `low` and `high`, or that the device calls a failed sensor",
        response=_LOOK_AT_SENSOR,
        consequence="the temperature is not known, and neither is whether it is over its limit",
    ),
    "sensor frozen": AlarmKind(
        subject="watched", namur="failure",
        watches="a reading that does not move a bit while its twin, or the machine, does",
        response=_LOOK_AT_SENSOR,
        consequence="a bearing that heats is not seen",
    ),
    "sensor jumping": AlarmKind(
        subject="watched", namur="out of specification", priority=3,
        watches="steps between readings that no bearing can take",
        response=_LOOK_AT_SENSOR,
        consequence="single readings are wrong, as by a loose contact; the alarm at the limit may come in vain",
    ),
    "sensor noisy": AlarmKind(
        subject="watched", namur="out of specification", priority=3,
        watches="the spread of the readings about a straight line through each three of them",
        response=_LOOK_AT_SENSOR,
        consequence="alarms come in vain, and the forecast begins from a wrong temperature",
    ),
    "sensor drifting": AlarmKind(
        subject="watched", namur="maintenance required", priority=3,
        watches="the difference to its twin bearing, against what that was before",
        response=_LOOK_AT_SENSOR + "; if it is right, this bearing is warmer than the other",
        consequence="the limit is reached later, or earlier, than it is seen",
    ),
    "link": AlarmKind(
        subject="machine", priority=1, on_delay=10.0,
        watches="whether good readings arrive at all",
        response="no good reading arrives: see link in the status, then look at network, cable and PLC",
        consequence="the machine is not watched",
    ),
    "device": AlarmKind(
        subject="machine", bit=6,
        watches="what the device itself says is wrong with it (as by EMCY)",
        response="the device or its bus says that something is wrong: see complaints in the status",
        consequence="readings may fail or be wrong",
    ),
    "another writer": AlarmKind(
        subject="machine", bit=6, priority=1,
        watches="the PLC's word of another gateway that writes its blocks",
        response="another gateway writes to this PLC: other_writer in the status is its number, writer is this one's; "
        "find it and disarm one of the two",
        consequence="the PLC takes the other one's blocks, or nobody's",
    ),
    "records": AlarmKind(
        subject="machine", bit=7,
        watches="whether historian, audit log and log take what happens",
        response="what happens may not be on record: see historian and parts in the status, and make room or mend the "
        "disk",
        consequence="what happens is lost, and an armed gateway disarms itself",
    ),
    "parts": AlarmKind(
        subject="machine", bit=7,
        watches="parts of the gateway that failed and were begun anew, or could not be begun, as a model whose file is "
        "damaged",
        response="a part of the gateway failed or could not be begun: see parts in the status and the log, and report "
        "it",
        consequence="what that part does is late or missing",
    ),
    "clock": AlarmKind(
        subject="machine", bit=8, priority=3,
        watches="the clock, against the newest record, the monotonic clock and the PLC's (`clock.tag`)",
        response="the clock has jumped: set it and start the gateway anew; nothing is deleted by age meanwhile",
        consequence="times in the records are wrong",
    ),
    "clock not steered": AlarmKind(
        subject="plant", priority=4, on_delay=3600.0,
        watches="whether a time server steers this computer's clock, by the kernel's own account",
        response="no time server steers the clock: see timedatectl, and have NTP set up; where there shall be none, "
        "switch this alarm off",
        consequence="the clock drifts by seconds a day, and times of this gateway and of others cannot be compared",
    ),
    "disk": AlarmKind(
        subject="plant",
        watches="the room that is left where the records lie, against `alarms.disk_mb`",
        response="the disk is nearly full: make room, or lower historian.max_mb",
        consequence="the oldest measurements go, and in the end nothing is on record",
    ),
    "certificate": AlarmKind(
        subject="machine", priority=3,
        watches="the days until a certificate of the link or of the OPC UA server runs out, against "
        "`alarms.certificate_days`",
        response="a certificate of the link or of the OPC UA server runs out: have a new one made and put in its place",
        consequence="from that day on the PLC refuses the gateway and the machine is not watched, or the clients of "
        "the OPC UA server refuse it and see nothing",
    ),
    "notification": AlarmKind(
        subject="plant", priority=3,
        watches="whether messages about alarms are delivered",
        response="messages about alarms are not delivered: see the log for the recipient, then mail server or web hook",
        consequence="nobody who is away from the page hears of an alarm",
    ),
    "northbound": AlarmKind(
        subject="plant", priority=3, on_delay=300.0,
        watches="whether the brokers and databases that are told what is on record can be reached",
        response="a broker or database is out of reach: see the log for which one and why, then network and server",
        consequence="other systems show old values, and what is older than northbound.backlog_hours never comes there",
    ),
}  # fmt: skip
"""Every kind by its name, in the order in which they are shown."""

PLANT = "plant"
"""What an alarm of the whole plant names in place of a tag, where there are several machines."""
OF_PLANT = frozenset(name for name, kind in ALARM_KINDS.items() if kind.subject == "plant")
"""The kinds that a plant has once, whatever its machines: its first machine looks after them."""


def alarm_subject(alarm: str, tag: str, machine: str) -> str:
    """Whose an alarm is that names a tag: PLANT for one of a plant of several machines, else the machine.

    Rows on record from before a plant had such an alarm once name the machine, and are its.
    """
    return PLANT if alarm in OF_PLANT and tag == PLANT else machine


def kind_of(alarm: str) -> str:
    """The kind of an alarm by its name, which may have a tag behind it; "" for one that is in no table."""
    return max((kind for kind in ALARM_KINDS if f"{alarm} ".startswith(f"{kind} ")), key=len, default="")


Priority = Annotated[int, Field(ge=MOST_URGENT, le=LEAST_URGENT)]


class AlarmRow(Section):
    """`[[alarm]]`: what is other than by default of one kind of alarms, on all tags or on one. Later rows count more.

    What is not given stays as it is.
    """

    name: str = Field(description="the name of a kind of alarm, as `decanter alarm list` shows it without the tag")
    tag: str | None = Field(None, description="the tag of one temperature; all without this key")
    enabled: bool | None = Field(None, description="true or false: whether there is such an alarm at all")
    priority: Priority | None = Field(
        None, description=f"a priority from {MOST_URGENT}, the most urgent, to {LEAST_URGENT}"
    )
    deadband: float | None = Field(None, ge=0, description="by how much it must fall below its limit to be over")
    on_delay: float | None = Field(None, ge=0, description="seconds that it must stand before it is raised")
    off_delay: float | None = Field(None, ge=0, description="seconds that it must be over before it returns")
    response: Line | None = Field(None, description="one line of what an operator shall do")
    consequence: Line | None = Field(None, description="one line of what comes of not doing it")
    latch: bool | None = Field(None, description="true: it stays until it is reset, false: it goes by itself")
    suppressed_by: str | None = Field(
        None, description="'TAG' or 'TAG=0': the alarm is suppressed while that tag is not 0 (is 0)"
    )

    @field_validator("name")
    @classmethod
    def _a_kind(cls, name: str) -> str:
        if name not in ALARM_KINDS:
            guess = did_you_mean(name, list(ALARM_KINDS))
            raise ValueError(f"there is no alarm {name[:60]!r}; {guess or 'give one of ' + ', '.join(ALARM_KINDS)}")
        return name

    @field_validator("suppressed_by")
    @classmethod
    def _tag_and_value(cls, text: str | None) -> str | None:
        if text is not None and (not suppressing(text)[0] or text.partition("=")[2] not in ("", "0", "1")):
            raise ValueError(f"{text[:60]!r} is neither 'TAG', 'TAG=1' nor 'TAG=0'; give the name of a tag")
        return text


def suppressing(text: str) -> tuple[str, float]:
    """The tag of a `suppressed_by`, and the value (0 or 1 for anything else) by which it suppresses."""
    tag, _, value = text.partition("=")
    return tag, 0.0 if value == "0" else 1.0


def settings_of(rows: Iterable[AlarmRow], kind: str, tag: str = "") -> dict[str, Any]:
    """What the rows say of a kind's alarm on a tag ("": of the machine), key by key; a later row goes over a former."""
    found: dict[str, Any] = {}
    for row in rows:
        if row.name == kind and row.tag in (None, tag):
            found |= row.model_dump(exclude_none=True, exclude={"name", "tag"})
    return found


def alarm_problems(
    rows: Iterable[AlarmRow], tags: Iterable[str], watched: Iterable[str], predicted: Iterable[str], file: object
) -> list[str]:
    """What no single key of the rows shows: tags that are not there, or of which there is no such alarm."""
    known, problems = set(tags), []
    of = {"watched": list(watched), "predicted": list(predicted), "machine": list[str](), "plant": list[str]()}
    for place, row in enumerate(rows):
        subjects = of[ALARM_KINDS[row.name].subject]
        if row.tag is not None and row.tag not in subjects:
            whose = ALARM_KINDS[row.name].subject
            right = f"give one of {', '.join(subjects)}" if subjects else f"leave the key out: it is the {whose}'s"
            problems.append(f"alarm[{place}].tag: there is no alarm {row.name!r} of {row.tag!r}; {right}")
        if row.suppressed_by is not None and (tag := suppressing(row.suppressed_by)[0]) not in known:
            problems.append(f"alarm[{place}].suppressed_by: {tag!r} is not a tag of {file}; give one of its names")
    return problems
