"""`decanter diagnose`: where model and measurement disagree, which effect is missing, and the model that has it."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console.options import json_option, map_option, seed_option
from gateway.console.output import emit, progress, sentences, table
from gateway.console.places import shipped
from gateway.console.traces import load

if TYPE_CHECKING:
    from gateway.lab.diagnosing import Request, Told
    from sim.discrepancy.diagnosis import HeatPlace
    from sim.sha.model import Model
    from sim.sha.trace import Trace
    from sim.traces.column_map import ColumnMap


RECENT = "14d"
"""What of a historian is read where nobody says how much."""


@click.command(short_help="Find where model and traces disagree, name what is missing, add it, prove it.")
@click.argument("more", nargs=-1, metavar="[TRACES]...")
@click.option("--model", "where", required=True, help="A model directory, a store, a model.json, or DIR/NAME.")
@click.option("--traces", "paths", multiple=True, help="A file, a folder or a glob; may be given again.")
@click.option("--historian", type=click.Path(path_type=Path), help="A gateway's historian instead of --traces.")
@click.option("--since", help="Of the historian: from this time (2026-03-01T06:00) or span (7d, 36h) on [14d].")
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder for the diagnosis.")
@click.option("--max-names", "most", type=click.IntRange(1, 3), default=3, show_default=True, help="Effects at most.")
@click.option("--temperature", help="The signal that a set of artefacts predicts, which does not say it itself.")
@click.option("--no-report", is_flag=True, help="No page and no pictures: half of the time, for programs.")
@seed_option
@json_option
def diagnose(
    more: Sequence[str],
    where: str,
    paths: Sequence[str],
    historian: Path | None,
    since: str | None,
    map_name: str,
    out: Path,
    most: int,
    temperature: str | None,
    no_report: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Diagnose a model on measured traces: find where they disagree, name the missing effect, add it, prove it.

    --out gets diagnosis.json, report.html, pictures, and model/ where an effect was named: an ordinary model that can
    be verified, promoted and diagnosed again. Nothing is named that chance, moved parameters or a rough plant could
    make: the verdict may be "agree", "unexplained" or "too-little-data". The exit code is 0 whatever the verdict.
    """
    from gateway.lab.diagnosing import Request, roles_of, run
    from sim.discrepancy.fitting.record import overlapping

    sources = (*paths, *more)
    if bool(sources) == (historian is not None):
        raise click.UsageError("give either --traces or --historian")
    if since is not None and historian is None:
        raise click.UsageError("--since belongs to --historian")
    with sentences(), progress("diagnosing") as report:
        request = Request(where, out, _source(sources, historian), seed, most, time.time(), temperature, not no_report)
        report("reading", 0.0)
        model, traces, column_map = _read(request, sources, historian, since, map_name)
        if found := overlapping(traces):
            click.echo(f"{found}: the traces are taken one after the other, as given (a folder by names)", err=True)
        told = run(request, model, traces, roles_of(column_map), report)
    emit(_data(told, out), lambda: show(told, out), as_json_line=as_json)


def _source(sources: Sequence[str], historian: Path | None) -> str:
    return ", ".join(sources) if historian is None else str(historian)


def _read(
    request: "Request", sources: Sequence[str], historian: Path | None, since: str | None, map_name: str
) -> "tuple[Model, list[Trace], ColumnMap | None]":
    """The model, its traces, and the map that names their roles (a historian's have the plant's names)."""
    from gateway.lab.diagnosing import model_of
    from sim.traces.column_map import load_map

    model = model_of(request, load_map(shipped("traces", map_name)))
    if historian is None:
        traces, column_map = load(sources, map_name)
        return model, traces, column_map
    from gateway.store.history import recent

    return model, [recent(historian, since or RECENT)], None


def _data(told: "Told", out: Path) -> dict[str, Any]:
    from sim.discrepancy.output.document import document

    verification = told.verification
    page = out / "report.html"
    more: dict[str, Any] = {"out": str(out), "report": str(page) if page.exists() else None}
    if verification is not None:
        more |= {"verified": not verification, "refused": list(verification)}
    return document(told.diagnosis) | more


def show(told: "Told", out: Path) -> None:
    """Print the verdict with its evidence."""
    one = told.diagnosis
    click.echo(f"{one.verdict}: {one.sentence}")
    for reason in one.reasons:
        click.echo(f"  {reason}")
    if one.places:
        rows = [_place(place) for place in one.places[:5]]
        columns = ("location", "after", "seconds", "share", "heat (°C/h)", "cycles", "p", "goes with")
        table("where the unexplained heat is", columns, rows)
    if one.effects:
        rows = [
            [effect.name, ", ".join(effect.members), effect.confidence, effect.gain, dict(effect.params)]
            for effect in one.effects
        ]
        table("added to the model", ("effect", "class", "confidence", "nats", "parameters"), rows)
        for effect in one.effects:
            click.echo(f"to tell {effect.name} from its twins: {effect.experiment}")
    if one.shifts:
        rows = [[s.location, s.parameter, s.before, s.after, s.unit, s.change, s.sigma] for s in one.shifts]
        table("parameters that moved", ("location", "parameter", "before", "after", "unit", "change", "sigma"), rows)
    _show_held_out(told)
    if one.untested:
        click.echo(f"not tested: {', '.join(one.untested)} (the report says why)")
    if (out / "report.html").exists():
        click.echo(f"report: {out / 'report.html'}")
    if one.model_after is not None:
        click.echo(f"new model: {one.model_after}{_verified(told.verification)}")


def _place(one: "HeatPlace") -> list[object]:
    goes = one.when or one.correlates
    return [one.location, one.after, _span(one.seconds), one.share, one.heat, _of(one.cycles), one.p, goes]


def _show_held_out(told: "Told") -> None:
    held = told.diagnosis.held_out
    if held is None:
        return
    said = f"held out: {held.cycles} cycles, free-run error {held.rmse_before:.3f} °C"
    if told.diagnosis.effects:
        low, high = held.ci95
        said += f" before, {held.rmse_after:.3f} °C after"
        said += f"; {held.excess_removed:.0%} of the excess removed ({low:.0%} to {high:.0%})"
    click.echo(f"{said}; noise floor {held.noise_floor:.3f} °C")


def _verified(reasons: tuple[str, ...] | None) -> str:
    return "; it verifies" if not reasons else f"; it DOES NOT VERIFY: {'; '.join(reasons)}"


def _of(cycles: tuple[int, int]) -> str:
    return f"{cycles[0]} of {cycles[1]}"


def _span(seconds: tuple[float, float]) -> str:
    from sim.discrepancy.heat_map import span

    return span(*seconds)
