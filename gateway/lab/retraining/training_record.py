"""`record.json` of a version: everything that it was made of, so that it can be made again bit for bit."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any

from pydantic import TypeAdapter, ValidationError

from sim.artefacts import MANIFEST
from sim.files import file_error, read_text
from sim.strict_json import json_text

RECORD, FORMAT = "record.json", "decanter-training-record"
LIBRARIES = ("numpy", "scipy")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingRecord:
    """How a version came about: `training` are (name, content hash) of its traces, `settings` those of the `method`.

    `parent` is the version that it was learned beside, `code` the hash of the program's arithmetic, `software` the
    versions of what it ran on, `study` the retraining that made it (its settings' hash).
    """

    name: str
    method: str
    settings: Mapping[str, str | float | int | bool]
    seed: int
    parent: str
    parent_hash: str
    training: tuple[tuple[str, str], ...]
    code: str
    software: Mapping[str, str]
    study: str

    def text(self) -> str:
        """The file's content."""
        return json_text({"format": FORMAT, "version": 1, **asdict(self)}, indent=1) + "\n"


def read_record(folder: Path) -> TrainingRecord | None:
    """That of the version in `folder`; None where it has none. Raises ArtefactError for one that cannot be used."""
    file = folder / RECORD
    if not file.is_file():
        return None
    text = read_text(file)
    try:
        document: dict[str, Any] = json.loads(text)
        if document["format"] != FORMAT or document["version"] != 1:
            raise ValueError("it is of another format")
        return TypeAdapter(TrainingRecord).validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        what = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise file_error(file, None, f"cannot be used as a record ({what}); restore it from a backup") from None
    except (KeyError, RecursionError, TypeError, ValueError) as error:
        raise file_error(
            file, None, f"cannot be used as a record ({str(error)[:80]}); restore it from a backup"
        ) from None


def creation_time(folder: Path) -> float:
    """When the version in `folder` was made (s UTC). Raises ArtefactError."""
    manifest = folder / MANIFEST
    try:
        created = float(json.loads(read_text(manifest))["created"])
        datetime.fromtimestamp(created, UTC)
        return created
    except (KeyError, OverflowError, OSError, TypeError, ValueError) as error:
        raise file_error(manifest, None, f"does not say when the version was made ({error!r}); restore it") from None


def code_hash(*folders: str) -> str:
    """SHA-256 over the sources of folders, file by file; without any over those that a model is computed by."""
    digest = sha256()
    for folder in folders or ("sim", "gateway/lab/retraining"):
        root = Path(__file__).parents[3] / folder
        for path in sorted(root.rglob("*.py")):
            digest.update(f"{path.relative_to(root).as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def software() -> dict[str, str]:
    """The versions of what arithmetic depends on."""
    return {"python": python_version(), **{name: version(name) for name in LIBRARIES}}
