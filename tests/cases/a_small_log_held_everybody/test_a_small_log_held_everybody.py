"""A compressed log of 3.2 MB held `trace ingest` for minutes, and with `--watch` everybody else's files too.

What a file unpacks to has a bound by its size, and no file's reading is waited for longer than a turn by those behind.
"""

import gzip
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from can.io.blf import (
    FILE_HEADER_SIZE,
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    OBJ_HEADER_BASE_STRUCT,
    ZLIB_DEFLATE,
)

from drivers.vehicle import log
from gateway.lab.ingestion import ingest
from gateway.lab.ingestion.archive import IngestOutcome, open_archive
from gateway.lab.ingestion.ingest import ingest_units, watch_folder
from gateway.lab.ingestion.recognising import IngestUnit, RecognisedUnit, list_units

LINE = b"(1627274455.023950) can0 7E8#03412F8C00000000\n"
FREE = 1 << 16
LINES = 400_000


@pytest.fixture(autouse=True)
def _little_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "UNPACKED_FREE_BYTES", FREE, raising=False)


def most_of(path: Path) -> int:
    return FREE + 64 * path.stat().st_size


@pytest.mark.parametrize("content", [LINE * LINES, b"\0" * len(LINE) * LINES])
def test_what_a_compressed_text_unpacks_to_has_a_bound(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.log.gz"
    path.write_bytes(gzip.compress(content))
    assert most_of(path) < len(content) / 2
    opened = log.open_log(path)
    frames = sum(1 for _ in opened.frames())
    assert frames * len(LINE) <= most_of(path) and "unpacks to more than" in opened.summary()
    assert opened.counts["broken"] == 1


def test_a_whole_log_is_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "x.log.gz"
    content = b"".join(b"(%d.%06d) can0 7E8#%016X\n" % (n, n * 7919 % 1_000_000, n * 2**40 // 977) for n in range(3000))
    path.write_bytes(gzip.compress(content))
    assert len(content) > FREE
    opened = log.open_log(path)
    assert sum(1 for _ in opened.frames()) == 3000 and not opened.problem


def blf_bomb(path: Path, unpacked: int) -> None:
    """A BLF file of one container that unpacks to so many zeros."""
    whole = path.with_name("whole.blf")
    with can.BLFWriter(whole) as writer:
        writer.on_message_received(can.Message(arbitration_id=1, data=b"1", timestamp=1.0))
    packed = LOG_CONTAINER_STRUCT.pack(ZLIB_DEFLATE, unpacked) + zlib.compress(b"\0" * unpacked)
    length = OBJ_HEADER_BASE_STRUCT.size + len(packed)
    head = OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", OBJ_HEADER_BASE_STRUCT.size, 1, length, LOG_CONTAINER)
    path.write_bytes(whole.read_bytes()[:FILE_HEADER_SIZE] + head + packed + b"\0" * (length % 4))
    whole.unlink()


def test_what_a_container_of_a_blf_unpacks_to_has_a_bound(tmp_path: Path) -> None:
    path = tmp_path / "x.blf"
    blf_bomb(path, 1 << 24)
    opened = log.open_log(path)
    assert not list(opened.frames()) and "unpacks to more than" in opened.summary()


def test_an_object_that_says_it_is_huge_unpacks_no_more_of_its_file(tmp_path: Path) -> None:
    whole, path = tmp_path / "x.blf", tmp_path / "x.blf.gz"
    blf_bomb(whole, 1000)
    head = OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", OBJ_HEADER_BASE_STRUCT.size, 1, 0xFFFFFFFF, LOG_CONTAINER)
    path.write_bytes(gzip.compress(whole.read_bytes()[:FILE_HEADER_SIZE] + head + b"\0" * (1 << 24)))
    opened = log.open_log(path)
    assert not list(opened.frames()) and "unpacks to more than" in opened.summary()


def test_a_log_of_several_containers_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "x.blf"
    with can.BLFWriter(path, max_container_size=2000) as writer:
        for number in range(500):
            writer.on_message_received(
                can.Message(arbitration_id=number, data=struct.pack("<Q", number), timestamp=1.0 + number)
            )
    opened = log.open_log(path)
    assert [frame.id for frame in opened.frames()] == list(range(500)) and not opened.problem


@pytest.mark.parametrize(
    ("at", "with_", "words"),
    [
        (FILE_HEADER_SIZE + OBJ_HEADER_BASE_STRUCT.size, b"\x63\0", "packed in a way that is not known (99)"),
        (FILE_HEADER_SIZE + 8, b"\3\0\0\0", "an object without a length"),
    ],
)
def test_a_container_that_cannot_be_read_is_not_passed_over(tmp_path: Path, at: int, with_: bytes, words: str) -> None:
    path = tmp_path / "x.blf"
    blf_bomb(path, 1000)
    content = bytearray(path.read_bytes())
    content[at : at + len(with_)] = with_
    path.write_bytes(content)
    opened = log.open_log(path)
    assert not list(opened.frames()) and words in opened.summary()


def test_a_container_that_is_cut_short_is_said(tmp_path: Path) -> None:
    path = tmp_path / "x.blf"
    blf_bomb(path, 100_000)
    content = path.read_bytes()
    packed = zlib.compress(b"\0" * 100_000)
    path.write_bytes(content.replace(packed, packed[:-20] + b"\0" * 20))
    opened = log.open_log(path)
    assert not list(opened.frames()) and opened.problem


# ---------------------------------------------------------------- turns


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Files of three sources; `a_slow.log` is read only until `others` were taken, or a while."""
    here = tmp_path / "usb"
    for name in ("a_slow", "b", "c"):
        (here / name).mkdir(parents=True)
        (here / name / f"{name}.log").write_bytes(LINE * (1 + ord(name[0])))
    monkeypatch.setattr(ingest, "TURN_SECONDS", 0.05, raising=False)
    yield here


def held(monkeypatch: pytest.MonkeyPatch, until_set: threading.Event) -> None:
    """Have the slow file's reading done only once it is set."""
    read: Callable[..., RecognisedUnit] = ingest.recognise

    def slowly(unit: IngestUnit, maps: Any) -> RecognisedUnit:
        known = read(unit, maps)
        if unit.source.name == "a_slow.log":
            assert until_set.wait(30.0), "the others wait for it"
        return known

    monkeypatch.setattr(ingest, "recognise", slowly)


def test_those_behind_a_slow_file_do_not_wait_for_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = threading.Event()
    held(monkeypatch, others)
    order: list[str] = []
    with open_archive(tmp_path / "archive") as archive:
        units = list_units(folder, tmp_path / "archive")
        for outcome in ingest_units(units, archive, {}, move=False, clock=lambda: 1.0):
            assert outcome.verdict == "taken", outcome
            order.append(outcome.source.name)
            if order == ["b.log", "c.log"]:
                others.set()
    assert order == ["b.log", "c.log", "a_slow.log"]


def test_a_watch_takes_others_files_while_it_reads_a_slow_one(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = threading.Event()
    held(monkeypatch, others)
    order: list[str] = []

    class Over(Exception):
        pass

    def keep(outcome: IngestOutcome) -> None:
        assert outcome.verdict == "taken", outcome
        order.append(outcome.source.name)
        if order == ["b.log", "c.log"]:
            (folder / "d").mkdir()
            (folder / "d/d.log").write_bytes(LINE)
        elif order[-1] == "d.log":
            others.set()  # one that came while it was read was taken, too
        elif len(order) == 4:
            raise Over

    with pytest.raises(Over):
        watch_folder(
            folder, tmp_path / "archive", {}, move=True, every=0.05, rest=0.0, seconds=100.0,
            show=lambda _: None, keep=keep,
        )  # fmt: skip
    assert order == ["b.log", "c.log", "d.log", "a_slow.log"]
    assert not list(folder.rglob("*.log"))


def test_a_file_that_changes_while_it_is_read_is_not_taken_as_what_it_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = threading.Event()
    held(monkeypatch, others)
    outcomes: dict[str, IngestOutcome] = {}
    with open_archive(tmp_path / "archive") as archive:
        units = list_units(folder, tmp_path / "archive")
        for outcome in ingest_units(units, archive, {}, move=False, clock=lambda: 1.0):
            outcomes[outcome.source.name] = outcome
            if len(outcomes) == 2:
                (folder / "a_slow/a_slow.log").write_bytes(b"no log")
                others.set()
    slow = outcomes["a_slow.log"]
    assert slow.verdict == "refused" and slow.passes and "changed while it was read" in slow.sentence
