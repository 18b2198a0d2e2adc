"""The CANopen face of the running PLC, seen by the canopen library and by the gateway's driver."""

import asyncio
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import canopen
import pytest

from drivers.can.bus.hub import Hub
from drivers.can.bus.hub_bus import HubBus
from drivers.canopen.driver import CanopenDriver, open_canopen
from drivers.tag import Quality
from gateway.settings.devices import load_device
from sim.plc.record.recording import read_recording
from tests.plc.bench import DECANTER, block, ramp, running, wait_until

MAP = DECANTER.parent / "decanter_canopen.toml"
EDS = MAP.parents[1] / "decanter.eds"


@pytest.fixture
def path(tmp_path: Path) -> Iterator[Path]:
    with Hub(tmp_path / "bus"):
        yield tmp_path / "bus"


def face(path: Path) -> list[str | Path]:
    return ["--canopen", MAP, "--can-interface", "hub", "--can-channel", path]


def driver_on(path: Path, **settings: object) -> CanopenDriver:
    device = load_device(MAP)
    assert device.writeback is not None
    place = {"interface": "hub", "channel": str(path), "connect_timeout": 20.0}  # a busy machine brings a node up late
    merged = {**device.settings, **place, "configure": True, **settings}
    known = {key: value for key, value in merged.items() if value is not None}
    return open_canopen(known, clock=time.time, write_map=device.writeback.words)


def test_the_librarys_master_reads_starts_and_is_told_and_its_block_is_taken(tmp_path: Path, path: Path) -> None:
    with running("--trace", ramp(tmp_path), "--hold", *face(path)) as plc:
        assert plc.ready["faces"]["canopen"] == {"interface": "hub", "channel": str(path), "node": 1}
        network = canopen.Network(HubBus(str(path)))
        network.NOTIFIER_CYCLE = 0.02
        network.connect()
        try:
            remote = network.add_node(1, str(EDS))
            assert remote.sdo[0x1008].raw == "decanter software PLC"
            assert remote.sdo.upload(0x1021, 0) == EDS.read_bytes()
            with remote.sdo.open(0x1021, 0, "rb", block_transfer=True) as stream:
                assert stream.read() == EDS.read_bytes()
            remote.tpdo.read()
            told: list[float] = []
            remote.tpdo[2].add_callback(lambda pdo: told.append(pdo[1].raw))
            remote.nmt.state = "OPERATIONAL"
            remote.nmt.wait_for_heartbeat(2.0)
            assert remote.nmt.state == "OPERATIONAL"
            plc.order("force", tag="TCuscinettiRiduttore", value=42.5)
            wait_until(lambda: 42.5 in told)
            remote.rpdo.read()
            words = block(1, 1)
            for number in range(1, 8):
                pdo = remote.rpdo[number]
                part = words[4 * number - 4 : 4 * number]
                pdo.data = bytearray(struct.pack(f"<{len(part)}H", *part))
                pdo.transmit()
            wait_until(lambda: plc.order("status")["accepted"] == 1)
            with pytest.raises(canopen.SdoAbortedError, match="read only"):
                remote.sdo.download(0x2001, 1, b"\0\0")
        finally:
            network.disconnect()
        plc.stop()


async def test_a_driver_without_an_eds_asks_the_device_for_its_own(path: Path) -> None:
    with running(*face(path)) as plc:
        driver = driver_on(path, eds=None, tpdo=None)  # its EDS comes in some 500 frames
        await driver.open()
        tags = load_device(MAP).tags
        await asyncio.to_thread(plc.order, "force", tag="TCuscinettiRiduttore", value=42.5)
        end = time.monotonic() + 60.0
        while True:
            samples = {sample.tag: sample for sample in await driver.read(tags)}
            if samples["TCuscinettiRiduttore"].value == 42.5 or time.monotonic() > end:
                break
            await asyncio.sleep(0.01)
        assert samples["TCuscinettiRiduttore"].value == 42.5
        assert samples["WritePermit"].value is True
        assert samples["Assorbimento"].quality is Quality.NO_DATA, "the sentinel: nothing is replayed"
        await driver.close()
        plc.stop()


async def test_a_node_whose_parameters_somebody_has_reset_is_configured_and_started_anew(
    tmp_path: Path, path: Path
) -> None:
    record = tmp_path / "r.jsonl"
    with running("--record", record, *face(path)) as plc:
        driver = driver_on(path)
        await driver.open()
        for number in range(3):
            reply = await asyncio.to_thread(plc.order, "fault", fault={"kind": "node_reset"})
            assert reply["ok"]
            begun = time.monotonic()
            while driver.statistics()["starts"] < number + 2:
                assert time.monotonic() - begun < 60.0
                await asyncio.sleep(0.01)
            assert driver.connected
        await driver.close()
        plc.stop()
    frames = read_recording(record).frames
    starts = [row.time for row in frames if not row.sent and row.id == 0x000 and row.data == b"\x01\x01"]
    boots = [row.time for row in frames if row.sent and row.id == 0x701 and row.data == b"\0"]
    assert len(boots) >= 4 and len(starts) == 4
    remapped = [
        row for row in frames if not row.sent and row.id == 0x601 and row.data and row.data[:3] == b"\x2b\0\x18"
    ]
    assert len(remapped) == 4, "the event timer of TPDO 1, each time"


def test_two_faces_serve_one_image(path: Path) -> None:
    with running(*face(path), "--rtu-tcp", "0") as plc:
        assert set(plc.ready["faces"]) == {"tcp", "rtu-tcp", "canopen"}
        plc.stop()


def test_a_bus_that_is_not_there_is_said_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="no CAN hub at"), running(*face(tmp_path / "none")):
        pass
