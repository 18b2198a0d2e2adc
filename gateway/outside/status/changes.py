"""What a person is told of a running gateway: three lines at the start, then one line for each change of its state."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from gateway.outside.status.health import link_sentence, not_good, readings_sentence, records_sentence, virtual_sentence
from gateway.outside.status.picture import GatewayStatus, TemperatureStatus
from sim.strict_json import escape_text

FIRST_HOLD, LONGEST_HOLD = 2.0, 300.0
"""For how long (real s) a topic is not spoken of again: doubled while it keeps changing, up to the longest."""
MIN_CHANGES_TO_REPORT = 4
"""So many changes since the last line are worth another one, also where the last of them led back."""
SAID_BY_CHANGES = frozenset(
    {
        "good readings arrive",
        "no good reading any more",
        "no good reading",
        "another link is used",
        "alarm",
        "the model in place of a bad sensor",
        "the present cycle is unlike the training",
        "the cycle is familiar again",
        "armed",
        "disarmed",
        "a promoted model runs from now on",
        "the promoted model is refused and the former one goes on",
        "the records cannot be relied on",
        "the records can be relied on again",
        "the clock cannot be relied on",
        "the clock can be relied on again",
    }
)
"""Events of the log that these lines say too: who reads the lines needs them only in the file."""

MODES = {"off": "off, nothing is computed for the PLC", "shadow": "shadow, computed and not written"}


def clock_text(time: float) -> str:
    """The time of day of plant seconds UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%H:%M:%SZ")


def date_text(time: float) -> str:
    """The date and minute of seconds UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def model_text(status: GatewayStatus) -> str:
    """The model that runs and the date of its file."""
    model = status.model
    if model is None:
        return "none: threshold alarm and records only"
    version = f", version {model.version}" if model.version else ""
    written = f" of {date_text(model.written)}" if model.written is not None else ""
    return f"{model.name} {model.hash[:8]}{written}{version}"


def arming_text(status: GatewayStatus) -> str:
    """The mode of the write-back; where it is armed, by whom and until when."""
    w = status.writeback
    if w["mode"] != "armed" or w.get("armed_until") is None:
        return MODES.get(w["mode"], str(w["mode"]))
    return f"ARMED by {w['armed_by']} until {clock_text(w['armed_until'])}, blocks are written to the PLC"


def opening_lines(status: GatewayStatus) -> tuple[str, str, str]:
    """The three lines with which a run begins."""
    predicts = f"; predicts {status.temperature}" if status.model else f"; watches {status.temperature}"
    return (
        f"model    {model_text(status)}{predicts}, limit {status.limit:g} {status.unit}",
        f"PLC      {status.place}, read every {status.scan.period:g} s; write-back {arming_text(status)}",
        f"records  {status.historian.path}; the live panel: decanter top",
    )


@dataclass(frozen=True, slots=True)
class Topic:
    """One thing that changes: two equal `key`s are the same state. `usual`: not worth a line as the first state."""

    key: object
    sentence: str
    usual: bool = False


def topics(status: GatewayStatus) -> Iterator[tuple[str, Topic]]:
    """Every topic on which something can be said now, by name."""
    if status.scan.age is not None:
        link = link_sentence(status)
        active = next((str(each["name"]) for each in status.links if each["active"]), "")
        over = f" over {active}" if len(status.links) > 1 else ""
        # The reason of a dead link holds seconds that count on: by what it is, not by what it says.
        yield "link", Topic((bool(link), active), f"link: {link or 'good readings arrive' + over}")
        if not link:
            bad = readings_sentence(status)
            key = tuple((name, tag.quality) for name, tag in not_good(status))
            yield "readings", Topic(key, f"quality: {bad or 'all readings are good'}", usual=not bad)
    if (p := status.prediction) is not None and status.link.alive:
        location = "not known" if not p.known else p.location
        if (f := p.familiarity) is not None:
            known = {True: f"unlike the training: {f.sentence}", False: "as in training"}[f.outside]
            said = "unknown" if f.zone == "unknown" else known
            yield "familiarity", Topic((f.zone == "unknown", f.outside), f"familiarity: {said}", usual=not f.outside)
        yield "zone", Topic(p.zone, f"confidence: {p.zone} (state {location})", usual=p.zone == "none")
    temperatures: tuple[GatewayStatus | TemperatureStatus, ...] = (status, *status.further)
    for one in temperatures:
        if one.prediction is not None:
            v, bad = one.prediction.virtual, virtual_sentence(status, one)
            sentence = f"sensor: {bad or one.temperature + ' is measured again'}"
            yield f"sensor {one.temperature}", Topic(v and bad and (v.stopped or "model"), sentence, usual=not bad)
    w = status.writeback
    arming = (w["mode"], w.get("armed_by"), w.get("armed_until"))
    yield "arming", Topic(arming, f"write-back: {arming_text(status)}", usual=w["mode"] != "armed")
    summary = {alarm.name: alarm for alarm in status.alarm_summary}
    for name, state in status.alarms.items():
        alarm = summary.get(name)
        response = f": {alarm.response}" if alarm is not None and alarm.active and alarm.response else ""
        said = "raised" if state == "unacknowledged" else "over" if state.startswith("returned") else state
        yield f"alarm {name}", Topic(state, f"alarm {said}: {name}{response}", usual=state == "normal")
    if status.model is not None:
        model = (status.model.hash, status.model.refused)
        refused = f"; the promoted one is refused: {status.model.refused}" if status.model.refused else ""
        yield "model", Topic(model, f"model: {model_text(status)}{refused}", usual=not refused)
    records = records_sentence(status)
    yield "records", Topic(bool(records), f"records: {records or 'all is stored'}", usual=not records)
    wrong = str(status.clock.get("complaint") or "")
    yield "clock", Topic(bool(wrong), f"clock: {wrong or 'believed again'}", usual=not wrong)
    complaints = tuple(status.complaints)
    sentence = "; ".join(complaints[:2]) or "nothing to complain of any more"
    yield "device", Topic(complaints, f"device: {sentence}", usual=not complaints)


@dataclass(slots=True)
class _Said:
    """The state of a topic that was said last, when (monotonic s), for how long it rests, and what changed since."""

    key: object
    at: float
    hold: float = FIRST_HOLD
    seen: object = None
    changes: int = 0


class ChangeLines:
    """Picks the lines worth saying out of one status after another.

    A line says what is different from what was said last of its topic. What changes to and fro is said at growing
    intervals, with a count, and what went and came back meanwhile not at all.
    """

    def __init__(self) -> None:
        self._said: dict[str, _Said] = {}

    def take(self, status: GatewayStatus, now: float) -> list[str]:
        """The lines for this status; `now` is monotonic (s)."""
        lines: list[str] = []
        for name, topic in topics(status):
            said = self._said.get(name)
            if said is None:
                self._said[name] = _Said(topic.key, now - LONGEST_HOLD, seen=topic.key)
                if not topic.usual:
                    self._said[name].at = now
                    lines.append(f"{clock_text(status.time)} {topic.sentence}")
                continue
            if topic.key != said.seen:
                said.seen, said.changes = topic.key, said.changes + 1
            rested = now - said.at
            if rested < said.hold:
                continue
            if topic.key != said.key or said.changes >= MIN_CHANGES_TO_REPORT:
                often = f" (changed {said.changes} times in {rested:.0f} s)" if said.changes > 1 else ""
                lines.append(f"{clock_text(status.time)} {topic.sentence}{often}")
                hold = min(2.0 * said.hold, LONGEST_HOLD) if rested < 2.0 * said.hold else FIRST_HOLD
                self._said[name] = _Said(topic.key, now, hold, seen=topic.key)
            elif said.changes:
                # It went and came back: the last line still says how it is.
                said.at, said.changes = now, 0
        # Reasons hold what devices have said, and may be shown on a terminal.
        return [str(escape_text(line)) for line in lines]
