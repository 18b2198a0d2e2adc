"""A power cut at a drawn moment leaves a chain that verifies and a row for each block that the PLC had received."""

import shutil
from pathlib import Path
from random import Random

import pytest

from benchmarks.power_cuts import cuts, worked
from tests.rig.power_cut import DiskCall, DiskChange, disk_after

CUTS = 40
FILE = Path("/records/file")


def test_what_was_synced_is_there_and_what_was_not_may_be() -> None:
    folder = FILE.parent
    changes = [
        DiskChange(1.0, DiskCall.WRITE, FILE, 0, b"synced"),
        DiskChange(2.0, DiskCall.SYNC, FILE, 0, b""),
        DiskChange(3.0, DiskCall.WRITE, FILE, 6, b" or not"),
        DiskChange(4.0, DiskCall.TRUNCATE, FILE, 2, b""),
        DiskChange(5.0, DiskCall.REMOVE, FILE, 0, b""),
        DiskChange(6.0, DiskCall.SYNC, folder, 0, b""),
    ]
    assert {disk_after(changes, 2.5, Random(seed)).get(FILE) for seed in range(50)} == {b"synced"}
    drawn = {disk_after(changes, 4.5, Random(seed)).get(FILE) for seed in range(50)}
    assert drawn == {b"synced", b"synced or not", b"sy"}
    assert {disk_after(changes, 6.5, Random(seed)).get(FILE) for seed in range(50)} == {None}


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler (apt-get install gcc libc6-dev)")
@pytest.mark.timeout(1200)
def test_cuts_lose_no_block_and_break_no_chain(tmp_path: Path) -> None:
    aftermath = worked(tmp_path, 4.0)
    assert len(aftermath.recording.blocks) > 30
    assert cuts(aftermath, CUTS, 0, tmp_path) == {}
