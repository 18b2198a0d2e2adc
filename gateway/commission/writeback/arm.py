"""`decanter arm` and `disarm`: in the gateway that runs, or in the audit log where none does."""

import asyncio
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import click

from drivers.errors import DriverError
from gateway.commission.options import SharedOptions
from gateway.commission.session import (
    Site,
    Target,
    audit_path,
    find_period,
    format_moment,
    gateway_target,
    login,
    perform,
    running_gateway,
)
from gateway.commission.writeback.block_writer import gateway_runs, open_block_writers, require_layouts
from gateway.console import CommandResult, Line, Part
from gateway.entry import sentences
from gateway.machine.writing import (
    ArmingError,
    arm_in_log,
    clear_for_arming,
    countersign,
    disarm_in_log,
    find_places,
    next_start,
    sign_arming,
    uptime,
)
from gateway.store import DISARMED, EXPIRED, AuditError, given_words, head, open_audit

_TAKEN_S, _TAKEN_PERIODS, _LOOK_S = 10.0, 3.0, 0.1
"""How long, in seconds or in scans, a running gateway has to find a disarming in the audit log, and how often it is
looked."""


async def start_arming(
    site: Site,
    audit_path: Path,
    by: str,
    reason: str,
    minutes: float,
    *,
    acknowledged: Sequence[str] = (),
) -> CommandResult:
    """Arm a machine for some minutes; `acknowledged` are heads of lost rows.

    Raises ArmingError, AuditError, ValueError or OSError.
    """
    require_layouts(site)
    if not by.strip():
        raise ArmingError("arming needs a name: say who arms with --by NAME, or once with the variable DECANTER_BY")
    now = time.time()
    arming = sign_arming(by, reason, minutes, now)
    if (config := site.target.config) is not None and config.writeback.mode == "off":
        site.notes.append("writeback.mode is 'off': a gateway with this plant file computes and writes nothing")
    reply = _ask_gateway(site, "arm", by=arming.by, reason=arming.reason, minutes=minutes, acknowledge=[*acknowledged])
    if reply is None:
        if _is_gateway_alive(site):
            raise ArmingError(
                "a gateway runs with this plant file, and its control socket does not answer; stop it first"
            )
        config = site.target.config
        places = find_places(audit_path, config)
        with closing(open_audit(audit_path)) as audit:
            clear_for_arming(places, audit.record, by=arming.by, now=now, acknowledged=acknowledged)
        armed_for = "" if config is None else config.arming_hash
        arm_in_log(audit_path, arming, now, key=places.key, subject=site.target.subject, armed_for=armed_for)
        countersign(places, now)
    place = "the audit log" if reply is None else f"the running gateway (pid {reply['pid']})"
    until = arming.until if reply is None else float(reply["until"])
    data = {"by": arming.by, "reason": arming.reason, "minutes": minutes, "until": until, "told": place}
    return CommandResult({**data, "audit": str(audit_path), "head": head(audit_path)})


async def end_arming(site: Site, audit_path: Path, by: str, reason: str) -> CommandResult:
    """Take the arming of a machine back, then write validity 0 if that can be done.

    A running gateway that cannot be asked finds it in the audit log before its next block, and says so there; where it
    does not, the result has a complaint. It says what the next start of the gateway will do too. Raises ArmingError,
    AuditError, ValueError or OSError.
    """
    complaint, runs = "", _is_gateway_alive(site)
    try:
        reply = _ask_gateway(site, "disarm", by=by, reason=reason)
    except OSError as error:
        reply, runs = None, True
        site.notes.append(f"the running gateway does not answer at its control socket ({error})")
    if reply is not None:
        was, sentence = bool(reply["was_armed"]), f"the running gateway (pid {reply['pid']}) writes no more"
    else:
        # On record first: what another command sends after this finds no arming, and the block is the last word.
        config = site.target.config
        plant = config is not None or site.target.places is not None
        stamp = site.target.files[0].stat().st_mtime if plant and site.target.files[0].exists() else None
        subjects = _subjects(site.target, audit_path)
        before = {subject: _newest_row(audit_path, subject) for subject in subjects}
        rows = [
            disarm_in_log(audit_path, by, reason, time.time(), stamp, subject=subject, say=site.notes.append)
            for subject in subjects
        ]
        row = next(filter(None, rows), None)
        try:
            countersign(find_places(audit_path, config), time.time())
        except ArmingError as error:
            site.notes.append(str(error))
        was, sentence = row is not None, "nothing was armed"
        patience = max(_TAKEN_S, _TAKEN_PERIODS * find_period(site))
        is_taken = runs and await _is_withdrawal_logged(audit_path, before, patience)
        if is_taken:
            was, sentence = True, "the running gateway has found it in the audit log, and writes no more"
        elif runs and (reply := _answer_now(site, "disarm", by=by, reason=reason)) is not None:
            # Its socket is there again: a gateway that has lost it makes another.
            was, sentence = was or bool(reply["was_armed"]), f"the running gateway (pid {reply['pid']}) writes no more"
        elif runs and _is_gateway_alive(site):
            sentence = "validity 0 was not written"
            complaint = (
                "the disarming is on record, and whether the running gateway has taken it is NOT known: it answers "
                "neither at its control socket nor in the audit log; stop it, or take the permit away at the PLC"
            )
        elif row is not None:
            try:
                async with open_block_writers(site, audit_path, taking_back=row) as writers:
                    for writer in writers:
                        await writer.block()
                        writer.written = 0  # this block takes everything back already
                sentence = "validity 0 was written"
            except (DriverError, ValueError) as error:
                sentence = f"validity 0 was not written ({error}); the PLC's own timer covers it"
    said = sentence if was or complaint else "nothing was armed"
    data = {"by": by, "reason": reason, "was_armed": was, "known": not complaint, "said": said}
    newest = ""
    try:
        newest = head(audit_path) if audit_path.exists() else ""
        if site.target.config is not None and audit_path.exists():
            start = next_start(site.target.config, audit_path, time.time(), uptime())
            data["next_start"] = {"armed": start.arming is not None, "sentence": start.sentence}
    except AuditError as error:
        site.notes.append(f"{error}; a start of the gateway arms nothing on it")
    data |= {"audit": str(audit_path), "head": newest}
    return CommandResult(data, complaint)


def _newest_row(audit_path: Path, subject: str) -> int:
    """The row of the newest word about a subject; 0 where none can be read."""
    with suppress(AuditError):
        return next((word.id for word in given_words(audit_path, subject=subject)), 0)
    return 0


async def _is_withdrawal_logged(audit_path: Path, before: Mapping[str, int], seconds: float) -> bool:
    """Whether a running gateway says in the audit log, behind the rows `before`, that it has disarmed itself."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for subject, row in before.items():
            with suppress(AuditError):
                words = [word.entry for word in given_words(audit_path, subject=subject) if word.id > row]
                # A gateway's own doing names no process.
                if any(word.kind in (DISARMED, EXPIRED) and "pid" not in word.detail for word in words):
                    return True
        await asyncio.sleep(_LOOK_S)
    return False


def _subjects(target: Target, audit_path: Path) -> list[str]:
    """Whose armings in the audit log are taken back, where no gateway runs. Raises ConfigError or ArmingError."""
    places = target.places
    if places is None:
        return [target.subject]
    if not audit_path.exists():
        raise places.problem or ArmingError(f"nothing answers at {places.socket}")
    if places.several and not target.machine:
        why = f", as the plant file cannot be used: {places.problem}" if places.problem else ""
        raise ArmingError(f"which machine? Name it with --machine NAME{why}")
    # Of a file that cannot be used nobody knows whether its machine has a name there: too much is taken back at most.
    return [target.machine] if places.several else list(dict.fromkeys(("", target.machine)))


def _ask_gateway(site: Site, command: str, **keys: Any) -> dict[str, Any] | None:
    """The running gateway's answer; None where none can be reached. Raises OSError for one that does not answer."""
    line = running_gateway(site.target)
    if line is None:
        return None
    with closing(line):
        return line.ask(command, **keys)


def _answer_now(site: Site, command: str, **keys: Any) -> dict[str, Any] | None:
    """The running gateway's answer; None for one that gives none."""
    with suppress(OSError):
        return _ask_gateway(site, command, **keys)
    return None


def _is_gateway_alive(site: Site) -> bool:
    """Whether a gateway has the historian that the plant file names."""
    config, places = site.target.config, site.target.places
    historian = config.historian.path if config is not None else places.historian if places is not None else None
    return historian is not None and gateway_runs(historian)


def arm(given: SharedOptions, reason: str, minutes: float, acknowledged: tuple[str, ...], audit: Path | None) -> None:
    """Carry out `decanter arm`; its options and its help are in commission/commands.py."""

    async def work(site: Site) -> CommandResult:
        return await start_arming(
            site, audit_path(audit, given, site.target), given.by, reason, minutes, acknowledged=acknowledged
        )

    arguments = {"reason": reason, "minutes": minutes, "acknowledged": list(acknowledged)}
    perform(given, "arm", arguments, work, _armed_lines)


def _armed_lines(data: Mapping[str, Any]) -> Iterator[Part]:
    yield Line(f"ARMED until {format_moment(data['until'])} by {data['by']}: {data['reason']}", "yellow")
    yield f"told to {data['told']}; audit log {data['audit']}, head {data['head'][:16]}"


def disarm(given: SharedOptions, reason: str, socket: Path | None, audit: Path | None) -> None:
    """Carry out `decanter disarm`; its options and its help are in commission/commands.py."""

    async def work(site: Site) -> CommandResult:
        return await end_arming(site, audit_path(audit, given, site.target), given.by or login(), reason)

    target = None
    with sentences():
        if given.plant is not None and given.device is None:
            target = gateway_target(given.plant, given.machine, socket)
    if target is not None and target.places is not None and target.places.problem is not None:
        click.echo(f"{target.places.problem}; the disarming goes on all the same", err=True)
    perform(given, "disarm", {"reason": reason}, work, _disarmed_lines, target=target)


def _disarmed_lines(data: Mapping[str, Any]) -> Iterator[Part]:
    sentence = f"disarmed; {data['said']}" if data["was_armed"] else "nothing was armed; the disarming is on record"
    if not data["known"]:
        sentence = f"the disarming is on record; {data['said']}"
    yield f"{sentence}; audit log {data['audit']}, head {data['head'][:16]}"
    if start := data.get("next_start"):
        mode = click.style("ARMED", fg="yellow") if start["armed"] else "not armed"
        yield f"the next start of the gateway: {mode} ({start['sentence']})"
