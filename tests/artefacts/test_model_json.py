"""The JSON form that holds everything of a model."""

import json
from dataclasses import replace
from math import inf, nan
from typing import Any

import pytest
from hypothesis import given, settings

from sim.artefacts.model_json import model_document, model_hash, model_text, parse_model
from sim.files import ArtefactError
from sim.sha.automaton import Distribution, Flow, Location
from sim.sha.model import Model
from tests.artefacts.models import decanter_model, models


@settings(max_examples=20, deadline=None)
@given(models())
def test_written_and_read_again_a_model_is_the_same(model: Model) -> None:
    text = model_text(model)
    read = parse_model(text)
    assert read == model
    assert model_text(read) == text
    assert model_hash(read) == model_hash(model)


def test_a_model_with_a_transient_says_its_units_and_is_read_again() -> None:
    """The units of all other models stay as they are, or their hashes would change."""
    plain = decanter_model()
    flow = Flow("transient", {"tau": 8.0, "m": -1.5, "noise": 0.1})
    peak = Location("peak", flow, Distribution("normal", {"mu": 42.0, "sigma": 1.0}), "resample")
    model = replace(plain, sha=replace(plain.sha, locations=(*plain.sha.locations, peak)))
    document = json.loads(model_text(model))
    assert document["units"]["tau"] == "s" and "transient" in document["units"]["m"]
    assert "tau" not in json.loads(model_text(plain))["units"]
    assert parse_model(model_text(model)) == model
    document["locations"][-1]["flow"]["params"]["tau"] = -8.0
    with pytest.raises(ArtefactError, match=r"tau must be positive and finite, got -8"):
        parse_model(json.dumps(document))
    document["units"]["tau"] = "min"
    with pytest.raises(ArtefactError, match="the units must be"):
        parse_model(json.dumps(document))


def test_settings_keep_their_types() -> None:
    settings = parse_model(model_text(decanter_model())).provenance.settings
    assert {name: type(value) for name, value in settings.items()} == {"seed": int, "share": float, "x": str, "b": bool}


def test_the_hash_depends_on_content_and_not_on_the_order_of_mappings() -> None:
    model = decanter_model()
    turned = replace(model, calibration=dict(reversed(model.calibration.items())))
    assert model_hash(turned) == model_hash(model)
    assert model_hash(replace(model, sensor_sigma=0.1000001)) != model_hash(model)
    assert model_hash(replace(model, sha=replace(model.sha, edges=model.sha.edges[::-1]))) != model_hash(model)


def test_the_hash_is_the_same_in_every_process_and_release() -> None:
    assert model_hash(decanter_model()) == "01192847a928d53b096c643f1647145aa55d38267a9df9715e33806e8dbeaba0"


def test_an_unlimited_rate_is_written_as_a_text_and_nan_is_refused() -> None:
    model = decanter_model()
    unlimited = replace(model, sha=replace(model.sha, max_rate=inf))
    assert json.loads(model_text(unlimited))["limits"]["max_rate"] == "inf"
    assert parse_model(model_text(unlimited)) == unlimited
    with pytest.raises(ArtefactError, match="NaN cannot be written"):
        model_text(replace(model, sensor_sigma=nan))


def test_a_model_that_could_not_be_run_is_refused_when_it_is_written() -> None:
    model = decanter_model()
    strange = replace(model.sha.locations[0], flow=Flow("exponential", {"noise": 0.0}))
    with pytest.raises(ArtefactError, match="location 'off'"):
        model_text(replace(model, sha=replace(model.sha, locations=(strange, *model.sha.locations[1:]))))
    with pytest.raises(ArtefactError, match=r"semi_markov\.gone names the location 'gone'"):
        model_text(replace(model, semi_markov={"gone": model.semi_markov["off"]}))


def changed(path: str, value: Any) -> str:
    """The decanter model's JSON with one key path set to `value`, or removed for `...`."""
    document = model_document(decanter_model())
    place: Any = document
    *way, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    for key in way:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return json.dumps(document)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("format", "something", "format: this is 'something'; a model has 'decanter-sha-model'"),
        (
            "version",
            4,
            "version 4 is unknown; this program reads the versions 1, 2 (with effects) and 3 (with own effects)",
        ),
        ("version", "1", "version: a whole number is needed"),
        ("sensor_sigma", ..., "the document: the key 'sensor_sigma' is missing; it has"),
        ("sensor_sigma", "much", "sensor_sigma: a number is needed"),
        ("sensor_sigma", True, "sensor_sigma: a number is needed"),
        ("sensor_sigma", 10**400, "sensor_sigma: the number is too large"),
        ("extra", 1, "the key 'extra' is unknown; known are format"),
        ("units/temperature", "K", "units: the units must be"),
        (
            "locations/1/flow/params/k",
            None,
            'locations[1].flow.params.k: a number is needed (or "inf"), but this is null',
        ),
        ("locations/1/flow/kind", "warp", "location 'on': unknown flow 'warp'"),
        ("locations/0/flow/params/k", -1.0, "location 'off'"),
        ("locations/1/flow/inputs/0/gain", ..., "locations[1].flow.inputs[0]: the key 'gain' is missing"),
        ("locations/0/entry", "jump", "locations[0].entry: the entry mode 'jump' is unknown"),
        ("locations", {}, "locations: a list [...] is needed"),
        ("edges/0/target", "gone", "names the location 'gone', which is not defined"),
        ("edges/0", "x", 'edges[0]: an object {...} is needed, but this is "x"'),
        ("initial_location", "gone", "the initial location 'gone' is not among"),
        ("alphabet/channels/0/kind", "dial", "alphabet.channels[0].kind: the channel 'dial' is unknown"),
        ("alphabet/channels/1/symbols", ["A"], "alphabet.channels[1]: 3 thresholds need 4 symbols, here are 1"),
        ("alphabet/uppaal/0", ["W_ON"], "alphabet.uppaal[0]: a pair"),
        ("semi_markov/off/law/params/shape", -1, "shape=-1"),
        ("calibration/0/horizon", 300.0, "calibration: a horizon is given twice"),
        (
            "anomalies",
            {"seconds": 60, "units": 0, "level": 12, "peaks": []},
            "anomalies: a record of anomaly scores needs at least one unit",
        ),
        ("anomalies", {"seconds": 60, "units": 1, "level": -1, "peaks": []}, "finite numbers of at least 0"),
        ("anomalies", {"seconds": 60, "units": 1, "peaks": []}, "anomalies: the key 'level' is missing"),
        ("provenance/settings/seed", [], "provenance.settings.seed: a text, a number, true or false is needed"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_key_path(path: str, value: Any, reason: str) -> None:
    with pytest.raises(ArtefactError, match=r"^m\.json: ") as error:
        parse_model(changed(path, value), "m.json")
    assert reason in str(error.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"format": ', "m.json:1: is no JSON"),
        ('{"a": 1,\n "a": 2}', "the key 'a' is given twice"),
        ('{"a": NaN}', "NaN is no JSON number"),
        ("[]", "the document: an object {...} is needed"),
        ("[" * 100_000, "is no JSON that can be used"),
        ("", "m.json:1: is no JSON"),
    ],
)
def test_a_text_that_is_no_usable_json_is_one_sentence(text: str, reason: str) -> None:
    with pytest.raises(ArtefactError) as error:
        parse_model(text, "m.json")
    assert reason in str(error.value)


def test_a_model_of_another_variable_says_its_unit_and_one_without_is_in_degrees() -> None:
    power = replace(decanter_model(), unit="kW")
    document = json.loads(model_text(power))
    assert document["units"]["temperature"] == "kW" and document["units"]["noise"] == "kW/sqrt(s)"
    assert parse_model(model_text(power)) == power
    older = json.loads(model_text(decanter_model()))
    del older["units"]["temperature"]
    assert parse_model(json.dumps(older)).unit == "degC"
    document["units"]["noise"] = "degC/sqrt(s)"
    with pytest.raises(ArtefactError, match="the units must be"):
        parse_model(json.dumps(document))
