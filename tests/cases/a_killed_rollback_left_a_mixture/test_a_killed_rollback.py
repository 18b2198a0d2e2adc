"""A way back that was killed half-way left files of two configurations, and a restored gateway files of two times.

The program is killed at each call by which it changes the disk, one after the other: what it does behind that call does
not happen, whatever its own cleaning up had in mind. Whoever reads the plant file next finds all files of one version,
and the same command does its work then. A way back that was refused gave the plant file another time of change, so
that its arming counted as saved anew.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from queue import Queue
from threading import Event, Thread, current_thread
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.settings import ConfigError
from gateway.cli.keep import configurations as config_commands
from gateway.cli.keep.commands import rollback
from gateway.cli.main import main
from gateway.plant.configurations import KeptConfiguration, keep_configuration
from gateway.replacement import journal_path, settle
from gateway.settings import Config, config, load_plant
from gateway.store import AuditEntry, load_or_make_key, open_audit
from tests.gateway.support import MAP
from tests.rig.memory import folder_in_memory

CHANGES = (
    *("open", "write", "fsync", "rename", "replace", "link", "unlink", "rmdir", "mkdir"),
    *("chmod", "fchmod", "chown", "fchown", "utime"),
)
"""Functions of `os` by which files are changed; reading by `open` is left out."""
MOST_STEPS = 500
AGAIN = 4
"""Behind each so many steps the command is given a second time."""
MODE = 0o1644
"""Of a journal, and of no other file."""


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
        patched.setattr(os, "getpid", lambda: 0)  # the next program has another one
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
    """What was left behind; locks stay, for the next one who locks."""
    return [path.name for path in folder.rglob(".*") if path.is_file() and path.suffix != ".lock"]


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
        assert not journal_path(begun).exists()
        if not killed or step % AGAIN == 0:
            code, printed = typed(*words)
            assert code == 0, f"killed at step {step}: {printed}"
            assert set(versions(begun).values()) == {80.0}
            assert not litter(begun.parent), f"killed at step {step}"
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
    assert runner.invoke(main, ["keep", "backup", str(kept), "--config", str(plant)]).exit_code == 0
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
            assert not litter(plant.parent), f"killed at step {step}"
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
    assert not litter(tmp_path)


def test_a_journal_of_somebody_else_is_not_carried_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant = plant_in(tmp_path, 80.0)
    mine, journal = tmp_path / "mine", journal_path(plant)
    mine.write_text("mine", encoding="utf-8")
    write_journal(plant, places=[mine])
    journal.chmod(0o666)
    with pytest.raises(ConfigError, match=r"is not as a replacement .* leaves it"):
        load_plant(plant)
    journal.chmod(MODE)
    if os.geteuid() == 0:
        os.chown(journal, 65_000, -1)  # the superuser's are everybody's
    owner = journal.stat().st_uid
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(ConfigError, match=r"run `sudo -u .* decanter plc check`"):
        load_plant(plant)
    assert mine.exists()
    monkeypatch.setattr(os, "geteuid", lambda: owner)
    settle(plant)
    assert not mine.exists() and not journal.exists()


def test_no_link_in_the_place_of_a_draft_has_another_file_given_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = plant_in(tmp_path, 80.0)
    keep_configuration(load_plant(plant), now=1_700_000_000.0, note="start")
    plant_in(tmp_path, 75.0)
    others, given = tmp_path / "others", list[int]()
    others.write_text("", encoding="utf-8")

    def give(file: int | Path, *_: int) -> None:
        """To another owner; it is looked at which file that is, after a link was put where its name was."""
        draft = Path(f"/proc/self/fd/{file}").readlink() if isinstance(file, int) else file
        draft.rename(draft.with_name("taken"))
        draft.symlink_to(others)
        given.append((os.fstat(file) if isinstance(file, int) else file.stat()).st_ino)
        draft.with_name("taken").rename(draft)

    for name in ("chown", "fchown"):
        monkeypatch.setattr(os, name, give)
    code, printed = typed("config", "rollback", "1", "--reason", "x", "--by", "Ada", "--config", str(plant))
    assert code == 0, printed
    assert given and others.stat().st_ino not in given


def test_what_one_who_may_rename_has_given_the_journals_name_is_not_carried_out(tmp_path: Path) -> None:
    plant = plant_in(tmp_path, 80.0)
    mine, theirs, journal = tmp_path / "mine", tmp_path / "theirs", journal_path(plant)
    for file in (mine, theirs):
        file.write_text(file.name, encoding="utf-8")
    write_journal(plant, places=[mine])
    journal.chmod(0o644)  # as any file of the superuser in a folder of the gateway's user
    refused(plant, mine, theirs)
    for places, aside in (([], [(mine, theirs)]), ([], [(mine, tmp_path / "out/.mine.former")]), ([Path("mine")], [])):
        write_journal(plant, places=places, aside=aside)
        refused(plant, mine, theirs)
    for text in ("", "[]", '{"places": 3, "aside": []}', '{"places": ["\\u0000"], "aside": []}', "[" * 100_000):
        journal.write_text(text, encoding="utf-8")
        refused(plant, mine, theirs)
    journal.unlink()
    journal.symlink_to(plant)
    refused(plant, mine, theirs)


def write_journal(plant: Path, places: Sequence[Path] = (), aside: Sequence[tuple[Path, Path]] = ()) -> None:
    """A journal as it was, and as it is; each row of it as renames that remove or replace the file it names."""
    plain = {
        "aside": [list(map(str, pair)) for pair in aside],
        "drafts": [[str(place), f"{place}.none"] for place in places],
        "places": list(map(str, places)),
    }
    journal_path(plant).unlink(missing_ok=True)
    journal_path(plant).write_text(json.dumps(plain), encoding="utf-8")
    journal_path(plant).chmod(MODE)


def refused(plant: Path, *untouched: Path) -> None:
    with pytest.raises(ConfigError, match=r"is not as a replacement .* leaves it .* remove it"):
        load_plant(plant)
    assert [file.read_text(encoding="utf-8") for file in untouched] == [file.name for file in untouched]


def test_a_pipe_with_the_journals_name_is_refused_at_once(tmp_path: Path) -> None:
    plant, said = plant_in(tmp_path, 80.0), Queue[str]()
    os.mkfifo(journal_path(plant), MODE)

    def load() -> None:
        try:
            load_plant(plant)
        except ConfigError as error:
            said.put(str(error))

    Thread(target=load, daemon=True).start()
    assert "is not as a replacement" in said.get(timeout=60.0)


def test_who_may_not_look_for_a_journal_is_told_of_the_plant_file(tmp_path: Path) -> None:
    plant = plant_in(tmp_path, 80.0)
    longest = tmp_path / f"{'p' * 245}.toml"
    shutil.copy(plant, longest)
    assert load_plant(longest)[0].alarms.limit == 80.0
    with pytest.raises(ConfigError, match="Not a directory"):
        load_plant(plant / "plant.toml")


def test_the_second_of_two_ways_back_at_once_is_refused_and_takes_nothing_from_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = plant_in(tmp_path, 80.0)
    keep_configuration(load_plant(plant), now=1_700_000_000.0, note="start")
    plant_in(tmp_path, 75.0)
    first_is_under_way, second_is_over = Event(), Event()
    kept, seconds, said = config_commands._list_configurations, count(), Queue[BaseException | None]()

    def slowly(path: Path, folder: Path | None) -> list[KeptConfiguration]:
        found = kept(path, folder)
        if current_thread() is second:
            assert first_is_under_way.wait(60.0)
        return found

    def unusable(path: Path) -> tuple[Config, ...]:
        first_is_under_way.set()
        assert second_is_over.wait(60.0)
        raise ConfigError([f"{path}: is of no use"])

    def go_back() -> None:
        words = ["1", "--reason", "x", "--by", "Ada", "--config", str(plant)]
        rollback.main(words, standalone_mode=False)

    def go_back_too() -> None:
        try:
            go_back()
            said.put(None)
        except (SystemExit, OSError, ValueError) as error:
            said.put(error)
        second_is_over.set()

    # Whoever waits has waited long at once.
    clock = SimpleNamespace(monotonic=lambda: float(next(seconds)), sleep=lambda _: None)
    monkeypatch.setattr("gateway.replacement.time", clock)
    monkeypatch.setattr(config_commands, "_list_configurations", slowly)
    monkeypatch.setattr(config_commands, "read_plant", unusable)
    second = Thread(target=go_back_too, daemon=True)
    second.start()
    with pytest.raises(SystemExit):
        go_back()
    assert isinstance(said.get(timeout=60.0), SystemExit)
    second.join(60.0)
    assert versions(plant) == {"plant": 75.0, "device": 75.0}


def test_who_reads_while_files_are_replaced_has_all_of_one_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = plant_in(tmp_path, 80.0)
    keep_configuration(load_plant(plant), now=1_700_000_000.0, note="start")
    plant_in(tmp_path, 75.0)
    plain, readings = config.read_toml, list[Path]()

    def read_toml(path: Path) -> dict[str, Any]:
        """The plant file; it is replaced before its device file is read."""
        found = plain(path)
        readings.append(path)
        if len(readings) == 1:
            code, printed = typed("config", "rollback", "1", "--reason", "x", "--by", "Ada", "--config", str(plant))
            assert code == 0, printed
        return found

    monkeypatch.setattr(config, "read_toml", read_toml)
    assert load_plant(plant)[0].alarms.limit == 80.0
    known = len(readings)
    load_plant(plant)
    assert len(readings) == known + 1
