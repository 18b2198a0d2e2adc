"""The judge, and the recording that it judges by."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.tag import Quality, Sample
from sim.plc.program.checks import InputError
from sim.plc.program.clock import EmulatorClock
from sim.plc.record.judge import wrong_good
from sim.plc.record.recorder import PlcRecorder
from sim.plc.record.recording import PlcRecording, Run, TruthRow, read_recording

ROUNDINGS = {"T": (0.05, 1e-12), "On": (0.0, 0.0), "F": (0.0, 2.0**-23)}
RUN = Run(EmulatorClock(0.0, 0.0), "decanter", None, 0, ROUNDINGS)
HISTORY = [
    ("T", 0.0, None),
    ("T", 10.0, 20.0),
    ("T", 20.0, 30.0),
    ("T", 30.0, None),
    ("On", 0.0, True),
    ("F", 0.0, 18.4),
]
TRUTH = tuple(TruthRow(time, time, 1, tag, value) for tag, time, value in HISTORY)
RECORDING = PlcRecording((RUN,), TRUTH, (), (), (), 0, 0)


def judged(tag: str, value: object, sent: float, time: float, tolerance_s: float = 0.0) -> bool:
    """True if the judge finds nothing wrong."""
    sample = Sample(tag, value, Quality.GOOD, time, sent)
    return not wrong_good(RECORDING, [sample], tolerance_s)


def test_a_good_value_must_have_been_true_between_sent_and_time() -> None:
    assert judged("T", 20.0, 12.0, 13.0)
    assert not judged("T", 30.0, 12.0, 13.0)
    assert not judged("T", 20.0, 20.0, 21.0)
    assert judged("T", 20.0, 19.9, 21.0) and judged("T", 30.0, 19.9, 21.0)
    assert not judged("T", 20.0, 5.0, 9.0)


def test_a_value_may_differ_by_its_registers_rounding_and_no_more() -> None:
    assert judged("T", 20.05, 12.0, 13.0) and not judged("T", 20.06, 12.0, 13.0)
    assert judged("F", 18.399999618530273, 1.0, 2.0) and not judged("F", 18.4001, 1.0, 2.0)
    assert judged("On", True, 1.0, 2.0) and judged("On", 1.0, 1.0, 2.0) and not judged("On", False, 1.0, 2.0)


def test_an_old_value_is_right_only_within_the_tolerance() -> None:
    assert judged("T", 20.0, 21.0, 21.1, tolerance_s=1.5) and not judged("T", 20.0, 22.0, 22.1, tolerance_s=1.5)


def test_nothing_is_right_while_the_plc_has_no_value_or_no_such_tag() -> None:
    assert not judged("T", 30.0, 31.0, 32.0) and not judged("T", 0.0, 31.0, 32.0)
    assert not judged("Unknown", 1.0, 1.0, 2.0)
    (wrong,) = wrong_good(RECORDING, [Sample("T", 31.0, Quality.GOOD, 22.0, 21.0)])
    assert wrong.truths == (30.0,) and "31.0" in wrong.reason


@given(st.sampled_from([quality for quality in Quality if not quality.is_good]))
def test_what_was_not_called_good_is_not_judged(quality: Quality) -> None:
    assert wrong_good(RECORDING, [Sample("T", 99.0, quality, 22.0, 21.0)]) == []


def begun(path: Path) -> PlcRecorder:
    recorder = PlcRecorder(path, pytest.fail)
    about = {"epoch": 1000.0, "monotonic": 50.0, "speed": 10.0, "device": "d", "trace": None, "seed": 0}
    recorder("run", 50.0, {**about, "roundings": {"T": [0.5, 0.0]}})
    return recorder


def test_a_recording_comes_back_with_both_clocks(tmp_path: Path) -> None:
    recorder = begun(tmp_path / "r.jsonl")
    recorder("truth", 51.0, {"version": 2, "values": {"T": 1.25, "On": None}})
    recorder("event", 52.0, {"event": "connected", "peer": "x"})
    recording = read_recording(tmp_path / "r.jsonl")  # while the writer still has it open
    assert recording.truth[0] == TruthRow(51.0, 1010.0, 2, "T", 1.25)
    assert recording.truth[1].value is None
    assert (recording.events[0].event, recording.events[0].detail) == ("connected", {"peer": "x"})
    assert (recording.missing, recording.damaged) == (0, 0)
    recorder.close()


def test_half_a_line_and_missing_rows_are_counted_and_the_next_run_goes_on_below(tmp_path: Path) -> None:
    path = tmp_path / "r.jsonl"
    begun(path).close()
    with path.open("a") as stream:
        stream.write(json.dumps({"k": "event", "n": 4, "t": 51.0, "event": "later"}) + '\n{"k":"tru')
    begun(path).close()
    recording = read_recording(path)
    assert (len(recording.runs), recording.missing, recording.damaged) == (2, 2, 1)


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x").write_text('{"a": 1}\n')
    with pytest.raises(InputError, match="no row of a recording"):
        read_recording(tmp_path / "x")
    with pytest.raises(InputError, match="cannot be written"):
        PlcRecorder(tmp_path / "none" / "r.jsonl", pytest.fail)
