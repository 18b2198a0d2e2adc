"""The options of `model judge regression` and its help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import json_option, map_option, seed_option


@click.command("regress", short_help="Run a standard set against all models; say what became worse since when.")
@click.argument("places", metavar="MODELS...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--standard", required=True, help="The traces: a folder, a file, a glob, or a TOML list of them.")
@click.option(
    "--history",
    "file",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("out/regressions.jsonl"),
    show_default=True,
    help="All results so far, which this run is held against and added to.",
)
@click.option("--accept", "reason", help="From now on the models as they are at this run are what counts; say why.")
@map_option
@seed_option
@json_option
def regress(**given: Any) -> None:
    """Forecast along the standard set with every model of MODELS (stores, folders, models), and keep the results.

    Each model is held against its best former run by a paired test, at the forecast's horizons. Where it is worse, it
    is said since which program or model, and the exit code is 1. So it is where a model of the former run is gone, one
    of MODELS cannot be run, or a trace of the set cannot be read. A result that the history has is not computed again,
    and a run that was stopped or killed goes on with the same command.
    """
    from gateway.lab.regression.regress import regress as work

    work(**given)
