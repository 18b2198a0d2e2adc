"""What a browser is shown of a machine: its status, and the sentences that people read first. Pure; no clock, no file.

Numbers are made into sentences here and nowhere else; who reads the REST interface gets the same ones.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import isfinite
from typing import Any

from gateway.outside.status import (
    FamiliarityStatus,
    ForecastStatus,
    GatewayStatus,
    HealthFinding,
    TagStatus,
    TemperatureStatus,
    findings,
    judge_health,
    link_sentence,
    unfamiliar_sentence,
)
from gateway.outside.texts import Words, strange_sentence
from gateway.outside.web.alarm_view import alarm_rows
from gateway.outside.web.arming_view import arming_view, machine_mode
from sim.phrase import translate
from sim.units import display_unit

LEVELS = ("normal", "over", "attention", "unknown", "alarm")
"""What a row asks of people, the least first; beyond the second it has a colour (ISA-101: grey is normal)."""
DOUBTFUL_ZONES = ("yellow", "red")
MOST_NAMED = 3
"""How many readings a finding names."""
NARROW_BAND, USELESS_BAND = 0.8, 0.6
"""A 90 % band that held less than this share of what came is no reason for high confidence, or for any."""


def machine_view(words: Words, labels: Mapping[str, str], status: GatewayStatus) -> dict[str, Any]:
    """A machine as plain values: `status` whole, `temperatures` with a sentence each, its level and what is wrong.

    Those that are only watched come after those that are predicted; `labels` are words for people by tags.
    """
    first = TemperatureStatus(**{field.name: getattr(status, field.name) for field in fields(TemperatureStatus)})
    watched = (_watched_status(status, tag, limit) for tag, limit in status.watched.items())
    temperatures = [_temperature(words, labels, status, one) for one in (first, *status.further, *watched)]
    alarms = alarm_rows(words, labels, status)
    own = [alarm for alarm in alarms if not alarm["of_plant"]]
    for place, row in enumerate(temperatures):
        row["alarms"] = [each["name"] for each in own if _belongs(each, row["tag"], temperatures, first=place == 0)]
        row["action"] = _action(words, row, [each for each in own if each["name"] in row["alarms"]])
    return {
        "label": labels.get(status.machine, status.machine),
        "level": max((row["level"] for row in (*temperatures, *own)), key=LEVELS.index),
        "health": judge_health(status).value,
        "findings": [
            {"check": each.check, "sentence": _finding_text(words, status, alarms, each)} for each in findings(status)
        ],
        "link_reason": link_reason(words, status),
        "link_reasons": [_told(words, link.get("reason") or "") for link in status.links],
        "reasons": {name: _told(words, tag.reason) for name, tag in status.values.items() if tag.reason},
        "temperatures": temperatures,
        "labels": {name: labels[name] for name in status.values if name in labels},
        "alarms": alarms,
        "mode": machine_mode(status),
        "arming": arming_view(words, labels, status),
        "status": status,
    }


def _belongs(alarm: Mapping[str, Any], tag: str, temperatures: Sequence[Mapping[str, Any]], *, first: bool) -> bool:
    """Whether an alarm stands in a temperature's row: its own, and in the machine's first row what is of none."""
    return bool(alarm["tag"] == tag or (first and all(alarm["tag"] != row["tag"] for row in temperatures)))


def _action(words: Words, row: Mapping[str, Any], alarms: Sequence[Mapping[str, Any]]) -> str:
    """What a person has to do about a temperature: by its most urgent alarm that holds, else by what is foreseen.

    What was put aside asks for nothing, and nothing less than an alarm goes before a limit that is passed.
    """
    standing = [each for each in alarms if each["holds"] and each["sentence"] and each["section"] == "standing"]
    holding = standing[0] if standing else None
    hot = row["level"] == "alarm" and row["value"] is not None
    if holding is not None and not (hot and holding["level"] != "alarm"):
        return str(holding["sentence"])
    if row["level"] in ("alarm", "attention") and row["value"] is not None:
        kind = "over_limit" if hot else "predicted_over_limit"
        limit = words.number(row["limit"], 0 if row["limit"] == int(row["limit"]) else 1)
        return words.say(f"response.{kind}", tag=row["label"], limit=limit, unit=row["unit"])
    if row["level"] in ("unknown", "attention"):
        return words.say("action.look")
    waiting = any(alarm["state"].endswith("unacknowledged") for alarm in alarms)
    return words.say("action.acknowledge" if waiting else "action.nothing")


def reading_reason(words: Words, tag: TagStatus) -> str:
    """Why a reading is not good: the driver's sentence where this language has words for it, else by its quality."""
    return words.reason(tag.reason) or words.of_code(f"quality.{tag.quality.lower()}")


def _told(words: Words, reason: str) -> str:
    """A driver's sentence where it stands beside the quality: marked where it is English, as this language has none."""
    return words.reason(reason) or translate(words.language, reason) if reason else ""


def link_reason(words: Words, status: GatewayStatus) -> str:
    """Why no good readings arrive: what most tags say; "" while they do."""
    bad = Counter(reading_reason(words, tag) for tag in status.values.values() if tag.quality != "GOOD")
    own = words.reason(status.link.reason)
    return "" if status.link.alive else own or (bad.most_common(1)[0][0] if bad else "")


def _finding_text(
    words: Words, status: GatewayStatus, alarms: Sequence[Mapping[str, Any]], finding: HealthFinding
) -> str:
    """What a check found, in the reader's language where it is made of codes; else the gateway's sentence."""
    if finding.check == "alarms":
        return "; ".join(
            f"{row['of'] + ': ' if row['of_plant'] else ''}{row['title']} ({words.of_code('alarm.' + row['state'])})"
            for row in alarms
            if row["active"]
        )
    if words.language == "en":
        return finding.sentence
    if finding.check == "link" and (reason := link_reason(words, status)):
        return words.say("found.link", reason=reason)
    bad = [f"{name} ({reading_reason(words, tag)})" for name, tag in status.values.items() if tag.quality != "GOOD"]
    if finding.check == "readings":
        names = ", ".join(bad[:MOST_NAMED]) + (" …" if len(bad) > MOST_NAMED else "")
        return words.say("found.readings", count=len(bad), all=len(status.values), names=names)
    return translate(words.language, finding.sentence)


def _watched_status(status: GatewayStatus, tag: str, limit: float) -> TemperatureStatus:
    """A temperature that has a limit and is not predicted."""
    unit = status.values[tag].unit if tag in status.values else status.unit
    return TemperatureStatus(
        temperature=tag,
        unit=unit,
        limit=limit,
        prediction=None,
        forecast=None,
        model=None,
        guards=None,
        writeback={"mode": "off"},
    )


def _temperature(
    words: Words, labels: Mapping[str, str], status: GatewayStatus, one: TemperatureStatus
) -> dict[str, Any]:
    """A followed temperature: its newest value if that is a present one, the sentence, and what that is worth."""
    tag, unit = status.values.get(one.temperature), display_unit(one.unit)
    label = labels.get(one.temperature, one.temperature)
    what = f"{labels.get(status.machine, status.machine)}: {label}"
    silence = link_sentence(status)
    present = not silence and tag is not None and tag.quality == "GOOD" and isinstance(tag.value, int | float)
    v = one.prediction.virtual if one.prediction is not None and not silence else None
    value = float(tag.value) if present and tag is not None and isinstance(tag.value, int | float) else None
    row: dict[str, Any] = {
        "tag": one.temperature,
        "label": label,
        "predicted": one.temperature not in status.watched,
        "unit": unit,
        "limit": one.limit,
        "value": value,
        "quality": "" if tag is None else tag.quality,
        "age": None if tag is None else tag.age / status.speed,
        "valid": "none",
        "familiarity": None if one.prediction is None else _familiarity(words, one.prediction.familiarity),
        "confidence": None if one.prediction is None else _confidence(words, one.prediction.zone, one.forecast),
        "to_limit": None if one.forecast is None else _to_limit(words, one.forecast),
        "when": ["–", words.say("when.unknown")],
    }
    # What a faulty sensor shows is no measurement; but above the limit nobody leaves it at that.
    if v is not None and (value is None or value <= one.limit):
        age = duration(words, (status.time - v.since) / status.speed)
        if v.mean is None or v.low is None or v.high is None:
            why = words.say(f"why.{v.stopped.replace(' ', '_')}")
            sentence = words.say("sentence.virtual_stopped", what=what, age=age, why=why)
            own = {"level": "unknown", "sentence": sentence, "validity": words.say("validity.none")}
        else:
            mean, low, high = (words.number(x, 0 if v.high - v.low >= 2.0 else 1) for x in (v.mean, v.low, v.high))
            value_of_model = f"{mean}\u00a0{unit}"
            key = "sentence.virtual_twin" if v.twin else "sentence.virtual"
            sentence = words.say(key, what=what, age=age, value=value_of_model, low=low, high=high)
            own = {"level": "attention", "sentence": sentence, "validity": words.say("validity.virtual")}
            own["valid"] = "doubtful"
        return {**row, "value": None, **own}
    if value is None:
        if silence and status.link.last_good is not None:
            gone = (status.time - status.link.last_good) / status.speed
            sentence = words.say("sentence.no_reading", what=what, age=duration(words, gone))
        elif silence or tag is None:
            sentence = words.say("sentence.never_read", what=what)
        else:
            sentence = words.say("sentence.bad", what=what, reason=reading_reason(words, tag))
        return {**row, "level": "unknown", "sentence": sentence, "validity": words.say("validity.none")}
    shown = f"{words.number(value, 1)}\u00a0{unit}"  # never broken between number and unit
    limit = f"{words.number(one.limit, 0 if one.limit == int(one.limit) else 1)}\u00a0{unit}"
    forecast = one.forecast
    known = one.prediction is not None and one.prediction.known
    if forecast is None or not forecast.usable or not known:
        why = "no_model" if one.model is None else "unknown_state" if not known else "old_forecast"
        sentence = words.say("sentence.no_forecast", what=what, value=shown, why=words.say(f"why.{why}"))
        worth: tuple[str, str] = ("none", words.say("validity.measured"))
    else:
        sentence = _foreseen(words, forecast, what=what, shown=shown, limit=limit)
        row["when"] = _when(words, forecast)
        zone = one.prediction.zone if one.prediction is not None else "none"
        worth = _worth(words, zone, measured_coverage(forecast))
        if unfamiliar_sentence(one) and row["familiarity"] is not None:
            worth = ("doubtful", f"{words.say('validity.unfamiliar')}: {row['familiarity']['sentence']}")
        if one.model is not None and one.model.verdict == "unfit":
            worth = ("doubtful", words.say("validity.unfit"))
        if unusual := _beyond_past(words, forecast, unit):
            # Said and no doubt of its own: what is far from all that was measured may be the machine that fails.
            worth = (worth[0], f"{worth[1]}; {unusual}")
    level = "normal"
    if value > one.limit:
        # This is measured: what the forecast is worth says nothing of it.
        level, sentence = "alarm", words.say("sentence.over", what=what, value=shown, limit=limit)
        row["when"] = ["0\u00a0min", words.say("when.over_by", value=words.number(value - one.limit, 1), unit=unit)]
        row["to_limit"] = row["to_limit"] and {"median": "0", "band": row["when"][1]}
        worth = ("good", words.say("validity.measured"))
    elif worth[0] != "none" and forecast is not None and minutes_to_limit(forecast)[1] is not None:
        level = "attention"
    return {**row, "level": level, "sentence": sentence, "valid": worth[0], "validity": worth[1]}


def _familiarity(words: Words, f: FamiliarityStatus | None) -> dict[str, Any] | None:
    """How like its training the present cycle is: zone, word, and the sentence of what is strange; None not known."""
    if f is None or f.strangeness is None:
        return None
    parts = {"value": words.number(f.strangeness, 2), "limit": words.number(f.limit, 2)}
    detail = [words.say("familiarity.strangeness", **parts)]
    if f.expected_error is not None:
        detail.append(words.say("familiarity.expected", percent=words.number(100.0 * f.expected_error, 0)))
    word = words.say("familiarity.unfamiliar" if f.outside else "familiarity.familiar")
    return {"zone": f.zone, "word": word, "sentence": strange_sentence(words, f.thing), "detail": "; ".join(detail)}


def measured_coverage(forecast: ForecastStatus | None) -> float | None:
    """The share of recent 90 % bands that held what came, over the horizons; None where it is not measured yet."""
    found = [share for share in (forecast.coverage if forecast is not None else ()) if share is not None]
    return sum(found) / len(found) if found else None


def _worth(words: Words, zone: str, coverage: float | None) -> tuple[str, str]:
    """Whether a forecast is good or doubtful, and why: by its model's zone and by how often its band held."""
    if zone != "green":
        return ("doubtful" if zone in DOUBTFUL_ZONES else "good", words.say(f"validity.{zone}"))
    if coverage is None:
        return ("good", words.say("validity.unmeasured"))
    held = words.say("word.coverage_of", percent=words.number(100.0 * coverage, 0))
    return (
        ("doubtful", words.say("validity.narrow", held=held))
        if coverage < NARROW_BAND
        else ("good", words.say("validity.green", held=held))
    )


def _beyond_past(words: Words, forecast: ForecastStatus, unit: str) -> str:
    """That the forecast is beyond 3 sd of what came after like moments, where it is most; "" where it is not."""
    flagged = [
        (abs(past.deviations), horizon, past)
        for horizon, past in zip(forecast.horizons, forecast.past, strict=False)
        if past is not None and past.flagged
    ]
    if not flagged:
        return ""
    deviations, horizon, past = max(flagged, key=lambda each: each[0])
    return words.say(
        "validity.beyond_past",
        minutes=words.minutes(horizon),
        deviations=words.number(deviations, 1),
        mean=words.number(past.mean, 1),
        sigma=words.number(past.sigma, 1),
        unit=unit,
        moments=words.number(past.moments, 0),
    )


def _confidence(words: Words, zone: str, forecast: ForecastStatus | None) -> dict[str, str]:
    """The word for how far a forecast can be relied on, with its zone, and the measure that it is made of."""
    coverage = measured_coverage(forecast)
    worst = {"green": "high", "yellow": "fair", "red": "low"}.get(zone, "unmeasured")
    if zone == "green" and coverage is None:
        worst = "unmeasured"
    elif coverage is not None and worst != "unmeasured" and coverage < NARROW_BAND:
        worst = "low" if coverage < USELESS_BAND or worst == "low" else "fair"
    percent = "–" if coverage is None else words.number(100.0 * coverage, 0)
    measured = words.say("confidence.unmeasured" if coverage is None else "word.coverage_of", percent=percent)
    css = {"high": "green", "fair": "yellow", "low": "red"}.get(worst, "none")
    return {"zone": css, "word": words.say(f"confidence.{worst}"), "coverage": measured}


def _to_limit(words: Words, forecast: ForecastStatus) -> dict[str, str]:
    """The minutes to the limit in words, and their band; what lies beyond the horizon altogether has none."""
    low, median, high = minutes_to_limit(forecast)
    beyond = words.say("sentence.beyond", minutes=words.minutes(forecast.horizons[-1]))
    low_said, median_said, high_said = (beyond if m is None else _minutes(words, m) for m in (low, median, high))
    band = "" if low is None and high is None else f"{low_said} – {high_said}"
    return {"median": median_said, "band": band}


def _when(words: Words, forecast: ForecastStatus) -> list[str]:
    """When the limit is reached if it goes on so, as a figure, and the band or the chance beside it."""
    low, median, _ = minutes_to_limit(forecast)
    said = _to_limit(words, forecast)
    chance = forecast.p_limit[-1]
    horizon = words.minutes(forecast.horizons[-1])
    if median is not None:
        return [f"{said['median']}\u00a0min", f"{said['band']}\u00a0min"]
    if low is not None and chance is not None:
        percent = words.number(100.0 * chance, 0)
        return [f"> {horizon}\u00a0min", words.say("when.chance", percent=percent, minutes=horizon)]
    return [f"> {horizon}\u00a0min", words.say("when.stays")]


def minutes_to_limit(forecast: ForecastStatus) -> tuple[float | None, float | None, float | None]:
    """The low, median and high minutes to the limit; None for those beyond the last horizon."""
    most = forecast.horizons[-1] / 60.0
    low, median, high = (
        minutes if minutes is not None and isfinite(minutes) and minutes <= most else None
        for minutes in (forecast.block.get(f"minutes_{which}") for which in ("low", "median", "high"))
    )
    return low, median, high


def _foreseen(words: Words, forecast: ForecastStatus, *, what: str, shown: str, limit: str) -> str:
    """What comes if it goes on so, within the horizons of the forecast."""
    low, median, high = minutes_to_limit(forecast)
    horizon = words.minutes(forecast.horizons[-1])
    if median is not None:
        latest = words.say("sentence.beyond", minutes=horizon) if high is None else _minutes(words, high)
        earliest = _minutes(words, low or 0.0)
        return words.say(
            "sentence.reaches",
            what=what,
            value=shown,
            limit=limit,
            median=_minutes(words, median),
            low=earliest,
            high=latest,
        )
    chance = forecast.p_limit[-1]
    if low is not None:
        percent = "–" if chance is None else words.number(100.0 * chance, 0)
        parts = {"low": _minutes(words, low), "percent": percent, "horizon": horizon}
        return words.say("sentence.may_reach", what=what, value=shown, limit=limit, **parts)
    return words.say("sentence.stays", what=what, value=shown, limit=limit, horizon=horizon)


def _minutes(words: Words, minutes: float) -> str:
    return "< 1" if minutes < 1.0 else words.number(minutes, 0)


def duration(words: Words, seconds: float) -> str:
    """Seconds as a person says them, as the page does: in minutes, hours or days once they are many.

    What is to come, by a clock that was set back, has no age.
    """
    if seconds < 0.0:
        return "–"
    if seconds < 120.0:
        return f"{words.number(seconds, 1 if seconds < 10.0 else 0)} s"
    if seconds < 7200.0:
        return f"{words.number(seconds / 60.0, 0)} min"
    hours = seconds / 3600.0
    return f"{words.number(hours, 1)} h" if hours < 48.0 else f"{words.number(hours / 24.0, 1)} d"
