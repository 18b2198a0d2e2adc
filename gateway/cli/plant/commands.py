"""The options of what is done with a plant and its gateway, and their help; the work is loaded when it is asked for."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from gateway.cli.plant.options import by_option, config_option, machine_option
from gateway.commission.options import DRY_RUN
from gateway.console import json_option, socket_option
from gateway.entry import Exit
from gateway.outside.status import Health
from gateway.outside.web.access import ROLES, AccountRole
from gateway.store import TABLE_COLUMNS

REFRESH_S = 0.5
EXITS: dict[Health, tuple[Exit, str]] = {
    Health.WELL: (Exit.OK, "readings arrive and no check finds anything"),
    Health.ATTENTION: (
        Exit.CHECK_FAILED,
        "an alarm, a reading, the model, the write-back, the records, a part, the clock, the device",
    ),
    Health.ABSENT: (Exit.CANNOT_CONNECT, "no gateway runs with this plant file"),
    Health.NO_READINGS: (Exit.DEVICE_EXCEPTION, "it runs, and its device gives no good reading"),
    Health.SILENT: (Exit.TIMEOUT, "it is there and does not answer"),
}
"""The exit code of `decanter top --once` by the gateway's health, and when it is that."""
_EXIT_CODES = "; ".join(f"{code:d} {word}: {when}" for word, (code, when) in EXITS.items())
_HELP = f"""\
Watch a running gateway until Ctrl-C: value, age, quality, state, prediction, alarms, records, arming.

On a terminal a panel, elsewhere three lines and then one for each change. An old number is never shown as a present
one: without an answer the panel says so, and for how long. Several may watch one gateway.

With --once there is one look. Its exit codes: {_EXIT_CODES}.
"""
_since_option = click.option(
    "--since", default="1d", show_default=True, help="A time (2026-03-01T06:00, UTC), a span back (7d, 36h), or `all`."
)
_until_option = click.option("--until", default=None, help="A time (UTC).  [default: the newest scan, and after]")
_tag_option = click.option("--tag", default=None, metavar="TAG", help="Only this tag's rows, or this alarm's.")


def _names(required: bool = True) -> Callable[[Any], Any]:
    return click.argument("names", nargs=-1, required=required, metavar="NAME...")


def _signed(command: Any) -> Any:
    """The command with a person and a reason, a plant file and a machine."""
    reason_option = click.option("--reason", required=True, help="Why, for the audit log and the journal.")
    return by_option(reason_option(config_option(machine_option(json_option(command)))))


@click.command(short_help="Run the gateway with a configuration file.")
@config_option
@click.option("--host", help="Instead of device.host.")
@click.option("--port", type=click.IntRange(1, 65535), help="Instead of device.port.")
@click.option(
    "--clock",
    "clock_text",
    metavar="EPOCH,MONOTONIC,SPEED",
    help="The clock of a replay, as the software PLC announces it.",
)
@click.option(
    "--status", type=click.Path(path_type=Path), help="Rewrite this file with the present state (one line of JSON)."
)
@click.option("--watch", is_flag=True, help="Show the live panel, as `decanter top` does; lines off a terminal.")
@click.option("--quiet", is_flag=True, help="Log to the file only.")
@click.option("--stdin", is_flag=True, help="Also stop when standard input ends, as it does when the parent is gone.")
def run(**options: Any) -> None:
    """Run the gateway until it is told to stop (SIGTERM or Ctrl-C).

    It begins with three lines (model, PLC, records) and says each change of state in one line on standard output.
    Other events of the log go to standard error. SIGHUP, sent to a gateway that runs off a terminal, has it read its
    configuration anew, as `decanter reload` does.
    """
    from gateway.cli.plant.run import run as work

    work(**options)


@click.command(short_help="Watch a running gateway; --once: one look, and an exit code.", help=_HELP)
@config_option
@machine_option
@click.option("--watch/--once", "watches", default=True, show_default=True, help="Until Ctrl-C, or one look.")
@click.option(
    "--every",
    type=click.FloatRange(0.1, 60.0),
    default=REFRESH_S,
    show_default=True,
    help="Seconds between two looks.",
)
@socket_option
@json_option
def top(**options: Any) -> None:
    """Watch a running gateway, or look once."""
    from gateway.cli.plant.top import top as work

    work(**options)


@click.command(short_help="Let a running gateway read its plant file anew.")
@config_option
@click.option("--dry-run", is_flag=True, help="Only say what would change.")
@socket_option
@json_option
def reload(**options: Any) -> None:
    """Let the running gateway read its plant file anew; machines that it does not touch lose no scan.

    A file that cannot be used is refused, and so is a change of what all machines have in common; the former
    configuration goes on then. What the next start would go without, as a file that it reads is damaged, is said too.
    """
    from gateway.cli.plant.reload import reload as work

    work(**options)


@click.command("list", short_help="List the alarms that are not normal, the most urgent first.")
@click.option("--all", "every", is_flag=True, help="Those that are normal too.")
@config_option
@machine_option
@json_option
def list_alarms(**options: Any) -> None:
    """List the alarms that are not normal, the most urgent first, with what an operator shall do. Times are UTC.

    Exit code 1 where one waits for an acknowledgement or stands.
    """
    from gateway.cli.plant.alarms import list_alarms as work

    work(**options)


@click.command(short_help="Show one alarm: what it watches, what to do, what comes of not doing it.")
@click.argument("name")
@config_option
@machine_option
@json_option
def show_alarm(**options: Any) -> None:
    """Show the alarm NAME: its state, what it watches, what an operator shall do, what comes of not doing it."""
    from gateway.cli.plant.alarms import show as work

    work(**options)


def _change(kind: str, options: Mapping[str, Any]) -> None:
    from gateway.cli.plant.alarms import change as work
    from gateway.machine.alarms import Change

    work(Change(kind), **options)


@click.command(short_help="Say that you know: of the named alarms, or of all that wait.")
@_names(required=False)
@by_option
@click.option("--reason", default="", help="A remark, for the audit log and the journal.")
@config_option
@machine_option
@json_option
def acknowledge(**options: Any) -> None:
    """Acknowledge the alarms NAME..., or all of the machine that wait for it."""
    _change("acknowledge", options)


@click.command(short_help="Put alarms aside for some minutes.")
@_names()
@click.option(
    "--minutes", type=click.FloatRange(0, min_open=True), required=True, help="For how long (alarms.longest_shelving)."
)
@_signed
def shelve(**options: Any) -> None:
    """Put the alarms NAME... aside: neither shown nor sent until the time is over, when what stands is raised anew."""
    _change("shelve", options)


@click.command(short_help="Take alarms back before their time is over.")
@_names()
@_signed
def unshelve(**options: Any) -> None:
    """Take the shelved alarms NAME... back before their time is over."""
    _change("unshelve", options)


@click.command(short_help="Take alarms out for work on what they watch.")
@_names()
@_signed
def remove_from_service(**options: Any) -> None:
    """Take the alarms NAME... out of service: neither shown nor sent until they are returned."""
    _change("remove from service", options)


@click.command(short_help="Return alarms to service.")
@_names()
@_signed
def return_to_service(**options: Any) -> None:
    """Return the alarms NAME... to service; what stands is raised anew."""
    _change("return to service", options)


@click.command(short_help="Let go of latched alarms.")
@_names()
@_signed
def reset(**options: Any) -> None:
    """Let go of the latched alarms NAME..., which are over and acknowledged."""
    _change("reset", options)


@click.command(short_help="Show what alarms did, and who did what with them.")
@click.option("--since", default="8h", show_default=True, help="A time (2026-03-01T06:00, UTC) or a span back (7d).")
@config_option
@machine_option
@json_option
def journal(**options: Any) -> None:
    """Show every change of an alarm with its person and reason, in order. Times are UTC."""
    from gateway.cli.plant.alarms import journal as work

    work(**options)


@click.command(short_help="Hold the alarms against what a person can deal with (EEMUA 191).")
@click.option("--since", default="7d", show_default=True, help="A time (2026-03-01T06:00, UTC) or a span back (8h).")
@config_option
@machine_option
@json_option
def rates(**options: Any) -> None:
    """Count the alarms up to the newest scan: average, peak, floods, chattering, standing, stale, priorities.

    Of several machines all are counted together, as one person has to deal with them. Exit code 1 where it is more
    than a person can deal with.
    """
    from gateway.cli.plant.alarms import rates as work

    work(**options)


@click.command(short_help="Write a table of the records as CSV or Parquet.")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--table",
    "name",
    type=click.Choice(list(TABLE_COLUMNS)),
    default="samples",
    show_default=True,
    help="Which; `decanter historian tables` describes them.",
)
@_tag_option
@_since_option
@_until_option
@config_option
@machine_option
@json_option
def export(**options: Any) -> None:
    """Write rows of the records to FILE, which ends in .csv or .parquet (needs the package decanter-gateway-parquet).

    The file is there whole or not at all. Rows come machine by machine, in the order in which they were recorded; times
    are UTC.
    """
    from gateway.cli.plant.records import export as work

    work(**options)


@click.command(short_help="Show the newest rows of a table, or a tag's means.")
@click.argument("name", metavar="TABLE", type=click.Choice(list(TABLE_COLUMNS)))
@_tag_option
@_since_option
@_until_option
@click.option("--last", type=click.IntRange(1, 100_000), default=20, show_default=True, help="How many rows.")
@click.option(
    "--every",
    type=click.Choice(["60", "3600"]),
    default=None,
    help="Instead of rows a tag's count, least, mean and greatest value of each minute or hour.",
)
@config_option
@machine_option
@json_option
def query(**options: Any) -> None:
    """Show the newest rows of TABLE: samples, predictions, forecasts, events or alarms. Times are UTC."""
    from gateway.cli.plant.records import query as work

    work(**options)


@click.command(short_help="List the tables and what their columns mean.")
@json_option
def tables(**options: Any) -> None:
    """List the tables of `decanter historian export`, which are those of the PostgreSQL sink too."""
    from gateway.cli.plant.records import tables as work

    work(**options)


@click.command("list", short_help="List the machines, and how they are where a gateway runs.")
@config_option
@json_option
def list_machines(**options: Any) -> None:
    """List the machines with their devices and temperatures, and how they are where the gateway runs."""
    from gateway.cli.plant.machines import list_machines as work

    work(**options)


@click.command(short_help="Add a machine to the plant file.")
@click.argument("name")
@click.option("--host", help="Its PLC's name or address.")
@click.option("--port", type=click.IntRange(1, 65535), help="Its TCP port.")
@click.option("--unit", type=click.IntRange(0, 255), help="Its Modbus unit, behind a gateway for several.")
@click.option("--node", type=click.IntRange(1, 127), help="Its CANopen node.")
@click.option("--device", "device_file", help="Its device file, relative to the plant file; the common one without it.")
@click.option(
    "--temperature", "temperatures", multiple=True, metavar="TAG[=MODEL]", help="A temperature that is predicted."
)
@config_option
@DRY_RUN
@json_option
def add_machine(**options: Any) -> None:
    """Add the machine NAME to the plant file; what is not given is as for the others."""
    from gateway.cli.plant.machines import add as work

    work(**options)


@click.command(short_help="Take a machine out of the plant file; its records stay.")
@click.argument("name")
@config_option
@DRY_RUN
@json_option
def remove_machine(**options: Any) -> None:
    """Take the machine NAME out of the plant file; its records stay."""
    from gateway.cli.plant.machines import remove as work

    work(**options)


@click.command(short_help="Make an account; its password is asked for.")
@click.argument("name")
@click.option(
    "--role",
    type=click.Choice([role.value for role in AccountRole]),
    required=True,
    help="; ".join(f"{role}: {meaning}" for role, meaning in ROLES.items()) + ".",
)
@config_option
def add_account(**options: Any) -> None:
    """Make an account NAME for the page. There is none at first, and no password that anybody knows.

    The password is asked for twice at a terminal, and is one line of standard input elsewhere: 12 to 128 characters.
    """
    from gateway.cli.plant.accounts import add as work

    work(**options)


@click.command("list", short_help="List the accounts and what each may do.")
@config_option
@json_option
def list_accounts(**options: Any) -> None:
    """List the accounts of the page, with their roles."""
    from gateway.cli.plant.accounts import list_accounts as work

    work(**options)


@click.command(short_help="Give an account another password; its sessions end.")
@click.argument("name")
@config_option
def change_password(**options: Any) -> None:
    """Give the account NAME another password; whoever is logged in with it is logged out."""
    from gateway.cli.plant.accounts import password as work

    work(**options)


@click.command(short_help="Remove an account; its sessions end.")
@click.argument("name")
@config_option
def remove_account(**options: Any) -> None:
    """Remove the account NAME; whoever is logged in with it is logged out."""
    from gateway.cli.plant.accounts import remove as work

    work(**options)
