"""The picture of the live demonstration: with and without the gateway, the forecast at the alarm, what the PLC did."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from gateway.demo.heat import align_start, headline, raised_alarms
from gateway.demo.lead_time import TRUE_WITHIN_S
from gateway.demo.prepare import DemoBearing, DemoRun
from gateway.store import history, mature_forecasts, to_trace
from sim.lab.pictures import blank_figure
from sim.sha import Array, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MEASURED, WITHOUT, FORECAST, AT_ALARM = "#222222", "#c65d1e", "#1f6fb4", "#2a8c6a"
LIMIT, OUTAGE = "#b3261e", "#999999"
LOAD = "Assorbimento"
BAND = (0.05, 0.5, 0.95)
ISSUED_S = 300.0
"""Of the forecasts that came due: how long before (s) they were issued."""


def draw_heat(
    setting: DemoRun, heat: Mapping[str, Any], historian: Path, happened: Sequence[Mapping[str, Any]], path: Path
) -> Path:
    """Draw the run from its `historian`, its figures `heat` and the PLC's events `happened` into `path`."""

    begin, without = align_start(setting.trace, happened)

    def clock(absolute: Array) -> Array:
        return (np.asarray(absolute, dtype=float) - begin) / 60.0

    further = len(setting.bearings) - 1
    figure = blank_figure(11, 7 + 2.3 * further)
    heights = [4.0, *[2.0] * further, 1.2]
    axes = figure.subplots(len(heights), 1, sharex=True, gridspec_kw={"height_ratios": heights})
    upper, lower = axes[0], axes[-1]
    readings = to_trace(historian)
    for axis, bearing in zip(axes[:-1], setting.bearings, strict=True):
        _course(axis, setting, bearing, historian=historian, without=without, clock=clock)
    for axis, bearing in zip(axes[1:-1], setting.bearings[1:], strict=True):
        for moment in raised_alarms(historian, setting, bearing):
            axis.axvline(float(clock(np.array(moment))), color=FORECAST, linewidth=1)
    if heat["alarm_s"] is not None:
        _draw_forecast(upper, historian, begin + heat["alarm_s"], clock)
    _story(upper, heat, setting.limit)
    for row in happened:
        if row["event"] == "fault began":
            ended = [each["time"] for each in happened if each["event"] == "fault ended"]
            left, right = clock(np.array([row["time"], ended[0] if ended else readings.times[-1]]))
            for axis in axes:
                axis.axvspan(float(left), float(right), color=OUTAGE, alpha=0.25, linewidth=0)
            y = upper.get_ylim()[0]
            words = "outage: the PLC\nrefuses connections"
            upper.annotate(
                words, (float(left + right) / 2, y), (0, 6), textcoords="offset points", ha="center", fontsize=9
            )
    upper.legend(loc="lower right", fontsize=9, framealpha=0.85, edgecolor="none")
    for trace, style, colour, label in (
        (without, "--", WITHOUT, "without the gateway"),
        (readings, "-", MEASURED, "measured"),
    ):
        lower.plot(clock(trace.times), trace.signals[LOAD], style, color=colour, linewidth=1, label=label)
    lower.set_ylabel("load current (A)")
    lower.set_xlabel(f"plant time (min since the start; the demo shows {setting.speed / 60:.1f} of them in a second)")
    for axis in axes:
        axis.grid(alpha=0.25)
    lower.set_xlim(0.0, float(clock(readings.times[-1])))
    figure.suptitle(fill(headline(heat), 105), fontsize=12, x=0.01, ha="left", parse_math=False)
    note = f"SYNTHETIC: a simulated decanter, seed {setting.seed}, not measured on a plant; read over {setting.link}"
    figure.supxlabel(note, fontsize=9, color=OUTAGE, x=0.01, ha="left", parse_math=False)
    figure.savefig(path, dpi=110)
    return path


def _course(
    axis: Axes,
    setting: DemoRun,
    bearing: DemoBearing,
    *,
    historian: Path,
    without: Trace,
    clock: Callable[[Array], Array],
) -> None:
    """One bearing: measured, forecast five minutes before, the same day without the gateway, its limit."""
    temperature, limit = bearing.temperature, bearing.limit
    seen = history(historian, temperature=temperature)
    alone = without.signals[temperature]
    axis.plot(clock(without.times), alone, "--", color=WITHOUT, linewidth=1.5, label="same day without the gateway")
    axis.plot(clock(seen.times), seen.measured, ".", color=MEASURED, markersize=3, label="measured")
    due = mature_forecasts(historian, temperature=temperature).get(ISSUED_S)
    if due is not None:
        at = due.times + ISSUED_S
        shown = at <= seen.times[-1]
        at = at[shown]
        low, median, high = (due.quantiles[shown, due.levels.index(level)] for level in BAND)
        # No line where no forecast was issued: in the outage there was none.
        holes = np.flatnonzero(np.diff(at) > 3 * setting.forecast_period) + 1
        at, low, median, high = (np.insert(column, holes, np.nan) for column in (at, low, median, high))
        words = f"forecast issued {ISSUED_S / 60:.0f} minutes before, 90 % band"
        axis.plot(clock(at), median, color=FORECAST, linewidth=1.3, label=words)
        axis.fill_between(clock(at), low, high, color=FORECAST, alpha=0.18, linewidth=0)
    axis.axhline(limit, color=LIMIT, linewidth=1, linestyle=":")
    axis.annotate(f"limit {limit:g} °C", (0.4, limit), (0, 4), textcoords="offset points", color=LIMIT, fontsize=9)
    # What was measured fills the picture; the far end of a wide forecast is cut off.
    coldest = float(min(np.nanmin(seen.measured), np.min(alone)))
    axis.set_ylim(coldest - 6.0, limit + 5.0)
    axis.set_ylabel(f"{temperature} (°C)")


def _draw_forecast(axis: Axes, historian: Path, moment: float, clock: Callable[[Array], Array]) -> None:
    """The whole forecast that the alarm was raised by: the newest one at that moment, at each of its horizons."""
    points = []
    for horizon, forecasts in sorted(mature_forecasts(historian).items()):
        before = np.flatnonzero(forecasts.times <= moment)
        if before.size:
            fan = forecasts.quantiles[before[-1]]
            points.append((forecasts.times[before[-1]] + horizon, *fan[[forecasts.levels.index(x) for x in BAND]]))
    if points:
        at, low, median, high = np.array(points).T
        spread = (median - low, high - median)
        words = "the forecast at the alarm: 1, 5 and 15 min on"
        axis.errorbar(
            clock(at), median, spread, fmt="o", color=AT_ALARM, markersize=5, elinewidth=1, capsize=4, label=words
        )


def _story(axis: Axes, heat: Mapping[str, Any], limit: float) -> None:
    """Alarm, lead time, the PLC's action and the trip, at their places."""
    forecast, reached = heat["alarms"][0], heat["without_reached_s"]
    for moment in forecast["raised"]:
        axis.axvline(moment / 60, color=FORECAST, linewidth=1)
        true = reached is not None and reached - moment <= TRUE_WITHIN_S
        words = "ALARM" if true else "FALSE ALARM"
        axis.annotate(
            words, (moment / 60, limit - 4), (-4, 0), textcoords="offset points", rotation=90, ha="right", fontsize=9
        )
    if forecast["lead_s"] is not None:
        begin, end = (reached - forecast["lead_s"]) / 60, reached / 60
        axis.annotate("", (end, limit + 2), (begin, limit + 2), arrowprops={"arrowstyle": "<->", "color": FORECAST})
        words = f"{forecast['lead_s'] / 60:.1f} min"
        axis.text((begin + end) / 2, limit + 2.3, words, color=FORECAST, ha="center", fontsize=10)
    if heat["acted_s"] is not None:
        words = f"PLC: feed to {100 * heat['feed']:.0f} %"
        place = (heat["acted_s"] / 60, heat["hottest"])
        axis.annotate(
            words,
            place,
            (0, -90),
            textcoords="offset points",
            ha="center",
            color=MEASURED,
            fontsize=10,
            arrowprops={"arrowstyle": "->", "color": MEASURED},
        )
    if reached is not None:
        axis.plot([reached / 60], [limit], "x", color=WITHOUT, markersize=9, markeredgewidth=2)
        axis.annotate(
            "without the gateway:\nthe PLC trips",
            (reached / 60, limit),
            (8, 4),
            textcoords="offset points",
            color=WITHOUT,
            fontsize=9,
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1},
        )
