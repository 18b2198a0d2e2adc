"""Cases from specs: strengths set to the wanted signal-to-noise ratio, runs, recorded traces, models, labels."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.discrepancy.bearings import Machine, family_of, learn, learn_before, machine_of, moved, suits
from benchmarks.discrepancy.effects import EFFECTS, Kind
from benchmarks.discrepancy.log import written_log
from benchmarks.discrepancy.operation import Array, Operation, operate
from benchmarks.discrepancy.outside import OUTSIDE
from benchmarks.discrepancy.plant import Bearing, Case, Course, Parts, disturbance, run, together
from benchmarks.discrepancy.seal import Label
from benchmarks.discrepancy.strata import SETS, Spec
from benchmarks.discrepancy.visible import FITTED, Family, left_over, signal_to_noise

KINDS = {**EFFECTS, **OUTSIDE}
PASSES, CLOSE = 5, 0.05
"""Rounds in which strengths are scaled, and the relative distance from the wanted ratio that is near enough."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A case with all that was drawn for it except the strengths."""

    spec: Spec
    machine: Machine
    bearing: Bearing
    operation: Operation
    disturbance: Array
    family: Family

    def parts(self, strengths: dict[str, float]) -> Parts:
        """What acts at these strengths; each effect has its own details whatever its strength and company."""
        made = [KINDS[name].make(self.operation, value, self._details(name)) for name, value in strengths.items()]
        return together([Parts(), *made])

    def case(self, strengths: dict[str, float], quiet: bool = False) -> Case:
        """What `plant.run` takes; `quiet`: without the disturbance."""
        noise = np.zeros_like(self.disturbance) if quiet else self.disturbance
        return self.operation, self.bearing, noise, self.parts(strengths)

    def _details(self, name: str) -> np.random.Generator:
        return self.spec.generator(f"effect/{name}")


def identifier(spec: Spec) -> str:
    """A name that tells nothing: the first half of a hash over set, its entropy, stratum and number."""
    text = f"{spec.set}/{SETS[spec.set]}/{spec.stratum}/{spec.number}"
    return sha256(text.encode()).hexdigest()[:12]


def draw(spec: Spec, models: Path) -> Drawn:
    """Everything about a case but its strengths; its machine's model must lie in `models`."""
    machine = machine_of(spec)
    operation = operate(spec.generator("operation"), spec.days, spec.cycles)
    bearing = moved(machine.bearing, spec.generator("moved")) if spec.moved else machine.bearing
    noise = disturbance(spec.generator("disturbance"), operation, bearing, machine.rough)
    return Drawn(spec, machine, bearing, operation, noise, family_of(models / machine.name))


@dataclass(slots=True)
class _Search:
    """The search for one effect's strength: the best so far, and what is tried next."""

    drawn: Drawn
    name: str
    strength: float
    best: tuple[float, float] = (np.nan, np.nan)

    @property
    def kind(self) -> Kind:
        """The effect."""
        return KINDS[self.name]

    @property
    def done(self) -> bool:
        """Near enough, or at the end of what the plant bears."""
        near = abs(self.best[1] / self.drawn.spec.ratio - 1) < CLOSE
        return bool(near or (np.isfinite(self.best[1]) and self.strength == self.best[0]))

    def learn(self, ratio: float) -> None:
        """Take the ratio that was found at the strength tried, and go on in proportion."""
        wanted = self.drawn.spec.ratio
        old = self.best
        if not np.isfinite(old[1]) or abs(np.log(ratio / wanted)) < abs(np.log(old[1] / wanted)):
            self.best = (self.strength, ratio)
        power = 1.0
        if np.isfinite(old[1]) and old[0] != self.strength and old[1] != ratio:
            power = float(np.clip(np.log(ratio / old[1]) / np.log(self.strength / old[0]), 0.5, 2.5))
        ahead = self.best[0] * float(np.clip((wanted / self.best[1]) ** (1 / power), 0.1, 10.0))
        self.strength = float(np.clip(ahead, self.kind.low, self.kind.high))


def scaled(cases: Sequence[Drawn]) -> list[dict[str, tuple[float, float]]]:
    """For each case the (strength, ratio) of its effects, each by itself; a ratio out of reach comes out lower."""
    without = run([one.case({}) for one in cases])
    searches = [
        (number, _Search(one, name, float(np.clip(0.1 * one.spec.ratio, KINDS[name].low, KINDS[name].high))))
        for number, one in enumerate(cases)
        for name in one.spec.effects
    ]
    for _ in range(PASSES):
        open_ = [(number, search) for number, search in searches if not search.done]
        if not open_:
            break
        courses = run([search.drawn.case({search.name: search.strength}) for _, search in open_])
        for (number, search), course in zip(open_, courses, strict=True):
            search.learn(_ratio(search.drawn, without[number], course))
    found: list[dict[str, tuple[float, float]]] = [{} for _ in cases]
    for number, search in searches:
        found[number][search.name] = search.best
    return found


def _ratio(one: Drawn, without: Course, course: Course) -> float:
    sensor = one.machine.rough.sensor
    return signal_to_noise(one.operation, one.bearing, one.family, without.sensor, course.sensor, sensor)


def make(specs: Sequence[Spec], out: Path) -> list[Label]:
    """Write the traces, models and configurations of some cases under `out`, and return their labels.

    The models of their machines must lie in `out`/models already.
    """
    cases = [draw(spec, out / "models") for spec in specs]
    strengths = scaled(cases)
    courses = run([one.case(_bare(given)) for one, given in zip(cases, strengths, strict=True)])
    alone = run([one.case({}, quiet=True) for one in cases])
    quiet = run([one.case(_bare(given), quiet=True) for one, given in zip(cases, strengths, strict=True)])
    return [
        _write(*each, out)
        for each in zip(cases, strengths, courses, map(_floor, cases, courses, quiet), alone, strict=True)
    ]


def _floor(one: Drawn, course: Course, quiet: Course) -> float:
    """Free-run error (degC) of the true plant in the time held out: what its disturbances and its sensor do."""
    rows = slice(int(FITTED * course.sensor.size), None)
    wandering = float(np.mean((course.sensor[rows] - quiet.sensor[rows]) ** 2))
    return float(np.sqrt(wandering + one.machine.rough.sensor**2))


def _bare(given: dict[str, tuple[float, float]]) -> dict[str, float]:
    return {name: strength for name, (strength, _) in given.items()}


def _write(
    one: Drawn, given: dict[str, tuple[float, float]], course: Course, floor: float, alone: Course, out: Path
) -> Label:
    spec, name = one.spec, identifier(one.spec)
    folder = out / "cases" / name
    written_log(folder / "traces.csv", one.operation, course, one.machine.rough, spec, spec.generator("log"))
    model, learned = out / "models" / one.machine.name, spec.learned
    if learned == "same":
        learn(folder / "traces.csv", folder / "model", seed=0)
        if suits(family_of(folder / "model"), one.bearing):
            model = folder / "model"
        else:
            learned = "before"
    gap = left_over(one.operation, one.bearing, one.family, alone.sensor) / one.machine.rough.sensor
    config: dict[str, Any] = {"traces": "traces.csv", "seed": int(spec.generator("seed").integers(2**31))}
    Label.write_config(folder, config | {"model": str(model.relative_to(out))})
    return Label(
        case=name,
        spec=asdict(replace(spec, learned=learned)),
        strengths={key: strength for key, (strength, _) in given.items()},
        ratios={key: ratio for key, (_, ratio) in given.items()},
        outside=tuple(key for key in spec.effects if key in OUTSIDE),
        baseline_gap=gap,
        sensor=one.machine.rough.sensor,
        floor=floor,
        machine=one.machine.name,
    )


def learn_models(specs: Sequence[Spec], out: Path, jobs: int) -> None:
    """The models of all machines that the specs need, each learned once."""
    from joblib import Parallel, delayed

    machines = {(spec.set, machine.name): machine for spec in specs for machine in [machine_of(spec)]}
    Parallel(n_jobs=jobs)(
        delayed(learn_before)(set_, machine, out / "models") for (set_, _), machine in machines.items()
    )
