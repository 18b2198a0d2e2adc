"""`decanter plc verify`: the PLC's values against the HMI's, from a list or by questions."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.console.output import table

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site

_FILE = click.Path(path_type=Path)


@click.command()
@click.option("--against", "listed", type=_FILE, help="Readings of the HMI (CSV, XLSX): tag, value and, if any, time.")
@click.option("--only", multiple=True, metavar="TAG", help="Only this tag; may be given again.")
@click.option("--readings", type=_FILE, help="For readings with times: what was recorded (soak --record, historian).")
@click.option("--within", type=click.FloatRange(0), default=2.0, show_default=True, help="Seconds around such a time.")
@click.option("--clock-offset", type=float, default=0.0, help="Seconds by which the HMI's clock is ahead.")
@click.option("--tolerance", "slack", type=click.FloatRange(0), default=0.0, help="Engineering units beside rounding.")
@click.option("--complete", is_flag=True, help="Fail as long as a tag is not proved.")
@click.option("--anew", is_flag=True, help="Do not count what earlier verifications proved.")
@link_options
def verify(
    given: Given,
    listed: Path | None,
    only: tuple[str, ...],
    readings: Path | None,
    within: float,
    clock_offset: float,
    slack: float,
    complete: bool,
    anew: bool,
) -> None:
    """Compare with the HMI until each number was right at two distinct values, each flag in both states.

    With --against the readings come from a list: one row a reading, or one column a tag. Without it each tag is asked
    for, round by round. What was proved before counts as long as the tag lies where it lay (see --anew).
    """

    async def work(site: "Site") -> "Outcome":
        from gateway.commission.verifying import against, by_questions, earlier, to_prove

        tags, before = to_prove(site, only), [] if anew else earlier(given.records)
        if listed is None:
            return await by_questions(site, tags, before, _ask, _tell, slack=slack, complete=complete)
        past: dict[str, Any] = {"readings": readings, "within": within, "clock_offset": clock_offset}
        return await against(site, listed, tags, before, slack=slack, complete=complete, **past)

    arguments = {
        "against": listed and str(listed),
        "only": list(only),
        "tolerance": slack,
        "clock_offset": clock_offset,
    }
    perform(given, "verify", arguments, work, _show)


def _ask(question: str) -> str:
    """One line from the person; the end of the input is `q`."""
    try:
        return str(click.prompt(question, default="", show_default=False, err=True))
    except click.Abort:
        return "q"


def _tell(sentence: str) -> None:
    click.echo(sentence, err=True)


def _show(data: Mapping[str, Any]) -> None:
    rows = [
        ("agrees" if one["ok"] else "NOT", one["tag"], one["shown"], _text(one["read"]), one["reason"])
        for one in data["points"]
    ]
    if rows:
        table(f"{sum(one['ok'] for one in data['points'])} of {len(rows)} agree", _COLUMNS, rows)
    click.echo(f"{data['proved']} of {data['tags']} tags are proved")
    for name, todo in data["left"].items():
        click.echo(f"  {name}: {todo}")


_COLUMNS = ("", "tag", "HMI", "PLC", "why")


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:.7g}" if isinstance(value, float) else str(value)
