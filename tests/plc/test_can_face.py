"""The raw-frame CAN face, seen by a bare python-can program and by the gateway's driver, each fault included."""

import asyncio
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import can
import cantools
import pytest
from cantools.database.can import Database

from drivers.can.bus.access import open_bus
from drivers.can.bus.hub import Hub
from drivers.can.driver import CanDriver, open_can
from drivers.errors import WriteUnverified
from drivers.tag import Quality, Sample, Tag
from gateway.settings.devices import DeviceMap, load_device
from sim.plc.can.messages import protect_payload, read_messages
from sim.plc.program.checks import InputError
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import EventRow, read_recording
from tests.drivers.conftest import open_anyway
from tests.plc.bench import DECANTER, Process, block, crc, ramp, running, trace_file, wait_until

MAP = DECANTER.parent / "decanter_can.toml"
DATABASE = cantools.database.load_file(MAP.parents[1] / "decanter.dbc")
WRITEBACK, ECHO = 0x200, 0x280
OLDEST_S = 0.35
"""The age (s) that a value of this device file may have and be good: its longest timeout, and a cycle or two."""


@pytest.fixture
def path(tmp_path: Path) -> Iterator[Path]:
    with Hub(tmp_path / "bus"):
        yield tmp_path / "bus"


@pytest.fixture
def device() -> DeviceMap:
    return load_device(MAP)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Process]]:
    """A bus, and a PLC on it that holds the ramp; blocks are told apart by `beats`."""
    folder = tmp_path_factory.mktemp("can")
    with Hub(folder / "bus"), running(*face(folder / "bus"), "--trace", ramp(folder), "--hold") as plc:
        yield folder / "bus", plc


@pytest.fixture
def bus(shared: tuple[Path, Process]) -> Iterator[can.BusABC]:
    """A client of the shared bus, on which the PLC speaks."""
    with open_bus("hub", str(shared[0])) as bus:
        answers(bus, 0x100, 1)
        yield bus


beats = itertools.count(1)
"""A block with the heartbeat of the one before is refused: each has its own."""


def face(path: Path) -> list[str | Path]:
    return ["--can", MAP, "--can-interface", "hub", "--can-channel", path]


def driver_on(path: Path, device: DeviceMap, **settings: object) -> CanDriver:
    assert device.writeback is not None
    place = {"interface": "hub", "channel": str(path), "connect_timeout": 20.0}  # a busy machine opens a bus late
    merged = {**device.settings, **place, **settings}
    return open_can(merged, clock=time.time, write_map=device.writeback.words)


def decoded(message: can.Message) -> dict[str, object]:
    assert isinstance(DATABASE, Database)
    values = DATABASE.decode_message(message.arbitration_id, bytes(message.data), decode_choices=False)
    assert isinstance(values, dict)
    return dict(values)


def frames(words: list[int]) -> list[can.Message]:
    """A block as nine frames, by struct rules of this test's own."""
    parts = [words[at : at + 3] for at in range(0, 26, 3)]
    data = [
        bytes((n, 0)) + b"".join(word.to_bytes(2, "little") for word in [*part, 0][:3]) for n, part in enumerate(parts)
    ]
    return [can.Message(arbitration_id=WRITEBACK, is_extended_id=False, data=one) for one in data]


def answers(bus: can.BusABC, number: int, count: int) -> list[can.Message]:
    """The next frames of an id."""
    found: list[can.Message] = []
    end = time.monotonic() + 60.0
    while len(found) < count:
        assert time.monotonic() < end
        one = bus.recv(0.5)
        if one is not None and one.arbitration_id == number:
            found.append(one)
    return found


def status(bus: can.BusABC, page: int) -> dict[str, object]:
    """The newest frame of a page of the service message."""
    time.sleep(0.15)
    while bus.recv(0.0) is not None:
        pass
    return next(values for one in answers(bus, 0x140, 4) if (values := decoded(one))["Page"] == page)


def test_all_messages_come_in_their_cycles_with_checksum_and_counter(bus: can.BusABC) -> None:
    assert isinstance(DATABASE, Database)
    heard: dict[int, list[can.Message]] = {}
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        message = bus.recv(0.2)
        if message is not None:
            heard.setdefault(message.arbitration_id, []).append(message)
    own = [message for message in DATABASE.messages if not message.name.startswith("Writeback")]
    assert set(heard) == {message.frame_id for message in own}
    for message in own:
        ones = heard[message.frame_id]
        counters = [one.data[2] for one in ones]
        assert counters == [(counters[0] + place) % 256 for place in range(len(ones))]
        assert all(bytes(one.data) == protect_payload(message.frame_id, one.data[2], bytes(one.data)) for one in ones)
        if message.cycle_time == 50:
            assert len(ones) >= 8


def counted(bus: can.BusABC) -> tuple[int, int]:
    """The blocks that the PLC has accepted and refused, by its own service message."""
    page = status(bus, 0)
    accepted, refused = page["BlocksAccepted"], page["BlocksRefused"]
    assert isinstance(accepted, int) and isinstance(refused, int)
    return accepted, refused


def test_a_block_of_nine_frames_is_echoed_and_judged_by_its_last_frame(bus: can.BusABC) -> None:
    accepted, refused = counted(bus)
    beat = next(beats)
    sent = frames(block(beat, beat))
    for frame in sent:
        bus.send(frame)
    assert [bytes(echo.data) for echo in answers(bus, ECHO, 9)] == [bytes(frame.data) for frame in sent]
    assert counted(bus) == (accepted + 1, refused)


@pytest.mark.parametrize(("lost", "reason"), [(0, 2), (3, 3), (6, 3)])
def test_a_block_that_has_lost_a_frame_is_refused_as_torn(bus: can.BusABC, lost: int, reason: int) -> None:
    accepted, refused = counted(bus)
    beat = next(beats)
    for frame in frames(block(beat, beat, temperature=4000)):
        bus.send(frame)
    beat = next(beats)
    later = block(beat, beat, validity=3, temperature=4100)
    later[11:22] = [word + 1 & 0xFFFF for word in later[11:22]]
    later[24] = crc(later[:24])
    for place, frame in enumerate(frames(later)):
        if place != lost:
            bus.send(frame)
    assert counted(bus) == (accepted + 1, refused + 1)
    assert status(bus, 1)["LastRefusal"] == reason


def test_a_block_whose_last_frame_is_lost_is_not_judged_at_all(bus: can.BusABC) -> None:
    before = counted(bus)
    for frame in frames(block(7, next(beats)))[:-1]:
        bus.send(frame)
    assert counted(bus) == before


def test_frames_that_are_no_part_of_the_block_change_nothing(bus: can.BusABC, shared: tuple[Path, Process]) -> None:
    before = counted(bus)
    for data in (b"", b"\x00", b"\xff" * 8, bytes(7), bytes(range(200, 208))):
        bus.send(can.Message(arbitration_id=WRITEBACK, is_extended_id=False, data=data))
    bus.send(can.Message(arbitration_id=WRITEBACK, is_extended_id=True, data=bytes(8)))
    assert counted(bus) == before
    assert shared[1].order("status")["running"]


async def test_the_driver_reads_what_the_modbus_face_serves(path: Path, device: DeviceMap, tmp_path: Path) -> None:
    header = "time,MarciaDecanter,Assorbimento,TFango,TCuscinettiRiduttore,LivelloVibrazioni,TAmbiente"
    trace = trace_file(tmp_path, ["0,1,123.4,-5.5,61.25,2.34,-12.3", "100,0,1,1,1,1,1"], header)
    with running(*face(path), "--trace", trace) as plc:
        driver = driver_on(path, device)
        samples = {sample.tag: sample for sample in await _settled(driver, device)}
        true = await asyncio.to_thread(plc.order, "values")
        await driver.close()
    for name, value in true["values"].items():
        if name != "PlcHeartbeat" and value is not None:
            assert samples[name].quality is Quality.GOOD, samples[name]
            assert samples[name].value == pytest.approx(value, abs=0.051), name
        elif value is None:
            assert samples[name].quality.is_bad


async def test_a_block_written_by_the_driver_is_accepted_and_one_that_is_forgotten_is_unverified(
    path: Path, device: DeviceMap, tmp_path: Path
) -> None:
    assert device.writeback is not None
    with running(*face(path), "--record", tmp_path / "r.jsonl") as plc:
        driver = driver_on(path, device)
        await _settled(driver, device)
        for number in range(1, 21):
            await driver.write(list(zip(device.writeback.words, block(number, number), strict=True)))
        await asyncio.to_thread(plc.fault, "write_ignored")
        with pytest.raises(WriteUnverified):
            await driver.write(list(zip(device.writeback.words, block(99, 99), strict=True)))
        await driver.close()
        await asyncio.to_thread(plc.stop)
    recording = read_recording(tmp_path / "r.jsonl")
    assert [one.accepted for one in recording.blocks] == [True] * 20
    taken = [one for one in recording.frames if not one.sent]
    assert len(taken) == 21 * 9, "each frame is on the wire once"
    assert {one.id for one in taken} == {WRITEBACK}


FAULTS: dict[str, dict[str, float]] = {
    "frame_loss": {"share": 0.95},
    "short_frame": {},
    "stale_message": {},
    "corrupt_frame": {},
    "bus_off": {},
    "refuse": {},
    "restart": {"down_s": 0.3, "zeros_s": 0.3},
    "babbling_node": {"rate": 1500.0, "known": True},
}
STAYS_GOOD = {"babbling_node"}


async def test_no_fault_of_the_bus_makes_a_wrong_value_good_and_each_is_seen_and_survived(
    path: Path, device: DeviceMap, tmp_path: Path
) -> None:
    """Every value that the driver called good is one that the PLC had within the message's timeout."""
    tags = [device.by_name[name] for name in ("Assorbimento", "TFango", "MarciaDecanter", "PlcHeartbeat")]
    samples: list[Sample] = []
    with running(*face(path), "--trace", ramp(tmp_path, rows=300), "--loop", "--record", tmp_path / "r.jsonl") as plc:
        driver = driver_on(path, device)
        await _settled(driver, device)
        for kind, keys in FAULTS.items():
            plc.order("fault", fault={"kind": kind, "duration": 0.6, **keys})
            during = await _polled(driver, tags, samples, 0.6)
            good = sum(one.quality.is_good for one in during) / len(during)
            assert good > 0.8 if kind in STAYS_GOOD else good < 0.9, (kind, good)
            wait_until(lambda: plc.order("status")["faults"] == [])
            after = await _polled(driver, tags, samples, 1.0, until_good=True)
            assert all(sample.quality.is_good for sample in after[-4:]), (kind, after[-4:])
            await _polled(driver, tags, samples, 0.1)
        counted = driver.statistics()
        await driver.close()
        plc.stop()
    recording = read_recording(tmp_path / "r.jsonl")
    zeros = _zeros(recording.events)
    judged = [one for one in samples if not any(begin <= one.time <= end for begin, end in zeros)]
    assert wrong_good(recording, judged, OLDEST_S) == []
    assert len(judged) > 500
    assert counted["bus_off"] >= 1
    assert counted["frames_refused"] > 500


def test_a_device_file_that_the_face_cannot_serve_is_refused_in_one_sentence(tmp_path: Path) -> None:
    text = MAP.read_text(encoding="utf-8").replace("../decanter.dbc", str(MAP.parents[1] / "decanter.dbc"))
    known = list(load_device(MAP).by_name)
    path = tmp_path / "device.toml"
    for words, content, tags in (
        ("has no such tag", text, ["TFango"]),
        ("'dbc:Message.Signal'", text.replace('"dbc:Drive.Coppia"', '"holding:3"'), known),
        ("no Drive.Nothing", text.replace("dbc:Drive.Coppia", "dbc:Drive.Nothing"), known),
        ("give 'dbc:Message.{field}'", text.replace('"dbc:Writeback.{field}"', '"holding:400"'), known),
        ("device.driver: 'cn' is no driver", text.replace('driver = "can"', 'driver = "cn"'), known),
        ("names no echo", text.replace('Writeback = "WritebackEcho"', ""), known),
        ("is no DBC file", text.replace("decanter.dbc", "nowhere.dbc"), known),
    ):
        path.write_text(content, encoding="utf-8")
        with pytest.raises(InputError) as caught:
            read_messages(path, tags)
        assert words in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


# ---------------------------------------------------------------- helpers


async def _settled(driver: CanDriver, device: DeviceMap) -> list[Sample]:
    """Open and wait until every message has come."""
    await open_anyway(driver)
    end = time.monotonic() + 60.0
    while True:
        samples = await driver.read(device.tags)
        waiting = {Quality.WAITING_FOR_INITIAL_DATA, Quality.NOT_CONNECTED, Quality.TIMEOUT}
        if not any(sample.quality in waiting for sample in samples) or time.monotonic() > end:
            return samples
        await asyncio.sleep(0.02)


async def _polled(
    driver: CanDriver, tags: list[Tag], samples: list[Sample], seconds: float, *, until_good: bool = False
) -> list[Sample]:
    """What is read in so many seconds; `until_good`: at most."""
    got: list[Sample] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        read = await driver.read(tags)
        got += read
        if until_good and all(sample.quality.is_good for sample in read):
            break
        await asyncio.sleep(0.02)
    samples += got
    return got


def _zeros(events: Sequence[EventRow]) -> list[tuple[float, float]]:
    """When the program did not run: what is read then is 0, and the heartbeat says so (the gateway's rule)."""
    begins = [row.time for row in events if row.event == "program stopped"]
    ends = [row.time for row in events if row.event == "program runs"]
    return [(begin, end + OLDEST_S) for begin, end in zip(begins, ends, strict=True)]
