"""`decanter model learn`: a model from traces, written with all its artefacts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console import CommandResult, Part, Rows, conclude, json_option, map_option, progress, seed_option
from gateway.entry import sentences
from gateway.lab.learning.familiar import familiarity_files, trained_familiarity
from gateway.lab.models.show import show_model, show_verdict, spread_sentence, summary
from gateway.lab.options import method_option, temperature_option, traces_option
from gateway.lab.traces.load import load_reported, warned_of
from sim.artefacts import VERDICT_FILE
from sim.lab.formats import check_free, write_model_directory
from sim.lab.judge import judge_learned
from sim.lab.learning import machine_corrections
from sim.lab.learning.lsha import FLOW_KINDS, LshaSettings
from sim.sha import Trace, encoded, shown_unit
from sim.strict_json import json_text

if TYPE_CHECKING:
    from sim.lab.learning.bins import Learned
    from sim.lab.learning.lsha import LearnedLsha
    from sim.lab.recordings import ColumnMap

REPORT = "learning_report"


@click.command(short_help="Learn a model from traces and write its directory.")
@method_option
@traces_option
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The model directory to write.")
@click.option("--name", default="decanter", show_default=True, help="The model's name, and the artefacts' base name.")
@temperature_option
@seed_option
@click.option("--delta", type=click.FloatRange(0.0), help="lsha: merge tolerance, share of the parameters' spread.")
@click.option("--default-flow", type=click.Choice(FLOW_KINDS), help="lsha: the flow of all locations to begin with.")
@click.option(
    "--memory", type=click.Choice(["context", "direction", "previous", "word"]), help="lsha: what rare words share."
)
@click.option("--n-min", type=click.IntRange(2), help="lsha: segments below which a word says nothing by itself [5].")
@click.option("--alpha", type=click.FloatRange(0, 1, min_open=True, max_open=True), help="lsha: error rate [0.05].")
@click.option("--split", type=click.IntRange(2), help="lsha: parts of the traces, each held out once [5].")
@click.option("--observed-edges", is_flag=True, help="lsha: no default edges for what was never seen.")
@json_option
def learn(
    method: str,
    paths: Sequence[str],
    map_name: str,
    out: Path,
    name: str,
    temperature: str | None,
    seed: int,
    as_json: bool,
    observed_edges: bool,
    **options: float | str | None,
) -> None:
    """Learn a model from traces and write its directory with all artefacts.

    `bins`: one location for each combination of running and current bin, fitted by free-run maximum likelihood; the
    held-out likelihood chooses between a constant target and one that the current drives.

    `lsha`: L*_SHA. Words of events that the traces do not tell apart lead to one location; flow, memory and merge
    tolerance are chosen by the held-out likelihood unless given. The directory gets a learning report besides.
    """
    settings: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    settings |= {"complete": False} if observed_edges else {}
    with sentences(), progress(f"learning ({method})") as report:
        if settings and method != "lsha":
            first = next(iter(settings))
            option = {"complete": "observed-edges"}.get(first, first.replace("_", "-"))
            raise ValueError(f"--{option} belongs to --method lsha; leave it out, or choose that method")
        check_free(out, name)  # nobody waits for a model that cannot be written
        traces, column_map, read = load_reported(paths, map_name)
        warnings = warned_of(traces, column_map.alphabet)
        if method == "lsha":
            from sim.lab.learning.lsha import learn_lsha, report_document, report_text

            words_learned = learn_lsha(
                traces,
                column_map.alphabet,
                temperature or column_map.temperature,
                name=name,
                seed=seed,
                settings=LshaSettings(**settings),
                progress=report,
            )
            account = words_learned.report
            more = {
                f"{REPORT}.json": json_text(report_document(account), indent=1) + "\n",
                f"{REPORT}.md": report_text(account, name),
            }
            model, spread = words_learned.model, words_learned.spread
            values, observations = words_learned.values, account.table
            shown, acceptance, coverage = lsha_diagnostics(words_learned), account.acceptance, account.coverage
        else:
            learned = learn_from(traces, column_map, name=name, seed=seed, report=report, temperature=temperature)
            model, spread = learned.model, learned.spread
            values, observations, more = learned.values, None, {}
            shown, acceptance, coverage = diagnostics(learned), None, learned.coverage
        # Of several machines it is a model of their type, and has what is each one's own.
        model = replace(model, machines=machine_corrections(model, traces, spread))
        familiar = trained_familiarity(model, traces)
        verdict = judge_learned(model, [encoded(trace, model.alphabet) for trace in traces], coverage)
        more = more | familiarity_files(familiar) | {VERDICT_FILE: verdict.text()}
        written = write_model_directory(out, model, values, observations=observations, more=more)
    data = {"model": str(out), "file": str(written), **summary(model), "diagnostics": shown}
    cycles = 0 if familiar is None else familiar.reference.held_out.size
    data |= {"verdict": verdict.plain() | {"sentence": verdict.sentence}}
    data |= {"familiar_cycles": cycles, "machines": asdict(spread), "warnings": warnings}
    data |= {"account": read.account()}

    def show() -> Iterator[Part]:
        yield read.account()
        yield from show_model(model)
        for title, rows in shown.items():
            if rows:
                yield Rows(title, list(rows[0]), [list(row.values()) for row in rows])
        yield spread_sentence(spread, shown_unit(model.unit))
        yield f"familiarity: {f'{cycles} cycles' if cycles else 'unknown, too few cycles with an hour before them'}"
        yield f"model directory: {out}"
        yield from show_verdict(verdict)
        if acceptance is not None:
            counts = f"{acceptance.accepted} of {acceptance.traces} training traces"
            yield f"accepted: {counts}, by the observed edges alone"
            yield f"learning report: {out / (REPORT + '.md')}"

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def learn_from(
    traces: Sequence[Trace],
    column_map: ColumnMap,
    *,
    name: str,
    seed: int,
    report: Any = None,
    temperature: str | None = None,
    bands: bool = True,
) -> Learned:
    """A model of the traces by the map's alphabet, of its temperature or the one given, with its `bands` or without."""
    from sim.lab.learning.bins import learn_bins

    return learn_bins(
        traces,
        column_map.alphabet,
        temperature or column_map.temperature,
        name=name,
        seed=seed,
        bands=bands,
        progress=report,
    )


def write(out: Path, learned: Learned, more: Mapping[str, str] | None = None) -> Path:
    """Write the model directory with `more` files by their names; returns the path of its model.json."""
    return write_model_directory(out, learned.model, learned.values, more=more)


def diagnostics(learned: Learned) -> dict[str, list[dict[str, Any]]]:
    """How the model came about, as plain values: the candidates' held-out scores, the fits, the bands' coverage."""
    fits = [asdict(location) for location in learned.locations if location.source != "unknown"]
    wanted = ("name", "source", "readings", "stays", "mu", "mu_error", "sigma", "k", "gains")
    return {
        "candidates": [asdict(candidate) for candidate in learned.candidates],
        "fits": [{name: fit[name] for name in wanted} for fit in fits],
        "held-out forecasts": [asdict(row) for row in learned.coverage],
    }


def lsha_diagnostics(learned: LearnedLsha) -> dict[str, list[dict[str, Any]]]:
    """How the model came about, in short: the rivals, the locations, the edges and the check, the bands' coverage."""
    report = learned.report
    wanted = ("name", "flow", "entry", "segments", "readings", "seconds", "mu", "mu_error", "scatter", "rate")
    fits = [asdict(location) for location in report.locations]
    edges = {"observed": report.observed_edges, "default": report.default_edges, "queries": report.queries}
    checked = {"traces": report.acceptance.traces, "accepted": report.acceptance.accepted}
    events = {"events": report.acceptance.events, "of which compared for the flow": report.flow_events}
    return {
        "flow hypotheses": [asdict(flow) for flow in report.flows],
        "structures (errors in units of a segment's uncertainty)": [
            asdict(structure) for structure in report.structures
        ],
        "locations": [{name: fit[name] for name in wanted} for fit in fits],
        "edges and acceptance": [edges | checked | events],
        "held-out forecasts": [asdict(row) for row in report.coverage],
    }
