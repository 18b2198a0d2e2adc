"""A backup that somebody had made up was restored: any file to any place, with the set-uid bit.

A manifest's seal shows that a backup is whole, not whose it is: whoever can write a folder can compute one. What is
restored has a known role, lies where the plant file in the backup says, has no bits beyond 0777, and is vouched for.
"""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from gateway.cli.keep.backup import list_sources
from gateway.cli.main import main
from gateway.plant import configurations
from gateway.settings import Config, load_plant, named_files
from gateway.store import AuditEntry, load_or_make_key, open_audit, open_historian, public_path
from gateway.store.backup import MANIFEST, _digest, _seal
from sim.artefacts.model_json import model_text
from tests.gateway.support import MAP, two_modes

AS_OWNER = 0o6000
"""Set-uid and set-gid."""


def decanter(*words: object) -> Result:
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert "Traceback" not in done.output and (done.exception is None or isinstance(done.exception, SystemExit))
    return done


def plant_in(home: Path, text: str = "", plant: str = "plant.toml") -> tuple[Config, ...]:
    """A plant whose files are all there: records, key, accounts, a model, a device file."""
    path, up = home / plant, "../" * plant.count("/")
    for folder in (path.parent, home / "devices", home / "records"):
        folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(MAP, home / "devices/plc.toml")
    (home / "model.json").write_text(model_text(two_modes()), encoding="utf-8")
    path.write_text(
        f'[device]\nfile = "{up}devices/plc.toml"\n[model]\npath = "{up}model.json"\n'
        f'[historian]\npath = "{up}records/h.sqlite"\n{text}',
        encoding="utf-8",
    )
    machines = load_plant(path)
    open_historian(machines[0].historian.path).close()
    audit = open_audit(machines[0].audit)
    assert audit.record(AuditEntry(1.0, "start", "Ada", "test"))
    audit.close()
    load_or_make_key(machines[0].audit_key)
    machines[0].users.write_text("{}", encoding="utf-8")
    return machines


@pytest.fixture
def made(tmp_path: Path) -> tuple[Config, Path]:
    machines = plant_in(tmp_path / "plant")
    done = decanter("keep", "backup", tmp_path / "backup", "--config", machines[0].path)
    assert done.exit_code == 0, done.output
    return machines[0], tmp_path / "backup"


def forge(folder: Path, change: Callable[[dict[str, Any]], None]) -> str:
    """Change a manifest as its writer likes, and seal it anew as the program does; gives the seal."""
    path = folder / MANIFEST
    content = json.loads(path.read_text())
    del content["seal"]
    change(content)
    path.write_text(json.dumps({**content, "seal": (seal := _seal(content))}))
    return seal


def add(content: dict[str, Any], folder: Path, role: str, place: Path, mode: int = 0o755) -> None:
    stored = "files/9999-tool"
    (folder / stored).write_bytes(b"#!/bin/sh\n")
    row = {"role": role, "stored": stored, "original": str(place), "sha256": _digest(folder / stored), "size": 10}
    content["files"].insert(0, {**row, "mode": mode, "time": 1})


def test_a_file_that_runs_as_root_is_not_restored(made: tuple[Config, Path], tmp_path: Path) -> None:
    _, folder = made
    forge(folder, lambda content: add(content, folder, "model", tmp_path / "bin/tool", 0o4755))
    assert decanter("keep", "restore", folder, "--into", tmp_path / "box").exit_code == 2
    assert not (tmp_path / "box").exists()


@pytest.mark.parametrize("role", ["tool", "model", "device", "accounts", "heads", "public key", "plant"])
def test_no_file_goes_where_the_plant_file_does_not_say_even_if_the_seal_is_given(
    made: tuple[Config, Path], tmp_path: Path, role: str
) -> None:
    _, folder = made
    seal = forge(folder, lambda content: add(content, folder, role, tmp_path / "bin/tool", 0o4755))
    done = decanter("keep", "restore", folder, "--into", tmp_path / "box", "--seal", seal)
    assert done.exit_code == 2 and "bin/tool" in done.output, done.output
    assert not (tmp_path / "box").exists()


def test_no_restored_file_runs_as_its_owner(made: tuple[Config, Path], tmp_path: Path) -> None:
    _, folder = made

    def change(content: dict[str, Any]) -> None:
        for file in content["files"]:
            file["mode"] |= AS_OWNER

    seal = forge(folder, change)
    done = decanter("keep", "restore", folder, "--into", tmp_path / "box", "--seal", seal)
    assert done.exit_code == 0, done.output
    files = [path for path in (tmp_path / "box").rglob("*") if path.is_file()]
    assert len(files) >= 8 and not any(path.stat().st_mode & AS_OWNER for path in files)


def test_what_was_changed_and_sealed_anew_is_not_restored(made: tuple[Config, Path], tmp_path: Path) -> None:
    _, folder = made
    original = json.loads((folder / MANIFEST).read_text())["seal"]
    plant = next(path for path in (folder / "files").iterdir() if path.name.endswith("plant.toml"))
    plant.write_text(plant.read_text() + "[alarms]\nlimit = 300.0\n", encoding="utf-8")

    def change(content: dict[str, Any]) -> None:
        row = next(file for file in content["files"] if file["role"] == "plant")
        row.update(sha256=_digest(plant), size=plant.stat().st_size)

    forge(folder, change)
    for words in ((), ("--seal", original)):
        done = decanter("keep", "restore", folder, "--into", tmp_path / "box", *words)
        assert done.exit_code == 2 and ("nobody vouches" in done.output or "another seal" in done.output), done.output
    assert not (tmp_path / "box").exists()


@pytest.mark.parametrize("moment", [1e300, 1.5, float("nan"), 1 << 70, -(1 << 70), "now", None])
@pytest.mark.parametrize("key", ["made", "time"])
def test_a_moment_that_no_file_has_is_refused_in_one_sentence(
    made: tuple[Config, Path], tmp_path: Path, key: str, moment: object
) -> None:
    _, folder = made

    def change(content: dict[str, Any]) -> None:
        (content if key == "made" else content["files"][0])[key] = moment

    seal = forge(folder, change)
    done = decanter("keep", "restore", folder, "--into", tmp_path / "box", "--seal", seal)
    if (key, moment) == ("made", 1.5):
        assert done.exit_code == 0, done.output
    else:
        assert done.exit_code == 2 and "is damaged or was changed" in done.output, done.output


def test_a_pipe_in_place_of_the_manifest_is_not_waited_for(made: tuple[Config, Path], tmp_path: Path) -> None:
    _, folder = made
    (folder / MANIFEST).unlink()
    os.mkfifo(folder / MANIFEST)
    done = decanter("keep", "restore", folder, "--into", tmp_path / "box")
    assert done.exit_code == 2 and "named pipe" in done.output


def test_a_box_without_the_key_asks_for_the_public_key_or_the_seal(made: tuple[Config, Path], tmp_path: Path) -> None:
    config, folder = made
    seal = json.loads((folder / MANIFEST).read_text())["seal"]
    shutil.copyfile(public_path(config.audit_key), tmp_path / "kept.pub")
    load_or_make_key(tmp_path / "other.key")
    shutil.move(tmp_path / "plant", tmp_path / "gone")
    refused = decanter("keep", "restore", folder, "--into", tmp_path / "box")
    assert refused.exit_code == 2 and "--seal HASH" in refused.output and not (tmp_path / "box").exists()
    other = decanter("keep", "restore", folder, "--into", tmp_path / "box", "--public-key", tmp_path / "other.pub")
    assert other.exit_code == 2 and "not signed by the key" in other.output
    for place, words in (("box", ("--public-key", tmp_path / "kept.pub")), ("box2", ("--seal", seal))):
        done = decanter("keep", "restore", folder, "--into", tmp_path / place, *words)
        assert done.exit_code == 0, done.output


def test_another_gateways_key_vouches_for_nothing(made: tuple[Config, Path], tmp_path: Path) -> None:
    config, folder = made
    config.audit_key.unlink()
    load_or_make_key(config.audit_key)
    done = decanter("keep", "restore", folder, "--into", tmp_path / "box")
    assert done.exit_code == 2 and "nobody vouches" in done.output


def test_whatever_is_backed_up_lies_where_the_plant_file_says(tmp_path: Path) -> None:
    home = tmp_path / "plant"
    text = (
        f'[ensemble]\nmembers = ["../more.json", "{home}/store"]\n[writeback]\naudit = "{home}/records/log.sqlite"\n'
        'audit_heads = "../heads"\n[page]\nusers = "../people.json"\n'
    )
    for place in ("more.json", "store/v1/model.json"):
        (home / place).parent.mkdir(parents=True, exist_ok=True)
        (home / place).write_text(model_text(two_modes()), encoding="utf-8")
    machines = plant_in(home, text, "conf/plant.toml")
    (home / "heads").write_text("", encoding="utf-8")
    assert len({role for role, _ in list_sources(machines)}) == 9
    assert decanter("keep", "backup", tmp_path / "backup", "--config", machines[0].path).exit_code == 0
    done = decanter("keep", "restore", tmp_path / "backup", "--overwrite")
    assert done.exit_code == 0, done.output


def test_a_plant_file_names_the_files_of_each_link_and_what_is_no_plant_file_names_nothing() -> None:
    plant, device = Path("/conf/plant.toml"), Path("/conf/node.toml")
    links = "".join(f'[[device.links]]\nname = "{name}"\nfile = "node.toml"\neds = "{name}.eds"\n' for name in "ab")
    contents = {plant: links.encode(), device: b'[device]\ndriver = "canopen"\neds = "own.eds"\n'}
    named = {path.name for path in named_files(plant, contents)["device"]}
    assert named == {"node.toml", "own.eds", "a.eds", "b.eds"}
    for text in (b"\xff", b"[", b"device = 1\nmachine = 2\nmodel = []", b"[device]\nfile = 3\nlinks = [1, {}]", b""):
        assert not named_files(plant, {plant: text})["device"] | named_files(plant, {plant: text})["model"]
    for text in (b"[device]\ndriver = [1]", b"device = 1", b"\xff", b'[device]\ndriver = "canopen"\neds = 1'):
        assert named_files(plant, {plant: links.encode(), device: text})["device"] >= {device}


def test_a_made_up_configuration_is_not_gone_back_to(made: tuple[Config, Path], tmp_path: Path) -> None:
    config, _ = made
    kept = configurations.keep_configuration(load_plant(config.path), now=1.0, note="start")
    assert kept is not None
    forge(kept.folder, lambda content: add(content, kept.folder, "device", tmp_path / "bin/tool", 0o4755))
    words = ("--config", config.path, "--reason", "test", "--by", "Eve")
    done = decanter("keep", "rollback", kept.number, *words)
    assert done.exit_code == 2 and not (tmp_path / "bin").exists(), done.output
    forge(kept.folder, lambda content: content["files"].pop(0))
    forge(kept.folder, lambda content: [file.update(mode=0o6755) for file in content["files"]])
    assert decanter("keep", "rollback", kept.number, *words).exit_code == 0
    assert not config.path.stat().st_mode & AS_OWNER
