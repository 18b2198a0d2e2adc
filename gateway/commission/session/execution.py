"""How every `decanter plc` command is carried out: found, tapped, timed, recorded, shown, and its exit code given."""

import asyncio
import getpass
import platform
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from drivers.errors import DriverError
from drivers.tap import tap_frames
from gateway.commission.options import SharedOptions
from gateway.commission.session.evidence import FrameEvidence
from gateway.commission.session.records import CommandRecord, append, check_writable, file_hashes, versions
from gateway.commission.session.site import Site
from gateway.commission.session.target import Target, make_target
from gateway.console import CommandResult, Part, View, conclude
from gateway.entry import Exit, exit_code, sentence, sentences
from gateway.settings import load_plant

Work = Callable[[Site], Awaitable[CommandResult]]


def perform(
    given: SharedOptions,
    command: str,
    arguments: Mapping[str, Any],
    work: Work,
    view: View,
    *,
    target: Target | None = None,
) -> None:
    """Find the device, do the work on it with all frames told to the evidence, record it, show it, leave with its code.

    `view` is what a person sees of the result's data; with --json it is one object with `ok`, `exit`, `frames`,
    `exchanges` and `notes` besides. What device and link do wrong is a sentence, an exit code and a record, never a
    traceback.
    `target` is the device where the command has found it already.
    """
    with sentences():
        target = find_target(given) if target is None else target
        check_writable(given.records)
    begun, clock = time.time(), time.monotonic()
    with sentences(), closing(FrameEvidence(given.pcap, target.medium)) as evidence:
        site = Site(target, evidence)
        outcome = _run_work(site, work)
    seconds = time.monotonic() - clock
    record = CommandRecord(
        time=begun,
        seconds=seconds,
        command=command,
        arguments=arguments,
        place=target.place,
        code=outcome.code,
        reason=outcome.complaint,
        result={**outcome.data, "exchanges": site.exchanges.plain(), "notes": site.notes},
        frames=evidence.plain(),
        configuration=file_hashes(target.files),
        versions=versions(),
        who=given.by or login(),
        machine=platform.node(),
    )
    with sentences():
        append(given.records, record)
    extra = {"exchanges": site.exchanges.plain(), "frames": evidence.plain(), "notes": site.notes}
    reason = {"reason": outcome.complaint} if outcome.complaint else {}
    whole = {"exit": int(outcome.code), **outcome.data, **extra, **reason}

    def all_parts(_: Mapping[str, Any]) -> Iterator[Part]:
        if set(outcome.data) - {"reason"}:
            if target.place:
                yield target.place
            yield from view(outcome.data)
        yield from (f"note: {note}" for note in site.notes)
        if site.exchanges.asked or site.exchanges.heard:
            yield site.exchanges.line()
        if given.pcap is not None:
            yield f"evidence: {given.pcap} ({evidence.sent} frames sent, {evidence.received} received)"

    conclude(replace(outcome, data=whole), all_parts, as_json=given.as_json)


def find_target(given: SharedOptions) -> Target:
    """The device that the options name. Raises TargetError or ConfigError."""
    return make_target(given.plant, given.device, given.link, given.settings, given.machine)


def audit_path(audit: Path | None, given: SharedOptions, target: Target | None = None) -> Path:
    """The audit log: the one that is named, the plant file's, or the one beside the records. Raises ConfigError."""
    if audit is None and target is not None:
        audit = target.audit
    elif audit is None and given.plant is not None:
        audit = load_plant(given.plant)[0].audit
    return audit if audit is not None else given.records.with_name("audit.sqlite")


def _run_work(site: Site, work: Work) -> CommandResult:
    """The work's outcome; what goes wrong on the way is one too."""

    async def start() -> CommandResult:  # asyncio.run wants a coroutine, and `work` may give any awaitable
        return await work(site)

    try:
        with tap_frames(site.evidence.take):
            return asyncio.run(start())
    except (DriverError, ValueError, OSError) as error:
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().params.get("traceback"):
            raise
        return CommandResult({"reason": sentence(error)}, sentence(error), exit_code(error))
    except KeyboardInterrupt:
        return CommandResult({"reason": "interrupted"}, "interrupted", Exit.INTERRUPTED)


def login() -> str:
    """The name under which this user is logged in."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"
