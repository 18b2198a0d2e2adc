"""Speed of the filter (samples per second) and of a forecast (ms), each against a limit measured in the same run.

The filter's limit is the same arithmetic, one Kalman step on (X, m) and its evidence, written out on local floats in
one loop: no value is built, nothing is looked up. The forecast's limit is drawing the random numbers that it needs,
with the same generator, and doing nothing with them. Best of the repetitions.
"""

from math import expm1, log, pi

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from sim.engine.belief import observe, on_event, start, with_inputs
from sim.engine.tracker import Tracker, compile_model
from sim.forecast.calibration import calibrate, issue, settle
from sim.forecast.fan import forecast
from sim.sha.automaton import SHA, Distribution, Edge, Effect, Flow, Input, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model, Stay
from sim.sha.semi_markov import compile_chain, draw_paths
from sim.sha.trace import Event

SAMPLES = 20_000
HORIZONS = (60.0, 300.0, 900.0)
SOJOURN = 10.0
SYMBOLS = ("W_ON", "W_OFF", "A_0", "A_1", "A_2", "A_3")
K, NOISE, SENSOR = 0.004, 0.05, 0.1


def plant(*effects: Effect) -> Tracker:
    """Six locations, each driven by the current, all of them left after 10 s on average."""
    locations = tuple(
        Location(
            symbol,
            Flow("driven", {"k": K, "noise": NOISE}, (Input("Assorbimento", 0.02, 50.0),)),
            Distribution("normal", {"mu": 40.0 + 5.0 * place, "sigma": 1.0}),
        )
        for place, symbol in enumerate(SYMBOLS)
    )
    edges = tuple(Edge(source, symbol, symbol) for source in SYMBOLS for symbol in SYMBOLS if source != symbol)
    stays = {
        source: Stay(
            Distribution("weibull", {"shape": 1.2, "scale": SOJOURN}),
            {symbol: 0.2 for symbol in SYMBOLS if symbol != source},
            {"Assorbimento": (50.0, 10.0)},
        )
        for source in SYMBOLS
    }
    sha = SHA("benchmark", locations, edges, SYMBOLS[1], effects=effects)
    return compile_model(Model(sha, DECANTER, "T", SENSOR, semi_markov=stays))


def filter_all(tracker: Tracker, readings: list[float]) -> None:
    belief = start(tracker, 0.0, 40.0)
    for second, reading in enumerate(readings, 1):
        belief = observe(tracker, belief, float(second), reading)


def bare_filter(readings: list[float]) -> float:
    """The filter's limit: see the module."""
    x, m, xx, xm, mm, before, evidence = 40.0, 45.0, SENSOR**2, 0.0, 1.0, 0.0, 0.0
    settled, sensor = NOISE**2 / (2.0 * K), SENSOR**2
    for second, reading in enumerate(readings, 1):
        lost = expm1(-K * (second - before))
        decay, pull, variance = 1.0 + lost, -lost, -settled * lost * (2.0 + lost)
        x = decay * x + pull * m
        xx = decay * decay * xx + 2.0 * decay * pull * xm + pull * pull * mm + variance
        xm = decay * xm + pull * mm
        total = xx + sensor
        value = reading - x
        square = value * value / total
        x += xx / total * value
        m += xm / total * value
        mm = max(mm - xm * xm / total, 0.0)
        xx, xm = xx * sensor / total, xm * sensor / total
        evidence -= 0.5 * (log(2.0 * pi * total) + square)
        before = second
    return evidence


def event_all(tracker: Tracker, count: int) -> None:
    belief = start(tracker, 0.0, 40.0)
    for second in range(count):
        belief = on_event(tracker, belief, Event(float(second), SYMBOLS[second % len(SYMBOLS)]))


def input_all(tracker: Tracker, count: int) -> None:
    belief = start(tracker, 0.0, 40.0)
    for second in range(count):
        belief = with_inputs(tracker, belief, float(second), {"Assorbimento": 50.0 + second % 7})


def measure_filter(tracker: Tracker, repeats: int) -> list[Figure]:
    readings = (40.0 + SENSOR * np.random.default_rng(1).standard_normal(SAMPLES)).tolist()
    taken, limit = best(lambda: filter_all(tracker, readings), repeats), best(lambda: bare_filter(readings), repeats)
    events, inputs = (
        best(lambda: event_all(tracker, SAMPLES), repeats),
        best(lambda: input_all(tracker, SAMPLES), repeats),
    )
    bare = ("bare arithmetic of a sample", SAMPLES / limit)
    return [
        Figure("belief, readings", SAMPLES / taken, "samples/s", *bare),
        Figure("belief, events", SAMPLES / events, "events/s", *bare),
        Figure("belief, changes of inputs", SAMPLES / inputs, "changes/s", *bare),
    ]


def measure_random(plain: Tracker, repeats: int) -> list[Figure]:
    """The same with heat that has a memory and a machine's own offset, against the plant without them."""
    effects = (Effect("heat-disturbance", {"sigma": 0.005, "memory": 400.0}), Effect("machine-offset", {"sigma": 3.0}))
    tracker, size = plant(*effects), SAMPLES // 10
    readings = (40.0 + SENSOR * np.random.default_rng(1).standard_normal(size)).tolist()
    filtered = [best(lambda one=one: filter_all(one, readings), repeats) for one in (tracker, plain)]
    foreseen = []
    for one in (tracker, plain):
        belief, rng = start(one, 0.0, 60.0), np.random.default_rng(1)
        foreseen.append(
            best(lambda: forecast(one, belief, HORIZONS, rng, limit=80.0, runs=256), repeats)  # noqa: B023
        )
    return [
        Figure("belief with memory, readings", size / filtered[0], "samples/s", "without", size / filtered[1]),
        Figure("forecast with memory, 256 runs", 1e3 * foreseen[0], "ms", "without", 1e3 * foreseen[1]),
    ]


def measure_forecast(tracker: Tracker, runs: int, repeats: int) -> list[Figure]:
    """One forecast of three horizons up to 15 minutes, with stays of 10 s on average, and a step of recalibration."""
    belief, rng = start(tracker, 0.0, 60.0), np.random.default_rng(1)
    told = forecast(tracker, belief, HORIZONS, rng, limit=80.0, runs=runs)
    paths = draw_paths(
        compile_chain(tracker.model), 1, age=0.0, horizon=HORIZONS[-1], runs=runs, rng=np.random.default_rng(1)
    )
    stays = paths.location.size
    steps = stays + 65 * runs

    def draw_all() -> None:
        """Each stay its length, next place and target, each step its noise."""
        rng.standard_exponential(stays)
        rng.random(stays)
        rng.standard_normal(stays + steps)

    taken = best(lambda: forecast(tracker, belief, HORIZONS, rng, limit=80.0, runs=runs), repeats)
    limit = best(draw_all, repeats)
    state = calibrate(dict.fromkeys(HORIZONS, 1.0))
    recalibrated = best(lambda: issue(settle(state, 0.0, 60.0), told), repeats)
    what = f"forecast, {runs} runs of {steps // runs} steps"
    return [
        Figure(what, 1e3 * taken, "ms", "drawing its random numbers", 1e3 * limit),
        Figure("  its recalibration", 1e3 * recalibrated, "ms"),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="2 repetitions.")
@click.option("--repeats", default=7, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
def main(as_json: bool, quick: bool, repeats: int) -> None:
    times, tracker = 2 if quick else repeats, plant()
    fans = [figure for runs in (256, 512) for figure in measure_forecast(tracker, runs, times)]
    figures = [*measure_filter(tracker, times), *fans, *measure_random(tracker, times)]
    give("belief and forecast", figures, as_json=as_json)


if __name__ == "__main__":
    main()
