"""Frames as a pcap file, written as they come, so that any protocol analyser can read what went over the wire.

The bytes are those of the program's end of the wire; the IP and TCP headers around them are made here (without a
handshake, with true addresses and sequence numbers that count the bytes), since a program without privileges sees none.
"""

import ipaddress
import struct
from pathlib import Path
from typing import BinaryIO

from drivers.named_files import name_write_errors
from drivers.tap import Medium, TapFrame
from gateway.store import make_private

LINK_TYPES: dict[Medium, int] = {"tcp": 101, "udp": 101, "serial": 147, "can": 227}
"""LINKTYPE_RAW (IP from the first byte), LINKTYPE_USER0 (RTU bytes as they stand), LINKTYPE_CAN_SOCKETCAN."""
_MAGIC = 0xA1B2C3D4
_LONGEST = 65535
_TCP, _UDP = 6, 17
_PSH_ACK = 0x18
_UNKNOWN = "0.0.0.0:0"


class PcapWriter:
    """A pcap file of one medium, from `PcapWriter(path, medium)` to `close`. Raises OSError.

    Frames of another medium are left out and counted in `foreign`.
    """

    def __init__(self, path: Path, medium: Medium) -> None:
        self.path, self.medium, self.foreign = path, medium, 0
        make_private(path)
        self._file: BinaryIO = path.open("wb")
        self._file.write(struct.pack(">IHHiIII", _MAGIC, 2, 4, 0, 0, _LONGEST, LINK_TYPES[medium]))
        self._moved: dict[tuple[str, str], int] = {}

    def write(self, frame: TapFrame) -> None:
        """Append one frame, durable against the end of the program."""
        if frame.medium != self.medium:
            self.foreign += 1
            return
        data = self._packet(frame) if frame.medium in ("tcp", "udp") else frame.data
        seconds, rest = divmod(frame.time, 1.0)
        head = struct.pack(">IIII", int(seconds), int(rest * 1e6), len(data), len(data))
        with name_write_errors(self.path):
            self._file.write(head + data)
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _packet(self, frame: TapFrame) -> bytes:
        # Each direction counts the bytes that it has sent, and acknowledges those of the other one.
        ours, theirs = frame.local or _UNKNOWN, frame.place or _UNKNOWN
        source, target = (ours, theirs) if frame.sent else (theirs, ours)
        if frame.medium == "udp":
            return _udp_packet(source, target, frame.data)
        sequence, heard = self._moved.get((source, target), 1), self._moved.get((target, source), 1)
        self._moved[source, target] = (sequence + len(frame.data)) & 0xFFFFFFFF
        return _tcp_packet(source, target, sequence, heard, frame.data)


def _udp_packet(source: str, target: str, data: bytes) -> bytes:
    ports = _split(source)[1], _split(target)[1]
    # UDP (RFC 768): ports, length, checksum.
    return _ip_packet(source, target, _UDP, struct.pack(">HHHH", *ports, 8 + len(data), 0), data)


def _tcp_packet(source: str, target: str, sequence: int, heard: int, data: bytes) -> bytes:
    ports = _split(source)[1], _split(target)[1]
    # TCP (RFC 9293): ports, sequence, acknowledgement, 5 words of header, flags, window, checksum, urgent pointer.
    head = struct.pack(">HHIIBBHHH", *ports, sequence, heard, 5 << 4, _PSH_ACK, 0xFFFF, 0, 0)
    return _ip_packet(source, target, _TCP, head, data)


_CHECKSUM_AT = {_TCP: 16, _UDP: 6}


def _ip_packet(source: str, target: str, protocol: int, head: bytes, data: bytes) -> bytes:
    (from_ip, _), (to_ip, _) = _split(source), _split(target)
    length = len(head) + len(data)
    if from_ip.version == to_ip.version == 4:
        # The checksum is over a pseudo header too, which ties the segment to its addresses.
        pseudo = from_ip.packed + to_ip.packed + struct.pack(">BBH", 0, protocol, length)
        # IPv4 (RFC 791): version 4 with 5 words, may not be fragmented, 64 hops; its own checksum is at byte 10.
        ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + length, 0, 0x4000, 64, protocol, 0) + from_ip.packed + to_ip.packed
        ip = ip[:10] + struct.pack(">H", checksum(ip)) + ip[12:]
    else:
        # One address of each kind, as a dual-stack socket gives them: both are written as IPv6.
        from_ip, to_ip = _as_v6(from_ip), _as_v6(to_ip)
        pseudo = from_ip.packed + to_ip.packed + struct.pack(">I3xB", length, protocol)
        ip = struct.pack(">IHBB", 6 << 28, length, protocol, 64) + from_ip.packed + to_ip.packed
    # Over a header whose checksum is still 0; it is put there then.
    total, at = checksum(pseudo + head + data), _CHECKSUM_AT[protocol]
    return ip + head[:at] + struct.pack(">H", total) + head[at + 2 :] + data


_Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def _split(place: str) -> tuple[_Address, int]:
    host, _, port = place.rpartition(":")
    try:
        return ipaddress.ip_address(host.strip("[]").partition("%")[0]), int(port)
    except ValueError:
        return ipaddress.IPv4Address(0), 0


def _as_v6(address: _Address) -> ipaddress.IPv6Address:
    if isinstance(address, ipaddress.IPv6Address):
        return address
    return ipaddress.IPv6Address(b"\0" * 10 + b"\xff\xff" + address.packed)


def checksum(data: bytes) -> int:
    """The internet checksum (RFC 1071)."""
    padded = data + b"\0" * (len(data) % 2)
    total = int(sum(struct.unpack(f">{len(padded) // 2}H", padded)))
    while total >> 16:  # ones' complement: a carry is added at the other end
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
