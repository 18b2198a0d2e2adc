"""What nobody had foreseen ended the audit log's thread for good, and nothing said so."""

from pathlib import Path
from typing import Any

import pytest

from drivers.supervision import Supervisor
from gateway.store import audit as module
from gateway.store.audit import AuditEntry, open_audit, read
from tests.gateway.support import EPOCH


def test_it_is_begun_anew_said_and_loses_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    supervisor, calls = Supervisor(), []
    insert = module._insert

    def fails_once(*args: Any) -> str:
        calls.append(args)
        if len(calls) == 1:
            raise RuntimeError("unforeseen")
        return insert(*args)

    monkeypatch.setattr(module, "_insert", fails_once)
    audit = open_audit(tmp_path / "audit.sqlite", supervisor)
    audit.put(AuditEntry(EPOCH, "armed", "Ada", "first", {"until": EPOCH + 1.0}))
    assert audit.record(AuditEntry(EPOCH, "write", "Ada", "second"), timeout=60.0) or audit.record(
        AuditEntry(EPOCH, "write", "Ada", "third"), timeout=60.0
    )
    assert supervisor.report()["audit"]["restarts"] == 1 and "unforeseen" in supervisor.complaint
    assert audit.close()
    reasons = [row.entry.reason for row in read(audit.path)]
    assert reasons[0] == "first" and reasons[-1] in ("second", "third")
