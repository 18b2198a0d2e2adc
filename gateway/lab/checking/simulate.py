"""`decanter model simulate`: a model let run along measured traces, and how far off it comes out; or along a word."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from gateway.console import CommandResult, Part, Rows, conclude, progress
from gateway.entry import Exit, sentence, sentences
from gateway.lab.checking.word import replay_word
from gateway.lab.traces.load import load
from sim.engine import Policy, Start, errors, open_loop, open_loop_schedule, readings, start_law
from sim.engine import simulate as sample_runs
from sim.forecast import review_errors, standardise
from sim.lab.formats import find_model
from sim.lab.pictures import Curve, Picture, draw
from sim.sha import Model, Trace, display_unit, encode_trace, signal_unit

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
            rows.append(
                _simulate_one(
                    model,
                    trace,
                    runs,
                    policy=policy,
                    start=start,
                    rng=np.random.default_rng([seed, index]),
                    picture=wanted,
                )
            )
        except ValueError as error:
            rows.append({"trace": trace.name, "error": sentence(error)})
    return rows


def _simulate_one(
    model: Model, trace: Trace, runs: int, policy: Policy, start: Start, rng: np.random.Generator, picture: Path | None
) -> dict[str, Any]:
    unit = signal_unit([trace], model.temperature, model.unit)
    mean = open_loop(model, trace, policy, start)
    missed = errors(mean, trace, model.temperature)
    steps = open_loop_schedule(model, trace, policy)
    sampled = sample_runs(steps, start_law(model, trace, start), runs, rng)
    noisy = sampled.temperatures + model.sensor_sigma * rng.normal(size=sampled.temperatures.shape)
    low, high = np.quantile(noisy, BAND, axis=0)
    times, values = readings(trace, model.temperature)
    place = np.searchsorted(sampled.times, times)
    inside = (values >= low[place]) & (values <= high[place])
    outside = review_errors(*standardise(mean, trace, model))
    if picture is not None:
        # The band is of the runs' moments, the line of the exact mean's: it is drawn at the latter.
        edges = (np.interp(mean.times, sampled.times, edge) for edge in (low, high))
        driving = [channel.signal for channel in model.alphabet.channels if channel.signal in trace.signals]
        inputs = [
            Curve(name, trace.times[present], trace.signals[name][present])
            for name in driving
            if (present := np.isfinite(trace.signals[name])).any() and np.nanmax(trace.signals[name]) > 1
        ]
        drawn = Picture(
            f"{model.sha.name} along {trace.name}, open loop",
            Curve(f"measured {model.temperature}", times, values),
            open_loop=Curve("simulated, 90 % band", mean.times, mean.mean, *edges),
            inputs=inputs,
            events=trace.events,
            note="SYNTHETIC: not measured on a plant" if trace.synthetic else trace.origin,
            units=trace.units,
            unit=unit,
        )
        draw(drawn, picture)
    return {
        "trace": trace.name,
        "unit": unit,
        "synthetic": trace.synthetic,
        "events": len(trace.events),
        "rmse": missed.at_samples.rmse,
        "mae": missed.at_samples.mae,
        "rmse at events": missed.at_events.rmse,
        "mae at events": missed.at_events.mae,
        "final": missed.final,
        "final %": missed.final_percent,
        "coverage 90 %": float(np.mean(inside)),
        "clamps": mean.clamps,
        "limited": mean.limited,
        "beyond 3 sigma": outside.share,
        "longest run beyond 3 sigma": outside.run,
        "review": outside.review,
        "flags": ", ".join((*mean.flags, *(["review"] if outside.review else []))),
    }


def simulate(
    directory: str,
    paths: Sequence[str],
    word: str | None,
    map_name: str,
    runs: int,
    policy: Policy,
    start: Start,
    seed: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """The work of `model simulate`."""
    if bool(paths) == (word is not None):
        raise click.UsageError("give --trace or --word, one of the two")
    if word is not None:
        replay_word(directory, word, policy, as_json=as_json)
        return
    with sentences(), progress("simulating") as report:
        traces, column_map = load(paths, map_name)
        found_model = find_model(directory, alphabet=column_map.alphabet, temperature=column_map.temperature)
        chosen = found_model.runnable()
        traces = [encode_trace(trace, chosen.alphabet) for trace in traces]
        rows = simulate_traces(
            chosen, traces, runs=runs, policy=policy, start=start, seed=seed, picture=picture, report=report
        )
    data = {"model": chosen.sha.name, "traces": rows, "picture": picture and str(picture)}
    complaint = "; ".join(str(row["error"]) for row in rows if "error" in row)
    conclude(CommandResult(data, complaint, Exit.USAGE), lambda _: _show_rows(rows, picture), as_json=as_json)


def _show_rows(rows: Sequence[Mapping[str, Any]], picture: Path | None) -> Iterator[Part]:
    columns = ("trace", "events", "rmse", "mae", "rmse at events", "final", "coverage 90 %", "clamps", "flags")
    done = [[row[name] for name in columns] for row in rows if "error" not in row]
    if done:
        units = " and ".join(dict.fromkeys(display_unit(row["unit"]) for row in rows if "error" not in row))
        yield Rows(f"open loop ({units})", columns, done)
    if picture is not None:
        yield f"picture: {picture}"
