"""`decanter plc test`: what is written on purpose to see that the PLC's side of the write-back works."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from gateway.commission.session import CommandResult, SharedOptions, audit_option, link_options, perform
from gateway.commission.writeback.block_writer import BlockWriter, of_each_block, with_block_writers
from gateway.commission.writeback.conformance import conform_all, show_conformance
from gateway.commission.writeback.loop import alarm_loop, heartbeat_loop, show_alarms, show_heartbeats

Test = Callable[[Sequence[BlockWriter], Callable[[str, float], None]], Awaitable[CommandResult]]
TESTS: dict[str, tuple[Test, Callable[[Mapping[str, Any]], None], tuple[str, ...]]] = {
    "alarms": (of_each_block(alarm_loop), show_alarms, ("ask",)),
    "heartbeat": (of_each_block(heartbeat_loop), show_heartbeats, ("watchdog",)),
    "conformance": (conform_all, show_conformance, ("ask",)),
}
"""What can be tested -> the test, how its result is shown, and which of the command's options it takes."""


@click.command(short_help="Test the PLC's side: alarm bits, heartbeats, the contract; needs an arming.")
@click.argument("what", type=click.Choice(list(TESTS)))
@click.option("--ask", is_flag=True, default=None, help="alarms, conformance: put each question to the person here.")
@click.option("--watchdog/--no-watchdog", default=None, help="heartbeat: let the PLC's timer run out.  [default: yes]")
@audit_option
@link_options
def test(given: SharedOptions, what: str, audit: Path | None, **options: bool | None) -> None:
    """Test the PLC's side of the write-back. It writes, so it needs an arming (decanter plc arm).

    alarms sets each alarm bit alone, then none: the PLC has to accept the block, and the HMI to show it (--ask).
    heartbeat moves and checks both heartbeats; the PLC's timer runs out when the blocks cease. Blocks of both have
    validity 0, but for one that starts the timer, with a probability of 0 and no other number in it.

    conformance puts the PLC's side through the suite of the contract: whole, torn, wrong and late blocks, for about
    five times the PLC's timer. With --ask a person gives and takes the permit when the suite wants it.
    """
    work, show, taken = TESTS[what]
    for name, value in options.items():
        if value is not None and name not in taken:
            others = " and ".join(other for other, (_, _, names) in TESTS.items() if name in names)
            raise click.UsageError(f"--{name} is for {others}, not for {what}")
    ask, watchdog = bool(options["ask"]), options["watchdog"] is not False
    arguments = {"ask": ask} if "ask" in taken else {"watchdog": watchdog}
    if what == "heartbeat":
        work = of_each_block(partial(heartbeat_loop, watchdog=watchdog))
    perform(given, f"test {what}", arguments, with_block_writers(given, audit, f"test {what}", work, ask=ask), show)
