"""A damaged historian (cut, garbage, one page) kept the whole gateway from starting, threshold alarm included."""

import asyncio
import os
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from drivers.tag import Tag
from gateway.plant.app import run
from gateway.settings.config import Config
from gateway.store.files import PAGE, HistorianError
from gateway.store.historian import open_historian
from tests.gateway.support import EPOCH, TEMPERATURE, Bench, JumpClock, config_in, logged, one_machine

ROWS = 4_000


def written(path: Path, rows: int = ROWS) -> None:
    """A historian with rows of every kind, packed ones among them, and all of it in the main file."""
    store, historian = one_machine(path, ())
    historian.put("scans", [(EPOCH + n, 0.0, 0) for n in range(rows)])
    historian.put("events", [(EPOCH + n, "W_ON", "on") for n in range(rows)])
    historian.put("alarms", [(EPOCH + n, "over limit", "T", 1, "normal", 81.0, "") for n in range(300)])
    historian.put("audit", [(EPOCH + n, f"entry {n}", "Ada", "test") for n in range(300)])
    assert store.close()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def overwritten(path: Path, begin: int, data: bytes) -> None:
    with path.open("r+b") as stream:
        stream.seek(begin)
        stream.write(data)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2 // PAGE * PAGE + 100)


def garbage(path: Path) -> None:
    path.write_bytes(b"these are notes, and no database at all\n" * 2000)


def first_page(path: Path) -> None:
    overwritten(path, 0, os.urandom(PAGE))


def one_page(path: Path) -> None:
    """The root of the alarms' table."""
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'alarms'").fetchone()
    overwritten(path, (page - 1) * PAGE, b"\xff" * PAGE)


def a_page_of_each_kind(path: Path) -> None:
    for page in range(20, path.stat().st_size // PAGE, 7):
        overwritten(path, page * PAGE, b"\x5a" * PAGE)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def directory(path: Path) -> None:
    path.unlink()
    path.mkdir()
    (path / "something").write_text("of somebody")


def strange_wal(path: Path) -> None:
    """The WAL of another database, left beside this one, with pages that fit nowhere in it."""
    other = path.with_name("other.sqlite")
    with closing(sqlite3.connect(other, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE t (x)")
        connection.executemany("INSERT INTO t VALUES (?)", [("y" * 3000,) for _ in range(100)])
        path.with_name(path.name + "-wal").write_bytes(other.with_name("other.sqlite-wal").read_bytes())


def wal_of_garbage(path: Path) -> None:
    path.with_name(path.name + "-wal").write_bytes(os.urandom(50_000))


def wal_is_a_directory(path: Path) -> None:
    path.with_name(path.name + "-wal").mkdir()


DAMAGE: tuple[Callable[[Path], None], ...] = (
    cut, garbage, first_page, one_page, a_page_of_each_kind, empty, directory, strange_wal, wal_of_garbage,
    wal_is_a_directory,
)  # fmt: skip


async def hot(config: Config) -> dict[str, Any]:
    """The status after twelve scans with the temperature over the limit."""
    bench = Bench(config, JumpClock(EPOCH + 10_000.0), stop_after=12)
    bench.plan[0] = {TEMPERATURE: 85.0}
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)


def table(path: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(query).fetchall()


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
async def test_the_gateway_starts_raises_the_threshold_alarm_and_stores_it(
    tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    config = config_in(tmp_path)
    path = config.historian.path
    written(path)
    damage(path)
    status = await hot(config)
    assert status["alarms"][f"over limit {TEMPERATURE}"] == "unacknowledged"
    assert status["historian"]["failure"] == "" and status["scan"]["count"] >= 10
    query = f"SELECT count(*) FROM alarms WHERE condition = 'over limit {TEMPERATURE}'"  # noqa: S608
    assert table(path, query) == [(1,)]
    assert table(path, "PRAGMA integrity_check") == [("ok",)]
    aside = [place for place in tmp_path.iterdir() if ".damaged-" in place.name and not place.name.endswith("-wal")]
    if damage is wal_of_garbage:  # SQLite passes over it: nothing is lost
        assert not aside and status["alarms"]["records"] == "normal"
        return
    if damage is empty:  # nothing is left that could be set aside, and that is said
        assert not aside and status["alarms"]["records"] == "unacknowledged"
        assert "history.sqlite: was empty" in status["historian"]["complaint"]
        return
    assert status["alarms"]["records"] == "unacknowledged", "it stands until the next start"
    assert aside and any(place.name in status["historian"]["complaint"] for place in aside)
    said = [row["reason"] for row in logged(tmp_path) if row["event"] == "the records cannot be relied on"]
    assert len(said) == 1 and "is set aside as" in said[0] and "\n" not in said[0]
    again = await hot(config)
    assert again["historian"]["complaint"] == "", "the new one is sound"


@pytest.mark.parametrize("damage", [cut, one_page, a_page_of_each_kind, strange_wal], ids=lambda d: d.__name__)
def test_what_can_be_read_is_recovered(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    path = tmp_path / "h.sqlite"
    written(path)
    damage(path)
    store, historian = one_machine(path, (), mend=True)
    assert "rows of it were recovered" in historian.note
    assert store.close()
    audit = [row[0] for row in table(path, "SELECT what FROM audit ORDER BY id")]
    assert audit == sorted(audit, key=lambda what: int(what.split()[1])), "in their order"
    if damage in (one_page, strange_wal):
        assert len(audit) == 300
    if damage is one_page:
        assert table(path, "SELECT count(*) FROM alarms") == [(0,)], "one bad page costs its table"


def test_a_table_that_goes_bad_while_the_gateway_runs_costs_that_table(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    written(path)
    store, historian = one_machine(path, ())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TABLE scans")
        connection.execute("DROP TABLE events")
    historian.put("scans", [(EPOCH + 5000, 0.0, 0)])
    historian.put("audit", [(EPOCH, "after", "Ada", "test")])
    assert historian.flush(60.0) and historian.failure == "" and "is damaged (no such table" in historian.complaint
    historian.put("scans", [(EPOCH + 5001, 0.0, 0)])
    historian.put("events", [(EPOCH + 5001, "W_ON", "on")])
    assert store.close()
    assert table(path, "SELECT time FROM scans") == [(EPOCH + 5000,), (EPOCH + 5001,)]
    assert table(path, "SELECT count(*) FROM audit") == [(301,)]


def test_a_file_that_is_taken_away_under_it_is_begun_anew_and_said(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    written(path)
    store, historian = one_machine(path, (), mend=True)
    for ending in ("", "-wal", "-shm"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    historian.put("audit", [(EPOCH, "after", "Ada", "test")])
    assert historian.flush(60.0) and "was taken away" in historian.complaint
    assert store.close()
    assert table(path, "SELECT what FROM audit") == [("after",)]


async def test_where_nothing_can_be_written_the_gateway_runs_and_the_alarms_stand(tmp_path: Path) -> None:
    """A path below a file stands for any folder that takes nothing: it refuses root as well."""
    config = config_in(tmp_path, historian__path=tmp_path / "file" / "h.sqlite", control__path=tmp_path / "c.sock")
    (tmp_path / "file").write_text("no folder")
    status = await hot(config)
    assert status["alarms"][f"over limit {TEMPERATURE}"] == "unacknowledged"
    assert status["alarms"]["records"] == "unacknowledged"
    assert "give a path that this user may write" in status["historian"]["failure"]


def test_once_it_can_be_written_what_waited_is_stored_under_the_right_tag(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.write_text("not mounted yet")
    store, historian = one_machine(folder / "h.sqlite", (Tag("A", "holding:1"), Tag("B", "holding:2")), mend=True)
    historian.put("samples", [("B", EPOCH, 2.0, 0, None)])
    assert not historian.flush(0.2) and "cannot be made" in historian.complaint
    folder.unlink()
    folder.mkdir()
    assert historian.flush(60.0) and historian.failure == ""
    assert store.close()
    query = "SELECT name, value FROM samples JOIN tags ON tags.id = samples.tag"
    assert table(folder / "h.sqlite", query) == [("B", 2.0)]


def test_a_database_of_something_else_and_a_newer_layout_are_refused_and_left_alone(tmp_path: Path) -> None:
    foreign, newer = tmp_path / "foreign.sqlite", tmp_path / "newer.sqlite"
    with closing(sqlite3.connect(foreign)) as connection, connection:
        connection.execute("CREATE TABLE t (x)")
    written(newer, 10)
    with closing(sqlite3.connect(newer)) as connection:
        connection.execute("PRAGMA user_version = 4")
    for path, reason in ((foreign, "is a database of something else"), (newer, "has layout 4")):
        before = path.read_bytes()
        with pytest.raises(HistorianError, match=reason):
            open_historian(path, mend=True)
        assert path.read_bytes() == before
