"""`decanter plc watch`: tags as they change, live on a terminal, as plain lines elsewhere."""

import asyncio
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.commission.plc_read import shown_value
from gateway.console.output import Exit, table

if TYPE_CHECKING:
    from rich.table import Table

    from gateway.commission.outcome import Outcome, Site
    from gateway.commission.reading import How
    from gateway.commission.watching import Mark, Seen

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_COLUMNS = ("tag", "value", "unit", "quality", "min", "max", "good", "bad", "changes")
_WIDE = 150
"""Columns of a terminal from which raw words and reference numbers are shown too."""


@click.command()
@click.argument("what", nargs=-1)
@click.option("--period", type=click.FloatRange(0.02, 3600), default=1.0, show_default=True, help="Seconds a reading.")
@click.option("--seconds", type=click.FloatRange(0.02), help="Stop after so long; else Ctrl-C ends it.")
@link_options
def watch(given: Given, what: Sequence[str], period: float, seconds: float | None) -> None:
    """Watch tags or addresses as they change: value, raw words, quality, age, least and greatest, a sparkline.

    On a terminal the view is live, and Enter sets a mark: its time and all values are kept in the records. Elsewhere
    each change is a line.
    """
    from gateway.commission.reading import How

    arguments = {"what": list(what), "period": period, "seconds": seconds}

    async def work(site: "Site") -> "Outcome":
        return await _watched(site, what, How(), (period, seconds), quiet=given.as_json)

    perform(given, "watch", arguments, work, _show_end)


async def _watched(
    site: "Site", what: Sequence[str], how: "How", times: tuple[float, float | None], *, quiet: bool
) -> "Outcome":
    """Watch until the end; gives what each tag did, and the marks."""
    from gateway.commission.reading import tags_of
    from gateway.commission.watching import Seen, looking, marked
    from gateway.commission.watching import watch as watch_tags

    seen = [Seen(tag) for tag in tags_of(site, what, how)]
    marks: list[Mark] = []
    live = sys.stdout.isatty() and not quiet

    def mark() -> bool:
        entered = bool(sys.stdin.readline())
        if entered:
            marks.append(marked(seen, len(marks) + 1, time.time()))
        return entered

    with _ending(times[1], mark if live and sys.stdin.isatty() else None) as stop:
        async with looking(site, [one.tag for one in seen]) as look:
            if live:
                await _live(site.target.place, seen, marks, lambda show: watch_tags(look, seen, times[0], stop, show))
            else:
                await watch_tags(look, seen, times[0], stop, _nothing if quiet else _lines)
    return _outcome(seen, marks)


@contextmanager
def _ending(seconds: float | None, on_enter: Callable[[], bool] | None) -> Iterator[asyncio.Event]:
    """An event that is set by Ctrl-C, by SIGTERM, and after `seconds`; Enter calls `on_enter` while that says True."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()

    def entered() -> None:
        if on_enter is not None and not on_enter():
            loop.remove_reader(sys.stdin)

    for number in _SIGNALS:
        loop.add_signal_handler(number, stop.set)
    if seconds is not None:
        loop.call_later(seconds, stop.set)
    if on_enter is not None:
        loop.add_reader(sys.stdin, entered)
    try:
        yield stop
    finally:
        for number in _SIGNALS:
            loop.remove_signal_handler(number)
        if on_enter is not None:
            loop.remove_reader(sys.stdin)


def _outcome(seen: Sequence["Seen"], marks: Sequence["Mark"]) -> "Outcome":
    from gateway.commission.outcome import Outcome

    rows = [one.plain() for one in seen]
    data = {"tags": rows, "marks": [{"number": m.number, "time": m.time, "values": dict(m.values)} for m in marks]}
    never = next((row for row in rows if not row["good"] and row["quality"] != "GOOD"), None)
    if never is None:
        return Outcome(data)
    return Outcome(data, Exit.CHECK_FAILED, f"{never['tag']} was never good: {never['reason']}")


def _nothing(_: Sequence["Seen"]) -> None:
    """With --json the end alone is printed."""


async def _live(place: str, seen: Sequence["Seen"], marks: Sequence["Mark"], run: Callable[[Any], Any]) -> None:
    """The view that is drawn anew with each reading."""
    from rich.live import Live

    with Live(auto_refresh=False) as live:

        def show(_: Sequence["Seen"]) -> None:
            live.update(_view(place, seen, marks, live.console.width), refresh=True)

        await run(show)


def _view(place: str, seen: Sequence["Seen"], marks: Sequence["Mark"], width: int) -> "Table":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    caption = "Enter: mark   Ctrl-C: end"
    if marks:
        caption = f"mark {marks[-1].number} at {clock_time(marks[-1].time)}   {caption}"
    grid = Table(
        title=Text(place), caption=Text(caption), title_justify="left", caption_justify="left", box=SIMPLE_HEAD
    )
    wide = width >= _WIDE
    for column in ("tag", *(("address", "raw") if wide else ()), "value", "quality", "age", "min", "max"):
        grid.add_column(column, justify="right" if column in ("value", "age", "min", "max") else "left", no_wrap=True)
    if marks:
        grid.add_column("at mark", justify="right", no_wrap=True)
    grid.add_column("last readings", no_wrap=True)
    for one in seen:
        good = one.last is not None and one.last.sample.quality.is_good
        cells = _cells(one, marks, wide=wide)
        spark = sparkline_of(one, width)
        grid.add_row(*(Text(cell, style="" if good else "red") for cell in (*cells, spark)))
    return grid


def sparkline_of(one: "Seen", width: int) -> str:
    """As much of the last readings as a terminal of this width has room for."""
    from gateway.commission.watching import WIDTH, sparkline

    return sparkline(one.history, max(8, min(WIDTH, width - (110 if width >= _WIDE else 70))))


def _cells(one: "Seen", marks: Sequence["Mark"], *, wide: bool) -> list[str]:
    from gateway.commission.survey.addresses import reference_of

    sample = one.last.sample if one.last else None
    cells = [one.tag.name]
    if wide:
        raw = " ".join(f"{word:04X}" for word in one.last.raw) if one.last and one.last.raw else ""
        cells += [" ".join(filter(None, (one.tag.address, reference_of(one.tag.address)))), raw]
    cells += [" ".join(filter(None, (_cell(sample.value if sample else None), one.tag.unit)))]
    cells += ["", ""] if sample is None else [sample.quality.name, _age(sample.time)]
    cells += [_cell(one.low), _cell(one.high)]
    return cells + ([_cell(marks[-1].values.get(one.tag.name))] if marks else [])


def _cell(value: Any) -> str:
    return "" if value is None else str(shown_value(value))


def _age(moment: float) -> str:
    return f"{max(0.0, time.time() - moment):.1f} s"


def clock_time(moment: float) -> str:
    """The time of day with tenths, UTC."""
    return datetime.fromtimestamp(moment, UTC).strftime("%H:%M:%S.%f")[:-5]


def _lines(changed: Sequence["Seen"]) -> None:
    """One line for each tag that changed."""
    for one in changed:
        if one.last is None:
            continue
        sample = one.last.sample
        raw = " ".join(f"{word:04X}" for word in one.last.raw) if one.last.raw else ""
        words = (clock_time(sample.time), one.tag.name, _cell(sample.value), one.tag.unit, sample.quality.name)
        click.echo("  ".join(filter(None, (*words, raw, sample.reason))))


def _show_end(data: Mapping[str, Any]) -> None:
    rows = [
        [_cell(row[key]) if key in ("value", "min", "max") else row[key] for key in _COLUMNS] for row in data["tags"]
    ]
    table("watched", _COLUMNS, rows)
    for mark in data["marks"]:
        click.echo(f"mark {mark['number']} at {clock_time(mark['time'])}")
