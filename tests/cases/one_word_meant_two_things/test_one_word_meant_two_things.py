"""Old names answer, errors are one sentence (with --json one object), and what is printed fits any terminal."""

import io
import json
import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commission.options import SharedOption
from gateway.commission.session import make_target
from gateway.console import table
from gateway.console.output import bands
from gateway.entry.lazy import LazyGroup
from gateway.entry.plain import write_plainly
from sim.plc.__main__ import main as emulator
from tests.cli.support import Tree, command_paths, decanter, misused, only_object, refused

OLD = {
    "check --connect": "decanter plc check",
    "plc write plan": "decanter plc check plan --write",
    "plc loop alarms --ask": "decanter plc check write alarms",
    "plc loop heartbeat": "decanter plc check write heartbeat",
    "plc conformance --host x": "decanter plc check write conformance",
    "model verify x --json": "decanter model judge proof",
    "plc scan units --units 1-3": "decanter plc scan units 1-32",
}


@pytest.mark.parametrize("words", OLD)
def test_an_old_name_runs_nothing_and_says_the_new_one(words: str) -> None:
    done = decanter(*words.split())
    assert done.exit_code == 2 and OLD[words] in done.stderr and done.stderr.count("\n") == 1
    if "--json" in words:
        assert only_object(done.stdout) == {"ok": False, "exit": 2, "reason": done.stderr.strip()[len("decanter: ") :]}


def test_the_emulators_register_map_is_a_device_file_as_everywhere() -> None:
    done = CliRunner().invoke(emulator, ["--map", "x.toml"])
    assert done.exit_code == 2 and "--device x.toml" in done.stderr
    assert CliRunner().invoke(emulator, ["-h"]).exit_code == 0


@pytest.mark.parametrize(
    "words",
    ["bogus", "plc bogus", "plc scan", "plc scan bogus", "plc check --bogus", "plc probe --port x", "model show"],
)
def test_errors_are_one_object_under_json_and_one_sentence_besides(words: str) -> None:
    data = only_object(decanter(*words.split(), "--json").stdout)
    assert data["ok"] is False and data["exit"] == 2
    misused(decanter(*words.split()), data["reason"].partition(";")[0].removesuffix(" ").replace("'--json'", ""))


def test_an_error_that_the_work_meets_is_one_object_too(tmp_path: Path) -> None:
    for words in (["model", "show", tmp_path / "none"], ["trace", "show", tmp_path / "none.csv"]):
        data = only_object(decanter(*words, "--json").stdout)
        assert data["ok"] is False and data["reason"] in refused(decanter(*words), 2)


def test_a_terminal_without_the_signs_gets_what_it_can_show() -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)
    write_plainly(stream)
    stream.write("80 °C ± 1 – è…日")
    assert stream.buffer.getvalue() == b"80 degC +- 1 - e...?"  # type: ignore[attr-defined]


def test_json_is_whole_where_the_terminal_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    done = CliRunner(charset="ascii").invoke(main, ["trace", "show", "§.csv", "--json"])
    assert "§.csv" in json.loads(done.stdout_bytes.decode("ascii"))["reason"]


NUMBERS = (0.000123, 1.5e-07, 12.25, 100.5, 0.875)
ROW = (
    "cd1",
    *NUMBERS,
    "a sentence that is too long for what is left of the line",
    "/a/path/without/any/gap/at/all.csv",
)


@pytest.mark.parametrize("width", [24, 40, 80, 200])
def test_a_table_keeps_to_the_width_and_cuts_no_digit(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    table("results", ("trace", "low", "p", "mean error", "worst", "share", "what is said", "file"), [ROW, ROW])
    shown = capsys.readouterr().out
    assert all(len(line) <= max(width, 34) for line in shown.splitlines())
    words = shown.split()
    assert all(words.count(f"{number:.4g}") == 2 for number in NUMBERS) and "sentence" in words and "…" not in shown


def test_no_column_is_lost_and_the_first_leads_every_table() -> None:
    assert bands([5, 10, 10, 10], 20) == [[0, 1], [0, 2], [0, 3]]
    assert bands([5, 10, 10, 10], 80) == [[0, 1, 2, 3]]
    assert bands([], 10) == [] and bands([50, 60], 10) == [[0, 1]]


def test_certificates_name_the_link_whatever_the_file_says(tmp_path: Path) -> None:
    device = tmp_path / "device.toml"
    device.write_text(
        '[device]\nname = "p"\ndriver = "modbus"\ntransport = "tcp"\nhost = "h"\n'
        '[[tags]]\nname = "T"\naddress = "holding:0"\ndtype = "uint16"\n',
        encoding="utf-8",
    )
    assert make_target(device=device, given={"certificates": "c"}).kind == "modbus-tls"
    assert make_target(given={"host": "h", "certificates": "c"}).kind == "modbus-tls"


def test_the_tree_of_commands_fits_on_a_screen_with_every_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    shown = decanter("--help").stdout
    assert len(shown.splitlines()) <= 40 and max(map(len, shown.splitlines())) <= 80
    assert all(words[-1] in shown for words, group in command_paths() if isinstance(group, LazyGroup))
    assert "import, check, served, codegen" in " ".join(shown.split())


@pytest.mark.parametrize(
    ("words", "group"), list(command_paths()), ids=lambda each: " ".join(each) if isinstance(each, tuple) else ""
)
def test_every_command_has_one_example_that_it_takes(words: tuple[str, ...], group: Tree) -> None:
    example = shlex.split(group.examples[words[-1]])
    assert tuple(example[: len(words)]) == words
    command = group.get_command(click.Context(group), words[-1])
    assert command is not None
    if words == ("emulate",):
        command = emulator
    # A command keeps the help option of the first context that it is in.
    root = click.Context(main, **main.context_settings)
    command.make_context(words[-1], example[len(words) :], parent=root)
    with click.Context(command, info_name=words[-1], parent=root) as context:
        shown = command.get_help(context)
    if command is not emulator:
        assert shown.count("Example:") == 1 and f"decanter {group.examples[words[-1]]}" in shown
    listed = [option for option in command.params if isinstance(option, SharedOption)]
    assert all(option.get_help_record(context) is None for option in listed)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed_or_installed(shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    printed = decanter("completion", shell).stdout
    assert "_DECANTER_COMPLETE" in printed
    said = decanter("completion", shell, "--install").stdout
    assert Path(said.partition(" is written")[0]).read_text(encoding="utf-8").strip() == printed.strip()
    monkeypatch.setenv("SHELL", "/bin/tcsh")
    refused(decanter("completion"), 2, "tcsh")


def test_a_group_without_a_command_shows_its_help() -> None:
    assert decanter("plc").exit_code == 2 and "--host" in decanter("plc", "--help").stdout
