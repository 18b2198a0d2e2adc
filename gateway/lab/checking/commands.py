"""The options of `model check`, `judge proof` and `simulate`; the work is loaded when it is asked for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from gateway.console import finite, historian_machine_option, json_option, map_option, seed_option
from gateway.lab.options import picture_option, policy_option, start_option, trace_option


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


def _pair(text: str) -> tuple[float, float]:
    """LOW..HIGH as two numbers. Raises click.BadParameter."""
    low, dots, high = text.partition("..")
    try:
        return (float(low), float(high)) if dots else (float(text), float(text))
    except ValueError:
        raise click.BadParameter(f"{text!r} is no range; write LOW..HIGH, as 0..600") from None


def _sojourn(_: click.Context, __: click.Parameter, text: str) -> str | tuple[float, float]:
    if text in ("any", "law"):
        return text
    return _pair(text)


def _inputs(_: click.Context, __: click.Parameter, texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    ranges = {}
    for text in texts:
        name, sign, value = text.rpartition("=")
        if not (sign and name):
            raise click.BadParameter(f"{text!r} is no signal's range; write SIGNAL=LOW..HIGH")
        ranges[name] = _pair(value)
    return ranges


@click.command(short_help="Prove or refute what a model can do; say whether it may be deployed.")
@click.argument("model")
@click.option("--traces", "paths", multiple=True, help="Must be accepted: a file, a folder or a glob; may be repeated.")
@map_option
@click.option("--bounds", type=(float, float), metavar="LOW HIGH", help="Claim that T stays within these (°C).")
@click.option(
    "--sojourn",
    default="any",
    callback=_sojourn,
    metavar="any|law|LOW..HIGH",
    show_default=True,
    help="How long stays last: any time, as the model's own laws allow, or LOW to HIGH seconds.",
)
@click.option(
    "--z", type=click.FloatRange(0), default=3.0, show_default=True, callback=finite, help="Standard deviations."
)
@click.option(
    "--inputs", multiple=True, callback=_inputs, metavar="SIGNAL=LOW..HIGH", help="Range of an input; may be repeated."
)
@click.option("--start", type=(float, float), metavar="LOW HIGH", help="Where runs begin (°C).")
@policy_option
@click.option("--known", is_flag=True, help="No gap ever: UNKNOWN, which leads to the initial location, never comes.")
@click.option(
    "--wear",
    type=click.FloatRange(0),
    callback=finite,
    metavar="DAYS",
    help="Follow a wear for so long; else 7 to 365.",
)
@click.option("--word", "out", type=click.Path(path_type=Path, dir_okay=False), help="Write the first counterexample.")
@json_option
def prove(**given: Any) -> None:
    """Verify a model's structure, and what its temperature can do under any sequence of events.

    Every check is proven, refuted with its evidence, or not decided. Leaves with 1 when the model is not deployable or
    was judged unfit where it was learned; a range given by --bounds must be proven too.
    `decanter model simulate MODEL --word ...` replays a counterexample.
    """
    from gateway.lab.checking.prove import prove as work

    work(**given)


@click.command(short_help="Let a model run along measured traces; say how far off it is.")
@click.argument("directory")
@trace_option
@click.option("--word", help="Instead of traces: a timed word, as 'W_ON@0 A_2@30 @600', or a file with one.")
@map_option
@click.option(
    "--runs", type=click.IntRange(2, 1_000_000), default=1000, show_default=True, help="Stochastic runs a trace."
)
@policy_option
@start_option
@seed_option
@picture_option
@json_option
def simulate(**options: Any) -> None:
    """Let a model run along measured traces (open loop) and say how far off it comes out.

    Errors are given at all readings, at the events (the thesis's way) and for the last reading, apart; the band is
    that of the stochastic runs, the sensor's noise included.

    With --word the model runs without noise and without clamps along a timed word, such as a counterexample of
    `decanter model judge proof`: each stay's m, inputs and temperature may stand behind its event (docs/checking.md).
    """
    from gateway.lab.checking.simulate import simulate as work

    work(**options)
