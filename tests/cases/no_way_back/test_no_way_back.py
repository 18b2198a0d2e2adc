"""There was no backup of a running gateway and no way back from one; a stored file of another layout was untested."""

import asyncio
import json
import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.machine.writing import witness_places
from gateway.plant.app import run
from gateway.settings import Config, load_config
from gateway.store import examine, open_historian
from gateway.store.arming_rows import find_arming, given_words
from gateway.store.audit import ARMED, DISARMED, AuditEntry, AuditError, open_audit, read, verify
from gateway.store.backup import MANIFEST, BackupError, _seal, read_manifest
from tests.gateway.support import EPOCH, MAP, Bench, JumpClock, PacedClock, config_in, logged, two_modes

ARMED_BY_FILE: dict[str, Any] = {"armed_by": "Ada", "reason": "test", "minutes": 480.0}
OLD = Path(__file__).with_name("audit_layout_1.sql")


def armed_config(folder: Path) -> Config:
    """An armed gateway whose files, device file too, all lie in the folder."""
    folder.mkdir()
    shutil.copy(MAP, folder / "device.toml")
    text = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "test"\nminutes = 480\n'
    config_in(folder, text, model=two_modes())
    path = folder / "plant.toml"
    path.write_text(path.read_text().replace(str(MAP), "device.toml"))
    return load_config(path)


def decanter(*words: object) -> Result:
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert "Traceback" not in done.output and (done.exception is None or isinstance(done.exception, SystemExit))
    return done


async def go(config: Config, clock: JumpClock, reads: int, at: int = 0, backup: Path | None = None) -> Bench:
    """Run for some reads; a backup is made at read `at`, and the gateway goes on meanwhile and afterwards."""
    bench = Bench(config, clock, armed=True)
    bench.stop_after = reads if backup is None else None
    running = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))
    if backup is not None:
        while bench.reads < at:
            assert not running.done()
            await asyncio.sleep(0)
        done = await asyncio.to_thread(decanter, "backup", backup, "--config", config.path)
        assert done.exit_code == 0, done.output
        assert not running.done(), "the backup ended the gateway"
        bench.stop_after = max(reads, bench.reads + 20)
    await asyncio.wait_for(running, 300.0)
    assert bench.stop_after is not None and bench.reads >= bench.stop_after
    return bench


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A backup that was made while its gateway ran."""
    home = tmp_path_factory.mktemp("made")
    clock = PacedClock(pause_s=0.002)
    asyncio.run(go(armed_config(home / "plant"), clock, 200, at=30, backup=home / "backup"))
    return home / "backup"


@pytest.fixture
def backed(tmp_path: Path) -> tuple[Config, JumpClock, Path]:
    config, clock = armed_config(tmp_path / "plant"), PacedClock(pause_s=0.002)
    asyncio.run(go(config, clock, 200, at=30, backup=tmp_path / "backup"))
    return config, clock, tmp_path / "backup"


def test_a_running_gateway_is_backed_up_whole_and_restored_elsewhere_never_armed(
    backed: tuple[Config, JumpClock, Path], tmp_path: Path
) -> None:
    config, clock, folder = backed
    manifest = read_manifest(folder)
    roles = [file.role for file in manifest.files]
    assert sorted(set(roles)) == sorted(
        ["plant", "device", "model", "key", "public key", "heads", "historian", "audit"]
    )
    assert roles[-1] == "audit" and not list(tmp_path.glob(".backup*"))
    key = next(file for file in manifest.files if file.role == "key")
    assert (folder / key.stored).stat().st_mode & 0o777 == 0o600 and folder.stat().st_mode & 0o077 == 0
    root = tmp_path / "box"
    done = decanter("keep", "restore", folder, "--into", root, "--by", "Bea")
    assert done.exit_code == 0, done.output
    assert "starts in mode 'shadow' (it was 'armed')" in done.output
    restored = load_config(root / config.path.relative_to("/"))
    assert restored.writeback.mode == "shadow"
    assert restored.audit_key.stat().st_mode & 0o777 == 0o600
    rows = read(restored.audit)
    assert rows[-1].entry.kind == DISARMED and rows[-1].entry.who == "Bea"
    assert [row.hash for row in rows[: manifest.audit_rows]][-1] == manifest.audit_head
    assert find_arming(restored.audit, clock.time) is None
    verdict = examine(witness_places(restored))
    assert verdict.problem == "" and verdict.witnessed == verdict.rows
    bench = asyncio.run(go(restored, clock, 20))
    assert bench.written == [] and not any(row["event"] == "armed" for row in logged(restored.path.parent))


def test_a_restore_over_a_gateway_needs_to_be_told_keeps_what_was_there_and_shows_what_is_lost(
    backed: tuple[Config, JumpClock, Path],
) -> None:
    config, clock, folder = backed
    before = {path: path.read_bytes() for path in config.path.parent.iterdir() if path.is_file()}
    refused = decanter("keep", "restore", folder)
    assert refused.exit_code == 2 and "nothing is overwritten without --overwrite" in refused.output
    assert {path: path.read_bytes() for path in before} == before
    store = open_historian(config.historian.path)
    running = decanter("keep", "restore", folder, "--overwrite")
    assert running.exit_code == 2 and "a gateway runs on it" in running.output
    store.close()
    newest = config.audit.read_bytes()
    done = decanter("keep", "restore", folder, "--overwrite")
    assert done.exit_code == 0, done.output
    assert config.audit.with_name("audit.sqlite.replaced-1").read_bytes() == newest
    assert not list(config.path.parent.glob(".*restored*"))
    # The log is not in a backup: it still bears witness to the rows that are newer than it.
    assert "was signed and is not in it" in examine(witness_places(config)).problem
    bench = asyncio.run(go(load_config(config.path), clock, 20))
    assert bench.written == []


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        ("no manifest", "has no manifest.json"),
        ("manifest cut", "is damaged"),
        ("manifest changed", "was changed"),
        ("manifest nested", "is damaged"),
        ("newer format", "format 2, this program reads 1"),
        ("newer layout", "layout 99"),
        ("file missing", "is missing"),
        ("file cut", "is damaged"),
        ("one bit", "is damaged"),
        ("link", "is missing"),
        ("outside", "which no backup does"),
        ("above", "which no backup does"),
    ],
)
def test_a_backup_that_is_not_whole_is_refused_and_nothing_is_touched(
    made: Path, tmp_path: Path, harm: str, words: str
) -> None:
    folder = tmp_path / "backup"
    shutil.copytree(made, folder)
    path = folder / MANIFEST
    content = json.loads(path.read_text())
    stored = folder / content["files"][-1]["stored"]
    if harm == "no manifest":
        path.unlink()
    elif harm == "manifest cut":
        path.write_text(path.read_text()[:-200])
    elif harm == "manifest changed":
        path.write_text(path.read_text().replace("plant.toml", "plant.tomb"))
    elif harm == "manifest nested":
        path.write_text("[" * 200_000)
    elif harm == "file missing":
        stored.unlink()
    elif harm == "file cut":
        os.truncate(stored, stored.stat().st_size - 1)
    elif harm == "one bit":
        data = bytearray(stored.read_bytes())
        data[len(data) // 2] ^= 1
        stored.write_bytes(data)
    elif harm == "link":
        stored.rename(tmp_path / "elsewhere")
        stored.symlink_to(tmp_path / "elsewhere")
    else:
        del content["seal"]
        content["format"] += harm == "newer format"
        if harm == "newer layout":
            content["layouts"]["audit"] = 99
        elif harm == "outside":
            content["files"][0]["stored"] = "files/../../x"
        elif harm == "above":
            content["files"][0]["original"] = "/srv/../etc/x"
        path.write_text(json.dumps({**content, "seal": _seal(content)}))
    done = decanter("keep", "restore", folder, "--into", tmp_path / "box")
    assert done.exit_code == 2 and words in done.output, done.output
    assert not (tmp_path / "box").exists()


def test_a_backup_that_fails_leaves_nothing_and_none_is_made_over_another(
    backed: tuple[Config, JumpClock, Path], tmp_path: Path
) -> None:
    config, _, folder = backed
    again = decanter("keep", "backup", folder, "--config", config.path)
    assert again.exit_code == 2 and "is there already" in again.output
    assert read_manifest(folder).audit_rows > 0
    with closing(sqlite3.connect(config.audit)) as connection, connection:
        connection.execute("DROP TRIGGER audit_no_change")
        connection.execute("UPDATE audit SET who = 'Eve' WHERE id = 2")
    broken = decanter("keep", "backup", tmp_path / "second", "--config", config.path)
    assert broken.exit_code == 0 and "THE AUDIT LOG IS DAMAGED" in broken.output
    assert "row 2 was changed" in read_manifest(tmp_path / "second").damaged
    config.audit.write_bytes(config.audit.read_bytes()[:5000])
    config.audit.with_name("audit.sqlite-wal").unlink(missing_ok=True)
    assert decanter("keep", "backup", tmp_path / "third", "--config", config.path).exit_code == 0
    (aside,) = [file for file in read_manifest(tmp_path / "third").files if "audit.sqlite" in file.original]
    assert aside.original == f"{config.audit}.damaged", "what is restored begins with a new one"
    box = tmp_path / "plant" / "box"
    log = box / config.audit.relative_to("/")
    log.parent.mkdir(parents=True)
    log.write_bytes(b"of another time, perhaps with an arming")
    restored = decanter("keep", "restore", tmp_path / "third", "--into", box)
    assert restored.exit_code in (0, 1), restored.output
    assert "THE AUDIT LOG IN IT IS DAMAGED" in restored.output
    assert not log.exists() and log.with_name("audit.sqlite.replaced-1").exists()
    config.historian.path.write_bytes(config.historian.path.read_bytes()[:5000])
    assert decanter("keep", "backup", tmp_path / "fourth", "--config", config.path).exit_code == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup", "plant", "second", "third"]


def test_a_restore_that_fails_half_way_leaves_no_draft(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []

    def full(*values: object, ns: object) -> None:
        calls.append(values)
        if len(calls) > 3:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("gateway.store.backup.os.utime", full)
    done = decanter("keep", "restore", made, "--into", tmp_path / "box")
    assert done.exit_code == 2 and not [path for path in (tmp_path / "box").rglob("*") if path.is_file()]


# ---------------------------------------------------------------- files of other layouts


def old_audit(path: Path) -> Path:
    """An audit log as the first program that had one made it."""
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(OLD.read_text(encoding="utf-8"))
    return path


def test_an_audit_log_of_a_former_program_is_read_and_gone_on_with(tmp_path: Path) -> None:
    path = old_audit(tmp_path / "audit.sqlite")
    kept = verify(path)
    assert (kept.rows, kept.problem) == (4, "")
    (found,) = given_words(path)
    assert found.entry.kind == ARMED and found.entry.who == "Ada"
    assert find_arming(path, EPOCH + 10.0) is None, "no former program confirmed an arming: it has to be given again"
    audit = open_audit(path)
    assert audit.record(AuditEntry(EPOCH + 20.0, DISARMED, "Bea", "enough"))
    audit.close()
    assert verify(path, kept.head).rows == 5 and verify(path, kept.head).problem == ""
    assert find_arming(path, EPOCH + 21.0) is None


@pytest.mark.parametrize("layout", [2, 99])
def test_an_audit_log_of_a_newer_layout_is_refused_and_not_touched(tmp_path: Path, layout: int) -> None:
    config = config_in(tmp_path, writeback__mode="shadow")
    old_audit(config.audit)
    with closing(sqlite3.connect(config.audit)) as connection:
        connection.execute(f"PRAGMA user_version = {layout}")
    before = config.audit.read_bytes()
    for use in (open_audit, verify):
        with pytest.raises(AuditError, match=f"has layout {layout}, this program reads 1"):
            use(config.audit)
    bench = asyncio.run(go(config, JumpClock(), 5))
    assert bench.reads >= 5 and bench.written == []
    said = [row["reason"] for row in logged(tmp_path) if row["event"] == "the records cannot be relied on"]
    assert len(said) == 1 and f"has layout {layout}, this program reads 1" in said[0]
    assert not list(tmp_path.glob("*damaged*")) and config.audit.stat().st_size == len(before)
    with pytest.raises(BackupError):
        read_manifest(tmp_path)
