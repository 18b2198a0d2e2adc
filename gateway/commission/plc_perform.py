"""How every `decanter plc` command is carried out: found, tapped, timed, recorded, shown, and its exit code given."""

import asyncio
import getpass
import platform
import sys
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any

import click

from drivers.errors import DriverError
from gateway.commission.plc_options import Given
from gateway.console.output import Exit, exit_code, fail, sentence, sentences
from sim.strict_json import json_text

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site
    from gateway.commission.target import Target

Work = Callable[["Site"], Awaitable["Outcome"]]
Show = Callable[[Mapping[str, Any]], None]


def perform(given: Given, command: str, arguments: Mapping[str, Any], work: Work, show: Show) -> None:
    """Find the device, do the work on it with all frames told to the evidence, record it, show it, leave with its code.

    `show` prints the outcome's data for a person; with --json it is one object with `ok`, `exit`, `frames`, `exchanges`
    and `notes` besides. What device and link do wrong is a sentence, an exit code and a record, never a traceback.
    """
    with sentences():
        from gateway.commission.records import check_writable
        from gateway.commission.target import make_target

        target = make_target(given.plant, given.device, given.link, given.settings)
        check_writable(given.records)
    perform_at(target, given, command, arguments, work, show)


def perform_at(
    target: "Target", given: Given, command: str, arguments: Mapping[str, Any], work: Work, show: Show
) -> None:
    """As `perform`, where the device is found already."""
    from gateway.commission.evidence import Evidence
    from gateway.commission.outcome import Site

    begun, clock = time.time(), time.monotonic()
    with sentences(), closing(Evidence(given.pcap, target.medium)) as evidence:
        site = Site(target, evidence)
        outcome = _done(site, work)
    seconds = time.monotonic() - clock
    with sentences():
        _record(site, given, command, arguments, outcome, (begun, seconds))
    _show(site, given, outcome, show)
    if outcome.code:
        fail(outcome.complaint, outcome.code) if outcome.complaint else sys.exit(outcome.code)


def _done(site: "Site", work: Work) -> "Outcome":
    """The work's outcome; what goes wrong on the way is one too."""
    from drivers.tap import listening
    from gateway.commission.outcome import Outcome

    try:
        with listening(site.evidence.take):
            return asyncio.run(_awaited(work, site))
    except (DriverError, ValueError, OSError) as error:
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().params.get("traceback"):
            raise
        return Outcome({"reason": sentence(error)}, exit_code(error), sentence(error))
    except KeyboardInterrupt:
        return Outcome({"reason": "interrupted"}, Exit.INTERRUPTED, "interrupted")


async def _awaited(work: Work, site: "Site") -> "Outcome":
    return await work(site)


def _record(
    site: "Site",
    given: Given,
    command: str,
    arguments: Mapping[str, Any],
    outcome: "Outcome",
    when: tuple[float, float],
) -> None:
    from gateway.commission.records import Record, append, file_hashes, versions

    append(
        given.records,
        Record(
            time=when[0],
            seconds=when[1],
            command=command,
            arguments=arguments,
            place=site.target.place,
            code=outcome.code,
            reason=outcome.complaint,
            result={**outcome.data, "exchanges": site.exchanges.plain(), "notes": site.notes},
            frames=site.evidence.plain(),
            configuration=file_hashes(site.target.files),
            versions=versions(),
            who=given.by or login(),
            machine=platform.node(),
        ),
    )


def login() -> str:
    """The name under which this user is logged in."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"


def _show(site: "Site", given: Given, outcome: "Outcome", show: Show) -> None:
    if given.as_json:
        extra = {"exchanges": site.exchanges.plain(), "frames": site.evidence.plain(), "notes": site.notes}
        click.echo(json_text({"ok": not outcome.code, "exit": int(outcome.code), **outcome.data, **extra}))
        return
    if set(outcome.data) - {"reason"}:
        if site.target.place:
            click.echo(site.target.place)
        show(outcome.data)
    for note in site.notes:
        click.echo(f"note: {note}")
    if site.exchanges.asked or site.exchanges.heard:
        click.echo(site.exchanges.line())
    if given.pcap is not None:
        click.echo(f"evidence: {given.pcap} ({site.evidence.sent} frames sent, {site.evidence.received} received)")
