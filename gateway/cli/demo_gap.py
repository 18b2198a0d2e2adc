"""`decanter demo --discrepancy`: a hidden effect found, named, added to the model, and the gap that shrinks."""

import time
from pathlib import Path
from typing import Any

import click

from gateway.console.output import Exit, emit, fail, make_folder, progress, sentences
from gateway.console.places import shipped

MOST = 3
"""Effects that may be named."""


def demonstrate(seed: int, out: Path, *, as_json: bool) -> None:
    """Run it in `out` and say what came out; leaves with code 1 when a wrong effect was named."""
    from gateway.demo.folder import held

    with sentences(), held(out):
        data = perform(seed, out)
    emit(data, lambda: show(data), as_json_line=as_json)
    if data["wrong"]:
        fail("an effect was named that is not the hidden one", Exit.CHECK_FAILED)


def perform(seed: int, out: Path) -> dict[str, Any]:
    """Learn the model before the change and diagnose it after; the figures. Raises ValueError or OSError."""
    from gateway.demo.gap import days, figures
    from gateway.lab.diagnosing import Request, roles_of, run
    from gateway.lab.learn import learn_from, write
    from sim.discrepancy.output.document import document
    from sim.discrepancy.output.folder import check_folder
    from sim.traces.column_map import load_map
    from sim.traces.trace_file import write_trace

    column_map, folder, before = load_map(shipped("traces", "decanter")), out / "diagnosis", out / "model_before"
    check_folder(folder, before)
    plant = days(seed, column_map.alphabet)
    for name, traces in (("before", plant.before), ("after", plant.after)):
        make_folder(out / name)
        for trace in traces:
            write_trace(trace, out / name / f"{trace.name}.csv")
    with progress("learning before the change") as report:
        learned = learn_from(plant.before, column_map, name="bearing", seed=seed, report=report)
    write(before, learned)
    request = Request(str(before), folder, str(out / "after"), seed, MOST, time.time())
    with progress("diagnosing after it") as report:
        told = run(request, learned.model, plant.after, roles_of(column_map), report)
    return figures(document(told.diagnosis), folder)


def show(data: dict[str, Any]) -> None:
    """Print the summary."""
    from gateway.demo.gap import sentences as said

    click.echo("decanter demo: a hidden effect (SYNTHETIC data, not measured on a plant)")
    for sentence in said(data):
        click.echo(f"  {sentence}")
    if data["model_after"]:
        click.echo(f"new model: {data['model_after']}")
    click.echo(f"picture: {data['picture']}")
    click.echo(f"report: {data['report']}")
