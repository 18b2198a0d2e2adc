"""The gateway as a Modbus server for its peers: the device's own registers, qualities and ages, nothing written."""

import asyncio
import csv
import io
import socket
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.pdu import ExceptionResponse

from drivers.settings import ConfigError
from drivers.tag import Quality, Sample
from gateway.cli.main import main
from gateway.machine.reading.quality import DEAD_PERIODS
from gateway.outside.serving import DeviceImage, PeerServer, served_rows
from gateway.plant.app import run
from gateway.settings.config import Config
from tests.drivers.scripted import ScriptedPlc
from tests.gateway.support import CURRENT, EPOCH, TEMPERATURE, at_rest, config_in, logged, plant_file, scan_of

STATE = 50000
SPEED_PUMP, FEED_SIDE = "VelocitaPompa", "TCuscinettiAlimentazione"


def image_of(config: Config, now: list[float]) -> DeviceImage:
    return DeviceImage(config, lambda: now[0])


def place(config: Config, name: str) -> int:
    return next(row.quality for row in served_rows(config) if row.tag.name == name)


# ------------------------------------------------------------------ the image


def test_a_tag_has_the_address_type_and_order_that_it_has_in_the_device(tmp_path: Path) -> None:
    config, now = config_in(tmp_path), [EPOCH]
    image = image_of(config, now)
    values = at_rest(config) | {CURRENT: 12.3, TEMPERATURE: 41.5, "MarciaDecanter": True, "AllarmeVibrazioni": True}
    image.take(scan_of(values, EPOCH))
    assert image.read("holding", 101, 1) == [123]
    words = image.read("holding", 105, 2)
    assert isinstance(words, list)
    assert struct.unpack(">f", struct.pack(">HH", *reversed(words)))[0] == 41.5  # low word first, as the device has it
    assert image.read("holding", 100, 1) == [0b1001], "two tags, one register"
    assert image.read("holding", 100, 12) == image.read("holding", 100, 5) + image.read("holding", 105, 7)  # type: ignore[operator]
    for table, start in (("holding", 99), ("holding", 0), ("input", 100), ("coil", 100), ("holding", 65535)):
        assert image.read(table, start, 1) == 2


def test_a_bad_reading_is_the_devices_own_word_for_it_or_the_last_good_value_and_the_quality_says_so(
    tmp_path: Path,
) -> None:
    config, now = config_in(tmp_path), [EPOCH]
    image = image_of(config, now)
    image.take(scan_of(at_rest(config) | {CURRENT: 12.3, FEED_SIDE: 30.0, "BlocksAccepted": 7}, EPOCH))
    bad: Any = {CURRENT: None, FEED_SIDE: None, "BlocksAccepted": None}
    image.take(scan_of(at_rest(config) | bad, EPOCH + 2))
    now[0] = EPOCH + 2
    assert image.read("holding", 101, 2) == [65535, 0], "its sentinel"
    words = image.read("holding", 105, 4)
    assert isinstance(words, list) and words[3] & 0x7FC0 == 0x7FC0, "not a number"
    assert image.read("holding", 115, 2) == [7, 0], "no way to say it: the last good one"
    for name in bad:
        assert image.read("input", place(config, name), 2) == [Quality.TIMEOUT >> 16, 20], name
        assert image.read("holding", place(config, name), 1) == [0x800A]
    assert image.read("input", place(config, "Coppia"), 2) == [0, 0]


def test_a_request_of_which_nothing_is_known_is_refused_as_for_a_silent_device(tmp_path: Path) -> None:
    config, now = config_in(tmp_path), [EPOCH]
    image = image_of(config, now)
    assert image.read("holding", 101, 1) == 11, "before the first scan"
    assert image.read("input", STATE, 4) == [1, 0, 65535, len(config.map.tags)]
    image.take(scan_of(at_rest(config) | {"BlocksAccepted": None}, EPOCH))
    assert image.read("holding", 115, 1) == 11, "a bad tag asked for alone"
    assert image.read("holding", 115, 2) == [0, 0], "beside a good one it is what it was"
    # Without a further scan everything grows old by itself: first in quality, then there is nothing left.
    now[0] = EPOCH + 5
    assert image.read("holding", 101, 1) == [0]
    assert image.read("input", place(config, CURRENT), 2) == [Quality.LAST_USABLE >> 16, 50]
    now[0] = EPOCH + DEAD_PERIODS + 1
    assert image.read("holding", 101, 1) == 11
    assert image.read("input", place(config, CURRENT), 1) == [Quality.NO_DATA >> 16]


def test_a_hole_between_tags_reads_as_0_and_is_no_request_of_its_own(tmp_path: Path) -> None:
    config, now = config_in(tmp_path), [EPOCH]
    rows = [row for row in served_rows(config) if row.table == "holding"]
    first, end = min(row.start for row in rows), max(row.start + row.count for row in rows)
    gone = next(row for row in rows if row.tag.name == CURRENT)
    tags = tuple(tag for tag in config.map.tags if tag.name != CURRENT)
    link = replace(config.links[0], map=replace(config.map, tags=tags))
    image = image_of(replace(config, links=(link,)), now)
    image.take(scan_of({name: value for name, value in at_rest(config).items() if name != CURRENT}, EPOCH))
    words = image.read("holding", first, min(125, end - first))
    assert isinstance(words, list) and words[gone.start - first] == 0
    assert image.read("holding", gone.start, 1) == 2 and image.read("holding", end - 1, 2) == 2
    assert image.read("holding", first - 1, 2) == 2


def test_what_cannot_be_served_beside_the_devices_registers_is_refused_at_the_start(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    for address, words in ((65500, "leaves no room for"), (60, "holding:60 to .* lies over MarciaDecanter")):
        other = replace(config, serve=config.serve.model_copy(update={"address": address}))
        with pytest.raises(ConfigError, match=rf"plant\.toml: serve\.address: .*{words}"):
            served_rows(other)
    first = config.links[0]
    tags = [replace(tag, scale_from="holding:9") if tag.name == CURRENT else tag for tag in first.map.tags]
    scaled = replace(config, links=(replace(first, map=replace(first.map, tags=tuple(tags))),))
    with pytest.raises(ConfigError, match=f"{CURRENT} has its scale from a register, which a peer cannot know"):
        served_rows(scaled)


def test_the_table_is_printed_for_people_for_programs_and_for_a_peers_import(tmp_path: Path) -> None:
    path = plant_file(tmp_path, "[serve]\nport = 15020\nunit = 4\n")
    shown = CliRunner().invoke(main, ["plc", "served", "--config", str(path)])
    assert shown.exit_code == 0 and "127.0.0.1:15020 unit 4" in shown.stdout and "holding:105" in shown.stdout
    rows = list(
        csv.DictReader(io.StringIO(CliRunner().invoke(main, ["plc", "served", "--config", str(path), "--csv"]).stdout))
    )
    by_tag = {row["tag"]: row for row in rows}
    assert by_tag[TEMPERATURE] | {"table": "holding", "address": "105", "count": "2"} == by_tag[TEMPERATURE]
    assert int(by_tag[TEMPERATURE]["quality"]) == STATE + 4 + 2 * rows.index(by_tag[TEMPERATURE])


# ------------------------------------------------------------------ the server


class Numbers:
    """Every address holds its own number; 100 and up are not there."""

    def read(self, table: str, start: int, count: int) -> list[int] | int:
        return list(range(start, start + count)) if start + count <= 100 else 2


async def serving(server: PeerServer) -> "asyncio.Task[None]":
    task = asyncio.ensure_future(server.serve())
    while not server.port:
        await asyncio.sleep(0.001)
    return task


async def test_several_requests_in_one_segment_are_answered_each_and_what_is_no_modbus_ends_the_connection() -> None:
    server = PeerServer("127.0.0.1", 0, {1: Numbers()}, most_clients=1)
    task = await serving(server)
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    ask = b"".join(struct.pack(">HHHBBHH", number, 0, 6, 1, 3, number, 1) for number in range(5))
    writer.write(ask[:20])
    await asyncio.sleep(0.01)
    writer.write(ask[20:])
    for number in range(5):
        assert await reader.readexactly(11) == struct.pack(">HHHBBBH", number, 0, 5, 1, 3, 2, number)
    other, end = await asyncio.open_connection("127.0.0.1", server.port)
    assert await other.read() == b"" and server.refused == 1, "one peer too many"
    end.close()
    writer.write(b"GET / HTTP/1.1\r\n")
    assert await reader.read() == b""
    writer.close()
    task.cancel()
    await asyncio.wait({task})


@pytest.mark.parametrize(
    ("unit", "request_", "code"),
    [
        (1, struct.pack(">BHH", 6, 1, 1), 1),
        (1, struct.pack(">BHH", 5, 1, 0xFF00), 1),
        (1, struct.pack(">BHHBH", 16, 1, 1, 2, 7), 1),
        (1, struct.pack(">BHHBB", 15, 1, 1, 1, 1), 1),
        (1, struct.pack(">BHHHHBH", 23, 0, 1, 0, 1, 2, 7), 1),
        (1, struct.pack(">BHHH", 22, 1, 1, 1), 1),
        (1, struct.pack(">BHH", 3, 99, 2), 2),
        (1, struct.pack(">BHH", 3, 65535, 2), 2),
        (1, struct.pack(">BHH", 3, 0, 0), 3),
        (1, struct.pack(">BHH", 3, 0, 126), 3),
        (1, b"\x03\x00", 3),
        (2, struct.pack(">BHH", 3, 0, 1), 10),
    ],
)
def test_what_is_not_a_read_of_what_is_there_is_refused(unit: int, request_: bytes, code: int) -> None:
    server = PeerServer("127.0.0.1", 0, {1: Numbers()})
    assert server.answer(unit, request_) == bytes((request_[0] | 0x80, code))


# ------------------------------------------------------------------ the gateway


def test_a_client_that_knows_of_no_units_reads_the_first_machine() -> None:
    server = PeerServer("127.0.0.1", 0, {3: Numbers()})
    request_ = bytes((3, 0, 100, 0, 1))
    assert server.answer(255, request_) == server.answer(0, request_) == server.answer(3, request_)
    assert server.answer(1, request_) == server.answer(3, request_)
    several = PeerServer("127.0.0.1", 0, {3: Numbers(), 5: Numbers()})
    assert several.answer(1, request_) == bytes((0x83, 10)), "of several machines none is unit 1"
    assert server.answer(4, request_) == bytes((0x83, 10))


async def test_every_function_of_a_foreign_master_is_answered_as_the_specification_says(tmp_path: Path) -> None:
    """V1.1b3, 6: function, then quantity, then address. V1.0b, page 23: units 0 and 255 are the server's own."""
    config, now = config_in(tmp_path), [EPOCH]
    gone = {CURRENT, "Coppia"}
    tags = tuple(tag for tag in config.map.tags if tag.name not in gone)
    image = image_of(replace(config, links=(replace(config.links[0], map=replace(config.map, tags=tags)),)), now)
    image.take(scan_of({name: value for name, value in at_rest(config).items() if name not in gone}, EPOCH))
    server = PeerServer("127.0.0.1", 0, {5: image})
    task = await serving(server)
    peer = AsyncModbusTcpClient("127.0.0.1", port=server.port, retries=0, timeout=60)
    end = max(row.start + row.count for row in image.rows)
    try:
        assert await peer.connect()
        for unit in (0, 1, 5, 255, 6):
            own = {"device_id": unit}
            there = unit != 6
            block = await peer.read_holding_registers(100, count=end - 100, **own)
            whole = await peer.read_input_registers(STATE, count=4 + 2 * len(image.rows), **own)
            assert block.isError() != there and whole.isError() != there
            assert not there or block.registers[1:3] == [0, 0], "a hole is 0"
            asked = {
                "coils": (peer.read_coils(0, count=1, **own), 2),
                "discrete inputs": (peer.read_discrete_inputs(0, count=1, **own), 2),
                "input registers that are not there": (peer.read_input_registers(100, count=1, **own), 2),
                "a hole alone": (peer.read_holding_registers(101, count=1, **own), 2),
                "over the end": (peer.read_holding_registers(100, count=end - 99, **own), 2),
                "before the beginning": (peer.read_holding_registers(99, count=2, **own), 2),
                "over the state's end": (peer.read_input_registers(STATE, count=len(whole.registers) + 1, **own), 2),
                "beyond 65535": (peer.read_holding_registers(65535, count=2, **own), 2),
                "one coil": (peer.write_coil(0, True, **own), 1),
                "one register": (peer.write_register(100, 1, **own), 1),
                "coils, written": (peer.write_coils(0, [True, False], **own), 1),
                "registers, written": (peer.write_registers(100, [1, 2], **own), 1),
                "a mask": (peer.mask_write_register(address=100, **own), 1),
                "both": (peer.readwrite_registers(read_address=100, read_count=1, values=[1], **own), 1),
                "identity": (peer.read_device_information(**own), 1),
            }  # fmt: skip
            # pymodbus asks for none of these itself.
            for function, most in ((1, 2000), (2, 2000), (3, 125), (4, 125)):
                for count in (0, most + 1, 0xFFFF):
                    asked[f"{count} of function {function}"] = (plain_request(server, unit, function, 0, count), 3)
            for what, (reply, code) in asked.items():
                assert (await reply).exception_code == (code if there else 10), (unit, what)
    finally:
        peer.close()
        task.cancel()
        await asyncio.wait({task})


async def plain_request(server: PeerServer, unit: int, function: int, start: int, count: int) -> ExceptionResponse:
    """The exception that a request is answered with over a connection of its own."""
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(struct.pack(">HHHBBHH", 7, 0, 6, unit, function, start, count))
    transaction, _, length, answers, refused, code = struct.unpack(">HHHBBB", await reader.readexactly(9))
    writer.close()
    assert (transaction, length, answers, refused) == (7, 3, unit, function | 0x80)
    return ExceptionResponse(function, code)


async def test_a_foreign_master_reads_from_the_gateway_what_it_has_read_of_a_plc_with_one_connection(
    tmp_path: Path,
) -> None:
    plc = ScriptedPlc()

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        plc.registers[112] += 1
        writer.write(honest)

    plc.bend = bend
    plc.registers |= {100: 1, 101: 123, 103: 0, 105: 0, 106: 0x4226, 107: 0, 108: 0x41F0}
    await plc.start()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    text = f"[serve]\nport = {port}\nunit = 5\n[scan]\nperiod = 0.05\n"
    config, stop = config_in(tmp_path, text, device__host="127.0.0.1", device__port=plc.port), asyncio.Event()
    running = asyncio.ensure_future(run(config, stop=stop))
    peer = AsyncModbusTcpClient("127.0.0.1", port=port, retries=0, timeout=2)

    async def read(address: int, count: int = 1) -> list[int]:
        """Registers once they are served: what a busy machine reads late is served as bad meanwhile."""
        while (reply := await peer.read_holding_registers(address, count=count, device_id=5)).isError():
            await asyncio.sleep(0.02)
        return list(reply.registers)

    try:
        async with asyncio.timeout(120):
            while not await peer.connect():
                await asyncio.sleep(0.02)
            assert await read(101) == [123]
            assert await read(105, 4) == [0, 0x4226, 0, 0x41F0]
            while (state := await peer.read_input_registers(STATE, count=4, device_id=5)).registers[2] >= 20:
                await asyncio.sleep(0.02)
            assert state.registers[0] == 1
            while (quality := await read(place(config, TEMPERATURE), 2))[0] != 0 or quality[1] >= 20:
                await asyncio.sleep(0.02)
            # It is read-only, and the PLC hears of nothing.
            asked = plc.functions()
            assert (await peer.write_register(101, 1, device_id=5)).exception_code == 1
            assert (await peer.write_registers(400, [1, 2], device_id=5)).exception_code == 1
            assert (await peer.read_holding_registers(0, count=1, device_id=5)).exception_code == 2
            assert (await peer.read_holding_registers(101, count=1, device_id=6)).exception_code == 10
            assert set(asked) == {3} and plc.connections == 1
            # The PLC goes: no old value is left for one who asks for no quality.
            await plc.stop()
            while not (reply := await peer.read_holding_registers(101, count=1, device_id=5)).isError():
                await asyncio.sleep(0.02)
            assert reply.exception_code == 11
            quality = await peer.read_input_registers(place(config, TEMPERATURE), count=1, device_id=5)
            assert quality.registers[0] & 0x8000
    finally:
        peer.close()
        stop.set()
        status = await running
        await plc.stop()
    assert status["parts"]["peers"]["restarts"] == 0


async def test_a_port_that_is_taken_is_said_and_stops_nothing(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        text = f"[serve]\nport = {taken.getsockname()[1]}\n[scan]\nperiod = 0.05\n"
        config, stop = config_in(tmp_path, text, device__host="127.0.0.1", device__port=1), asyncio.Event()
        running = asyncio.ensure_future(run(config, stop=stop))
        began = time.monotonic()
        while not (tmp_path / "gateway.jsonl").exists() or not any(
            row.get("part") == "peers" and "cannot be served" in row["reason"] for row in logged(tmp_path)
        ):
            assert time.monotonic() - began < 60
            await asyncio.sleep(0.02)
        stop.set()
        status = await running
    assert status["parts"]["peers"]["restarts"] >= 1 and status["scan"]["count"] >= 1


def test_a_sample_that_has_no_register_for_its_value_is_served_as_none(tmp_path: Path) -> None:
    config, now = config_in(tmp_path), [EPOCH]
    image = image_of(config, now)
    scan = scan_of(at_rest(config), EPOCH)
    odd = Sample(CURRENT, "much", Quality.GOOD, EPOCH)
    image.take(replace(scan, samples={**scan.samples, CURRENT: odd}))
    assert image.read("holding", 101, 1) == [65535]
