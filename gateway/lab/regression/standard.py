"""What is run: the traces of a standard set, the models under a path, the program that forecasts."""

import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from itertools import chain
from pathlib import Path

import click

from drivers import DISTRIBUTION
from drivers.named_files import parse_toml
from gateway.lab.retraining.training_record import code_hash
from gateway.lab.traces.load import load_with_report
from sim.artefacts import MODEL_FILE, current, is_store, versions
from sim.files import ArtefactError, check_utf8, file_error, read_text
from sim.lab.formats import find_model
from sim.lab.recordings import files_by_machine
from sim.lab.suffixes import SUFFIXES
from sim.sha import Alphabet, Model, Trace

KEYS = ("traces", "map")


@dataclass(frozen=True, slots=True)
class StandardSet:
    """The traces that every model is held against, not encoded for any model, and the column map that read them.

    `problems` has a sentence for each trace that belongs to the set and is missing or cannot be read.
    """

    traces: Sequence[Trace]
    alphabet: Alphabet
    temperature: str
    problems: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class CodeVersion:
    """The program that forecasts: `content` is the hash of its sources, `release` and `commit` its names for people."""

    content: str
    release: str
    commit: str

    def __str__(self) -> str:
        return f"{self.release}{f' at {self.commit}' if self.commit else ''} ({self.content[:8]})"


def read_standard(path: str, map_name: str) -> StandardSet:
    """The standard set: traces (a file, a folder, a glob) read by the map, or a TOML list of them with its own map.

    Paths of a list are relative to it. Raises ValueError, also where there is no trace at all.
    """
    paths = [path]
    if path.endswith(".toml"):
        file = Path(path)
        try:
            document = parse_toml(read_text(file))
        except ValueError as error:
            raise file_error(file, None, f"cannot be read as a list of traces ({error})") from None
        strange = next((key for key in document if key not in KEYS), None)
        listed = document.get("traces")
        if strange is not None:
            raise file_error(
                file, None, f"{strange}: is no key of a standard set; it has traces, and map if it needs one"
            )
        if not (isinstance(listed, list) and listed and all(isinstance(each, str) and each for each in listed)):
            raise file_error(file, None, 'traces: is no list of paths; write traces = ["cycles/*.csv"]')
        named = document.get("map", map_name)
        if not isinstance(named, str):
            raise file_error(file, None, 'map: is no name; write map = "decanter", or the path of a column map')
        paths = [str(file.parent / each) for each in listed]
        map_name = str(file.parent / named) if named.endswith(".toml") and "map" in document else named
    traces, column_map, report = load_with_report(paths, map_name)
    files = {each: [*chain(*files_by_machine(each, column_map).values())] for each in paths}
    for found in chain(*files.values()):
        check_utf8(found)
    missing = [f"{each}: there is no CSV file there; put it back, or take it out" for each in paths if not files[each]]
    return StandardSet(traces, column_map.alphabet, column_map.temperature, (*missing, *report.errors))


def load_models(place: Path, standard: StandardSet) -> dict[str, Model | str]:
    """The models under a path by their subject's name, or the sentence why one cannot be run.

    A store's are its versions and, under the store's own name, the promoted one; a folder's those in it and in the
    folders below, artefact sets too. Raises ArtefactError where there is none.
    """

    def load(where: str) -> Model | str:
        try:
            return find_model(where, alphabet=standard.alphabet, temperature=standard.temperature).runnable()
        except ArtefactError as error:
            return str(error)

    if is_store(place):
        found = {f"{place}@{each}": load(f"{place}@{each}") for each in versions(place)}
        try:
            found[str(place)] = found[f"{place}@{current(place)}"]
        except ArtefactError as error:
            if not found:
                raise
            click.secho(f"note: {error}", fg="yellow", err=True)
        return found
    if not place.is_dir() or (place / MODEL_FILE).is_file():
        return {str(place): find_model(place, alphabet=standard.alphabet, temperature=standard.temperature).runnable()}
    found = {}
    for parent, folders, files in os.walk(place):
        here = Path(parent)
        if is_store(here):
            folders.clear()
            found |= load_models(here, standard)
        elif MODEL_FILE in files:
            folders.clear()
            found[str(here)] = load(str(here))
        else:
            folders[:] = sorted(name for name in folders if name[:1] != ".")
            bases = sorted(name.removesuffix(SUFFIXES["source"]) for name in files if name.endswith(SUFFIXES["source"]))
            found |= {str(here / base): load(str(here / base)) for base in bases}
    if not found:
        raise file_error(place, None, "has no model in it; give a store, a model, or a folder that has some")
    return found


def code_version() -> CodeVersion:
    """What forecasts now: the hash of all three floors' sources, the release, and the commit of a checkout."""
    content = sha256("".join(code_hash(floor) for floor in ("drivers", "sim", "gateway")).encode()).hexdigest()
    return CodeVersion(content, version(DISTRIBUTION), checkout_commit(Path(__file__).parents[3]))


def checkout_commit(root: Path) -> str:
    """The commit of the checkout whose top is `root`; "" where there is none, as for an installed program."""
    # Named, and not looked for: git would take the repository of somebody else that a folder above may be.
    command = ["git", f"--git-dir={root / '.git'}", f"--work-tree={root}", "describe", "--always", "--dirty"]
    try:
        asked = subprocess.run(  # noqa: S603
            [*command, "--abbrev=10"], capture_output=True, text=True, timeout=10.0, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return asked.stdout.strip() if asked.returncode == 0 else ""
