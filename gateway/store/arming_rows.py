"""Who may write, as the audit log has it: the newest word of a person, as long as it lasts.

Each subject (`AuditEntry.subject`) is armed by itself: the rows of one say nothing of another. A word is a row of the
kind ARMED, DISARMED or EXPIRED. An ARMED row counts only once it is confirmed with the
gateway's key (`gateway.store.confirming`); what takes away needs no key. A row CANCELLED says to the reader of the
log that an ARMED row was not confirmed, and to a start that the words of a plant file were not used up by it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gateway.store.audit import ARMED, CANCELLED, CONFIRMED, AuditEntry, AuditRow, arming_rows, newest_time
from gateway.store.confirming import has_confirmation, public_key
from gateway.store.signing import key_path


@dataclass(frozen=True, slots=True)
class Uptime:
    """Seconds since this start of the machine, sleep included, and which start it is ("": not known)."""

    boot: str
    seconds: float


def cancel_entry(entry: AuditEntry, reason: str) -> AuditEntry:
    """The row that undoes the ARMED row of `entry`, whether that was stored or not."""
    detail = {"armed": entry.time, "until": entry.detail["until"]}
    return AuditEntry(entry.time, CANCELLED, entry.who, reason, detail).with_subject(entry.subject or "")


def armed_subjects(path: Path) -> list[str]:
    """The subjects of which the log has words, in the order of their first one. Raises AuditError."""
    return list(dict.fromkeys(subject for row in arming_rows(path) if (subject := row.entry.subject) is not None))


def given_words(path: Path, *, subject: str = "") -> list[AuditRow]:
    """The words about a subject that were given and not cancelled, the newest first, whether they count or not.

    Raises AuditError.
    """
    rows = [row for row in arming_rows(path) if row.entry.subject == subject]
    # What was confirmed was in force: nothing makes it undone.
    confirmed = {row.entry.detail.get("row") for row in rows if row.entry.kind == CONFIRMED}
    cancelled = {
        (row.entry.who, row.entry.detail.get("armed"), row.entry.detail.get("until"))
        for row in rows
        if row.entry.kind == CANCELLED
    }
    return [
        row
        for row in reversed(rows)
        if row.entry.kind not in (CANCELLED, CONFIRMED)
        and (
            row.entry.kind != ARMED
            or row.id in confirmed
            or (row.entry.who, row.entry.time, row.entry.detail["until"]) not in cancelled
        )
    ]


def armings(path: Path, key: Path | None = None, *, subject: str = "") -> Iterator[AuditRow]:
    """The words about a subject that count, the newest first.

    `key` is the gateway's key file, by default the one beside the log. Raises AuditError, and SigningKeyError for a key
    that cannot be trusted.
    """
    public = public_key(key or key_path(path))
    by = [row for row in arming_rows(path) if row.entry.kind == CONFIRMED and row.entry.subject == subject]
    for row in given_words(path, subject=subject):
        if row.entry.kind != ARMED or has_confirmation(path, row, by, public):
            yield row


def find_arming(
    path: Path, now: float, uptime: Uptime | None = None, *, key: Path | None = None, subject: str = ""
) -> AuditRow | None:
    """The arming of a subject in force at `now`; None if there is none, it was taken back, or it is over.

    Raises as `armings`.
    """
    row = next(armings(path, key, subject=subject), None)
    return None if row is None or row.entry.kind != ARMED or end_reason(path, row, now, uptime) else row


def end_reason(path: Path, row: AuditRow, now: float, uptime: Uptime | None = None) -> str:
    """Why the arming of an ARMED row of this log is over at `now`; "" while it lasts. Raises AuditError.

    The wall clock alone is not believed: nothing that was stored since then may be of later than `now`.
    """
    if now >= float(row.entry.detail["until"]):
        return "its time is over"
    newest = newest_time(path, row.id)
    if newest is not None and now < newest:
        return f"the clock stands {newest - now:.3g} s before the newest record, so that its time cannot be told"
    if now >= arming_end(row, now, uptime):
        return "its time is over by the machine's own count, whatever the clock says"
    return ""


def arming_end(row: AuditRow, now: float, uptime: Uptime | None = None) -> float:
    """When the arming of an ARMED row ends, in the time of `now`.

    While the machine has not been started anew its own count of seconds bounds what is left (`uptime`).
    """
    entry, until = row.entry, float(row.entry.detail["until"])
    if uptime is None or not uptime.boot or entry.detail.get("boot") != uptime.boot:
        return until
    spent = (uptime.seconds - float(entry.detail.get("uptime", uptime.seconds))) * float(entry.detail.get("speed", 1.0))
    return min(until, now + until - entry.time - spent)
