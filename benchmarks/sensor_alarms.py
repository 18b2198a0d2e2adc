"""How often the alarms about sensors and the straight line come in vain, and how soon they find a fault (record 0132).

In vain: on the shipped scenarios, on days of production, and on measured data beside the project (`--data`,
../shared/data by default; a set that is not there is left out). A sensor of the run-to-failure tests that jumps does so
on record: what is raised is listed with its time, so that it can be looked at. Found: faults put into the reading of
one of two bearings in the middle of a day of production.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from drivers.tag import Quality, Sample
from gateway.machine.alarms import SensorWatch
from gateway.machine.reading import Scan
from gateway.settings.alarm_kinds import FAULT_THRESHOLD
from sim.lab.recordings import load_map, load_traces
from sim.plant import SCENARIOS, production, scenario
from sim.sha import Array

MAPS = Path(__file__).parents[1] / "config" / "traces"
TWINS = ("TCuscinettiRiduttore", "TCuscinettiAlimentazione")
LIMIT, TREND = 80.0, 300.0
MEASURED = {"femto": "femto_bearing", "skab": "skab", "carobd": "carobd"}
"""Column maps, and the folders of their data."""


def follow(times: Array, readings: dict[str, Array], *, limit: float = LIMIT) -> Iterator[tuple[float, str]]:
    """The moments (s) at which alarms begin, and their names, on readings at `times` that are all good; NaN: none."""
    names = tuple(readings)
    watch = SensorWatch(names, names if len(names) == 2 else (), TREND)
    standing: set[str] = set()
    for row, time in enumerate(times.tolist()):
        samples = {
            name: Sample(name, value, Quality.GOOD, time)
            for name, column in readings.items()
            if np.isfinite(value := float(column[row]))
        }
        for name, value in watch.take(Scan(row, time, samples, 0, 0.0)).items():
            if value is None:
                continue
            if value > (limit if name.startswith("rising") else FAULT_THRESHOLD):
                if name not in standing:
                    yield time, name
                standing.add(name)
            else:
                standing.discard(name)


def in_vain(set_name: str, times: Array, readings: dict[str, Array], *, limit: float = LIMIT) -> list[Figure]:
    """How many alarms of each kind were raised where nothing was wrong, with the first times (s from the begin)."""
    found: dict[str, list[float]] = {}
    for time, name in follow(times, readings, limit=limit):
        found.setdefault(name, []).append(time - float(times[0]))
    hours = float(times[-1] - times[0]) / 3600.0
    figures = [Figure(f"{set_name}, {hours:.1f} h, alarms", sum(map(len, found.values())), "")]
    return figures + [
        Figure(f"{set_name}, {name}, {len(at)} times, first after", at[0], "s") for name, at in found.items()
    ]


def faults(seed: int) -> dict[str, Callable[[Array, Array], Array]]:
    """What is done to the readings (degC) from a moment on; given the times since then (s)."""
    rng = np.random.default_rng(seed)

    def jumping(since: Array, values: Array) -> Array:
        return values + np.where(since.astype(int) % 120 == 60, 30.0, 0.0)

    return {
        "sensor frozen": lambda since, values: np.full_like(values, values[0]),
        "sensor jumping": jumping,
        "sensor noisy": lambda since, values: values + rng.normal(0.0, 1.0, values.size),
        "sensor drifting": lambda since, values: values + since / 3600.0 * 0.25,
    }


def found_after(days: int, seed: int) -> list[Figure]:
    """The seconds after which each fault is found, and what else is raised then."""
    trace = production(days + 1, 4, seed=seed, period=1.0)
    begin = int(np.searchsorted(trace.times, trace.times[0] + days * 86_400.0 + 30_000.0))
    end = begin + 40_000
    figures = []
    for name, spoil in faults(seed).items():
        first = 0 if name == "sensor drifting" else begin - 4000
        readings = {tag: trace.signals[tag][first:end].copy() for tag in TWINS}
        times = trace.times[first:end]
        fault = slice(begin - first, None)
        readings[TWINS[0]][fault] = spoil(times[fault] - times[begin - first], readings[TWINS[0]][fault])
        raised = {alarm: time for time, alarm in reversed(list(follow(times, readings)))}
        at = raised.pop(f"{name} {TWINS[0]}", float("nan"))
        figures.append(Figure(f"{name}, found after", at - float(times[begin - first]), "s"))
        figures.append(Figure(f"{name}, others raised", len(raised), ""))
    return figures


@click.command()
@click.option("--days", type=click.IntRange(4, 60), default=14, show_default=True, help="Days of production.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--data", type=click.Path(path_type=Path), default=Path("../shared/data"), show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(days: int, seed: int, data: Path, as_json: bool) -> None:
    """Measure alarms in vain and the time until a fault is found."""
    figures: list[Figure] = []
    for name in SCENARIOS:
        trace = scenario(name, seed)
        figures += in_vain(name, trace.times, {tag: trace.signals[tag] for tag in TWINS})
    trace = production(days, 4, seed=seed, period=1.0)
    figures += in_vain(f"production, {days} days", trace.times, {tag: trace.signals[tag] for tag in TWINS})
    figures += found_after(4, seed)
    for name, folder in MEASURED.items():
        column_map = load_map(MAPS / f"{name}.toml")
        for trace in load_traces(str(data / folder), column_map)[0] if (data / folder).is_dir() else []:
            readings = {column_map.temperature: trace.signals[column_map.temperature]}
            # Nothing is wrong with being hot there: the straight line has no limit to reach.
            figures += in_vain(f"{name} {trace.name}", trace.times, readings, limit=1000.0)
    give("alarms about sensors", figures, as_json=as_json)


if __name__ == "__main__":
    main()
