"""The artefacts of one automaton in a directory, found by their base name: source, report, histogram, flow file."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from sim.files import ArtefactError, file_error, replace_durably, write_error
from sim.lab.formats.foreign.dot import Source, read_source, source_text
from sim.lab.formats.foreign.flow_file import FLOW_FILE, FlowFile, flow_file_text, read_flow_file
from sim.lab.formats.foreign.histogram import Histogram, histogram_text, read_histogram
from sim.lab.formats.foreign.report import Report, read_report, report_text
from sim.lab.suffixes import SUFFIXES

KINDS = (*SUFFIXES, "flows")


@dataclass(frozen=True, slots=True)
class Artefacts:
    """What was read under one base name; histogram and flow file are None where they were allowed to be missing."""

    name: str
    source: Source
    report: Report
    histogram: Histogram | None = None
    flows: FlowFile | None = None


def file_names(name: str) -> dict[str, str]:
    """The file of each kind for a base name. Raises ArtefactError when the name cannot be part of a file's name."""
    if not re.fullmatch(r"\w[\w .\-]*", name) or name.endswith((" ", ".")):
        raise ArtefactError(
            f"{name!r} cannot be a model's base name, since files are named by it; use letters, digits, _ and -"
        )
    names = {kind: name + suffix for kind, suffix in SUFFIXES.items()} | {"flows": FLOW_FILE}
    if FLOW_FILE in (name + suffix for suffix in SUFFIXES.values()):
        raise ArtefactError(f"{name!r} cannot be a model's base name, {FLOW_FILE} is the flow file; choose another")
    return names


def read_artefacts(directory: Path, name: str, optional: Collection[str] = ()) -> Artefacts:
    """The set `name` of a directory. Names are case-sensitive, whatever the file system thinks of it.

    `optional` names the kinds (of `KINDS`) that may be missing. All names are checked before any file is opened. Raises
    ArtefactError, saying what is missing and what is there instead, or with file and line where a file is unusable.
    """
    unknown = sorted(set(optional) - set(KINDS))
    if unknown:
        raise ValueError(f"unknown kind of artefact {unknown[0]!r}: known are {', '.join(KINDS)}")
    try:
        present = sorted(path.name for path in directory.iterdir())
    except OSError as error:
        raise file_error(directory, None, f"is no directory that can be read ({error.strerror}); give one") from None
    names = file_names(name)
    missing = [file for kind, file in names.items() if file not in present and kind not in optional]
    if missing:
        # Which files are missing, which differ in case only, and which base names are there.
        folded, parts = {file.casefold(): file for file in present}, []
        for file in missing:
            other = folded.get(file.casefold())
            hint = f" (there is {other}: upper and lower case count, rename it or ask for it as it is written)"
            parts.append(f"{file} is missing{hint if other else ''}")
        suffix = SUFFIXES["source"]
        bases = [file.removesuffix(suffix) for file in present if file.endswith(suffix)]
        sets = f"the sets here are {', '.join(bases)}" if bases else "there is no file *_source.txt here"
        files = ", ".join(file for file in present if file.casefold().startswith(name.casefold()) or file == FLOW_FILE)
        raise file_error(directory, None, f"{'; '.join(parts)}; {sets}{f', with the files {files}' if files else ''}")
    histogram, flows = names["histogram"], names["flows"]
    return Artefacts(
        name,
        read_source(directory / names["source"]),
        read_report(directory / names["report"]),
        read_histogram(directory / histogram) if histogram in present else None,
        read_flow_file(directory / flows) if flows in present else None,
    )


def texts(artefacts: Artefacts) -> dict[str, str]:
    """The content of each file by its name."""
    names = file_names(artefacts.name)
    written = {names["source"]: source_text(artefacts.source), names["report"]: report_text(artefacts.report)}
    if artefacts.histogram is not None:
        written[names["histogram"]] = histogram_text(artefacts.histogram)
    if artefacts.flows is not None:
        written[names["flows"]] = flow_file_text(artefacts.flows)
    return written


def write_artefacts(directory: Path, artefacts: Artefacts) -> None:
    """Writes the files of the set into a directory, which is made. Each file is replaced at one moment."""
    content = texts(artefacts)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, text in content.items():
            replace_durably(directory / name, text)
    except OSError as error:
        raise write_error(directory, error) from None
