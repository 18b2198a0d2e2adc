"""The options of `model export` and its help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import json_option, map_option, seed_option
from gateway.lab.options import policy_option, start_option, trace_option


@click.command(short_help="Write a model for UPPAAL along traces; compare with its engine.")
@click.argument("model")
@click.option("--uppaal", is_flag=True, help="Main and minimal model and queries of each trace.")
@click.option("--artefacts", is_flag=True, help="The public learner's files: graph, report, flows.")
@trace_option
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder to write to.")
@click.option("--query", "queries", multiple=True, help="One more query (docs/checking.md); may be given again.")
@click.option("--template", type=click.Path(path_type=Path), help="A Jinja template for the .xml files, not our own.")
@policy_option
@start_option
@click.option(
    "--tick", type=click.IntRange(0, 3600), default=1, show_default=True, help="Seconds between draws of the noise."
)
@click.option("--run/--no-run", "wanted", default=False, help="Let verifyta answer, and compare.")
@click.option("--verifyta", help="UPPAAL's engine; else DECANTER_VERIFYTA, else PATH. Implies --run.")
@click.option(
    "--timeout", type=click.FloatRange(0, min_open=True), default=600.0, show_default=True, help="Seconds a file."
)
@seed_option
@json_option
def export(**given: Any) -> None:
    """Write a model for other programs: for UPPAAL (--uppaal, one pair of files a trace), or as public artefacts.

    MODEL_TRACE.xml is the whole model that replays the trace, MODEL_TRACE_val.xml the small one that asks whether the
    automaton accepts it; each has its queries in a .q file beside it. docs/uppaal.md says what they mean.
    """
    from gateway.lab.models.export import export as work

    work(**given)
