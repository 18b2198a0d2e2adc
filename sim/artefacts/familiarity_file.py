"""`familiarity.json` of a model: the law of its training's cycles, and the error that goes with strangeness."""

import json
from dataclasses import dataclass
from pathlib import Path

from sim.familiarity import ErrorCurve, FamiliarityReference, parse_curve, parse_reference
from sim.files import at, read_text
from sim.strict_json import json_text

FAMILIARITY_FILE = "familiarity.json"
FORMAT = "decanter-familiarity"


@dataclass(frozen=True, slots=True)
class Familiarity:
    """The `reference` of a model's training, and the `curve` of errors (None: no cycle told it)."""

    reference: FamiliarityReference
    curve: ErrorCurve | None

    def text(self) -> str:
        """The file's content."""
        curve = self.curve and self.curve.as_plain()
        document = {"format": FORMAT, "version": 1, "reference": self.reference.as_plain(), "curve": curve}
        return json_text(document) + "\n"


def read_familiarity(folder: Path) -> Familiarity | None:
    """That of the model in `folder`; None where it has none. Raises ArtefactError for one that cannot be used."""
    file = folder / FAMILIARITY_FILE
    if not file.is_file():
        return None
    text = read_text(file)
    try:
        document = json.loads(text)
        if document["format"] != FORMAT or document["version"] != 1:
            raise ValueError("it is of another format")
        curve = document["curve"]
        return Familiarity(parse_reference(document["reference"]), None if curve is None else parse_curve(curve))
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise at(
            file, None, f"cannot be used ({str(error)[:80]}); learn the model again, or take the file away"
        ) from None
