"""How often a model's own alarms come where nothing is wrong: `python -m benchmarks.nuisance [SOURCE ...]`.

Of each source a model is learned as `decanter model learn` does; a whole gateway (`Machine`, on a clock that is an
argument) then takes days or recordings of the same plant that it was not taught, with a stop after every few hours and
a new start on the same records, at true speed and sixty times as fast (a clock that wakes late by real milliseconds is
late by plant seconds). Nothing is broken in any: each announcement of `anomaly`, `unfamiliar`, `review` or `drift` is a
nuisance. Beside it the same for what is broken, where a source has it: how many of these had an alarm, and how soon.

Beside `anomaly` at the level of the model's own record stands what it would have been at 10, by the same gateway's
records of its score. Rates are per week of watching, with Poisson's exact
95 % interval: of a few hours that is wide, and alarms that come in groups make it wider than is said.
"""

import asyncio
import csv
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import click
import numpy as np
from scipy.stats import chi2

from benchmarks.discrepancy.bearings import machine
from benchmarks.discrepancy.log import FIRST
from benchmarks.familiarity import days_of
from benchmarks.figures import Figure, give
from benchmarks.year.plant import TEMPERATURE, dates_of, day_of, days_before
from gateway.commission.files import SiteRecording
from gateway.commission.replay import SteppedClock, follow_recording
from gateway.lab.learning.learn import teach_model
from gateway.machine.alarms import read_journal
from gateway.settings import ANOMALY_FLOOR, load_config
from gateway.store import machines, reading, stored_rows
from sim.anomaly import DEADBAND_SHARE
from sim.lab.recordings import ColumnMap, load_map, load_traces
from sim.plant import production
from sim.plant.decanter import DecanterPlant
from sim.sha import Trace, encode_trace

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared" / "data"
KINDS = ("anomaly", "unfamiliar", "review", "drift")
DAY_S, WEEK_S = 86_400.0, 7 * 86_400.0
BEGIN = 1_750_000_000.0
SESSION_S, OFF_S = 7 * 3600.0, (60.0, 3600.0)
"""s after which the gateway is stopped, and for how long it is off at least and at most."""
LATE_S = 0.01
"""Real s by which a clock wakes late on average."""
SPEEDS = (1.0, 60.0)
MIN_ROWS = 200
SLOW_ROW_S = 60.0
BEARING_FAULTS = ("vibration-friction", "wear-drift", "sensor-offset-step", "housing-thermal-mass")
WORN = (1.25, 1.5, 2.0, 3.0)
"""Times the heat of a bearing that nothing is wrong with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A plant: recordings to be `taught`, others on which nothing is wrong, and others on which something is.

    `faults` gives the moment (s) from which on something is wrong by the recording.
    """

    column_map: ColumnMap
    taught: Sequence[Trace]
    ordinary: Sequence[Trace]
    faults: Sequence[tuple[Trace, float]] = ()


@dataclass(slots=True)
class LateClock(SteppedClock):
    """A stepped clock that wakes late by real time, which is more of the plant's the faster it runs."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        """Be a little after that moment."""
        await SteppedClock.sleep_until(self, moment, stop)
        self.time += self.speed * float(self.rng.exponential(LATE_S))


# ------------------------------------------------------------------ the plants


def _decanter_map(temperature: str) -> ColumnMap:
    return load_map(ROOT / "config" / "traces" / "decanter.toml").model_copy(update={"temperature": temperature})


def _year(seed: int, days: int) -> Source:
    """Days of `benchmarks.year` after a model of six days before; nothing but wear and people's habits changes."""
    ordinary = [day_of(date, seed=seed).trace for date in dates_of(2, 30)[:days]]
    return Source(column_map=_decanter_map(TEMPERATURE), taught=days_before(6, seed=seed), ordinary=ordinary)


def _days(trace: Trace) -> list[Trace]:
    """A trace by its days."""
    first = float(trace.times[0])
    cuts = np.arange(first, float(trace.times[-1]) + DAY_S, DAY_S)
    return [
        replace(trace.between(begin, end), name=f"{trace.name} {day}", events=())
        for day, (begin, end) in enumerate(pairwise(cuts), start=1)
    ]


def _shifts(seed: int, days: int) -> Source:
    """Days of four runs each of the synthetic plant (`sim.plant.production`), taught by three, as the demo is.

    Faults are days on which the bearing's friction gives more heat, by each of WORN.
    """
    taught, ordinary = (_days(production(many, seed=own)) for many, own in ((3, 2 * seed + 1), (days, 100 + seed)))
    new = DecanterPlant()
    faults = []
    for place, much in enumerate(WORN):
        plant = replace(new, idle_heat=new.idle_heat * much, heat_per_ampere=new.heat_per_ampere * much)
        day = replace(production(1, seed=200 + place, plant=plant), events=())
        running = day.times[day.signals["MarciaDecanter"] > 0]
        faults.append((day, float(running[0])))
    return Source(column_map=_decanter_map(TEMPERATURE), taught=taught, ordinary=ordinary, faults=faults)


def _slow(seed: int, days: int) -> Source:
    """The shifts as a historian has them that keeps a row a minute."""
    source = _shifts(seed, days)
    taught, ordinary = ([_by_the_minute(trace) for trace in part] for part in (source.taught, source.ordinary))
    alphabet = replace(source.column_map.alphabet, gap=5 * SLOW_ROW_S)  # as `trace map` has it
    return replace(
        source,
        column_map=source.column_map.model_copy(update={"alphabet": alphabet}),
        taught=taught,
        ordinary=ordinary,
        faults=[(_by_the_minute(trace), begin) for trace, begin in source.faults],
    )


def _by_the_minute(trace: Trace) -> Trace:
    minutes = np.arange(float(trace.times[0]), float(trace.times[-1]), SLOW_ROW_S)
    rows = np.unique(np.searchsorted(trace.times, minutes))
    return replace(
        trace, times=trace.times[rows], signals={name: column[rows] for name, column in trace.signals.items()}
    )


def _bearing(number: int, days: int) -> Source:
    """A rough machine of the discrepancy benchmark; faults are some of its effects at their strongest, a day each."""
    own = machine("development", "stages", True, number)
    return Source(
        column_map=_decanter_map(FIRST),
        taught=_days(days_of(own, 6, seed=10 * number)),
        ordinary=_days(days_of(own, days, seed=10 * number + 1)),
        faults=[
            (trace, float(trace.times[0]))
            for place, name in enumerate(BEARING_FAULTS)
            for trace in [replace(days_of(own, 1, seed=1000 + place, effect=name), name=name, events=())]
        ],
    )


def _files(name: str, folder: Path, taught: int, files: str = "*.csv") -> Source:
    """Measured recordings, every so many-th of them taught; a single one is cut in halves."""
    column_map = load_map(ROOT / "config" / "traces" / f"{name}.toml")
    traces = list[Trace]()
    for path in sorted(folder.rglob(files)):
        try:
            traces += [trace for trace in load_traces([str(path)], column_map)[0] if trace.times.size > MIN_ROWS]
        except ValueError:
            continue  # the public sets hold files that lack the clock or the temperature
    if len(traces) == 1:
        middle = float(traces[0].times[traces[0].times.size // 2])
        traces = [traces[0].between(-np.inf, middle), traces[0].between(middle, np.inf)]
        return Source(column_map=column_map, taught=traces[:1], ordinary=traces[1:])
    return Source(
        column_map=column_map,
        taught=traces[::taught],
        ordinary=[trace for place, trace in enumerate(traces) if place % taught],
    )


def _skab(folder: Path) -> Source:
    """The pump's recording without a fault, its second half not taught; the public set's others, each with one."""
    whole = _files("skab", folder, 2, "anomaly-free.csv")
    files = [path for path in sorted(folder.rglob("*.csv")) if path.name != "anomaly-free.csv"]
    faults = []
    for path in files:
        (trace,) = load_traces([str(path)], whole.column_map)[0]
        with path.open(encoding="utf-8", newline="") as stream:
            wrong = [row["anomaly"] == "1.0" for row in csv.DictReader(stream, delimiter=";")]
        begin = float(trace.times[0]) + wrong.index(True) / len(wrong) * float(trace.times[-1] - trace.times[0])
        faults.append((replace(trace, name=f"{path.parent.name} {path.stem}"), begin))
    return replace(whole, faults=faults)


SOURCES: Mapping[str, Callable[[int, Path], Source]] = {
    **{f"year {seed}": lambda days, _, seed=seed: _year(seed, days) for seed in (1, 2, 3)},
    **{f"shifts {seed}": lambda days, _, seed=seed: _shifts(seed, days) for seed in (1, 2)},
    "slow": lambda days, _: _slow(1, days),
    **{f"bearing {number}": lambda days, _, number=number: _bearing(number, days) for number in (0, 1)},
    "carobd": lambda _, data: _files("carobd", data / "carobd", 2),
    "skab": lambda _, data: _skab(data / "skab"),
}
"""A source by its name, of so many days where it is synthetic, of the data in a folder where it is measured."""


# ------------------------------------------------------------------ a gateway on them


AT_FLOOR = "anomaly at 10"
"""What would have been announced without the model's record."""


@dataclass(frozen=True, slots=True)
class Announced:
    """A kind of alarm that was announced, how long (s) after the beginning of its recording."""

    kind: str
    after: float


def _raised_at_floor(historian: Path) -> Iterator[float]:
    """When (s) the anomaly alarm would have been raised at its floor, by the scores on record."""
    with reading(historian) as connection:
        (machine_name, _), *_ = machines(connection)
        rows = stored_rows(connection, "predictions", ("time", "anomaly"), machine=machine_name)
        stands = False
        for time, score in sorted(rows):
            if not stands and score > ANOMALY_FLOOR:
                yield time
            stands = score > ANOMALY_FLOOR * (1.0 - DEADBAND_SHARE) if stands else score > ANOMALY_FLOOR


def write_plant(folder: Path, source: Source) -> Path:
    """The plant file of a machine that has the source's signals."""
    trace = source.taught[0]
    units = {name: each.unit for name, each in source.column_map.signals.items()}
    rows = "".join(
        f'[[tags]]\nname = "{name}"\naddress = "holding:{2 * place}"\ndtype = "float32"\norder = "CDAB"\n'
        + (f'unit = "{unit}"\n' if (unit := units.get(name)) else "")
        for place, name in enumerate(sorted(trace.signals))
    )
    (folder / "device.toml").write_text(f'[device]\nname = "m"\ndriver = "modbus"\nunit = 1\n{rows}', encoding="utf-8")
    period = max(1.0, round(float(np.median(np.diff(trace.times))), 1))
    temperature = source.column_map.temperature
    path = folder / "plant.toml"
    path.write_text(
        f'[device]\nfile = "device.toml"\nhost = "127.0.0.1"\n[scan]\nperiod = {period}\n'
        f'[model]\npath = "model"\ntemperature = "{temperature}"\n[historian]\npath = "h.sqlite"\n'
        f'[log]\npath = "log.jsonl"\n[forecast]\nruns = 50\nperiod = {max(60.0, 6 * period)}\n'
        f'[writeback]\nmode = "off"\n[alarms]\nlimit = 1000.0\ntags = ["{temperature}"]\n',
        encoding="utf-8",
    )
    return path


def _sessions(trace: Trace, rng: np.random.Generator) -> Iterator[Trace]:
    """A trace as a gateway sees it that is stopped every few hours and off for a while."""
    begin, end = float(trace.times[0]), float(trace.times[-1])
    while begin < end:
        stop = begin + SESSION_S * float(rng.uniform(0.5, 1.5))
        session = trace.between(begin, min(stop, np.nextafter(end, np.inf)))
        if session.times.size > 1:
            yield session
        begin = stop + float(rng.uniform(*OFF_S))


def watch(plant: Path, traces: Sequence[Trace], *, speed: float, seed: int) -> tuple[list[Announced], float]:
    """What a gateway announces along the traces, one after the other on the same records; and how long (s) it ran.

    Each begins a night after the one before it.
    """
    rng = np.random.default_rng([seed, int(speed)])
    config, begin, seconds = load_config(plant), BEGIN, 0.0
    starts = list[float]()
    for trace in traces:
        moved = replace(trace, times=trace.times - trace.times[0] + begin, events=())
        begin = float(moved.times[-1]) + 8 * 3600.0
        starts.append(float(moved.times[0]))
        for session in _sessions(moved, rng):
            columns = {name: column.tolist() for name, column in session.signals.items()}
            recording = SiteRecording(plant, session.times.tolist(), columns)
            clock = LateClock(recording.times[0], speed, rng)
            asyncio.run(follow_recording(config, recording, clock, lambda *_: None))
            seconds += recording.duration
    journal = read_journal(config.historian.path)
    told = [(row.time, row.alarm) for row in journal if row.state == "unacknowledged" and row.alarm in KINDS]
    told += [(time, AT_FLOOR) for time in _raised_at_floor(config.historian.path)]
    places = np.searchsorted(starts, [time for time, _ in told], side="right") - 1
    found = zip(told, places.tolist(), strict=True)
    return [Announced(kind, time - starts[place]) for (time, kind), place in found], seconds


def rate_interval(count: int, weeks: float) -> tuple[float, float]:
    """Poisson's exact 95 % interval of a rate per week (Garwood 1936)."""
    low = float(chi2.ppf(0.025, 2 * count)) / 2 if count else 0.0
    return low / weeks, float(chi2.ppf(0.975, 2 * count + 2)) / 2 / weeks


def measure(name: str, source: Source, *, speeds: Sequence[float]) -> Iterator[Figure]:
    """The alarms of one source: of what is ordinary by kind and speed, and of what is broken."""
    taught = teach_model(
        [encode_trace(replace(trace, events=()), source.column_map.alphabet) for trace in source.taught],
        source.column_map,
        temperature=source.column_map.temperature,
        name="nuisance",
        seed=0,
        lsha=None,
        report=lambda *_: None,
    )
    record = taught.model.anomalies
    if record is not None:
        what = f"{name}: anomaly begins at, by {record.seconds / 3600.0:.3g} h of {record.units} held out"
        yield Figure(what, max(record.level, ANOMALY_FLOOR), "", "by the record", record.level)
    with tempfile.TemporaryDirectory(prefix="nuisance-") as parent:

        def begin(what: str) -> Path:
            folder = Path(parent) / what
            folder.mkdir()
            taught.write(folder / "model")
            return write_plant(folder, source)

        for speed in speeds:
            found, seconds = watch(begin(f"{speed:g}"), source.ordinary, speed=speed, seed=1)
            weeks, counts = seconds / WEEK_S, Counter(each.kind for each in found)
            for kind in (*KINDS, AT_FLOOR):
                low, high = rate_interval(counts[kind], weeks)
                what = f"{name}, x{speed:g}: {kind} a week ({low:.2g} to {high:.2g}), {seconds / 3600.0:.3g} h"
                yield Figure(what, counts[kind] / weeks, "alarms", "counted", counts[kind])
        if source.faults:
            delays: dict[str, list[float]] = {"anomaly": [], AT_FLOOR: []}
            for place, (trace, wrong) in enumerate(source.faults):
                found, _ = watch(begin(f"fault {place}"), [trace], speed=1.0, seed=1)
                after = wrong - float(trace.times[0])
                for kind, own in delays.items():
                    own += sorted(each.after - after for each in found if each.kind == kind and each.after >= after)[:1]
            for kind, own in delays.items():
                yield Figure(f"{name}: broken, with {kind} after it began", len(own), "", "of", len(source.faults))
                if own:
                    yield Figure(f"{name}: broken, until {kind} (median)", float(np.median(own)) / 60.0, "min")


@click.command()
@click.argument("names", nargs=-1, metavar="[SOURCE]...")
@click.option("--days", type=click.IntRange(1, 60), default=14, show_default=True, help="Of a synthetic source.")
@click.option("--data", type=click.Path(exists=True, file_okay=False, path_type=Path), default=SHARED, help="Measured.")
@click.option("--speed", "speeds", type=float, multiple=True, default=SPEEDS, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="One line of JSON instead of a table.")
def main(names: Sequence[str], days: int, data: Path, speeds: Sequence[float], as_json: bool) -> None:
    """Learn from some days and let a gateway watch others."""
    if unknown := [name for name in names if name not in SOURCES]:
        raise click.UsageError(f"{unknown[0]!r} is no source; these are: {', '.join(SOURCES)}")
    rows = [figure for name in names or SOURCES for figure in measure(name, SOURCES[name](days, data), speeds=speeds)]
    give("a model's own alarms where nothing is wrong", rows, as_json=as_json)


if __name__ == "__main__":
    main()
