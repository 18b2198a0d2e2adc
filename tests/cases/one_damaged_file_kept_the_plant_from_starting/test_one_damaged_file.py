"""A line end appended to a text beside the second machine's model kept the first one from being watched, too.

Damages drawn for every file that a start reads; the whole matrix is `python -m benchmarks.broken_starts`.
"""

import asyncio
import json
import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from random import Random
from typing import Any

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.machine.model import loading
from gateway.outside.status import connect
from gateway.settings import Config, load_plant
from gateway.store.audit import DISARMED, arming_rows
from tests.rig.broken_starts import Damage, drawn, files_of, seed, started, tried
from tests.rig.memory import folder_in_memory


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with folder_in_memory(tmp_path_factory.mktemp("plant")) as home:
        seed(home / "plant")
        yield home / "plant"


def all_files() -> list[str]:
    """What a start reads, by the ends of the names: how versions and rows are called is known when they are there."""
    return [
        "model/model.json", "model/two modes.txt", "model/manifest.json", "store/store.json", "store/current",
        "secrets.toml", "northbound.toml", "records/users.json", "records/audit.key", "records/audit.heads.jsonl",
        "records/audit.sqlite", "records/history.sqlite", "gateway.jsonl", "plant.toml",
        "records/configurations/0001/manifest.json",
    ]  # fmt: skip


@pytest.mark.parametrize("file", all_files())
def test_both_machines_are_watched_whatever_is_damaged(plant: Path, file: str) -> None:
    assert file in files_of(plant)
    damage = Random(file).choice(drawn(plant, 3, Random(file), [file]))
    assert not (problems := tried(plant, plant.with_name("it"), damage)), (str(damage), problems)


def at_text(path: Path, text: bytes) -> int:
    """Where in the audit log's file a text stands, newest first."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    place = path.read_bytes().rfind(text)
    assert place >= 0
    return place


def no_utf8(folder: Path) -> None:
    """A byte of a reason becomes one that is no UTF-8."""
    audit = folder / "records/audit.sqlite"
    place = at_text(audit, b"gateway began")
    Damage("records/audit.sqlite", place, place + 1, b"\xed").to(folder)


def no_database(folder: Path) -> None:
    (folder / "records/audit.sqlite").write_bytes(b"these are notes, and no database at all\n" * 200)


def a_page(folder: Path) -> None:
    """The last leaf of the table."""
    audit = folder / "records/audit.sqlite"
    place = at_text(audit, b"confirmed") // 1024 * 1024
    Damage("records/audit.sqlite", place, place + 1024, b"\x5a" * 1024).to(folder)


AUDIT_DAMAGES = [no_utf8, no_database, a_page]


@pytest.mark.parametrize("damage", AUDIT_DAMAGES, ids=lambda damage: damage.__name__)
def test_commands_work_with_a_damaged_audit_log_and_say_what_is_damaged(
    plant: Path, tmp_path: Path, damage: Any
) -> None:
    folder = tmp_path / "it"
    shutil.copytree(plant, folder)
    damage(folder)

    def command(*words: str) -> tuple[int, str]:
        done = CliRunner().invoke(main, [*words, "--config", str(folder / "plant.toml")])
        assert "Traceback" not in done.output and not (done.exception and not isinstance(done.exception, SystemExit))
        return done.exit_code, done.output

    code, said = command("audit")
    assert code == 1 and ("was changed" in said or "can be read" in said), said
    code, said = command("backup", str(tmp_path / "backup"), "--json")
    assert code == 0 and json.loads(said)["damaged"], said
    kept = next((tmp_path / "backup/files").glob("*-audit.sqlite"))
    assert kept.stat().st_size > 0
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        code, said = command("disarm", "--machine", "first", "--by", "Bea", "--reason", "enough")
    assert code == 0, said
    newest = arming_rows(folder / "records/audit.sqlite")[-1].entry
    assert (newest.kind, newest.who, newest.subject) == (DISARMED, "Bea", "first")
    if damage is not no_utf8:
        assert "is set aside" in said and list((folder / "records").glob("audit.sqlite.damaged-1"))


async def test_reload_says_what_the_next_start_would_go_without(plant: Path, tmp_path: Path) -> None:
    folder = tmp_path / "it"
    shutil.copytree(plant, folder)
    socket = load_plant(folder / "plant.toml")[0].control_socket
    said: list[dict[str, Any]] = []

    async def asked(**keys: Any) -> None:
        line = await asyncio.to_thread(connect, socket)
        assert line is not None
        try:
            said.append(await asyncio.to_thread(line.ask, "reload", **keys))
        finally:
            line.close()

    async def meanwhile() -> None:
        await asked(dry_run=True)
        for name in ("model/model.json", "secrets.toml", "records/users.json"):
            with (folder / name).open("a") as stream:
                stream.write("[x")
        await asked(dry_run=True)

    await started(folder, 6, meanwhile=meanwhile)
    before, after = said
    assert before["next_start"] == [] and before["changes"] == after["changes"] == {}
    assert len(after["next_start"]) == 3
    missing = {"first": "model.json", "page": "users.json", "messages": "secrets.toml"}
    for sentence, (part, name) in zip(after["next_start"], missing.items(), strict=True):
        assert sentence.startswith(f"{part}: the next start would go without: ") and name in sentence


async def test_a_reload_reads_each_model_once(plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, read, reload = tmp_path / "it", Counter[str](), list[dict[str, Any]]()
    shutil.copytree(plant, folder)
    socket = load_plant(folder / "plant.toml")[0].control_socket
    load = loading._load

    def counted(config: Config, path: Path, key: str) -> Any:
        read[path.name] += 1
        return load(config, path, key)

    def ask() -> None:
        line = connect(socket)
        assert line is not None
        try:
            reload.append(line.ask("reload", dry_run=True))
        finally:
            line.close()

    async def meanwhile() -> None:
        text = (folder / "plant.toml").read_text()
        (folder / "plant.toml").write_text(text.replace("port = 15022", "port = 15023"))
        monkeypatch.setattr(loading, "_load", counted)
        await asyncio.to_thread(ask)

    await started(folder, 6, meanwhile=meanwhile)
    assert list(reload[0]["changes"]) == ["second"] and reload[0]["next_start"] == []
    assert read == {"model": 1, "store": 1}


async def test_a_model_that_was_mended_is_taken_up_by_a_reload(plant: Path, tmp_path: Path) -> None:
    folder = tmp_path / "it"
    shutil.copytree(plant, folder)
    model = folder / "model/model.json"
    whole = model.read_bytes()
    model.write_bytes(b"")
    socket = load_plant(folder / "plant.toml")[0].control_socket

    async def meanwhile() -> None:
        model.write_bytes(whole)
        line = await asyncio.to_thread(connect, socket)
        assert line is not None
        try:
            reply = await asyncio.to_thread(line.ask, "reload")
        finally:
            line.close()
        assert reply["changes"] == {"first": ["its model can be read again"]} and reply["applied"]

    status = await started(folder, 6, meanwhile=meanwhile)
    assert status["machines"]["first"]["model"] is not None
