"""A model was learned, for minutes, before its name or its folder was refused."""

from pathlib import Path

import pytest

from gateway.lab.learning import learn
from tests.cli.support import decanter, refused


@pytest.mark.parametrize(("out", "name"), [("m", "a/b"), ("taken", "plant"), ("file", "plant")])
def test_a_name_or_a_folder_that_cannot_be_written_is_refused_before_anything_is_learned(
    out: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learn, "load_with_report", lambda *_: pytest.fail("it began to work"))
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "letter.txt").write_text("hello", encoding="utf-8")
    (tmp_path / "file").write_text("hello", encoding="utf-8")
    wrong = name if "/" in name else out
    refused(decanter("model", "learn", "--traces", "cd1.csv", "--name", name, "--out", tmp_path / out), 2, wrong)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "taken"]
