"""Raw CAN on this machine: frames a second through the driver, a verified write, and 20,000 frames of garbage.

The bus is a hub in a process of its own, the strange programs on it are processes too. Each figure stands against what
a bare python-can program does on the same bus in the same run.
"""

import asyncio
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import can
import click

from benchmarks.figures import Figure, give, shares
from drivers.can.bus.access import open_bus
from drivers.can.driver import open_can
from drivers.can.protection import Protection, protect_frame
from drivers.tag import DType, Tag
from gateway.settings.devices import load_device

DEVICE = Path(__file__).parents[1] / "config" / "devices" / "decanter_can.toml"
FRAMES = 60_000
WRITES = 2_000
GARBAGE = 10_000
LEVEL, MODE = Tag("level", "0x181:0|32", DType.UINT32), Tag("mode", "0x201:0|32", DType.UINT32)
ECHO = {"0x201": "0x281"}
TRUE_C = 61.25
OWN = ((0x100, 6), (0x110, 4), (0x120, 7), (0x121, 7), (0x130, 7), (0x131, 7), (0x132, 7), (0x133, 5), (0x140, 8))
"""The PLC's messages of config/decanter.dbc and their lengths."""

SENDER = """
import sys
import can
bus = can.Bus(interface="hub", channel=sys.argv[1])
count = int(sys.argv[2])
sys.stdin.readline()
for place in range(count):
    data = place.to_bytes(4, "little")
    bus.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=data, check=False))
bus.shutdown()
"""
ECHOER = """
import sys
import can
bus = can.Bus(interface="hub", channel=sys.argv[1])
print("ready", flush=True)
for message in bus:
    if message.arbitration_id == 0x201:
        bus.send(can.Message(arbitration_id=0x281, is_extended_id=False, data=message.data, check=False))
"""


@contextmanager
def hub(folder: Path) -> Iterator[str]:
    """A hub as a process; gives its path."""
    path = str(folder / "bus")
    command = [sys.executable, "-m", "drivers.can.bus.hub", path, "--queue", "1000000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield path
        finally:
            process.terminate()


@contextmanager
def program(code: str, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """A bare python-can program as a process; killed on leaving."""
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code, *arguments], stdin=pipe, stdout=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def start(process: "subprocess.Popen[str]") -> None:
    """Let the sender begin, once it has joined."""
    assert process.stdin is not None
    time.sleep(0.7)
    process.stdin.write("go\n")
    process.stdin.flush()


def bare_frames(path: str, frames: int) -> tuple[float, float]:
    """Frames a second, and CPU seconds of this process for each million, that a bare program takes from the bus."""
    with open_bus("hub", path) as bus, program(SENDER, path, str(frames)) as sender:
        start(sender)
        assert bus.recv(10.0) is not None
        begin, cpu, got = time.perf_counter(), time.process_time(), 1
        while got < frames and bus.recv(2.0) is not None:
            got += 1
        return got / (time.perf_counter() - begin), (time.process_time() - cpu) / got * 1e6


async def driver_frames(path: str, frames: int) -> tuple[float, float, float]:
    """Frames a second through the driver while a tag is read every 10 ms, its CPU, and the share that arrived."""
    driver = open_can({"interface": "hub", "channel": path}, clock=time.time)
    await driver.open()
    await driver.read([LEVEL])
    with program(SENDER, path, str(frames)) as sender:
        await asyncio.to_thread(start, sender)
        while driver.statistics()["frames"] == 0:
            await asyncio.sleep(0.001)
        begin, cpu, last = time.perf_counter(), time.process_time(), time.perf_counter()
        seen = 0.0
        while seen < frames and time.perf_counter() - last < 2.0:
            await asyncio.sleep(0.01)
            await driver.read([LEVEL])
            now = driver.statistics()["frames"]
            if now > seen:
                seen, last = now, time.perf_counter()
        used = time.process_time() - cpu
    await driver.close()
    return seen / (last - begin), used / seen * 1e6, seen / frames


def bare_round_trips(path: str, count: int) -> list[float]:
    """Milliseconds from a frame to its echo for a bare program."""
    with open_bus("hub", path) as bus, program(ECHOER, path) as device:
        assert device.stdout is not None
        device.stdout.readline()
        time.sleep(0.1)
        times = []
        for place in range(count):
            begin = time.perf_counter()
            bus.send(can.Message(arbitration_id=0x201, is_extended_id=False, data=place.to_bytes(4, "little")))
            assert bus.recv(2.0) is not None
            times.append((time.perf_counter() - begin) * 1000.0)
        return times


async def verified_writes(path: str, count: int) -> list[float]:
    """Milliseconds of the driver's verified writes of one frame to the same program."""
    settings = {"interface": "hub", "channel": path, "echo": ECHO}
    driver = open_can(settings, clock=time.time, write_map=(MODE,))
    with program(ECHOER, path) as device:
        assert device.stdout is not None
        await asyncio.to_thread(device.stdout.readline)
        await driver.open()  # not before: a bus on which nothing is heard for two seconds is opened anew
        await asyncio.sleep(0.1)
        times = []
        for place in range(count):
            begin = time.perf_counter()
            await driver.write([(MODE, place)])
            times.append((time.perf_counter() - begin) * 1000.0)
    await driver.close()
    return times


async def garbage(
    path: str, frames: int, payload: Callable[[random.Random], tuple[int, bytes]]
) -> tuple[int, int, int]:
    """(good readings, wrong ones among them, frames refused) while garbage falls between the true frames.

    The map is the decanter's. The true frames say TRUE_C in one message; any other good value is a wrong one.
    """
    device = load_device(DEVICE)
    driver = open_can({**device.settings, "interface": "hub", "channel": path}, clock=time.time)
    await driver.open()
    await driver.read(device.tags)
    rng, good, wrong = random.Random(7), 0, 0
    guard, body = Protection(0x130), bytes(3) + b"\x00\x00\x75\x42"
    with open_bus("hub", path) as bus:
        await asyncio.sleep(0.2)
        for place in range(frames):
            number, data = payload(rng)
            bus.send(can.Message(arbitration_id=number, is_extended_id=False, data=data))
            if place % 20 == 0:
                true = protect_frame(guard, place // 20, body)
                bus.send(can.Message(arbitration_id=0x130, is_extended_id=False, data=true))
                await asyncio.sleep(0)
                for sample in await driver.read(device.tags):
                    good += sample.quality.is_good
                    right = sample.tag == "TCuscinettiRiduttore" and sample.value == TRUE_C
                    wrong += sample.quality.is_good and not right
        await asyncio.sleep(0.3)
        refused = int(driver.statistics()["frames_refused"])
    await driver.close()
    return good, wrong, refused


def any_frame(rng: random.Random) -> tuple[int, bytes]:
    """Any id, any length."""
    return rng.randrange(0x800), rng.randbytes(rng.randrange(9))


def own_frame(rng: random.Random) -> tuple[int, bytes]:
    """One of the PLC's own ids, of its right length: the worst that a strange node can do."""
    number, length = rng.choice(OWN)
    return number, rng.randbytes(length)


def measured(frames: int, writes: int, noise: int) -> Sequence[Figure]:
    """All figures."""
    with tempfile.TemporaryDirectory(prefix="decanter-can-") as folder, hub(Path(folder)) as path:
        bare_rate, bare_cpu = bare_frames(path, frames)
        rate, cpu, share = asyncio.run(driver_frames(path, frames))
        trips = bare_round_trips(path, writes)
        written = asyncio.run(verified_writes(path, writes))
        good_any, wrong_any, refused_any = asyncio.run(garbage(path, noise, any_frame))
        good_own, wrong_own, refused_own = asyncio.run(garbage(path, noise, own_frame))
    return [
        Figure("frames through the driver", rate, "1/s", "bare python-can program on the hub", bare_rate),
        Figure("processor time of a frame", cpu, "us", "bare python-can program on the hub", bare_cpu),
        Figure("share of the frames that arrived", 100.0 * share, "%"),
        *shares("verified write of a frame", "ms", written, "bare frame and its echo", trips),
        Figure(f"wrong good values, {noise} random frames", wrong_any, "", "good values", good_any),
        Figure("of those frames refused", refused_any, ""),
        Figure(f"wrong good values, {noise} random frames with own ids", wrong_own, "", "good values", good_own),
        Figure("of those frames refused (own ids)", refused_own, ""),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Less of everything: whether it works, not how fast it is.")
def main(as_json: bool, quick: bool) -> None:
    figures = measured(FRAMES // 10, WRITES // 10, GARBAGE // 10) if quick else measured(FRAMES, WRITES, GARBAGE)
    give("can", figures, as_json=as_json)


if __name__ == "__main__":
    main()
