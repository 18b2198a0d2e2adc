"""`decanter model show`: a model as text or JSON."""

from collections.abc import Mapping
from math import nan
from typing import TYPE_CHECKING, Any

import click

from gateway.cli.options import json_option
from gateway.cli.output import emit, sentences, table

if TYPE_CHECKING:
    from sim.sha.model import Model


@click.command(short_help="Show a model and where it comes from.")
@click.argument("name")
@json_option
def show(name: str, as_json: bool) -> None:
    """Show a model: locations, flows, laws of parameters and stays, where it comes from."""
    from sim.artefacts.find import find_model

    with sentences():
        shown = find_model(name).runnable()
    emit(summary(shown), lambda: show_model(shown), as_json_line=as_json)


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
