"""The present cycle held against a model's training, scan by scan: what it changes, and what it does not."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.settings import ConfigError
from gateway.machine.model.familiar import CycleFamiliarity, FamiliarityRating
from gateway.machine.model.loading import load_model
from gateway.machine.model.predict import Predictor, ScanPrediction
from gateway.outside.status import GatewayStatus, findings, read_status
from gateway.outside.texts import all_words
from gateway.outside.web import machine_view
from gateway.settings import load_config
from sim.artefacts import FAMILIARITY_FILE, Familiarity
from sim.familiarity import MIN_CYCLES, ErrorCurve, fit_reference
from sim.lab.formats import write_model_directory
from tests.gateway.status_picture import picture
from tests.gateway.support import TEMPERATURE, config_in, two_modes
from tests.retraining.test_familiarity import cycles_of, restless


@pytest.fixture(scope="module")
def known() -> Familiarity:
    cycles = [each.values for seed in range(4) for each in cycles_of(restless(seed, step=10.0))]
    curve = ErrorCurve(strangeness=np.array([0.5, 3.0]), error=np.array([0.1, 0.2]), cycles=2)
    return Familiarity(fit_reference(cycles), curve)


def ratings(known: Familiarity | None, warmer: float, limit: float = 1.2) -> list[FamiliarityRating]:
    """What is said at each row of a day."""
    model = replace(two_modes(), temperature="T")
    following = CycleFamiliarity(known, model, limit)
    trace = restless(77, hours=6.0, step=10.0, warmer=warmer)
    predictor = Predictor(model, "T")
    found = []
    columns = {name: column.tolist() for name, column in trace.signals.items()}
    for row, time in enumerate(trace.times.tolist()):
        readings = {name: column[row] for name, column in columns.items()}
        scan: Any = SimpleNamespace(time=time, good=readings.get)
        events = tuple(predictor.encoder.feed(time, {k: readings[k] for k in ("MarciaDecanter", "Assorbimento")}))
        found.append(following.take(scan, events))
    return found


def test_a_model_without_a_reference_says_unknown_and_changes_nothing(known: Familiarity) -> None:
    (only,) = set(ratings(None, warmer=30.0))
    assert only == FamiliarityRating("unknown", 1.2) and not only.outside
    before = prediction("green")
    assert before.with_familiarity(only) == replace(before, familiarity=only)


def test_another_machine_is_outside_from_its_first_hour_on_and_the_same_one_is_not(known: Familiarity) -> None:
    same, other = ratings(known, warmer=0.0), ratings(known, warmer=12.0)
    assert {each.zone for each in same[:300]} == {"unknown"}, "nothing is said before an hour was read"
    assert {each.zone for each in same} == {"unknown", "green"} and not any(each.outside for each in same)
    outside = [each for each in other if each.outside]
    assert len(outside) > 0.7 * sum(each.strangeness is not None for each in other)
    assert {(each.zone, each.thing.kind) for each in outside} == {("yellow", "warmer")}
    assert all(each.expected_error is not None and 0.1 <= each.expected_error <= 0.2 for each in outside)
    # A rating comes every five minutes: between them the same one is given.
    assert len(set(map(id, other))) < len(other) / 20
    assert ({each.word for each in same}, other[-1].word) == ({"unknown", "familiar"}, "strange")
    assert not any(each.outside for each in ratings(known, warmer=12.0, limit=100.0))


def prediction(zone: str) -> ScanPrediction:
    plain: dict[str, Any] = dict.fromkeys(ScanPrediction.__slots__)
    return ScanPrediction(**plain | {"zone": zone, "virtual": None, "familiarity": None})


@pytest.mark.parametrize(
    ("zone", "of_cycle", "outside", "after"),
    [
        ("green", "yellow", True, "yellow"),
        ("green", "red", True, "red"),
        ("red", "yellow", True, "red"),
        ("none", "red", True, "none"),
        # What errors are to be expected lowers nothing while the cycle is a familiar one.
        ("green", "red", False, "green"),
    ],
)
def test_confidence_is_lowered_outside_of_the_training_alone(
    zone: str, of_cycle: Any, outside: bool, after: str
) -> None:
    rating = FamiliarityRating(of_cycle, 1.2, 0.0, 2.0, 0.3, outside)
    assert prediction(zone).with_familiarity(rating).zone == after


def status_of(**changes: Any) -> GatewayStatus:
    """A picture in which idling is strange."""
    rating = {
        "zone": "yellow", "limit": 1.2, "time": 0.0, "strangeness": 2.5, "expected_error": 0.31, "outside": True,
        "thing": {"kind": "above", "features": ["idling"], "values": [40.0], "bound": 12.0},
        "sentence": "idling for 40 min of the last hour: in training at most 12",
    }  # fmt: skip
    plain = picture()
    plain["prediction"] |= {"zone": "yellow", "familiarity": rating | changes}
    return read_status(plain)


def test_health_and_page_say_what_is_strange_in_the_language_of_who_reads() -> None:
    said = {each.check: each.sentence for each in findings(status_of())}
    assert said["model"].endswith("is unlike the training: idling for 40 min of the last hour: in training at most 12")
    rows = {
        language: machine_view(words, {}, status_of())["temperatures"][0]["familiarity"]
        for language, words in all_words().items()
    }
    assert rows["en"]["sentence"] == "idling for 40 min of the last hour: in training at most 12"
    assert rows["it"]["sentence"] == "a vuoto per 40 min dell'ultima ora: nell'addestramento al massimo 12"
    assert rows["de"]["sentence"] == "Leerlauf über 40 min der letzten Stunde: im Training höchstens 12"
    assert rows["de"]["detail"] == "Fremdheit 2,50, Grenze 1,20; erwarteter Fehler 31 % der Bewegung"
    nothing = {"kind": "", "features": [], "values": [], "bound": None}
    calm = status_of(outside=False, zone="green", thing=nothing, sentence="")
    assert "unlike" not in " ".join(each.sentence for each in findings(calm))
    unknown = status_of(outside=False, zone="unknown", strangeness=None)
    assert machine_view(all_words()["en"], {}, unknown)["temperatures"][0]["familiarity"] is None


def test_the_limit_has_a_range(tmp_path: Path) -> None:
    assert load_config(config_in(tmp_path, "[alarms]\nunfamiliar = 2.5\n").path).alarms.unfamiliar == 2.5
    with pytest.raises(ConfigError, match=r"alarms\.unfamiliar: .*0\.5 to 100"):
        config_in(tmp_path, "[alarms]\nunfamiliar = 0.1\n")


def test_a_reference_travels_with_its_model_and_a_damaged_one_stops_the_start(
    tmp_path: Path, known: Familiarity
) -> None:
    assert known.reference.held_out.size >= MIN_CYCLES
    write_model_directory(tmp_path / "m", two_modes(), more={FAMILIARITY_FILE: known.text()})
    config = config_in(tmp_path, f"[model]\npath = 'm'\ntemperature = '{TEMPERATURE}'\n")
    loaded = load_model(config)
    assert loaded is not None and loaded.familiarity is not None and loaded.familiarity.curve is not None
    write_model_directory(tmp_path / "m", two_modes(), more={FAMILIARITY_FILE: "{}"})
    with pytest.raises(ConfigError, match=r"familiarity\.json: cannot be used"):
        load_model(config)
