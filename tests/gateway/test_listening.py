"""What a running gateway listens on: what its configuration says, on loopback, and nothing else."""

import asyncio
import socket
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path

import pytest

from gateway.plant.app import run
from tests.gateway.support import Bench, JumpClock, config_in, logged

LISTENS = "0A"
"""The state of a listening socket in /proc/net/tcp (proc(5))."""
SERVERS = """
[page]
enabled = true
port = 0
[serve]
port = {free}
[northbound.metrics]
port = 0
[northbound.opcua]
port = 0
"""


def listening() -> set[str]:
    """The addresses on which this process listens for TCP, as text with their ports."""
    own = set()
    for number in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the folder itself, which is closed by then
            own.add(str(number.readlink()))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            columns = line.split()
            if columns[3] == LISTENS and f"socket:[{columns[9]}]" in own:
                digits, _, port = columns[1].partition(":")
                # Words of four bytes, each in the order of the machine.
                words = [bytes.fromhex(digits[place : place + 8])[::-1] for place in range(0, len(digits), 8)]
                found.add(f"{ip_address(b''.join(words))} {int(port, 16)}")
    return found


@pytest.mark.parametrize(("text", "servers"), [("", 0), (SERVERS, 4)])
async def test_nothing_listens_but_what_the_file_says_and_that_on_loopback(
    text: str, servers: int, tmp_path: Path
) -> None:
    pytest.importorskip("asyncua")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free = probe.getsockname()[1]
    config = config_in(tmp_path, text.format(free=free))
    bench = Bench(config, JumpClock())
    before = listening()
    work = asyncio.create_task(run(config, clock=bench.clock, stop=bench.stop, driver=bench))
    async with asyncio.timeout(120.0):
        while len(opened := listening() - before) < servers or bench.reads < 20:
            await asyncio.sleep(0.01)
    bench.stop.set()
    await work
    assert len(opened) == servers and all(ip_address(each.split()[0]).is_loopback for each in opened), opened
    assert not listening() - before, "it stays open"
    assert bool(servers) == any(line["event"] == "the page is served" for line in logged(tmp_path))
