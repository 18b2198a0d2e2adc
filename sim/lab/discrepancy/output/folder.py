"""The folder of a diagnosis: checked before the work, written beside and moved in, `diagnosis.json` last."""

import json
import os
import shutil
import tempfile
from pathlib import Path

from sim.files import replace_durably, sync_directory
from sim.lab.discrepancy import Diagnosis
from sim.lab.discrepancy.output.diagnosis_json import FORMAT, MISSING_HEAT_FILE, document_text, missing_heat_text
from sim.lab.discrepancy.output.pictures import FILES, draw
from sim.lab.discrepancy.output.report import Occasion, report_html
from sim.lab.formats import write_model_directory
from sim.sha import Model

DOCUMENT, REPORT, MODEL = "diagnosis.json", "report.html", "model"


def check_folder(out: Path, model: Path) -> None:
    """Raises ValueError, in one sentence, where a diagnosis of the model at `model` cannot be written to `out`.

    A folder may hold other things, which are left alone, and an earlier diagnosis, which is replaced. Nothing is
    touched here.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out}: this is a file; give a folder for the diagnosis")
    inside = (out / MODEL).resolve()
    if model.resolve() == inside or inside in model.resolve().parents:
        raise ValueError(f"{out}: the new model would replace the one that is diagnosed; give --out another folder")
    if (out / MODEL).exists() and not _is_ours(out / DOCUMENT):
        raise ValueError(f"{out / MODEL}: is not from a diagnosis; give --out a folder that has no {MODEL!r} in it")
    nearest = next(path for path in (out.absolute(), *out.absolute().parents) if path.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise ValueError(f"{out}: no folder can be written there; give one that this user may write")


def _is_ours(file: Path) -> bool:
    """Whether a file is a diagnosis' document, of whatever version."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.get("format") == FORMAT


def write_diagnosis(diagnosis: Diagnosis, occasion: Occasion, model: Model | None, *, report: bool = True) -> Path:
    """Write all of a diagnosis to `occasion.folder`; returns the path of its document.

    `model` is the augmented one, which gets a directory of its own. Without `report` there are no page and no pictures.
    Everything is made in a hidden folder first and then moved in, so that a folder with a document is whole. Raises
    ArtefactError or OSError.
    """
    out = occasion.folder
    out.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=".diagnosis-", dir=out))
    try:
        if report:
            pictures = draw(diagnosis, f"Diagnosis of {occasion.name}: {diagnosis.verdict}", beside)
            replace_durably(beside / REPORT, report_html(diagnosis, occasion, pictures))
        if diagnosis.missing_heat is not None:
            replace_durably(beside / MISSING_HEAT_FILE, missing_heat_text(diagnosis.missing_heat))
        replace_durably(beside / DOCUMENT, document_text(diagnosis))
        if model is not None:
            write_model_directory(beside / MODEL, model)
        # What is new is whole by now. The document goes first and comes last: whoever reads while the rest is being
        # exchanged, or after a crash in between, finds a folder without a diagnosis and not one of two halves.
        (out / DOCUMENT).unlink(missing_ok=True)
        for name in (*FILES, MISSING_HEAT_FILE, REPORT):
            (out / name).unlink(missing_ok=True)
        if (out / MODEL).exists():
            shutil.rmtree(out / MODEL)
        for name in (MODEL, *FILES, MISSING_HEAT_FILE, REPORT, DOCUMENT):
            if (beside / name).exists():
                (beside / name).replace(out / name)
        sync_directory(out)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return out / DOCUMENT
