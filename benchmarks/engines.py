"""The engines of plain models beside those of effects, both on plain models: largest difference, ratio of their times.

A plain model goes through an engine of effects when it has an effect that does nothing, a sensor step of 0 degC. Times
are of the processor, the median of the repetitions, each of which times one engine right after the other. Where runs
are drawn, the engines draw in orders of their own: then the difference is that of the mean ends, in standard errors.
The rows "limited" and "logarithmic" have a maximum rate and a drift that falls as 1/time: what the plain engines take
in closed form. Words have no pair: one replay does both.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import sqrt
from statistics import median
from time import process_time

import click
import numpy as np

from benchmarks import belief as belief_benchmark
from benchmarks.figures import Figure, give
from benchmarks.simulation import EVENTS, ROWS, SECONDS, SYMBOLS, plant
from benchmarks.smc import question, speed_start
from sim.engine.belief import Belief, Tracker, observe, on_event, start, with_inputs
from sim.engine.moment_equations import moments
from sim.engine.schedules import Schedule, schedule
from sim.engine.simulation import simulate
from sim.engine.tracker import compile_model
from sim.forecast.fan import Forecast, forecast
from sim.lab.checking.smc.answers import prepare_question
from sim.lab.checking.smc.chunks import LARGEST
from sim.lab.checking.smc.runs import sampler
from sim.sha.automaton import Distribution, Effect, Flow
from sim.sha.model import Model
from sim.sha.trace import Array, Event

NOTHING = (Effect("sensor-offset-step", {"size": 0.0, "at": 0.0}),)
SAMPLES, RUNS, FORECAST_RUNS = 400, 4096, 256
LEAST = 0.02
"""Seconds of processor time that one measurement takes at least."""


def with_nothing(model: Model) -> Model:
    """The model with an effect that does nothing."""
    return replace(model, sha=replace(model.sha, effects=NOTHING))


def timed(plain: Callable[[], object], effects: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Seconds of processor time of a call of each, medians; a quick one is called several times in a row."""
    taken: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for work, times in zip((plain, effects), taken, strict=True):
            begin, calls = process_time(), 0
            while calls == 0 or process_time() - begin < LEAST:
                work()
                calls += 1
            times.append((process_time() - begin) / calls)
    return median(taken[0]), median(taken[1])


def pair(
    name: str, plain: Callable[[], object], effects: Callable[[], object], difference: float, unit: str, repeats: int
) -> list[Figure]:
    """The two figures of a pair: both are called once beforehand, so that neither pays for what is made once."""
    plain(), effects()
    own, other = timed(plain, effects, repeats)
    return [
        Figure(f"{name}: effects", 1e3 * other, "ms", "plain", 1e3 * own),
        Figure(f"{name}: largest difference", difference, unit),
    ]


# ---------------------------------------------------------------- the filter


def followed(tracker: Tracker, work: Callable[[Tracker, Belief, int], Belief], count: int) -> Belief:
    """The belief after `count` steps at 1 Hz from a reading of 40 degC."""
    belief = start(tracker, 0.0, 40.0)
    for second in range(1, count + 1):
        belief = work(tracker, belief, second)
    return belief


def reading(tracker: Tracker, belief: Belief, second: int) -> Belief:
    return observe(tracker, belief, float(second), 40.0 + 0.1 * (second % 5))


def event(tracker: Tracker, belief: Belief, second: int) -> Belief:
    return on_event(tracker, belief, Event(float(second), SYMBOLS[second % len(SYMBOLS)]))


def change(tracker: Tracker, belief: Belief, second: int) -> Belief:
    return with_inputs(tracker, belief, float(second), {"Assorbimento": 50.0 + second % 7})


def everything(tracker: Tracker, belief: Belief, second: int) -> Belief:
    belief = event(tracker, belief, second) if second % 10 == 0 else belief
    return reading(tracker, change(tracker, belief, second), second)


def filters(repeats: int) -> list[Figure]:
    tracker = belief_benchmark.plant()
    other = compile_model(with_nothing(tracker.model))
    names = ("x", "m", "xx", "xm", "mm", "evidence")
    found = []
    for name, work in (("readings", reading), ("events", event), ("inputs", change), ("all three", everything)):
        a, b = (followed(each, work, SAMPLES) for each in (tracker, other))
        difference = max(abs(getattr(a, part) - getattr(b, part)) for part in names)
        runs = (partial(followed, each, work, SAMPLES) for each in (tracker, other))
        found += pair(f"filter, {SAMPLES} {name}", *runs, difference, "degC", repeats)
    return found


# ---------------------------------------------------------------- along a schedule


def schedules() -> dict[str, tuple[Schedule, Schedule]]:
    """The cases of `benchmarks.simulation` and two more flows, each without effects and with the one of nothing."""
    rng = np.random.default_rng(1)
    clock = np.linspace(0.0, SECONDS, ROWS)
    rows = np.sort(rng.choice(np.arange(1, ROWS), EVENTS, replace=False))
    events = [Event(float(clock[row]), SYMBOLS[rng.integers(len(SYMBOLS))]) for row in rows]
    slow = Flow("logarithmic", {"t0": 10.0, "noise": 0.05})
    falling = tuple(
        replace(place, flow=slow, distribution=Distribution("normal", {"mu": 0.3, "sigma": 0.1}))
        for place in plant().locations
    )
    kinds = {
        "events": (plant(), clock[rows]),
        "dense": (plant(), clock),
        "limited": (replace(plant(), max_rate=0.05), clock),
        "logarithmic": (replace(plant(), locations=falling), clock),
    }
    return {
        name: (
            schedule(sha, events, outputs, start=0.0),
            schedule(replace(sha, effects=NOTHING), events, outputs, start=0.0),
        )
        for name, (sha, outputs) in kinds.items()
    }


def along_schedules(repeats: int) -> list[Figure]:
    found = []
    for name, (plain, other) in schedules().items():
        a, b = moments(plain, 18.2), moments(other, 18.2)
        difference = max(np.abs(a.mean - b.mean).max(), np.abs(a.variance - b.variance).max())
        works = (partial(moments, each, 18.2) for each in (plain, other))
        found += pair(f"mean and variance, {name}", *works, float(difference), "degC", repeats)
    for name, (plain, other) in schedules().items():
        ends = [simulate(each, 18.2, RUNS, np.random.default_rng(1)).temperatures[:, -1] for each in (plain, other)]
        works = (partial(drawn, each) for each in (plain, other))
        found += pair(f"{RUNS} runs, {name}", *works, apart(*ends), "sigma", repeats)
    return found


def drawn(steps: Schedule) -> None:
    simulate(steps, 18.2, RUNS, np.random.default_rng(1))


def apart(a: Array, b: Array) -> float:
    """How far the means of two samples are apart, in standard errors."""
    return float(abs(a.mean() - b.mean()) / sqrt(a.var() / a.size + b.var() / b.size))


# ---------------------------------------------------------------- along paths


def forecasts(repeats: int) -> list[Figure]:
    tracker = belief_benchmark.plant()
    other = compile_model(with_nothing(tracker.model))

    def made(each: Tracker, seed: int = 1, runs: int = FORECAST_RUNS) -> Forecast:
        begun = start(each, 0.0, 60.0)
        return forecast(each, begun, belief_benchmark.HORIZONS, np.random.default_rng(seed), limit=80.0, runs=runs)

    a, b = (made(each, seed, 4096) for seed, each in enumerate((tracker, other)))
    difference = float(np.abs(a.quantiles[2] - b.quantiles[2]).max())
    works = (partial(made, each) for each in (tracker, other))
    return pair(f"forecast, {FORECAST_RUNS} runs", *works, difference, "degC", repeats)


def checked(repeats: int) -> list[Figure]:
    found = []
    for name, k, low, limit in (("events", 0.004, SECONDS, 32.0), ("dense", 0.045, 0.0, 45.0)):
        begun = speed_start(k)
        tracker = compile_model(with_nothing(begun.world.tracker.model))
        samplers = []
        for world in (begun.world, replace(begun.world, tracker=tracker)):
            own = replace(begun, world=world)
            samplers.append(sampler(world, (prepare_question(question(limit, SECONDS, low), own),), 1))
        # Past the small chunks; from then on each call draws one chunk of the largest size.
        verdicts = [each.draw(2 * LARGEST).astype(float) for each in samplers]
        works = (partial(each.draw, LARGEST) for each in samplers)
        found += pair(f"checking, {name}, {LARGEST} runs", *works, apart(*verdicts), "sigma", repeats)
    return found


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="3 repetitions.")
@click.option("--repeats", default=7, show_default=True, type=click.IntRange(1), help="Repetitions; the median counts.")
def main(as_json: bool, quick: bool, repeats: int) -> None:
    times = 3 if quick else repeats
    parts: Sequence[Callable[[int], list[Figure]]] = (filters, along_schedules, forecasts, checked)
    give("engines", [figure for part in parts for figure in part(times)], as_json=as_json)


if __name__ == "__main__":
    main()
