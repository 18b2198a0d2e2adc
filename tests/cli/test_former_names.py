"""A command's name of the last release does what it did, is in no help and no completion, and says the new one once."""

import shlex
from pathlib import Path

import click
import pytest

from benchmarks.words import measure
from gateway.cli.former import FORMER
from gateway.cli.main import main
from gateway.cli.plant.plant_file import load
from gateway.entry import LazyGroup
from tests.cli.support import ROOT, decanter, find_command, only_object, refused

CONTEXT = click.Context(main, info_name="decanter")
WHOLE = {old: now for old, now in FORMER.items() if old != "config"} | {
    f"config {word}": f"keep {word}" for word in ("history", "diff", "rollback")
}
"""Every command that had another name, by its former words."""


@pytest.mark.parametrize("old", WHOLE)
def test_a_former_name_is_the_command_and_says_its_new_name(old: str) -> None:
    now = WHOLE[old]
    shown = decanter(*old.split(), "--help")
    hint = f"decanter: `decanter {old}` is now `decanter {now} --help`\n"
    if old.startswith("config"):  # its group is what has another name
        hint = f"decanter: `decanter config` is now `decanter {now} --help`\n"
    assert (shown.exit_code, shown.stderr) == (0, hint)
    assert shown.stdout == decanter(*now.split(), "--help").stdout
    words = tuple(word for word in now.split() if not word.startswith("--"))
    assert find_command(words) is not None


@pytest.mark.parametrize("old", FORMER)
def test_a_former_name_is_in_no_help_and_not_completed(old: str) -> None:
    *group, name = old.split()
    command = find_command(tuple(group))
    assert isinstance(command, LazyGroup)
    context = click.Context(command, info_name=group[0] if group else "decanter", parent=CONTEXT if group else None)
    assert name not in command.list_commands(context)
    assert name not in [item.value for item in command.shell_complete(context, name[:2])]
    answering = command.get_command(context, name)
    assert answering is not None and answering.hidden


@pytest.mark.parametrize("old", FORMER)
def test_only_one_word_is_there_for_one_thing(old: str) -> None:
    with pytest.raises(KeyError):
        find_command(tuple(old.split()))


def test_a_program_reads_one_object_and_the_hint_names_to_a_person_all_that_was_given(tmp_path: Path) -> None:
    device = ROOT / "config" / "devices" / "decanter_plc.toml"
    given = ["--device", device, "--host", "127.0.0.1", "--records", tmp_path / "made here.jsonl"]
    done, now = decanter("plc", "plan", *given, "--json"), decanter("plc", "check", "plan", *given, "--json")
    assert (done.exit_code, now.exit_code, now.stderr) == (0, 0, "")
    assert only_object(done.output).keys() == only_object(now.output).keys()
    told = decanter("plc", "plan", *given)
    assert (told.exit_code, told.stdout) == (0, decanter("plc", "check", "plan", *given).stdout)
    said = told.stderr.strip()
    assert said == f"decanter: `decanter plc plan` is now `decanter plc check plan {shlex.join(map(str, given))}`"


def test_a_complaint_stays_the_one_sentence_of_its_call(tmp_path: Path) -> None:
    none = tmp_path / "none"
    said = refused(decanter("model", "prove", none), 2, "none")
    assert said == refused(decanter("model", "judge", "proof", none), 2) == refused(decanter("model", "judge", none), 2)
    said = refused(decanter("plc", "verify", "--bogus"), 2, "No such option '--bogus'")
    assert said.endswith("see `decanter plc check hmi --help`")
    answer = only_object(decanter("status", "--config", none, "--json").stdout)
    assert answer == only_object(decanter("top", "--once", "--config", none, "--json").stdout) and not answer["ok"]


def test_a_former_name_in_the_wrong_place_is_told_the_new_one() -> None:
    refused(decanter("retrain"), 2, "there is `decanter model version retrain`")
    refused(decanter("verify"), 2, "`decanter plc check hmi`")


@pytest.mark.parametrize("words", ["plc check soakk", "keep bogus", "keep --json"])
def test_a_first_word_that_names_no_work_is_refused_with_the_one_that_was_meant(words: str) -> None:
    said = refused_words(words)
    assert said.endswith(f"see `decanter {words.rpartition(' ')[0]} --help`")


def refused_words(words: str) -> str:
    result = decanter(*words.split())
    assert result.exit_code == 2
    return result.stderr.strip()


def test_a_command_of_several_works_is_completed_by_its_words_and_the_options_of_its_usual_one() -> None:
    for words, incomplete, found in (
        ("plc check", "so", ["soak"]),
        ("plc check", "--mach", ["--machine"]),
        ("model judge", "r", ["rank", "regression"]),
        ("keep", "--", []),
    ):
        command = find_command(tuple(words.split()))
        assert [item.value for item in command.shell_complete(click.Context(command), incomplete)] == found


@pytest.mark.parametrize(
    ("old", "now"),
    [
        (("--port", "1502"), ("--host", "127.0.0.1:1502")),
        (("--timeout", "0.25"), ("--set", "timeout=0.25")),
        (("--tls", "my certificates"), ("--set", "certificates=my certificates")),
        (("--tls", "2024"), ("--set", "certificates=2024")),
    ],
    ids=lambda words: " ".join(words),
)
def test_a_former_option_does_what_it_did_and_says_what_to_type(
    old: tuple[str, str], now: tuple[str, str], tmp_path: Path
) -> None:
    device = ROOT / "config" / "devices" / "decanter_plc.toml"
    words = ["plc", "check", "plan", "--device", device, "--records", tmp_path / "r.jsonl"]
    words += [] if old[0] == "--port" else ["--host", "127.0.0.1"]
    before = decanter(*words, *(["--host", "127.0.0.1"] if old[0] == "--port" else []), *old)
    after = decanter(*words, *now)
    assert (before.exit_code, before.stdout) == (after.exit_code, after.stdout) and after.exit_code == 0
    typed = shlex.join(now).replace("127.0.0.1", "HOST").replace("'certificates=my", "certificates='my")
    assert before.stderr == f"decanter: `{shlex.join(old)}` is now `{typed}`\n" and after.stderr == ""
    assert decanter(*words, "--host", "127.0.0.1", *old, "--json").stderr == ""
    assert old[0] not in decanter("plc", "--help").stdout + decanter("plc", "check", "plan", "--help").stdout


def test_a_host_with_its_port_wins_over_the_port_of_the_plant_file(tmp_path: Path) -> None:
    made = decanter("init", tmp_path / "p", "--device", "decanter_plc", "--host", "127.0.0.1", "--set", "port=1555")
    assert made.exit_code == 0, made.output
    words = ["plc", "check", "plan", "--config", tmp_path / "p" / "plant.toml", "--records", tmp_path / "r.jsonl"]
    assert "port 1555 " in decanter(*words).stdout
    assert "port 1888 " in decanter(*words, "--host", "127.0.0.1:1888").stdout
    refused(decanter(*words, "--host", "127.0.0.1:1", "--set", "port=2"), 2, "host says port 1, and port is 2")


def test_a_machine_that_is_added_has_the_port_that_stands_with_its_host(tmp_path: Path) -> None:
    plant = tmp_path / "plant.toml"
    decanter("init", tmp_path, "--device", "decanter_plc", "--host", "127.0.0.1", "--set", "port=1555")
    assert decanter("machine", "add", "east", "--host", "127.0.0.1:1999", "--config", plant).exit_code == 0
    read = ["plc", "check", "plan", "--config", plant, "--machine", "east", "--records", tmp_path / "r.jsonl"]
    assert "port 1999 " in decanter(*read).stdout
    assert [config.links[0].settings["port"] for config in load(plant, None, None, None)] == [1555, 1999]


def test_a_host_with_its_port_replaces_both_of_the_plant_file_for_a_run(tmp_path: Path) -> None:
    decanter("init", tmp_path, "--device", "decanter_plc", "--host", "127.0.0.1", "--set", "port=1555")
    (config,) = load(tmp_path / "plant.toml", "10.0.0.7:1666", None, None)
    assert (config.links[0].settings["host"], config.links[0].settings["port"]) == ("10.0.0.7", 1666)


@pytest.mark.parametrize("group", ["alarm", "machine", "user", "historian"])
def test_a_group_with_a_usual_work_does_it_without_a_word(group: str) -> None:
    usual = "tables" if group == "historian" else "list"
    said = decanter(group)
    assert (said.exit_code, said.output) == ((said := decanter(group, usual)).exit_code, said.output)


def test_the_tree_of_commands_stays_small() -> None:
    counted = {figure.name: figure.value for figure in measure()}
    assert counted["leaf commands"] <= 41 and counted["options that commands take"] <= 540
