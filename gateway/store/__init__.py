"""What stays: historian, audit log, chains of hashes, and reading them back."""

from gateway.store.audit import (
    ARMED,
    DISARMED,
    EXPIRED,
    Audit,
    AuditEntry,
    AuditRow,
    head,
    last_arming,
    open_audit,
    read,
    standing,
    verify,
)
from gateway.store.chain import first_break, hash_of
from gateway.store.historian import Historian, Row, open_historian, saved_state
from gateway.store.read_back import (
    events,
    history,
    matured,
    newest_scan,
    reading,
    recent,
    samples,
    stored_rows,
    to_trace,
    trend,
)
from gateway.store.schema import storable
from gateway.store.score import percentile, scorecard

__all__ = [
    "ARMED",
    "DISARMED",
    "EXPIRED",
    "Audit",
    "AuditEntry",
    "AuditRow",
    "Historian",
    "Row",
    "events",
    "first_break",
    "hash_of",
    "head",
    "history",
    "last_arming",
    "matured",
    "newest_scan",
    "open_audit",
    "open_historian",
    "percentile",
    "read",
    "reading",
    "recent",
    "samples",
    "saved_state",
    "scorecard",
    "standing",
    "storable",
    "stored_rows",
    "to_trace",
    "trend",
    "verify",
]
