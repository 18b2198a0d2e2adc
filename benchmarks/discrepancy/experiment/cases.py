"""Cases in which a diagnosis may end between near-twins: what acts, on which days, and how the machine goes on."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
import pandas as pd

from benchmarks.discrepancy.experiment import days
from benchmarks.discrepancy.experiment.days import Dull, PlantTime, days_of, obey, part
from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.actors import ACTORS
from benchmarks.discrepancy.recorder.baseline import cut_cells, measure_visible
from benchmarks.discrepancy.recorder.cases import (
    MOVED,
    TYPES,
    RecorderCase,
    RecorderSpec,
    integrate_all,
    machine_of_type,
    restless,
    suit_type,
)
from benchmarks.discrepancy.recorder.habits import HABITS, record, write_rows
from benchmarks.discrepancy.recorder.masses import Machine, Task, move, stir
from benchmarks.discrepancy.recorder.work import STEP, Work, roam
from benchmarks.discrepancy.seal import Label
from benchmarks.discrepancy.visible import Family

DAYS = 4
"""Days of the record."""
ROUNDS, NEAR = 4, 0.1
"""Rounds in which a strength is scaled, and the relative distance from the wanted ratio that ends them."""
MOST_STARTS = 256
"""Cycles for which a scatter is drawn."""
SETTABLE = ("MarciaDecanter", "Assorbimento", "MarciaPmpFango", "Differenziale")
"""Signals that the machine obeys; what others have in a file of set-points is what somebody expects of them."""
DAYS_FILE = "days.csv"
RECORDERS = ("tidy", "uneven", "slow", "lossy")
"""Habits of the recorder, by turns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinKind:
    """Near-twins: each of `acts` in turn, on `dull` days, at a signal-to-noise of each of `ratios` in turn. All
    are drawn on machines of one `law` of the load's heat, lest that tell them apart ("": on both laws by turns)."""

    acts: tuple[str, ...]
    dull: Dull
    law: str = ""
    ratios: tuple[float, ...] = (1.5, 3.0)


KINDS: Mapping[str, TwinKind] = {
    "law of the current": TwinKind(
        acts=("current-heating", "quadratic-current-heating"), dull=days.four_loads, law="steps", ratios=(2.0, 3.0)
    ),
    "speed or load": TwinKind(
        acts=("speed-friction", "current-heating"), dull=days.speed_by_load, law="steps", ratios=(1.5, 2.5)
    ),
    "speed or square of the load": TwinKind(
        acts=("speed-friction", "quadratic-current-heating"), dull=days.speed_by_load, law="line", ratios=(1.5, 2.5)
    ),
    "speed or torque": TwinKind(
        acts=("torque-friction", "speed-friction"), dull=days.speed_by_torque, ratios=(1.0, 1.5)
    ),
    "pump or feed": TwinKind(
        acts=("pump-cooling", "feed-temperature-coupling"), dull=days.even_feed, ratios=(1.5, 2.5)
    ),
    "lag or delay": TwinKind(acts=("sensor-lag", "dead-time"), dull=days.one_load, ratios=(1.0, 1.5)),
    "loss": TwinKind(
        acts=("radiation-loss", "ambient-coupling", "thermostatic-cooling"), dull=days.even_hall, ratios=(0.7, 1.0)
    ),
}
"""What is made, by the kind of class that it may end in."""


@dataclass(frozen=True, slots=True)
class TwinCase:
    """A case with what was drawn for it: the plant's time, the machine's family of models, and the strength."""

    case: RecorderCase
    plant: PlantTime
    family: Family
    strength: float = 1.0

    @property
    def spec(self) -> RecorderSpec:
        """What it is."""
        return self.case.spec

    def task(self, whole: Work, *, strength: float, quiet: bool) -> Task:
        """The machine through a work; `quiet`: without what nobody knows."""
        acting = RecorderCase(self.spec, self.case.machine, whole)
        guest = acting.guest({self.spec.acts[0]: strength} if strength else {})
        unrest = _unrest(self.spec.generator("unrest"), whole, self.case.machine) * (not quiet)
        return Task(work=whole, machine=self.case.machine, guest=guest, unrest=unrest)


def _unrest(rng: np.random.Generator, whole: Work, machine: Machine) -> Array:
    """As `unrest_of`, with the same draws for the same rows however many cycles follow."""
    each = machine.scatter * rng.standard_normal(MOST_STARTS)
    wandering = roam(rng, whole.running.size, machine.memory, machine.rough)
    scattered = whole.running * each[np.minimum(whole.cycle, MOST_STARTS - 1)]
    return np.asarray(machine.running * machine.usual * (stir(whole.running) * wandering + scattered))


def specs(set_: str, kind: str, numbers: Iterable[int]) -> list[RecorderSpec]:
    """The cases of a kind."""
    return [_spec(set_, kind, number) for number in numbers]


def _spec(set_: str, kind: str, n: int) -> RecorderSpec:
    twins = KINDS[kind]
    acts = twins.acts[n % len(twins.acts)]
    law = twins.law or ("steps", "line")[n // len(twins.acts) % 2]
    rng = np.random.default_rng(np.random.SeedSequence([crc32(f"{set_}/{kind}".encode()), n]))
    return RecorderSpec(
        set=set_,
        stratum=kind,
        number=n,
        acts=(acts,),
        ratio=twins.ratios[n // len(twins.acts) % len(twins.ratios)],
        law=law,
        type=f"{law}-{int(rng.integers(TYPES))}",
        habit=RECORDERS[(n + tuple(KINDS).index(kind)) % len(RECORDERS)],
        learned="other" if n % 2 else "before",
        rough=n % 4 != 3,
        days=DAYS,
    )


def draw(spec: RecorderSpec, out: Path) -> TwinCase:
    """What is random in a case but its recorder; the model of its type is learned where it is not there."""
    twins = KINDS[spec.stratum]
    suited, family = suit_type(replace(spec, acts=twins.acts), out)
    spec = replace(suited, acts=spec.acts)
    rng = spec.generator("machine")
    machine = machine_of_type(spec.set, spec.type)
    machine = restless(move(machine, rng, MOVED) if spec.learned == "other" else machine, rng, spec.rough)
    plant = days_of(spec.generator("work"), spec.days, twins.dull)
    return TwinCase(RecorderCase(spec, machine, plant.work), plant, family)


def scale(cases: Sequence[TwinCase]) -> list[tuple[TwinCase, float]]:
    """The cases at strengths that give the wanted ratios to the sensor's noise, and the ratios that were reached."""
    whole = [part(one.plant.work, slice(0, one.plant.recorded)) for one in cases]
    cells = [cut_cells(work, one.family) for work, one in zip(whole, cases, strict=True)]

    def courses(strengths: Sequence[float], which: Sequence[int]) -> list[Array]:
        return integrate_all([cases[n].task(whole[n], strength=strengths[n], quiet=True) for n in which])

    every = range(len(cases))
    without = courses([0.0] * len(cases), every)
    strengths, best = [1.0] * len(cases), [(1.0, 1e-9)] * len(cases)
    left = list(every)
    for _ in range(ROUNDS):
        for n, course in zip(left, courses(strengths, left), strict=True):
            wanted, sigma = cases[n].spec.ratio, HABITS[cases[n].spec.habit].sigma
            ratio = max(measure_visible(cells[n], without[n], course) / sigma, 1e-9)
            if abs(np.log(ratio / wanted)) < abs(np.log(best[n][1] / wanted)):
                best[n] = strengths[n], ratio
            ahead = best[n][0] * np.clip(wanted / best[n][1], 0.1, 10.0)
            strengths[n] = float(np.clip(ahead, 0.01, ACTORS[cases[n].spec.acts[0]].most))
        left = [n for n in left if abs(best[n][1] / cases[n].spec.ratio - 1.0) > NEAR and strengths[n] != best[n][0]]
        if not left:
            break
    return [(replace(one, strength=strength), ratio) for one, (strength, ratio) in zip(cases, best, strict=True)]


def write_days(cases: Sequence[TwinCase], out: Path) -> None:
    """The record of each case, and what the runner may know of it, in `out`/cases/its identifier."""
    works = [part(one.plant.work, slice(0, one.plant.recorded)) for one in cases]
    tasks = [one.task(one.plant.work, strength=one.strength, quiet=False) for one in cases]
    for one, whole, course in zip(cases, works, integrate_all(tasks), strict=True):
        habit, rng = HABITS[one.spec.habit], one.spec.generator("recorder")
        rows = record(rng, course[: one.plant.recorded], habit)
        write_rows(folder_of(one.spec, out) / DAYS_FILE, whole, rows, habit, rng)
        seed = int(one.spec.generator("seed").integers(2**31))
        model = f"models/{one.spec.set}-{one.spec.type}"
        Label.write_config(folder_of(one.spec, out), {"traces": DAYS_FILE, "seed": seed, "model": model})


def write_experiment(one: TwinCase, set_points: Path, out: Path) -> None:
    """The recording of a machine that obeys the set-points of a file: what the recorder keeps, after the record."""
    table = pd.read_csv(set_points, comment="#")
    columns = {name: table[name].to_numpy(float) for name in SETTABLE if name in table}
    whole, rows = obey(one.plant, table["time"].to_numpy(float), columns)
    (course,) = integrate_all([one.task(whole, strength=one.strength, quiet=False)])
    habit, rng = HABITS[one.spec.habit], one.spec.generator("recorder of the experiment")
    kept = record(rng, course[rows], habit)
    later = replace(kept, stated=kept.stated + rows.start * STEP)
    write_rows(out, part(whole, rows), later, habit, rng)


def folder_of(spec: RecorderSpec, out: Path) -> Path:
    """Where a case lies."""
    return out / "cases" / spec.identifier
