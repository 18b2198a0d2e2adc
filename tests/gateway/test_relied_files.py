"""What is noticed of files that are relied on, one thing after the other, and what is not worth a word."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from gateway.store.relied_files import FIXED, GROWS, FileRule, ReliedFiles, database


def relied(path: Path, rule: FileRule = GROWS, text: str = "one\n") -> ReliedFiles:
    path.write_text(text)
    files = ReliedFiles()
    files.watch("file", {path: rule})
    assert files.look() == ""
    return files


def test_it_grows_and_nothing_is_said_until_it_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "heads"
    files = relied(path)
    with path.open("a") as stream:
        stream.write("two\n")
    assert files.look() == "" and files.taken == 0
    os.truncate(path, 3)
    assert files.look().startswith(f"{path}: was cut to 3 bytes") and files.taken == 1
    with path.open("a") as stream:
        stream.write("another\n")
    assert files.look() == "" and "was cut" in files.note and files.taken == 1, "it stands until the next start"


def test_a_file_that_gets_the_number_of_the_one_that_was_removed_is_another(tmp_path: Path) -> None:
    path = tmp_path / "heads"
    files = relied(path)
    for _ in range(50):
        path.unlink()
        path.write_text("one\ntwo\n")
        assert "is another file" in files.look()


def test_a_disk_that_is_mounted_read_only_now_is_noticed_and_one_that_always_was_is_not(tmp_path: Path) -> None:
    path, read_only = tmp_path / "key", [False]
    path.write_text("secret")
    for at_first in (False, True):
        read_only[0] = at_first
        files = ReliedFiles(lambda _: read_only[0])
        files.watch("signing key", {path: FIXED})
        assert files.look() == ""
        read_only[0] = True
        assert bool(files.look()) is not at_first


def test_only_the_content_of_what_is_only_read_matters(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    files = relied(path, FIXED, "{}")
    path.touch()
    copy = tmp_path / "copy"
    copy.write_text("{}")
    copy.replace(path)
    assert files.look() == ""
    path.write_text("[]")
    assert "has another content" in files.look()
    path.write_text("{}")
    assert files.look() == "" and files.taken == 1


def test_what_comes_later_is_relied_on_from_then_on(tmp_path: Path) -> None:
    path, files = tmp_path / "heads", ReliedFiles()
    files.watch("heads", {path: FileRule(grows=True, late=True)})
    assert files.look() == ""
    path.write_text("one\n")
    assert files.look() == ""
    path.unlink()
    assert "is gone" in files.look()


def test_what_is_forgotten_may_go_and_is_held_no_more(tmp_path: Path) -> None:
    path = tmp_path / "heads"
    before = len(list(Path("/proc/self/fd").iterdir()))
    files = relied(path)
    files.forget("file")
    path.unlink()
    assert files.look() == "" and len(list(Path("/proc/self/fd").iterdir())) == before


def test_an_index_that_was_cut_under_a_database_ends_nobody(tmp_path: Path) -> None:
    """The kernel ended the process that looked there: it is given its length back, and made anew from the WAL."""
    path = tmp_path / "a.sqlite"
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE t (x)")
        files = ReliedFiles()
        files.watch("database", database(path, GROWS))
        assert files.look() == ""
        os.truncate(f"{path}-shm", 0)
        assert "a.sqlite-shm: was cut to 0 bytes" in files.look()
        connection.execute("INSERT INTO t VALUES (1)")
        assert connection.execute("SELECT x FROM t").fetchall() == [(1,)]
        files.forget("database")
