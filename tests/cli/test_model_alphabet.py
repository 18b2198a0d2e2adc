"""A trace that meets a model is encoded by the model's alphabet, whatever thresholds its column map has or finds."""

import json
from pathlib import Path
from typing import Any, NoReturn

import pytest

from sim.lab.formats.find import find_model
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.sha.events import encode
from sim.sha.model import Model
from sim.sha.trace import Trace
from tests.cli.support import ROOT, command_paths, decanter, find_command, refused

OWN = ROOT / "config" / "traces" / "decanter.toml"
AUTOMATIC = """
channels = [
    { kind = "switch", signal = "MarciaDecanter", rising = "W_ON", falling = "W_OFF" },
    { kind = "bins", signal = "Assorbimento", thresholds = "auto" },
]
"""
MODEL, TRACE, OUT = "MODEL", "TRACE", "OUT"
RESAMPLED = ["--semantics", "resampled", "--training", TRACE]

MEETING: dict[str, list[str]] = {
    "model check": [MODEL, "Pr[<=3600](<> Temp >= 50)", "--events", TRACE, "--from", "trace:1200", "--runs", "100"],
    "model learn correction": [MODEL, "--traces", TRACE, "--out", OUT],
    "model export": [MODEL, "--uppaal", "--trace", TRACE, "--out", OUT],
    "model judge proof": [MODEL, "--traces", TRACE],
    "model judge rank": [MODEL, "--traces", TRACE, "--runs", "100", "--jobs", "1", "--no-skill", *RESAMPLED],
    "model judge regression": [MODEL, "--standard", TRACE, "--history", OUT],
    "model simulate": [MODEL, "--trace", TRACE, "--runs", "100"],
    "model judge skill": [MODEL, "--traces", TRACE, "--period", "3600"],
    "model judge validation": [
        MODEL,
        "--traces",
        TRACE,
        "--out",
        OUT,
        "--no-pictures",
        "--jobs",
        "1",
        "--no-skill",
        *RESAMPLED,
    ],
}
"""Commands that take a model and, by a column map, traces; `diagnose` has a test of its own."""
FORGETTING = {"model version lineage", "model version retrain"}
"""Those that take the readings of such traces alone: they encode them for each model (tests/retraining)."""
LEARNING = {"demo", "historian import", "trace ingest", "trace show"}
LEARNING |= {f"model learn {word}" for word in ("model", "settings", "fleet")}
"""Those that meet no model, or only one that they learn from these very traces."""


def test_each_command_with_a_column_map_is_among_these() -> None:
    every = {" ".join(words): find_command(words) for words, _ in command_paths()}
    mapped = {words for words, command in every.items() if any("--map" in option.opts for option in command.params)}
    assert mapped == {*MEETING, "diagnose", *FORGETTING, *LEARNING}


@pytest.fixture(scope="module")
def automatic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plant's map with automatic thresholds."""
    above, alphabet, _ = OWN.read_text(encoding="utf-8").partition("[alphabet]")
    assert alphabet
    path = tmp_path_factory.mktemp("map") / "automatic.toml"
    path.write_text(above + alphabet + AUTOMATIC, encoding="utf-8")
    return path


def test_the_automatic_thresholds_are_others_than_the_models(automatic: Path, model: Path, traces: Path) -> None:
    (trace,), report = load_traces(traces / "cd17.csv", load_map(automatic))
    assert trace.events != encode(trace, find_model(model).runnable().alphabet) and report.alphabet.channels


@pytest.mark.parametrize("command", MEETING)
def test_a_command_answers_the_same_whatever_the_map_says_of_thresholds(
    command: str, automatic: Path, model: Path, traces: Path, tmp_path: Path
) -> None:
    def answered(column_map: Path) -> tuple[int, Any]:
        places = {MODEL: str(model), TRACE: str(traces / "cd17.csv"), OUT: str(tmp_path / column_map.stem)}
        words = [places.get(word, word) for word in MEETING[command]]
        result = decanter(*command.split(), *words, "--map", column_map, "--json")
        assert result.exit_code in (0, 1), result.output
        return result.exit_code, timeless(
            json.loads(result.stdout.replace(places[OUT], OUT).replace(str(column_map), "MAP"))
        )

    assert answered(automatic) == answered(OWN)


def test_diagnose_hands_on_the_events_of_the_models_alphabet(
    automatic: Path, model: Path, traces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Trace] = []

    def diagnosed(_model: Model, given: list[Trace], **_: Any) -> NoReturn:
        seen.extend(given)
        raise ValueError("seen")

    monkeypatch.setattr("gateway.lab.gap.diagnose.diagnose_model", diagnosed)
    places = ("--model", model, "--traces", traces, "--out", tmp_path / "out", "--map", automatic)
    refused(decanter("diagnose", *places), 2, "seen")
    alphabet = find_model(model).runnable().alphabet
    assert [trace.events for trace in seen] == [encode(trace, alphabet) for trace in seen]


TIMED = ("seconds", "created", "at", "seal")


def timeless(answer: Any) -> Any:
    """The answer without what a clock has said, and without the seal of files that tell when they were made."""
    if isinstance(answer, dict):
        return {name: timeless(value) for name, value in answer.items() if name not in TIMED}
    return [timeless(each) for each in answer] if isinstance(answer, list) else answer
