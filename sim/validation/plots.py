"""Pictures: measured against predicted with band, events and inputs on one time axis; to a file, never shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sim.sha.trace import UNKNOWN, Array, Event

MEASURED, PREDICTED, OPEN_LOOP, AHEAD, ALARM = "#222222", "#1f6fb4", "#c65d1e", "#2a8c6a", "#b3261e"
EVENT_COLOURS = ("#1f6fb4", "#c65d1e", "#2a8c6a", "#8a5fb0", "#b08a2e", "#5f7f8f", "#b35a7a", "#6b6b6b")


@dataclass(frozen=True, slots=True)
class Curve:
    """A line (n,) over its own clock (n,) in seconds, with an optional band `low`..`high` (n,)."""

    label: str
    times: Array
    values: Array
    low: Array | None = None
    high: Array | None = None


@dataclass(frozen=True, slots=True)
class Picture:
    """What one picture shows; times in absolute seconds, temperatures in degC.

    `outages` are (start, end) stretches without usable data, `limit` a temperature to mark, `note` a line below the
    title (say there if the data are synthetic).
    """

    title: str
    measured: Curve
    predicted: Curve | None = None
    open_loop: Curve | None = None
    ahead: Curve | None = None
    inputs: Sequence[Curve] = ()
    events: Sequence[Event] = ()
    outages: Sequence[tuple[float, float]] = ()
    limit: float | None = None
    note: str = ""
    units: Mapping[str, str] = field(default_factory=dict)


def draw(picture: Picture, path: Path) -> Path:
    """Write the picture to `path` (PNG, PDF or SVG by its ending) and return the path. Raises OSError."""
    rows = 2 + bool(picture.inputs)
    heights = [4.2] + [1.6] * bool(picture.inputs) + [0.9]
    figure = Figure(figsize=(11, 1.2 + sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 1, sharex=True, gridspec_kw={"height_ratios": heights}, squeeze=False)[:, 0]
    origin = float(picture.measured.times[0]) if picture.measured.times.size else 0.0
    _temperatures(axes[0], picture, origin)
    if picture.inputs:
        _inputs(axes[1], picture, origin)
    _events(axes[-1], picture.events, origin)
    axes[-1].set_xlabel("minutes since the first row")
    figure.suptitle(picture.title, fontsize=13, x=0.01, ha="left")
    if picture.note:
        axes[0].set_title(picture.note, fontsize=9, color="#666666", loc="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _minutes(times: Array, origin: float) -> Array:
    return (times - origin) / 60.0


def _broken(curve: Curve, origin: float) -> tuple[Array, Array]:
    """The curve with a NaN in each hole longer than five median steps, so that no line is drawn across a gap."""
    minutes, values = _minutes(curve.times, origin), np.asarray(curve.values, dtype=float)
    if minutes.size < 3:
        return minutes, values
    steps = np.diff(minutes)
    holes = np.flatnonzero(steps > max(5 * float(np.median(steps)), 0.25)) + 1
    return np.insert(minutes, holes, np.nan), np.insert(values, holes, np.nan)


def _line(axis: Axes, curve: Curve, origin: float, colour: str, width: float = 1.4, style: str = "-") -> None:
    minutes, values = _broken(curve, origin)
    axis.plot(minutes, values, style, color=colour, label=curve.label, linewidth=width)
    if curve.low is not None and curve.high is not None:
        low = _broken(Curve("", curve.times, curve.low), origin)[1]
        high = _broken(Curve("", curve.times, curve.high), origin)[1]
        axis.fill_between(minutes, low, high, color=colour, alpha=0.18, linewidth=0)


def _temperatures(axis: Axes, picture: Picture, origin: float) -> None:
    measured = picture.measured
    if picture.open_loop is not None:
        _line(axis, picture.open_loop, origin, OPEN_LOOP, width=1.2, style="--")
    if picture.ahead is not None:
        _line(axis, picture.ahead, origin, AHEAD)
    if picture.predicted is not None:
        _line(axis, picture.predicted, origin, PREDICTED)
    axis.plot(
        _minutes(measured.times, origin), measured.values, ".", color=MEASURED, markersize=2, label=measured.label
    )
    low, high = axis.get_ylim()
    for start, end in picture.outages:
        axis.axvspan((start - origin) / 60, (end - origin) / 60, color="#999999", alpha=0.25, linewidth=0)
    if picture.limit is not None and low < picture.limit < high + (high - low):
        axis.axhline(picture.limit, color=ALARM, linewidth=1, linestyle=":", label=f"limit {picture.limit:g} °C")
    axis.set_ylabel("temperature (°C)")
    axis.grid(alpha=0.25)
    axis.legend(loc="upper left", fontsize=8, framealpha=0.9)


def _inputs(axis: Axes, picture: Picture, origin: float) -> None:
    for curve, colour in zip(picture.inputs, EVENT_COLOURS, strict=False):
        minutes, values = _broken(curve, origin)
        unit = picture.units.get(curve.label, "")
        axis.plot(
            minutes, values, color=colour, linewidth=0.9, label=f"{curve.label} ({unit})" if unit else curve.label
        )
    axis.grid(alpha=0.25)
    axis.legend(loc="upper left", fontsize=8, framealpha=0.9)


def _events(axis: Axes, events: Sequence[Event], origin: float) -> None:
    """One row of ticks a symbol; "unknown" last and in the alarm's colour."""
    symbols = sorted({event.symbol for event in events}, key=lambda symbol: (symbol == UNKNOWN, symbol))
    for row, symbol in enumerate(symbols):
        minutes = [(event.time - origin) / 60 for event in events if event.symbol == symbol]
        colour = ALARM if symbol == UNKNOWN else EVENT_COLOURS[row % len(EVENT_COLOURS)]
        axis.plot(minutes, [row] * len(minutes), "|", color=colour, markersize=8)
    axis.set_yticks(range(len(symbols)), symbols, fontsize=8)
    axis.set_ylim(-0.7, max(len(symbols), 1) - 0.3)
    axis.set_ylabel(f"{len(events)} events")
    axis.grid(alpha=0.15)
