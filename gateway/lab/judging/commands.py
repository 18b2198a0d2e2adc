"""The options of what judges models and its help; the work is loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console import json_option, map_option, seed_option
from gateway.lab.options import (
    MOST_MOMENTS,
    cluster_option,
    jobs_option,
    optional_traces_option,
    policy_option,
    traces_option,
)

if TYPE_CHECKING:
    from gateway.lab.judging.request import JudgingRequest

LIMITS = """
\b
Limits of fitness, judged on traces that were not in training where there are any:
  coverage_low 0.8    least mean share of the readings inside the 90 % band
  coverage_high 0.99  largest
  persistence 1       MAE below so many times that of the first reading held
  largest 30          no error above this, degC
  percent 70          no trace's mean error above this, in per cent of its readings
  clamps 0            clamps to the model's range at most
  rejecting 0         traces at most with an event that has no edge
  unseen 1            traces at least that were not in training
"""


def judging_options(*, semantics: str, training: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The options of a JudgingRequest, which the command gets as its first argument; the two help texts are its own.

    MODEL and --traces are the command's to declare, and --policy where it has one.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def call(**given: Any) -> Any:
            from gateway.lab.judging.request import JudgingRequest
            from sim.lab.judge import TraceRunSettings

            settings = TraceRunSettings(given.pop("runs"), given.pop("policy", "resync"), given.pop("seed"))
            names = ("models", "paths", "map_name", "wanted", "training", "jobs", "skill", "rivals")
            asked = {name: given.pop(name) for name in names}
            asked["skill"] = asked["skill"] or asked["rivals"]
            return command(JudgingRequest(settings=settings, **asked), **given)

        kinds = click.Choice(["written", "carried", "resampled", "both"])
        carried = f"The temperature is carried over events or resampled on entry (the thesis); {semantics}."
        ahead = "Also score forecasts 60, 300 and 900 s ahead, made as the running gateway does (seconds a trace)."
        beside = "Statistical methods beside them, fitted to --training; implies --skill."
        for option in (
            seed_option,
            jobs_option,
            click.option(
                "--runs", type=click.IntRange(100, 100_000), default=1000, show_default=True, help="Runs a trace."
            ),
            click.option("--rivals", is_flag=True, help=beside),
            click.option("--skill/--no-skill", default=False, show_default=True, help=ahead),
            click.option("--training", multiple=True, help=training),
            click.option("--semantics", "wanted", type=kinds, default="written", show_default=True, help=carried),
            map_option,
        ):
            call = option(call)
        return call

    return decorate


def _horizons(_: click.Context, __: click.Parameter, text: str) -> tuple[float, ...]:
    from gateway.settings import ForecastSection

    try:
        return ForecastSection(horizons=tuple(float(part) for part in text.split(","))).horizons
    except ValueError:
        raise click.BadParameter(f"{text!r}: give positive seconds in ascending order, such as 60,300,900") from None


@click.command(short_help="Validate models along measured traces in nine stages; write a report for each.")
@click.argument("models", nargs=-1, required=True, metavar="MODEL...")
@traces_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder for reports and results.")
@click.option("--overwrite", is_flag=True, help="Replace the results of an earlier campaign in --out.")
@judging_options(
    semantics="both side by side",
    training="Traces to learn `bins` or `lsha` from, to give the resampled semantics its entry laws, "
    "and to fit rivals to.",
)
@policy_option
@cluster_option
@click.option("--pictures/--no-pictures", default=True, show_default=True, help="A PNG and a PDF a trace.")
@json_option
def validate(request: JudgingRequest, **given: Any) -> None:
    """Validate models along measured traces: artefacts checked, every event followed, open-loop runs compared.

    MODEL is a model directory, a store, STORE@VERSION, a model.json, or DIR/NAME of a set of artefacts; `bins` or
    `lsha`, where nothing of that name is there, is learned from --training first. --out gets the record of each of the
    nine stages, results as JSON and CSV, pictures, one HTML report a model and an index. A trace that fails is reported
    and the others go on; the exit code is 1 only when nothing could be simulated. With --skill the models' forecasts
    along the traces are scored too, beside persistence, and it is said where they are not worth it.
    """
    from gateway.lab.judging.validate import validate as work

    work(request, **given)


@click.command(short_help="Forecast along held-out traces as the running gateway does; score it beside rivals.")
@click.argument("directory", metavar="MODEL")
@traces_option
@map_option
@click.option("--member", "members", multiple=True, help="A model beside MODEL in an ensemble; may be given again.")
@click.option("--rivals", is_flag=True, help="Statistical methods too, fitted to the traces of --training.")
@click.option("--training", multiple=True, help="Traces that the rivals are fitted to; may be given again.")
@click.option(
    "--period", type=click.FloatRange(1.0), default=30.0, show_default=True, help="Seconds between two forecasts."
)
@click.option(
    "--horizons", default="60,300,900", show_default=True, callback=_horizons, help="Seconds ahead, ascending."
)
@click.option(
    "--scan", type=click.FloatRange(0.0, min_open=True), default=1.0, show_default=True, help="The scan period, s."
)
@click.option(
    "--moments", type=click.IntRange(1), default=MOST_MOMENTS, show_default=True, help="Forecasts of a trace at most."
)
@click.option(
    "--picture", type=click.Path(path_type=Path, dir_okay=False), help="Also draw the figures (.png, .pdf, .svg)."
)
@seed_option
@json_option
def skill(**given: Any) -> None:
    """Forecast along held-out traces as the running gateway does, and score it beside persistence and rivals.

    Every trace is followed scan by scan: events to come are not known, the bands are widened by what came true so far.
    All methods are compared at the same moments; a forecast's outcome is the reading when it is due. Means are of the
    machines' means.
    """
    from gateway.lab.judging.skill import skill as work

    work(**given)


@click.command(epilog=LIMITS, short_help="Compare models on the same traces; say which are fit for deployment.")
@click.argument("models", nargs=-1, metavar="[MODEL...]")
@optional_traces_option
@click.option(
    "--results",
    "folders",
    multiple=True,
    type=click.Path(path_type=Path),
    help="The folder of an earlier `model judge validation`; may be given again.",
)
@judging_options(
    semantics="both are ranked apart",
    training="Traces that give the resampled semantics its entry laws; rivals are fitted to them.",
)
@click.option(
    "--weights",
    type=click.FloatRange(0.0),
    nargs=3,
    default=(0.5, 0.3, 0.2),
    show_default=True,
    help="Of MAE, largest error and sigma of the errors in the score.",
)
@click.option(
    "--limit",
    "limits",
    type=(str, str),
    multiple=True,
    metavar="NAME NUMBER",
    help="A limit of fitness, as `--limit coverage_low 0.85`; may be given again. Names and defaults are below.",
)
@click.option("--allow-synthetic", is_flag=True, help="A model learned from synthetic traces may be fit.")
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), help="Also write the ranking as one HTML page."
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also draw errors and wins to this file (.png, .pdf, .svg).",
)
@json_option
def rank(request: JudgingRequest, **given: Any) -> None:
    """Compare models on the same traces by S = w1 MAE + w2 largest error + w3 sigma(error), with paired tests.

    Give MODEL... and --traces to run them (open loop), or --results of an earlier `decanter model judge validation`;
    models given beside --results are verified. A model that has seen a trace in training is marked in-sample. The
    limits of fitness for deployment are options; `open` means that one of them could not be looked at. With --skill the
    models' forecasts along the traces are scored too, beside persistence, and it is said where they are not worth it.
    """
    from gateway.lab.judging.rank import rank as work

    work(request, **given)
