"""`decanter plc doctor`: whether this machine is fit for the plant."""

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform_at
from gateway.commission.plc_probe import show_steps
from gateway.console.output import sentences


@click.command()
@link_options
def doctor(given: Given) -> None:
    """Look at this machine before the plant: clock, network, serial ports, CAN, disk, files.

    With --config, --device or --host what they name is looked at too. Nothing is sent to any device.
    """
    with sentences():
        from gateway.commission.doctor import doctor as work
        from gateway.commission.records import check_writable
        from gateway.commission.target import Target, make_target

        anything = given.plant or given.device or given.link or given.settings
        target = make_target(given.plant, given.device, given.link, given.settings) if anything else None
        check_writable(given.records)
    place = target or Target("this machine", "", {})
    perform_at(place, given, "doctor", {}, lambda site: work(site, given.records), show_steps)
