"""What the historian costs: bytes a day at 1 and 10 Hz, bytes written for each block, queries over 90 days.

One machine as `decanter run` has it: the 21 tags of the decanter's register map, a prediction and a block with every
scan, forecasts at three horizons and the guards' report every ten seconds. The plant's course is a day of production
(`sim.plant`), a row a second; what no plant gives (predictions, forecasts, blocks) has the spread of a gateway's, with
all the digits that a computation has. A day is written through the historian itself, row by row as a gateway puts them;
the other days of the 90 are that day's chunks with their times moved, packed again. At 10 Hz each second of the plant
is ten scans. Temperatures have noise beyond the digits of the plant's, so that none repeats the one before it.

Against layout 1 of the historian (every row in a table of its own, under its time), filled with the same rows in the
same run; its bytes for a block are those of one durable transaction a scan. Bytes written are those that the system
sent to the disk for the process (/proc/self/io, write_bytes), with every checkpoint: on a file system in memory there
are none. Rows are counted as 8 bytes a number and one a character. The goals: 90 days at 1 Hz within 1 GB, ten minutes
of one tag in 10 ms, 90 days of tiers in 200 ms. A day is written once more with a deadband for the two bearing
temperatures, three times their noise, and its trace is compared with the day's. In an hour's file (--quick) the
rows that are not packed yet weigh most.

Last, fifty machines (three with --quick) of ten tags at 10 Hz put their rows into one historian side by side: the
processor's time that a second of all of them takes, and ten minutes of one tag of one of them, against a machine that
has the historian for itself.
"""

import json
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import monotonic, process_time, sleep
from typing import Any

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from benchmarks.processes import MAP
from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading import Scan
from gateway.machine.records import Keeper
from gateway.settings import load_device
from gateway.store import HistorianView, open_historian, samples, to_trace, trend
from gateway.store.columns import pack, unpack
from gateway.store.retention import ended_tiers, pack_tier
from sim.plant.scenarios import production
from sim.sha import Array, Trace
from tests.rig.layout_1 import FormerStore

DAY = 86_400.0
LEVELS = json.dumps([0.05, 0.25, 0.5, 0.75, 0.95])
SHOWN = "TCuscinettiRiduttore"
DEADBAND = 0.1
Batch = dict[str, list[tuple[Any, ...]]]


@cache
def production_day() -> Trace:
    """A day of production, a row a second."""
    return production(1, seed=3, period=1.0)


class Course:
    """A day of the plant, and what a gateway makes of it, scan by scan."""

    def __init__(self, tags: Sequence[Tag], rate: float, seconds: float) -> None:
        self.tags, self.period = tags, 1.0 / rate
        trace = production_day()
        self._times, self._signals = trace.times, {tag.name: trace.signals.get(tag.name) for tag in tags}
        self._rng = np.random.default_rng(7)
        # Less than a day begins when the machine does.
        self.start = float(trace.times[0]) + (7 * 3600.0 if seconds < DAY / 2 else 0.0)
        self.scans = int(seconds * rate)

    def batches(self, keeper: Keeper) -> Iterator[Batch]:
        """The rows of one scan after the other."""
        rng, mean, slow, words = self._rng, 20.0, 20.0, rng_words(self._rng)
        place = np.searchsorted(self._times, self.start + np.arange(self.scans) * self.period, side="right") - 1
        for number in range(self.scans):
            now = self.start + number * self.period + abs(float(rng.normal(0.0, 1e-4)))
            taken = max(float(rng.normal(4e-3, 4e-4)), 1e-3)
            values = {tag.name: self._value(tag, int(place[number]), number) for tag in self.tags}
            read = {
                name: Sample(name, value, Quality.GOOD, now, now - taken / (1 + (index % 2)))
                for index, (name, value) in enumerate(values.items())
            }
            measured = float(values[SHOWN])
            sigma = 0.05 + 0.001 * float(rng.random())
            mean, slow = mean + 0.3 * (measured - mean), slow + 0.01 * (measured - slow)
            latency = 4.0 + float(rng.gamma(2.0, 0.5))
            known = (measured, mean, mean - 1.645 * sigma, mean + 1.645 * sigma, slow, float(rng.gamma(1.0, 0.5)))
            batch: Batch = {
                "scans": [(now, taken, 0)],
                "samples": keeper.rows(Scan(number, now, read, 0, taken)),
                "predictions": [(now, "running 2", 1, *known, "green")],
                "writes": [(now, number & 0xFFFF, "armed", "written", 31, latency, "", next(words))],
            }
            if number % int(10 / self.period) == 0:
                fan = measured + np.sort(rng.normal(0.0, 1.0, (3, 5)))
                quantiles = [json.dumps([round(value, 4) for value in row]) for row in fan.tolist()]
                chances = [float(chance) / 500 for chance in rng.integers(0, 500, 3)]
                batch["forecasts"] = [
                    (now, horizon, LEVELS, quantile, chance, 80.0, measured)
                    for horizon, quantile, chance in zip((60.0, 300.0, 900.0), quantiles, chances, strict=True)
                ]
                shares = {f"{horizon} s": [round(float(x), 6) for x in rng.random(3)] for horizon in (0, 60, 300, 900)}
                batch["guards"] = [(now, json.dumps({"reviews": shares, "drift": {"running": 0}, "clamps": 0}))]
            if number % int(1800 / self.period) == 0:
                batch["events"] = [(now, "W_ON", "running 2")]
                batch["alarms"] = [(now, f"over limit {SHOWN}", SHOWN, 1, "unacknowledged", measured, "")]
            yield batch

    def _value(self, tag: Tag, place: int, number: int) -> float | int | bool:
        column: Array | None = self._signals[tag.name]
        if column is None:
            return number & 0xFFFF if tag.name == "BlocksAccepted" else 1 if tag.bit is not None else 0
        value = float(column[place])
        if tag.bit is not None:
            return value > 0.5
        if tag.dtype == "float32":
            return float(np.float32(value + self._rng.normal(0.0, 0.03)))
        return round((value - tag.offset) / tag.scale) * tag.scale + tag.offset


def rng_words(rng: np.random.Generator) -> Iterator[bytes]:
    """Blocks of 24 words: counters, temperatures that wander, a CRC that looks like noise."""
    course = np.full(12, 6000.0)
    number = 0
    while True:
        number += 1
        course += rng.normal(0.0, 3.0, 12)
        words = [1, number, number, 31, 0, 1, 2, *np.abs(course).astype(int).tolist(), 7, 0, 0xBEEF]
        yield np.array([*words, rng.integers(0, 0xFFFF), number], dtype=np.int64).astype(">u2").tobytes()


def payload(batch: Batch) -> int:
    """Bytes of the rows: 8 a number, one a character or byte."""
    rows = [cell for rows in batch.values() for row in rows for cell in row]
    return sum(len(cell) if isinstance(cell, str | bytes) else 8 for cell in rows if cell is not None)


def size(path: Path) -> int:
    """Bytes of the database with its WAL."""
    return sum(place.stat().st_size for place in path.parent.glob(path.name + "*") if place.suffix != ".lock")


def written() -> int:
    """Bytes that the system has sent to disks for this process."""
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("write_bytes"))


def one_day(path: Path, tags: Sequence[Tag], course: Course, former: Path | None) -> tuple[float, float]:
    """Write a course; gives bytes a day of the historian and of layout 1 (0 without `former`)."""
    opened = open_historian(path, max_mb=100_000.0)
    historian = opened.view("decanter", tags)
    left_out = frozenset({"PlcHeartbeat"})
    keeper = Keeper({tag.name: tag for tag in tags}, 5.0, left_out)
    store = FormerStore(former, [tag.name for tag in tags]) if former else None
    historian.put("runs", [(course.start, SHOWN, "hash", course.period, 5.0)])
    gathered: Batch = {}
    for number, batch in enumerate(course.batches(keeper), start=1):
        put(historian, batch)
        for table, rows in batch.items() if store else ():
            gathered.setdefault(table, []).extend(store.numbered(table, rows) if store else ())
        if number % 2000 == 0 or number == course.scans:
            if store is not None:
                store.commit(gathered)
                gathered = {}
            if not historian.flush(60.0):
                raise click.ClickException(historian.complaint)
    if not opened.close():
        raise click.ClickException(historian.complaint)
    share = DAY / (course.scans * course.period)
    if store is not None:
        store.close()
    return size(path) * share, size(former) * share if former else 0.0


def put(historian: HistorianView, batch: Batch) -> None:
    for table, rows in batch.items():
        historian.put(table, rows)


def multiplied(path: Path, days: int) -> None:
    """Make `days` days of a file with one: its chunks and tiers with their times moved, the tiers packed."""
    historian = open_historian(path, max_mb=100_000.0)
    connection = historian._normal  # noqa: SLF001 - the benchmark fills what would take 90 days to fill
    chunks = connection.execute(
        "SELECT kind, tag, batch, first, last, rows, data FROM chunks ORDER BY rowid"
    ).fetchall()
    connection.execute("BEGIN")
    for day in range(1, days):
        connection.execute(
            f"INSERT INTO tiers SELECT tag, width, start - {day * DAY}, count, low, mean, high FROM tiers "  # noqa: S608
            "WHERE start >= (SELECT max(start) FROM tiers) - 86400"
            if day == 1
            else f"INSERT INTO tiers SELECT tag, width, start - {DAY}, count, low, mean, high FROM tiers "  # noqa: S608
            "WHERE start < (SELECT min(start) FROM tiers) + 86400"
        )
    connection.execute("COMMIT")
    # First, so that the room of their rows is used again, as it is when they come day by day.
    for ended in ended_tiers(connection, max(row[4] for row in chunks), 0):
        pack_tier(connection, *ended)
    # Before the day that is there already, which stays the newest, by its batches as by its times.
    top = max(row[2] for row in chunks)
    connection.execute("BEGIN")
    for day in range(1, days):
        for kind, tag, batch, first, last, rows, data in chunks:
            if kind != "samples":  # the samples' times are in their stamps
                columns = unpack(data)
                for place in range(2 if kind == "stamps" else 1):
                    columns[place] = [None if time is None else time - day * DAY for time in columns[place]]  # type: ignore[operator]
                data = pack(columns)
            row = (kind, tag, batch - day * top, first - day * DAY, last - day * DAY, rows, data)
            connection.execute(
                "INSERT INTO chunks (kind, tag, batch, first, last, rows, data) VALUES (?, ?, ?, ?, ?, ?, ?)", row
            )
    connection.execute("COMMIT")
    historian.close()


def amplification(folder: Path, tags: Sequence[Tag], seconds: float) -> tuple[float, float, float]:
    """Bytes written to disk for a block at 10 Hz in real time, by the historian and by layout 1; bytes of its rows."""
    course = Course(tags, 10.0, seconds)
    path = folder / "ten.sqlite"
    opened = open_historian(path)
    historian = opened.view("decanter", tags)
    keeper = Keeper({tag.name: tag for tag in tags}, 5.0, frozenset({"PlcHeartbeat"}))
    batches = list(course.batches(keeper))
    historian.flush()
    before, begin = written(), monotonic()
    for number, batch in enumerate(batches):
        sleep(max(0.0, begin + number * course.period - monotonic()))
        put(historian, batch)
    opened.close()  # with its last checkpoint
    ours = written() - before
    store = FormerStore(folder / "former.sqlite", [tag.name for tag in tags])
    before = written()
    for batch in batches:
        store.commit({table: store.numbered(table, rows) for table, rows in batch.items()})
    store.close()
    theirs = written() - before
    return ours / len(batches), theirs / len(batches), sum(map(payload, batches)) / len(batches)


def side_by_side(folder: Path, machines: int, seconds: int) -> tuple[float, float, float]:
    """`machines` of ten tags at 10 Hz in one historian, as fast as it takes them.

    Gives the processor's time (ms) for a second of all of them, and the times (ms) of reading the newest ten minutes of
    one tag, and ten minutes from the middle.
    """
    path, rng = folder / f"machines{machines}.sqlite", np.random.default_rng(5)
    historian, names = open_historian(path, max_mb=100_000.0), [f"Tag{number}" for number in range(10)]
    views = [historian.view(f"machine {number}") for number in range(machines)]
    course = np.round(60.0 + np.cumsum(rng.normal(0.0, 0.05, (seconds * 10, 10)), axis=0), 2).tolist()
    begin = process_time()
    for scan in range(seconds * 10):
        now = scan / 10.0
        rows = [(name, now, value, 0, now) for name, value in zip(names, course[scan], strict=True)]
        for view in views:
            view.put("scans", [(now, 0.004, 0)])
            view.put("samples", rows)
            view.put("predictions", [(now, "on", 1, 60.0, 60.0, 59.0, 61.0, 60.0, 0.5, "green")])
            view.put("writes", [(now, scan & 0xFFFF, "armed", "written", 31, 4.0, "", bytes(48))])
        if scan % 10 == 9 and not historian.flush(60.0):
            raise click.ClickException(historian.complaint)
    taken = 1e3 * (process_time() - begin) / seconds
    if not historian.close():
        raise click.ClickException(historian.complaint)
    last = f"machine {machines // 2}"

    def read_from(start: float) -> float:
        return 1e3 * best(lambda: list(samples(path, names[3], start, start + 600.0, machine=last)), 5)

    return taken, read_from(max(seconds - 600.0, 0.0)), read_from(max(seconds / 2 - 300.0, 0.0))


def measure(days: int, hours: float, seconds: float, *, machines: int, together: int) -> list[Figure]:
    """All figures: a course of `hours` at 1 Hz (multiplied to `days`), an eighth of it at 10 Hz, then `machines` at
    10 Hz for `together` seconds."""
    tags = load_device(MAP).tags
    figures = []
    with tempfile.TemporaryDirectory(prefix="decanter-historian-") as name:
        folder = Path(name)
        slow, fast = folder / "slow.sqlite", folder / "fast.sqlite"
        course = Course(tags, 1.0, hours * 3600.0)
        now, former = one_day(slow, tags, course, folder / "slow1.sqlite")
        figures.append(Figure("bytes a day at 1 Hz", now / 1e6, "MB", "layout 1", former / 1e6))
        figures.append(Figure("bytes of 90 days at 1 Hz", 90 * now / 1e6, "MB", "goal", 1000.0))
        with closing(sqlite3.connect(slow)) as connection:
            packed = dict(connection.execute("SELECT kind, sum(length(data)) FROM chunks GROUP BY kind").fetchall())
        values, every = packed["samples"] / 1e6, sum(packed.values()) / 1e6
        figures.append(Figure("readings packed, without their moments", values, "MB", "all that is packed", every))
        thin = folder / "thin.sqlite"
        wide = [replace(tag, deadband=DEADBAND) if tag.dtype == "float32" else tag for tag in tags]
        less, _ = one_day(thin, wide, Course(wide, 1.0, hours * 3600.0), None)
        figures.append(Figure(f"bytes a day with a deadband of {DEADBAND:g} degC", less / 1e6, "MB", "none", now / 1e6))
        all_of_it, kept = (to_trace(path).signals for path in (slow, thin))
        error = max(float(np.abs(kept[tag.name] - all_of_it[tag.name]).max()) for tag in wide if tag.deadband)
        figures.append(Figure("largest error of a reading by it", error, "degC", "deadband", DEADBAND))
        quick, former = one_day(fast, tags, Course(tags, 10.0, hours * 450.0), folder / "fast1.sqlite")
        figures.append(Figure("bytes a day at 10 Hz", quick / 1e6, "MB", "layout 1", former / 1e6))
        multiplied(slow, days)
        figures.append(Figure(f"the file of {days} days at 1 Hz", size(slow) / 1e6, "MB", "goal", 1000.0 * days / 90))
        middle = course.start - days // 2 * DAY + hours * 900.0
        ten = list(samples(slow, SHOWN, middle, middle + 600.0))
        if not 500 < len(ten) < 700:
            raise click.ClickException(f"ten minutes have {len(ten)} samples")
        took = 1e3 * best(lambda: list(samples(slow, SHOWN, middle, middle + 600.0)), 5)
        figures.append(Figure("ten minutes of one tag", took, "ms", "goal", 10.0))
        end = course.start + hours * 3600.0
        recent = 1e3 * best(lambda: list(samples(slow, SHOWN, end - 600.0, end)), 5)
        figures.append(Figure("the newest ten minutes of one tag", recent, "ms", "goal", 10.0))
        since = end - days * DAY
        for width in (None, 60):
            took = 1e3 * best(lambda width=width: trend(slow, SHOWN, since, end, width=width), 3)  # type: ignore[misc]
            figures.append(
                Figure(
                    f"{days} days of one tag, {f'a row every {width} s' if width else 'as a trend'}",
                    took,
                    "ms",
                    "goal",
                    200.0,
                )
            )
        ours, theirs, rows = amplification(folder, tags, seconds)
        figures.append(Figure("written to disk for a block at 10 Hz", ours / 1e3, "kB", "layout 1", theirs / 1e3))
        figures.append(Figure("written to disk for a byte of rows", ours / rows, "", "layout 1", theirs / rows))
        whats = ("processor's time for a second", "the newest ten minutes of a tag", "ten minutes of a tag")
        one, many = (side_by_side(folder, number, together) for number in (1, machines))
        for what, alone, beside in zip(whats, one, many, strict=True):
            figures.append(Figure(f"{what}, {machines} machines", beside, "ms", "one machine", alone))
    return figures


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="An hour and 3 days instead of 24 and 90.")
@click.option("--seconds", type=click.FloatRange(1.0), help="Real time at 10 Hz, 20 s by default.")
def main(as_json: bool, quick: bool, seconds: float | None) -> None:
    days, hours = (3, 1.0) if quick else (90, 24.0)
    machines, together = (3, 20) if quick else (50, 600)
    figures = measure(days, hours, seconds or (2.0 if quick else 20.0), machines=machines, together=together)
    give("historian", figures, as_json=as_json)


if __name__ == "__main__":
    main()
