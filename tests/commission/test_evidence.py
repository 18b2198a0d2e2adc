"""What is kept of a command: frames as pcap, counts, and the chain of records."""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.can.bus.hub import Hub
from drivers.tap import TapFrame
from gateway.commission.session.evidence import Exchanges, FrameEvidence
from gateway.commission.session.pcap import checksum
from gateway.commission.session.records import RecordsError, find_break, read_records, sha256_hex
from tests.commission.bench import answer, at
from tests.plc.bench import ROOT, Process, running


@dataclass(frozen=True)
class Packet:
    """A packet of a pcap file as a reader sees it."""

    time: float
    data: bytes


def read_pcap(path: Path) -> tuple[int, list[Packet]]:
    """Link type and packets, by the format's own definition (draft-ietf-opsawg-pcap): every length must fit."""
    data = path.read_bytes()
    magic, major, minor, _, _, longest, link = struct.unpack(">IHHiIII", data[:24])
    assert (magic, major, minor) == (0xA1B2C3D4, 2, 4)
    packets, at_ = [], 24
    while at_ < len(data):
        seconds, micro, kept, whole = struct.unpack(">IIII", data[at_ : at_ + 16])
        assert kept == whole <= longest and micro < 1_000_000
        packets.append(Packet(seconds + micro / 1e6, data[at_ + 16 : at_ + 16 + kept]))
        at_ += 16 + kept
    assert at_ == len(data)
    return link, packets


def tcp_payloads(packets: list[Packet]) -> list[tuple[int, int, int, bytes]]:
    """(source port, target port, sequence, payload) of each; the checksums of IP and TCP are verified."""
    found = []
    for packet in packets:
        ip = packet.data
        assert ip[0] == 0x45 and ip[9] == 6 and struct.unpack(">H", ip[2:4])[0] == len(ip)
        assert checksum(ip[:20]) == 0
        tcp = ip[20:]
        assert checksum(ip[12:20] + struct.pack(">BBH", 0, 6, len(tcp)) + tcp) == 0
        source, target, sequence = struct.unpack(">HHI", tcp[:8])
        found.append((source, target, sequence, tcp[(tcp[12] >> 4) * 4 :]))
    return found


@pytest.fixture(scope="module")
def device() -> Iterator[Process]:
    with running() as process:
        yield process


def test_a_modbus_exchange_stands_in_the_pcap_as_tcp_with_true_ports_and_sums(device: Process, tmp_path: Path) -> None:
    path = tmp_path / "out.pcap"
    data = answer(tmp_path, "read", "holding:112-113", *at(device), "--pcap", path)
    link, packets = read_pcap(path)
    assert link == 101
    request, reply = tcp_payloads(packets)
    assert request[1] == reply[0] == device.port and request[0] == reply[1]
    assert request[3][7:] == struct.pack(">BHH", 3, 112, 2)
    assert list(struct.unpack(">2H", reply[3][9:])) == [row["raw"][0] for row in data["readings"]]
    assert data["frames"] == {**data["frames"], "sent": 1, "received": 1, "bytes": len(request[3]) + len(reply[3])}


def test_a_streams_segments_follow_one_another_in_the_pcap(device: Process, tmp_path: Path) -> None:
    path = tmp_path / "out.pcap"
    answer(tmp_path, "probe", *at(device), "--pcap", path)
    following: dict[tuple[int, int], int] = {}
    for source, target, sequence, payload in tcp_payloads(read_pcap(path)[1]):
        assert following.get((source, target), sequence) == sequence
        following[source, target] = sequence + len(payload)
    assert len(following) == 2


def test_frames_of_a_bus_stand_in_the_pcap_as_socketcan(tmp_path: Path) -> None:
    hub, path = tmp_path / "can.hub", tmp_path / "out.pcap"
    options = ["--can", ROOT / "config/devices/decanter_can.toml", "--can-interface", "hub", "--can-channel", hub]
    with Hub(hub), running(*options):
        bus = ("--link", "can", "--interface", "hub", "--channel", hub)
        data = answer(tmp_path, "scan", "frames", *bus, "--seconds", 0.3, "--pcap", path)
    link, packets = read_pcap(path)
    assert link == 227 and len(packets) >= data["heard"] > 0
    for packet in packets:
        number, length = struct.unpack(">IB", packet.data[:5])
        assert number & 0x1FFFFFFF in range(0x100, 0x200) and len(packet.data) == 8 + length


def test_ipv6_packets_have_a_sum_that_a_receiver_accepts(tmp_path: Path) -> None:
    evidence = FrameEvidence(tmp_path / "v6.pcap")
    evidence.take(TapFrame(time=1.5, sent=True, medium="tcp", place="::1:502", data=b"abc", local="::1:40000"))
    evidence.close()
    (packet,) = read_pcap(tmp_path / "v6.pcap")[1]
    assert packet.data[0] >> 4 == 6 and packet.time == 1.5
    tcp = packet.data[40:]
    assert checksum(packet.data[8:40] + struct.pack(">I3xB", len(tcp), 6) + tcp) == 0
    assert tcp.endswith(b"abc")


def test_the_hash_tells_direction_bytes_and_order(tmp_path: Path) -> None:
    def digest(*frames: tuple[bool, bytes]) -> str:
        evidence = FrameEvidence()
        for sent, data in frames:
            evidence.take(TapFrame(time=0.0, sent=sent, medium="serial", place="/dev/x", data=data))
        return str(evidence.plain()["sha256"])

    seen = [((True, b"ab"),), ((False, b"ab"),), ((True, b"a"), (True, b"b")), ((True, b"b"), (True, b"a"))]
    assert len({digest(*frames) for frames in seen}) == 4


def test_the_line_of_frame_loss_counts_what_was_lost() -> None:
    exchanges = Exchanges()
    exchanges.add({"requests": 40, "timeouts": 2, "exceptions": 1, "foreign_replies": 3}, "modbus")
    assert "40 requests, 2 without reply (5.0%), 1 refused" in exchanges.line()
    assert "3 that nobody asked for" in exchanges.line()


def test_every_command_leaves_a_record_and_the_records_are_a_chain(device: Process, tmp_path: Path) -> None:
    answer(tmp_path, "read", "holding:112", *at(device))
    answer(tmp_path, "read", "holding:9", *at(device))
    path = tmp_path / "records.jsonl"
    first, second = read_records(path)
    assert (first.command, first.code, first.who) == ("read", 0, "the engineer")
    assert (second.code, second.frames["sent"]) == (4, 1)
    assert "illegal data address" in second.reason
    assert second.previous == sha256_hex(path.read_bytes().splitlines()[0])
    assert find_break(path) is None


@pytest.mark.parametrize("damage", ["changed", "removed", "inserted"])
def test_a_changed_a_missing_and_an_inserted_record_are_found(device: Process, tmp_path: Path, damage: str) -> None:
    for _ in range(3):
        answer(tmp_path, "read", "holding:112", *at(device))
    path = tmp_path / "records.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    if damage == "changed":
        lines[0] = lines[0].replace('"code": 0', '"code": 1')
    elif damage == "removed":
        del lines[1]
    else:
        lines.insert(1, lines[1])
    path.write_text("".join(lines), encoding="utf-8")
    assert find_break(path) in (2, 3)


def test_a_line_that_is_no_record_is_named(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    path.write_text(json.dumps({"what": 1}) + "\n", encoding="utf-8")
    with pytest.raises(RecordsError, match="line 1 is no record"):
        read_records(path)
