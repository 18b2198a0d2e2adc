"""`decanter plc soak`: the same scan again and again, as the gateway will do it."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.console.output import progress, table

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site


@click.command()
@click.option("--seconds", type=click.FloatRange(0.1), default=60.0, show_default=True, help="For how long.")
@click.option("--period", type=click.FloatRange(0.01), help="Seconds between two scans.  [default: the plant file's]")
@click.option("--record", type=click.Path(path_type=Path), help="Keep the readings in this CSV, one row a scan.")
@link_options
def soak(given: Given, seconds: float, period: float | None, record: Path | None) -> None:
    """Scan all tags for a while, as the gateway will: times of a scan, losses, and the period to be recommended.

    Fails if a tag was not good or a tick was missed. Ctrl-C ends it early with what there is.
    """

    async def work(site: "Site") -> "Outcome":
        from gateway.commission.soaking import soak as work

        with progress("soak") as report:
            return await work(site, seconds, period, record, report)

    arguments = {"seconds": seconds, "period": period, "record": record and str(record)}
    perform(given, "soak", arguments, work, _show)


def _show(data: Mapping[str, Any]) -> None:
    if not data["scans"]:
        return
    kinds = (("scan", "scan_ms"), ("age of a reading", "age_ms"))
    rows = [(name, *data[key].values()) for name, key in kinds if data.get(key)]
    click.echo(f"{data['scans']} scans every {data['period_s']:g} s, {data['missed']} ticks missed")
    table("", ("ms", "p50", "p95", "max"), rows)
    counts = f"{data['timeouts']} timeouts, {data['mismatches']} wrong replies, {data['reconnects']} reconnections"
    click.echo(f"{data['scans_with_bad']} scans had a tag that was not good; {counts}")
    for tag, times in list(data["bad_tags"].items())[:10]:
        click.echo(f"  {tag}: {times} times")
    for reason, times in data["reasons"].items():
        click.echo(f"  {times} x {reason}")
    if data["recommended_period_s"]:
        click.echo(f"recommended period: {data['recommended_period_s']:g} s or longer")
    if data["recording"]:
        click.echo(f"recording: {data['recording']}")
