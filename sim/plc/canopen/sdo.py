"""The SDO server: expedited, segmented and block transfers, both ways (CiA 301, 7.2.4); frames in, frames out."""

from binascii import crc_hqx
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from sim.plc.canopen.eds import Address

TOGGLE, TIMED_OUT, COMMAND, SEQUENCE, CRC = 0x05030000, 0x05040000, 0x05040001, 0x05040003, 0x05040004
WRITE_ONLY, READ_ONLY = 0x06010001, 0x06010002
NO_OBJECT, NOT_MAPPABLE, PDO_LENGTH = 0x06020000, 0x06040041, 0x06040042
LENGTH, TOO_LONG, TOO_SHORT, NO_SUBINDEX, VALUE = 0x06070010, 0x06070012, 0x06070013, 0x06090011, 0x06090030
GENERAL, STATE = 0x08000000, 0x08000022
BLOCK_SEGMENTS = 64
"""Segments of a block that the server asks for when it is written to."""
MAX_TRANSFER_BYTES = 1 << 16


class Abort(Exception):
    """The transfer is given up with this abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


@dataclass(slots=True)
class _Transfer:
    """What a transfer beyond its first frame remembers. `at` counts the bytes that the client has for certain."""

    kind: str
    address: Address
    data: bytes = b""
    announced: int | None = None
    toggle: int = 0
    at: int = 0
    block: int = BLOCK_SEGMENTS
    received: bytearray = field(default_factory=bytearray)
    sequence: int = 0
    last: bool = False


def abort_frame(address: Address, code: int) -> bytes:
    """The frame that gives a transfer up."""
    return _head(0x80, address) + code.to_bytes(4, "little")


class SdoServer:
    """One transfer at a time; a new first frame ends the one before. `read` and `write` raise Abort."""

    def __init__(self, read: Callable[[Address], bytes], write: Callable[[Address, bytes], None]) -> None:
        self._read, self._write = read, write
        self._open: _Transfer | None = None

    def reset(self) -> None:
        """Forget the transfer in hand."""
        self._open = None

    def take(self, data: bytes) -> list[bytes]:
        """The answers to a client's frame; a frame of another length than 8 has none."""
        if len(data) != 8:
            return []
        address = int.from_bytes(data[1:3], "little"), data[3]
        transfer = self._open
        try:
            if transfer is not None and transfer.kind == "blocks in":
                return self._block_segment(transfer, data)
            return self._begin(data, address) or self._continue(data)
        except Abort as abort:
            failed = self._open
            self._open = None
            return [abort_frame(address if failed is None else failed.address, abort.code)]

    # ------------------------------------------------------------ first frames

    def _begin(self, data: bytes, address: Address) -> list[bytes]:
        """The answer to the first frame of a transfer; empty for any other frame."""
        # CiA 301, 7.2.4.3: bits 5..7 are the client's command specifier; 5 and 6 share theirs with the frames that
        # continue a block transfer, which the lowest bits tell apart.
        command = data[0]
        match command >> 5:
            case 1:
                self._open = None
                return [self._download(data, address)]
            case 2:
                self._open = None
                return [self._upload(address)]
            case 5 if command & 3 == 0:
                return [self._block_upload(data, address)]
            case 6 if command & 1 == 0:
                size = int.from_bytes(data[4:8], "little") if command & 2 else None
                self._announce(size)
                self._open = _Transfer("blocks in", address, announced=size)
                self._open.toggle = command & 4
                return [_head(0xA4, address) + bytes([BLOCK_SEGMENTS, 0, 0, 0])]
        return []

    def _upload(self, address: Address) -> bytes:
        content = self._read(address)
        if 1 <= len(content) <= 4:
            return _head(0x43 | 4 - len(content) << 2, address) + content.ljust(4, b"\0")
        self._open = _Transfer("upload", address, data=content)
        return _head(0x41, address) + len(content).to_bytes(4, "little")

    def _download(self, data: bytes, address: Address) -> bytes:
        command = data[0]
        if command & 2:
            size = 4 - (command >> 2 & 3) if command & 1 else 4
            self._write(address, data[4 : 4 + size])
        else:
            size = int.from_bytes(data[4:8], "little") if command & 1 else -1
            self._announce(size if command & 1 else None)
            self._open = _Transfer("download", address, announced=size if command & 1 else None)
        return _head(0x60, address) + bytes(4)

    def _announce(self, size: int | None) -> None:
        if size is not None and size > MAX_TRANSFER_BYTES:
            raise Abort(TOO_LONG)

    def _block_upload(self, data: bytes, address: Address) -> bytes:
        self._open = None
        if not 1 <= data[4] <= 127:
            raise Abort(0x05040002)
        content = self._read(address)
        self._open = _Transfer("block upload", address, data=content, block=data[4])
        return _head(0xC6, address) + len(content).to_bytes(4, "little")

    # ------------------------------------------------------------ what follows

    def _continue(self, data: bytes) -> list[bytes]:
        transfer, command = self._open, data[0]
        if command >> 5 == 4 and command & 0x1F == 0:
            self._open = None  # the client has given up
            return []
        if transfer is None:
            raise Abort(COMMAND)
        match transfer.kind, command >> 5:
            case "upload", 3:
                return [self._send_segment(transfer, command)]
            case "download", 0:
                return [self._take_segment(transfer, data)]
            case "block upload", 5:
                return list(self._send_blocks(transfer, data))
            case "blocks in ended", 6 if command & 1:
                return [self._block_end(transfer, data)]
        raise Abort(COMMAND)

    def _send_segment(self, transfer: _Transfer, command: int) -> bytes:
        if command & 0x10 != transfer.toggle:
            raise Abort(TOGGLE)
        piece = transfer.data[transfer.at : transfer.at + 7]
        transfer.at += len(piece)
        last = transfer.at >= len(transfer.data)
        frame = bytes([transfer.toggle | 7 - len(piece) << 1 | last]) + piece.ljust(7, b"\0")
        transfer.toggle ^= 0x10
        if last:
            self._open = None
        return frame

    def _take_segment(self, transfer: _Transfer, data: bytes) -> bytes:
        command = data[0]
        if command & 0x10 != transfer.toggle:
            raise Abort(TOGGLE)
        transfer.received += data[1 : 8 - (command >> 1 & 7)]
        self._announce(len(transfer.received))
        answer = bytes([0x20 | transfer.toggle]) + bytes(7)
        transfer.toggle ^= 0x10
        if command & 1:
            self._open = None
            self._store(transfer, bytes(transfer.received))
        return answer

    def _store(self, transfer: _Transfer, content: bytes) -> None:
        if transfer.announced is not None and transfer.announced != len(content):
            self._open = transfer
            raise Abort(LENGTH)
        self._open = transfer  # so that an abort names the object
        self._write(transfer.address, content)
        self._open = None

    def _send_blocks(self, transfer: _Transfer, data: bytes) -> Iterator[bytes]:
        """The next block of segments, or the end; the client says how many of the last block it has."""
        match data[0] & 3:
            case 1:
                self._open = None
                return
            case 2:
                # ackseq: what the client has not got in sequence goes out again (7.2.4.3.14).
                transfer.at = min(transfer.at + 7 * data[1], len(transfer.data))
                transfer.block = data[2] if 1 <= data[2] <= 127 else transfer.block
                if transfer.at >= len(transfer.data) and transfer.last:
                    unused = -len(transfer.data) % 7 if transfer.data else 7
                    crc = crc_hqx(transfer.data, 0).to_bytes(2, "little")
                    yield bytes([0xC1 | unused << 2]) + crc + bytes(5)
                    return
        for number in range(1, transfer.block + 1):
            start = transfer.at + 7 * (number - 1)
            piece = transfer.data[start : start + 7]
            last = start + 7 >= len(transfer.data)
            transfer.last = transfer.last or last
            yield bytes([number | (0x80 if last else 0)]) + piece.ljust(7, b"\0")
            if last:
                return

    def _block_segment(self, transfer: _Transfer, data: bytes) -> list[bytes]:
        """One segment of a block written to us; the answer comes at the end of the block."""
        number, last = data[0] & 0x7F, bool(data[0] & 0x80)
        if number == 0:
            self._open = None  # an abort of the client (0x80), or nonsense
            return [] if last else [abort_frame(transfer.address, SEQUENCE)]
        if number == transfer.sequence + 1:
            transfer.sequence = number
            transfer.received += data[1:8]
            self._announce(len(transfer.received))
            transfer.last = last
        # After a gap the rest of the block is passed over; ackseq makes the client begin again behind it.
        if number < BLOCK_SEGMENTS and not last:
            return []
        answer = bytes([0xA2, transfer.sequence, BLOCK_SEGMENTS]) + bytes(5)
        transfer.sequence = 0
        if transfer.last:
            transfer.kind = "blocks in ended"
        return [answer]

    def _block_end(self, transfer: _Transfer, data: bytes) -> bytes:
        content = bytes(transfer.received[: len(transfer.received) - (data[0] >> 2 & 7)])
        if transfer.toggle and crc_hqx(content, 0) != int.from_bytes(data[1:3], "little"):
            raise Abort(CRC)
        self._store(transfer, content)
        return bytes([0xA1]) + bytes(7)


def _head(command: int, address: Address) -> bytes:
    return bytes([command]) + address[0].to_bytes(2, "little") + bytes([address[1]])
