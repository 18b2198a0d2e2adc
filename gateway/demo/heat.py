"""What the demonstration's live bearing came to: the alarm, what the PLC did about it, and the run without it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gateway.demo.child import DemoError
from gateway.demo.lead_time import first_crossing, rivals, score
from gateway.demo.prepare import P_LIMIT, DemoBearing, DemoRun
from gateway.settings import load_device
from gateway.store import reading, stored_rows, to_trace
from sim.sha import Trace

ALARM = "predicted over limit"
FORECAST = "forecast"


def raised_alarms(historian: Path, setting: DemoRun, bearing: DemoBearing) -> tuple[float, ...]:
    """When the gateway raised its alarm of a bearing's forecast (plant s UTC)."""
    name = ALARM if bearing is setting.bearings[0] else f"{ALARM} {bearing.temperature}"
    with reading(historian) as connection:
        rows = stored_rows(connection, "alarms", ("time", "condition", "state"))
    return tuple(sorted(row[0] for row in rows if row[1:] == (name, "unacknowledged")))


def heat_result(
    setting: DemoRun, without: Trace, historian: Path, happened: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The figures of a live run; `without` is the same day with nobody who acts, `happened` are the PLC's events.

    Times are plant seconds since the run's beginning, temperatures degC. The rivals see the readings of `without`,
    which are those of this run until the PLC acts, less those that the gateway lost in the outage.
    """
    temperature = setting.model.temperature
    begin, without = align_start(without, happened)
    reached = first_crossing(without, temperature, setting.limit)
    acted, tripped = (_first(happened, event) for event in ("feed reduced", "drum tripped"))
    seen = to_trace(historian)
    hottest = float(np.nanmax(seen.signals[temperature]))
    alarms = raised_alarms(historian, setting, setting.bearings[0])
    blocks = {layout.suffix: layout.temperature for layout in load_device(setting.device).writebacks}
    reduced = next((row for row in happened if row["event"] == "feed reduced"), None)
    # After the PLC has acted the two runs are two: what the alarm then says cannot be held against the other one.
    judged = tuple(moment for moment in alarms if acted is None or moment <= acted)
    others = rivals(
        setting.model,
        _hide_outage(without, happened),
        temperature=temperature,
        limit=setting.limit,
        p_limit=P_LIMIT,
        period=setting.forecast_period,
        scan_period=setting.period,
    )
    usable = () if acted is None else (acted,)
    scores = [
        score(FORECAST, judged, reached, usable),
        *(score(name, moments, reached) for name, moments in others.items()),
    ]

    def offset(moment: float | None) -> float | None:
        return None if moment is None else moment - begin

    return {
        "limit": setting.limit,
        "alarm_s": offset(alarms[0] if alarms else None),
        "acted_s": offset(acted),
        "feed": None if reduced is None else reduced["feed"],
        "acted_on": None if reduced is None else blocks[reduced.get("block", "")],
        "hottest": hottest,
        "tripped_s": offset(tripped),
        "without_reached_s": offset(reached),
        "without_hottest": float(np.max(without.signals[temperature])),
        "alarms": [each.plain() | {"raised": [moment - begin for moment in each.raised]} for each in scores],
    }


def align_start(without: Trace, happened: Sequence[Mapping[str, Any]]) -> tuple[float, Trace]:
    """When the PLC let its plant go (plant s UTC), and the day without the gateway as if it had begun then."""
    begin = _first(happened, "start")
    if begin is None:
        raise DemoError("the software PLC never started its plant")
    return begin, replace(without, times=without.times + (begin - float(without.times[0])))


def _first(happened: Sequence[Mapping[str, Any]], event: str) -> float | None:
    return next((float(row["time"]) for row in happened if row["event"] == event), None)


def _hide_outage(trace: Trace, happened: Sequence[Mapping[str, Any]]) -> Trace:
    """The trace without its rows during the outage."""
    begun, ended = _first(happened, "fault began"), _first(happened, "fault ended")
    if begun is None:
        return trace
    keep = (trace.times < begun) | (trace.times > (np.inf if ended is None else ended))
    signals = {name: column[keep] for name, column in trace.signals.items()}
    return replace(trace, times=trace.times[keep], signals=signals)


def headline(heat: Mapping[str, Any]) -> str:
    """What the run shows, in one sentence with its figures; also where it shows something else than it is meant to."""
    forecast = heat["alarms"][0]
    limit, lead, reached = heat["limit"], forecast["lead_s"], heat["without_reached_s"]
    others = f"false alarms: {forecast['false']}"
    # Whichever bearing's block says it first: what this one would have come to is then not known.
    if heat["acted_s"] is not None and (heat["alarm_s"] is None or heat["acted_s"] < heat["alarm_s"]):
        return (
            f"The PLC fed {100 * heat['feed']:.0f} % after {heat['acted_s'] / 60:.1f} min, on the forecast of "
            f"{heat['acted_on']}: before any alarm of the bearing that was to reach {limit:g} °C; {others}"
        )
    if reached is None:
        return f"The bearing would not have reached {limit:g} °C in this run; {others}"
    trips = f"without the gateway the PLC trips at {limit:g} °C after {reached / 60:.1f} min"
    if lead is None:
        return f"NO ALARM before the limit of {limit:g} °C: {trips}; {others}"
    alarm = f"Alarm {lead / 60:.1f} min before the limit of {limit:g} °C would have been reached"
    if heat["acted_s"] is None:
        return f"{alarm}, BUT THE PLC DID NOT ACT on it; {trips}; {others}"
    if heat["tripped_s"] is not None:
        return (
            f"{alarm}, BUT TOO LATE: with {100 * heat['feed']:.0f} % of the feed the PLC tripped all the same; {others}"
        )
    late = heat["acted_s"] - heat["alarm_s"]
    return (
        f"{alarm}: {late / 60:.1f} min later the PLC feeds {100 * heat['feed']:.0f} % and the bearing turns at "
        f"{heat['hottest']:.1f} °C; {trips}; {others}"
    )


def alarm_rows(heat: Mapping[str, Any]) -> list[list[object]]:
    """(alarm, lead time, false alarms) for each kind of alarm, as the summary shows them."""
    return [
        [
            each["name"],
            "missed" if each["missed"] else "-" if each["lead_s"] is None else f"{each['lead_s'] / 60:.1f} min",
            str(each["false"]),
        ]
        for each in heat["alarms"]
    ]
