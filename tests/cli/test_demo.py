"""The demonstration from start to end: its report, its judge (no formality), and that nothing stays behind."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from gateway.demo.summary import verdict
from gateway.store.read_back import samples
from tests.cli.support import DATA, decanter, only_object, refused

GATEWAY = (sys.executable, "-m", "gateway.cli.main")
PATIENCE_S = 60.0


def performed(folder: Path, *arguments: object) -> dict[str, Any]:
    """The object of a whole demonstration as a process."""
    command = [*GATEWAY, "demo", "--json", "--out", str(folder), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return only_object(done.stdout)


def sane(data: dict[str, Any]) -> None:
    """What every demonstration must have come to, whatever the trace."""
    assert data["wrong_good"] == 0 and data["judged"] > 100
    assert data["events"] > 0 and data["samples"] > 0
    for error in data["errors"].values():
        assert 0 < error["mae"] <= error["rmse"] < 50
    assert list(data["forecast"]) == ["60", "300", "900"]
    near = data["forecast"]["60"]
    assert near["count"] > 0 and near["mae"] > 0 and near["persistence_mae"] > 0 and 0 <= near["coverage90"] <= 1
    assert 0 < near["crps"] < near["mae"] * 2
    written, outage = data["writeback"], data["outage"]
    assert written["accepted"] > 50 and written["refused"] == 0
    assert 0 < written["latency_ms"]["p50"] <= written["latency_ms"]["p99"]
    assert outage["detected_s"] is not None and 0 <= outage["detected_s"] < 2.0
    assert outage["recovered_s"] is not None and outage["recovered_s"] > 0
    assert Path(data["picture"]).read_bytes().startswith(b"\x89PNG") and Path(data["log"]).is_file()


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, traces: Path) -> tuple[Path, dict[str, Any]]:
    """A whole demonstration on cd17, eight seconds of replay: its folder and its object."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    return folder, performed(folder, "--trace", traces / "cd17.csv", "--seconds", 8)


@pytest.mark.slow
def test_the_demo_ends_with_one_object_that_holds_together(shown: tuple[Path, dict[str, Any]]) -> None:
    _, data = shown
    sane(data)
    assert data["synthetic"] is True


def judge_again(folder: Path, rows: list[str]) -> dict[str, Any]:
    readings = folder / "changed.jsonl"
    readings.write_text("".join(row + "\n" for row in rows), encoding="utf-8")
    return verdict(folder / "plc.jsonl", readings, tolerance=8.0)


def test_one_wrong_value_in_what_was_held_for_good_is_found(shown: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(shown[0], folder)
    rows = (folder / "samples.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(rows) == shown[1]["judged"]
    assert judge_again(folder, rows)["wrong_good"] == 0
    for tag, wrong in (("TCuscinettiRiduttore", 3.0), ("MarciaDecanter", 1.0), ("BlocksAccepted", 5000.0)):
        place = [number for number, row in enumerate(rows) if json.loads(row)["tag"] == tag][-3]
        row = json.loads(rows[place])
        value = 1.0 - row["value"] if tag == "MarciaDecanter" else row["value"] + wrong
        changed = [*rows[:place], json.dumps({**row, "value": value}), *rows[place + 1 :]]
        assert judge_again(folder, changed)["wrong_good"] == 1, tag


def test_the_outage_is_in_the_historian_as_bad_quality(shown: tuple[Path, dict[str, Any]]) -> None:
    stored = [one for one in samples(shown[0] / "historian.sqlite") if one.tag == "TCuscinettiRiduttore"]
    bad = [one for one in stored if not one.quality.is_good]
    assert bad and all(one.value is None or not one.quality.is_good for one in bad)
    assert stored[-1].quality.is_good and stored[-1].time > bad[-1].time


@pytest.mark.slow
def test_a_second_demo_in_the_same_folder_begins_anew(shown: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder = tmp_path / "again"
    shutil.copytree(shown[0], folder)
    data = performed(folder, "--trace", folder / "replay.csv", "--seconds", 6)
    sane(data)
    assert data["rows"] < shown[1]["rows"]


def test_a_demo_says_what_is_wrong_before_it_starts_anything(
    shown: tuple[Path, dict[str, Any]], wrong: Path, traces: Path
) -> None:
    refused(decanter("demo", "--trace", wrong / "none.csv", "--out", wrong / "a"), 2, "none.csv")
    refused(decanter("demo", "--trace", wrong / "cold.csv", "--out", wrong / "a"), 2, "TCuscinettiRiduttore")
    refused(decanter("demo", "--map", "nomap", "--out", wrong / "a"), 2, "nomap")
    refused(decanter("demo", "--out", wrong / "empty"), 2, "empty", "--out")
    refused(decanter("demo", "--out", wrong / "folder"), 2, "folder", "--out")
    assert (wrong / "folder" / "note.txt").read_text(encoding="utf-8") == "hello"
    before = (shown[0] / "demo.png").stat().st_mtime_ns
    refused(decanter("demo", "--trace", wrong / "none.csv", "--out", shown[0]), 2, "none.csv")
    assert (shown[0] / "demo.png").stat().st_mtime_ns == before


def alive(folder: Path) -> list[int]:
    """The processes whose command line names the folder, by /proc."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if str(folder).encode() in words:
                found.append(int(entry.name))
    return found


def gone(folder: Path) -> bool:
    deadline = time.monotonic() + 20.0
    while alive(folder) and time.monotonic() < deadline:
        time.sleep(0.05)
    return alive(folder) == []


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda number: number.name)
def test_however_a_demo_is_ended_neither_process_stays(number: signal.Signals, traces: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    command = [*GATEWAY, "demo", "--json", "--trace", traces / "cd17.csv", "--seconds", "60", "--out", folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as demo:
        deadline = time.monotonic() + PATIENCE_S
        while not (folder / "status.json").exists() or len(alive(folder)) < 3:
            assert demo.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        os.kill(demo.pid, number)
        out, err = demo.communicate(timeout=PATIENCE_S)
    assert gone(folder)
    assert out == ""
    assert "Traceback" not in err
    if number != signal.SIGKILL:
        assert demo.returncode == 130
        assert "stopped before the end" in err.splitlines()[-1]
    else:
        assert demo.returncode == -number


@pytest.mark.slow
@pytest.mark.real_data
def test_the_demo_on_a_measured_pump_learns_and_foresees(tmp_path: Path) -> None:
    trace = DATA / "skab" / "anomaly-free.csv"
    if not trace.exists():
        pytest.skip(f"{trace} is not there")
    data = performed(tmp_path / "out", "--trace", trace, "--map", "skab", "--seconds", 8)
    sane(data)
    assert data["synthetic"] is False and data["errors"]["one_step"]["rmse"] < 1.0
