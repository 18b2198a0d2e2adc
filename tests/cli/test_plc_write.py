"""`decanter plc` where it writes: armed by name, reason and minutes, else exit code 6; every answer one sentence."""

import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.outside.status import connect
from gateway.store.audit import read, verify
from sim.plc.record.recording import read_recording
from tests.plc.bench import DECANTER, PATIENCE_S, ROOT, Process, running, wait_until

pytestmark = pytest.mark.usefixtures("patient_disk")

HELD_BACK = (
    r"has not taken its row within|its readings are .* s old|WritePermit was read|it waited .* to be sent|"
    r"blocks a second|it was disarmed meanwhile|is not known: "
)
"""What a block may be refused for that a busy machine sends too late, too close after another, or by a late scan."""
MINE = ("plc codegen", "plc check plan", "arm", "disarm", "plc check write", "audit", "plc report")


@pytest.fixture(scope="module")
def plc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, Path]]:
    recording = tmp_path_factory.mktemp("plc") / "recording.jsonl"
    with running("--record", recording) as process:
        yield process, recording


def decanter(folder: Path, *words: str, by: str = "Ada", told: str = "") -> Result:
    environment = {"DECANTER_RECORDS": str(folder / "records.jsonl"), "DECANTER_BY": by}
    return CliRunner().invoke(main, ["plc", *words], env=environment, input=told)


def at(port: int) -> list[str]:
    return ["--device", str(DECANTER), "--host", f"127.0.0.1:{port}"]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.mark.parametrize("name", MINE)
def test_every_command_that_writes_has_its_help(name: str) -> None:
    done = CliRunner().invoke(main, [*name.split(), "--help"])
    assert done.exit_code == 0 and done.output.startswith("Usage: ")


def test_the_plan_shows_every_word_with_both_addresses_and_sends_nothing(tmp_path: Path) -> None:
    nobody = at(free_port())
    done = decanter(tmp_path, "plan", "--write", *nobody, "--json")
    assert done.exit_code == 0
    words = json.loads(done.stdout)["words"]
    assert len(words) == 2 * 26 and [words[at]["block"] for at in (0, 26)] == [
        "TCuscinettiRiduttore",
        "TCuscinettiAlimentazione",
    ]
    assert (words[7]["address"], words[7]["reference"], words[7]["unknown"]) == ("holding:407", "40408", "0x8000")
    assert words[1]["unknown"] == "" and json.loads(done.stdout)["armed"] is None
    text = decanter(tmp_path, "plan", "--write", *nobody).stdout
    assert "holding:425" in text and "40426" in text and "holding:455" in text and "not armed" in text


def test_the_plan_says_what_stands_in_the_way(tmp_path: Path) -> None:
    content = (
        DECANTER.read_text()
        .replace('name = "WritePermit"', 'name = "Permission"')
        .replace("holding:118", "holding:405")
    )
    path = tmp_path / "device.toml"
    path.write_text(content.replace('heartbeat = "PlcHeartbeat"', ""))
    done = decanter(tmp_path, "plan", "--write", "--device", str(path), "--host", "127.0.0.1", "--json")
    assert done.exit_code == 1
    problems = "\n".join(json.loads(done.stdout)["problems"])
    for words in ("no tag WritePermit", "names no heartbeat", "PredictionUsable lies at holding:405"):
        assert words in problems


def test_without_an_arming_nothing_is_written_and_the_exit_code_is_6(plc: tuple[Process, Path], tmp_path: Path) -> None:
    before = len(read_recording(plc[1]).blocks)
    for words in (["test", "alarms"], ["test", "heartbeat"], ["test", "conformance"]):
        done = decanter(tmp_path, *words, *at(plc[0].port))
        assert done.exit_code == 6 and "not armed" in done.stderr and done.stderr.count("\n") == 1
    assert len(read_recording(plc[1]).blocks) == before


@pytest.mark.parametrize(
    ("by", "words", "reason"),
    [
        ("", ["--reason", "x", "--minutes", "5"], "needs a name: say who arms with --by NAME"),
        ("Ada", ["--reason", " ", "--minutes", "5"], "needs a reason"),
        ("Ada", ["--reason", "x", "--minutes", "481"], "at most 480"),
        ("Ada", ["--reason", "x", "--minutes", "nan"], "at most 480"),
        ("Ada", ["--reason", "x"], "Missing option '--minutes'"),
        ("Ada", ["--minutes", "5"], "Missing option '--reason'; see"),
        ("Ada", [], "Missing option '--reason', and '--minutes'; see"),
    ],
)
def test_an_arming_that_is_not_signed_is_refused(tmp_path: Path, by: str, words: list[str], reason: str) -> None:
    done = decanter(tmp_path, "arm", *words, *at(9), by=by)
    assert done.exit_code == 2 and reason in done.stderr
    assert not (tmp_path / "audit.sqlite").exists()


def test_armed_the_loop_tests_run_each_answer_is_kept_and_disarming_ends_it(
    plc: tuple[Process, Path], tmp_path: Path
) -> None:
    place = at(plc[0].port)
    armed = decanter(tmp_path, "arm", "--reason", "loop test", "--minutes", "5", *place)
    assert armed.exit_code == 0 and "ARMED until" in armed.stdout and "Ada" in armed.stdout
    asked = decanter(tmp_path, "test", "alarms", "--ask", *place, told="y\ny\nn\ny\ny\ny\ny\ny\ny\ny\n" + 10 * "y\n")
    assert asked.exit_code == 1 and "TCuscinettiRiduttore: 1 of 10 alarm bits failed, 'AnomalyFound'" in asked.stderr, (
        asked.output
    )
    assert "of TCuscinettiAlimentazione" in asked.output, "each question says of which block"
    assert decanter(tmp_path, "test", "alarms", *place).exit_code == 0
    beats = decanter(tmp_path, "test", "heartbeat", "--no-watchdog", *place, "--json")
    assert beats.exit_code == 0 and [row["ok"] for row in json.loads(beats.stdout)["rows"]] == [True] * 6, (
        "three of each block"
    )
    done = decanter(tmp_path, "disarm", "--reason", "enough", *place)
    assert done.exit_code == 0 and "validity 0 was written" in done.stdout
    assert "nothing was armed" in decanter(tmp_path, "disarm", *place).stdout
    assert decanter(tmp_path, "test", "alarms", *place).exit_code == 6
    blocks = read_recording(plc[1]).blocks
    writes = read(tmp_path / "audit.sqlite", ["write"])
    assert [row.entry.detail["words"] for row in writes] == [
        "".join(f"{word:04x}" for word in block.words) for block in blocks[-len(writes) :]
    ]
    log = decanter(tmp_path, "audit", "--last", "3", "--json")
    assert log.exit_code == 0 and json.loads(log.stdout)["entries"][-1]["kind"] == "disarmed"
    assert decanter(tmp_path, "audit", "--head", "00" * 32).exit_code == 1


def test_a_plc_that_is_not_there_is_exit_code_3_and_disarming_works_all_the_same(tmp_path: Path) -> None:
    place = [*at(free_port()), "--set", "timeout=0.2"]
    assert decanter(tmp_path, "arm", "--reason", "x", "--minutes", "5", *place).exit_code == 0
    gone = decanter(tmp_path, "test", "heartbeat", *place)
    assert gone.exit_code == 3 and gone.stderr.count("\n") == 1
    done = decanter(tmp_path, "disarm", *place)
    assert done.exit_code == 0 and "the PLC's own timer covers it" in done.stdout
    assert verify(tmp_path / "audit.sqlite").problem == ""


def test_without_a_permit_nothing_is_written_and_the_refusal_is_kept(tmp_path: Path) -> None:
    with running("--no-permit", "--record", tmp_path / "rec.jsonl") as process:
        place = at(process.port)
        assert decanter(tmp_path, "arm", "--reason", "x", "--minutes", "5", *place).exit_code == 0
        refused = decanter(tmp_path, "test", "alarms", *place)
        assert refused.exit_code == 6 and "does not permit" in refused.stderr
    assert read_recording(tmp_path / "rec.jsonl").blocks == ()
    assert [row.entry.kind for row in read(tmp_path / "audit.sqlite")] == ["armed", "confirmed", "write refused"]


def test_a_gateway_that_runs_is_armed_and_disarmed_through_its_socket(
    plc: tuple[Process, Path], tmp_path: Path
) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text(
        f'[device]\nfile = "{DECANTER}"\nport = {plc[0].port}\nheartbeat_period = 1.0\n'
        '[scan]\nperiod = 0.1\n[writeback]\nmode = "shadow"\n'
        '[historian]\npath = "h.sqlite"\n[log]\npath = "gateway.jsonl"\n'
    )
    config = ["--config", str(plant)]
    command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(plant), "--quiet", "--stdin"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, cwd=ROOT) as gateway:
        try:
            wait_until(lambda: _writes(tmp_path) is not None)
            armed = decanter(tmp_path, "arm", "--reason", "walk", "--minutes", "5", *config, "--json")
            assert armed.exit_code == 0 and f"pid {gateway.pid}" in json.loads(armed.stdout)["told"]
            wait_until(lambda: (_writes(tmp_path) or {}).get("written", 0) > 3)
            loop = decanter(tmp_path, "test", "alarms", *config)
            assert loop.exit_code == 2 and "a gateway runs" in loop.stderr, loop.output
            done = decanter(tmp_path, "disarm", *config)
            assert done.exit_code == 0 and "writes no more" in done.stdout
            assert (_writes(tmp_path) or {})["mode"] == "shadow"
        finally:
            gateway.terminate()
            gateway.wait(PATIENCE_S)
    rows = [row.entry for row in read(tmp_path / "audit.sqlite")]
    # What a busy machine is too late for is held back, and that is on record too.
    late = [row for row in rows if row.kind == "write refused" and re.search(HELD_BACK, row.reason)]
    kinds = [row.kind for row in rows if row not in late]
    assert kinds[0] == "armed" and kinds[-1] == "disarmed", rows
    assert set(kinds) == {"armed", "confirmed", "write", "disarmed"}, [(row.kind, row.reason) for row in rows]


def _writes(folder: Path) -> dict[str, Any] | None:
    line = connect(folder / "h.sock", PATIENCE_S)
    if line is None:
        return None
    try:
        found: dict[str, Any] = line.ask("status")["status"]["writeback"]
        return found
    finally:
        line.close()


def test_codegen_writes_the_text_and_the_suite_or_says_why_not(tmp_path: Path) -> None:
    out, suite = tmp_path / "st" / "block.st", tmp_path / "suite.json"
    done = decanter(
        tmp_path, "codegen", "--out", str(out), "--suite", str(suite), "--location", "%QW", "--name", "Gate"
    )
    assert done.exit_code == 0 and "AT %QW400" in out.read_text() and "FUNCTION_BLOCK GATE\n" in out.read_text()
    assert len(json.loads(suite.read_text())["steps"]) > 80
    alone = decanter(tmp_path, "codegen", "--no-program")
    assert alone.exit_code == 0 and "END_PROGRAM" not in alone.stdout and "END_FUNCTION_BLOCK" in alone.stdout
    wrong = decanter(tmp_path, "codegen", "--location", "somewhere")
    assert wrong.exit_code == 2 and "no prefix of a location" in wrong.stderr
    assert decanter(tmp_path, "codegen", "--device", str(tmp_path / "none.toml")).exit_code == 2
