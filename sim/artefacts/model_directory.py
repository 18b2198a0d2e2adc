"""A plain directory with one model: `model.json`, the artefacts under the model's base name, and a manifest of hashes.

`model.json` alone is the model; the artefacts say the same to other tools. The manifest is written last and removed
first, so that a directory whose writing was interrupted has none, and one that has it is whole (`write_model`).
"""

import hashlib
from pathlib import Path

from drivers.named_files import regular
from sim.artefacts.json_node import JsonNode, parse_json
from sim.artefacts.model_json import parse_model
from sim.files import file_error, read_text
from sim.sha import Model

MODEL_FILE = "model.json"
MANIFEST = "manifest.json"


def sha256(content: bytes) -> str:
    """The hash of a file's content, 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def read_hashes(manifest: Path) -> dict[str, str]:
    """The hash of each file by its name. Raises ArtefactError."""
    hashes = parse_json(read_text(manifest), manifest).get("files").table(JsonNode.text)
    strange = next((name for name in hashes if "/" in name or name in ("", ".", "..")), None)
    if strange is not None:
        raise file_error(manifest, None, f"files: {strange!r} is no file of this directory; write the model again")
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
    hashes = read_hashes(manifest)
    for name, expected in hashes.items():
        try:
            digest = sha256(regular(directory / name).read_bytes())
        except OSError as error:
            sentence = f"the manifest lists this file, but it cannot be read ({error.strerror}); write the model again"
            raise file_error(directory / name, None, sentence) from None
        if digest != expected:
            sentence = (
                f"its content has changed since it was written (SHA-256 {digest[:12]}, manifest {expected[:12]}); "
                "restore the file, or write the model again"
            )
            raise file_error(directory / name, None, sentence)
    if MODEL_FILE not in hashes:
        raise file_error(manifest, None, f"files: {MODEL_FILE} is not listed; write the model again")
