"""One demonstration, and three that are ended: its report, its judge (no formality), and that nothing stays behind."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from gateway.demo.can_bus import LONGEST_PATH, hub_path
from gateway.demo.live import newest_status
from gateway.demo.summary import verdict
from gateway.store.read_back import samples
from tests.cli.support import decanter, only_object, refused, with_one_bearing

GATEWAY = (sys.executable, "-m", "gateway.cli.main")
PATIENCE_S = 500.0


def performed(folder: Path, *arguments: object, seconds: float) -> dict[str, Any]:
    """The object of a whole demonstration, with a process of its own for the command, as people start it."""

    def once(longer: float) -> tuple[int, str, str]:
        command = [*GATEWAY, "demo", "--json", "--out", str(folder), *map(str, arguments), "--seconds", str(longer)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
        return done.returncode, done.stdout, done.stderr

    return long_enough(once, seconds)


def long_enough(once: Callable[[float], tuple[int, str, str]], seconds: float) -> dict[str, Any]:
    """The object of a demonstration of so many seconds, longer where the computer had no time for a scan or two."""
    for slower in (1.0, 4.0, 16.0):
        code, out, err = once(slower * seconds)
        assert code == 0, err
        assert "Traceback" not in err
        data = only_object(out)
        if data["writeback"]["accepted"] > 50 and data["forecast"]["60"]["count"] > 0:
            break
    return data


def sane(data: dict[str, Any]) -> None:
    """What every demonstration must have come to, whatever the trace."""
    assert data["wrong_good"] == 0 and data["judged"] > 100
    assert data["fitness"]["word"] in ("fit", "limited", "unfit")
    assert bool(data["fitness"]["why"]) == (data["fitness"]["word"] != "fit")
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
    assert outage["detected_s"] is not None and 0 <= outage["detected_s"] < 30.0
    assert outage["recovered_s"] is not None and outage["recovered_s"] > 0
    assert Path(data["picture"]).read_bytes().startswith(b"\x89PNG") and Path(data["log"]).is_file()


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, traces: Path) -> tuple[Path, dict[str, Any]]:
    """A whole demonstration on the first half of cd17, eight seconds of replay: its folder and its object."""
    home = tmp_path_factory.mktemp("demo")
    lines = (traces / "cd17.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (home / "cd17.csv").write_text("".join(lines[: len(lines) // 2]), encoding="utf-8")
    return home / "out", performed(home / "out", "--trace", home / "cd17.csv", seconds=8)


def test_the_demo_ends_with_one_object_that_holds_together(shown: tuple[Path, dict[str, Any]]) -> None:
    _, data = shown
    sane(data)
    assert data["synthetic"] is True


def test_both_bearings_are_predicted_written_and_judged_by_the_plc(shown: tuple[Path, dict[str, Any]]) -> None:
    folder, data = shown
    assert [bearing["temperature"] for bearing in data["bearings"]] == [
        "TCuscinettiRiduttore",
        "TCuscinettiAlimentazione",
    ]
    for bearing in data["bearings"]:
        sane(data | bearing | {"writeback": data["writeback"]})
        assert bearing["writeback"]["accepted"] > 25 and bearing["writeback"]["refused"] == 0
    first, second = data["bearings"]
    assert first["writeback"]["accepted"] + second["writeback"]["accepted"] == data["writeback"]["accepted"]
    assert first["errors"] == data["errors"] != second["errors"]
    blocks = [json.loads(row) for row in (folder / "plc.jsonl").read_text(encoding="utf-8").splitlines()]
    written = {row["address"]: row.get("block", "") for row in blocks if row["k"] == "block"}
    assert written == {400: "", 430: "Alimentazione"}
    assert (folder / "demo_TCuscinettiAlimentazione.png").read_bytes().startswith(b"\x89PNG")
    assert len({path.read_bytes() for path in folder.glob("model*/model.json")}) == 2


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
    stored = [sample for sample in samples(shown[0] / "historian.sqlite") if sample.tag == "TCuscinettiRiduttore"]
    stretches = [list(some) for _, some in groupby(stored, key=lambda sample: sample.quality.is_good)]
    outage = max((some for some in stretches if not some[0].quality.is_good), key=len)
    # A busy machine may lose a scan elsewhere, and the last one; the outage is the longest, and good readings follow.
    assert stretches[-1] is not outage and len(outage) > 1


def test_the_hubs_socket_has_a_path_that_a_socket_can_have(tmp_path: Path) -> None:
    assert hub_path(tmp_path) == tmp_path / "can.hub"
    far = tmp_path / ("x" * 120)
    assert len(os.fsencode(hub_path(far))) <= LONGEST_PATH
    assert hub_path(far) == hub_path(far) != hub_path(far / "y")


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


def alive(pids: list[int]) -> list[int]:
    """Those of the processes that still run; one that has ended and is not yet waited for does not."""
    running = []
    for pid in pids:
        try:
            state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
        except FileNotFoundError:
            continue
        if state != "Z":
            running.append(pid)
    return running


def named(folder: Path) -> list[int]:
    """The processes whose command line names the folder, by /proc."""
    pids = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if str(folder).encode() in words:
                pids.append(int(entry.name))
    return pids


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]


# Over CAN there is a third process to be left behind, the hub; what stops it is the same for every signal.
ENDINGS = [(signal.SIGINT, "can", 3), (signal.SIGTERM, "modbus-tls", 2), (signal.SIGKILL, "can", 3)]


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="needs /proc")
@pytest.mark.parametrize(("number", "link", "processes"), ENDINGS, ids=[number.name for number, *_ in ENDINGS])
def test_however_a_demo_is_ended_no_process_stays(
    number: signal.Signals,
    link: str,
    processes: int,
    shown: tuple[Path, dict[str, Any]],
    traces: Path,
    tmp_path: Path,
) -> None:
    """Over the other links, in the folder of an earlier one: it begins anew, and is ended when its gateway has read."""
    folder = tmp_path / "out"
    shutil.copytree(shown[0], folder)
    (folder / "status.json").unlink()
    trace = with_one_bearing(traces / "cd1.csv", tmp_path, rows=200)
    options = ["--link", link, "--trace", str(trace), "--seconds", "60", "--out", str(folder)]
    command = [*GATEWAY, "demo", "--json", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as demo:
        try:
            deadline = time.monotonic() + PATIENCE_S
            while (seen := newest_status(folder / "status.json")) is None or not seen["link"]["alive"]:
                assert demo.poll() is None and time.monotonic() < deadline
                time.sleep(0.05)
            started = children(demo.pid)
            assert len(started) == processes
            assert hub_path(folder).exists() == (link == "can")
            plant = (folder / "plant.toml").read_text(encoding="utf-8")
            assert ('transport = "tls"' in plant) == (link == "modbus-tls")
            assert not list(folder.glob("demo_*.png")), "one bearing is measured here, of the two before"
            os.kill(demo.pid, number)
            out, err = demo.communicate(timeout=PATIENCE_S)
        finally:
            demo.kill()
    deadline = time.monotonic() + 120.0
    while (alive(started) or named(folder)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert alive(started) == [] and named(folder) == []
    assert "Traceback" not in err
    if number != signal.SIGKILL:
        assert demo.returncode == 130
        answer = json.loads(out)
        assert answer["ok"] is False and answer["exit"] == 130 and "stopped before the end" in answer["reason"]
        assert "stopped before the end" in err.splitlines()[-1]
        assert not hub_path(folder).exists()
    else:
        assert demo.returncode == -number and out == ""
