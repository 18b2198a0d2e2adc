"""The pool of bearings that the cases are drawn from, each with a model learned on days before anything happened."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.discrepancy.log import written_log
from benchmarks.discrepancy.operation import OFF, STAGES, operate
from benchmarks.discrepancy.plant import Bearing, Parts, Roughness, disturbance, run
from benchmarks.discrepancy.strata import Spec, generator
from benchmarks.discrepancy.visible import Family
from sim.artefacts.model_directory import MANIFEST

POOL = 6
"""Bearings of each kind (stages or linear, rough or smooth) in a set."""
MOVED = 0.08
MIDDLES = (0.0, 50.0, 150.0, 250.0, 350.0)


@dataclass(frozen=True, slots=True)
class Machine:
    """A bearing and how rough it is; `name` is its model's directory."""

    name: str
    bearing: Bearing
    rough: Roughness


def machine_of(spec: Spec) -> Machine:
    """The machine of a case, drawn from its set's pool."""
    return machine(spec.set, spec.base, spec.rough, int(spec.generator("machine").integers(POOL)))


def machine(set_: str, base: str, rough: bool, number: int) -> Machine:
    """A machine of the pool: time constants of 18 to 30 min running, 50 to 80 min at rest, 35 to 80 degC."""
    name = f"{base}-{'rough' if rough else 'smooth'}-{number}"
    rng = generator(set_, f"machine/{base}/{rough}", number)
    loss = 1.0 / rng.uniform(1100, 1800)
    hall = rng.uniform(16.0, 19.0)
    idle = rng.uniform(19.0, 27.0)
    if base == "linear":
        slope = rng.uniform(0.07, 0.13)
        above = [0.0, *(idle + slope * (middle - 50.0) for middle in MIDDLES[1:])]
    else:
        slope = 0.0
        above = [0.0, *(idle + np.cumsum([0.0, *rng.uniform((7, 6, 5), (14, 12, 11))]))]
    bearing = Bearing(
        hall, tuple(float(loss * value) for value in above), 1.0 / rng.uniform(3000, 4800), loss, slope * loss
    )
    return Machine(name, bearing, _roughness(rng) if rough else SMOOTH)


SMOOTH = Roughness(coloured=0.0, memory=400.0, scatter=0.0, noise=0.06, quantum=0.01)


def _roughness(rng: np.random.Generator) -> Roughness:
    """Heat that wanders by about a percent for some minutes, and a percent of scatter from start to start."""
    return Roughness(
        coloured=rng.uniform(0.005, 0.015),
        memory=rng.uniform(200, 800),
        scatter=rng.uniform(0.004, 0.012),
        noise=rng.uniform(0.05, 0.1),
        quantum=0.1,
    )


def moved(bearing: Bearing, rng: np.random.Generator) -> Bearing:
    """The bearing some weeks later: each constant moved by up to 8 %, as a model of its kind can follow."""
    by = 1.0 + rng.uniform(-MOVED, MOVED, STAGES + 3)
    stages = tuple(heat * by[0 if bearing.slope else stage] for stage, heat in enumerate(bearing.heat))
    return replace(
        bearing,
        heat=stages,
        slope=bearing.slope * by[0],
        loss_rest=bearing.loss_rest * by[STAGES],
        loss_running=bearing.loss_running * by[STAGES + 1],
        hall=bearing.hall + 0.5 * (by[STAGES + 2] - 1.0) / MOVED,
    )


def learn_before(set_: str, one: Machine, folder: Path, days: int = 3) -> Path:
    """The model directory of a machine, learned on days of its own before the cases, unless it is there already."""
    out = folder / one.name
    if not (out / MANIFEST).exists():
        rng = generator(set_, f"before/{one.name}", 0)
        operation = operate(rng, days)
        course = run([(operation, one.bearing, disturbance(rng, operation, one.bearing, one.rough), Parts())])[0]
        traces = folder / "before" / f"{one.name}.csv"
        written_log(traces, operation, course, one.rough, Spec(set_, "before", 0), rng)
        learn(traces, out, seed=0)
    return out


def learn(traces: Path, out: Path, seed: int) -> None:
    """`decanter model learn --method bins --traces TRACES --out OUT`, by its own functions, without bands."""
    from gateway.lab.learning.learn import learn_traces, write
    from gateway.lab.traces.load import load

    loaded, column_map = load([str(traces)], "decanter")
    write(out, learn_traces(loaded, column_map, name="decanter", seed=seed, report=None, bands=False))


def family_of(model: Path) -> Family:
    """What a model in a directory may adjust: which of its stages share a rate or a gain."""
    from sim.artefacts.model_directory import read_model_directory

    places = read_model_directory(model).sha.by_name
    names = ("OFF/0-100", "ON/0-100", "ON/100-200", "ON/200-300", "ON/300+")
    flows = [places[name].flow for name in names]
    rates: dict[float, int] = {}
    gains: dict[float, int] = {}
    return Family(
        tuple(rates.setdefault(flow.params.get("k", 0.0), len(rates)) for flow in flows),
        tuple(gains.setdefault(flow.inputs[0].gain, len(gains)) if flow.inputs else -1 for flow in flows),
    )


def suits(family: Family, bearing: Bearing) -> bool:
    """Whether a model of the family can say all that a clean bearing does (the current of idling hardly moves)."""
    apart = family.rates[OFF] not in family.rates[1:]
    follows = all(gain >= 0 for gain in family.gains[2:])
    return apart and (follows or not bearing.slope)
