"""The judge as a command: what a client held for good against what the PLC recorded, from files alone."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivers.tag import Quality
from sim.plc.record.recorder import PlcRecorder
from sim.plc.record.verdict import main

GOOD, TIMEOUT = int(Quality.GOOD), int(Quality.TIMEOUT)
RIGHT = [
    {"tag": "T", "value": 20.0, "quality": GOOD, "time": 1012.0, "sent": 1011.0},
    {"tag": "T", "value": 30.0, "quality": GOOD, "time": 1025.0, "sent": 1024.0},
    {"tag": "On", "value": True, "quality": GOOD, "time": 1012.0},
    {"tag": "On", "value": 1.0, "quality": GOOD, "time": 1012.0},
    {"tag": "Recipe", "value": "fango 1", "quality": GOOD, "time": 1012.0},
    {"tag": "T", "value": None, "quality": TIMEOUT, "time": 1013.0, "sent": 1012.0},
    {"tag": "T", "value": 77.0, "quality": TIMEOUT, "time": 1013.0, "sent": 1012.0},
]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Plant time is 1000 s + 10 times the monotonic one; T is 20 from 1010 on and 30 from 1020 on."""
    path = tmp_path / "plc.jsonl"
    recorder = PlcRecorder(path, pytest.fail)
    about = {"epoch": 1000.0, "monotonic": 50.0, "speed": 10.0, "device": "d", "trace": None, "seed": 0}
    recorder("run", 50.0, {**about, "roundings": {"T": [0.05, 0.0], "On": [0.0, 0.0]}})
    recorder("truth", 51.0, {"version": 1, "values": {"T": 20.0, "On": True, "Recipe": "fango 1"}})
    recorder("truth", 52.0, {"version": 2, "values": {"T": 30.0}})
    recorder("event", 53.0, {"event": "fault began", "number": 1, "kind": "refuse"})
    for accepted in (True, True, False):
        verdict = "accepted" if accepted else "CRC"
        block = {"peer": "p", "address": 400, "words": [], "fields": None, "verdict": verdict, "accepted": accepted}
        recorder("block", 54.0, block)
    recorder.close()
    return path


def judged(recording: Path, rows: Sequence[Mapping[str, Any]], *options: str) -> Result:
    samples = recording.with_name("samples.jsonl")
    samples.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return CliRunner().invoke(main, [str(recording), str(samples), *options])


def test_right_readings_of_every_type_pass_and_the_account_is_given(recording: Path) -> None:
    result = judged(recording, RIGHT)
    said = json.loads(result.stdout)
    assert result.exit_code == 0
    assert (said["judged"], said["good"], said["wrong_good"], said["examples"]) == (7, 5, 0, [])
    assert (said["blocks_accepted"], said["blocks_refused"], said["missing"], said["damaged"]) == (2, 1, 0, 0)
    (event,) = said["events"]
    assert (event["event"], event["time"], event["kind"]) == ("fault began", 1030.0, "refuse")


@pytest.mark.parametrize(
    ("row", "value"), [(0, 20.2), (1, 20.0), (2, False), (3, 0.0), (4, "fango 2"), (0, None), (0, float("nan"))]
)
def test_one_wrong_value_among_right_ones_is_found(row: int, value: object, recording: Path) -> None:
    rows = [*RIGHT]
    rows[row] = {**rows[row], "value": value}
    result = judged(recording, rows)
    said = json.loads(result.stdout)
    assert result.exit_code == 1
    assert said["wrong_good"] == 1
    assert said["examples"][0]["time"] == RIGHT[row]["time"]
    assert f"{RIGHT[row]['tag']} was said to be" in said["examples"][0]["reason"]


def test_an_old_value_is_right_only_within_the_tolerance(recording: Path) -> None:
    old = [{"tag": "T", "value": 20.0, "quality": GOOD, "time": 1022.0, "sent": 1022.0}]
    assert judged(recording, old).exit_code == 1
    assert judged(recording, old, "--tolerance", "1.9").exit_code == 1
    assert judged(recording, old, "--tolerance", "2.1").exit_code == 0


SAMPLE = RIGHT[0]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("{", "line 2: is no sample"),
        ("[]", "line 2: is no sample"),
        (json.dumps({"tag": "T", "value": 1.0, "quality": GOOD}), "'time' is missing"),
        (json.dumps({**SAMPLE, "value": [1]}), "value [1] is no number, text"),
        (json.dumps({**SAMPLE, "quality": 7}), "is not a valid Quality"),
        (json.dumps({**SAMPLE, "time": "noon"}), "could not convert"),
        (json.dumps({**SAMPLE, "time": float("nan")}), "are no moments"),
        (json.dumps({**SAMPLE, "sent": 2000.0}), "sent is not the later"),
    ],
)
def test_a_line_that_is_no_sample_is_named_with_its_reason(line: str, reason: str, recording: Path) -> None:
    samples = recording.with_name("samples.jsonl")
    samples.write_text(json.dumps(SAMPLE) + "\n" + line + "\n", encoding="utf-8")
    result = CliRunner().invoke(main, [str(recording), str(samples)])
    assert (result.exit_code, result.stdout) == (2, "")
    assert reason in result.stderr and "samples.jsonl: line 2" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["nowhere.jsonl", "folder", "binary"])
def test_files_that_cannot_be_read_are_one_sentence(name: str, recording: Path) -> None:
    (recording.parent / "folder").mkdir()
    (recording.parent / "binary").write_bytes(b"\xff\xfe\x00garbage")
    other = recording.with_name(name)
    for arguments in ([str(recording), str(other)], [str(other), str(recording)]):
        result = CliRunner().invoke(main, arguments)
        assert (result.exit_code, result.stdout) == (2, "")
        assert result.stderr.startswith("verdict: ") and name in result.stderr and result.stderr.count("\n") == 1
