"""Every command answers wrong input with one sentence and its exit code, and --json with one strict object."""

import ast
import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from drivers.errors import (
    AddressError,
    DeviceException,
    DriverError,
    LinkDown,
    ReplyMismatch,
    ReplyTimeout,
    WriteForbidden,
    WriteUnverified,
)
from drivers.settings import ConfigError
from gateway.cli.main import COMMANDS, main
from gateway.cli.model import COMMANDS as MODEL_COMMANDS
from gateway.cli.trace import trace
from gateway.entry.exits import Exit, exit_code, sentence, sentences
from gateway.entry.lazy import LazyGroup
from gateway.store.historian import HistorianError
from sim.files import ArtefactError
from sim.lab.recordings.load_report import TraceError
from sim.plc.program.replay import read_trace
from sim.strict_json import json_text
from tests.cli.artefact_set import files, written
from tests.cli.support import ROOT, decanter, misused, only_object, refused
from tests.gateway.support import plant_file
from tests.plc.bench import running

GATEWAY = (sys.executable, "-m", "gateway.cli.main")
EVERY = [[], *([name] for name in COMMANDS), ["trace", "show"], ["trace", "synth"]]
EVERY += [["model", name] for name in MODEL_COMMANDS]


@pytest.mark.parametrize("command", [words for words in EVERY if words != ["emulate"]], ids=" ".join)
def test_every_command_explains_itself(command: list[str]) -> None:
    for flag in ("-h", "--help"):
        result = decanter(*command, flag)
        assert result.exit_code == 0
        assert result.stdout.startswith("Usage: ")
        assert "..." not in result.stdout.partition("Commands:")[2], "a command's line is cut off"


@click.command()
def pressed() -> None:
    raise KeyboardInterrupt


def test_control_c_ends_any_command_with_a_sentence_and_its_code() -> None:
    group = LazyGroup("outer", table={"pressed": (f"{__name__}:pressed", "")})
    done = CliRunner().invoke(group, ["pressed"])
    assert (done.exit_code, done.output) == (130, "decanter: stopped before the end\n")


def test_emulate_speaks_under_its_own_name() -> None:
    done = subprocess.run([*GATEWAY, "emulate", "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stdout.startswith("Usage: decanter emulate ")


def test_emulate_plays_an_export_of_ones_own_by_its_column_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [f"01.03.2026 08:{row:02d}:00;{row + 40},5;{'EIN' if row % 2 else 'AUS'}" for row in (2, 1, 0)]
    export, column_map = tmp_path / "export.csv", tmp_path / "columns.toml"
    export.write_text("\n".join(["Zeit;Lager °C;läuft", *rows]), encoding="cp1252")
    column_map.write_text(
        'format = "wide"\nseparator = ";"\ndecimal = ","\ntemperature = "T"\n'
        '[clock]\ncolumn = "Zeit"\nformats = ["%d.%m.%Y %H:%M:%S"]\ntimezone = "UTC"\n'
        '[signals]\nT = { column = "Lager °C", unit = "degC" }\nOn = { column = "läuft", boolean = true }\n',
        encoding="utf-8",
    )
    called: list[list[str]] = []
    monkeypatch.setattr("gateway.cli.setup.emulate.os.execv", lambda _, words: called.append(words))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    assert decanter("emulate", "--trace", export, "--columns", column_map, "--port", 0).exit_code == 0
    ((*_, option, path, port, number),) = called
    assert (option, port, number) == ("--trace", "--port", "0")
    assert list((tmp_path / "temporary").iterdir()) == [] and os.get_inheritable(int(Path(path).name))
    table = read_trace(Path(path))
    os.close(int(Path(path).name))
    assert {name: list(column) for name, column in table.columns.items()} == {"T": [40.5, 41.5, 42.5], "On": [0, 1, 0]}
    refused(decanter("emulate", "--columns", column_map), 2, "give --trace FILE, too")


def test_emulate_refuses_a_wrong_map_in_one_sentence(wrong: Path) -> None:
    done = subprocess.run(
        [*GATEWAY, "emulate", "--device", str(wrong / "none.toml")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "none.toml: there is no such file" in done.stderr and done.stderr.count("\n") == 1


def test_an_option_that_is_the_same_in_two_commands_is_declared_once() -> None:
    places = defaultdict(list)
    for path in sorted((ROOT / "gateway").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "click.option":
                places[ast.unparse(node)].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert places and {option: found for option, found in places.items() if len(found) > 1} == {}


def test_unknown_words_are_refused() -> None:
    misused(decanter("bogus"), "No such command 'bogus'")
    misused(decanter("trace", "bogus"), "No such command 'bogus'")
    misused(decanter("plc", "check", "--bogus"), "No such option")
    misused(decanter("trace", "synth"), "name scenarios")
    misused(decanter("demo", "--seconds", "nan"), "no finite number")
    misused(decanter("demo", "--limit", "nan"), "no finite number")


# ------------------------------------------------------------------ traces


def test_trace_synth_writes_what_it_says_and_says_that_it_is_synthetic(tmp_path: Path) -> None:
    data = only_object(decanter("trace", "synth", "cd1", "--out", tmp_path / "new" / "folder", "--json").stdout)
    (row,) = data["traces"]
    assert data["synthetic"] is True and row["synthetic"] is True
    lines = Path(row["file"]).read_text(encoding="utf-8").splitlines()
    assert any(line.startswith("# SYNTHETIC") for line in lines[:2])
    assert row["rows"] == sum(not line.startswith(("#", "time")) for line in lines) == 401


def test_trace_show_reads_back_what_synth_wrote(traces: Path) -> None:
    data = only_object(decanter("trace", "show", traces / "cd1.csv", "--json").stdout)
    assert [row["rows"] for row in data["traces"]] == [401]
    assert data["report"][0]["used"] == 401 and data["picture"] is None
    text = decanter("trace", "show", traces)
    assert text.exit_code == 0 and "cd17" in text.stdout and "SYNTHETIC" not in text.stderr


def test_trace_commands_refuse_wrong_files_in_one_sentence(wrong: Path, traces: Path) -> None:
    refused(decanter("trace", "synth", "cd99", "--out", wrong / "out"), 2, "cd99", "cd17")
    refused(decanter("trace", "synth", "cd1", "--out", wrong / "empty"), 2, "empty", "no folder can be made")
    refused(decanter("trace", "synth", "cd1", "--out", wrong / "empty" / "x"), 2, "no folder can be made")
    refused(decanter("trace", "show", wrong / "none.csv"), 2, "none.csv")
    refused(decanter("trace", "show", wrong / "empty"), 2, "empty")
    refused(decanter("trace", "show", wrong / "garbage"), 2, "garbage")
    said = refused(decanter("trace", "show", wrong / "folder"), 2, "there is no CSV file")
    assert "[" not in said
    refused(decanter("trace", "show", wrong / "cold.csv"), 2, "cold.csv", "TCuscinettiRiduttore")
    for name in ("nomap", wrong / "garbage", wrong / "folder", wrong / "none.toml"):
        refused(decanter("trace", "show", traces / "cd1.csv", "--map", name), 2, str(name))


def test_a_picture_is_drawn_where_asked_and_a_wrong_name_is_refused_before_any_work(
    traces: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "deep" / "cd1.png"
    data = only_object(decanter("trace", "show", traces / "cd1.csv", "--picture", picture, "--json").stdout)
    assert data["picture"] == str(picture) and picture.stat().st_size > 10_000
    for name in ("x.docx", "x"):
        misused(decanter("trace", "show", traces / "cd1.csv", "--picture", tmp_path / name), "is no picture")
    (tmp_path / "file").touch()
    refused(decanter("trace", "show", traces / "cd1.csv", "--picture", tmp_path / "file" / "x.png"), 2, "file")


# ------------------------------------------------------------------ models


def test_a_model_is_learned_shown_and_simulated(model: Path, traces: Path, tmp_path: Path) -> None:
    shown = only_object(decanter("model", "show", model, "--json").stdout)
    assert re.fullmatch("[0-9a-f]{64}", shown["hash"]) and shown["provenance"]["synthetic"] is True
    assert "SYNTHETIC" in decanter("model", "show", model).stdout
    picture = tmp_path / "sim.png"
    arguments = ["model", "simulate", model, "--trace", traces / "cd17.csv", "--runs", 50, "--picture", picture]
    said = decanter(*arguments, "--json").stdout
    (row,) = only_object(said)["traces"]
    assert 0 < row["mae"] <= row["rmse"] < 20 and 0 <= row["coverage 90 %"] <= 1
    assert picture.stat().st_size > 10_000
    assert decanter(*arguments, "--json").stdout == said


def test_model_commands_refuse_wrong_input_in_one_sentence(wrong: Path, model: Path, traces: Path) -> None:
    for name in ("none", "empty", "garbage", "folder"):
        refused(decanter("model", "show", wrong / name), 2, name)
        refused(decanter("model", "simulate", wrong / name, "--trace", traces / "cd1.csv"), 2, name)
    refused(decanter("model", "learn", "--traces", wrong / "cold.csv", "--out", wrong / "m"), 2, "cold.csv")
    refused(decanter("model", "learn", "--traces", traces / "cd1.csv", "--out", wrong / "empty"), 2, "empty")
    arguments = ["model", "learn", "--traces", traces / "cd1.csv", "--out", wrong / "m"]
    refused(decanter(*arguments, "--name", "a/b"), 2, "a/b")
    assert not (wrong / "m").exists()


# ------------------------------------------------------------------ check and run


def test_check_accepts_the_shipped_configuration_as_one_object() -> None:
    data = only_object(decanter("plc", "check", "--offline", "--json").stdout)
    assert data["ok"] is True and data["readings"] == [] and data["tags"] > 10


def test_check_prints_the_requests_of_a_scan() -> None:
    steps = only_object(decanter("plc", "check", "--offline", "--json").stdout)["steps"]
    assert any(step["step"] == "places" and "requests for" in step["sentence"] for step in steps), steps


def test_check_names_the_file_and_the_key_of_a_wrong_configuration(wrong: Path) -> None:
    refused(decanter("plc", "check", "--config", wrong / "none.toml"), 2, "none.toml")
    refused(decanter("plc", "check", "--config", wrong / "empty"), 2, "empty", "device")
    refused(decanter("plc", "check", "--config", wrong / "garbage"), 2, "garbage")
    refused(decanter("plc", "check", "--config", wrong / "folder"), 2, "folder")
    refused(decanter("plc", "check", "--config", plant_file(wrong, "prt = 1")), 2, "plant.toml", "prt")
    refused(decanter("run", "--config", wrong / "none.toml"), 2, "none.toml")


@pytest.mark.parametrize("clock", ["1,2", "1,2,x", "1,2,-3", "1,2,0", "nan,2,3", "1,inf,3", "1,2,nan"])
def test_run_refuses_a_clock_that_is_none(clock: str) -> None:
    misused(decanter("run", "--clock", clock), "EPOCH,MONOTONIC,SPEED")


def test_check_reads_every_tag_of_a_running_plc_and_says_when_there_is_none(tmp_path: Path, traces: Path) -> None:
    with running("--trace", traces / "cd1.csv") as plc:
        port = plc.port
        result = decanter("plc", "check", "--config", ROOT / "config/plant.toml", "--port", port, "--json")
        data = only_object(result.stdout)
        assert {row["tag"] for row in data["readings"]} >= {"TCuscinettiRiduttore", "PlcHeartbeat"}
        assert data["ok"] and result.exit_code == 0, data["steps"]
        assert all(row["quality"] == "GOOD" for row in data["readings"]), data["readings"]
    gone = decanter("plc", "check", "--config", ROOT / "config/plant.toml", "--port", port, "--json")
    assert gone.exit_code == 3
    assert only_object(gone.stdout)["ok"] is False
    said = decanter("plc", "check", "--config", ROOT / "config/plant.toml", "--port", port)
    assert said.exit_code == 3 and said.stderr.startswith("decanter: ") and "--host HOST:PORT" in said.stderr
    assert said.stderr.count(f"127.0.0.1:{port}") == said.stderr.count("\n") == 1


def test_run_stops_when_its_standard_input_ends_and_leaves_the_historian_whole(tmp_path: Path) -> None:
    with subprocess.Popen(
        [
            *GATEWAY,
            "run",
            "--stdin",
            "--port",
            "1",
            "--config",
            plant_file(tmp_path),
            "--status",
            tmp_path / "status.json",
        ],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stderr is not None and process.stdin is not None
        assert b"does not answer yet" in process.stderr.readline()
        process.stdin.close()
        process.stderr.read()
        assert process.wait(120) == 0
    assert json.loads((tmp_path / "status.json").read_text(encoding="utf-8"))["phase"] == "stopped"


# ------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (LinkDown("refused"), 3),
        (ReplyMismatch("unit 2"), 3),
        (WriteUnverified("reads 3"), 3),
        (DriverError("something"), 3),
        (DeviceException(2, "illegal address"), 4),
        (ReplyTimeout("0.5 s"), 5),
        (WriteForbidden("holding:3"), 6),
        (AddressError("coil"), 2),
        (HistorianError("x: is no historian"), 2),
        (ConfigError(["x: key: reason"]), 2),
        (ArtefactError("x: is no model"), 2),
        (TraceError("x: is no trace", None), 2),
        (FileNotFoundError(2, "No such file or directory", "x.csv"), 2),
    ],
    ids=lambda one: type(one).__name__ if isinstance(one, Exception) else None,
)
def test_every_error_of_the_rooms_is_a_sentence_with_its_code(
    error: Exception, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left, sentences():
        raise error
    assert left.value.code == code == exit_code(error)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"decanter: {sentence(error)}\n"


def test_what_the_system_says_becomes_file_reason_remedy() -> None:
    said = sentence(PermissionError(13, "Permission denied", "/x/y"))
    assert said == "/x/y: permission denied; give a path that is there and that this user may read or write"


@pytest.mark.parametrize("defect", [KeyError("x"), TypeError("x"), AttributeError("x"), IndexError("x")])
def test_a_defect_is_never_hidden_behind_a_sentence(defect: Exception) -> None:
    with pytest.raises(type(defect)), sentences():
        raise defect


def test_traceback_shows_where_an_error_arose(wrong: Path) -> None:
    result = CliRunner().invoke(main, ["--traceback", "trace", "show", str(wrong / "empty")])
    assert isinstance(result.exception, TraceError)


def test_json_is_strict_whatever_the_numbers_are() -> None:
    np = pytest.importorskip("numpy")
    data = {"a": float("nan"), "b": [float("inf"), np.float64("nan"), np.int64(3)], 60.0: {"p": Path("x")}, "è": True}
    assert json.loads(json_text(data)) == {"a": None, "b": [None, None, 3], "60.0": {"p": "x"}, "è": True}


def test_exit_codes_are_stable() -> None:
    assert [int(code) for code in Exit] == [0, 1, 2, 3, 4, 5, 6, 130]


def test_the_table_of_commands_names_commands() -> None:
    assert isinstance(main.get_command(click.Context(main), "trace"), type(trace))
    assert all(main.get_command(click.Context(main), name) is not None for name in COMMANDS)


def test_a_reader_that_goes_away_leaves_no_traceback(traces: Path) -> None:
    command = f"{sys.executable} -m gateway.cli.main trace show {traces / 'cd1.csv'} --json | true"
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False, cwd=ROOT, env={**os.environ}
    )
    assert "Traceback" not in done.stderr


def test_artefacts_are_shown_with_their_structure_also_when_they_cannot_be_run(tmp_path: Path) -> None:
    name = str(written(tmp_path, files()))
    shown = json.loads(decanter("model", "show", name, "--json").stdout)
    assert [row["location"] for row in shown["locations"]] == ["q_0", "q_1", "__init__"]
    assert shown["runnable"]
    (tmp_path / "flow_conditions.txt").unlink()
    shown = json.loads(decanter("model", "show", name, "--json").stdout)
    assert len(shown["edges"]) == 12
    assert not shown["runnable"]
    assert "no flow_conditions.txt" in shown["refusal"]
    assert "it cannot be run" in decanter("model", "show", name).stdout
