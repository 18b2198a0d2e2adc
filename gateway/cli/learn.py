"""`decanter model learn`: a model from traces, written with all its artefacts."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.cli.options import json_option, map_option, seed_option
from gateway.cli.output import emit, progress, sentences, table
from gateway.cli.show import show_model, summary
from gateway.cli.traces import load

if TYPE_CHECKING:
    from sim.learning.bins import Learned
    from sim.sha.trace import Trace
    from sim.validation.column_map import ColumnMap


@click.command(short_help="Learn a model from traces and write its directory.")
@click.option("--method", type=click.Choice(["bins"]), default="bins", show_default=True)
@click.option("--traces", "paths", multiple=True, required=True, help="A file, a folder or a glob; may be given again.")
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The model directory to write.")
@click.option("--name", default="decanter", show_default=True, help="The model's name, and the artefacts' base name.")
@seed_option
@json_option
def learn(method: str, paths: Sequence[str], map_name: str, out: Path, name: str, seed: int, as_json: bool) -> None:
    """Learn a model from traces and write its directory with all artefacts.

    `bins`: one location for each combination of running and current bin, fitted by free-run maximum likelihood; the
    held-out likelihood chooses between a constant target and one that the current drives.
    """
    with sentences(), progress(f"learning ({method})") as report:
        traces, column_map = load(paths, map_name)
        learned = learn_from(traces, column_map, name=name, seed=seed, report=report)
        written = write(out, learned)
    data = {"model": str(out), "file": str(written), **summary(learned.model), "diagnostics": diagnostics(learned)}
    emit(data, lambda: _show_learned(learned, out), as_json_line=as_json)


def learn_from(traces: "Sequence[Trace]", column_map: "ColumnMap", *, name: str, seed: int, report: Any) -> "Learned":
    """A model of the traces by the map's alphabet and temperature."""
    from sim.learning.bins import learn_bins

    return learn_bins(
        traces,
        column_map.alphabet,
        column_map.temperature,
        name=name,
        seed=seed,
        progress=report,
    )


def write(out: Path, learned: "Learned") -> Path:
    """Write the model directory; returns the path of its model.json."""
    from sim.artefacts.model_directory import write_model_directory

    return write_model_directory(out, learned.model, learned.values)


def diagnostics(learned: "Learned") -> dict[str, list[dict[str, Any]]]:
    """How the model came about, as plain values: the candidates' held-out scores, the fits, the bands' coverage."""
    from dataclasses import asdict

    fits = [asdict(one) for one in learned.locations if one.source != "unknown"]
    wanted = ("name", "source", "readings", "stays", "mu", "mu_error", "sigma", "k", "gains")
    return {
        "candidates": [asdict(one) for one in learned.candidates],
        "fits": [{name: fit[name] for name in wanted} for fit in fits],
        "held-out forecasts": [asdict(one) for one in learned.coverage],
    }


def _show_learned(learned: "Learned", out: Path) -> None:
    show_model(learned.model)
    for title, rows in diagnostics(learned).items():
        if rows:
            table(title, list(rows[0]), [list(row.values()) for row in rows])
    click.echo(f"model directory: {out}")
