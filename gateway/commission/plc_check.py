"""`decanter plc check`: the configuration on paper, and at the device."""

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.commission.plc_probe import show_steps


@click.command()
@click.option("--offline", is_flag=True, help="Only what can be checked without the device.")
@link_options
def check(given: Given, offline: bool) -> None:
    """Check files, places, limits, model and write-back contract; then read every tag, and see the heartbeat move."""
    from gateway.commission.checking import check as work

    perform(given, "check", {"offline": offline}, lambda site: work(site, offline=offline), show_steps)
