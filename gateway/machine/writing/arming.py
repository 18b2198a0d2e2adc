"""Arming and disarming: who lets the gateway write, why and for how long. It counts once the audit log has it."""

import asyncio
from dataclasses import asdict
from pathlib import Path
from random import Random

from structlog.typing import FilteringBoundLogger

from drivers.driver import Driver, Writes
from drivers.settings import ConfigError
from gateway.machine.reading import Clock
from gateway.machine.writing.writeback import Arming, Pace, Writer
from gateway.settings import MAX_ARMED_MINUTES, Config, WritebackLayout
from gateway.store import (
    ARMED,
    DISARMED,
    Audit,
    AuditEntry,
    AuditRow,
    Historian,
    last_arming,
    open_audit,
    saved_state,
    standing,
)

LONGEST = 200


class ArmingError(ValueError):
    """It is not armed; the message says why and what would be right."""


def signed(by: str, reason: str, minutes: float, now: float) -> Arming:
    """The arming that a person signs at `now`. Raises ArmingError for one without a name, a reason or an end."""
    by, reason = by.strip(), reason.strip()
    for what, text in (("name", by), ("reason", reason)):
        if not text:
            raise ArmingError(f"arming needs a {what}; give the person's name, the reason and the minutes")
        if len(text) > LONGEST or not text.isprintable():
            raise ArmingError(f"the {what} must be one line of at most {LONGEST} characters")
    if not 0 < minutes <= MAX_ARMED_MINUTES:
        raise ArmingError(f"{minutes:g} minutes cannot be armed; give more than 0 and at most {MAX_ARMED_MINUTES:g}")
    return Arming(by, reason, now + 60.0 * minutes)


def entry_of(arming: Arming, now: float, via: str) -> AuditEntry:
    """The audit log's row of an arming."""
    return AuditEntry(now, ARMED, arming.by, arming.reason, {"until": arming.until, "via": via})


def arming_of(row: AuditRow) -> Arming:
    """The arming in a row of the audit log."""
    return Arming(row.entry.who, row.entry.reason, float(row.entry.detail["until"]))


def arm_in_log(path: Path, arming: Arming, now: float) -> None:
    """Arm where no gateway runs: for the commands that write, and for a gateway that starts meanwhile.

    Raises ArmingError or AuditError.
    """
    _store(path, entry_of(arming, now, "command"))


def disarm_in_log(path: Path, by: str, reason: str, now: float) -> AuditRow | None:
    """Take back what `arm_in_log` armed; gives it, None if nothing was in force. Raises ArmingError or AuditError."""
    row = standing(path, now)
    if row is not None:
        _store(path, AuditEntry(now, DISARMED, by, reason))
    return row


def _store(path: Path, entry: AuditEntry) -> None:
    audit = open_audit(path)
    try:
        if not audit.record(entry):
            raise ArmingError(f"nothing has changed, as the audit log does not take it: {audit.failure}")
    finally:
        audit.close()


# ---------------------------------------------------------------- the running gateway


def open_writer(
    config: Config,
    layout: WritebackLayout,
    *,
    clock: Clock,
    driver: Driver,
    historian: Historian,
    audit: Audit,
    log: FilteringBoundLogger,
    rng: Random,
) -> Writer:
    """The writer of the block `layout`, in the configured mode, which is not off.

    It is armed by the configuration, or by `decanter plc arm` before the gateway began; only while that lasts, and only
    once the audit log has it. `rng` draws the number of this start. Raises ConfigError for a driver that cannot write.
    """
    section, now = config.writeback, clock.now()
    writer = Writer(layout, clock, "shadow", rng.randint(1, 0xFFFF), pace=Pace(config.blocks_per_second), audit=audit)
    if not isinstance(driver, Writes):
        if section.mode == "armed":
            reason = f"{config.map.driver!r} cannot write; set writeback.mode to 'shadow'"
            raise ConfigError([f"{config.map.path}: device.driver: {reason}"])
        return writer
    if section.mode == "armed":
        arming = _configured(config, historian, audit, now, log)
    else:
        row = standing(audit.path, now)
        arming = arming_of(row) if row else None
    if arming is None:
        return writer
    # First on record, then armed: what cannot be accounted for is not written.
    historian.put("audit", [(now, f"armed until {arming.until:.0f}", arming.by, arming.reason)])
    if not (audit.record(entry_of(arming, now, "gateway began")) and historian.flush()):
        log.error("not armed, as the audit record cannot be stored", reason=audit.failure or historian.failure)
        return writer
    writer.arm(driver, arming)
    log.warning("armed", by=arming.by, reason=arming.reason, until=arming.until)
    return writer


def _configured(
    config: Config, historian: Historian, audit: Audit, now: float, log: FilteringBoundLogger
) -> Arming | None:
    """The configuration's arming, None where it is over or was taken back.

    The time counts from when this arming was first used: a restart does not begin it anew. An arming is another one
    when its name, reason, minutes or the configuration file's time of change differ.
    """
    section = config.writeback
    fresh = signed(section.armed_by, section.reason, section.minutes or 0.0, now)
    key = {"by": section.armed_by, "reason": section.reason, "minutes": section.minutes, "stamp": config.stamp}
    saved = saved_state(historian, "arming", log)
    if saved is None or saved[1].get("key") != key or not isinstance(saved[1].get("until"), float):
        historian.save("arming", now, {"key": key, **asdict(fresh)})
        return fresh
    # The earlier end: a clock that was set back must not make an arming longer than its minutes.
    arming = Arming(fresh.by, fresh.reason, min(saved[1]["until"], fresh.until))
    last = last_arming(audit.path)
    if last is not None and last.entry.kind == DISARMED:
        why, by = f"it was taken back: {last.entry.reason}", last.entry.who
    elif now >= arming.until:
        why, by = "its time is over", arming.by
    else:
        return arming
    log.warning("the arming is over; save the configuration anew to arm again", by=by, until=arming.until, reason=why)
    historian.put("audit", [(now, "arming is over, shadow", by, arming.reason)])
    return None


async def arm(writer: Writer, driver: Driver, *, by: str, reason: str, minutes: float) -> Arming:
    """Arm a gateway that runs in shadow, or sign its arming anew. Raises ArmingError."""
    if writer.audit is None or not isinstance(driver, Writes):
        raise ArmingError("this driver cannot write")
    now = writer.clock.now()
    arming = signed(by, reason, minutes, now)
    if not await asyncio.to_thread(writer.audit.record, entry_of(arming, now, "command")):
        raise ArmingError(f"not armed, as the audit log does not take it: {writer.audit.failure}")
    writer.arm(driver, arming)
    return arming
