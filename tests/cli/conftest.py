"""Files that are made once for all tests of the command line: a synthetic trace and a model learned from one."""

import fcntl
import os
from pathlib import Path

import pytest

from tests.cli.support import decanter
from tests.rig.no_bands import without_bands


@pytest.fixture(scope="session")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with cd1.csv and cd17.csv."""
    folder = tmp_path_factory.mktemp("traces")
    assert decanter("trace", "synth", "cd1", "cd17", "--out", folder).exit_code == 0
    return folder


@pytest.fixture(scope="session")
def model(tmp_path_factory: pytest.TempPathFactory, traces: Path) -> Path:
    """A model directory, learned from cd17 by the first of pytest's processes that needs it, for all of them.

    It has no bands: what the commands make of a model's calibration is asked where it is the question.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "learned_for_the_commands" / "model"
    folder.parent.mkdir(exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            arguments = ("--traces", traces / "cd17.csv", "--out", folder)
            with pytest.MonkeyPatch.context() as patch:
                without_bands(patch)
                assert decanter("model", "learn", *arguments).exit_code == 0
    return folder


@pytest.fixture
def wrong(tmp_path: Path) -> Path:
    """A folder with files that are none of what commands want."""
    (tmp_path / "empty").touch()
    (tmp_path / "garbage").write_bytes(b"\xff\xfe\x00\x80" * 500)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "note.txt").write_text("hello", encoding="utf-8")
    (tmp_path / "cold.csv").write_text("time,MarciaDecanter,Assorbimento\n0,1,10\n1,1,12\n", encoding="utf-8")
    return tmp_path


@pytest.fixture(autouse=True)
def records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commissioning commands append to a file of this test, not to out/ of the project."""
    monkeypatch.setenv("DECANTER_RECORDS", str(tmp_path / "records" / "commissioning.jsonl"))
