"""The alarms of a machine as a browser shows them: what is so now, what was so, and what tells of one cause. Pure."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from gateway.outside.status import AlarmStatus, GatewayStatus, link_sentence
from gateway.outside.texts import Words
from gateway.settings import ALARM_KINDS
from sim.units import display_unit

PUT_ASIDE = ("shelved", "suppressed by design", "out of service")
SECTIONS = ("standing", "over", "aside")
"""Where an alarm is shown: what stands, what is over and waits to be acknowledged, what somebody put aside."""
OF_A_TEMPERATURE = ("watched", "predicted")


def alarm_rows(words: Words, labels: Mapping[str, str], status: GatewayStatus) -> list[dict[str, Any]]:
    """The alarms that are not normal, by section, the most urgent first.

    Beside the fields of AlarmStatus each has its `section`; `of`, whose it is in the plant's words; `holds`, whether
    what it tells is so now; a `title` and a `sentence` in the present tense where it is, in the past where it was;
    `otherwise`, what comes if nobody acts ("" where it is not so now); its level; and `under`, the name of the row of
    the same cause above it ("": it is a row of its own).
    """
    rows = [_row(words, labels, status, alarm) for alarm in status.alarm_summary]
    rows.sort(key=lambda row: (SECTIONS.index(row["section"]), row["priority"], not row["holds"], row["since"]))
    heads: dict[tuple[str, str], str] = {}
    for row in rows:
        kind = ALARM_KINDS.get(row["kind"])
        of = f"{kind.cause} {row['tag']}" if kind is not None and kind.cause else row["name"]
        head = heads.setdefault((row["section"], of), row["name"])
        row["under"] = "" if head == row["name"] else head
    return rows


def _row(words: Words, labels: Mapping[str, str], status: GatewayStatus, alarm: AlarmStatus) -> dict[str, Any]:
    of = words.say("nav.plant") if alarm.of_plant else labels.get(status.machine, status.machine)
    section = "aside" if alarm.state in PUT_ASIDE else "standing" if alarm.active else "over"
    urgent = alarm.state == "unacknowledged" and alarm.priority == 1
    level = {"aside": "normal", "over": "over"}.get(section, "alarm" if urgent else "attention")
    of_temperature = alarm.kind in ALARM_KINDS and ALARM_KINDS[alarm.kind].subject in OF_A_TEMPERATURE
    # Of a temperature that is not read now nothing is so; what is wrong with the gateway itself needs no reading.
    known = alarm.beyond is not None and not (of_temperature and link_sentence(status))
    holds = alarm.standing and known and alarm.beyond is True
    response = _response(words, labels, status, alarm)
    return {
        **asdict(alarm),
        "label": of if alarm.of_plant else labels.get(alarm.tag, alarm.tag),
        "level": level,
        "of": of,
        "section": section,
        "holds": holds,
        "title": _title(words, labels, alarm, holds=holds, known=known, of_temperature=of_temperature),
        "response": response,
        "sentence": response if holds else _current_state(words, status, alarm, known=known),
        "otherwise": _consequence(words, alarm) if holds else "",
    }


def _title(
    words: Words, labels: Mapping[str, str], alarm: AlarmStatus, *, holds: bool, known: bool, of_temperature: bool
) -> str:
    """What it tells, of what in the plant's words; its own name where nobody knows its kind.

    What stands and may be so still is not said as what is over is.
    """
    key = f"{'kind' if holds else 'past'}.{alarm.kind.replace(' ', '_')}"
    if key not in words.texts:
        return alarm.name
    title = words.say(key)
    if alarm.standing and not known:
        title = words.say("alarm.last_known", title=title)
    return f"{labels.get(alarm.tag, alarm.tag)}: {title}" if of_temperature else title


def _current_state(words: Words, status: GatewayStatus, alarm: AlarmStatus, *, known: bool) -> str:
    """What is known of now, where it is not so that the alarm's condition is met."""
    if alarm.standing and not known:
        return words.say("alarm.not_known_now")
    parts = []
    tag = None if link_sentence(status) else status.values.get(alarm.tag)
    if tag is not None and tag.quality == "GOOD" and isinstance(tag.value, int | float):
        value = f"{words.number(tag.value, 1)}\u00a0{display_unit(tag.unit)}"
        parts.append(words.say("alarm.now", value=value))
    if alarm.standing:
        parts.append(words.say("alarm.ends"))
    return "; ".join(parts)


def _response(words: Words, labels: Mapping[str, str], status: GatewayStatus, alarm: AlarmStatus) -> str:
    """What an operator shall do: in this language, unless the plant file has words of its own."""
    key = f"response.{alarm.kind.replace(' ', '_')}"
    if alarm.own_response or key not in words.texts or alarm.limit is None:
        return alarm.response
    tag = status.values.get(alarm.tag)
    limit = words.number(alarm.limit, 0 if alarm.limit == int(alarm.limit) else 1)
    unit = "" if tag is None else display_unit(tag.unit)
    twin = words.say("word.twin")
    return words.say(key, tag=labels.get(alarm.tag, alarm.tag), twin=twin, limit=limit, unit=unit)


def _consequence(words: Words, alarm: AlarmStatus) -> str:
    """What comes of not acting: in this language, unless the plant file has words of its own."""
    kind = ALARM_KINDS.get(alarm.kind)
    if kind is None or alarm.consequence != kind.consequence:
        return alarm.consequence
    return words.of_code(f"consequence.{alarm.kind}")
