"""What stays: historian, audit log, chains of hashes, and reading them back."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.store.arming_rows import (
        Uptime,
        armed_subjects,
        arming_end,
        armings,
        cancel_entry,
        end_reason,
        find_arming,
        given_words,
    )
    from gateway.store.audit import (
        ARMED,
        DISARMED,
        EXPIRED,
        NO_PROCESS,
        Audit,
        AuditEntry,
        AuditError,
        AuditRow,
        head,
        open_audit,
        read,
        read_since,
        subject_detail,
        verify,
    )
    from gateway.store.audit_damage import open_or_set_aside
    from gateway.store.backup import (
        DAMAGED_AUDIT,
        ROLES,
        BackupError,
        Manifest,
        as_one_file,
        damaged_audit,
        discard,
        make_backup,
        put_in_place,
        read_manifest,
        signer,
        stage,
    )
    from gateway.store.chain import first_break, sha256_hex
    from gateway.store.confirming import confirmation
    from gateway.store.durable import (
        RECORDS_MODE,
        SQLITE_HEADER,
        make_private,
        numbered_files,
        sync_folder,
        write_durably,
    )
    from gateway.store.files import HistorianError
    from gateway.store.follow import (
        FollowedRow,
        RowPosition,
        RowStream,
        find_position,
        newest_position,
        newest_rows,
        next_rows,
        row_streams,
        select_rows,
    )
    from gateway.store.historian import Historian, HistorianView, open_historian, saved_state
    from gateway.store.nearest_rank import percentile
    from gateway.store.queues import Row
    from gateway.store.read_back import (
        events,
        history,
        machines,
        mature_forecasts,
        newest_scan,
        oldest_scan,
        parse_moment,
        reading,
        recent,
        samples,
        stored_rows,
        tag_names,
        to_trace,
        trend,
    )
    from gateway.store.relied_files import FIXED, FileRule, ReliedFiles
    from gateway.store.schema import storable
    from gateway.store.score import scorecard, warning_score
    from gateway.store.signing import (
        SigningKeyError,
        key_path,
        load_key,
        load_or_make_key,
        load_public_key,
        public_digits,
        public_path,
    )
    from gateway.store.tables import TABLE_COLUMNS, Cells, TableColumn, row_cells
    from gateway.store.witness import (
        HEAD_EVENT,
        HEAD_STATE,
        HeadSink,
        SignedHead,
        WitnessPlaces,
        acknowledgement,
        default_places,
        examine,
        heads_file,
        sign_head,
        trusted_key,
    )
else:
    __getattr__ = lazy_getattr(__name__)
