"""A Modbus device with habits of `tests.rig.device_habits`, over each link: the tests' and the benchmark's."""

import asyncio
import os
import pty
import random
import struct
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

from drivers.errors import LinkDown
from drivers.modbus import rtu
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.tag import DType, Tag
from tests.drivers.certified import folder as certificates
from tests.drivers.certified import server_context
from tests.rig.device_habits import HABITS, LINE, PTY, TCP, TLS, DeviceHabit

TAGS = [Tag(f"T{number}", f"holding:{number}", DType.INT16, writable=True) for number in range(8)]
WRITTEN, MOVING = TAGS[:2], range(2, 8)
MOVES = 4000
"""So many answers until a moving register, an int16, holds the same again."""
SOON = {"timeout": 0.15, "backoff_first": 0.01, "backoff_cap": 0.02}
"""Short waits; a machine that is loaded makes them longer, which costs the tests nothing but time."""


@dataclass
class Habit:
    """A device with one habit or several: registers 0 to 7 hold their own numbers.

    `moving`: those that are not written hold another number, of the same remainder by 8, in each answer (`held`).
    `behind`: of so many answers one is kept back until the next question, and sent before that one's answer.
    """

    quiet: float = 0.0
    silent_at: int = -1
    busy: int = 0
    no_way: int = 0
    stale: int = 0
    transaction: int | None = None
    unit: int | None = None
    beside: int | None = None
    lead: bytes = b""
    late: float = 0.0
    behind: int = 0
    echo: bool = False
    hidden: bool = False
    single: bool = False
    ends_connections: bool = False
    even: bool = False
    most: int = 125
    serial: bool = False
    registers: dict[int, int] = field(default_factory=lambda: {number: number for number in range(8)})
    moving: bool = False
    requests: list[tuple[int, int, int]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    _former: list[dict[int, int]] = field(default_factory=list)
    _asked: Any = field(default_factory=count)

    def answer(self, pdu: bytes) -> bytes | None:
        function, start, number = struct.unpack(">BHH", pdu[:5])
        self.requests.append((function, start, number))
        if self.moving:
            self.times.append(asyncio.get_running_loop().time())
        if self.no_way and function == 3:
            self.no_way -= 1
            return bytes((function | 0x80, 11))
        if self.busy and next(self._asked) % 3 < self.busy:
            return bytes((function | 0x80, 6))
        if function == 16 and self.single:
            return bytes((16 | 0x80, 1))
        if function == 6:
            self._former = [dict(self.registers)] * self.stale
            self.registers[start] = number
            return pdu[:5]
        if function == 3 and (number > self.most or (self.even and (start % 2 or number % 2))):
            return bytes((3 | 0x80, 3))
        if function == 3 and start <= self.silent_at < start + number:
            return None
        if function == 16:
            self._former = [dict(self.registers)] * self.stale
            self.registers |= dict(
                zip(range(start, start + number), struct.unpack(f">{number}H", pdu[6:]), strict=True)
            )
            return pdu[:5]
        shown = self._former.pop() if self._former else self.registers
        if self.hidden:
            shown = {number: number for number in range(8)}
        step = 8 * (len(self.requests) % MOVES) if self.moving else 0
        words = [shown[at] + (step if at in MOVING else 0) for at in range(start, start + number)]
        return struct.pack(f">BB{number}H", function, 2 * number, *words)

    def held(self, at: int, value: int, sent: float, received: float) -> bool:
        """Whether a moving register's value was told between these moments of the loop's time."""
        number, rest = divmod(value - at, 8)
        return not rest and any(
            sent <= self.times[place - 1] <= received for place in range(number, len(self.times) + 1, MOVES) if place
        )

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        born, kept = asyncio.get_running_loop().time(), b""
        try:
            while True:
                head = await reader.readexactly(1 if self.serial else 7)
                size = 7 if self.serial else int.from_bytes(head[4:6], "big") - 1
                request = await reader.readexactly(size)
                if self.serial and request[0] == 16:
                    request += await reader.readexactly(request[5] + 1)
                if self.echo:
                    writer.write(head + request)
                pdu = self.answer(request[:-2] if self.serial else request)
                if pdu is None or asyncio.get_running_loop().time() < born + self.quiet:
                    continue
                await asyncio.sleep(self.late)
                unit = bytes((head[-1] if self.unit is None else self.unit,))
                if self.serial:
                    writer.write(self.lead + unit + pdu + rtu.crc(unit + pdu))
                    continue
                number = head[:2] if self.transaction is None else self.transaction.to_bytes(2, "big")
                if self.beside is not None:
                    writer.write(_headed(number, bytes((self.beside,)) + pdu[:2] + bytes(len(pdu) - 2)))
                if self.behind and not kept and len(self.requests) % self.behind == 0:
                    kept = _headed(number, unit + pdu)
                    continue
                writer.write(kept + _headed(number, unit + pdu))
                kept = b""
                if self.ends_connections:
                    writer.close()
                    return
        except (asyncio.IncompleteReadError, OSError, asyncio.CancelledError):
            writer.close()


def _headed(number: bytes, plain: bytes) -> bytes:
    return number + b"\0\0" + len(plain).to_bytes(2, "big") + plain


@asynccontextmanager
async def served(habit: Habit, link: str = "", folder: Path = Path(), **settings: Any) -> AsyncIterator[dict[str, Any]]:
    """The settings of a driver for the device, over `link`; `folder` is for certificates."""
    link = link or (LINE if habit.serial else TCP)
    if link == PTY:
        async with on_a_pty(habit) as path:
            yield {"transport": PTY, "serial": path, **SOON, **settings}
        return
    context = server_context(folder / "server") if link == TLS else None
    server = await asyncio.start_server(habit.serve, "127.0.0.1", 0, ssl=context)
    own = {"certificates": str(certificates(folder / "client"))} if link == TLS else {}
    try:
        port = server.sockets[0].getsockname()[1]
        yield {"transport": link, "host": "127.0.0.1", "port": port, **SOON, **own, **settings}
    finally:
        server.close()


@asynccontextmanager
async def on_a_pty(habit: Habit) -> AsyncIterator[str]:
    """The device at the other end of a serial port, whose path it is."""
    loop, (near, far) = asyncio.get_running_loop(), pty.openpty()
    tty.setraw(far)
    reader = asyncio.StreamReader()
    receiving, _ = await loop.connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader),
        open(near, "rb", buffering=0, closefd=False),  # noqa: SIM115
    )
    sending, protocol = await loop.connect_write_pipe(
        asyncio.streams.FlowControlMixin,
        open(near, "wb", buffering=0, closefd=False),  # noqa: SIM115
    )
    writer = asyncio.StreamWriter(sending, protocol, reader, loop)
    task = asyncio.ensure_future(habit.serve(reader, writer))
    try:
        yield os.ttyname(far)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        receiving.close()
        await asyncio.sleep(0)
        os.close(near)
        os.close(far)


@asynccontextmanager
async def driven(habit: Habit, link: str = "", folder: Path = Path(), **settings: Any) -> AsyncIterator[ModbusDriver]:
    async with served(habit, link, folder, **settings) as given:
        driver = open_modbus(given, clock=asyncio.get_running_loop().time, write_map=TAGS)
        try:
            with suppress(LinkDown):  # on a loaded machine; it goes on trying
                await driver.open()
            yield driver
        finally:
            await driver.close()


# ---------------------------------------------------------------- drawn together

WALKED = [row for row in HABITS if row.wire]
LINKS = (TCP, LINE, TLS, PTY)
_APART = ({"quiet", "ends_connections"}, {"hidden", "stale"})
"""Habits that no device has together: one that is quiet after each connection and ends each would never be read."""


@dataclass(frozen=True, slots=True)
class Together:
    """Habits that one device has, and the links on which it can have all of them."""

    rows: tuple[DeviceHabit, ...]

    @property
    def links(self) -> tuple[str, ...]:
        return tuple(link for link in LINKS if all(link in row.over for row in self.rows))

    def device(self, link: str, **own: Any) -> Habit:
        wires = {key: value for row in self.rows for key, value in row.wire.items()}
        return Habit(serial=link in (LINE, PTY), **wires, **own)

    def settings(self, link: str) -> dict[str, Any]:
        """What such a device needs, and waits that a loaded machine keeps."""
        needs = {key: value for row in self.rows for key, value in row.needs.items()}
        return {"timeout": 0.5, **({"longest_reply": 0.6} if link in (LINE, PTY) else {}), **needs}

    def lost(self, habit: Habit) -> set[int]:
        """The registers that cannot be read of it: where it is silent, and what is asked together with that."""
        silent = set() if habit.silent_at < 0 else {habit.silent_at}
        return {4, 5} if silent and habit.even else silent


def draw_habits(rng: random.Random) -> Together:
    """Two or three habits that a device may have together, over one link at least."""
    while True:
        link = rng.choice(LINKS)
        rows = rng.sample([row for row in WALKED if link in row.over], rng.choice((2, 3)))
        if not any(apart <= {key for row in rows for key in row.wire} for apart in _APART):
            return Together(tuple(rows))
