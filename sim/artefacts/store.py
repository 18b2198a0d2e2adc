"""A versioned store of models in a directory: every version is whole or not there, and one of them is current.

    STORE/store.json          says that this is a store
    STORE/versions/0001-1f2e3d4c/   number and start of the model's hash; a model directory with its manifest
    STORE/current             the name of the promoted version
    STORE/promoted.json       the names of the versions that ran, in the order of their promotions
    STORE/forced.json         who promoted which version although it does not verify or is unfit, when and why
    STORE/.lock               held while a version is written or promoted

A version is written under a name that begins with a dot and renamed when all of it is on the disk; `current` is
replaced by a rename. A kill at any moment leaves at most such a dotted directory, which the next save removes. Versions
are saved by `write_model`; here they are read and promoted.
"""

import fcntl
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from sim.artefacts.json_node import JsonNode, parse_json
from sim.artefacts.model_directory import (
    MODEL_FILE,
    check_hashes,
    read_model_directory,
)
from sim.artefacts.model_json import read_model_file
from sim.artefacts.verdict_file import ModelVerdict, read_verdict
from sim.files import file_error, read_text, replace_durably, write_error
from sim.sha import Model

STORE_FILE = "store.json"
CURRENT_LINK = "current"
PROMOTED_FILE = "promoted.json"
FORCED_FILE = "forced.json"
VERSIONS_FOLDER = "versions"


@dataclass(frozen=True, slots=True)
class Force:
    """Who promoted a version that does not verify or is unfit, why, and when (seconds UTC)."""

    by: str
    reason: str
    time: float


def versions(store: Path) -> tuple[str, ...]:
    """The versions of a store, oldest first; none for a new one. Raises ArtefactError when it is no store."""
    check_store(store)
    names = [
        path.name for path in (store / VERSIONS_FOLDER).iterdir() if re.fullmatch(r"\d{4,}-[0-9a-f]{8}", path.name)
    ]
    return tuple(sorted(names, key=version_number))


def current(store: Path) -> str:
    """The promoted version. Raises ArtefactError when there is none."""
    known = versions(store)
    file = store / CURRENT_LINK
    if not file.is_file():
        raise file_error(
            store, None, f"no version is promoted; promote one of: {', '.join(known) or 'none yet, save a model'}"
        )
    name = read_text(file).strip()
    if name not in known:
        raise file_error(
            file, None, f"names the version {name!r}, which is not there; promote one of: {', '.join(known)}"
        )
    return name


def load(store: Path, version: str | None = None) -> Model:
    """The model of a version (by default the current one), its files' hashes checked. Raises ArtefactError."""
    directory = version_directory(store, version)
    check_hashes(directory)
    return read_model_file(directory / MODEL_FILE)


def version_directory(store: Path, version: str | None = None) -> Path:
    """Where the files of a version lie (by default of the current one). Raises ArtefactError."""
    name = current(store) if version is None else version
    if name not in versions(store):
        raise file_error(
            store, None, f"there is no version {name!r}; there are: {', '.join(versions(store)) or 'none'}"
        )
    return store / VERSIONS_FOLDER / name


def objections(refuted: Sequence[str], verdict: ModelVerdict | None) -> list[str]:
    """What speaks against running a model: what its proof refutes, and a verdict of unfit where it was learned."""
    found = [f"it does not verify: {'; '.join(refuted)}"] if refuted else []
    return found + ([f"it is {verdict.sentence}"] if verdict is not None and verdict.word == "unfit" else [])


def objection(store: Path, version: str) -> tuple[bool, str]:
    """(whether a version can be run at all, what speaks against promoting it: "" for nothing). Raises ArtefactError."""
    # Only a promotion proves; the running gateway reads what was promoted.
    from sim.proof import verify

    verification = verify(load(store, version))
    if not verification.executable:
        return False, "; ".join(verification.reasons)
    verdict = read_verdict(version_directory(store, version))
    return True, "; and ".join(objections(verification.reasons, verdict))


def promote(store: Path, version: str, force: Force | None = None, *, beside: str = "") -> None:
    """Makes a version the current one, if its files are as they were written, its model verifies as deployable, and it
    was not judged unfit where it was learned.

    `beside` is what speaks against it beside the one that runs ("" for nothing). `force` promotes one that can be run
    all the same; it is recorded in the store. Raises ArtefactError.
    """
    runs, reason = objection(store, version)
    if not runs:
        raise file_error(
            store / VERSIONS_FOLDER / version, None, f"is not promoted, as it cannot be run at all: {reason}"
        )
    reason = "; and ".join(filter(None, (reason, beside)))
    if reason and force is None:
        raise file_error(
            store / VERSIONS_FOLDER / version,
            None,
            f"is not promoted, as {reason}; see `decanter model judge proof {store}@{version}`, learn "
            "another model, or force it with a name and a reason",
        )
    try:
        with lock_store(store):
            if reason and force is not None:
                # The record goes first: a kill between the two leaves a reason without a promotion, never the reverse.
                known = {name: asdict(record) for name, record in _forces(store).items()}
                replace_durably(store / FORCED_FILE, json.dumps(known | {version: asdict(force)}, indent=2) + "\n")
            before = ran(store)
            replace_durably(store / CURRENT_LINK, version + "\n")
            # It goes last: a kill between the two is made good by the next promotion, as `ran` begins with what runs.
            if before[-1:] != (version,):
                replace_durably(store / PROMOTED_FILE, json.dumps({"ran": [*before, version]}, indent=1) + "\n")
    except OSError as error:
        raise write_error(store, error) from None


def ran(store: Path) -> tuple[str, ...]:
    """The versions that ran, in the order of their promotions, the current one last; none before a promotion.

    Of a store of a former release only the current one is known. Raises ArtefactError.
    """
    file = store / PROMOTED_FILE
    known = [each.text() for each in parse_json(read_text(file), file).get("ran").each()] if file.is_file() else []
    # By what the file says: one that names a version which is gone must not stand in the way of the next promotion.
    running = [read_text(store / CURRENT_LINK).strip()] if (store / CURRENT_LINK).is_file() else []
    return tuple(known) if known[-1:] == running else (*known, *running)


def find_force(path: Path, version: str | None = None) -> Force | None:
    """Who forced a version of the store at `path`, by default the current one; None for others, and for no store.

    Raises ArtefactError.
    """
    return _forces(path).get(version or current(path)) if is_store(path) else None


def is_store(path: Path) -> bool:
    """Whether a store lies at `path`."""
    return (path / STORE_FILE).is_file()


def promotion(store: Path) -> tuple[tuple[int, int] | None, ...]:
    """What changes when a version is promoted or forced, and else does not: to be compared, cheap enough to poll."""
    # Inode and time (ns), not content: a running gateway asks this again and again, and each rename puts another file
    # there. None where there is none.
    stamps: list[tuple[int, int] | None] = []
    for name in (CURRENT_LINK, FORCED_FILE):
        try:
            status = (store / name).stat()
        except OSError:
            stamps.append(None)
        else:
            stamps.append((status.st_ino, status.st_mtime_ns))
    return tuple(stamps)


def _forces(store: Path) -> dict[str, Force]:
    file = store / FORCED_FILE
    if not file.is_file():
        return {}
    return parse_json(read_text(file), file).table(_read_force)


def _read_force(node: JsonNode) -> Force:
    node.require_keys(("by", "reason", "time"))
    return Force(node.get("by").text(), node.get("reason").text(), node.get("time").number())


def read_model(path: Path) -> Model:
    """The model at `path`: a JSON file, a model directory, or a store (its current version). Raises ArtefactError."""
    if path.is_dir():
        if is_store(path):
            return load(path)
        if (path / MODEL_FILE).is_file():
            return read_model_directory(path)
        present = ", ".join(sorted(entry.name for entry in path.iterdir())[:5]) or "nothing"
        raise file_error(
            path, None, f"has neither {MODEL_FILE} nor {STORE_FILE} (it has {present}); give a model or a store"
        )
    return read_model_file(path)


def check_store(store: Path) -> None:
    file = store / STORE_FILE
    if not file.is_file():
        raise file_error(
            store, None, f"is no model store (no {STORE_FILE} in it); save a model there first, or give another"
        )
    document = parse_json(read_text(file), file)
    if document.get("version").integer() != 1:
        raise document.get("version").error("this version of the store is unknown; this program reads version 1")


@contextmanager
def lock_store(store: Path) -> Iterator[None]:
    """One writer at a time; the system releases the lock when a process dies. Raises OSError."""
    handle = os.open(store / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)  # waits for whoever holds it
        yield
    finally:
        os.close(handle)


def version_number(name: str) -> int:
    return int(name.partition("-")[0])
