"""Cases of the network: what is hidden, how it is sampled, and which model is given; as the runner reads them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from zlib import crc32

import numpy as np
import pandas as pd

from benchmarks.discrepancy.bearings import learn
from benchmarks.discrepancy.network.baseline import left_over, visible
from benchmarks.discrepancy.network.duty import Duty, DutyKind, duty
from benchmarks.discrepancy.network.hidden import INSIDE, OUTSIDE, Hidden
from benchmarks.discrepancy.network.thermal import Addition, NetworkRun, Plant, added, courses, unrest_of
from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.seal import Label

SETS: Mapping[str, int] = {"tuning": 71_011, "fresh": 82_013, "final": 93_019}
"""The entropy of each set's seeds; a set that was used for tuning is no longer fresh. `final` is only measured."""
PERIODS = (10, 1, 30, 5, 60, 2, 20)
RATIOS = (3.0, 6.0, 1.5)
NOISES = (0.05, 0.5)
GIVEN = ("before", "other", "same")
LEARNABLE = 20
"""Seconds between rows up to which a model can be learned with the plant's own alphabet (its `gap`)."""
FITTED, BATCH = 0.7, 100
"""The share of the time that a tool may fit; runs that are integrated side by side."""
HIDDEN: Mapping[str, Hidden] = {**{name: make for name, (_, make) in INSIDE.items()}, **OUTSIDE}


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkSpec:
    """One case before anything is drawn; `effects` are the names of a perfect answer, or what has none.

    `learned`: the given model comes from days `before` on this machine, from an `other` machine of its type, or from
    the `same` traces. `period` (s) and `noise` (degC) are the recorder's.
    """

    set: str
    stratum: str
    number: int
    hidden: tuple[str, ...]
    effects: tuple[str, ...]
    ratio: float
    rough: bool
    learned: str
    duty: DutyKind
    period: int
    noise: float
    days: int
    moved: bool = False
    missing: tuple[str, ...] = ()

    def generator(self, purpose: str) -> np.random.Generator:
        """A generator of its own for each purpose."""
        label = f"{self.stratum}/{purpose}"
        return np.random.default_rng(np.random.SeedSequence([SETS[self.set], crc32(label.encode()), self.number]))

    @property
    def identifier(self) -> str:
        """A name that tells nothing."""
        return sha256(f"network/{self.set}/{self.stratum}/{self.number}".encode()).hexdigest()[:12]


def specs(set_: str, stratum: str, numbers: Sequence[int]) -> list[NetworkSpec]:
    """The cases of a stratum: clean, singles, pairs or outside. Raises ValueError for any other."""
    return [_spec(set_, stratum, number) for number in numbers]


def _spec(set_: str, stratum: str, n: int) -> NetworkSpec:
    names = tuple(INSIDE)
    match stratum:
        case "clean":
            hidden: tuple[str, ...] = ()
        case "singles":
            hidden = (names[n % len(names)],)
        case "outside":
            hidden = (tuple(OUTSIDE)[n % len(OUTSIDE)],)
        case "pairs":
            first, second = divmod(n * 37 % (len(names) * (len(names) - 1)), len(names) - 1)
            hidden = (names[first], names[(first + 1 + second) % len(names)])
        case _:
            raise ValueError(f"there is no stratum {stratum!r}; there are clean, singles, outside and pairs")
    period = PERIODS[n % len(PERIODS)]
    draft = NetworkSpec(
        set=set_,
        stratum=stratum,
        number=n,
        hidden=hidden,
        effects=tuple(INSIDE[name][0] if name in INSIDE else name for name in hidden),
        ratio=RATIOS[(n + n // len(names)) % 3] if hidden else 0.0,
        rough=n % 2 == 0,
        learned="other" if GIVEN[n % 3] == "same" and period > LEARNABLE else GIVEN[n % 3],
        duty="campaign" if n % 5 == 4 else "shifts",
        period=period,
        noise=0.0,
        days=2 if period <= 2 else 4,
    )
    return replace(draft, noise=round(float(np.exp(draft.generator("noise").uniform(*np.log(NOISES)))), 3))


def plant_of(rng: np.random.Generator, rough: bool) -> Plant:
    """A machine: time constants of about 20 to 30 min running and 45 to 75 min at rest, 30 to 80 degC."""
    total = 41_000.0
    running = total / rng.uniform(1200, 1800)
    return Plant(
        idle=running * rng.uniform(8.0, 12.0),
        slope=running * rng.uniform(0.07, 0.12),
        viscous=rng.uniform(15.0, 60.0),
        resting=total / rng.uniform(2700, 4500),
        running=running,
        hall=rng.uniform(16.0, 20.0),
        inrush=rng.uniform(1000, 6000),
        rough=rng.uniform(0.005, 0.015) if rough else 0.0,
        memory=rng.uniform(200, 900),
        scatter=rng.uniform(0.003, 0.010) if rough else 0.0,
    )


def sister(plant: Plant, rng: np.random.Generator) -> Plant:
    """Another machine of the type: friction and draught differ by some per cent."""
    by = np.exp(0.05 * rng.standard_normal(5))
    return replace(
        plant,
        idle=plant.idle * by[0],
        slope=plant.slope * by[1],
        resting=plant.resting * by[2],
        running=plant.running * by[3],
        viscous=plant.viscous * by[4],
        hall=plant.hall + 0.5 * float(rng.standard_normal()),
    )


@dataclass(frozen=True, slots=True)
class NetworkCase:
    """A case with what was drawn for it, except the strengths."""

    spec: NetworkSpec
    plant: Plant
    duty: Duty

    def addition(self, strengths: Mapping[str, float]) -> Addition:
        """What is hidden at these strengths; its details do not change with them."""
        made = [HIDDEN[name](self.duty, s, self.spec.generator(f"hidden/{name}")) for name, s in strengths.items()]
        return added([Addition(), *made])

    def run(self, strengths: Mapping[str, float], *, quiet: bool) -> NetworkRun:
        """The run with what is hidden; `quiet`: without what nobody knows."""
        unrest = unrest_of(self.spec.generator("unrest"), self.duty, self.plant)
        return NetworkRun(
            duty=self.duty, plant=self.plant, addition=self.addition(strengths), unrest=unrest * (not quiet)
        )


def drawn(spec: NetworkSpec) -> NetworkCase:
    """All that is random in a case but its sensor's noise."""
    plant = plant_of(spec.generator("plant"), spec.rough)
    return NetworkCase(spec, plant, duty(spec.generator("duty"), spec.days, spec.duty))


def sigma_of(spec: NetworkSpec) -> float:
    """degC: the sensor's noise with its rounding."""
    return float(np.hypot(spec.noise, quantum_of(spec) / np.sqrt(12)))


def quantum_of(spec: NetworkSpec) -> float:
    """degC that the recorder rounds to."""
    return 0.1 if spec.number % 2 else 0.01


def make(wanted: Sequence[NetworkSpec], out: Path) -> list[Label]:
    """Write the cases, which must last equally long, and return their labels."""
    cases = [drawn(spec) for spec in wanted]
    clean = _batched([case.run({}, quiet=True) for case in cases])
    # An effect is nearly proportional to its strength: one run at 1, one correction by what it was found to do, and the
    # ratio that the label tells is that of the strength in the end.
    flat = [(number, name) for number, case in enumerate(cases) for name in case.spec.hidden]
    at_one = _batched([cases[number].run({name: 1.0}, quiet=True) for number, name in flat])
    strengths: list[dict[str, float]] = [{} for _ in cases]
    for (number, name), course in zip(flat, at_one, strict=True):
        case = cases[number]
        found = visible(case.duty, clean[number], course) / sigma_of(case.spec)
        strengths[number][name] = float(np.clip(case.spec.ratio / max(found, 1e-9), 0.02, 30.0))
    alone = _batched([cases[number].run({name: strengths[number][name]}, quiet=True) for number, name in flat])
    ratios: list[dict[str, float]] = [{} for _ in cases]
    for (number, name), course in zip(flat, alone, strict=True):
        case = cases[number]
        ratios[number][name] = visible(case.duty, clean[number], course) / sigma_of(case.spec)
    # What has one effect, or none, was run already without what nobody knows.
    by_itself = {number: course for (number, _), course in zip(flat, alone, strict=True)}
    pairs = [number for number, each in enumerate(strengths) if len(each) > 1]
    both = dict(zip(pairs, _batched([cases[n].run(strengths[n], quiet=True) for n in pairs]), strict=True))
    quiet = [both.get(n, by_itself.get(n, course)) for n, course in enumerate(clean)]
    rough = _batched([case.run(each, quiet=False) for case, each in zip(cases, strengths, strict=True)])
    _learn_before([case for case in cases if case.spec.learned != "same"], out)
    labels = []
    for number, case in enumerate(cases):
        spec = case.spec
        held_out = slice(int(FITTED * clean[number].size), None)
        unrest = np.mean((rough[number][held_out] - quiet[number][held_out]) ** 2)
        folder = out / "cases" / spec.identifier
        write_log(folder / "traces.csv", case.duty, rough[number], spec, spec.generator("log"))
        model = folder / "model"
        if spec.learned == "same":
            learn(folder / "traces.csv", model, seed=0)
        seed = int(spec.generator("seed").integers(2**31))
        Label.write_config(folder, {"traces": "traces.csv", "seed": seed, "model": str(model.relative_to(out))})
        labels.append(
            Label(
                case=spec.identifier,
                spec=asdict(spec),
                strengths=strengths[number],
                ratios=ratios[number],
                outside=tuple(name for name in spec.hidden if name in OUTSIDE),
                baseline_gap=left_over(case.duty, clean[number]) / sigma_of(spec),
                sensor=sigma_of(spec),
                floor=float(np.sqrt(unrest + sigma_of(spec) ** 2)),
                machine=spec.identifier,
            )
        )
    return labels


def _batched(runs: Sequence[NetworkRun]) -> list[Array]:
    return [course for at in range(0, len(runs), BATCH) for course in courses(runs[at : at + BATCH])]


def _learn_before(cases: Sequence[NetworkCase], out: Path) -> None:
    """The given models, learned on three days of shifts before, of this machine or of a sister."""
    runs, streams = [], []
    for case in cases:
        rng = case.spec.generator("before")
        plant = sister(case.plant, rng) if case.spec.learned == "other" else case.plant
        before = duty(rng, 3, "shifts")
        unrest = unrest_of(rng, before, plant)
        runs.append(NetworkRun(duty=before, plant=plant, addition=Addition(), unrest=unrest))
        streams.append(rng)
    for case, run, course, rng in zip(cases, runs, _batched(runs), streams, strict=True):
        traces = out / "cases" / case.spec.identifier / "before.csv"
        recorded = replace(case.spec, period=min(max(case.spec.period, 5), LEARNABLE))
        write_log(traces, run.duty, course, recorded, rng)
        learn(traces, traces.parent / "model", seed=0)


def write_log(path: Path, duty: Duty, sensor: Array, spec: NetworkSpec, rng: np.random.Generator) -> None:
    """A wide CSV under the plant's names, a row every `period` seconds, the temperature noisy and rounded."""
    rows = np.arange(0, sensor.size, spec.period)
    quantum = quantum_of(spec)
    noisy = sensor[rows] + rng.normal(0.0, spec.noise, rows.size)
    columns = {
        "time": rows,
        "MarciaDecanter": duty.running[rows].astype(int),
        "MarciaPmpFango": duty.slurry[rows].astype(int),
        "Assorbimento": np.round(duty.current[rows], 1),
        "Coppia": np.round(duty.torque[rows], 2),
        "Differenziale": np.round(duty.differential[rows], 2),
        "LivelloVibrazioni": np.round(duty.vibration[rows] + np.abs(rng.normal(0.0, 0.05, rows.size)), 2),
        "VelocitaPompa": np.round(duty.speed[rows], 1),
        "TFango": np.round(duty.feed[rows] + rng.normal(0.0, 0.05, rows.size), 2),
        "TAmbiente": np.round(duty.ambient[rows] + rng.normal(0.0, 0.05, rows.size), 2),
        "TCuscinettiRiduttore": np.round(np.round(noisy / quantum) * quantum, 2),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("# SYNTHETIC: the thermal network of benchmarks/discrepancy/network\n")
        pd.DataFrame(columns).to_csv(file, index=False)
