"""The options of what learns and its help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import json_option, map_option, seed_option
from gateway.lab.options import method_option, traces_option
from sim.lab.choices import SEARCHES
from sim.lab.learning.lsha import FLOW_KINDS


@click.command(short_help="Learn a model from traces and write its directory.")
@method_option
@traces_option
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The model directory to write.")
@click.option("--name", default="decanter", show_default=True, help="The model's name, and the artefacts' base name.")
@click.option(
    "--temperature",
    "temperatures",
    multiple=True,
    metavar="SIGNAL",
    help="The signal that is predicted; given again, each has its model in a folder of its name.  [default: the map's]",
)
@click.option(
    "--driver",
    "drivers",
    multiple=True,
    metavar="SIGNAL",
    help="A signal that loads the machine: power, speed, set point; given again, several.  [default: the map's]",
)
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
def learn(**given: Any) -> None:
    """Learn a model from traces and write its directory with all artefacts.

    What drives the temperature, and what only follows it, is said with its evidence; of several level signals of the
    alphabet one that follows it is left out.

    `bins`: one location for each combination of running and current bin, fitted by free-run maximum likelihood; the
    held-out likelihood chooses between a constant target and one that the current drives.

    `lsha`: L*_SHA. Words of events that the traces do not tell apart lead to one location; flow, memory and merge
    tolerance are chosen by the held-out likelihood unless given. The directory gets a learning report besides.
    """
    from gateway.lab.learning.learn import learn as work

    work(**given)


@click.command(short_help="Learn T' = k T + b from traces and write the corrected model.")
@click.argument("name")
@traces_option
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The model directory or store to write to.")
@click.option(
    "--form",
    type=click.Choice(["best", "gain", "affine"]),
    default="best",
    show_default=True,
    help="gain: T' = k T; affine: T' = k T + b; best: the simplest one as good as the best.",
)
@click.option("--max-rate", "limit_rate", is_flag=True, help="Also limit the flows by the greatest rate in the traces.")
@json_option
def correct(**given: Any) -> None:
    """Learn the calibration correction T' = k T (+ b) of a model and write the corrected model.

    T is the automaton's temperature, T' what the sensor reads. Give traces that the model was not learned from. The
    correction is accepted when the error of held-out traces falls by more than its standard error; where nothing is
    accepted nothing is written, and the exit code is 1.
    """
    from gateway.lab.learning.correct import correct as work

    work(**given)


@click.command(short_help="Search a learning method's best settings by cross-validation over traces.")
@method_option
@traces_option
@map_option
@click.option("--cycles", is_flag=True, help="Cut each trace into cycles first, for one long recording.")
@click.option(
    "--study",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="The file of the search; one that is there is gone on with.",
)
@click.option("--trials", type=click.IntRange(1), default=30, show_default=True, help="Trials of the study in all.")
@click.option("--folds", type=click.IntRange(2), default=5, show_default=True, help="Parts that are held out in turn.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
@click.option(
    "--objective",
    type=click.Choice(["crps", "likelihood"]),
    default="crps",
    show_default=True,
    help="Of held-out traces, open loop: CRPS (in what is followed), or minus the log-likelihood per reading.",
)
@click.option(
    "--search",
    type=click.Choice(SEARCHES),
    default="tpe",
    show_default=True,
    help="Settings by Parzen estimator, from a grid, or by crossing the best.",
)
@click.option("--prune", is_flag=True, help="Give a trial up when its first folds are worse than the median's.")
@click.option("--out", type=click.Path(path_type=Path), help="Learn with the best settings from all traces; write it.")
@click.option("--name", default="decanter", show_default=True, help="The name of the model for --out.")
@seed_option
@json_option
def tune(**given: Any) -> None:
    """Search a learning method's best settings by cross-validation over traces.

    The first trial has the method's defaults; the result says whether the best settings beat them by more than one
    standard error, paired by trace. A search that was stopped or killed goes on with the same command; a study of
    other traces, another method or other settings is refused.
    """
    from gateway.lab.learning.tune import tune as work

    work(**given)
