"""Open-loop simulation of measured traces for the command line: errors, stochastic band, picture."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim.engine.open_loop import Start, errors, measured, open_loop, open_loop_schedule, start_law
from sim.engine.schedule import Policy
from sim.engine.simulate import simulate
from sim.forecast.review import beyond, standardised
from sim.sha.model import Model
from sim.sha.trace import Array, Trace

BAND = (0.05, 0.95)


def simulate_traces(
    model: Model,
    traces: Sequence[Trace],
    *,
    runs: int,
    policy: Policy,
    start: Start,
    seed: int,
    picture: Path | None,
    report: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """One row a trace; a trace that fails has `error` and does not stop the others."""
    rows = []
    for index, trace in enumerate(traces):
        report(trace.name, index / len(traces))
        wanted = picture if index == 0 else None
        try:
            rows.append(_simulate_one(model, trace, runs, policy, start, np.random.default_rng([seed, index]), wanted))
        except ValueError as error:
            rows.append({"trace": trace.name, "error": str(error)})
    return rows


def _simulate_one(
    model: Model, trace: Trace, runs: int, policy: Policy, start: Start, rng: np.random.Generator, picture: Path | None
) -> dict[str, Any]:
    mean = open_loop(model, trace, policy, start)
    wrong = errors(mean, trace, model.temperature)
    steps = open_loop_schedule(model, trace, policy)
    sampled = simulate(steps, start_law(model, trace, start), runs, rng)
    noisy = sampled.temperatures + model.sensor_sigma * rng.normal(size=sampled.temperatures.shape)
    low, high = np.quantile(noisy, BAND, axis=0)
    times, values = measured(trace, model.temperature)
    place = np.searchsorted(sampled.times, times)
    inside = (values >= low[place]) & (values <= high[place])
    outside = beyond(*standardised(mean, trace, model))
    if picture is not None:
        _draw(model, trace, (mean.times, mean.mean), (sampled.times, low, high), picture)
    return {
        "trace": trace.name,
        "synthetic": trace.synthetic,
        "events": len(trace.events),
        "rmse": wrong.at_samples.rmse,
        "mae": wrong.at_samples.mae,
        "rmse at events": wrong.at_events.rmse,
        "mae at events": wrong.at_events.mae,
        "final": wrong.final,
        "final %": wrong.final_percent,
        "coverage 90 %": float(np.mean(inside)),
        "clamps": mean.clamps,
        "limited": mean.limited,
        "beyond 3 sigma": outside.share,
        "longest run beyond 3 sigma": outside.run,
        "review": outside.review,
        "flags": ", ".join((*mean.flags, *(["review"] if outside.review else []))),
    }


def _draw(
    model: Model, trace: Trace, mean: tuple[Array, Array], band: tuple[Array, Array, Array], picture: Path
) -> None:
    from sim.validation.plots import Curve, Picture, draw

    times, values = measured(trace, model.temperature)
    low, high = (np.interp(mean[0], band[0], edge) for edge in band[1:])
    driving = [channel.signal for channel in model.alphabet.channels if channel.signal in trace.signals]
    inputs = [
        Curve(name, trace.times[there], trace.signals[name][there])
        for name in driving
        if (there := np.isfinite(trace.signals[name])).any() and np.nanmax(trace.signals[name]) > 1
    ]
    note = "SYNTHETIC: not measured on a plant" if trace.synthetic else trace.origin
    draw(
        Picture(
            f"{model.sha.name} along {trace.name}, open loop",
            Curve(f"measured {model.temperature}", times, values),
            open_loop=Curve("simulated, 90 % band", mean[0], mean[1], low, high),
            inputs=inputs,
            events=trace.events,
            note=note,
        ),
        picture,
    )
