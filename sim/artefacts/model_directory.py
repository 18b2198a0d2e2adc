"""A plain directory with one model: `model.json`, the artefacts under the model's base name, and a manifest of hashes.

`model.json` alone is the model; the artefacts say the same to other tools. The manifest is written last and removed
first, so that a directory whose writing was interrupted has none, and one that has it is whole.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.artefacts.bundle import texts
from sim.artefacts.files import at, read_text, refused, replace_durably, sync_directory, write_durably
from sim.artefacts.from_model import RawValues, to_artefacts
from sim.artefacts.json_reading import Node, parse_json
from sim.artefacts.model_json import model_hash, model_text, parse_model
from sim.learning.lsha.hypothesis import ObservationTable
from sim.sha.model import Model

MODEL_FILE = "model.json"
MANIFEST = "manifest.json"

Facts = Mapping[str, str | float]
"""What a manifest says besides the files' hashes: method, data hash, parent, time of creation."""


def directory_files(
    model: Model, histogram: RawValues | None = None, observations: ObservationTable | None = None
) -> dict[str, str]:
    """The content of a model directory by file name, without the manifest. Raises ArtefactError."""
    return {MODEL_FILE: model_text(model)} | texts(to_artefacts(model, histogram, observations))


def manifest_text(model: Model, files: Mapping[str, str], facts: Facts) -> str:
    """The manifest: the model's content hash, where it comes from, and the SHA-256 of each file."""
    hashes = {name: _sha256(content.encode()) for name, content in sorted(files.items())}
    origin = {"method": model.provenance.method, "data_hash": model.provenance.data_hash}
    document: dict[str, Any] = {"name": model.sha.name, "model_hash": model_hash(model)} | origin | dict(facts)
    return json.dumps(document | {"files": hashes}, indent=2, ensure_ascii=False) + "\n"


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def write_files(directory: Path, files: Mapping[str, str]) -> None:
    """Writes files into a directory that nobody reads yet. Raises OSError."""
    for name, content in files.items():
        write_durably(directory / name, content)
    sync_directory(directory)


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
        stale = set(_earlier_files(out)) - set(files)
        (out / MANIFEST).unlink(missing_ok=True)
        for name, content in (*files.items(), (MANIFEST, manifest)):
            replace_durably(out / name, content)
        for name in stale:
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise refused(out, error) from None
    return out / MODEL_FILE


def _earlier_files(out: Path) -> list[str]:
    """The files of the model that `out` holds. Raises ArtefactError when it holds something else."""
    present = {path.name for path in out.iterdir()}
    if MANIFEST in present:
        return list(_listed(out / MANIFEST))
    if present and MODEL_FILE not in present and not all(name.startswith(".") for name in present):
        some = ", ".join(sorted(present)[:3])
        raise at(out, None, f"is no model directory (it has {some}); give a new directory or an empty one")
    return []


def _listed(manifest: Path) -> dict[str, str]:
    """The hash of each file by its name. Raises ArtefactError."""
    hashes = parse_json(read_text(manifest), manifest).get("files").table(Node.text)
    strange = next((name for name in hashes if "/" in name or name in ("", ".", "..")), None)
    if strange is not None:
        raise at(manifest, None, f"files: {strange!r} is no file of this directory; write the model again")
    return hashes


def read_model_directory(directory: Path) -> Model:
    """The model of a directory. Raises ArtefactError, also when a file is not what the manifest says it was."""
    if (directory / MANIFEST).is_file():
        check_hashes(directory)
    file = directory / MODEL_FILE
    return parse_model(read_text(file), file)


def check_hashes(directory: Path) -> None:
    """Raises ArtefactError, naming the file, unless every file of the manifest is there and unchanged."""
    manifest = directory / MANIFEST
    hashes = _listed(manifest)
    for name, expected in hashes.items():
        try:
            found = _sha256((directory / name).read_bytes())
        except OSError as error:
            sentence = f"the manifest lists this file, but it cannot be read ({error.strerror}); write the model again"
            raise at(directory / name, None, sentence) from None
        if found != expected:
            sentence = (
                f"its content has changed since it was written (SHA-256 {found[:12]}, manifest {expected[:12]}); "
                "restore the file, or write the model again"
            )
            raise at(directory / name, None, sentence)
    if MODEL_FILE not in hashes:
        raise at(manifest, None, f"files: {MODEL_FILE} is not listed; write the model again")
