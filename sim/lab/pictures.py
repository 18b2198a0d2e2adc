"""Pictures, to files and never shown: how they are made and saved, and measured against predicted on one time axis."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import cycle
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from drivers.named_files import name_write_errors
from sim.sha import DEFAULT_UNIT, UNKNOWN, Array, Event, display_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Pixels = npt.NDArray[np.uint8]
DPI = 110
PICTURE_SUFFIXES = (".png", ".pdf", ".svg")


def check_picture(path: Path) -> None:
    """Raises ValueError for another ending than those of pictures."""
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise ValueError(f"{path}: cannot be a picture; give a name that ends in {', '.join(PICTURE_SUFFIXES)}")


def blank_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, which no window shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def lay_out(figure: Figure) -> None:
    """Lay a figure out once, and not again for every time that it is drawn, which would take half of a picture's
    time."""
    engine = figure.get_layout_engine()
    if figure.axes and engine is not None:
        engine.execute(figure)
    figure.set_layout_engine(None)


def draw_pixels(figure: Figure) -> Pixels:
    """(height, width, 4) a figure as red, green, blue and opacity, at its own resolution."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a letter that the font lacks is shown as a box
        lay_out(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())  # type: ignore[no-untyped-call]


def write_picture(figure: Figure, path: Path) -> Path:
    """Write a figure to a file of its own ending, in a folder that is made if need be. Raises ValueError, OSError."""
    check_picture(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_picture(figure, path, path.suffix[1:].lower())
    return path


def svg_text(figure: Figure) -> str:
    """A figure as it stands inside a page: SVG without the XML prologue, which has no place in HTML."""
    text = StringIO()
    save_picture(figure, text, "svg")
    return "".join(text.getvalue().partition("<svg")[1:])


def save_picture(figure: Figure, target: Path | StringIO, form: str) -> None:
    """Write a figure in the form `png`, `pdf` or `svg`. Raises OSError."""
    with name_write_errors(target if isinstance(target, Path) else "the picture"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a letter that the font lacks is shown as a box
        figure.savefig(target, format=form, dpi=DPI, metadata={"Date": None} if form == "svg" else None)


MEASURED, PREDICTED, OPEN_LOOP, AHEAD, ALARM = "#555555", "#1f6fb4", "#c65d1e", "#2a8c6a", "#b3261e"
EVENT_COLOURS = ("#1f6fb4", "#c65d1e", "#2a8c6a", "#8a5fb0", "#b08a2e", "#5f7f8f", "#b35a7a", "#6b6b6b")
TIME_UNITS = (("minutes", 60.0), ("hours", 3600.0), ("days", 86_400.0))
MAX_TITLE_CHARS = 100


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
    """What one picture shows; times in absolute seconds, temperatures in `unit`.

    `outages` are (start, end) stretches without usable data, `limit` a temperature to mark, `note` a line at the
    bottom (say there if the data are synthetic). Curves may be empty and may have NaN where there is nothing.
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
    unit: str = DEFAULT_UNIT


Clock = Callable[[Array], Array]
"""Absolute seconds to places on a picture's time axis."""


def draw(picture: Picture, path: Path, *also: Path) -> Path:
    """Write the picture to `path` (and, laid out once, to `also`) and return the path.

    Raises ValueError for another ending than a picture's, and OSError.
    """
    for file in (path, *also):
        check_picture(file)
    # Minutes up to three hours, hours up to three days, then days.
    times = picture.measured.times
    origin, span = (float(times[0]), float(times[-1] - times[0])) if times.size else (0.0, 0.0)
    unit, seconds = TIME_UNITS[(span > 3 * 3600) + (span > 3 * 86_400)]

    def clock(absolute: Array) -> Array:
        return (np.asarray(absolute, dtype=float) - origin) / seconds

    rows = 2 + bool(picture.inputs)
    heights = [4.2] + [1.6] * bool(picture.inputs) + [0.9]
    figure = blank_figure(11, 1.6 + sum(heights))
    axes = figure.subplots(rows, 1, sharex=True, gridspec_kw={"height_ratios": heights}, squeeze=False)[:, 0]
    _temperatures(axes[0], picture, clock)
    if picture.inputs:
        for curve, colour in zip(picture.inputs, cycle(EVENT_COLOURS), strict=False):
            instants, values = _break_gaps(curve.times, curve.values)
            name = f"{curve.label} ({picture.units[curve.label]})" if picture.units.get(curve.label) else curve.label
            axes[1].plot(clock(instants), values, color=colour, linewidth=0.9, label=_literal(name))
        axes[1].grid(alpha=0.25)
        _legend(axes[1])
    _events(axes[-1], picture.events, clock)
    axes[-1].set_xlabel(f"{unit} since the first row")
    figure.suptitle(_shorten_title(picture.title), fontsize=13, x=0.01, ha="left", parse_math=False)
    if picture.note:
        note = _shorten_title(picture.note)
        figure.supxlabel(note, fontsize=9, color=MEASURED, x=0.01, ha="left", parse_math=False)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a letter that the font lacks is shown as a box
        lay_out(figure)
        for file in (path, *also):
            _save(figure, file)
    return path


def _save(figure: Figure, file: Path) -> None:
    """The file is there as a whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.part")
    try:
        with name_write_errors(file):
            figure.savefig(part, dpi=DPI, format=file.suffix[1:].lower())
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _shorten_title(text: str) -> str:
    return shorten(text, MAX_TITLE_CHARS, placeholder=" ...") if len(text) > MAX_TITLE_CHARS else text


def _break_gaps(times: Array, values: Array) -> tuple[Array, Array]:
    """The curve with a NaN in each hole longer than five median steps and 15 s: no line is drawn across a gap."""
    seconds, numbers = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    if seconds.size < 3:
        return seconds, numbers
    steps = np.diff(seconds)
    holes = np.flatnonzero(steps > max(5 * float(np.median(steps)), 15.0)) + 1
    return np.insert(seconds, holes, np.nan), np.insert(numbers, holes, np.nan)


def _line(axis: Axes, curve: Curve, clock: Clock, colour: str, width: float = 1.4, style: str = "-") -> None:
    times, values = _break_gaps(curve.times, curve.values)
    axis.plot(clock(times), values, style, color=colour, label=_literal(curve.label), linewidth=width)
    if curve.low is not None and curve.high is not None:
        low, high = _break_gaps(curve.times, curve.low)[1], _break_gaps(curve.times, curve.high)[1]
        axis.fill_between(clock(times), low, high, color=colour, alpha=0.18, linewidth=0)


def _temperatures(axis: Axes, picture: Picture, clock: Clock) -> None:
    measured = picture.measured
    axis.plot(clock(measured.times), measured.values, ".", color=MEASURED, markersize=3, label=_literal(measured.label))
    if picture.open_loop is not None:
        _line(axis, picture.open_loop, clock, OPEN_LOOP, width=1.2, style="--")
    if picture.ahead is not None:
        _line(axis, picture.ahead, clock, AHEAD)
    if picture.predicted is not None:
        _line(axis, picture.predicted, clock, PREDICTED)
    for start, end in picture.outages:
        left, right = clock(np.array([start, end]))
        axis.axvspan(left, right, color="#999999", alpha=0.25, linewidth=0)
    if picture.limit is not None:
        # A line where it is near the curves; a word where it would press them flat.
        low, high = axis.get_ylim()
        text = f"limit {picture.limit:g} {display_unit(picture.unit)}"
        if low <= picture.limit <= high + 0.3 * (high - low):
            axis.axhline(picture.limit, color=ALARM, linewidth=1, linestyle=":", label=text)
        else:
            above = picture.limit > high
            words = f"{text}, {'above' if above else 'below'} this range"
            height, side = (0.97, "top") if above else (0.03, "bottom")
            axis.text(0.99, height, words, transform=axis.transAxes, ha="right", va=side, color=ALARM, fontsize=8)
    quantity = "temperature" if picture.unit == DEFAULT_UNIT else "value"
    axis.set_ylabel(f"{quantity} ({display_unit(picture.unit)})")
    axis.grid(alpha=0.25)
    _legend(axis)


def _literal(text: str) -> str:
    """Neither a formula ($) nor hidden (a leading underscore) to matplotlib."""
    return (f" {text}" if text.startswith("_") else text).replace("$", r"\$")


def _legend(axis: Axes) -> None:
    """Above the curves, not over them."""
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, ncols=5, fontsize=8, frameon=False)


def _events(axis: Axes, events: Sequence[Event], clock: Clock) -> None:
    """One row of ticks a symbol; "unknown" last and in the alarm's colour."""
    symbols = sorted({event.symbol for event in events}, key=lambda symbol: (symbol == UNKNOWN, symbol))
    for row, symbol in enumerate(symbols):
        times = clock(np.array([event.time for event in events if event.symbol == symbol]))
        colour = ALARM if symbol == UNKNOWN else EVENT_COLOURS[row % len(EVENT_COLOURS)]
        axis.plot(times, [row] * times.size, "|", color=colour, markersize=8)
    axis.set_yticks(range(len(symbols)), [_literal(symbol) for symbol in symbols], fontsize=8)
    axis.set_ylim(-0.7, max(len(symbols), 1) - 0.3)
    axis.set_ylabel(f"{len(events)} events")
    axis.grid(alpha=0.15)
