"""From a wheel, `decanter run` without `--config` took a file inside site-packages and put its historian there."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.console import config_dir, find_plant_file

COMMANDS = (["run"], ["status", "--json"], ["top"], ["backup", "copy"])


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_without_a_plant_file_a_command_says_one_sentence_and_touches_nothing(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = sorted(config_dir().parent.iterdir())
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2, result.output
    (sentence,) = result.stderr.splitlines()
    if "--json" in words:
        assert json.loads(result.stdout)["reason"] in sentence
    assert "decanter init" in sentence and "./plant.toml" in sentence and "./config/plant.toml" in sentence
    assert not list(tmp_path.iterdir()) and sorted(config_dir().parent.iterdir()) == shipped


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_needs_no_plant_file(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, [*words, "--help"])
    assert result.exit_code == 0 and "./plant.toml" in result.output


def test_the_file_of_the_folder_is_taken_before_that_of_its_config_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="decanter init"):
        find_plant_file()
    (tmp_path / "plant.toml").mkdir()  # a folder of that name is no plant file
    (tmp_path / "config").mkdir()
    (tmp_path / "config/plant.toml").write_text("zzz = 1\n", encoding="utf-8")
    assert find_plant_file() == Path("config/plant.toml")
    result = CliRunner().invoke(main, ["run"])
    assert result.exit_code == 2 and "config/plant.toml" in result.output and "zzz" in result.output
    (tmp_path / "plant.toml").rmdir()
    (tmp_path / "plant.toml").write_text("yyy = 1\n", encoding="utf-8")
    assert find_plant_file() == Path("plant.toml")
    result = CliRunner().invoke(main, ["run"])
    assert result.exit_code == 2 and "yyy" in result.output and not (tmp_path / "out").exists()
