"""The disk of the records becomes read-only, is full, or goes away under an armed gateway: nothing usable follows.

When it is writable again, all that was given to the PLC is on record, and so is what was not, and why.
"""

import asyncio
import os
import sqlite3
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from struct import pack
from typing import Any

import pytest

from gateway.plant.app import run
from gateway.settings import Config
from gateway.store.audit import DISARMED, read, verify
from tests.gateway.support import PacedClock, config_in, two_modes
from tests.gateway.test_pickup import ARMED, Plant

SOONER, AGAIN, LATER = 8, 20, 40


def mounted(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["mount", *words], capture_output=True, text=True, check=False)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own of 4 MB, or a skip where this user may not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    done = mounted("-t", "tmpfs", "-o", "size=4m", "tmpfs", str(place)) if os.geteuid() == 0 else None
    if done is None or done.returncode:
        pytest.skip(f"cannot mount a disk: {done.stderr.strip() if done else 'not root'}")
    try:
        yield place
    finally:
        while os.path.ismount(place):
            subprocess.run(["umount", "--lazy", str(place)], check=True)


def read_only(disk: Path) -> None:
    """Files that are open for writing keep a disk from being remounted: at its path it is mounted once more."""
    for words in (("--bind", str(disk), str(disk)), ("-o", "remount,bind,ro", str(disk))):
        done = mounted(*words)
        assert done.returncode == 0, done.stderr


def unmounted(disk: Path) -> None:
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


def fill(disk: Path) -> None:
    with (disk / "filler").open("wb", buffering=0) as stream, suppress(OSError):
        while True:
            stream.write(b"\0" * 4096)


def make_room(disk: Path) -> None:
    (disk / "filler").unlink()


async def seen(config: Config, deeds: dict[int, Callable[[], Any]]) -> tuple[dict[str, Any], Plant, list[int]]:
    """The last status, the bench, and how many blocks were written before each deed."""
    counts: list[int] = []

    failures: list[BaseException] = []

    def counted(deed: Callable[[], Any]) -> Callable[[], None]:
        def once() -> None:
            patient.undo()
            counts.append(len(bench.written))
            try:
                deed()
            except (AssertionError, OSError, subprocess.CalledProcessError) as error:
                failures.append(error)  # the gateway would take it for its device's, and go on

        return once

    bench = Plant(
        config, PacedClock(pause_s=0.01), armed=True, deeds={read: counted(deed) for read, deed in deeds.items()}
    )
    bench.stop_after = LATER
    # Until the disk is taken, no block is held back where it is only slow.
    with pytest.MonkeyPatch.context() as patient:
        patient.setattr("gateway.machine.writing.writeback.SENDING_SECONDS", 60.0)
        status = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    if failures:
        raise failures[0]
    return status, bench, counts


def armed_on(disk: Path, tmp_path: Path) -> Config:
    """Plant file, model and log lie elsewhere: what is taken are the records."""
    return config_in(
        tmp_path,
        '[historian]\npath = "disk/history.sqlite"\n',
        model=two_modes(),
        **ARMED,
        writeback__audit=disk / "audit.sqlite",
    )


def all_on_record(config: Config, bench: Plant) -> None:
    """Each block that reached the PLC has its row, and the chain is whole."""
    rows = {row.entry.detail["words"] for row in read(config.audit) if row.entry.kind == "write"}
    words = [pack(f">{len(block)}H", *map(int, block.values())).hex() for block in bench.written]
    assert words and [word for word in words if word not in rows] == []
    assert verify(config.audit).problem == ""
    with closing(sqlite3.connect(config.historian.path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


async def test_on_a_disk_that_becomes_read_only_nothing_usable_follows_and_nothing_is_lost(
    disk: Path, tmp_path: Path
) -> None:
    config = armed_on(disk, tmp_path)
    deeds = {SOONER: lambda: read_only(disk), AGAIN: lambda: unmounted(disk)}
    status, bench, (before, again) = await seen(config, deeds)
    assert before > 3
    assert [block["validity"] for block in bench.written[before:]] in ([0], []), "disarmed, until a person arms again"
    assert again <= before + 1 and status["alarms"]["records"] == "unacknowledged"
    assert status["writeback"]["mode"] == "shadow" and status["scan"]["count"] > AGAIN
    all_on_record(config, bench)
    assert DISARMED in [row.entry.kind for row in read(config.audit)]
    assert status["historian"]["dropped"] == 0


async def test_a_full_disk_holds_blocks_back_and_they_go_on_when_there_is_room(disk: Path, tmp_path: Path) -> None:
    config = armed_on(disk, tmp_path)
    status, bench, (before, again) = await seen(config, {SOONER: lambda: fill(disk), AGAIN: lambda: make_room(disk)})
    assert before > 3
    # A commit or two may find room in pages that the logs have already.
    assert again - before <= 4, (before, again)
    all_on_record(config, bench)
    assert status["historian"]["dropped"] == 0 and status["failures"] == 0


async def test_a_disk_that_goes_away_is_an_alarm_and_nothing_usable_follows(disk: Path, tmp_path: Path) -> None:
    config = armed_on(disk, tmp_path)
    status, bench, (before,) = await seen(config, {SOONER: lambda: unmounted(disk)})
    assert before > 3
    assert [block["validity"] for block in bench.written[before:]] in ([0], [])
    assert status["alarms"]["records"] == "unacknowledged" and status["writeback"]["mode"] == "shadow"
