"""A way back that was killed half-way left files of two configurations, and a restored gateway files of two times.

The program is killed at each call by which it changes the disk, one after the other: what it does behind that call does
not happen, whatever its own cleaning up had in mind. Whoever reads the plant file next finds all files of one version,
and the same command does its work then. A way back that was refused gave the plant file another time of change, so
that its arming counted as saved anew.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.settings import ConfigError
from gateway.cli.main import main
from gateway.plant.configurations import keep_configuration
from gateway.replacement import journal_of, settle
from gateway.settings import load_plant
from gateway.store import AuditEntry, load_or_make_key, open_audit
from tests.gateway.support import MAP
from tests.rig.memory import folder_in_memory

CHANGES = ("open", "write", "fsync", "rename", "replace", "link", "unlink", "rmdir", "mkdir", "chmod", "chown", "utime")
"""Functions of `os` by which files are changed; reading by `open` is left out."""
MOST_STEPS = 500
AGAIN = 4
"""Behind each so many steps the command is given a second time."""


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Path]:
    """A folder whose files need not wait for the disk."""
    with folder_in_memory(tmp_path) as folder:
        yield folder


class Killed(BaseException):
    """The program is no more."""


@contextmanager
def killed_at(step: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """From the call `step` on no change of the disk is done any more; gives how many were asked for."""
    asked = [0]

    def instead(change: Callable[..., object], name: str) -> Callable[..., object]:
        def call(*given: object, **named: object) -> object:
            if name == "open" and not isinstance(given[1], int | None):
                return change(*given, **named)
            if name == "open" and not int(str(given[1])) & (os.O_CREAT | os.O_WRONLY | os.O_RDWR):
                return change(*given, **named)
            asked[0] += 1
            if asked[0] > step:
                raise Killed
            return change(*given, **named)

        return call

    with monkeypatch.context() as patched:
        for name in CHANGES:
            patched.setattr(os, name, instead(getattr(os, name), name))
        yield asked


def typed(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, list(words))
    assert not isinstance(done.exception, Killed) or not done.output
    if isinstance(done.exception, Killed):
        raise done.exception
    return done.exit_code, done.output


def plant_in(folder: Path, limit: float, more: str = "") -> Path:
    """A plant with a device file of its own, both of this version."""
    (folder / "devices").mkdir(parents=True, exist_ok=True)
    text = MAP.read_text(encoding="utf-8")
    (folder / "devices/plc.toml").write_text(f"{text}\n# {limit}\n", encoding="utf-8")
    plant = folder / "plant.toml"
    text = f'[device]\nfile = "devices/plc.toml"\n[historian]\npath = "out/h.sqlite"\n[alarms]\nlimit = {limit}\n{more}'
    plant.write_text(text, encoding="utf-8")
    return plant


def versions(plant: Path) -> dict[str, float]:
    """Of which version each file is."""
    device = plant.parent / "devices/plc.toml"
    return {
        "plant": load_plant(plant)[0].alarms.limit,
        "device": float(device.read_text(encoding="utf-8").splitlines()[-1].removeprefix("# ")),
    }


def litter(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*") if path.is_file()]


def test_after_a_kill_at_any_step_of_the_way_back_all_files_are_of_one_version(
    memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = plant_in(memory / "begun", 80.0)
    keep_configuration(load_plant(begun), now=1_700_000_000.0, note="start")
    plant_in(begun.parent, 75.0)
    seen = set[float]()
    for step in range(MOST_STEPS):
        shutil.copytree(begun.parent, memory / "aside")
        words = ("config", "rollback", "1", "--reason", "too low", "--by", "Ada", "--config", str(begun))
        killed = False
        try:
            with killed_at(step, monkeypatch) as asked:
                code, printed = typed(*words)
        except Killed:
            killed = True
        found = versions(begun)
        assert len(set(found.values())) == 1, f"killed at step {step}: {found}"
        seen.add(found["plant"])
        if not killed:
            assert code == 0, printed
        assert not journal_of(begun).exists()
        if not killed or step % AGAIN == 0:
            code, printed = typed(*words)
            assert code == 0, f"killed at step {step}: {printed}"
            assert set(versions(begun).values()) == {80.0}
        shutil.rmtree(begun.parent)
        (memory / "aside").rename(begun.parent)
        if not killed:
            break
    assert not killed and asked[0] == step and seen == {75.0, 80.0}


def test_after_a_kill_at_any_step_of_a_restoration_all_files_are_of_one_time(
    memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, runner = plant_in(memory / "plant", 80.0), CliRunner()
    config = load_plant(plant)[0]
    load_or_make_key(config.audit_key)

    def record(who: str) -> None:
        audit = open_audit(config.audit)
        assert audit.record(AuditEntry(0.0, "test", who))
        audit.close()

    record("before")
    kept = memory / "kept"
    assert runner.invoke(main, ["backup", str(kept), "--config", str(plant)]).exit_code == 0
    record("after")
    plant_in(plant.parent, 75.0)
    (plant.parent / "devices/plc.toml").chmod(0o600)
    words = ("restore", str(kept), "--overwrite", "--by", "Ada")
    names = [path.relative_to(plant.parent) for path in plant.parent.rglob("*") if path.is_file()]
    before: Mapping[Path, bytes] = {name: (plant.parent / name).read_bytes() for name in names}
    seen = set[float]()
    for step in range(MOST_STEPS):
        shutil.copytree(plant.parent, memory / "aside", copy_function=shutil.copy2)
        killed = False
        try:
            with killed_at(step, monkeypatch):
                code, printed = typed(*words)
        except Killed:
            killed = True
        found = versions(plant)
        assert len(set(found.values())) == 1, f"killed at step {step}: {found}"
        if found["plant"] == 75.0:
            for name, data in before.items():
                if name.suffix != ".sqlite-shm":
                    assert (plant.parent / name).read_bytes() == data, f"killed at step {step}: {name}"
        seen.add(found["plant"])
        if not killed:
            assert code == 0, printed
        if not killed or step % AGAIN == 0:
            code, printed = typed(*words)
            assert code == 0 and set(versions(plant).values()) == {80.0}, f"killed at step {step}: {printed}"
        shutil.rmtree(plant.parent)
        (memory / "aside").rename(plant.parent)
        if not killed:
            break
    assert not killed and seen == {75.0, 80.0}


def test_a_way_back_that_is_refused_leaves_the_plant_file_as_it_was_saved(tmp_path: Path) -> None:
    plant = plant_in(tmp_path, 80.0, '[model]\npath = "model.json"\n')
    (tmp_path / "model.json").write_text("{}", encoding="utf-8")
    keep_configuration(load_plant(plant), now=1_700_000_000.0, note="start")
    (tmp_path / "model.json").unlink()
    plant_in(tmp_path, 75.0)
    plant.chmod(0o600)
    os.utime(plant, ns=(10**18, 10**18))
    before = plant.stat()
    code, printed = typed("config", "rollback", "1", "--reason", "x", "--by", "Ada", "--config", str(plant))
    assert code == 2 and "nothing is changed" in printed
    after = plant.stat()
    assert (after.st_ino, after.st_mtime_ns, after.st_mode) == (before.st_ino, before.st_mtime_ns, before.st_mode)
    assert versions(plant) == {"plant": 75.0, "device": 75.0}
    assert not [name for name in litter(tmp_path) if not name.endswith(".lock")]


def test_a_journal_of_somebody_else_is_not_carried_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant = plant_in(tmp_path, 80.0)
    mine = tmp_path / "mine"
    mine.write_text("mine", encoding="utf-8")
    journal = journal_of(plant)
    journal.write_text(f'{{"aside": [], "drafts": [["{mine}", "{tmp_path}/none"]]}}', encoding="utf-8")
    journal.chmod(0o666)
    with pytest.raises(ConfigError, match="cannot be put back"):
        load_plant(plant)
    journal.chmod(0o644)
    monkeypatch.setattr(os, "geteuid", lambda: journal.stat().st_uid + 1)
    if journal.stat().st_uid:
        with pytest.raises(ConfigError, match="of user"):
            load_plant(plant)
    assert mine.exists()
    monkeypatch.undo()
    settle(plant)
    assert not mine.exists() and not journal.exists()
