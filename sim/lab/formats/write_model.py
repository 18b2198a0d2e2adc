"""Models are written: a model directory with all its artefacts, or a new version of a store.

Apart from reading (`model_directory`, `store`), which the running gateway does and which needs no grammar of the public
formats.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.artefacts import (
    FAMILIARITY_FILE,
    MANIFEST,
    MODEL_FILE,
    STORE_FILE,
    VERDICT_FILE,
    VERSIONS_FOLDER,
    check_store,
    lock_store,
    model_hash,
    model_text,
    read_hashes,
    sha256,
    version_number,
    versions,
)
from sim.files import file_error, replace_durably, sync_directory, write_durably, write_error
from sim.sha import Model

if TYPE_CHECKING:
    from sim.lab.formats.foreign import RawValues
    from sim.lab.learning.lsha import ObservationTable

STORE_TEXT = json.dumps({"format": "decanter-model-store", "version": 1}) + "\n"

Facts = Mapping[str, str | float]
"""What a manifest says besides the files' hashes: method, data hash, parent, time of creation."""


def directory_files(
    model: Model, histogram: RawValues | None = None, observations: ObservationTable | None = None
) -> dict[str, str]:
    """The content of a model directory by file name, without the manifest. Raises ArtefactError.

    An installation without the learner's forms writes the model alone.
    """
    own = {MODEL_FILE: model_text(model)}
    try:
        from sim.lab.formats.foreign import texts, to_artefacts
    except ModuleNotFoundError:
        return own
    return own | texts(to_artefacts(model, histogram, observations))


def manifest_text(model: Model, files: Mapping[str, str], facts: Facts) -> str:
    """The manifest: the model's content hash, where it comes from, and the SHA-256 of each file."""
    hashes = {name: sha256(content.encode()) for name, content in sorted(files.items())}
    origin = {"method": model.provenance.method, "data_hash": model.provenance.data_hash}
    document: dict[str, Any] = {"name": model.sha.name, "model_hash": model_hash(model)} | origin | dict(facts)
    return json.dumps(document | {"files": hashes}, indent=2, ensure_ascii=False) + "\n"


def write_files(directory: Path, files: Mapping[str, str]) -> None:
    """Writes files into a directory that nobody reads yet. Raises OSError."""
    for name, content in files.items():
        write_durably(directory / name, content)
    sync_directory(directory)


def check_free(out: Path, name: str) -> None:
    """Raises ArtefactError where a model of that name could not be written into `out`; makes nothing.

    To be asked before a model is learned. `out` may be absent, empty, or a model directory.
    """
    with suppress(ModuleNotFoundError):
        from sim.lab.formats.foreign import file_names

        file_names(name)
    try:
        _present(out)
    except OSError as error:
        raise write_error(out, error) from None


def _present(out: Path) -> set[str]:
    """The names of what is in `out`; none where it is not there. Raises ArtefactError, OSError."""
    present = {path.name for path in out.iterdir()} if out.exists() else set[str]()
    if present.isdisjoint({MANIFEST, MODEL_FILE}) and not all(name.startswith(".") for name in present):
        some = ", ".join(sorted(present)[:3])
        raise file_error(out, None, f"is no model directory (it has {some}); give a new directory or an empty one")
    return present


def write_model_directory(
    out: Path,
    model: Model,
    histogram: RawValues | None = None,
    *,
    observations: ObservationTable | None = None,
    more: Mapping[str, str] | None = None,
) -> Path:
    """Writes a model with all its artefacts into `out`, which is made; returns the path of its `model.json`.

    `histogram` has the raw parameter values by location, `observations` the learner's table, `more` the content of
    further files by their names (a learning report, say). A model directory that is there already is replaced file by
    file; files that no manifest lists are never touched, and a directory with other things in it is refused. Raises
    ArtefactError.
    """
    files = dict(more or {}) | directory_files(model, histogram, observations)
    manifest = manifest_text(model, files, {})
    try:
        out.mkdir(parents=True, exist_ok=True)
        stale = set(read_hashes(out / MANIFEST)) - set(files) if MANIFEST in _present(out) else set[str]()
        # Without a manifest the directory claims nothing of its files: a kill from here on leaves no wrong claim.
        (out / MANIFEST).unlink(missing_ok=True)
        for name, content in (*files.items(), (MANIFEST, manifest)):
            replace_durably(out / name, content)
        # What was said of the model before is not said of this one, though no manifest may have listed it.
        for name in stale | ({VERDICT_FILE, FAMILIARITY_FILE} - set(files)):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise write_error(out, error) from None
    return out / MODEL_FILE


def save(
    store: Path,
    model: Model,
    histogram: RawValues | None = None,
    *,
    created: float,
    parent: str = "",
    more: Mapping[str, str] | None = None,
) -> str:
    """Writes the model with all its artefacts as a new version and returns the version's name; promotes nothing.

    `histogram` has the raw parameter values by location, `created` the time in seconds UTC, `parent` the version that
    this one was derived from (by default the one in the model's provenance), `more` the content of further files by
    their names. Raises ArtefactError.
    """
    files = directory_files(model, histogram) | dict(more or {})
    facts: dict[str, str | float] = {"created": created, "parent": parent or model.provenance.parent}
    files[MANIFEST] = manifest_text(model, files, facts)
    try:
        # One listing decides: another writer may be making the store at this very moment.
        names = {path.name for path in store.iterdir()} if store.is_dir() else set()
        strange = sorted(name for name in names - {VERSIONS_FOLDER} if not name.startswith("."))
        if strange and STORE_FILE not in names:
            raise file_error(store, None, f"is no store (it has {strange[0]}); give a new directory or an empty one")
        store.mkdir(parents=True, exist_ok=True)
        with lock_store(store):
            directory = store / VERSIONS_FOLDER
            directory.mkdir(exist_ok=True)
            if not (store / STORE_FILE).exists():
                replace_durably(store / STORE_FILE, STORE_TEXT)
            check_store(store)
            # What killed writers left goes, under the lock alone: nobody else is writing.
            for path in directory.iterdir():
                if path.name.startswith("."):
                    shutil.rmtree(path)
            last = max((version_number(name) for name in versions(store)), default=0)
            version = f"{last + 1:04d}-{model_hash(model)[:8]}"
            # The dot hides it from `versions`; the rename on one file system is the moment at which the version exists.
            unfinished = directory / f".{version}"
            try:
                unfinished.mkdir()
                write_files(unfinished, files)
                unfinished.rename(directory / version)
            except OSError:
                shutil.rmtree(unfinished, ignore_errors=True)
                raise
            sync_directory(directory)
    except OSError as error:
        raise write_error(store, error) from None
    return version
