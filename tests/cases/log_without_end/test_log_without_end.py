"""The log never rotated, grew by 75 kB a minute where a reason carried a changing number, and took ESC from names."""

import errno
import io
import json
import os
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

from gateway.plant.folding import MAX_FORMS, Folding
from gateway.plant.log import open_log
from gateway.plant.log_file import RETRY_SECONDS, LogFile
from gateway.settings import LogSection
from gateway.store import numbered_files


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for file in numbered_files(path) for line in file.read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize(
    "reason",
    [
        "no reply within {0:.4f} s",
        "127.0.0.1:{1} refused the connection",
        "('10.0.0.7', {1}) is gone, block {2} of 0x2100",
        "the same each time",
        "late by {3:g} s",
    ],
)
def test_a_reason_with_a_changing_number_is_one_line_and_a_count(tmp_path: Path, reason: str) -> None:
    path = tmp_path / "log.jsonl"
    with open_log(path) as log:
        for number in range(1000):
            text = reason.format(number / 7e3, 40_000 + number, number, number * 1e-7)
            log.warning("no reading", reason=text, sequence=number)
    first, folded = lines(path)
    assert (first["sequence"], folded["sequence"]) == (0, 999), "the newest stands for those before it"
    assert folded["repeated"] == 999 and folded["seconds"] > 0


def test_a_change_is_written_at_once_and_names_with_digits_are_names(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with open_log(path) as log:
        for tag in ("T1", "T2", "holding:100", "holding:101"):
            log.info("alarm", tag=tag)
        log.warning("alarm", tag="T1")
        for _ in range(3):
            log.info("link lost")
            log.info("link back")
        assert [row.get("tag", row["event"]) for row in lines(path)] == [
            *("T1", "T2", "holding:100", "holding:101", "T1"),
            *("link lost", "link back") * 3,
        ]


def test_what_floods_by_words_is_bounded_too(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with open_log(path) as log:
        for number in range(3000):
            log.warning("no reading", reason=f"transaction x{number:x} failed")
            log.warning("other", reason="between")
    assert len(lines(path)) < 3 * MAX_FORMS and sum(row.get("repeated", 1) for row in lines(path)) == 6000


def test_the_count_comes_also_where_no_line_follows(tmp_path: Path) -> None:
    folding = Folding(window=60.0)
    event = {"level": "info", "event": "x"}
    assert [folding.take(event, float(now)) for now in range(5)] == [True, *[False] * 4]
    assert folding.due(59.0) == [] and folding.waiting
    assert folding.due(60.0) == [{**event, "repeated": 4, "seconds": 3.0}] and not folding.waiting
    path = tmp_path / "log.jsonl"
    with open_log(path, fold_seconds=0.05) as log:
        for _ in range(5):
            log.info("again")
        for _ in range(200):
            if len(lines(path)) == 2:
                break
            time.sleep(0.02)
        assert lines(path)[-1]["repeated"] == 4


def test_a_new_file_is_begun_by_size_and_no_line_is_lost_but_the_oldest_files(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with open_log(path, rotation=LogSection(max_mb=0.01, keep=3)) as log:
        for number in range(2000):
            log.info(f"event x{number}")
    files = numbered_files(path)
    assert [file.name for file in files] == [*(f"log.jsonl.{number}" for number in (3, 2, 1)), "log.jsonl"]
    assert all(file.stat().st_size <= 10_000 for file in files)
    numbers = [int(row["event"].removeprefix("event x")) for row in lines(path)]
    assert numbers == list(range(numbers[0], 2000)) and len(numbers) > 200


def test_a_new_file_is_begun_by_age_also_after_a_restart_and_whatever_the_clock_does(tmp_path: Path) -> None:
    path, now = tmp_path / "log.jsonl", [1_700_000_000.0]
    path.write_text('{"event": "old", "timestamp": "2023-11-14T22:13:20Z"}\n')

    def once() -> int:
        file = LogFile(path, max_bytes=1 << 20, max_days=2.0, keep=2, wall=lambda: now[0])
        file.write('{"timestamp": "2023-11-14T22:13:20Z"}')
        file.close()
        return len(numbered_files(path))

    assert once() == 1
    now[0] += 1.9 * 86_400
    assert once() == 1
    now[0] += 0.2 * 86_400
    assert once() == 2
    now[0] -= 400 * 86_400  # the clock is set back
    assert once() == 3
    assert once() == 3, "two older files are kept"


@pytest.mark.parametrize("harm", ["folder removed", "file removed", "file moved"])
def test_a_log_that_was_removed_or_moved_is_made_anew(tmp_path: Path, harm: str) -> None:
    path, console = tmp_path / "logs" / "log.jsonl", io.StringIO()
    with open_log(path, console=console) as log:
        log.info("before")
        if harm == "folder removed":
            shutil.rmtree(path.parent)
        elif harm == "file removed":
            path.unlink()
        else:
            path.rename(tmp_path / "elsewhere")
        log.info("after")
        assert [row["event"] for row in lines(path)] == ["after"]
    assert "before" in console.getvalue() and "after" in console.getvalue()


def test_a_full_disk_neither_raises_nor_silences_the_console_nor_tears_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, console, now, room = tmp_path / "log.jsonl", io.StringIO(), [0.0], [300]
    whole = os.write

    def write(file: int, data: bytes) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        part = bytes(data[: room[0]])
        room[0] -= len(part)
        return whole(file, part)

    file = LogFile(path, max_bytes=1 << 20, max_days=30.0, keep=2, monotonic=lambda: now[0])
    monkeypatch.setattr("gateway.plant.log_file.os.write", write)
    for number in range(10):
        file.write(json.dumps({"event": f"line {number}", "more": "x" * 40}))
    assert file.lost > 0
    room[0], now[0] = 1 << 20, RETRY_SECONDS + 1.0
    file.write('{"event": "room again"}')
    file.close()
    rows = lines(path)  # each line is whole JSON
    assert [row["event"] for row in rows[-2:]] == ["log lines were lost", "room again"]
    assert rows[-2]["lines"] + len(rows) - 2 == 10
    monkeypatch.undo()
    if Path("/dev/full").exists():
        with open_log(Path("/dev/full"), console=console) as log:
            log.error("said all the same")
        assert "said all the same" in console.getvalue()


@pytest.mark.parametrize("bad", ["a\nb", "a\x1b[2Jb", "a\rb", "a\u2028b", "a\x9b2Jb", "a\u202eb", "a\ud800b", "a\0b"])
def test_control_characters_reach_neither_file_nor_console(tmp_path: Path, bad: str) -> None:
    path, console = tmp_path / "log.jsonl", io.StringIO()
    with open_log(path, console=console) as log:
        log.warning("armed", by=bad, reason=["in a list", bad], where={bad: bad})
        try:
            raise ValueError(bad)
        except ValueError:
            log.exception("failed", reason=bad)
    own = {"\n"}
    for text in (path.read_text(encoding="utf-8"), console.getvalue()):
        assert all(c.isprintable() or c in own for c in text), text
    rows = lines(path)
    assert len(rows) == 2 and rows[0]["by"] == bad.encode("unicode_escape").decode()
    assert "Traceback" in rows[1]["exception"]
