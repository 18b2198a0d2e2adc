"""Signed heads of the audit log, kept in several places, so that its end cannot go unnoticed.

A chain of hashes shows what was changed in it, not that its end was cut off, that it was emptied or computed anew. So
its newest hash, with the row's number, is signed (`gateway.store.signing`) and given to witnesses: a file of signed
heads, the historian, the log, and whoever else takes one. Each signed head must be found in the chain again.

Where rows were lost indeed (a damaged file was set aside, a box restored from a backup), a person acknowledges the lost
head by name: a row of the chain that says so, and which counts once it is confirmed (`gateway.store.confirming`).
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.store.audit import CONFIRMED, AuditEntry, AuditError, ChainVerdict, hashes, read, verify
from gateway.store.audit_damage import damage
from gateway.store.confirming import has_confirmation
from gateway.store.durable import RECORDS_MODE
from gateway.store.files import HistorianError
from gateway.store.signing import (
    key_path,
    load_key,
    load_public_key,
    public_digits,
    public_path,
    verify_signature,
)

HEAD_EVENT = "audit head"
"""The log's line that holds a signed head."""
HEAD_STATE = "audit head"
"""The key of the historian's state that holds the newest signed head."""
ACKNOWLEDGED = "lost head acknowledged"
"""Kind of the audit log's row by which a person takes note that rows up to a head are lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignedHead:
    """The hash of row `row` of the chain that began with the hash `begin`, signed by `key` at `time` (s UTC)."""

    row: int
    head: str
    begin: str
    time: float
    key: str
    signature: str = ""

    @property
    def is_valid(self) -> bool:
        """True if the key that it names has signed it."""
        return verify_signature(self.key, self.signature, self.signed_bytes())

    def signed_bytes(self) -> bytes:
        """What the signature is over."""
        plain = asdict(self)
        del plain["signature"]
        return b"decanter audit head\n" + json.dumps(plain, sort_keys=True, allow_nan=False).encode()


def parse_head(plain: object) -> SignedHead | None:
    """The signed head in plain values; None for anything else, or one whose signature is not right."""
    if not isinstance(plain, Mapping):
        return None
    kinds: dict[str, type] = {"row": int, "head": str, "begin": str, "time": float, "key": str, "signature": str}
    values: dict[str, Any] = {name: plain.get(name) for name in kinds}
    if not all(isinstance(values[name], kind) for name, kind in kinds.items()) or not 0 < values["row"] < 1 << 63:
        return None
    head = SignedHead(**values)
    with suppress(ValueError):
        return head if head.is_valid else None
    return None


class HeadSink(Protocol):
    """Takes signed heads; one that cannot raises OSError."""

    def __call__(self, head: SignedHead) -> None:
        """Keep it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WitnessPlaces:
    """Where an audit log, its key, and the places that hold its signed heads are; None: there is none."""

    audit: Path
    key: Path
    heads: Path
    historian: Path | None = None
    logs: tuple[Path, ...] = ()


def default_places(audit: Path) -> WitnessPlaces:
    """Key and heads file of an audit log where nothing else is said; no other witness."""
    return WitnessPlaces(audit=audit, key=key_path(audit), heads=audit.with_suffix(".heads.jsonl"))


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditVerdict:
    """What is known of an audit log: its chain, who bears witness to its end, and what is wrong ("" nothing).

    `broken` is what is wrong with the chain in itself, `lost` the newest head that was signed and is not in it.
    `witnesses` says of each place how many heads it holds, or why none. `witnessed` is the newest row that a signed
    head stands at, 0 without one.
    """

    rows: int
    head: str
    problem: str
    broken: str
    lost: SignedHead | None
    witnesses: Mapping[str, str]
    witnessed: int
    notes: tuple[str, ...]

    @property
    def end(self) -> str:
        """What is known of the log's end, in a sentence."""
        if not self.witnessed:
            return "the end is not witnessed: no place holds a signed head of this chain"
        newer = self.rows - self.witnessed
        return f"rows 1 to {self.witnessed} are witnessed" + (f", the {newer} after them are not" if newer else "")


def heads_file(head: SignedHead, path: Path) -> None:
    """Append a signed head to a file, a line of JSON each, on the disk when this returns. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, RECORDS_MODE)
    try:
        size = os.fstat(file).st_size
        # A line that a power cut has torn stays alone.
        torn = size > 0 and os.pread(file, 1, size - 1) != b"\n"
        os.write(file, (b"\n" if torn else b"") + json.dumps(asdict(head)).encode() + b"\n")
        os.fsync(file)
    finally:
        os.close(file)


def sign_head(audit: Path, key: Ed25519PrivateKey, now: float, sinks: Iterable[HeadSink]) -> SignedHead | None:
    """Sign the newest head and give it to every sink; None for a log without rows.

    Raises AuditError, and the OSError of a sink that did not take it, after all others have.
    """
    found = hashes(audit)
    if not found:
        return None
    (row, digest), begin = next(iter(found.items())), hashes(audit, [1])[1]
    bare = SignedHead(row=row, head=digest, begin=begin, time=float(now), key=public_digits(key.public_key()))
    signed = SignedHead(**{**asdict(bare), "signature": key.sign(bare.signed_bytes()).hex()})
    failure: OSError | None = None
    for sink in sinks:
        try:
            sink(signed)
        except OSError as error:
            failure = error
    if failure is not None:
        raise failure
    return signed


def examine(places: WitnessPlaces, *, head: str = "", public: str | None = None) -> AuditVerdict:
    """Verify the chain, and find every signed head in it again; `head` is a hash that was kept from before.

    `public` is the key (digits) that counts; None: any, each by its own. Raises AuditError for a log that cannot be
    read at all.
    """
    # The witnesses first: a gateway that runs appends rows meanwhile, and each head must be in what is read after it.
    witnesses, heads, problems = _gather(places)
    if heads and not places.audit.is_file():
        row = max(signed.row for signed in heads)
        chain = ChainVerdict(0, "", f"there is no audit log, and row {row} of one was signed")
    else:
        chain = _verify_chain(places.audit, head)
    notes: list[str] = []
    strange = [signed for signed in heads if public is not None and signed.key != public]
    if strange:
        notes.append(f"{len(strange)} signed heads are by another key, {strange[0].key[:16]}..., and bear no witness")
    stored, witnessed, missing = {}, 0, []
    if not chain.problem:
        stored = hashes(places.audit, {1, *(signed.row for signed in heads)})
        own = [signed for signed in heads if public is None or signed.key == public]
        witnessed = max((signed.row for signed in own if stored.get(signed.row) == signed.head), default=0)
        # What a person has acknowledged counts once the key's owner has confirmed it.
        said = read(places.audit, [ACKNOWLEDGED, CONFIRMED])
        by = [row for row in said if row.entry.kind == CONFIRMED]
        keys = {public} if public is not None else {signed.key for signed in heads}
        noted = [
            (row.id, row.entry)
            for row in said
            if row.entry.kind == ACKNOWLEDGED and any(has_confirmation(places.audit, row, by, key) for key in keys)
        ]
        notes += [f"row {number}: {entry.who} has acknowledged that {entry.reason}" for number, entry in noted]
        missing = [
            signed
            for signed in heads
            if stored.get(signed.row) != signed.head and not _has_excuse(signed, noted, stored.get(1, ""))
        ]
    lost = max(missing, key=lambda signed: (signed.time, signed.row), default=None)
    if lost is not None:
        problems.insert(
            0,
            f"row {lost.row} with the hash {lost.head} was signed and is not in it: the log was cut, emptied, begun "
            "anew or computed anew",
        )
    return AuditVerdict(
        rows=chain.rows,
        head=chain.head,
        problem="; ".join([chain.problem, *problems] if chain.problem else problems),
        broken=chain.problem,
        lost=lost,
        witnesses=witnesses,
        witnessed=witnessed,
        notes=tuple(notes),
    )


def _verify_chain(audit: Path, head: str) -> ChainVerdict:
    """The verdict on the chain, of a damaged file too. Raises AuditError for what is no audit log at all."""
    try:
        return verify(audit, head)
    except AuditError:
        if not (reason := damage(audit)):
            raise
        return ChainVerdict(0, "", f"is damaged ({reason}), and no row of it can be read")


def acknowledgement(lost: SignedHead, by: str, now: float) -> AuditEntry:
    """The row by which a person takes note that the rows up to a head are lost."""
    detail = {"head": lost.head, "row": lost.row, "begin": lost.begin}
    return AuditEntry(now, ACKNOWLEDGED, by, f"the rows up to {lost.row}, head {lost.head}, are lost", detail)


def _has_excuse(signed: SignedHead, acknowledged: Sequence[tuple[int, AuditEntry]], begin: str) -> bool:
    """True for a head of rows that a person has acknowledged as lost."""
    for number, entry in acknowledged:
        detail = entry.detail
        if detail.get("begin") == signed.begin and signed.row <= int(detail.get("row", 0)):
            # In a chain that lost only its end, what lies before the acknowledgement has to be there still.
            return signed.begin != begin or signed.row >= number
    return False


def _gather(places: WitnessPlaces) -> tuple[dict[str, str], list[SignedHead], list[str]]:
    """Of each witness what it holds, all their signed heads, and what is wrong with them."""
    witnesses: dict[str, str] = {}
    heads: dict[tuple[int, str, str], SignedHead] = {}
    problems: list[str] = []

    def take(name: str, rows: Iterable[object], whole: bool = True) -> None:
        read_rows = list(rows)
        valid = [signed for row in read_rows if (signed := parse_head(row)) is not None]
        heads.update({(signed.row, signed.head, signed.key): signed for signed in valid})
        witnesses[name] = f"{len(valid)} signed heads" if valid else "holds no signed head"
        if len(valid) < len(read_rows) and whole:
            problems.append(f"{name}: {len(read_rows) - len(valid)} heads are not signed rightly: they were changed")

    name = f"heads file {places.heads}"
    try:
        lines = places.heads.read_bytes().split(b"\n")
        # What follows the last line break is the line that a power cut has torn.
        take(name, [_json(line) for line in lines[:-1] if line.strip()])
    except FileNotFoundError:
        witnesses[name] = "is not there"
    except OSError as error:
        witnesses[name] = f"cannot be read ({error.strerror})"
    if places.historian is not None:
        from gateway.store.read_back import reading  # loads numpy, which most of those who ask for the log do without

        name = f"historian {places.historian}"
        try:
            with reading(places.historian) as connection:
                rows = connection.execute("SELECT content FROM state WHERE key = ?", (HEAD_STATE,)).fetchall()
            take(name, [_json(str(row[0]).encode()) for row in rows])
        except (HistorianError, OSError) as error:
            witnesses[name] = f"cannot be read ({error})"
    for log in places.logs:
        name = f"log {log}"
        try:
            with log.open("rb") as file:
                mark = HEAD_EVENT.encode()
                rows_of_log = [_json(line) for line in file if mark in line]
            take(name, [row for row in rows_of_log if isinstance(row, dict) and row.get("event") == HEAD_EVENT])
        except OSError as error:
            witnesses[name] = f"cannot be read ({error.strerror})"
    return witnesses, list(heads.values()), problems


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def trusted_key(places: WitnessPlaces, public: Path | None) -> str | None:
    """The public key (digits) that signed heads have to be by: of the file `public`, else of the gateway's own key.

    None where there is no key at all. Raises SigningKeyError for a key file that cannot be trusted.
    """
    if public is not None:
        return load_public_key(public)
    if places.key.exists():
        return public_digits(load_key(places.key).public_key())
    return load_public_key(public_path(places.key)) if public_path(places.key).exists() else None
