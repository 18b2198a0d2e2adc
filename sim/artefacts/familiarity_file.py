"""`familiarity.json` of a model: the law of its training's cycles, and the error that goes with strangeness."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.familiarity import ErrorCurve, FamiliarityReference, parse_curve, parse_reference
from sim.files import file_error, read_text
from sim.strict_json import json_text

FAMILIARITY_FILE = "familiarity.json"
FORMAT, VERSION = "decanter-familiarity", 2


@dataclass(frozen=True, slots=True)
class Familiarity:
    """The `reference` of a model's training, and the `curve` of errors (None: no cycle told it).

    `held_out`: the curve's cycles were none of the training's; else its errors are a little too small.
    """

    reference: FamiliarityReference
    curve: ErrorCurve | None
    held_out: bool = True

    def text(self) -> str:
        """The file's content."""
        curve = self.curve and self.curve.as_plain()
        document: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "reference": self.reference.as_plain(),
            "curve": curve,
        }
        document["held_out"] = self.held_out
        return json_text(document) + "\n"


def read_familiarity(folder: Path) -> Familiarity | None:
    """That of the model in `folder`; None where it has none. Raises ArtefactError for one that cannot be used."""
    file = folder / FAMILIARITY_FILE
    if not file.is_file():
        return None
    text = read_text(file)
    try:
        document = json.loads(text)
        if document["format"] != FORMAT or document["version"] != VERSION:
            raise ValueError("it is of another version of this program")
        curve = document["curve"]
        curve = None if curve is None else parse_curve(curve)
        return Familiarity(parse_reference(document["reference"]), curve, bool(document["held_out"]))
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise file_error(
            file, None, f"cannot be used ({str(error)[:80]}); learn the model again, or take the file away"
        ) from None
