"""Cases of the recorder's plant: recorder, machine and model of its type, what acts, and what could be known of it."""

import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.discrepancy.bearings import family_of, learn
from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.actors import (
    ACTORS,
    BEGINNING,
    HALF_WAY,
    INSIDE,
    LATE,
    OUTSIDE,
    TWINS,
    WINDING,
    begin_at,
)
from benchmarks.discrepancy.recorder.baseline import FITTED, cut_cells, measure_left, measure_visible
from benchmarks.discrepancy.recorder.habits import HABITS, Habit, record, write_rows
from benchmarks.discrepancy.recorder.held_out import measure_removal
from benchmarks.discrepancy.recorder.ideal import Candidate, Removal, Verdict, judge_case
from benchmarks.discrepancy.recorder.masses import Guest, Machine, Task, integrate, join, move, unrest_of
from benchmarks.discrepancy.recorder.work import Work, work
from benchmarks.discrepancy.seal import Label
from benchmarks.discrepancy.visible import Family
from sim.artefacts.model_directory import MANIFEST

SETS: Mapping[str, int] = {
    "development": 104_003,
    "fresh": 115_013,
    "final": 126_011,
    "last": 137_029,
    "third": 148_039,
    "fourth": 159_053,
    "fifth": 171_007,
    "sixth": 183_011,
    "seventh": 194_017,
}
"""The entropy of each set's seeds. `final` and those after it were run once on frozen code and are known."""
STRATA = ("clean", "singles", "pairs", "late", "half-way", "outside")
TYPES, MOVED = 4, 0.08
"""Types of machine of each law in a set; how far off the sister may be that the type's model was learned on."""
RATIOS = (3.0, 1.5)
DAYS = (4, 5, 4, 6, 5)
BATCH_RUNS = 64
"""Runs that are integrated side by side."""
ROUNDS, NEAR = 4, 0.05
"""Rounds in which a strength is scaled, and the relative distance from the wanted ratio that ends them."""
DETAILS = 2
"""Draws of the free details of each rival that the ideal judge has."""
IDEAL = "ideal"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSpec:
    """One case before anything is drawn. `acts` are the actors, `effects` what a perfect answer names (those of no
    name stand there by their own). `share` (of the cycles) says where what acts begins; 0: at the beginning.

    `learned`: the model of the type was learned on this very machine (`before`) or on a sister (`other`).
    """

    set: str
    stratum: str
    number: int
    acts: tuple[str, ...]
    ratio: float
    law: str
    type: str
    habit: str
    learned: str
    rough: bool
    days: int
    share: float = 0.0
    missing: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """What a perfect answer names."""
        return self.acts

    def generator(self, purpose: str) -> np.random.Generator:
        """A generator of its own for each purpose."""
        label = f"recorder/{self.stratum}/{purpose}"
        return np.random.default_rng(np.random.SeedSequence([SETS[self.set], crc32(label.encode()), self.number]))

    @property
    def identifier(self) -> str:
        """A name that tells nothing."""
        return sha256(f"recorder/{SETS[self.set]}/{self.stratum}/{self.number}".encode()).hexdigest()[:12]


def specs(set_: str, stratum: str, numbers: Iterable[int]) -> list[RecorderSpec]:
    """The cases of a stratum. Raises ValueError for one that there is not."""
    if stratum not in STRATA:
        raise ValueError(f"there is no stratum {stratum!r}; there are {', '.join(STRATA)}")
    return [_spec(set_, stratum, number) for number in numbers]


def _spec(set_: str, stratum: str, n: int) -> RecorderSpec:
    draft = RecorderSpec(
        set=set_,
        stratum=stratum,
        number=n,
        acts=(),
        ratio=0.0,
        law="line" if n % 2 else "steps",
        type="",
        habit=tuple(HABITS)[(3 * n + n // len(HABITS) + STRATA.index(stratum)) % len(HABITS)],
        learned="before" if n % 3 == 0 else "other",
        rough=n % 4 != 3,
        days=DAYS[n % len(DAYS)],
    )
    first = int(draft.generator("type").integers(TYPES))
    if stratum == "clean":
        return replace(draft, type=f"{draft.law}-{first}")
    acts, ratio = _acts(draft), RATIOS[(n % len(INSIDE) + n // len(INSIDE)) % 2]
    laws = [ACTORS[name].law for name in acts if ACTORS[name].law != "any"]
    share = 0.0
    if stratum == "half-way":
        share, ratio = float(draft.generator("share").uniform(0.3, 0.5)), RATIOS[n // len(HALF_WAY) % 2]
    law = (*laws, draft.law)[0]
    ratio = 3.0 if stratum == "pairs" else ratio
    return replace(draft, acts=acts, ratio=ratio, law=law, type=f"{law}-{first}", share=share)


def _acts(draft: RecorderSpec) -> tuple[str, ...]:
    n, names = draft.number, tuple(INSIDE)
    match draft.stratum:
        case "singles":
            return (names[n % len(names)],)
        case "late":
            return (LATE,)
        case "half-way":
            return (HALF_WAY[n % len(HALF_WAY)],)
        case "outside":
            return (tuple(OUTSIDE)[n % len(OUTSIDE)],)
    rng = draft.generator("pair")
    while True:
        first, second = sorted(rng.choice(names, 2, replace=False).tolist())
        laws = {INSIDE[first].law, INSIDE[second].law} - {"any"}
        if frozenset((first, second)) not in TWINS and len(laws) < 2:
            return first, second


def machine_of_type(set_: str, name: str) -> Machine:
    """The machine that a type's model is learned on: time constants of 18 to 32 min running, 45 to 80 at rest."""
    law, number = name.split("-")
    label = f"recorder/type/{law}"
    rng = np.random.default_rng(np.random.SeedSequence([SETS[set_], crc32(label.encode()), int(number)]))
    idle = rng.uniform(17.0, 25.0)
    rises = np.concatenate([[0.0], np.cumsum(rng.uniform((6.0, 6.0, 5.0), (13.0, 12.0, 11.0)))])
    heats = [float(idle + rise) for rise in rises] if law == "steps" else [float(idle)] * 4
    return Machine(
        resting=1.0 / rng.uniform(2700.0, 4800.0),
        running=1.0 / rng.uniform(1080.0, 1900.0),
        hall=rng.uniform(15.0, 21.0),
        heats=(heats[0], heats[1], heats[2], heats[3]),
        slope=0.0 if law == "steps" else rng.uniform(0.07, 0.12),
        race=rng.uniform(1.5, 4.0),
        sensor=rng.uniform(1.5, 4.0),
        rough=0.0,
        memory=400.0,
        scatter=0.0,
    )


def restless(machine: Machine, rng: np.random.Generator, rough: bool) -> Machine:
    """The machine with heat that wanders, by half to one and a half per cent where it is rough, else by a fifth."""
    size = 1.0 if rough else 0.2
    return replace(
        machine,
        rough=size * rng.uniform(0.005, 0.015),
        memory=rng.uniform(200.0, 900.0),
        scatter=size * rng.uniform(0.004, 0.010),
    )


@dataclass(frozen=True, slots=True)
class RecorderCase:
    """A case with what was drawn for it, except the strengths."""

    spec: RecorderSpec
    machine: Machine
    work: Work

    @property
    def began(self) -> int:
        """The row at which what acts begins, in a rest; 0 when it always did."""
        if not self.spec.share:
            return 0
        starts = self.work.starts
        first = starts[max(int(self.spec.share * len(starts)), 1)]
        stopped = np.flatnonzero(self.work.running[:first] > 0)[-1] + 1
        return int(0.5 * (stopped + first))

    def guest(self, strengths: Mapping[str, float]) -> Guest:
        """What acts at these strengths; its details do not change with them."""
        made = [self.actor(name, s, self.spec.generator(f"acts/{name}")) for name, s in strengths.items()]
        if self.began:
            at = (np.arange(self.work.running.size) >= self.began).astype(float)
            made = [begin_at(one, at) for one in made]
        return join([Guest(), *made])

    def actor(self, name: str, strength: float, rng: np.random.Generator) -> Guest:
        """One actor."""
        return ACTORS[name].make(self.work, self.machine, strength, rng)

    def task(self, guest: Guest, *, quiet: bool) -> Task:
        """The run with a guest; `quiet`: without what nobody knows."""
        unrest = unrest_of(self.spec.generator("unrest"), self.work, self.machine)
        return Task(work=self.work, machine=self.machine, guest=guest, unrest=unrest * (not quiet))


def draw_case(spec: RecorderSpec) -> RecorderCase:
    """All that is random in a case but its recorder."""
    rng = spec.generator("machine")
    machine = machine_of_type(spec.set, spec.type)
    if spec.learned == "other":
        machine = move(machine, rng, MOVED)
    return RecorderCase(spec, restless(machine, rng, spec.rough), work(spec.generator("work"), spec.days))


def integrate_all(tasks: Sequence[Task]) -> list[Array]:
    """`integrate` in batches."""
    return [course for at in range(0, len(tasks), BATCH_RUNS) for course in integrate(tasks[at : at + BATCH_RUNS])]


def learn_type(set_: str, name: str, out: Path) -> Family:
    """What a type's model may adjust; it is learned, on four days of its own with tidy rows, unless it is there."""
    folder = out / "models" / f"{set_}-{name}"
    if not (folder / MANIFEST).exists():
        rng = np.random.default_rng(np.random.SeedSequence([SETS[set_], crc32(f"recorder/before/{name}".encode())]))
        machine, before = restless(machine_of_type(set_, name), rng, True), work(rng, 4)
        task = Task(work=before, machine=machine, guest=Guest(), unrest=unrest_of(rng, before, machine))
        habit = Habit()
        traces = out / "models" / f"{set_}-{name}.csv"
        write_rows(traces, before, record(rng, integrate([task])[0], habit), habit, rng)
        learn(traces, folder, seed=0)
    return family_of(folder)


def suit_type(spec: RecorderSpec, out: Path) -> tuple[RecorderSpec, Family]:
    """The case on the first type, from its own on, whose model lacks what acts and nothing else: one that follows the
    load where the heat does, and one that does not where following it is what is missing. Else on its own type."""
    law, first = spec.type.split("-")
    for turn in range(TYPES):
        name = f"{law}-{(int(first) + turn) % TYPES}"
        family = learn_type(spec.set, name, out)
        follows = min(family.gains[2:]) >= 0
        if (law == "line" and not follows) or ("current-heating" in spec.acts and max(family.gains) >= 0):
            continue
        return replace(spec, type=name), family
    return spec, learn_type(spec.set, spec.type, out)


def make(wanted: Sequence[RecorderSpec], out: Path) -> tuple[list[Label], dict[str, Verdict]]:
    """Write the cases, which must last equally long; their labels, and what an ideal judge says of each."""
    suited = [suit_type(spec, out) for spec in wanted]
    cases = [draw_case(spec) for spec, _ in suited]
    cells = [cut_cells(case.work, family) for case, (_, family) in zip(cases, suited, strict=True)]
    clean = integrate_all([case.task(Guest(), quiet=True) for case in cases])

    def ratio(number: int, course: Array) -> float:
        sigma = HABITS[cases[number].spec.habit].sigma
        return measure_visible(cells[number], clean[number], course) / sigma

    strengths: list[dict[str, float]] = [{} for _ in cases]
    ratios: list[dict[str, float]] = [{} for _ in cases]
    alone: dict[tuple[int, str], Array] = {}
    open_ = {(number, name): 1.0 for number, case in enumerate(cases) for name in case.spec.acts}
    for _ in range(ROUNDS):
        tasks = [cases[n].task(cases[n].guest({name: s}), quiet=True) for (n, name), s in open_.items()]
        found = dict(zip(open_, integrate_all(tasks), strict=True))
        for (n, name), course in found.items():
            wanted_ratio, is_ = cases[n].spec.ratio, ratio(n, course)
            before = ratios[n].get(name, np.inf)
            if abs(np.log(max(is_, 1e-9) / wanted_ratio)) <= abs(np.log(before / wanted_ratio)):
                strengths[n][name], ratios[n][name], alone[n, name] = open_[n, name], is_, course
            ahead = strengths[n][name] * np.clip(wanted_ratio / max(ratios[n][name], 1e-9), 0.1, 10.0)
            open_[n, name] = float(np.clip(ahead, 0.01, ACTORS[name].most))
        open_ = {
            (n, name): s
            for (n, name), s in open_.items()
            if abs(ratios[n][name] / cases[n].spec.ratio - 1.0) > NEAR and s != strengths[n][name]
        }
        if not open_:
            break
    guests = [case.guest(each) for case, each in zip(cases, strengths, strict=True)]
    quiet = integrate_all([case.task(guest, quiet=True) for case, guest in zip(cases, guests, strict=True)])
    courses = integrate_all([case.task(guest, quiet=False) for case, guest in zip(cases, guests, strict=True)])
    rivals = _rivals(cases, clean)
    labels, verdicts = [], {}
    for n, case in enumerate(cases):
        spec, habit = case.spec, HABITS[case.spec.habit]
        folder = out / "cases" / spec.identifier
        rng = spec.generator("recorder")
        rows = record(rng, courses[n], habit)
        traces = "traces" if habit.daily else "traces.csv"
        write_rows(folder / traces, case.work, rows, habit, rng)
        model = f"models/{spec.set}-{spec.type}"
        Label.write_config(
            folder, {"traces": traces, "seed": int(spec.generator("seed").integers(2**31)), "model": model}
        )
        held_out = slice(int(FITTED * clean[n].size), None)
        unrest = np.mean((courses[n][held_out] - quiet[n][held_out]) ** 2)
        labels.append(
            Label(
                case=spec.identifier,
                spec=asdict(spec) | {"effects": spec.effects, "began": _stated_start(case)},
                strengths=strengths[n],
                ratios=ratios[n],
                outside=tuple(name for name in spec.acts if name in OUTSIDE or name in BEGINNING),
                baseline_gap=measure_left(cells[n], clean[n]) / habit.sigma,
                sensor=habit.sigma,
                floor=float(np.sqrt(unrest + habit.sigma**2)),
                machine=spec.type,
            )
        )
        true = [Candidate(name=name, difference=alone[n, name] - clean[n], signed=_signed(name)) for name in spec.acts]
        verdict = judge_case(
            cells[n],
            case.machine,
            habit,
            rows,
            course=courses[n],
            quiet=quiet[n],
            clean=clean[n],
            true=true,
            rivals=rivals[n],
        )
        removal = measure_removal(
            cut_cells(case.work, cells[n].family, 1.0),
            case.machine,
            habit,
            rows,
            course=courses[n],
            quiet=quiet[n],
            clean=clean[n],
            true=true,
        )
        verdicts[spec.identifier] = replace(verdict, removal=removal)
    return labels, verdicts


def _signed(name: str) -> bool:
    return ACTORS[name].signed


def _stated_start(case: RecorderCase) -> dict[str, Any] | None:
    """When what acts began (s), the cycles before and after, and when all begin; None when it always did."""
    if not case.began:
        return None
    starts = [float(case.work.seconds[one]) for one in case.work.starts]
    before = int(np.searchsorted(case.work.starts, case.began))
    return {
        "time": float(case.work.seconds[case.began]), "before": before, "after": len(starts) - before, "starts": starts,
    }  # fmt: skip


def _rivals(cases: Sequence[RecorderCase], clean: Sequence[Array]) -> list[list[Candidate]]:
    """For each case what each form that a name stands for would do to its machine, with details of its own, at
    strength 1."""
    forms = {**INSIDE, **WINDING}
    named = [
        (number, name, case.actor(name, 1.0, case.spec.generator(f"rival/{name}/{draw}")))
        for number, case in enumerate(cases)
        for name, actor in forms.items()
        if actor.law in ("any", case.spec.law)
        for draw in range(DETAILS)
    ]
    courses = integrate_all([cases[number].task(guest, quiet=True) for number, _, guest in named])
    found: list[list[Candidate]] = [[] for _ in cases]
    for (number, name, _), course in zip(named, courses, strict=True):
        found[number].append(Candidate(name=name, difference=course - clean[number], signed=_signed(name)))
    return found


def write_verdicts(out: Path, batch: str, verdicts: Mapping[str, Verdict]) -> None:
    """Pack what the ideal judge says beside the sealed labels; the file appears whole or not at all."""
    folder = out / IDEAL
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps({case: asdict(one) for case, one in verdicts.items()}, sort_keys=True).encode()
    draft = folder / f".{batch}.draft"
    draft.write_bytes(gzip.compress(content, mtime=0))
    draft.replace(folder / f"{batch}.json.gz")


def read_verdicts(out: Path) -> dict[str, Verdict]:
    """What the ideal judge says, by case."""
    return {
        case: Verdict(**plain | {"removal": Removal(**plain["removal"]) if plain.get("removal") else None})
        for path in sorted((out / IDEAL).glob("*.json.gz"))
        for case, plain in json.loads(gzip.decompress(path.read_bytes())).items()
    }
