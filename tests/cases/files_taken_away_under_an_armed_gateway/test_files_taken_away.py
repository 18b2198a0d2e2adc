"""With its audit log removed or replaced an armed gateway wrote on without a record: no alarm, no line in the log.

So it is with each file that a promise rests on: whatever is done to it, not one usable block follows.
"""

import asyncio
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gateway.outside.web.access import AccountRole
from gateway.outside.web.access.accounts import add_account
from gateway.plant.app import run
from gateway.settings import Config
from gateway.store import default_places, examine
from gateway.store.audit import DISARMED, read
from tests.gateway.support import Bench, PacedClock, config_in, logged, two_modes
from tests.rig.memory import folder_in_memory

ARMED: dict[str, Any] = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 480.0,
}
SOONER, LATER = 6, 14


def with_all_that_belongs_to_it(path: Path) -> list[Path]:
    return [path.with_name(path.name + ending) for ending in ("", "-wal", "-shm")]


FILES: dict[str, Callable[[Config], list[Path]]] = {
    "audit": lambda config: with_all_that_belongs_to_it(config.audit),
    "audit's file": lambda config: [config.audit],
    "audit's WAL": lambda config: [config.audit.with_name("audit.sqlite-wal")],
    "audit's index": lambda config: [config.audit.with_name("audit.sqlite-shm")],
    "heads": lambda config: [config.audit_heads],
    "key": lambda config: [config.audit_key],
    "historian": lambda config: with_all_that_belongs_to_it(config.historian.path),
    "historian's file": lambda config: [config.historian.path],
    "historian's WAL": lambda config: [config.historian.path.with_name("history.sqlite-wal")],
    "lock": lambda config: [config.historian.path.with_name("history.sqlite.lock")],
    "accounts": lambda config: [config.users],
    "model": lambda config: [config.path.with_name("model.json")],
}


def removed(path: Path) -> None:
    path.unlink()


def renamed(path: Path) -> None:
    path.rename(path.with_name(f"{path.name}.elsewhere"))


def replaced(path: Path) -> None:
    """By a copy of itself, as who restores a backup by hand does."""
    copy = path.with_name("copy")
    shutil.copyfile(path, copy)
    copy.chmod(path.stat().st_mode & 0o777)
    copy.replace(path)


def emptied(path: Path) -> None:
    os.truncate(path, 0)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def read_only(path: Path) -> None:
    path.chmod(0o400)


def to_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


DEEDS = (removed, renamed, replaced, emptied, cut, read_only, to_a_folder)


@dataclass
class Tampered(Bench):
    """A device in whose reading before the scan SOONER something is done to files."""

    deed: Callable[[], None] = lambda: None
    before: int = -1
    failure: Exception | None = None

    async def read(self, tags: Any) -> Any:
        if self.reads == SOONER and self.before < 0:
            self.before = len(self.written)
            try:
                self.deed()
            except Exception as error:  # noqa: BLE001 - it is the test's, and is raised there
                self.failure = error
        return await super().read(tags)


def armed_config(folder: Path, **more: Any) -> Config:
    page = {"page__enabled": True, "page__port": 0} if more.pop("page", False) else {}
    config = config_in(folder, model=two_modes(), **ARMED, **page, **more)
    if page:
        add_account(config.users, "ada", AccountRole.ENGINEER, "a long enough word")
    return config


async def tampered(config: Config, deed: Callable[[], None]) -> tuple[dict[str, Any], Tampered]:
    bench = Tampered(config, PacedClock(pause_s=0.005), armed=True, stop_after=LATER, deed=deed)
    status = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    if bench.failure is not None:
        raise bench.failure
    return status, bench


# An accounts' file that another whole one replaces is an account that was added; what is only read is the same in a
# copy of it; a lock has nothing to be cut.
NO_HARM = {("accounts", replaced), ("key", replaced), ("model", replaced), ("lock", emptied), ("lock", cut)}


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    with folder_in_memory(tmp_path) as place:
        yield place


@pytest.mark.parametrize("deed", DEEDS, ids=lambda deed: deed.__name__)
@pytest.mark.parametrize("files", FILES)
async def test_no_usable_block_follows_and_an_alarm_stands(
    folder: Path, files: str, deed: Callable[[Path], None]
) -> None:
    if (files, deed) in NO_HARM:
        return
    config = armed_config(folder, page=files == "accounts")

    def tamper() -> None:
        for path in FILES[files](config):
            deed(path)

    status, bench = await tampered(config, tamper)
    assert bench.before > 3, "it was armed and wrote"
    after = bench.written[bench.before :]
    assert [block["validity"] for block in after] in ([0], []), "nothing but what takes everything back"
    assert status["alarms"]["records"] == "unacknowledged"
    assert status["writeback"]["mode"] == "shadow", "a person looks, and arms again"
    said = [row["reason"] for row in logged(folder) if row["event"] == "the records cannot be relied on"]
    if deed is not to_a_folder:
        assert DISARMED in [row.entry.kind for row in read(config.audit)], "also in a log that was begun anew"
    names = {path.name for path in FILES[files](config)}
    assert said and any(name in said[0] for name in names) and "\n" not in said[0]


async def test_rows_that_are_taken_out_of_the_log_in_its_place_disarm(folder: Path) -> None:
    """The file is the same and no shorter: only its owner knows which row was written last."""
    config = armed_config(folder)

    def take_out() -> None:
        with closing(sqlite3.connect(config.audit)) as connection, connection:
            for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
                connection.execute(f"DROP TRIGGER {name}")
            connection.execute("DELETE FROM audit WHERE id > 1")

    status, bench = await tampered(config, take_out)
    assert bench.before > 3, "it was armed and wrote"
    assert [block["validity"] for block in bench.written[bench.before :]] in ([0], [])
    assert status["alarms"]["records"] == "unacknowledged" and status["writeback"]["mode"] == "shadow"


async def test_nothing_is_said_where_nothing_was_done(folder: Path) -> None:
    """What the gateway and its commands do to these files themselves is no tampering."""
    config = armed_config(folder, page=True, historian__max_mb=1.0)
    deeds: list[Callable[[], Any]] = [
        lambda: add_account(config.users, "bea", AccountRole.OPERATOR, "another long word"),
        lambda: read(config.audit),
        lambda: examine(default_places(config.audit)),
        lambda: replaced(config.audit_key),
        lambda: replaced(config.path.with_name("model.json")),
        lambda: config.path.with_name("model.json").touch(),
    ]
    status, bench = await tampered(config, lambda: [deed() for deed in deeds] and None)
    assert len(bench.written) >= LATER - 3 and status["writeback"]["mode"] == "armed"
    assert status["alarms"]["records"] == "normal"
