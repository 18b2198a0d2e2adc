"""Effects in a model's JSON, in the artefacts and on the command line: nothing is lost silently."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from sim.artefacts.model_json import model_document, model_hash, model_text, parse_model
from sim.files import ArtefactError
from sim.lab.formats.find import find_model
from sim.lab.formats.foreign.bundle import texts
from sim.lab.formats.foreign.convert import to_sha
from sim.lab.formats.foreign.from_model import to_artefacts
from sim.lab.formats.foreign.report import parse_report
from sim.lab.formats.write_model import write_model_directory
from sim.sha.automaton import Effect
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from tests.sha.effect_reference import EFFECTS, LATE, plant

ALL = tuple({effect.kind: effect for effects in EFFECTS.values() for effect in effects}.values())


def model(*effects: Effect) -> Model:
    return Model(plant("driven", effects), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1)


@pytest.mark.parametrize("effect", [*ALL, *LATE["late heat"]], ids=lambda effect: effect.kind)
def test_a_model_with_an_effect_is_read_back_as_it_was(effect: Effect) -> None:
    again = parse_model(model_text(model(effect)))
    assert again == model(effect)
    assert model_hash(again) == model_hash(model(effect)) != model_hash(model())


def test_a_model_without_effects_keeps_its_version_and_says_nothing_of_them() -> None:
    assert model_document(model())["version"] == 1
    assert "effects" not in model_document(model())


def test_a_model_with_effects_has_a_version_that_older_programs_refuse() -> None:
    assert model_document(model(*ALL))["version"] == 2


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"kind": "magic"}, r"effects\[0\]: unknown effect 'magic'"),
        ({"params": {"loss": 0.1}}, r"effects\[0\]: effect 'pump-cooling' takes the parameters .*sink is missing"),
        ({"params": {"loss": "much", "sink": 1}}, r"effects\[0\].params.loss: a number is needed"),
        ({"signals": {"pump": 3}}, r"effects\[0\].signals.pump: a text"),
        ({"locations": ["up"]}, "the effect 'pump-cooling' names the location 'up', which is not defined"),
        ({"more": 1}, r"effects\[0\]: the key 'more' is unknown"),
    ],
)
def test_a_wrong_effect_is_told_by_where_it_stands(change: dict[str, object], sentence: str) -> None:
    document = model_document(model(*EFFECTS["pump-cooling"]))
    document["effects"][0] |= change
    with pytest.raises(ArtefactError, match=sentence):
        parse_model(json.dumps(document))


def test_effects_in_a_document_of_the_first_version_are_refused() -> None:
    document = model_document(model(*EFFECTS["pump-cooling"])) | {"version": 1}
    with pytest.raises(ArtefactError, match="a model with effects has version 2, here it is 1"):
        parse_model(json.dumps(document))


def test_the_report_names_the_effects_and_reading_the_artefacts_says_that_they_are_left_out() -> None:
    artefacts = to_artefacts(model(*EFFECTS["pump-cooling"]))
    report = next(text for name, text in texts(artefacts).items() if name == "augmented.txt")
    assert "EFFECT 1:\tpump-cooling: loss 0.005; sink 25; pump P" in report
    found = to_sha(replace(artefacts, report=parse_report(report)))
    assert found.sha.effects == ()
    assert any("that is left out here: pump-cooling" in note for note in found.notes)


def test_a_model_directory_holds_the_effects_and_show_prints_them(tmp_path: Path) -> None:
    augmented = model(*EFFECTS["pump-cooling"], *EFFECTS["startup-churning"])
    write_model_directory(tmp_path / "m", augmented)
    assert find_model(tmp_path / "m").model == augmented
    said = CliRunner().invoke(main, ["model", "show", str(tmp_path / "m")]).output
    assert "effect pump-cooling: loss 0.005; sink 25; pump P" in said
    assert "effect startup-churning: gain 0.1; shape 1; tau 80; since W_ON" in said
    document = json.loads(CliRunner().invoke(main, ["model", "show", str(tmp_path / "m"), "--json"]).output)
    assert [effect["kind"] for effect in document["effects"]] == ["pump-cooling", "startup-churning"]
