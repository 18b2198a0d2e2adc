"""What stays: historian, audit log, chains of hashes, and reading them back."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from gateway.store.arming_rows import (
        Uptime,
        armed_subjects,
        armings,
        cancelling,
        end_of,
        given_words,
        over,
        standing,
    )
    from gateway.store.audit import (
        ARMED,
        CANCELLED,
        CONFIRMED,
        DISARMED,
        EXPIRED,
        Audit,
        AuditColumns,
        AuditEntry,
        AuditError,
        AuditRow,
        head,
        open_audit,
        read,
        verify,
    )
    from gateway.store.audit_damage import open_or_set_aside
    from gateway.store.backup import (
        BackupError,
        Manifest,
        as_one_file,
        discard,
        make_backup,
        put_in_place,
        read_manifest,
        stage,
    )
    from gateway.store.confirming import confirmation
    from gateway.store.durable import numbered_files, set_aside, sync_folder, write_durably
    from gateway.store.files import HistorianError
    from gateway.store.historian import Historian, HistorianView, open_historian, saved_state
    from gateway.store.numbers import Source
    from gateway.store.queues import Batch, LostRows, Row
    from gateway.store.read_back import (
        events,
        history,
        machines,
        matured,
        moment_of,
        newest_scan,
        reading,
        recent,
        samples,
        stored_rows,
        to_trace,
        trend,
    )
    from gateway.store.schema import storable
    from gateway.store.score import percentile, scorecard, warning_score
    from gateway.store.signing import SigningKeyError, key_beside, load_key, load_or_make_key, public_path
    from gateway.store.witness import (
        HEAD_EVENT,
        HEAD_STATE,
        AuditVerdict,
        HeadSink,
        SignedHead,
        WitnessPlaces,
        acknowledgement,
        examine,
        heads_file,
        places_beside,
        sign_head,
        trusted_key,
    )
else:
    __getattr__ = opened_at_use(__name__)

__all__ = [
    "ARMED",
    "CANCELLED",
    "CONFIRMED",
    "DISARMED",
    "EXPIRED",
    "HEAD_EVENT",
    "HEAD_STATE",
    "Audit",
    "AuditColumns",
    "AuditEntry",
    "AuditError",
    "AuditRow",
    "AuditVerdict",
    "BackupError",
    "Batch",
    "HeadSink",
    "Historian",
    "HistorianError",
    "HistorianView",
    "LostRows",
    "Manifest",
    "Row",
    "SignedHead",
    "SigningKeyError",
    "Source",
    "Uptime",
    "WitnessPlaces",
    "acknowledgement",
    "armed_subjects",
    "armings",
    "as_one_file",
    "cancelling",
    "confirmation",
    "discard",
    "end_of",
    "events",
    "examine",
    "given_words",
    "head",
    "heads_file",
    "history",
    "key_beside",
    "load_key",
    "load_or_make_key",
    "machines",
    "make_backup",
    "matured",
    "moment_of",
    "newest_scan",
    "numbered_files",
    "open_audit",
    "open_historian",
    "open_or_set_aside",
    "over",
    "percentile",
    "places_beside",
    "public_path",
    "put_in_place",
    "read",
    "read_manifest",
    "reading",
    "recent",
    "samples",
    "saved_state",
    "scorecard",
    "set_aside",
    "sign_head",
    "stage",
    "standing",
    "storable",
    "stored_rows",
    "sync_folder",
    "to_trace",
    "trend",
    "trusted_key",
    "verify",
    "warning_score",
    "write_durably",
]
