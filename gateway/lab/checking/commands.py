"""The options of `model check` and its help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import finite, historian_machine_option, json_option, map_option


def _share(_: click.Context, parameter: click.Parameter, number: float) -> float:
    finite(_, parameter, number)
    if not 0.0 < number < 0.5:
        raise click.BadParameter(f"{number} is not between 0 and 0.5")
    return number


def _picture(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
    if path is None:
        return None
    from sim.lab.pictures import PICTURE_SUFFIXES

    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise click.BadParameter(
            f"{path} is no picture; give a name that ends in {', '.join(PICTURE_SUFFIXES)}", param=parameter
        )
    return _place(context, parameter, path)


def _place(_: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
    """A file in a folder that is there: an answer must not be lost because it cannot be written."""
    if path is not None and not path.absolute().parent.is_dir():
        raise click.BadParameter(f"{path.parent} is no folder; make it first, or name another one", param=parameter)
    return path


@click.command(short_help="Answer a query: how probable, how hot, whether it can.")
@click.argument("model_name", metavar="MODEL")
@click.argument("query_text", metavar="QUERY")
@click.option("--events", "events", metavar="TRACE", help="A recorded trace whose events and inputs drive the runs.")
@map_option
@click.option(
    "--from",
    "origin",
    default="initial",
    show_default=True,
    metavar="initial|location:NAME|trace:TIME|historian:FILE",
    help="Where runs start: as the model does, in a location, or from what is believed then.",
)
@click.option(
    "--future",
    type=click.Choice(["recorded", "semi-markov"]),
    help="What drives the runs after trace:TIME: the trace's own events (the default), or the semi-Markov law.",
)
@click.option(
    "--rule",
    type=click.Choice(["sequential", "fixed", "anytime"]),
    default="sequential",
    show_default=True,
    help="When there are enough runs: see docs/checking.md.",
)
@click.option("--runs", type=click.IntRange(1, 100_000_000), help="Exactly so many runs (for a test: at most).")
@click.option("--alpha", type=float, default=0.05, show_default=True, callback=_share, help="1 - confidence.")
@click.option("--epsilon", type=float, default=0.05, show_default=True, callback=_share, help="Interval's half-width.")
@click.option(
    "--delta", type=float, default=0.01, show_default=True, callback=_share, help="A test's indifference: p ± delta."
)
@click.option("--rare", is_flag=True, help="Importance splitting: for probabilities of 1e-4 and less.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Equal seeds, equal answers.")
@click.option(
    "--csv",
    "courses",
    type=click.Path(path_type=Path, dir_okay=False),
    callback=_place,
    help="Write the courses of a simulation there.",
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    callback=_picture,
    help="Draw the courses of a simulation, or how the probability grows with time.",
)
@historian_machine_option
@json_option
def check(**given: Any) -> None:
    """Answer QUERY about MODEL: Pr[<=T](...), a test >= p, a comparison, E[<=T; N](max: ...), simulate, E<>, A[] ...

    docs/checking.md has the language, and says how answers come about and how exact they are. Times are
    seconds from where the runs start.

    Exit codes: 0 answered or it holds, 1 a test, comparison or symbolic query whose answer is no, or stays open within
    the runs allowed, 2 wrong usage or input.
    """
    from gateway.lab.checking.check import check as work

    work(**given)
