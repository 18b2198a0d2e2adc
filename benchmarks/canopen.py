"""CANopen on this machine: how soon a TPDO's change is a prediction in the PLC's object, frames a second, and garbage.

The bus is a hub in a process of its own, the PLC another, the gateway a third (`decanter run`, armed, with model and
historian, its scan once a second). This process forces the current to another bin at random moments. All moments are
the PLC's own (its recording, one clock):

    change    the program puts the new value into the image
    TPDO      the frame that holds it goes out
    block     the last of the six RPDOs of the block that was made of it is taken, and its checks are passed

A change counts only if its block proves it: its location differs from that of the block before. The yardstick is the
canopen library alone on the same bus in the same run: an SDO upload from the same PLC, after pauses as long.

Frames: valid TPDOs of one node, as fast as a sender can, through the driver and through the bare library. Garbage:
10,000 random frames of any identifier and length, and as many with the node's own identifiers and lengths, while the
driver reads the PLC; the PLC's recording is the judge of every value that was good.
"""

import asyncio
import io
import random
import subprocess
import sys
import tempfile
import time
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import can
import canopen
import click
import numpy as np
from canopen.objectdictionary.eds import import_eds

from benchmarks.can import hub
from benchmarks.canopen_rig import DEVICE, NODE, canopen_rig, face
from benchmarks.figures import Figure, give, shares
from drivers.can.bus.hub_bus import HubBus
from drivers.canopen.driver import open_canopen
from drivers.driver import Driver, open_driver
from drivers.errors import DriverError
from drivers.tag import Sample
from gateway.demo.can_bus import can_hub
from gateway.machine.reading.clock import PlantClock
from gateway.settings.devices import DeviceMap, load_device
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import BlockRow, PlcRecording, read_recording
from sim.sha.trace import Trace
from tests.rig.pair import CURRENT, PATIENCE_S, ROOT, RUNNING, TEMPERATURE, Plc, make_rig, restless_trace
from tests.rig.stalls import longest_pause

CHANGES, PERIOD = 300, 1.0
CURRENTS = (150.0, 250.0)
FRAMES, GARBAGE = 60_000, 10_000
OWN_TPDO = 0x180 + NODE
TRANSPORT_S = 0.05
"""What a value may be older than its time says: the way over the bus on a busy machine."""

SENDER = """
import sys, time, can
from drivers.can.bus.hub_bus import HubBus
bus = HubBus(sys.argv[1])
count = int(sys.argv[2])
def send(number, data):
    bus.send(can.Message(arbitration_id=number, is_extended_id=False, data=data, check=False))
for line in sys.stdin:
    if line == "beat\\n":
        send(0x701, b"\\x05")
        continue
    for place in range(count):
        if place % 1000 == 0:
            send(0x701, b"\\x05")
        send(0x181, place.to_bytes(8, "little"))
    send(0x701, b"\\x05")
    break
bus.shutdown()
"""


class BenchmarkError(click.ClickException):
    """What was to be measured did not happen; the message says what."""


# ---------------------------------------------------------------- latency


@dataclass(frozen=True, slots=True)
class Latency:
    """Milliseconds: change to block and TPDO to block of each change, and the library's round trips between them."""

    total: list[float]
    from_tpdo: list[float]
    bare: list[float]


def quiet_trace(seconds: float) -> Trace:
    """A machine that runs and does nothing else: what changes is what is forced."""
    times = np.arange(0.0, seconds, 1.0)
    held = {RUNNING: 1.0, CURRENT: CURRENTS[0], TEMPERATURE: 40.0, "TCuscinettiAlimentazione": 40.0}
    return Trace("quiet", times, {name: np.full(times.shape, value) for name, value in held.items()}, synthetic=True)


def latency(folder: Path, changes: int, seed: int) -> Latency:
    """Provoke the changes and follow each to its block. Raises BenchmarkError if one cannot be followed."""
    rng = random.Random(seed)
    with canopen_rig(folder, quiet_trace(60.0 + 2.0 * changes), period=PERIOD) as (rig, options):
        with rig.plc(*options) as plc, rig.gateway(plc) as gateway:
            gateway.wait_for(lambda status: status["writeback"].get("last_verdict") == "written")
            time.sleep(2.0)
            since = time.monotonic()
            bare = _provoke(plc, Path(plc.ready["faces"]["canopen"]["channel"]), changes, rng)
            until = time.monotonic()
            code, _ = gateway.stop()
            plc.order("stop")
            plc.wait_for("stopped")
        recording = read_recording(rig.recording)
    if code:
        raise BenchmarkError(f"the gateway ended with code {code}")
    return _followed(recording, since, until, changes, bare)


def _provoke(plc: Plc, hub: Path, changes: int, rng: random.Random) -> list[float]:
    """Force the current to and fro, and ask the PLC by the bare library in between; the library's milliseconds."""
    network = canopen.Network(HubBus(str(hub)))
    network.NOTIFIER_CYCLE = 0.05
    network.connect()
    remote = network.add_node(NODE, str(ROOT / "config/decanter.eds"))
    bare = []
    try:
        for number in range(changes):
            time.sleep(rng.uniform(0.05, 0.15))
            begin = time.perf_counter()
            remote.sdo.upload(0x1008, 0) if number == 0 else remote.sdo.upload(0x2001, 1)
            bare.append(1e3 * (time.perf_counter() - begin))
            time.sleep(rng.uniform(0.05, 0.15))
            accepted = plc.order("status")["accepted"]
            plc.order("force", tag=CURRENT, value=CURRENTS[(number + 1) % 2])
            # A change that is overtaken by the next one before anybody has read it cannot be followed.
            answered = time.monotonic() + PATIENCE_S
            while plc.order("status")["accepted"] == accepted and time.monotonic() < answered:
                time.sleep(0.002)
        time.sleep(0.5)
    finally:
        network.disconnect()
    return bare


def _followed(recording: PlcRecording, since: float, until: float, changes: int, bare: list[float]) -> Latency:
    truth = [row for row in recording.truth if row.tag == CURRENT and since < row.monotonic < until]
    frames = [row for row in recording.frames if row.sent and row.id == OWN_TPDO and row.data]
    blocks = [row for row in recording.blocks if row.accepted]
    total, work = [], []
    for row in truth:
        raw = round(float(row.value or 0.0) / 0.1).to_bytes(2, "little")
        frame = next((one for one in frames if one.monotonic >= row.monotonic and (one.data or b"")[4:6] == raw), None)
        block = None if frame is None else _proven(blocks, frame.monotonic)
        if frame is None or block is None:
            raise BenchmarkError(f"the change at {row.monotonic:.3f} s was not followed to a block that proves it")
        total.append(1e3 * (block.monotonic - row.monotonic))
        work.append(1e3 * (block.monotonic - frame.monotonic))
    if len(truth) != changes:
        raise BenchmarkError(f"{len(truth)} changes were recorded, and {changes} were forced")
    return Latency(total, work, bare)


def _proven(blocks: Sequence[BlockRow], moment: float) -> BlockRow | None:
    """The first block after the moment that says another location than the last one before it."""
    at = bisect_right([block.monotonic for block in blocks], moment)
    before = (blocks[at - 1].fields or {}).get("location") if at else None
    return next((block for block in blocks[at:] if (block.fields or {}).get("location") != before), None)


# ---------------------------------------------------------------- frames a second


@contextmanager
def sender(path: Path, frames: int) -> Iterator["subprocess.Popen[str]"]:
    """A process that sends the node's TPDO 1 and heartbeats as fast as it can, when it is told."""
    command = [sys.executable, "-c", SENDER, str(path), str(frames)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            yield process
        finally:
            process.kill()


def _tell(process: "subprocess.Popen[str]", word: str) -> None:
    assert process.stdin is not None
    process.stdin.write(word + "\n")
    process.stdin.flush()


async def driver_rate(path: Path, frames: int) -> tuple[float, float]:
    """PDOs a second through the driver while a tag is read every 10 ms, and the share that arrived."""
    device = load_device(DEVICE)
    own = {"interface": "hub", "channel": str(path), "listen_only": True, "life": None}
    settings = {key: value for key, value in {**device.settings, **own}.items() if value is not None}
    driver = open_canopen(settings, clock=time.time)
    with sender(path, frames) as process:
        await asyncio.sleep(0.7)
        opening = asyncio.create_task(driver.open())
        while not opening.done():
            _tell(process, "beat")
            await asyncio.sleep(0.05)
        await opening
        _tell(process, "go")
        while driver.statistics()["pdos"] == 0:
            await asyncio.sleep(0.001)
        begin = last = time.perf_counter()
        seen = 0.0
        while seen < frames and time.perf_counter() - last < 2.0:
            await asyncio.sleep(0.01)
            await driver.read(device.tags)
            now = driver.statistics()["pdos"]
            if now > seen:
                seen, last = now, time.perf_counter()
    await driver.close()
    return seen / (last - begin), seen / frames


def library_rate(path: Path, frames: int) -> tuple[float, float]:
    """The same through the bare library: a callback that counts."""
    network = canopen.Network(HubBus(str(path)))
    network.NOTIFIER_CYCLE = 0.05
    network.connect()
    dictionary = import_eds(io.StringIO((ROOT / "config/decanter.eds").read_text(encoding="utf-8")), NODE)
    tpdo = network.add_node(NODE, dictionary).tpdo[1]
    tpdo.read(from_od=True)
    count, times = 0, [0.0, 0.0]

    def heard(_: object) -> None:
        nonlocal count
        times[1] = time.perf_counter()
        times[0] = times[0] or times[1]
        count += 1

    tpdo.add_callback(heard)
    with sender(path, frames) as process:
        time.sleep(0.7)
        _tell(process, "go")
        while count == 0 or (count < frames and time.perf_counter() - times[1] < 2.0):
            time.sleep(0.01)
    network.disconnect()
    return count / (times[1] - times[0]), count / frames


# ---------------------------------------------------------------- garbage


@dataclass(frozen=True, slots=True)
class Garbage:
    """What came of so many random frames: readings that were good, wrong ones among them, frames that were refused."""

    frames: int
    good: int
    wrong: int
    refused: int
    examples: tuple[str, ...]
    still_s: float
    """The longest time in which the PLC, or a round of frames and readings, did not get on."""


async def _all_good(driver: Driver, device: DeviceMap) -> Sequence[Sample]:
    """The readings once all of them are good; the last ones if they never are."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        read = await driver.read(device.tags)
        if all(sample.quality.is_good for sample in read) or time.monotonic() > deadline:
            return read
        await asyncio.sleep(0.01)


async def garbage(folder: Path, frames: int, *, own: bool, seed: int = 7) -> Garbage:
    """Random frames between the true ones of a PLC that changes all the time; every good value is judged by it.

    `own`: with identifiers and lengths of the node's TPDOs, which is the worst that a stranger can do.
    """
    rig = make_rig(folder, restless_trace(120.0), period=PERIOD)
    read: list[Sample] = []
    with can_hub(folder) as path, rig.plc(*face(path)) as plc:
        clock = PlantClock(plc.ready["epoch"], plc.ready["monotonic"], plc.ready["speed"])
        device = load_device(DEVICE)
        settings = {**device.settings, "interface": "hub", "channel": str(path), "configure": True}
        driver = open_driver("canopen", settings, clock=clock.now)
        with suppress(DriverError):  # the node may not be up yet; the driver goes on by itself
            await driver.open()
        await _all_good(driver, device)
        rng, talker = random.Random(seed), HubBus(str(path))
        lengths = {0x181: 8, 0x281: 6, 0x381: 6, 0x481: 8, 0x1C1: 6, 0x2C1: 8, 0x3C1: 8}
        longest, begun = 0.0, time.monotonic()
        for number in range(frames):
            if own:
                identifier = rng.choice(list(lengths))
                data = rng.randbytes(lengths[identifier])
            else:
                identifier, data = rng.randrange(0x800), rng.randbytes(rng.randrange(9))
            talker.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
            if number % 20 == 0:
                await asyncio.sleep(0.01)
                read += await driver.read(device.tags)
                longest, begun = max(longest, time.monotonic() - begun), time.monotonic()
        await asyncio.sleep(0.3)
        alive = await _all_good(driver, device)
        counts = driver.statistics()
        await driver.close()
        talker.shutdown()
        plc.order("stop")
        plc.wait_for("stopped")
    if not all(sample.quality.is_good for sample in alive):
        bad = next(sample for sample in alive if not sample.quality.is_good)
        raise BenchmarkError(f"after the garbage {bad.tag} is not good again: {bad.reason}")
    recording = read_recording(rig.recording)
    wrong = wrong_good(recording, read, TRANSPORT_S)
    still = max(longest, longest_pause(recording))
    good = sum(sample.quality.is_good for sample in read)
    refused = int(counts["malformed_pdos"] + counts["stranger_pdos"] + counts["malformed_emergencies"])
    return Garbage(frames, good, len(wrong), refused, tuple(one.reason for one in wrong[:3]), still)


# ---------------------------------------------------------------- the command


def measure(changes: int, frames: int, noise: int, seed: int) -> list[Figure]:
    """All figures. Raises BenchmarkError."""
    with tempfile.TemporaryDirectory(prefix="canopen-") as name:
        folders = [Path(name) / part for part in ("latency", "rate", "any", "own")]
        for folder in folders:
            folder.mkdir()
        followed = latency(folders[0], changes, seed)
        with hub(folders[1]) as bus:
            bare, bare_share = library_rate(Path(bus), frames)
            ours, share = asyncio.run(driver_rate(Path(bus), frames))
        heaps: Mapping[str, Garbage] = {
            "any identifier and length": asyncio.run(garbage(folders[2], noise, own=False)),
            "the node's identifiers and lengths": asyncio.run(garbage(folders[3], noise, own=True)),
        }
    library = "an SDO upload of the bare library"
    return [
        *shares("TPDO to its block", "ms", followed.from_tpdo, library, followed.bare),
        *shares("change to its block", "ms", followed.total, library, followed.bare),
        Figure("changes followed and proven", len(followed.total), "", "scan period, s", PERIOD),
        Figure("PDOs a second", ours, "1/s", "the bare library", bare),
        Figure("of them arrived", 100.0 * share, "%", "the bare library", 100.0 * bare_share),
        *(
            Figure(f"wrong and good: {what}", heap.wrong, "", "good readings", heap.good)
            for what, heap in heaps.items()
        ),
        *(Figure(f"frames refused: {what}", heap.refused, "", "frames", heap.frames) for what, heap in heaps.items()),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Less of everything.")
@click.option("--seed", default=1, show_default=True, help="Seed of the moments.")
def main(as_json: bool, quick: bool, seed: int) -> None:
    few = 10 if quick else 1
    give("CANopen", measure(CHANGES // few, FRAMES // few, GARBAGE // few, seed), as_json=as_json)


if __name__ == "__main__":
    main()
