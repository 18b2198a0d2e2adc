"""A disk that is busy with other things holds no block back where the test is not about that."""

import pytest

from gateway.store.audit import Audit, AuditEntry, AuditRow

DISK_S = 60.0
"""A block goes out once its audit row is stored, and is held back if that takes longer than a quarter of a second: on a
disk that others keep busy an `fsync` alone does. What is held back then is shown in
tests/cases/block_before_its_audit_row."""


@pytest.fixture(autouse=True)
def patient_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each audit row that a task waits for has DISK_S at least."""
    stored = Audit.stored

    async def patient(
        audit: Audit, entry: AuditEntry, timeout: float = DISK_S, undo: AuditEntry | None = None
    ) -> AuditRow | None:
        return await stored(audit, entry, max(timeout, DISK_S), undo)

    monkeypatch.setattr(Audit, "stored", patient)
