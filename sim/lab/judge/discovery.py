"""Stages 1 and 3: which files a model consists of, and whether its report agrees with the values it was made from."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

from drivers.named_files import regular
from sim.artefacts import MANIFEST, MODEL_FILE, STORE_FILE, version_directory
from sim.files import file_error
from sim.lab.formats import artefact_base
from sim.lab.formats.foreign import (
    PRINT_TOLERANCE,
    Artefacts,
    Histogram,
    Report,
    evidence,
    file_names,
    fit_values,
    read_histogram,
    read_report,
    reported_laws,
)
from sim.lab.suffixes import SUFFIXES
from sim.sha import Model

OPTIONAL_ARTEFACTS = ("histogram", "flows")
"""Artefacts that a set may lack. What cannot be done without them is said where it would be done."""


@dataclass(frozen=True, slots=True)
class FileFacts:
    """A file as it was found: its size in bytes and its SHA-256 (hex)."""

    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Discovery:
    """What lies under a MODEL argument: its `kind` in words, the directory, its files, and the names of absent ones."""

    kind: str
    directory: Path
    files: tuple[FileFacts, ...]
    absent: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """For the log."""
        lacking = f"; there is no {' and no '.join(self.absent)}" if self.absent else ""
        names = ", ".join(file.name for file in self.files) or "nothing"
        return f"{self.kind} in {self.directory}: {names}{lacking}"


def discover(where: str | Path) -> Discovery:
    """The files of the model under `where` (as for `find_model`), before any of them is parsed.

    Raises ArtefactError for a set of artefacts without source or report, and for a file whose name differs from the one
    wanted in case alone. A path under which nothing is gives no files: `find_model` says what is wrong with it.
    """
    path = Path(where)
    base = artefact_base(path)
    if base is None:
        store, at_sign, version = str(path).rpartition("@")
        kind, directory = "model directory" if path.is_dir() else "model file", path
        # A path of that very name goes first: an "@" is a sign like others to the file system.
        if at_sign and not path.exists() and (Path(store) / STORE_FILE).is_file():
            kind, directory = f"version {version} of a store", version_directory(Path(store), version)
        elif (path / STORE_FILE).is_file():
            directory = version_directory(path)
            kind = f"version {directory.name} (promoted) of a store"
        if directory.is_file():
            return Discovery(kind, directory.parent, _facts(directory.parent, [directory.name]))
        names = sorted(file.name for file in directory.iterdir() if file.is_file()) if directory.is_dir() else []
        return Discovery(kind, directory, _facts(directory, [name for name in names if not name.startswith(".")]))
    directory, name = base
    present = {file.name for file in directory.iterdir()}
    folded = {file.casefold(): file for file in sorted(present)}
    names, absent = [], []
    for kind, file in file_names(name).items():
        if file in present:
            names.append(file)
        elif file.casefold() in folded:
            other = folded[file.casefold()]
            raise file_error(
                directory, None, f"{file} is missing, but there is {other}: upper and lower case count, rename it"
            )
        elif kind in OPTIONAL_ARTEFACTS:
            absent.append(file)
        else:
            others = ", ".join(sorted(other for other in present if other.casefold().startswith(name.casefold())))
            raise file_error(directory, None, f"{file} is missing; of the set {name!r} there is {others or 'nothing'}")
    return Discovery(f"artefacts {name!r}", directory, _facts(directory, names), tuple(absent))


def _facts(directory: Path, names: Sequence[str]) -> tuple[FileFacts, ...]:
    facts = []
    for name in names:
        try:
            content = regular(directory / name).read_bytes()
        except OSError as error:
            raise file_error(
                directory / name, None, f"cannot be read ({error.strerror}); make it a readable file"
            ) from None
        facts.append(FileFacts(name, len(content), hashlib.sha256(content).hexdigest()))
    return tuple(facts)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawCheck:
    """One reported distribution beside the values it was made from: means in its own unit, NaN where one is absent."""

    name: str
    reported: float
    mean: float
    sigma: float
    values: int
    distinct: int


@dataclass(frozen=True, slots=True)
class CrossCheck:
    """The report's laws against what they come from; `origin` says what that is, `disagreements` what is wrong.

    An empty `origin`: there was nothing to hold them against.
    """

    laws: tuple[LawCheck, ...]
    runs: int
    distinct_runs: int
    origin: str
    disagreements: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """For the log."""
        if not self.origin:
            return f"{len(self.laws)} distributions reported, no histogram to check them against"
        appended = f" ({self.runs} runs appended, {self.distinct_runs} different)" if self.runs > 1 else ""
        agree = "all agree" if not self.disagreements else f"{len(self.disagreements)} disagree"
        first = f": {self.disagreements[0]}" if self.disagreements else ""
        return f"{len(self.laws)} distributions against {self.origin}{appended}, {agree}{first}"


def cross_check(artefacts: Artefacts) -> CrossCheck:
    """Every reported distribution against the histogram's values (six decimals, as the report prints them)."""
    reported = artefacts.report.distributions
    if artefacts.histogram is None:
        laws = tuple(
            LawCheck(name=law.name, reported=law.mean, mean=nan, sigma=nan, values=0, distinct=0) for law in reported
        )
        return CrossCheck(laws, 0, 0, "", ())
    used = evidence(artefacts.histogram, reported)
    checks = tuple(_law_check(law.name, law.mean, used.values) for law in reported)
    return CrossCheck(checks, used.runs, used.distinct, used.origin, used.disagreements)


def own_check(report: Report, histogram: Histogram | None, model: Model) -> CrossCheck:
    """The report beside a model.json of our own against the laws of that model.

    Its histogram has one estimate a stay, while the laws are fitted to all stays together: the means need not agree, so
    they stand beside and are not compared.
    """
    meant = {law.name: law.mean for law in reported_laws(model.sha)}
    reported = {law.name: law.mean for law in report.distributions}
    wrong = [f"{name} is in only one of the report and model.json" for name in sorted(set(meant) ^ set(reported))]
    wrong += [
        f"{name}: model.json says {meant[name]:.6g}, the report {mean:.6g}"
        for name, mean in reported.items()
        if name in meant and abs(mean - meant[name]) > PRINT_TOLERANCE * max(1.0, abs(meant[name]))
    ]
    runs = histogram.runs if histogram else ()
    laws = tuple(_law_check(name, mean, runs[-1] if runs else {}) for name, mean in reported.items())
    return CrossCheck(laws, len(runs), len(runs), MODEL_FILE, tuple(wrong))


def _law_check(name: str, reported: float, values: Mapping[str, tuple[float, ...]]) -> LawCheck:
    if not values.get(name):
        return LawCheck(name=name, reported=reported, mean=nan, sigma=nan, values=0, distinct=0)
    fitted = fit_values(values[name])
    return LawCheck(
        name=name,
        reported=reported,
        mean=fitted.mean,
        sigma=fitted.sigma,
        values=fitted.count,
        distinct=fitted.distinct,
    )


def read_own_report(discovery: Discovery) -> tuple[Report, Histogram | None] | None:
    """The report and the histogram that a model directory of our own holds beside its model.json, if it has one set.

    The other artefacts say what model.json says too, and take long to parse: a source has an edge for each location and
    symbol. Raises ArtefactError where they cannot be read.
    """
    names = {file.name for file in discovery.files}
    if not {MODEL_FILE, MANIFEST} <= names:
        return None
    bases = [name.removesuffix(SUFFIXES["source"]) for name in names if name.endswith(SUFFIXES["source"])]
    if len(bases) != 1:
        return None
    files = file_names(bases[0])
    histogram = read_histogram(discovery.directory / files["histogram"]) if files["histogram"] in names else None
    return read_report(discovery.directory / files["report"]), histogram
