"""`decanter trace synth`: synthetic traces as CSV."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click

from gateway.console import CommandResult, conclude, make_folder, progress
from gateway.entry import sentences
from gateway.lab.traces.summary import show_summaries, trace_summary
from sim.lab.recordings import write_trace
from sim.plant import SCENARIOS, production, scenario
from sim.sha import DECANTER, encode


def synth(
    names: Sequence[str],
    everything: bool,
    days: int | None,
    cycles: int,
    period: float,
    seed: int,
    out: Path,
    as_json: bool,
) -> None:
    """The work of `trace synth`."""
    wanted = list(SCENARIOS) if everything else list(names)
    if not wanted and days is None:
        raise click.UsageError("name scenarios (cd1 ... cd17), or give --all or --days N")
    with sentences(), progress("synthetic traces") as report:
        traces = []
        for index, name in enumerate(wanted):
            report(name, index / len(wanted))
            traces.append(scenario(name, seed))
        if days is not None:
            report(f"{days} days", 0.5)
            traces.append(production(days, cycles, seed=seed, period=period, name=f"production_{days}d_seed{seed}"))
        make_folder(out)
        files = [out / f"{trace.name}.csv" for trace in traces]
        for trace, file in zip(traces, files, strict=True):
            write_trace(trace, file)
    encoded = [replace(trace, events=encode(trace, DECANTER)) for trace in traces]
    rows = [trace_summary(trace, file) for trace, file in zip(encoded, files, strict=True)]
    conclude(
        CommandResult({"synthetic": True, "traces": rows}),
        lambda _: show_summaries("SYNTHETIC traces", rows),
        as_json=as_json,
    )
