"""The options of `model show`, `version promote` and `export`; the work is loaded when it is asked for."""

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


@click.command(short_help="Show a model and where it comes from.")
@click.argument("name")
@json_option
def show(**options: Any) -> None:
    """Show a model: locations, flows, laws of parameters and stays, where it comes from.

    Of artefacts that cannot be run the structure is shown, and why they cannot.
    """
    from gateway.lab.models.show import show as work

    work(**options)


@click.command(short_help="Make a version of a store current, if its model verifies.")
@click.argument("store", type=click.Path(path_type=Path, file_okay=False))
@click.argument("version", required=False)
@click.option("--add", "model", help="Save this model (a directory or JSON file) as a new version and promote that.")
@click.option("--force", "reason", metavar="REASON", help="Promote one that is not deployable or unfit; recorded.")
@click.option("--by", help="Who forces it; recorded.")
@json_option
def promote(**options: Any) -> None:
    """Make VERSION of STORE the current one: what a gateway runs whose model.path is the store.

    A model that does not verify (see `decanter model judge proof`), that was judged unfit where it was learned, or that
    foresaw the same cycles worse than the one that runs is refused, in one sentence with the reasons. Its verdict is
    shown beside that of the version that ran before; going back to one that ran is always free. --force with --by
    promotes it all the same, if it can be run at all: name and reason are kept in the store, the gateway warns at each
    start, does not run armed on one that does not verify, and has red confidence in one that is unfit.
    """
    from gateway.lab.models.promote import promote as work

    work(**options)
