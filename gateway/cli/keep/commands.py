"""The options of `decanter keep` and their help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.cli.plant.options import by_option, config_option
from gateway.console import json_option

_history_option = click.option(
    "--history",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="The folder of the kept configurations.  [default: configurations/ beside the historian]",
)


@click.command(short_help="Copy all that a gateway is into a new folder, while it runs.")
@click.argument("folder", type=click.Path(path_type=Path))
@config_option
@json_option
def backup(**options: Any) -> None:
    """Copy all that a gateway is into the new FOLDER, while it runs: plant file, device files, models, historian (with
    guards and states), the page's accounts, audit log with its key and signed heads.

    The folder is there whole or not at all, with the SHA-256 of each file. It holds the key: keep it as such. The log,
    certificates and other programs' files are not in it.
    """
    from gateway.cli.keep.backup import backup as work

    work(**options)


@click.command(short_help="Put a backup's files back in their places.")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--into", type=click.Path(path_type=Path), default=Path("/"), help="Another root than / for all places.")
@click.option("--overwrite", is_flag=True, help="Set aside what stands in the places, and put the backup's there.")
@click.option("--by", default="", envvar="DECANTER_BY", help="Who restores, for the audit log.  [default: the login]")
@click.option(
    "--seal", default="", metavar="HASH", help="The seal that `decanter keep backup` printed for this backup."
)
@click.option(
    "--public-key",
    type=click.Path(path_type=Path),
    help="A copy of the gateway's public key.  [default: the key that the gateway holds]",
)
@json_option
def restore(**options: Any) -> None:
    """Put the files of the backup in FOLDER back where they were (below --into), after every one was looked at.

    Somebody has to vouch for it: it is signed by the key that the gateway holds, or by the key of --public-key, or its
    --seal is given by hand. Nothing is written but what the plant file in it names.

    A backup that is damaged, partial or made by a newer program is refused, and so is one whose gateway runs. What is
    restored is never armed: the audit log gets a row that disarms it, and mode 'armed' in the plant file becomes
    'shadow'.
    """
    from gateway.cli.keep.backup import restore as work

    work(**options)


@click.command(short_help="Put what support needs into one file, without secrets.")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False), required=False)
@config_option
@json_option
def support(**options: Any) -> None:
    """Write FILE (decanter-support-TIME.zip by default): versions, configuration, status, log, alarms, records, disk,
    clock. What cannot be had is said in its place, so that it works where nothing else does.

    Passwords, tokens and web hooks' addresses are masked; keys, accounts, readings and models are not in it. Look
    through it before you send it: it is a ZIP of text files.
    """
    from gateway.cli.keep.support import support as work

    work(**options)


@click.command(short_help="List the configurations that were taken over.")
@config_option
@_history_option
@json_option
def history(**options: Any) -> None:
    """List the configurations that a gateway has taken over at a start or a reload, the newest last. Times are UTC."""
    from gateway.cli.keep.configurations import history as work

    work(**options)


@click.command(short_help="Show what differs between two configurations, or to the files now.")
@click.argument("old", type=int, required=False)
@click.argument("new", type=int, required=False)
@config_option
@_history_option
def diff(**options: Any) -> None:
    """Show what differs between the configurations OLD and NEW; without NEW to the files as they are now, without OLD
    from the newest one that was taken over.
    """
    from gateway.cli.keep.configurations import diff as work

    work(**options)


@click.command(short_help="Put the files of a former configuration back, never armed.")
@click.argument("number", type=int)
@click.option("--reason", required=True, help="Why, for the history.")
@by_option
@config_option
@_history_option
@json_option
def rollback(**options: Any) -> None:
    """Put the plant and device files of configuration NUMBER back, and let a running gateway take them over.

    What is in the files now is kept first. A configuration that cannot be used any more is refused, and nothing is
    changed then; one that was armed comes back as 'shadow'.
    """
    from gateway.cli.keep.configurations import rollback as work

    work(**options)
