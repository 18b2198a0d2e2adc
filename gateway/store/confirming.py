"""What lets something happen counts once a second row confirms it, signed with the gateway's key.

Whoever can write to the audit log can append an arming that is well formed; and one may be stored of which its person
was told that it is not, since its commit was under way when the wait for it ended. So an arming, and an
acknowledgement of lost rows, counts only with a row of the kind CONFIRMED behind it. That is written by whoever holds
the key, once the first row is known to be on the disk, and signs its number and hash, which stand for its content and
for all rows before it: copied to another place, or given another subject, it confirms nothing. A signed head
(`gateway.store.witness`) does not do, as one is signed each hour over whatever stands there.
"""

from collections.abc import Iterable
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.store.audit import CONFIRMED, AuditEntry, AuditRow, recompute_hashes
from gateway.store.signing import load_key, public_digits, verify_signature


def confirmation(row: AuditRow, key: Ed25519PrivateKey, now: float) -> AuditEntry:
    """The row that confirms a stored one."""
    detail = {"row": row.id, "hash": row.hash, "signature": key.sign(_signed_bytes(row.id, row.hash)).hex()}
    return AuditEntry(now, CONFIRMED, row.entry.who, f"row {row.id} ({row.entry.kind}) counts", detail).with_subject(
        row.entry.subject or ""
    )


def has_confirmation(path: Path, row: AuditRow, by: Iterable[AuditRow], public: str) -> bool:
    """True if one of the rows `by` confirms this row of the log, signed with the key `public` (digits).

    Raises AuditError.
    """
    # What stands in the row is hashed anew: the hash beside it may have been left when the row was changed.
    digest = recompute_hashes(path, [row.id]).get(row.id, "")
    return digest == row.hash and any(
        verify_signature(public, str(each.entry.detail.get("signature")), _signed_bytes(row.id, digest))
        for each in by
        if each.entry.detail.get("row") == row.id
    )


def public_key(path: Path) -> str:
    """The public half (digits) of the gateway's key at `path`; "" where there is none, which confirms nothing.

    Raises SigningKeyError for a key that cannot be trusted.
    """
    return public_digits(load_key(path).public_key()) if path.exists() else ""


def _signed_bytes(row: int, digest: str) -> bytes:
    return f"decanter audit row {row} {digest} counts\n".encode()
