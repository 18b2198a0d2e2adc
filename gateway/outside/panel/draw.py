"""The picture of a gateway as rows for people; 80 columns suffice."""

from collections.abc import Mapping
from textwrap import shorten

from rich.box import SIMPLE
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gateway.outside.status import (
    FamiliarityStatus,
    ForecastStatus,
    GatewayStatus,
    Health,
    Sighting,
    TemperatureStatus,
    arming_text,
    clock_text,
    date_text,
    findings,
    judge_health,
    link_sentence,
    model_text,
    records_sentence,
    virtual_sentence,
)
from sim.units import display_unit

ZONE_COLOURS = {"green": "green", "yellow": "yellow", "red": "red"}
HEALTH_COLOURS = {Health.WELL: "bold green", Health.ATTENTION: "bold yellow", Health.NO_READINGS: "bold red"}
LONGEST_SENTENCE = 150
"""Characters of one reason; the log has all of it."""
EVENTS_SHOWN = 6
NOTHING = "–"


def number(value: object, digits: int = 2, unit: str = "") -> str:
    """A number with its unit, or a dash."""
    return f"{value:.{digits}f}{unit}" if isinstance(value, int | float) else NOTHING


def duration(seconds: float) -> str:
    """Seconds as a person says them: with a tenth while they are few, else in minutes or hours."""
    if seconds < 10.0:
        return f"{seconds:.1f} s"
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def status_rows(status: GatewayStatus) -> dict[str, Text]:
    """The rows of the panel by their labels; the same ones each time, so that the panel keeps its height."""
    p, unit = status.prediction, f" {display_unit(status.unit)}"
    rows = {"link": _link(status), "measured": _measurement(status, unit)}
    if p is None or status.scan.late:
        rows["predicted"] = Text(f"{NOTHING} (no model)" if status.model is None else NOTHING)
        rows["state"] = Text(NOTHING)
    else:
        band = f"90 % band {number(p.low)} to {number(p.high)}"
        rows["predicted"] = Text(f"{number(p.mean, 2, unit)}, {band}; free run {number(p.free_run)}")
        if alone := virtual_sentence(status, status):
            rows["predicted"] = Text(shorten(alone, LONGEST_SENTENCE), style="yellow")
        location = p.location if p.known else "not known"
        borrowed = ", never seen in the data" if p.borrowed else ""
        rows["state"] = Text(f"{location}{borrowed}, confidence {p.zone}", style=ZONE_COLOURS.get(p.zone, ""))
    rows["familiarity"] = _familiarity(None if p is None or status.scan.late else p.familiarity)
    rows |= _forecast_rows(status.forecast, unit)
    rows |= {one.temperature: _further(one, status) for one in status.further}
    recent = ", ".join(symbol for _, symbol, _ in status.recent_events[-EVENTS_SHOWN:])
    raised = [f"{a.name} ({a.state}, {duration((status.time - a.since) / status.speed)})" for a in status.alarm_summary]
    urgent = any(alarm.active for alarm in status.alarm_summary)
    rows["events"] = Text(f"{status.events}: ... {recent}" if recent else f"{status.events}")
    rows["alarms"] = Text(", ".join(raised) or "none", style="bold red" if urgent else "")
    return rows


def _familiarity(f: FamiliarityStatus | None) -> Text:
    """How like its training the present cycle is, and what is strange of it."""
    if f is None or f.strangeness is None:
        return Text("unknown")
    found = f"{f.sentence}; " if f.outside else ""
    counted = f"strangeness {number(f.strangeness, 2)}, limit {f.limit:g}"
    return Text(f"{f.zone}: {shorten(found, LONGEST_SENTENCE)} {counted}", style=ZONE_COLOURS.get(f.zone, ""))


def _link(status: GatewayStatus) -> Text:
    outages = f"{status.link.outage_count} outage{'' if status.link.outage_count == 1 else 's'}"
    counts = f"{status.scan.count} scans, {status.scan.missed} missed, {outages}"
    if reason := link_sentence(status):
        return Text(f"{shorten(reason, LONGEST_SENTENCE)}; {counts}", style="bold red")
    active = next((str(link["name"]) for link in status.links if link["active"]), "")
    over = f" over {active}" if len(status.links) > 1 else ""
    age = 0.0 if status.scan.age is None else status.scan.age / status.speed
    return Text(f"last good reading {duration(age)} ago{over}; {counts}", style="green")


def _measurement(status: GatewayStatus, unit: str) -> Text:
    tag = status.values.get(status.temperature)
    if tag is None:
        return Text(NOTHING)
    age = duration(tag.age / status.speed)
    return Text(
        f"{number(tag.value, 2, unit)}  {tag.quality}, {age} old; limit {status.limit:g}{unit}",
        style="" if tag.quality == "GOOD" else "red",
    )


def _further(one: TemperatureStatus, status: GatewayStatus) -> Text:
    """One more temperature in one row: measured, predicted, and when it reaches its limit."""
    tag, p, forecast = status.values.get(one.temperature), one.prediction, one.forecast
    measured = NOTHING if tag is None else f"{number(tag.value, 2)} {tag.quality}"
    predicted = NOTHING if p is None or status.scan.late else f"{number(p.mean, 2)}, confidence {p.zone}"
    predicted = virtual_sentence(status, one) or predicted
    to_limit = _forecast_rows(forecast, "").get("to limit") if forecast else None
    return Text(
        f"{measured}; limit {one.limit:g}; predicted {predicted}; to limit {to_limit or NOTHING}",
        style="" if tag is not None and tag.quality == "GOOD" else "red",
    )


def _forecast_rows(forecast: ForecastStatus | None, unit: str) -> dict[str, Text]:
    """One row a horizon, and the minutes to the limit; of a forecast that is not usable any more only its age."""
    if forecast is None:
        return {"forecast": Text(NOTHING)}
    rows: dict[str, Text] = {}
    past = forecast.past or [None] * len(forecast.horizons)
    for horizon, fan, p_limit, own in zip(forecast.horizons, forecast.quantiles, forecast.p_limit, past, strict=True):
        span = f"{number(fan[2], 1, unit)} ({number(fan[0], 1)} to {number(fan[4], 1)}), P(limit) {number(p_limit, 3)}"
        flagged = own is not None and own.flagged
        if own is not None and flagged:
            usual = f"{number(own.mean, 1)} with sd {number(own.sigma, 1)} after {own.moments} like moments"
            span += f"; {number(abs(own.deviations), 1)} sd from {usual}"
        rows[f"in {horizon / 60:g} min"] = Text(
            span if forecast.usable else NOTHING, style="yellow" if flagged and forecast.usable else ""
        )
    if not forecast.usable:
        rows["to limit"] = Text(f"{NOTHING} (the newest forecast is {duration(forecast.age)} old)")
        return rows
    beyond = f"beyond {forecast.horizons[-1] / 60:g}"
    low, median, high = (
        beyond if minutes is None or minutes * 60 > forecast.horizons[-1] else f"{minutes:.1f}"
        for minutes in (forecast.block.get(f"minutes_{which}") for which in ("low", "median", "high"))
    )
    rows["to limit"] = Text(f"{median} min" if low == high else f"{median} min ({low} to {high})")
    return rows


def frame_rows(title: Text, rows: Mapping[str, Text]) -> RenderableType:
    """A title over labelled rows."""
    grid = Table(box=SIMPLE, show_header=False, pad_edge=False)
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, text in rows.items():
        grid.add_row(name, text)
    return Group(title, grid)


def panel(sighting: Sighting) -> RenderableType:
    """The whole panel. A status that is not a present one is never drawn: only that, since when, and what it was."""
    status = sighting.status
    if sighting.silence or not (status or sighting.machines):
        return _silent(sighting)
    if status is None:
        return plant_panel(sighting)
    health, found = judge_health(status), findings(status)
    title = Text(f"decanter top: {status.temperature} of {status.place}", style="bold", overflow="fold")
    rows = {
        "time": Text(f"{date_text(status.time)[:10]} {clock_text(status.time)}, asked {duration(sighting.age)} ago"),
        "health": Text(health.value, style=HEALTH_COLOURS[health]),
        "model": Text(model_text(status)),
        **status_rows(status),
        "records": _records(status),
        "write-back": _writeback(status),
    }
    for finding in found:
        # The link has a row of its own.
        if finding.check != "link":
            rows["health"].append(f"\n{finding.check}: {shorten(finding.sentence, LONGEST_SENTENCE)}", style="yellow")
    return frame_rows(title, rows)


def plant_panel(sighting: Sighting) -> RenderableType:
    """One row for each of several machines: how it is, its temperatures, and what is most urgent."""
    table = Table(box=SIMPLE, pad_edge=False)
    for column in ("machine", "health", "temperatures", "to limit", "most urgent"):
        table.add_column(column, overflow="fold")
    for name, status in sighting.machines.items():
        health, found = judge_health(status), findings(status)
        tags = (status.temperature, *(one.temperature for one in status.further))
        read = [value for tag in tags if (value := status.values.get(tag)) is not None]
        shown = ", ".join(number(value.value, 1) if value.quality == "GOOD" else NOTHING for value in read) or NOTHING
        soonest = _forecast_rows(status.forecast, "").get("to limit", Text(NOTHING))
        urgent = f"{found[0].check}: {found[0].sentence}" if found else ""
        table.add_row(
            name,
            Text(health.value, style=HEALTH_COLOURS[health]),
            f"{shown} {display_unit(status.unit)}",
            soonest,
            Text(shorten(urgent, LONGEST_SENTENCE)),
        )
    title = Text(f"decanter top: {len(sighting.machines)} machines, asked {duration(sighting.age)} ago", style="bold")
    return Group(title, table)


def _records(status: GatewayStatus) -> Text:
    lost = status.historian.dropped + status.historian.refused
    rows = f", {lost} rows lost" if lost else ""
    if reason := records_sentence(status):
        return Text(f"NOT kept{rows}: {shorten(reason, LONGEST_SENTENCE)}", style="bold red")
    return Text(f"kept in {status.historian.path}{rows}")


def _writeback(status: GatewayStatus) -> Text:
    w, mode = status.writeback, arming_text(status)
    if w["mode"] != "armed":
        return Text(mode)
    left = "" if w["armed_until"] is None else f" ({duration((w['armed_until'] - status.time) / status.speed)} left)"
    counts = f"; {w['written']} written, {w['accepted']} accepted, {w['refused']} refused"
    return Text(f"{mode}{left}{counts}", style="bold")


def _silent(sighting: Sighting) -> RenderableType:
    # Spaced out, as large as a terminal's letters become.
    headline = Text(" ".join(f" NO ANSWER FOR {duration(sighting.age).upper()} "), style="bold reverse red")
    lines = [Text(shorten(sighting.silence, 300))]
    if (status := sighting.status) is not None:
        tag = status.values.get(status.temperature)
        value = "" if tag is None else f": {number(tag.value, 2, f' {display_unit(status.unit)}')}, {tag.quality}"
        lines.append(Text(f"The last status is of {clock_text(status.time)}{value}. Nothing is known of now."))
    lines.append(Text("This panel goes on by itself once there is an answer; Ctrl-C ends it."))
    return Group(headline, Text(""), *lines)
