"""An MF4 log whose list of blocks leads back to one of its own kept asammdf in place for ever; `make fuzz` found it."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from drivers.vehicle.log import Log, has_loop


def mdf(blocks: Mapping[int, tuple[bytes, list[int]]]) -> bytes:
    """An MF4 file of nothing but blocks: id and links by place."""
    data = bytearray(b"MDF     4.10    ".ljust(1024, b"\0"))
    for at, (name, links) in blocks.items():
        block = name + bytes(4) + (24 + 8 * len(links)).to_bytes(8, "little") + len(links).to_bytes(8, "little")
        block += b"".join(link.to_bytes(8, "little") for link in links)
        data[at : at + len(block)] = block
    return bytes(data)


HEAD = (b"##HD", [200, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("blocks", "circles"),
    [
        ({200: (b"##DG", [300, 400, 0]), 300: (b"##DG", [0, 500, 0]), 400: (b"##CG", [0, 0])}, False),
        ({200: (b"##DG", [300, 400, 0]), 300: (b"##DG", [0, 400, 0]), 400: (b"##CG", [0, 0])}, False),
        ({200: (b"##DG", [0, 0, 300]), 300: (b"##DT", [300, 300])}, False),
        ({200: (b"##DG", [200, 0, 0])}, True),
        ({200: (b"##DG", [0, 300, 0]), 300: (b"##CG", [400, 0]), 400: (b"##CG", [300, 0])}, True),
        ({200: (b"##DG", [0, 300, 0]), 300: (b"##CG", [0, 400]), 400: (b"##CN", [0, 400])}, True),
        ({200: (b"##DG", [0, 0, 300]), 300: (b"##DL", [300])}, True),
    ],
)
def test_lists_that_come_back_to_themselves_are_seen_before_the_library_follows_them(
    tmp_path: Path, blocks: Mapping[int, tuple[bytes, list[int]]], circles: bool
) -> None:
    path = tmp_path / "log.mf4"
    path.write_bytes(mdf({64: HEAD, **blocks}))
    with path.open("rb") as stream:
        assert has_loop(stream) is circles
    if circles:
        log = Log(path, "mf4", size=path.stat().st_size)
        assert list(log.frames()) == [] and "comes back to itself" in log.problem and log.counts["broken"] == 1
