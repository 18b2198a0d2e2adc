"""What a command moved over the wire: counted, hashed and, where asked for, kept as a pcap file."""

import hashlib
import struct
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.driver import capabilities
from drivers.tap import Medium, TapFrame
from gateway.commission.session.pcap import PcapWriter

_GREETING = 64


class FrameEvidence:
    """The tap of one command (see `drivers.tap`). Raises OSError where the pcap file cannot be made.

    `greeting` is the beginning of what was received: it tells what listens there if it is no Modbus.
    """

    def __init__(self, pcap: Path | None = None, medium: Medium = "tcp") -> None:
        self.sent = self.received = self.octets = 0
        self.greeting = b""
        self._digest = hashlib.sha256()
        self._lock = threading.Lock()
        self._pcap = PcapWriter(pcap, medium) if pcap is not None else None

    def take(self, frame: TapFrame) -> None:
        """Count, hash and keep one frame; the hash is over direction, length and bytes of every frame in order.

        A driver may send in one thread and receive in another.
        """
        with self._lock:
            self.sent += frame.sent
            self.received += not frame.sent
            self.octets += len(frame.data)
            if not frame.sent and len(self.greeting) < _GREETING:
                self.greeting += frame.data[:_GREETING]
            self._digest.update(struct.pack(">?I", frame.sent, len(frame.data)) + frame.data)
            if self._pcap is not None:
                self._pcap.write(frame)

    def close(self) -> None:
        """Close the pcap file."""
        if self._pcap is not None:
            self._pcap.close()

    def plain(self) -> dict[str, Any]:
        """As the record has it."""
        return {
            "sent": self.sent,
            "received": self.received,
            "bytes": self.octets,
            "sha256": self._digest.hexdigest(),
            "pcap": str(self._pcap.path) if self._pcap is not None else None,
        }


@dataclass(slots=True)
class Exchanges:
    """How many requests were sent and what became of them; `heard` counts frames of a device that speaks by itself."""

    asked: int = 0
    refused: int = 0
    lost: int = 0
    wrong: int = 0
    foreign: int = 0
    heard: int = 0
    dropped: int = 0

    def add(self, statistics: Mapping[str, float], driver: str) -> None:
        """Take over a driver's counters since it was made; which of them are requests is the driver's to say."""
        for name, keys in (_COUNTERS | {"asked": capabilities(driver).requests}).items():
            setattr(self, name, getattr(self, name) + int(sum(statistics.get(key, 0) for key in keys)))

    def line(self) -> str:
        """The line of frame loss under every result."""
        lines = []
        if self.asked or not self.heard:
            share = f" ({self.lost / self.asked:.1%})" if self.asked else ""
            lines.append(f"{self.asked} requests, {self.lost} without reply{share}, {self.refused} refused")
        if self.wrong or self.foreign:
            lines.append(f"{self.wrong} wrong replies, {self.foreign} that nobody asked for")
        if self.heard or self.dropped:
            lines.append(f"{self.heard} frames heard, {self.dropped} lost in the receiver")
        return "frames: " + "; ".join(lines)

    def plain(self) -> dict[str, int]:
        """As JSON."""
        return {name: getattr(self, name) for name in _COUNTERS}


_COUNTERS: dict[str, tuple[str, ...]] = {
    "asked": ("requests",),
    "refused": ("exceptions", "aborts"),
    "lost": ("timeouts",),
    "wrong": ("mismatches",),
    "foreign": ("foreign_replies",),
    "heard": ("frames",),
    "dropped": ("dropped", "dropped_frames", "overruns"),
}
