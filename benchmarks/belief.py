"""Speed of the filter (samples per second) and of a forecast (ms), each against a limit measured in the same run.

The filter's limit is the same arithmetic, one Kalman step on (X, m) and its evidence, written out on local floats in
one loop: no value is built, nothing is looked up. The forecast's limit is drawing the random numbers that it needs,
with the same generator, and doing nothing with them. Best of the repetitions. `python -m benchmarks.belief [--json]`.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import expm1, log, pi
from time import perf_counter

import click
import numpy as np

from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input, Location
from sim.sha.belief import observe, on_event, start, with_inputs
from sim.sha.calibration import calibrate, issue, settle
from sim.sha.events import DECANTER
from sim.sha.forecast import forecast
from sim.sha.model import Model, Stay
from sim.sha.semi_markov import compile_chain, draw_paths
from sim.sha.trace import Event
from sim.sha.tracker import Tracker, compile_model

SAMPLES = 20_000
HORIZONS = (60.0, 300.0, 900.0)
SOJOURN = 10.0
SYMBOLS = ("W_ON", "W_OFF", "A_0", "A_1", "A_2", "A_3")
K, NOISE, SENSOR = 0.004, 0.05, 0.1


@dataclass(frozen=True)
class Filter:
    """Samples (or events, or input changes) per second; `of_limit` is the share of the limit's speed."""

    observe_per_s: float
    limit_per_s: float
    of_limit: float
    on_event_per_s: float
    with_inputs_per_s: float


@dataclass(frozen=True)
class Fan:
    """One forecast of three horizons up to 15 minutes with stays of 10 s on average, and one step of recalibration."""

    runs: int
    steps: int
    ms: float
    limit_ms: float
    times_limit: float
    calibration_ms: float


def plant() -> Tracker:
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
    sha = SHA("benchmark", locations, edges, SYMBOLS[1])
    return compile_model(Model(sha, DECANTER, "T", SENSOR, semi_markov=stays))


def best(work: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of `repeats`."""
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        work()
        times.append(perf_counter() - begin)
    return min(times)


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


def measure_filter(tracker: Tracker, repeats: int) -> Filter:
    readings = (40.0 + SENSOR * np.random.default_rng(1).standard_normal(SAMPLES)).tolist()
    taken, limit = best(lambda: filter_all(tracker, readings), repeats), best(lambda: bare_filter(readings), repeats)
    events, inputs = (
        best(lambda: event_all(tracker, SAMPLES), repeats),
        best(lambda: input_all(tracker, SAMPLES), repeats),
    )
    return Filter(SAMPLES / taken, SAMPLES / limit, limit / taken, SAMPLES / events, SAMPLES / inputs)


def measure_forecast(tracker: Tracker, runs: int, repeats: int) -> Fan:
    belief, rng = start(tracker, 0.0, 60.0), np.random.default_rng(1)
    told = forecast(tracker, belief, HORIZONS, rng, limit=80.0, runs=runs)
    paths = draw_paths(compile_chain(tracker.model), 1, 0.0, HORIZONS[-1], runs, np.random.default_rng(1))
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
    return Fan(runs, steps // runs, taken * 1e3, limit * 1e3, taken / limit, recalibrated * 1e3)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of lines.")
@click.option("--repeats", default=7, show_default=True, help="Repetitions, of which the best counts.")
def main(as_json: bool, repeats: int) -> None:
    """Measure filter and forecast."""
    tracker = plant()
    filtered = measure_filter(tracker, repeats)
    fans = [measure_forecast(tracker, runs, repeats) for runs in (256, 512)]
    if as_json:
        click.echo(json.dumps({"filter": asdict(filtered), "forecast": [asdict(fan) for fan in fans]}))
        return
    click.echo(
        f"filter    {filtered.observe_per_s:,.0f} samples/s, {filtered.of_limit:.0%} of bare arithmetic; "
        f"{filtered.on_event_per_s:,.0f} events/s, {filtered.with_inputs_per_s:,.0f} input changes/s"
    )
    for fan in fans:
        click.echo(
            f"forecast  {fan.runs} runs of {fan.steps} steps in {fan.ms:.1f} ms, {fan.times_limit:.1f} times the "
            f"drawing of its random numbers; recalibration {fan.calibration_ms:.3f} ms"
        )


if __name__ == "__main__":
    main()
