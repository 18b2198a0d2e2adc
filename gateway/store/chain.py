"""Rows bound to the one before them by a hash, so that one that was changed, put in or taken out shows.

Two files are such chains, and each keeps its hashes in its own way: the audit log has beside each row the hash of the
hash before and the row (`digest`); of commissioning's records each line names the hash of the line before
(`sha256_hex`). Bound by nothing is the end of either: keep the newest hash apart from the file.
"""

import hashlib
from collections.abc import Iterable

BEGIN = bytes(32)
"""The hash before the first row of the audit log."""


def digest(before: bytes, row: bytes) -> bytes:
    """The SHA-256 of the hash before a row and of the row."""
    return hashlib.sha256(before + row).digest()


def sha256_hex(data: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def first_break(rows: Iterable[tuple[str, str]]) -> int | None:
    """The number (1..) of the first row whose kept hash is not the one that was computed; None if all are."""
    return next((number for number, (kept, computed) in enumerate(rows, start=1) if kept != computed), None)
