"""`decanter plc plan`: how one scan is read, and whether it fits into its period."""

from collections.abc import Mapping
from typing import Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.console.output import table


@click.command()
@click.option("--period", type=click.FloatRange(0.01), help="Seconds between two scans.  [default: the plant file's]")
@link_options
def plan(given: Given, period: float | None) -> None:
    """The requests of one scan, and the longest time that they can take against the period; nothing is sent.

    The worst case is every request answered only just within its deadline, and the write-back's own requests besides.
    """
    from gateway.commission.planning import plan as work

    perform(given, "plan", {"period": period}, lambda site: work(site, period), _show)


def _names(request: Mapping[str, Any]) -> str:
    return "the block" if request["kind"] != "read" else ", ".join(request["tags"])


def _show(data: Mapping[str, Any]) -> None:
    if "sentences" in data:
        for line in data["sentences"]:
            click.echo(line)
        click.echo(f"{data['tags']} tags; period {data['period_s']:g} s")
        return
    rows = [
        (one["kind"], one["place"], one["reference"], one["count"], one["vain"] or "", _names(one))
        for one in (*data["requests"], *data["writes"])
    ]
    title = f"{len(data['requests'])} requests for {data['tags']} tags in {data['registers']} addresses"
    table(title, ("", "from", "reference", "count", "in vain", "tags"), rows)
    writing = f" + {data['worst_write_s']:.3g} s writing" if data["writes"] else ""
    used = 100.0 * data["worst_cycle_s"] / data["period_s"]
    click.echo(
        f"worst case {data['worst_read_s']:.3g} s reading{writing} = {data['worst_cycle_s']:.3g} s of a period of "
        f"{data['period_s']:g} s ({used:.0f} %)"
    )
    for problem in data["problems"]:
        click.secho(problem, fg="red")
