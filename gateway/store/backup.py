"""Backups of a running gateway: one folder with a manifest, there whole or not at all, and back from it.

`files/` holds the files, numbered; `manifest.json` says of each where it was, its size, mode and SHA-256. Databases are
copied by SQLite's online backup, so that the gateway goes on meanwhile; the audit log comes last, so that no signed
head in the backup is newer than the log in it. The manifest's seal, a hash over all of it, is signed in `manifest.sig`
by whoever holds the gateway's key: what is in a manifest is believed as far as somebody vouches for its seal.
"""

import hashlib
import json
import os
import re
import shutil
import sqlite3
import stat
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from drivers.errors import OneLineError
from drivers.named_files import contents, normal_path
from gateway.replacement import draft_path, replace_files
from gateway.store import audit as audit_log
from gateway.store import schema
from gateway.store.audit import verify
from gateway.store.audit_damage import damage
from gateway.store.durable import DATABASE_SUFFIXES, free_name, sync_folder, write_durably
from gateway.store.signing import public_digits, verify_signature

FORMAT = 1
MANIFEST = "manifest.json"
SIGNATURE = "manifest.sig"
DAMAGED_AUDIT = "damaged audit"
"""The role of an audit log that is no database any more."""
ROLES_ONCE = frozenset({"plant", "accounts", "key", "public key", "heads", "historian", "audit", DAMAGED_AUDIT})
"""What at most one file of a backup is."""
ROLES = ROLES_ONCE | {"device", "model"}
"""What a file of a backup may be to the gateway."""
PERMISSIONS = 0o777
"""The bits of a file's mode that are kept; no backup makes a file that runs as its owner."""
LAYOUTS: Mapping[str, int] = {"historian": schema.VERSION, "audit": audit_log.VERSION}
"""The newest layouts of the databases that this program reads, by role."""
_STORED = re.compile(r"files/\d{4}-[^/\0]{1,200}")
_CHUNK = 1 << 20
_FARTHEST_NS = 8e18
"""Of a moment from 1970, either way: what a file's time can be (64 bits of ns)."""
_LONGEST = 16 << 20


class BackupError(OneLineError, ValueError):
    """No backup, or none that can be used; the message is one sentence that says why and what would be right."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Backed:
    """One file of a backup: what it is to the gateway, its name in the backup, and what it was (`time` in ns)."""

    role: str
    stored: str
    original: str
    sha256: str
    size: int
    mode: int
    time: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """What a backup holds. `audit_head` is the newest hash of the audit log in it ("" without one); `note` is of who
    made it ("" for none), `damaged` says what is wrong with the audit log ("" nothing); `seal` is the hash over all
    the others."""

    made: float
    program: str
    layouts: Mapping[str, int]
    audit_rows: int
    audit_head: str
    files: tuple[Backed, ...]
    note: str = ""
    damaged: str = ""
    seal: str = ""


def damaged_audit(audit: Path) -> Path:
    """Where an audit log that is no database any more is restored to."""
    return audit.with_name(f"{audit.name}.damaged")


def make_backup(
    folder: Path,
    sources: Sequence[tuple[str, Path]],
    *,
    now: float,
    program: str,
    note: str = "",
    key: Ed25519PrivateKey | None = None,
) -> Manifest:
    """Copy the sources (role, file), in their order, into a new folder; the audit log has to be the last.

    An audit log whose chain is broken is copied too, and one that cannot be read as the file that it is, under another
    name: `damaged` says so. With `key`, the gateway's, the manifest is signed. Raises BackupError and OSError; nothing
    is left at `folder` then.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BackupError(f"{folder}: is there already; give the name of a new folder")
    draft = folder.with_name(f".{folder.name}.partial-{os.getpid()}")
    shutil.rmtree(draft, ignore_errors=True)
    done = False
    try:
        (draft / "files").mkdir(parents=True)
        draft.chmod(0o700)  # it holds the key
        files, layouts, rows, head, damaged = list[Backed](), dict[str, int](), 0, "", ""
        for number, (given, source) in enumerate(sources):
            role, original = given, normal_path(source)
            stored = f"files/{number:04d}-{source.name}"
            target = draft / stored
            status = source.stat()
            mode = stat.S_IMODE(status.st_mode) & PERMISSIONS
            if any((file.role, file.original) == (role, str(original)) for file in files):
                continue
            if not original.samefile(source):
                raise BackupError(f"{source}: leads by '..' out of a link; name it in the plant file without '..'")
            if role == "audit" and (damaged := damage(source)):
                # Under another name: a start on what is restored begins a new log, and this one is evidence.
                role, original = DAMAGED_AUDIT, damaged_audit(original)
            if role in LAYOUTS:
                layouts[role] = _copy_database(source, target)
            else:
                _copy(source, target)
            if role == "audit":
                verdict = verify(target)
                rows, head, damaged = verdict.rows, verdict.head, verdict.problem
            target.chmod(mode)
            files.append(
                Backed(
                    role=role,
                    stored=stored,
                    original=str(original),
                    sha256=_digest(target),
                    size=target.stat().st_size,
                    mode=mode,
                    time=status.st_mtime_ns,
                )
            )
        sync_folder(draft / "files")
        manifest = Manifest(
            made=now,
            program=program,
            layouts=layouts,
            audit_rows=rows,
            audit_head=head,
            files=tuple(files),
            note=note,
            damaged=damaged,
        )
        content = {"format": FORMAT, **asdict(manifest)}
        del content["seal"]
        for name in ("note", "damaged"):  # which former programs do not know
            if not content[name]:
                del content[name]
        manifest = replace(manifest, seal=_seal(content))
        write_durably(draft / MANIFEST, json.dumps({**content, "seal": manifest.seal}, indent=1).encode())
        if key is not None:  # in a file of its own: former programs read the manifest
            signature = {
                "key": public_digits(key.public_key()),
                "signature": key.sign(_signed_bytes(manifest.seal)).hex(),
            }
            write_durably(draft / SIGNATURE, json.dumps(signature).encode())
        if folder.exists():
            folder.rmdir()
        draft.rename(folder)
        sync_folder(folder.parent)
        done = True
    except sqlite3.Error as error:
        raise BackupError(f"the backup is not made: {error}") from None
    finally:
        if not done:
            shutil.rmtree(draft, ignore_errors=True)
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a whole backup, every file of it looked at.

    Raises BackupError for one that is partial, damaged, changed, or made by a newer program.
    """
    path = folder / MANIFEST
    try:
        content = json.loads(contents(path, _LONGEST))
        seal = content.pop("seal", "")
    except FileNotFoundError:
        raise BackupError(f"{folder}: has no {MANIFEST}, so it is no backup or only a part of one") from None
    except OSError as error:
        raise BackupError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError, AttributeError, TypeError):
        raise BackupError(f"{path}: is damaged; take another backup") from None
    form = content.get("format")
    if isinstance(form, int) and form > FORMAT:
        raise BackupError(f"{path}: has format {form}, this program reads {FORMAT}; restore it with a newer program")
    try:
        if form != FORMAT or seal != _seal(content):
            raise ValueError
        del content["format"]
        files = tuple(Backed(**{**file, "mode": file["mode"] & PERMISSIONS}) for file in content["files"])
        manifest = Manifest(**{**content, "files": files, "seal": seal})
        numbers = [manifest.made, *manifest.layouts.values()]
        numbers += [number for file in manifest.files for number in (file.size, file.mode, file.time)]
        if not all(isinstance(file.time, int) for file in manifest.files):
            raise TypeError
        texts = [manifest.note, manifest.damaged]
        texts += [text for file in manifest.files for text in (file.role, file.stored, file.original, file.sha256)]
        if not (all(isinstance(n, int | float) for n in numbers) and all(isinstance(text, str) for text in texts)):
            raise TypeError
        moments = [manifest.made * 1e9, *(file.time for file in manifest.files)]
        if not all(abs(moment) < _FARTHEST_NS for moment in moments):
            raise ValueError
    except (ValueError, TypeError, KeyError, AttributeError):
        raise BackupError(f"{path}: is damaged or was changed; take another backup") from None
    for role, layout in manifest.layouts.items():
        if layout > LAYOUTS.get(role, 0):
            raise BackupError(
                f"{folder}: its {role} has layout {layout}, this program reads {LAYOUTS.get(role, 0)}; restore it with "
                "a newer program"
            )
    for number, file in enumerate(manifest.files):
        original = Path(file.original)
        if not _STORED.fullmatch(file.stored) or not original.is_absolute() or ".." in original.parts:
            raise BackupError(f"{path}: names {file.stored!r} for {file.original!r}, which no backup does")
        others = [other for other in manifest.files[:number] if other.role == file.role and other.role in ROLES_ONCE]
        others += [other for other in manifest.files[:number] if other.original == file.original]
        if file.role not in ROLES or others:
            both = " and ".join(repr(other.original) for other in (*others[:1], file))
            raise BackupError(f"{path}: has {both} as {file.role!r}, which no backup does")
        stored = folder / file.stored
        if stored.is_symlink() or not stored.is_file():
            raise BackupError(f"{stored}: is missing; the backup is not whole, take another one")
        if stored.stat().st_size != file.size or _digest(stored) != file.sha256:
            raise BackupError(f"{stored}: is not as it was backed up; the backup is damaged, take another one")
    return manifest


def signer(folder: Path, manifest: Manifest) -> str:
    """The public key (digits) that has signed a backup; "" where none has."""
    try:
        plain = json.loads(contents(folder / SIGNATURE, _LONGEST))
        key, signature = str(plain["key"]), str(plain["signature"])
    except (OSError, ValueError, RecursionError, TypeError, KeyError):
        return ""
    return key if verify_signature(key, signature, _signed_bytes(manifest.seal)) else ""


def stage(folder: Path, manifest: Manifest, root: Path) -> dict[Path, Path]:
    """Copy a backup's files beside the places under `root` where they were, on the disk; gives draft by place.

    Within `gateway.replacement.hold_folder`. Raises OSError, BackupError for a file that has changed since the manifest
    was read, and leaves no draft then.
    """
    places = [root / Path(file.original).relative_to("/") for file in manifest.files]
    drafts = {place: draft_path(place) for place in places}
    discard(drafts)  # of one that was killed
    done = False
    try:
        for file, place in zip(manifest.files, places, strict=True):
            place.parent.mkdir(parents=True, exist_ok=True)
            draft = drafts[place]
            _copy(folder / file.stored, draft)
            if _digest(draft) != file.sha256:
                raise BackupError(f"{folder / file.stored}: was changed while it was being restored")
            draft.chmod(file.mode)
            # What the plant file's time of change says of its arming stays as it was.
            os.utime(draft, ns=(file.time, file.time))
        done = True
    finally:
        if not done:
            discard(drafts)
    return drafts


def put_in_place(plant: Path, drafts: Mapping[Path, Path], *, away: Sequence[Path] = ()) -> list[Path]:
    """Give every draft its place, in one step with that of the plant file, within `gateway.replacement.hold_folder`.

    What stands there is set aside, and what stands at the places `away`; its new names are given back. Raises OSError.
    """
    for draft in drafts.values():
        with draft.open("rb") as file:
            os.fsync(file.fileno())
    # A database's write-ahead log goes with it: beside another database it would be taken for that one's.
    renames = [
        (beside, aside.with_name(aside.name + suffix))
        for place in (*drafts, *away)
        for aside in (free_name(place, "replaced"),)
        for suffix in DATABASE_SUFFIXES
        if (beside := place.with_name(place.name + suffix)).exists()
    ]
    with replace_files(plant, drafts.keys(), renames):
        pass
    return [aside for place, aside in renames if place in drafts or place in away]


def as_one_file(path: Path) -> None:
    """Have all of a database in its file, with nothing beside it. Raises sqlite3.Error."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE").fetchone()


def discard(drafts: Mapping[Path, Path]) -> None:
    """Remove drafts that are not put in place."""
    for draft in drafts.values():
        for suffix in DATABASE_SUFFIXES:
            with suppress(OSError):
                draft.with_name(draft.name + suffix).unlink(missing_ok=True)


def _copy(source: Path, target: Path) -> None:
    # Readable by its owner alone until its own mode is given to it: it may be the key.
    file = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(file, "wb") as copy, source.open("rb") as original:
        shutil.copyfileobj(original, copy, _CHUNK)
        copy.flush()
        os.fsync(copy.fileno())


def _copy_database(source: Path, target: Path) -> int:
    """Copy a database while others write to it, as one file; gives its layout. Raises sqlite3.Error, BackupError."""
    with (
        closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True, timeout=10.0)) as original,
        closing(sqlite3.connect(target)) as copy,
    ):
        # In one step, within one reading of the source: whoever writes is not held up, and nothing is begun anew.
        original.backup(copy, pages=-1)
        copy.execute("PRAGMA journal_mode = DELETE").fetchone()
        found = str(copy.execute("PRAGMA quick_check(1)").fetchone()[0])
        if found != "ok":
            raise BackupError(f"{source}: is damaged ({found.splitlines()[-1]}), so no backup of it is made")
        layout = int(copy.execute("PRAGMA user_version").fetchone()[0])
    with target.open("rb") as file:
        os.fsync(file.fileno())
    return layout


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _signed_bytes(seal: str) -> bytes:
    return f"decanter keep backup {seal}\n".encode()


def _seal(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
