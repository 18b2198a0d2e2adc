"""Days of the recorder's plant on which near-twins look alike, and the same machine afterwards, told what to do."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.work import DAY, STEP, Work, follow, hold, roam, work

SPARE_DAYS = 3
"""Days after the record, in which the longest experiment has its place."""
IDLE_MOST_A = 80.0
"""A: below, the machine washes, and its recipe does not matter."""
TREMBLE_A, TREMBLE_S = 3.0, 120.0
"""A and s: size and memory of how the load wanders about what was set."""

Dull = Callable[[Work, np.random.Generator], Work]


def few_loads(usual: Work, rng: np.random.Generator, levels: int) -> Work:
    """So many recipes, each in a bin of its own as far as there are bins."""
    n = usual.running.size
    recipes = np.array([rng.uniform(low + 20.0, low + 80.0) for low in (200.0, 100.0, 240.0, 140.0)[:levels]])
    level = recipes[np.minimum((hold(rng, n, (60.0, 240.0), (0.0, 1.0)) * levels).astype(int), levels - 1)]
    tremble = np.clip(roam(rng, n, TREMBLE_S, TREMBLE_A), -9.0, 9.0)
    load = usual.running * np.where(usual.load < IDLE_MOST_A, usual.load, level + tremble)
    return _with_load(usual, load)


def one_load(usual: Work, rng: np.random.Generator) -> Work:
    """One recipe, day in, day out."""
    return few_loads(usual, rng, 1)


def four_loads(usual: Work, rng: np.random.Generator) -> Work:
    """Four recipes, two a bin."""
    return few_loads(usual, rng, 4)


def speed_by_torque(usual: Work, rng: np.random.Generator) -> Work:
    """The differential speed is set by the solids, as a controller of the torque does."""
    del rng
    speed = usual.running * np.clip(2.0 + 0.35 * usual.torque, 2.0, 27.0)
    return replace(usual, differential=speed)


def speed_by_load(usual: Work, rng: np.random.Generator) -> Work:
    """The differential speed is a part of the recipe: the more load, the faster."""
    load = four_loads(usual, rng)
    return replace(load, differential=load.running * follow(np.clip(0.08 * load.load, 3.0, 27.0), 30.0))


def even_feed(usual: Work, rng: np.random.Generator) -> Work:
    """Slurry that always flows as fast and is about as warm, or not by so much as elsewhere."""
    mean, share = float(np.mean(usual.feed)), rng.uniform(0.1, 0.6)
    return replace(usual, flow=70.0 * usual.pump, feed=mean + share * (usual.feed - mean))


def even_hall(usual: Work, rng: np.random.Generator) -> Work:
    """One recipe in a hall that is always about as warm."""
    mean = float(np.mean(usual.ambient))
    return replace(one_load(usual, rng), ambient=mean + 0.3 * (usual.ambient - mean))


def _with_load(usual: Work, load: Array) -> Work:
    inrush = usual.current > usual.load + 1.0
    return replace(usual, load=load, current=np.where(inrush, usual.current, load))


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantTime:
    """`work` (n,) from the first row of the record to the end of what may follow, at rest after `recorded` rows; and
    what the machine's surroundings do while nobody sets them, (n,) each, whether it runs or not: `torque` (%),
    `vibration` (mm/s), `tremble` of the load (A), `flow` of the pump (%), `differential` (rpm)."""

    work: Work
    recorded: int
    torque: Array
    vibration: Array
    tremble: Array
    flow: Array
    differential: Array


def days_of(rng: np.random.Generator, days: int, dull: Dull) -> PlantTime:
    """Some days of dull work, and the time after them."""
    usual = dull(work(rng, days + SPARE_DAYS), rng)
    n, recorded = usual.running.size, int(days * DAY / STEP)
    at = (np.arange(n) < recorded).astype(float)
    acting = {
        name: getattr(usual, name) * at
        for name in ("running", "load", "current", "pump", "flow", "torque", "differential")
    }
    rests = replace(
        usual,
        **acting,
        vibration=np.where(acting["running"] > 0, usual.vibration, 0.1),
        starts=tuple(start for start in usual.starts if start < recorded),
    )
    bursts = np.where(hold(rng, n, (2.0, 20.0), (0.0, 1.0)) < 0.2, hold(rng, n, (2.0, 20.0), (1.0, 5.0)), 0.0)
    return PlantTime(
        work=rests,
        recorded=recorded,
        torque=np.clip(hold(rng, n, (25.0, 120.0), (20.0, 70.0)) + roam(rng, n, 600.0, 5.0), 2.0, 98.0),
        vibration=1.3 + follow(bursts, 25.0),
        tremble=np.clip(roam(rng, n, TREMBLE_S, TREMBLE_A), -9.0, 9.0),
        flow=hold(rng, n, (30.0, 150.0), (45.0, 95.0)),
        differential=follow(hold(rng, n, (20.0, 100.0), (5.0, 27.0)), 30.0),
    )


def obey(plant: PlantTime, times: Array, columns: Mapping[str, Array]) -> tuple[Work, slice]:
    """The plant's work with set-points by their signals' names, held from `times` (s) on; and its rows of them.

    What is set is reached as a machine does it: with an inrush, a load that trembles and a speed that takes its time.
    Raises ValueError for set-points that begin in the record or end after the plant's time.
    """
    seconds, was = plant.work.seconds, plant.work
    first, last = int(np.ceil(times[0] / STEP)), int(times[-1] / STEP) + 1
    if first < plant.recorded or last > seconds.size:
        raise ValueError(f"rows {first} to {last} of set-points are not among {plant.recorded} to {seconds.size}")
    rows = slice(first, last)
    held = np.searchsorted(times, seconds[rows], side="right") - 1

    def settled(name: str, otherwise: Array) -> Array:
        return np.asarray(columns[name][held] if name in columns else otherwise[rows])

    running = (settled("MarciaDecanter", was.running) > 0.5).astype(float)
    starts = tuple((np.flatnonzero(np.diff(running, prepend=0.0) > 0) + first).tolist())
    load = running * np.maximum(settled("Assorbimento", was.load) + plant.tremble[rows], 0.0)
    pump = running * (settled("MarciaPmpFango", running) > 0.5)
    speed = running * follow(settled("Differenziale", plant.differential), 30.0)
    changed = {
        "running": running,
        "load": load,
        "current": load,
        "pump": pump,
        "flow": pump * plant.flow[rows],
        "torque": running * plant.torque[rows],
        "differential": speed,
        "vibration": np.where(running > 0, plant.vibration[rows], 0.1),
    }
    out = {name: getattr(was, name).copy() for name in changed}
    for name, column in changed.items():
        out[name][rows] = column
    for start in starts:
        out["current"][start] = 390.0
    return replace(was, **out, starts=(*was.starts, *starts)), rows


def part(whole: Work, rows: slice) -> Work:
    """These rows of a work, as one of its own."""
    columns = {one.name: getattr(whole, one.name)[rows] for one in fields(Work) if one.name != "starts"}
    starts = tuple(start - rows.start for start in whole.starts if rows.start <= start < rows.stop)
    return Work(**columns, starts=starts)
