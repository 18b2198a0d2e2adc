"""`decanter model simulate`: a model let run along measured traces, and how far off it comes out; or along a word."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console.options import json_option, map_option, picture_option, seed_option
from gateway.console.output import emit, fail, progress, sentences, table
from gateway.console.traces import load

if TYPE_CHECKING:
    from sim.engine.open_loop import Start
    from sim.engine.schedule import Policy


@click.command(short_help="Let a model run along measured traces; say how far off it is.")
@click.argument("directory")
@click.option("--trace", "paths", multiple=True, help="A file, a folder or a glob; may be given again.")
@click.option("--word", help="Instead of traces: a timed word, as 'W_ON@0 A_2@30 @600', or a file with one.")
@map_option
@click.option(
    "--runs", type=click.IntRange(2, 1_000_000), default=1000, show_default=True, help="Stochastic runs a trace."
)
@click.option(
    "--policy",
    type=click.Choice(["reject", "ignore", "resync"]),
    default="resync",
    show_default=True,
    help="An event without an edge.",
)
@click.option(
    "--start", type=click.Choice(["measured", "law"]), default="measured", show_default=True, help="First temperature."
)
@seed_option
@picture_option
@json_option
def simulate(
    directory: str,
    paths: Sequence[str],
    word: str | None,
    map_name: str,
    runs: int,
    policy: "Policy",
    start: "Start",
    seed: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Let a model run along measured traces (open loop) and say how far off it comes out.

    Errors are given at all readings, at the events (the thesis's way) and for the last reading, apart; the band is
    that of the stochastic runs, the sensor's noise included.

    With --word the model runs without noise and without clamps along a timed word, such as a counterexample of
    `decanter model verify`: each stay's m, inputs and temperature may stand behind its event (docs/verification.md).
    """
    if bool(paths) == (word is not None):
        raise click.UsageError("give --trace or --word, one of the two")
    if word is not None:
        from gateway.lab.word import replay_word

        replay_word(directory, word, policy, as_json=as_json)
        return
    from gateway.lab.simulation import simulate_traces
    from sim.artefacts.find import find_model

    with sentences(), progress("simulating") as report:
        traces, column_map = load(paths, map_name)
        found = find_model(directory, alphabet=column_map.alphabet, temperature=column_map.temperature)
        chosen = found.runnable()
        rows = simulate_traces(
            chosen, traces, runs=runs, policy=policy, start=start, seed=seed, picture=picture, report=report
        )
    data = {"model": chosen.sha.name, "traces": rows, "picture": picture and str(picture)}
    emit(data, lambda: _show_rows(rows, picture), as_json_line=as_json)
    if any("error" in row for row in rows):
        fail("; ".join(str(row["error"]) for row in rows if "error" in row))


def _show_rows(rows: Sequence[Mapping[str, Any]], picture: Path | None) -> None:
    columns = ("trace", "events", "rmse", "mae", "rmse at events", "final", "coverage 90 %", "clamps", "flags")
    done = [[row[name] for name in columns] for row in rows if "error" not in row]
    if done:
        table("open loop (°C)", columns, done)
    if picture is not None:
        click.echo(f"picture: {picture}")
