"""The folder of a campaign: what may be written over, records stage by stage, results as JSON and CSV, read back."""

import fcntl
import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from math import isfinite, nan
from pathlib import Path
from typing import Any

from drivers.csv_rows import write_rows
from drivers.named_files import regular
from sim.engine import Score
from sim.files import replace_durably
from sim.lab.judge.fitness import Facts
from sim.lab.judge.results import Interval, TraceResult
from sim.lab.judge.semantics import CARRIED, RESAMPLED
from sim.lab.judge.stages import Stage
from sim.sealed_files import seal_files, verify_seal
from sim.strict_json import json_text

CAMPAIGN_FILE = "campaign.json"
RESULTS = "results"
SKILL_FILE = "skill.json"
GENERATION_FILE = "04_model_generation.json"
FORMAT = "decanter-validation"
VERSION = 1
FORMER_SEMANTICS = {"own": CARRIED, "thesis": RESAMPLED}
RUNNING, COMPLETE = "running", "complete"
SEAL_FILE = "campaign.sha256"
OWN_FILES = ("index.html", f"{RESULTS}.json", f"{RESULTS}.csv", SKILL_FILE, "campaign.log", SEAL_FILE)
MODEL_FILES = ("0[1-9]_*.json", "report.html", "pictures/*.png", "pictures/*.pdf", "pictures/.*.part")
"""What a campaign writes, as patterns: beside campaign.json, and in the folder of each model."""
LEARNED_FOLDER = "learned"
"""Where the models are that a campaign has learned itself; a directory each."""


@dataclass(slots=True)
class Folder:
    """A folder that this campaign owns, and what its campaign.json says. `places` names each model's own folder."""

    path: Path
    places: Mapping[str, str]
    facts: dict[str, Any]

    def assign(self, labels: Sequence[str]) -> None:
        """Give each model its folder, and say so in campaign.json."""
        self.places = places(labels, {LEARNED_FOLDER})
        self.state(RUNNING)

    def write(self, name: str, text: str) -> Path:
        """Put a file in place at one moment. Raises ValueError where it cannot be written."""
        file = self.path / name
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            replace_durably(file, text)
        except OSError as error:
            raise write_error(file, error) from None
        return file

    def stage(self, stage: Stage) -> None:
        """The record of a stage of one model, in the model's own folder."""
        title = stage.name.replace(" ", "_")
        record = {"stage": stage.number, "name": stage.name, "found": stage.found, "seconds": stage.seconds}
        name = f"{self.places[stage.model]}/{stage.number:02d}_{title}.json"
        self.write(name, json_text(record | dict(stage.details), indent=2) + "\n")

    def state(self, state: str, **facts: Any) -> None:
        """Say in campaign.json how far the campaign is; the last thing that it does."""
        self.facts |= facts
        document = {"format": FORMAT, "version": VERSION, "state": state, "folders": dict(self.places), **self.facts}
        self.write(CAMPAIGN_FILE, json_text(document, indent=2) + "\n")

    def seal(self) -> str:
        """The seal of the finished campaign, over all files that are there. Raises ValueError where it has no room."""
        files = (file for file in self.path.rglob("*") if file.is_file() and file.name != SEAL_FILE)
        names = sorted(str(file.relative_to(self.path)) for file in files if not file.name.startswith("."))
        try:
            return seal_files(self.path, SEAL_FILE, names)
        except OSError as error:
            raise write_error(self.path / SEAL_FILE, error) from None


def check_folder(path: Path, *, overwrite: bool) -> list[Path]:
    """The files of an earlier campaign in `path`, which a new one removes; none where the folder is new or empty.

    Raises ValueError where the folder holds something else, where it holds results and `overwrite` is not asked for,
    and where it is none. Nothing is touched.
    """
    if not path.exists():
        return []
    if not path.is_dir():
        raise ValueError(f"{path}: this is a file; give a folder for the results")
    present = sorted(entry.name for entry in path.iterdir() if not entry.name.startswith("."))
    if not present:
        return []
    if CAMPAIGN_FILE not in present:
        raise ValueError(
            f"{path}: the folder has other things in it ({', '.join(present[:3])}); give a new one or an empty one"
        )
    file = path / CAMPAIGN_FILE
    try:
        earlier = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, OSError):
        earlier = None
    if not isinstance(earlier, dict) or earlier.get("format") != FORMAT:
        raise ValueError(f"{file}: this is no campaign of ours; give a new folder or an empty one")
    if not overwrite:
        state = "an unfinished campaign" if earlier.get("state") != COMPLETE else "a complete campaign"
        raise ValueError(
            f"{path}: holds the results of {state} of {earlier.get('created', 'unknown time')}; "
            "give another folder, or --overwrite to replace them"
        )
    # What is removed is what a campaign writes, in the folders that its own record names: a name that is no single part
    # of a path was written by somebody else, and leads out of the folder perhaps.
    folders = earlier.get("folders")
    names = [str(name) for name in folders.values()] if isinstance(folders, dict) else []
    wanted = (*OWN_FILES, *(f"{name}/{pattern}" for name in names if name == slug(name) for pattern in MODEL_FILES))
    return sorted(present for pattern in wanted for present in path.glob(pattern) if present.is_file())


@contextmanager
def hold_folder(path: Path) -> Iterator[None]:
    """Makes the folder and keeps other commands out of it until the block ends, however it ends.

    The lock is the system's, on the folder itself; a file system without locks gives none. Raises ValueError where
    another process holds the folder, and where there can be none.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise _unwritable(path, error) from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            reason = "another command is writing there; give another folder, or wait for it"
            raise ValueError(f"{path}: {reason}") from None
        except OSError:
            pass  # no locks on this file system: better to work without one than not at all
        yield
    finally:
        os.close(handle)


def _unwritable(path: Path, error: OSError) -> ValueError:
    reason = (error.strerror or str(error)).lower()
    return ValueError(f"{path}: cannot be written ({reason}); give a folder that this user may write")


def write_error(file: Path, error: OSError) -> ValueError:
    """What to say when a campaign can no longer write."""
    reason = (error.strerror or str(error)).lower()
    return ValueError(f"{file}: cannot be written ({reason}); make that possible, and begin again with --overwrite")


def claim_folder(path: Path, stale: Sequence[Path], labels: Sequence[str], facts: Mapping[str, Any]) -> Folder:
    """Mark the folder as being written, and remove the `stale` files of the campaign before. Raises ValueError."""
    folder = Folder(path, {}, dict(facts))
    folder.assign(labels)
    try:
        for file in stale:
            file.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from None
    return folder


def places(names: Sequence[str], reserved: Iterable[str] = ()) -> dict[str, str]:
    """A folder's or file's name for each of `names`, no two alike whatever the file system thinks of case."""
    by_name: dict[str, str] = {}
    taken = set(reserved)
    for name in names:
        place = first = slug(name)
        number = 2
        while place.casefold() in taken:
            place, number = f"{first}-{number}", number + 1
        taken.add(place.casefold())
        by_name[name] = place
    return by_name


def slug(name: str) -> str:
    """The name as one harmless part of a path."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._-")[:80] or "unnamed"


def results_json(results: Iterable[TraceResult]) -> str:
    """All results, field by field as in `TraceResult`; undefined numbers are null."""
    content = {"format": FORMAT, "version": VERSION, "results": [asdict(result) for result in results]}
    return json_text(content, indent=2) + "\n"


def results_csv(results: Iterable[TraceResult]) -> str:
    """One row a result; a score or an interval takes several columns (at_events_mae, mae_low). Undefined is empty."""
    rows: list[dict[str, Any]] = []
    for result in results:
        row: dict[str, Any] = {}
        for name, value in asdict(result).items():
            if isinstance(value, Mapping):
                row |= {name if key == "value" else f"{name}_{key}": _cell(inner) for key, inner in value.items()}
            else:
                row[name] = _cell(value)
        rows.append(row)
    text = io.StringIO()
    names = list(rows[0]) if rows else [field.name for field in fields(TraceResult)]
    write_rows(text, (names, *([row.get(name) for name in names] for row in rows)))
    return text.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, tuple | list):
        return "; ".join(str(inner) for inner in value)
    return "" if isinstance(value, float) and not isfinite(value) else value


def read_results(path: Path) -> list[TraceResult]:
    """The results in a campaign's folder or in its results.json.

    Raises ValueError with the file and the reason; also where what is read is not as it was sealed.
    """
    file = path / f"{RESULTS}.json" if path.is_dir() else path
    # Whoever names the file instead of its folder is told the same; a copy elsewhere has no seal.
    if file.name == f"{RESULTS}.json" and (file.parent / SEAL_FILE).is_file():
        _check_seal(file.parent)
    try:
        document = json.loads(regular(file).read_text(encoding="utf-8"))
        # A former release called the semantics by whose they are.
        for row in document["results"]:
            row["semantics"] = FORMER_SEMANTICS.get(row["semantics"], row["semantics"])
            # It kept no level of the readings: the last one's is what its final error in per cent tells.
            if "level" not in row and row.get("final_percent"):
                row["level"] = 100.0 * abs(row["final_error"]) / row["final_percent"]
        # Only the fields that this program knows: what a newer one adds is passed over, what an older one lacked keeps
        # its default.
        kinds = {field.name: field.type for field in fields(TraceResult)}
        return [
            TraceResult(**{name: _restore_value(row[name], kind) for name, kind in kinds.items() if name in row})
            for row in document["results"]
        ]
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(f"{file}: cannot be read ({reason}); give the folder of a finished campaign") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{file}: these are no results of a campaign ({error!r})") from None


def _check_seal(folder: Path) -> None:
    """Raises ValueError where results or records were changed after the campaign; a picture may be missing."""
    read = (f"{RESULTS}.json", CAMPAIGN_FILE, SEAL_FILE)
    changed = [row for row in verify_seal(folder, SEAL_FILE)[1] if not row.ok]
    for row in changed:
        if row.file in read or row.file.endswith(GENERATION_FILE):
            raise ValueError(f"{folder / row.file}: {row.problem}, after the campaign was sealed; validate anew")


def _restore_value(value: Any, kind: Any) -> Any:
    """A field's value from JSON, where a list stands for a tuple and null for NaN."""
    if kind in (Score, Interval):
        return kind(**{name: nan if inner is None else inner for name, inner in value.items()})
    if isinstance(value, list):
        return tuple(nan if inner is None else inner for inner in value)
    return nan if value is None else value


def recorded_facts(path: Path) -> dict[str, dict[str, Facts]]:
    """What a campaign's records say of its models, by label and semantics; a missing or odd record says nothing.

    `path` is the folder or its results.json.
    """
    folder, facts = path if path.is_dir() else path.parent, dict[str, dict[str, Facts]]()
    for label, place in _record(folder / CAMPAIGN_FILE).get("folders", {}).items():
        facts[label] = {}
        for semantics, row in _record(folder / place / GENERATION_FILE).get("variants", {}).items():
            traced = bool(row.get("data_hash") or row.get("training_traces"))
            facts[label][semantics] = Facts(synthetic=bool(row.get("synthetic")) if traced else None)
    return facts


def _record(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(regular(file).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}
