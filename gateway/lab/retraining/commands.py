"""The options of what learns while the plant runs and its help; the work is loaded when it is asked for."""

from math import inf
from pathlib import Path
from typing import Any

import click

from gateway.console import historian_machine_option, json_option, map_option, seed_option
from gateway.lab.options import RATINGS, historian_option, library_option
from sim.error_limits import RED, YELLOW


def _search(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, float | None] | None:
    """(trials, S in per cent above which they are made or None) of TRIALS[:PERCENT]."""
    if text is None:
        return None
    trials, colon, percent = text.partition(":")
    try:
        search = int(trials), float(percent) if colon else None
    except ValueError:
        search = 0, None
    if search[0] < 1 or not (search[1] is None or 0.0 <= search[1] < inf):
        raise click.BadParameter(
            f"{text!r} is not TRIALS or TRIALS:PERCENT, a whole number from 1 on and a percentage from 0 on, as 30:8"
        )
    return search


@click.command("retrain", short_help="Learn from the historian's new cycles; propose a version that is better.")
@click.argument("store", type=click.Path(path_type=Path, file_okay=False))
@historian_option
@historian_machine_option
@click.option("--since", help="A new library begins here: a time (2026-03-01T06:00) or a span (30d)  [everything].")
@library_option
@click.option("--standard", multiple=True, help="Traces that a new model must not be worse on; may be given again.")
@click.option("--traces", "former", multiple=True, help="Traces of earlier training to learn from as well.")
@map_option
@click.option("--method", type=click.Choice(["bins", "lsha"]), help="  [the present version's]")
@click.option(
    "--rows", type=click.IntRange(1000), default=600_000, show_default=True, help="Scans to learn from at most."
)
@click.option(
    "--tune",
    "search",
    metavar="TRIALS[:PERCENT]",
    callback=_search,
    help="Search settings in so many trials where performance has fallen: S above PERCENT of the readings, "
    "else a fifth of the new cycles badly predicted.",
)
@click.option("--no-diagnosis", is_flag=True, help="Do not look for what the new model still lacks.")
@click.option(
    "--if-due", is_flag=True, help="Only on drift, S above --tune's, --after new cycles that teach, or --every days."
)
@click.option(
    "--after", type=click.IntRange(1), default=10, show_default=True, help="New cycles that are not ordinary."
)
@click.option("--every", type=click.FloatRange(0.0, min_open=True), help="Days after which it is due in any case.")
@click.option(
    "--yellow", type=click.FloatRange(0.0), default=YELLOW, show_default=True, help="Relative error of a class."
)
@click.option("--red", type=click.FloatRange(0.0), default=RED, show_default=True, help="Relative error of a class.")
@click.option("--full-speed", is_flag=True, help="Do not leave the processor to all others.")
@seed_option
@json_option
def retrain_command(**given: Any) -> None:
    """Learn from the historian's new cycles, hold the new model against the current version of STORE, propose it.

    The historian is cut into cycles, each is rated, and those that teach are kept in the library. A new model is
    learned beside the current one; both forecast the new cycles that were held out, and the standard set. If the new
    one is better by a paired test at some horizon, worse at none, and verifies, it becomes a version of the store that
    a person may promote. Nothing else changes: the current version keeps running. A retraining that was stopped or
    killed goes on with the same command.
    """
    from gateway.lab.retraining.retrain import retrain_command as work

    work(**given)


@click.command("cycles", short_help="List a library's cycles, rated; exclude one with a reason.")
@click.argument("folder", metavar="LIBRARY", type=click.Path(path_type=Path, file_okay=False))
@click.option("--rating", type=click.Choice(RATINGS), help="Only those rated so.")
@click.option("--exclude", metavar="NAME", help="Learn nothing from this cycle and judge nothing by it; with --reason.")
@click.option("--reason", help="Why: work on the sensor, cleaning, a test.")
@click.option("--by", help="Who excludes it.")
@click.option("--include", metavar="NAME", help="Take back that a cycle is excluded.")
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="A map of what the plant did.")
@json_option
def cycles_command(**given: Any) -> None:
    """List the cycles that retrainings have cut from the historian, the newest last, with what is remarkable in each.

    A cycle that a person excludes stays in the list with name and reason; nothing is learned from it or judged by it.
    """
    from gateway.lab.retraining.cycles import cycles_command as work

    work(**given)


@click.command("lineage", short_help="Draw the family of a store's versions; make one again.")
@click.argument("store", type=click.Path(path_type=Path, file_okay=False))
@click.option("--remake", "version", help="Learn this version again and compare it bit for bit.")
@click.option("--library", "folder", type=click.Path(path_type=Path), help="Where the cycles of its record are kept.")
@click.option("--traces", "former", multiple=True, help="Traces of its record that no library has.")
@map_option
@json_option
def lineage_command(**given: Any) -> None:
    """Draw which version of STORE was learned beside which, from how much, and which of them runs.

    --remake learns a version again from its record: traces by their hash, settings, seed. The exit code is 1 where the
    result is another model, and the sentence says what differs: the program, or what it runs on.
    """
    from gateway.lab.retraining.lineage import lineage_command as work

    work(**given)


@click.command("shadow", short_help="Compare two versions on live cycles; promote the better one by a stated policy.")
@click.argument("store", type=click.Path(path_type=Path, file_okay=False))
@click.argument("version", required=False)
@historian_option
@historian_machine_option
@library_option
@click.option("--roll-back", is_flag=True, help="Promote VERSION again where the current one is worse than it.")
@click.option("--promote", "promotes", is_flag=True, help="Promote the candidate VERSION where it is the better one.")
@seed_option
@json_option
def shadow_command(**given: Any) -> None:
    """Hold the current version of STORE against VERSION on the cycles since the younger of them was made.

    VERSION is a candidate that waits for its promotion, or the one that ran before, which is the default: then
    --roll-back promotes it again if the current one is worse on live cycles by the paired test. With --promote a
    candidate is promoted if it is better by that test at some horizon and worse at none, once, on the live cycles of
    its first seven days, day against day. Neither version has been learned from these cycles.
    """
    from gateway.lab.retraining.shadow import shadow_command as work

    work(**given)
