"""`decanter plc read` and `watch`: raw words and values side by side, over every link, live or as lines."""

import json
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.can.bus.hub import Hub
from drivers.survey import Raw
from drivers.tag import Quality, Sample, Tag
from gateway.commission.survey.addresses import AddressTextError, parse_register, parse_stretch
from gateway.commission.watch import WatchedTag, sparkline
from tests.commission.bench import answer, at, force, plc
from tests.plc.bench import DECANTER, ROOT, Process, running

CANOPEN, CAN = ROOT / "config/devices/decanter_canopen.toml", ROOT / "config/devices/decanter_can.toml"


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, Path]]:
    hub = tmp_path_factory.mktemp("bus") / "can.hub"
    options = ["--canopen", CANOPEN, "--can", CAN, "--can-interface", "hub", "--can-channel", hub, "--rtu-tcp", "0"]
    with Hub(hub), running(*options, "--serial", "pty") as process:
        force(process, "Assorbimento", 80.5)
        force(process, "TCuscinettiRiduttore", 72.4375)
        yield process, hub


@pytest.mark.parametrize("link", ["modbus", "modbus-rtu-tcp", "modbus-rtu", "canopen", "can"])
def test_a_tag_reads_the_same_over_every_link(device: tuple[Process, Path], tmp_path: Path, link: str) -> None:
    process, hub = device
    faces, bus = process.ready["faces"], ("--interface", "hub", "--channel", hub)
    where: dict[str, tuple[object, ...]] = {
        "modbus": ("--device", DECANTER, *at(process)),
        "modbus-rtu-tcp": ("--device", DECANTER, "--link", link, "--host", "127.0.0.1", "--port",
                           faces["rtu-tcp"]["port"]),
        "modbus-rtu": ("--device", DECANTER, "--link", link, "--serial", faces["serial"]["path"], "--parity", "N"),
        "canopen": ("--device", CANOPEN, *bus),
        "can": ("--device", CAN, *bus),
    }  # fmt: skip
    data = answer(tmp_path, "read", "Assorbimento", "TCuscinettiRiduttore", *where[link])
    current, temperature = data["readings"]
    assert (current["value"], current["unit"], current["quality"]) == (pytest.approx(80.5), "A", "GOOD")
    assert temperature["value"] == pytest.approx(72.4375)
    if link.startswith("modbus"):
        assert (current["raw"], current["reference"]) == ([805], "40102")
    assert data["frames"]["received"] > 0


def test_over_tls_the_same_is_read_with_a_certificate(tmp_path: Path) -> None:
    folder = tmp_path / "tls"
    folder.mkdir()
    from gateway.network.certificates import make_all

    made = make_all(folder, hosts=("127.0.0.1",), days=2)
    with running("--tls", made) as process:
        port = process.ready["faces"]["tls"]["port"]
        data = answer(tmp_path, "read", "40113", "--host", "127.0.0.1", "--port", port, "--tls", made)
    assert data["readings"][0]["quality"] == "GOOD" and data["ok"]


def test_a_reference_number_and_its_pdu_address_are_the_same_register(
    device: tuple[Process, Path], tmp_path: Path
) -> None:
    data = answer(tmp_path, "read", "40102", "holding:101", *at(device[0]))
    first, second = data["readings"]
    assert first["address"] == second["address"] == "holding:101"
    assert first["reference"] == "40102" and first["hex"] == "0325" and first["int16"] == 805


def test_a_type_and_an_order_decode_bare_addresses(device: tuple[Process, Path], tmp_path: Path) -> None:
    data = answer(tmp_path, "read", "holding:105", "--type", "float32", "--order", "CDAB", *at(device[0]))
    assert data["readings"][0]["value"] == pytest.approx(72.4375)


def test_bare_objects_of_a_node_are_read_with_their_bytes(device: tuple[Process, Path], tmp_path: Path) -> None:
    bus = ("--link", "canopen", "--interface", "hub", "--channel", device[1])
    data = answer(tmp_path, "read", "0x1018:2", "0x1008", *bus)
    assert data["readings"][0]["value"] == 0xDEC and data["readings"][0]["raw"] == [0xEC, 0x0D, 0, 0]
    assert data["readings"][1]["value"] == "decanter software PLC"


def test_a_refused_address_is_a_device_exception_and_one_of_several_a_failed_check(
    device: tuple[Process, Path], tmp_path: Path
) -> None:
    assert answer(tmp_path, "read", "holding:9", *at(device[0]))["exit"] == 4
    some = plc(tmp_path, "read", "holding:9", "holding:112", *at(device[0]))
    assert some.exit_code == 1 and "1 of 2 readings are not good" in some.stderr


@pytest.mark.parametrize(
    ("text", "shown"),
    [("40101", "holding:100"), ("400101", "holding:100"), ("30001", "input:0"), ("coil:7", "coil:7"),
     ("465536", "holding:65535"), ("00001", "coil:0"), ("10010", "discrete:9")],
)  # fmt: skip
def test_addresses_are_understood_as_manuals_and_frames_write_them(text: str, shown: str) -> None:
    assert str(parse_register(text)) == shown
    assert parse_register(parse_register(text).reference) == parse_register(text)


@pytest.mark.parametrize("text", ["40000", "50001", "holding:65536", "holding", "", "466000"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(AddressTextError):
        parse_register(text)


def test_a_stretch_may_be_written_in_both_ways() -> None:
    assert parse_stretch("holding:10-19") == parse_stretch("40011-40020") == (parse_register("holding:10"), 10)
    with pytest.raises(AddressTextError, match="no stretch"):
        parse_stretch("holding:19-10")


def test_a_watch_off_a_terminal_is_a_line_for_each_change(device: tuple[Process, Path], tmp_path: Path) -> None:
    process = device[0]
    result = plc(
        tmp_path, "read", "--watch", "Assorbimento", "PlcHeartbeat", "--device", DECANTER, *at(process),
        "--period", 0.05, "--seconds", 1.0,
    )  # fmt: skip
    assert result.exit_code == 0
    lines = [line.split() for line in result.stdout.splitlines() if "GOOD" in line.split()]
    assert [line[1] for line in lines].count("Assorbimento") >= 1
    assert sum("PlcHeartbeat" in line for line in lines) >= 4
    assert "80.5" in next(line for line in lines if "Assorbimento" in line)


@pytest.mark.parametrize("option", [("--period", "1.0"), ("--seconds", "60")])
def test_what_only_a_watch_has_is_refused_without_one(tmp_path: Path, option: tuple[str, str]) -> None:
    result = plc(tmp_path, "read", "holding:0", "--host", "127.0.0.1:1", *option)
    assert result.exit_code == 2 and "--period and --seconds belong to --watch" in result.stderr


def test_a_watch_gives_extremes_and_counts_as_json(device: tuple[Process, Path], tmp_path: Path) -> None:
    data = answer(
        tmp_path,
        "read",
        "--watch",
        "PlcHeartbeat",
        "--device",
        DECANTER,
        *at(device[0]),
        "--period",
        0.05,
        "--seconds",
        0.4,
    )
    (row,) = data["tags"]
    assert row["max"] > row["min"] and row["good"] == row["changes"] + 1 and row["bad"] == 0


def test_a_watch_on_a_terminal_is_live_and_enter_sets_a_mark(device: tuple[Process, Path], tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    command = [
        sys.executable,
        "-m",
        "gateway.cli.main",
        "plc",
        "read",
        "--watch",
        "PlcHeartbeat",
        "--device",
        str(DECANTER),
    ]
    command += [*at(device[0]), "--period", "0.1", "--seconds", "2.5", "--records", str(tmp_path / "records.jsonl")]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, cwd=ROOT) as process:
        os.close(theirs)
        seen, marked = b"", False
        while True:
            try:
                seen += os.read(ours, 4096)
            except OSError:  # the terminal's other end is closed: the process has ended
                break
            if not marked and b"GOOD" in seen:
                marked = os.write(ours, b"\n") == 1
        assert process.wait(120) == 0
    os.close(ours)
    record = json.loads((tmp_path / "records.jsonl").read_text(encoding="utf-8"))
    assert "last readings" in seen.decode(errors="replace") and "mark 1 at" in seen.decode(errors="replace")
    (mark,) = record["result"]["marks"]
    assert mark["values"]["PlcHeartbeat"] > 0


def test_a_sparkline_has_a_cross_for_a_bad_reading_and_the_ends_of_the_range() -> None:
    line = sparkline([0.0, None, 5.0, 10.0], width=6)
    assert line == "  ▁×▅█" or line == "  ▁×▄█"
    assert sparkline([3.0, 3.0], width=2) == "▁▁"
    assert len(sparkline([float(n) for n in range(100)], width=10)) == 10


def test_what_a_tag_has_done_is_counted_without_its_bad_readings() -> None:
    tag = Tag("t", "holding:1")
    seen = WatchedTag(tag)
    for value, quality in ((5, Quality.GOOD), (None, Quality.TIMEOUT), (2, Quality.GOOD), (2, Quality.GOOD)):
        seen.take(Raw(tag, Sample("t", value, quality, 0.0), "holding:1", 1))
    assert (seen.low, seen.high, seen.good, seen.bad, seen.changes) == (2.0, 5.0, 3, 1, 2)
