"""`decanter model`: learn a model from traces, look at it, let it run along measured traces."""

from collections.abc import Mapping, Sequence
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.cli.options import json_option, map_option, picture_option, seed_option
from gateway.cli.output import emit, fail, progress, sentences, table
from gateway.cli.places import shipped

if TYPE_CHECKING:
    from sim.learning.bins import Learned
    from sim.sha.model import Model
    from sim.sha.open_loop import Start
    from sim.sha.schedule import Policy
    from sim.sha.trace import Trace
    from sim.validation.column_map import ColumnMap


@click.group()
def model() -> None:
    """Learn, look at and simulate models."""


def load(paths: Sequence[str], map_name: str) -> "tuple[list[Trace], ColumnMap]":
    """Encoded traces by a column map; what was refused goes to standard error. Raises ValueError."""
    from sim.validation.column_map import load_map
    from sim.validation.traces import load_traces

    column_map = load_map(shipped("traces", map_name))
    traces, report = load_traces(paths[0] if len(paths) == 1 else list(paths), column_map)
    if report.refused or report.errors:
        for sentence in report.sentences():
            click.secho(sentence, fg="yellow", err=True)
    return traces, column_map


@model.command(short_help="Learn a model from traces and write its directory.")
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


@model.command(short_help="Show a model and where it comes from.")
@click.argument("directory", type=click.Path(path_type=Path))
@json_option
def show(directory: Path, as_json: bool) -> None:
    """Show a model: locations, flows, laws of parameters and stays, where it comes from."""
    from sim.artefacts.store import read_model

    with sentences():
        shown = read_model(directory)
    emit(summary(shown), lambda: show_model(shown), as_json_line=as_json)


@model.command(short_help="Let a model run along measured traces; say how far off it is.")
@click.argument("directory", type=click.Path(path_type=Path))
@click.option("--trace", "paths", multiple=True, required=True, help="A file, a folder or a glob; may be given again.")
@map_option
@click.option(
    "--runs", type=click.IntRange(2, 1_000_000), default=1000, show_default=True, help="Stochastic runs a trace."
)
@click.option(
    "--policy",
    type=click.Choice(["reject", "ignore", "resync"]),
    default="resync",
    show_default=True,
    help="An event without an edge.",
)
@click.option(
    "--start", type=click.Choice(["measured", "law"]), default="measured", show_default=True, help="First temperature."
)
@seed_option
@picture_option
@json_option
def simulate(
    directory: Path,
    paths: Sequence[str],
    map_name: str,
    runs: int,
    policy: "Policy",
    start: "Start",
    seed: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Let a model run along measured traces (open loop) and say how far off it comes out.

    Errors are given at all readings, at the events (the thesis's way) and for the last reading, apart; the band is
    that of the stochastic runs, the sensor's noise included.
    """
    from gateway.cli.simulation import simulate_traces
    from sim.artefacts.store import read_model

    with sentences(), progress("simulating") as report:
        chosen = read_model(directory)
        traces, _ = load(paths, map_name)
        rows = simulate_traces(
            chosen, traces, runs=runs, policy=policy, start=start, seed=seed, picture=picture, report=report
        )
    data = {"model": chosen.sha.name, "traces": rows, "picture": picture and str(picture)}

    def show_rows() -> None:
        columns = ("trace", "events", "rmse", "mae", "rmse at events", "final", "coverage 90 %", "clamps", "flags")
        done = [[row[name] for name in columns] for row in rows if "error" not in row]
        if done:
            table("open loop (°C)", columns, done)
        if picture is not None:
            click.echo(f"picture: {picture}")

    emit(data, show_rows, as_json_line=as_json)
    if any("error" in row for row in rows):
        fail("; ".join(str(row["error"]) for row in rows if "error" in row))


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


def summary(shown: "Model") -> dict[str, Any]:
    """The model as plain values for JSON."""
    from sim.artefacts.model_json import model_hash

    return {
        "name": shown.sha.name,
        "hash": model_hash(shown),
        "temperature": shown.temperature,
        "sensor_sigma": shown.sensor_sigma,
        "locations": _location_rows(shown),
        "edges": len(shown.sha.edges),
        "provenance": {
            "method": shown.provenance.method,
            "data_hash": shown.provenance.data_hash,
            "traces": list(shown.provenance.traces),
            "synthetic": shown.provenance.synthetic,
            "settings": dict(shown.provenance.settings),
            "scores": dict(shown.provenance.scores),
        },
    }


def _location_rows(shown: "Model") -> list[dict[str, Any]]:
    from sim.sha import distributions

    rows = []
    for location in shown.sha.locations:
        law: Mapping[str, float] = location.distribution.params if location.distribution else {}
        stay = shown.semi_markov.get(location.name)
        row: dict[str, Any] = {"location": location.name, "flow": location.flow.kind}
        row |= {name: law.get(name, nan) for name in ("mu", "sigma")}
        row |= {name: location.flow.params.get(name, nan) for name in ("k", "noise")}
        row["gain"] = location.flow.inputs[0].gain if location.flow.inputs else nan
        row["stay_s"] = distributions.mean(stay.law) if stay else nan
        row["next"] = max(stay.to, key=lambda name: stay.to[name]) if stay and stay.to else ""
        rows.append(row)
    return rows


def show_model(shown: "Model") -> None:
    """Print the model's locations and where it comes from."""
    rows = _location_rows(shown)
    columns = list(rows[0])
    table(
        f"{shown.sha.name}: {len(rows)} locations, {len(shown.sha.edges)} edges",
        columns,
        [list(row.values()) for row in rows],
    )
    origin = shown.provenance
    click.echo(f"temperature {shown.temperature}, sensor sigma {shown.sensor_sigma:.3g} °C, method {origin.method}")
    if shown.calibration:
        click.echo("calibration " + ", ".join(f"{h:g} s x {f:.2f}" for h, f in sorted(shown.calibration.items())))
    synthetic = ", SYNTHETIC: not learned from a plant" if origin.synthetic else ""
    click.echo(f"{len(origin.traces)} traces, content {origin.data_hash[:12]}{synthetic}")


def _show_learned(learned: "Learned", out: Path) -> None:
    show_model(learned.model)
    for title, rows in diagnostics(learned).items():
        if rows:
            table(title, list(rows[0]), [list(row.values()) for row in rows])
    click.echo(f"model directory: {out}")
