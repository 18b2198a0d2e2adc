"""The report of a shift as a mail has it: plain text in one language, with the words of the page. Pure."""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from gateway.outside.texts import Words
from gateway.outside.web.views import duration
from sim.units import display_unit


def shift_title(words: Words, report: Mapping[str, Any]) -> str:
    """Of which time it is; a mail is read anywhere, so that its times are UTC and say so."""
    return words.say("shift.title", **{"from": _moment(report["start"]), "to": f"{_moment(report['end'])} UTC"})


def shift_text(words: Words, labels: Mapping[str, str], units: Mapping[str, str], report: Mapping[str, Any]) -> str:
    """The whole report; `units` are those of the temperatures by their tags."""
    lines = [shift_title(words, report), ""]
    there = report["on_shift"]
    lines.append(
        words.say("shift.nobody")
        if there is None
        else words.say("shift.there", names=there["names"], by=words.by_whom(there["by"]), since=_moment(there["time"]))
    )
    for name, machine in report["machines"].items():
        lines += ["", labels.get(name, name), *(f"  {line}" for line in _machine(words, labels, units, machine))]
    notes = [f"{_moment(note['time'])}  {_note(words, labels, note)}" for note in report["notes"]]
    deeds = [f"{_moment(deed['time'])}  {_deed(words, labels, deed)}" for deed in report["deeds"]]
    for title, key, found in (("note.notes", "notes", notes), ("shift.deeds", "deeds", deeds)):
        before = report["left_out"][key]
        more = [words.say("shift.left_out", count=before)] if before else []
        lines += ["", words.say(title), *(f"  {line}" for line in more + found or [words.say("word.none")])]
    return "\n".join(lines) + "\n"


def _machine(
    words: Words, labels: Mapping[str, str], units: Mapping[str, str], machine: Mapping[str, Any]
) -> Iterator[str]:
    for row in machine["temperatures"]:
        label, unit = labels.get(row["tag"], row["tag"]), display_unit(units.get(row["tag"], ""))
        hottest, nearest = row["hottest"], row["nearest"]
        said = "–" if hottest is None else f"{words.number(hottest['value'], 1)} {unit} ({_moment(hottest['time'])})"
        limit = f"{words.say('word.limit')} {words.number(row['limit'], 1)} {unit}"
        yield f"{label}: {words.say('shift.hottest')} {said}, {limit}"
        if not nearest["forecasts"]:
            said = words.say("shift.no_forecasts")
        elif nearest["minutes"] is None:
            said = f"> {words.minutes(nearest['horizon'])} min"
        else:
            said = f"{words.number(nearest['minutes'], 1)} min ({_moment(nearest['time'])})"
        yield f"{label}: {words.say('shift.nearest')} {said}"
    gone = machine["unwatched"]
    unread = f"{duration(words, gone['seconds'])} ({gone['count']})" if gone["count"] else words.say("word.none")
    yield f"{words.say('shift.unwatched')}: {unread}"
    blocks = ", ".join(f"{words.of_code(f'verdict.{verdict}')} {count}" for verdict, count in machine["writes"].items())
    yield f"{words.say('score.blocks')}: {blocks or words.say('word.none')}"
    yield f"{words.say('nav.alarms')}:" if machine["alarms"] else words.say("shift.no_alarms")
    for one in machine["alarms"]:
        by = words.say("shift.by_nobody")
        if one["acknowledged"]:
            by = f"{words.by_whom(one['by'])}, {duration(words, one['acknowledged'] - one['raised'])}"
        title = _title(words, labels, one, "kind" if one["ended"] is None else "past")
        outcome = f"{_outcome(words, one)}; {words.say('alarm.acknowledged_by')} {by}"
        yield f"  {_moment(one['raised'])}  {title}: {outcome}"


def _title(words: Words, labels: Mapping[str, str], one: Mapping[str, Any], tense: str = "past") -> str:
    """What is or was, of what in the plant's words; its own name where nobody knows its kind."""
    if not one["kind"]:
        return str(one["alarm"])
    said = words.of_code(f"{tense}.{one['kind']}")
    alone = one["alarm"] == one["kind"] or one.get("of_plant")
    return said if alone else f"{labels.get(one['tag'], one['tag'])}: {said}"


def _outcome(words: Words, one: Mapping[str, Any]) -> str:
    """What came of an alarm; of a warning, whether the limit was passed while it stood."""
    ended = (
        words.say("shift.stands")
        if one["ended"] is None
        else words.say("shift.over_after", age=duration(words, one["ended"] - one["raised"]))
    )
    if not one["warning"]:
        return ended
    after = one["limit_after"]
    open_key = "shift.not_passed_yet" if one["ended"] is None else "shift.not_passed"
    passed = words.say(open_key) if after is None else words.say("shift.passed", age=duration(words, after))
    return f"{passed}; {ended}"


def _note(words: Words, labels: Mapping[str, str], note: Mapping[str, Any]) -> str:
    return f"{labels.get(note['machine'], note['machine'])}: {note['text']} ({words.by_whom(note['by'])})"


def _deed(words: Words, labels: Mapping[str, str], deed: Mapping[str, Any]) -> str:
    what = words.of_code(f"deed.{deed['kind'].replace(':', '').replace('-', '_')}")
    alarm = deed["alarm"] and _title(words, labels, deed["alarm"])
    machine = labels.get(deed["machine"], deed["machine"])
    parts = [f"{words.by_whom(deed['by'])}: {what}", machine, alarm, deed["version"], deed["reason"]]
    return ", ".join(part for part in parts if part)


def _moment(time: float) -> str:
    return f"{datetime.fromtimestamp(time, UTC):%Y-%m-%d %H:%M:%S}"
