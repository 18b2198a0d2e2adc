"""One door for all commands that take a model: a directory, a store, a version, a JSON file, a set of artefacts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sim.artefacts import (
    MODEL_FILE,
    STORE_FILE,
    ModelVerdict,
    current,
    is_store,
    load,
    read_model,
    read_verdict,
    version_directory,
)
from sim.files import ArtefactError, file_error
from sim.lab.suffixes import SUFFIXES
from sim.sha import SHA, Alphabet, Model, Provenance

if TYPE_CHECKING:
    from sim.lab.formats.foreign import Artefacts, Parameter

SOURCE_SUFFIX = SUFFIXES["source"]
OPTIONAL_ARTEFACTS = ("report", "histogram", "flows")


@dataclass(frozen=True, slots=True)
class FoundModel:
    """What lies under a name. `structure` is always there: locations and edges; `model` is what can be run.

    `model` is None where artefacts describe no automaton that can be run, and `refusal` is then the sentence why.
    `artefacts` are the files read, None for a model of our own; `notes` what they said that the model does not.
    `home` is the directory that it lies in, None for a file by itself and for artefacts; `verdict` is that which was
    kept there where it was learned, None where none is.
    """

    name: str
    structure: SHA
    model: Model | None
    artefacts: Artefacts | None = None
    notes: tuple[str, ...] = ()
    refusal: str = ""
    verdict: ModelVerdict | None = None
    home: Path | None = None

    def runnable(self) -> Model:
        """The model. Raises ArtefactError with the refusal where there is none."""
        if self.model is None:
            raise ArtefactError(self.refusal)
        return self.model


def find_model(
    where: str | Path,
    *,
    alphabet: Alphabet | None = None,
    temperature: str = "Temp",
    parameter: Parameter = "rate",
) -> FoundModel:
    """The model under `where`, which is one of:

    a model directory, a store (its current version), `STORE@VERSION`, a `model.json`; `DIR/NAME` for the artefacts
    `DIR/NAME_source.txt` and so on; a directory that holds artefacts of one base name.

    Artefacts know neither their signals nor their sensor: `alphabet` and `temperature` (a column map's) are put in,
    and the sensor is taken as perfect. `parameter` is that of `convert.to_sha`. Raises ArtefactError.
    """
    path = Path(where)
    base = artefact_base(path)
    if base is None:
        store, at_sign, version = str(path).rpartition("@")
        if at_sign and not path.exists() and (Path(store) / STORE_FILE).is_file():
            model, home = load(Path(store), version), version_directory(Path(store), version)
        elif path.exists():
            home = version_directory(path, current(path)) if is_store(path) else path
            # A model's file in its directory is that directory's model.
            model, home = read_model(path), path.parent if path.name == MODEL_FILE else home
        else:
            sets = _sets(path.parent)
            others = f"; the artefact sets in {path.parent} are {', '.join(sets)}" if sets else ""
            raise file_error(
                path, None, f"there is no model directory, store, file or set of artefacts of this name{others}"
            )
        if not home.is_dir():
            return FoundModel(model.sha.name, model.sha, model)
        return FoundModel(model.sha.name, model.sha, model, verdict=read_verdict(home), home=home)
    # The grammars of the artefacts, of which a model of our own needs none.
    from sim.lab.formats.foreign import read_artefacts, structure, to_sha

    artefacts = read_artefacts(base[0], base[1], OPTIONAL_ARTEFACTS)
    bare = structure(artefacts.source, artefacts.name)
    try:
        converted = to_sha(artefacts, parameter)
    except ArtefactError as error:
        return FoundModel(artefacts.name, bare, None, artefacts, refusal=f"{base[0] / base[1]}: {error}")
    model = Model(
        sha=converted.sha,
        alphabet=alphabet if alphabet is not None else Alphabet(()),
        temperature=temperature,
        sensor_sigma=0.0,
        provenance=Provenance(method="artefacts"),
    )
    return FoundModel(artefacts.name, converted.sha, model, artefacts, converted.notes)


def artefact_base(path: Path) -> tuple[Path, str] | None:
    """(directory, base name) where `path` means artefacts; None where it means a model of our own.

    Raises ArtefactError where a directory holds several sets.
    """
    if path.is_dir():
        if any((path / file).is_file() for file in (MODEL_FILE, STORE_FILE)):
            return None
        sets = _sets(path)
        if len(sets) > 1:
            raise file_error(
                path, None, f"holds {len(sets)} sets of artefacts; say which, as {path / sets[0]} ({', '.join(sets)})"
            )
        return (path, sets[0]) if sets else None
    if path.exists():
        return (path.parent, path.name.removesuffix(SOURCE_SUFFIX)) if path.name.endswith(SOURCE_SUFFIX) else None
    names = {name.casefold() for name in _sets(path.parent)}
    return (path.parent, path.name) if path.name.casefold() in names else None


def _sets(directory: Path) -> list[str]:
    """The base names in a directory that can be listed."""
    try:
        return sorted(
            entry.name.removesuffix(SOURCE_SUFFIX)
            for entry in directory.iterdir()
            if entry.name.endswith(SOURCE_SUFFIX)
        )
    except OSError:
        return []
