"""One readable JSON form that holds everything of a model, and the model's content hash.

Units are named in the file itself. Numbers are finite or the texts "inf" and "-inf"; NaN is refused. Lists keep the
model's order (locations, edges, channels: the order means something), objects are sorted by key. What the writer writes
the reader reads back as an equal model; what the reader would refuse the writer refuses already.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.artefacts.files import ArtefactError, read_text
from sim.artefacts.json_reading import Node, parse_json, written_number
from sim.artefacts.model_parts import (
    alphabet_of,
    alphabet_part,
    correction_of,
    correction_part,
    edge_of,
    edge_part,
    effects_of,
    effects_part,
    law_of,
    law_part,
    location_of,
    location_part,
    numbers_part,
    provenance_of,
    provenance_part,
    stay_of,
    stay_part,
)
from sim.effects.check import check_sha
from sim.effects.correction import in_sensor_scale
from sim.sha.automaton import SHA
from sim.sha.distributions import check_distribution
from sim.sha.events import check_alphabet
from sim.sha.model import Model

FORMAT = "decanter-sha-model"
VERSION = 1
EFFECTS_VERSION = 2
"""A model with effects: a program that does not know them must refuse it, never run it without."""
UNITS: Mapping[str, str] = {
    "temperature": "degC",
    "time": "s",
    "k": "1/s",
    "noise": "degC/sqrt(s)",
    "max_rate": "degC/s",
    "gain": "degC per unit of the signal",
    "m": "degC (exponential, driven, logarithmic), degC/s (linear)",
}
KEYS = (
    "format",
    "version",
    "units",
    "name",
    "temperature",
    "sensor_sigma",
    "limits",
    "initial_location",
    "locations",
    "edges",
    "effects",
    "alphabet",
    "initial_temperature",
    "semi_markov",
    "calibration",
    "correction",
    "provenance",
)


def model_text(model: Model) -> str:
    """The model's JSON, ending in a newline. Raises ArtefactError for a model that could not be run when read back."""
    return json.dumps(model_document(model), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def model_hash(model: Model) -> str:
    """SHA-256 (64 hexadecimal digits) over the canonical JSON: keys sorted, no blanks, UTF-8."""
    canonical = json.dumps(model_document(model), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def model_document(model: Model) -> dict[str, Any]:
    """The model as JSON's own types. Raises ArtefactError."""
    _check(model)
    sha = model.sha
    return {
        "format": FORMAT,
        "version": EFFECTS_VERSION if sha.effects else VERSION,
        "units": dict(UNITS),
        "name": sha.name,
        "temperature": model.temperature,
        "sensor_sigma": written_number(model.sensor_sigma),
        "limits": numbers_part({"low": sha.low, "high": sha.high, "max_rate": sha.max_rate}),
        "initial_location": sha.initial,
        "locations": [location_part(location) for location in sha.locations],
        "edges": [edge_part(edge) for edge in sha.edges],
        **effects_part(sha.effects),
        "alphabet": alphabet_part(model.alphabet),
        "initial_temperature": law_part(model.initial) if model.initial else None,
        "semi_markov": {name: stay_part(stay) for name, stay in sorted(model.semi_markov.items())},
        "calibration": [
            {"horizon": written_number(horizon), "factor": written_number(factor)}
            for horizon, factor in sorted(model.calibration.items())
        ],
        **correction_part(model.correction),
        "provenance": provenance_part(model.provenance),
    }


def parse_model(text: str, file: str | Path = "model.json") -> Model:
    """The model in a JSON text. Raises ArtefactError with file and key path."""
    root = parse_json(text, file)
    _check_header(root)
    sha = _sha(root)
    model = Model(
        sha=sha,
        alphabet=alphabet_of(root.get("alphabet")),
        temperature=root.get("temperature").text(),
        sensor_sigma=root.get("sensor_sigma").number(),
        initial=root.get("initial_temperature").optional(law_of),
        semi_markov=root.get("semi_markov").table(stay_of),
        calibration=_calibration(root.get("calibration")),
        provenance=provenance_of(root.get("provenance")),
        correction=correction_of(root),
    )
    try:
        _check(model)
    except ArtefactError as error:
        raise root.error(str(error)) from None
    return model


def read_model_file(path: Path) -> Model:
    """The model in a JSON file. Raises ArtefactError with file and key path."""
    return parse_model(read_text(path), path)


def _check_header(root: Node) -> None:
    """Format and version first, so that another version is not blamed for its keys."""
    form, version = root.get("format").text(), root.get("version").integer()
    if form != FORMAT:
        raise root.get("format").error(f"this is {form!r}; a model has {FORMAT!r}")
    if version not in (VERSION, EFFECTS_VERSION):
        known = f"{VERSION} and {EFFECTS_VERSION} (with effects)"
        raise root.get("version").error(f"version {version} is unknown; this program reads the versions {known}")
    root.only(KEYS)
    if version == VERSION and "effects" in root.value:
        raise root.get("effects").error(f"a model with effects has version {EFFECTS_VERSION}, here it is {version}")
    units = root.get("units").table(Node.text)
    if units != UNITS:
        raise root.get("units").error(f"the units must be {dict(UNITS)}; convert the model's numbers and say so here")


def _sha(root: Node) -> SHA:
    limits = root.get("limits").only(("low", "high", "max_rate"))
    name, initial = root.get("name").text(), root.get("initial_location").text()
    locations = tuple(location_of(node) for node in root.get("locations").each())
    edges = tuple(edge_of(node) for node in root.get("edges").each())
    bounds = {key: limits.get(key).number() for key in ("max_rate", "low", "high")}
    effects = effects_of(root)
    try:
        return SHA(name, locations, edges, initial, effects=effects, **bounds)
    except ValueError as error:
        raise root.error(str(error)) from None


def _calibration(node: Node) -> dict[float, float]:
    pairs = [entry.only(("horizon", "factor")) for entry in node.each()]
    factors = {entry.get("horizon").number(): entry.get("factor").number() for entry in pairs}
    if len(factors) < len(pairs):
        raise node.error("a horizon is given twice; keep one factor for each")
    return factors


def _check(model: Model) -> None:
    """Raises ArtefactError unless every flow, law and name of the model can be used."""
    known = model.sha.by_name
    try:
        check_sha(model.sha)
        check_alphabet(model.alphabet)
        in_sensor_scale(model)
        if model.initial is not None:
            check_distribution(model.initial)
        for name, stay in model.semi_markov.items():
            check_distribution(stay.law)
            strange = [place for place in (name, *stay.to) if place not in known]
            if strange:
                raise ArtefactError(f"semi_markov.{name} names the location {strange[0]!r}, which is not defined")
    except ValueError as error:
        raise ArtefactError(str(error)) from None
