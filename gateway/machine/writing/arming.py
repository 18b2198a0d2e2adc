"""Arming and disarming: who lets the gateway write, why and for how long. It counts once the audit log has it.

The audit log is the one memory of it. A start believes an arming only if a second row confirms it, which is written
once the arming is in force (`gateway.store.confirming`): what was answered with "not armed" has none, whatever the
disk and a kill make of its row, and nobody can write one without the gateway's key. The newest word of a person wins:
an arming or disarming by command, or the plant file, whose word is given when it is saved. `next_start` says what a
start makes of all that.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from drivers.driver import Driver, Writes
from drivers.errors import OneLineError
from drivers.settings import ConfigError
from gateway.machine.reading import Clock
from gateway.machine.writing.writeback import DISARMED_SECONDS, Arming, Pace, Writer
from gateway.settings import MAX_ARMED_MINUTES, Config, WritebackLayout
from gateway.store import (
    ARMED,
    DISARMED,
    EXPIRED,
    NO_PROCESS,
    Audit,
    AuditEntry,
    AuditError,
    AuditRow,
    SigningKeyError,
    Uptime,
    arming_end,
    armings,
    cancel_entry,
    confirmation,
    end_reason,
    given_words,
    key_path,
    load_or_make_key,
    open_audit,
    open_or_set_aside,
)
from sim.moments import exact_moment

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

    from gateway.store import HistorianView


MAX_TEXT_CHARACTERS = 200
_FOR = "configuration"
"""The key of an arming's detail that names the configuration that it is for (`Config.arming_hash`)."""
CONFIRMED_SECONDS = 2.0
"""The longest wait for the disk to take the row that confirms an arming in force; then nobody waits for it."""


class ArmingError(OneLineError, ValueError):
    """It is not armed; the message says why and what would be right."""


def sign_arming(by: str, reason: str, minutes: float, now: float) -> Arming:
    """The arming that a person signs at `now`. Raises ArmingError for one without a name, a reason or an end."""
    by, reason = by.strip(), reason.strip()
    for what, text in (("name", by), ("reason", reason)):
        if not text:
            raise ArmingError(f"arming needs a {what}; give the person's name, the reason and the minutes")
        if len(text) > MAX_TEXT_CHARACTERS or not text.isprintable():
            raise ArmingError(f"the {what} must be one line of at most {MAX_TEXT_CHARACTERS} characters")
    if not 0 < minutes <= MAX_ARMED_MINUTES:
        raise ArmingError(f"{minutes:g} minutes cannot be armed; give more than 0 and at most {MAX_ARMED_MINUTES:g}")
    return Arming(by, reason, now + 60.0 * minutes)


def uptime() -> Uptime:
    """The machine's own count of seconds, which no setting of its clock moves."""
    boot = Path("/proc/sys/kernel/random/boot_id")
    name = boot.read_text(encoding="ascii").strip() if boot.exists() else ""
    return Uptime(name, time.clock_gettime(time.CLOCK_BOOTTIME))


def arming_entry(arming: Arming, now: float, via: str, speed: float = 1.0, **more: Any) -> AuditEntry:
    """The audit log's row of an arming; `speed` is seconds of `until` per real second."""
    count = uptime()
    detail = {"until": arming.until, "via": via, "boot": count.boot, "uptime": count.seconds, "speed": speed}
    return AuditEntry(now, ARMED, arming.by, arming.reason, {**detail, **more})


def _configuration_detail(configuration: str) -> dict[str, Any]:
    """What the row of an arming says of the configuration that it is for ("": nothing, as rows of before)."""
    return {_FOR: configuration} if configuration else {}


def parse_arming(row: AuditRow) -> Arming:
    """The arming in a row of the audit log."""
    return Arming(row.entry.who, row.entry.reason, float(row.entry.detail["until"]))


def own_process() -> Mapping[str, int]:
    """`uid` and `pid` of this program, for the row of what a person does by it."""
    return {"uid": os.getuid(), "pid": os.getpid()}


def arm_in_log(
    path: Path, arming: Arming, now: float, *, key: Path | None = None, subject: str = "", armed_for: str = ""
) -> None:
    """Arm a subject where no gateway runs: for the commands that write, and for a gateway that starts meanwhile.

    `key` is the gateway's key file, by default the one beside the log; `arming_hash` is the machine's configuration
    (`Config.arming_hash`, "": any). Raises ArmingError, AuditError, SigningKeyError.
    """
    entry = arming_entry(arming, now, "command", **own_process(), **_configuration_detail(armed_for)).with_subject(
        subject
    )
    late = "the disk did not take it in time"
    signing = load_or_make_key(key or key_path(path))
    audit = open_audit(path)
    try:
        row = audit.record(entry, undo=cancel_entry(entry, late))
        # Nothing is in force by then, so that the confirming row is waited for, and taken back by a disarming.
        stored = row is not None and audit.record(
            confirmation(row, signing, now), undo=AuditEntry(now, DISARMED, "", late).with_subject(subject)
        )
    finally:
        known = audit.close()
    if not stored:
        why = audit.failure or "the disk does not answer"
        doubt = "" if known else "; whether it has taken it after all cannot be told: disarm before a gateway starts"
        raise ArmingError(f"nothing has changed, as the audit log does not take it: {why}{doubt}")


def disarm_in_log(
    path: Path,
    by: str,
    reason: str,
    now: float,
    stamp: float | None = None,
    *,
    subject: str = "",
    say: Callable[[str], None] = lambda damage: None,
) -> AuditRow | None:
    """Take back what is in force of a subject, and what a plant file saved at `stamp` would arm at the next start.

    Gives the arming that was in force, None where there was none; the row is written all the same. So it is where the
    log is damaged, which is set aside where it takes no row: `say` is told what is damaged. Raises ArmingError.
    """
    row = None
    try:
        row = _find_arming(path, now, subject)
    except AuditError as error:
        say(f"whether it was armed is not known: {error}")
    audit = open_or_set_aside(path)
    try:
        if audit.note:
            say(audit.note)
        detail = {**own_process(), **({} if stamp is None else {"stamp": stamp})}
        entry = AuditEntry(now, DISARMED, by, reason, detail)
        if not audit.record(entry.with_subject(subject)):
            why = audit.failure or "the disk does not answer"
            raise ArmingError(f"nothing has changed, as the audit log does not take it: {why}")
    finally:
        audit.close()
    return row


def end_by_mode(config: Config, audit: Callable[[], Audit], now: float) -> AuditRow | None:
    """End an arming that stands in the log of a machine whose mode is 'off', and give it; None where none stands.

    A mode that is another one later does not bring it back: a person arms again. `audit` opens the log. Raises
    ArmingError, AuditError.
    """
    row = _find_arming(config.audit, now, config.subject) if config.audit.exists() else None
    if row is not None:
        log = audit()
        entry = AuditEntry(now, EXPIRED, row.entry.who, "writeback.mode was set to 'off'")
        if not log.record(entry.with_subject(config.subject)):
            why = log.failure or "the disk does not answer"
            raise ArmingError(f"the arming by {row.entry.who} stands, as the audit log does not take its end: {why}")
    return row


def newest_stamp(config: Config) -> float:
    """When the plant file was saved that a disarming is given against: as it is now, read or not (s)."""
    return config.path.stat().st_mtime if config.path.exists() else config.stamp


async def keep_disarming(
    config: Config, audit: Audit, now: float, *, by: str, reason: str, process: Mapping[str, int]
) -> None:
    """Put on record that a machine of mode 'off' was disarmed, against what its plant file may say later."""
    detail = {**process, "stamp": newest_stamp(config)}
    await audit.keep(AuditEntry(now, DISARMED, by, reason, detail).with_subject(config.subject), DISARMED_SECONDS)


def _find_arming(path: Path, now: float, subject: str) -> AuditRow | None:
    """The arming in force of a subject, confirmed or not: to take it back needs no key. Raises AuditError."""
    row = next(iter(given_words(path, subject=subject)), None)
    return None if row is None or row.entry.kind != ARMED or end_reason(path, row, now, uptime()) else row


# ---------------------------------------------------------------- what a start makes of it


@dataclass(frozen=True, slots=True)
class NextStart:
    """What a start of the gateway does: its arming (None: it does not write), and why, in a sentence.

    `file` are the plant file's words where these arm; `ended` is an arming whose end is not on record yet, `by` whoever
    armed or disarmed last where it does not write.
    """

    arming: Arming | None
    sentence: str
    file: dict[str, Any] | None = None
    ended: AuditRow | None = None
    by: str = ""


def next_start(config: Config, path: Path, now: float, count: Uptime) -> NextStart:
    """What a start at `now` does about its machine with this configuration and the audit log at `path`.

    The file's words count once: their time runs from their first use, restarts included. A disarming wins over every
    file that was saved before it. Raises AuditError.
    """
    section, rows = config.writeback, given_words(path, subject=config.subject)
    words = {"by": section.armed_by, "reason": section.reason, "minutes": section.minutes, "stamp": config.stamp}
    if section.mode == "off":
        return NextStart(None, "writeback.mode is 'off'")
    try:
        last = next(armings(path, config.audit_key, subject=config.subject), None)
    except SigningKeyError as error:
        return NextStart(None, str(error))
    # Confirmed or not, a row of the file's words uses them up.
    if section.mode == "armed" and not any(_matches_words(row, words) for row in rows):
        # Times of change are compared with one another, so that no clock has a say; without one, with the row's time.
        # The newest disarming of all, as an arming since then is one for what ran then, and no word about this file.
        against = next((row.entry for row in rows if row.entry.kind == DISARMED), None)
        stamp = against.detail.get("stamp") if against is not None else None
        if against is None or config.stamp > (stamp if isinstance(stamp, int | float) else against.time):
            arming = sign_arming(section.armed_by, section.reason, section.minutes or 0.0, now)
            return NextStart(arming, f"{config.path} arms it for {section.minutes:g} minutes", words)
        if last is not None and last.entry.kind == DISARMED:
            return NextStart(
                None, f"{_who(last)} after {config.path} was saved; save it anew to arm again", by=last.entry.who
            )
    if rows and rows[0].entry.kind == ARMED and (last is None or last.entry.kind != ARMED):
        who = rows[0].entry.who
        why = f"the arming by {who} (row {rows[0].id}) is not confirmed with this gateway's key, so that it does not "
        return NextStart(None, f"{why}count; arm again if that is wanted", ended=rows[0], by=who)
    if last is None:
        return NextStart(None, "nobody has armed it")
    if last.entry.kind == DISARMED:
        return NextStart(None, _who(last), by=last.entry.who)
    if last.entry.kind == EXPIRED:
        return NextStart(None, f"the arming by {last.entry.who} is over: {last.entry.reason}", by=last.entry.who)
    if why := end_reason(path, last, now, count):
        return NextStart(None, f"the arming by {last.entry.who} is over: {why}", ended=last, by=last.entry.who)
    if last.entry.detail.get(_FOR, config.arming_hash) != config.arming_hash:
        who = last.entry.who
        why = f"the arming by {who} is for another configuration of the machine than the one there is now"
        return NextStart(None, f"{why}; look at it, and arm again", ended=last, by=who)
    file = last.entry.detail.get("file")
    if file is not None and not (section.mode == "armed" and _matches_words(last, words)):
        return NextStart(None, f"the words of {config.path} that armed it are changed", ended=last, by=last.entry.who)
    left = Arming(last.entry.who, last.entry.reason, arming_end(last, now, count))
    return NextStart(left, f"the arming by {last.entry.who} goes on", file)


def _newest_word(path: Path, subject: str, before: float = inf) -> int:
    """The row of the newest word about a subject that stands before row `before`; 0: none. Raises AuditError."""
    return next((word.id for word in given_words(path, subject=subject) if word.id < before), 0)


def _matches_words(row: AuditRow, words: dict[str, Any]) -> bool:
    """True if the arming of this row was given by these words of the plant file."""
    entry = row.entry
    if entry.kind != ARMED or "file" in entry.detail:
        return entry.kind == ARMED and bool(entry.detail["file"] == words)
    # Rows of earlier gateways do not say it: by the same name and for the same reason, and later than the file.
    same = (entry.who, entry.reason) == (words["by"], words["reason"])
    return same and entry.detail.get("via") == "gateway began" and entry.time >= words["stamp"]


def _who(row: AuditRow) -> str:
    return f"{row.entry.who} disarmed it ({row.entry.reason})"


# ---------------------------------------------------------------- the running gateway


def open_writers(
    config: Config,
    layouts: Sequence[WritebackLayout],
    *,
    clock: Clock,
    driver: Driver,
    historian: HistorianView,
    audit: Audit,
    log: FilteringBoundLogger,
    rng: Random,
    obstacle: Callable[[], str] = lambda: "",
) -> tuple[Writer, ...]:
    """The writers of the blocks `layouts` of one machine, in the configured mode, which is not off.

    They have one arming and one number: by the configuration, or by `decanter arm` before the gateway began; only
    while that lasts, and only once the audit log has it. `obstacle` says why nothing may be armed at all, `rng` draws
    the number of this start. Raises ConfigError for a driver that cannot write.
    """
    section, now = config.writeback, clock.now()
    number, rate = rng.randint(1, 0xFFFF), config.blocks_per_second
    writers = tuple(
        Writer(
            layout,
            clock,
            "shadow",
            number,
            pace=Pace(rate),
            audit=audit,
            max_age=config.block_max_age,
            subject=config.subject,
        )
        for layout in layouts
    )
    if not isinstance(driver, Writes):
        if section.mode == "armed":
            reason = f"{config.map.driver!r} cannot write; set writeback.mode to 'shadow'"
            raise ConfigError([f"{config.map.path}: device.driver: {reason}"])
        return writers
    if audit.failure:
        log.error("not armed", reason=audit.failure)
        return writers
    try:
        word = _newest_word(audit.path, config.subject)
        start = next_start(config, audit.path, now, uptime())
    except AuditError as error:  # damaged in its middle: what it takes goes on being written, and nothing is armed
        log.error("not armed", reason=str(error))
        return writers
    arming = start.arming
    if start.ended is not None:
        # Its end is a row of its own: what is over stays over, whatever the clock does after this.
        audit.put(AuditEntry(now, EXPIRED, start.ended.entry.who, start.sentence).with_subject(config.subject))
    if arming is None:
        if section.mode == "armed" or start.ended is not None:
            log.warning("not armed", reason=start.sentence)
            historian.put("audit", [(now, "arming is over, shadow", start.by, start.sentence)])
        return writers
    if reason := obstacle():
        log.error("not armed", reason=reason)
        return writers
    # First on record, then armed: what cannot be accounted for is not written.
    historian.put("audit", [(now, f"armed until {exact_moment(arming.until)}", arming.by, arming.reason)])
    words: dict[str, Any] = {} if start.file is None else {"file": start.file}
    words |= _configuration_detail(config.arming_hash)
    entry = arming_entry(arming, now, "gateway began", clock.speed, **words).with_subject(config.subject)
    undo = cancel_entry(entry, "the records could not be stored when the gateway began")
    row = audit.record(entry, undo=undo) if historian.flush() else None
    if row is None:
        log.error("not armed, as the audit record cannot be stored", reason=historian.failure or audit.failure)
        return writers
    try:
        since = _newest_word(audit.path, config.subject, row.id)
    except AuditError as error:
        audit.put(cancel_entry(entry, "not armed: the audit log cannot be read"))
        log.error("not armed", reason=str(error))
        return writers
    if since != word:
        # A disarming that was given meanwhile, or that the disk had not taken when it was looked for.
        audit.put(cancel_entry(entry, "not armed: something was said of it while it began"))
        log.warning("not armed", reason="somebody armed or disarmed while it began; arm again if that is wanted")
        return writers
    for writer in writers:
        writer.arm(driver, arming, row.id)
    audit.put(confirmation(row, load_or_make_key(config.audit_key), now))
    log.warning("armed", by=arming.by, reason=arming.reason, until=arming.until)
    return writers


async def arm(
    writers: Sequence[Writer],
    driver: Driver,
    *,
    by: str,
    reason: str,
    minutes: float,
    key: Ed25519PrivateKey,
    process: Mapping[str, int] = NO_PROCESS,
    armed_for: str = "",
) -> Arming:
    """Arm the blocks of a gateway that runs in shadow, or sign their arming anew; `key` confirms it.

    `arming_hash` is the configuration that it is for (`Config.arming_hash`).

    They share clock and audit log. Raises ArmingError.
    """
    audit, clock = writers[0].audit, writers[0].clock
    if audit is None or not isinstance(driver, Writes):
        raise ArmingError("this driver cannot write")
    if any(writer.ending for writer in writers):
        doubt = f", which the audit log does not take ({audit.failure})" if audit.failure else ""
        raise ArmingError(f"it is being disarmed at this moment{doubt}; arm again once that is done")
    now, generations = clock.now(), [writer.generation for writer in writers]
    arming = sign_arming(by, reason, minutes, now)
    words = {**process, **_configuration_detail(armed_for)}
    entry = arming_entry(arming, now, "command", clock.speed, **words).with_subject(writers[0].subject)
    row = await audit.stored(entry, undo=cancel_entry(entry, "not armed: the disk did not take it in time"))
    if row is None:
        why = audit.failure or "the disk does not answer"
        raise ArmingError(f"not armed, as the audit log does not take it: {why}")
    if [writer.generation for writer in writers] != generations:
        # Whoever disarmed did so while this was being stored, and has been told that nothing is written any more.
        audit.put(cancel_entry(entry, "not armed: it was disarmed meanwhile"))
        raise ArmingError("not armed: it was disarmed meanwhile; arm again if that is still wanted")
    for writer in writers:
        writer.arm(driver, arming, row.id)
    # Shielded: whoever asked may go away, and it is in force all the same.
    await asyncio.shield(audit.keep(confirmation(row, key, now), CONFIRMED_SECONDS))
    return arming
