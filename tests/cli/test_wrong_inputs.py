"""What a user gives by mistake where a file is asked for: one sentence, the true reason, and what would be right."""

from pathlib import Path

import pytest

from tests.cli.support import decanter, refused

ADDRESS = "127.0.0.1:502"
COLUMNS = "x.csv: line 1: there is no column"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("plc", "read", "--config", ADDRESS), f"{ADDRESS}: is an address and no file; give the path of an existing"),
        (
            ("plc", "read", "--device", "plc-1:502"),
            "plc-1:502: is an address and no file; give the path of an existing",
        ),
        (("run", "--config", "[fd00::1]:502"), "[fd00::1]:502: is an address and no file; give the path"),
        (("run", "--config", "none.toml"), "none.toml: there is no such file; give the path of an existing TOML file"),
        (("run", "--config", "C:/plant.toml"), "C:/plant.toml: there is no such file"),
        (
            ("plc", "bind", "tag"),
            "plant.toml: has neither device.file nor a [[device.links]] table with a file; add it",
        ),
        (("model", "show", "x.csv"), "x.csv:1: is no JSON (Expecting value at column 1); give the file that was meant"),
        (("model", "show", "half.json"), "half.json:1: is no JSON (Expecting value at column 7); correct that place"),
        (("model", "judge", "proof", "empty.csv"), "(Expecting value at column 1); give the file that was meant"),
        (("trace", "show", "x.csv", "none*.csv"), "(and 1 more that gives no trace)"),
        (("trace", "show", "x.csv", "none*.csv", "empty.csv"), "(and 2 more that give no trace)"),
        (("trace", "show", "x.csv"), COLUMNS),
    ],
)
def test_what_was_given_in_place_of_a_file_is_called_that(
    words: tuple[str, ...], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (
        ("x.csv", "a,b\n1,2\n"),
        ("empty.csv", ""),
        ("half.json", '{"a": '),
        ("plant.toml", "[device]\n"),
    ):
        Path(name).write_text(text, encoding="utf-8")
    refused(decanter(*words), 2, sentence)


def test_a_disarming_that_fails_does_not_say_that_it_was_done(tmp_path: Path) -> None:
    result = decanter("disarm", "--config", tmp_path / "none.toml", "--by", "Ada")
    assert result.exit_code == 2 and "there is no such file" in result.stderr
    assert "is disarmed" not in result.output
