"""`decanter trace can`: a log to a table, JSON and a CSV that column maps read."""

import csv
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from tests.drivers.can_frames import candump
from tests.drivers.test_can_log import trip

ROOT = Path(__file__).resolve().parents[2]


def called(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["trace", "can", *map(str, arguments)])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "trip.log"
    path.write_text(candump(trip(60)) + "(1070.0) can0 7E8#0241050000000000\nbroken\n")
    return path


def test_the_csv_has_every_reading_and_the_map_of_the_same_name_reads_it(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "made" / "trace.csv"
    result = called(log, "--device", "obd2", "--out", out, "--json")
    assert result.exit_code == 0, result.output
    data = json.loads(result.output)
    assert data["counts"]["log_frames"] == 121
    assert data["counts"]["log_refused"] == 1
    by_tag = {row["tag"]: row for row in data["tags"]}
    assert (by_tag["CoolantTemperature"]["good"], by_tag["CoolantTemperature"]["highest"]) == (60, 59)
    assert by_tag["CoolantTemperature"]["not_good"] == {"DECODING_ERROR": 1}
    with out.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == sum(row["good"] + sum(row["not_good"].values()) for row in data["tags"])
    assert rows[0] == {"time_s": "1000.000000", "signal": "EngineSpeed", "value": "0.0", "quality": "GOOD"}
    assert rows[-1] == {
        "time_s": "1070.000000",
        "signal": "CoolantTemperature",
        "value": "nan",
        "quality": "DECODING_ERROR",
    }
    (trace,), report = load_traces(out, load_map(ROOT / "config" / "traces" / "can_obd2.toml"))
    assert not report.errors
    assert trace.times[0] == 1000.0
    assert [event.symbol for event in trace.events][:2] == ["W_OFF", "R_0"]


def test_the_table_says_what_became_of_the_frames_and_who_speaks(log: Path) -> None:
    result = called(log)
    assert result.exit_code == 0, result.output
    for words in (
        "CoolantTemperature",
        "7E8",
        "log_frames",
        "121",
        "DECODING_ERROR 1",
        "not decoded: 1 refused (first: line 122",
    ):
        assert words in result.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["absent.log"], "absent.log: cannot be read"),
        (["."], ".: is a folder; give one log file"),
        (["{log}", "--device", "decanter_plc"], "driver 'modbus' has no recordings"),
        (["{log}", "--format", "pcap"], "'pcap' is no format of CAN logs"),
        (["{log}", "--bus", "can7"], None),
    ],
)
def test_what_cannot_be_decoded_is_one_sentence(arguments: list[str], words: str | None, log: Path) -> None:
    result = called(*(word.replace("{log}", str(log)) for word in arguments))
    if words is None:
        assert result.exit_code == 0
        return
    assert result.exit_code in (2, 3)
    assert words in result.output
    assert result.output.count("\n") == 1


def test_a_log_that_cannot_be_used_leaves_no_file_behind(tmp_path: Path) -> None:
    path, out = tmp_path / "noise.log", tmp_path / "trace.csv"
    path.write_text("no log\n")
    result = called(path, "--out", out)
    assert result.exit_code == 2
    assert list(tmp_path.iterdir()) == [path]
