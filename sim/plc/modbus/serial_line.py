"""The serial face: Modbus RTU on a serial port, or on a pair of pseudo-terminals of its own.

What a pseudo-terminal has not is the line's speed and its parity: bytes arrive at once, whatever `--baud` says.
"""

import asyncio
import contextlib
import os
import pty
import tty
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import serial

from sim.plc.modbus.framing import RTU
from sim.plc.modbus.units import ServedProgram
from sim.plc.program import CycleFaults, InputError, ModbusReply, ModbusRequest

OWN_PAIR = "pty"
_MAX_READ_BYTES = 4096
_PAUSE_S = 0.002
_CHARACTER_BITS = 11
"""Of one character on a Modbus line: start, eight data, parity and stop, or a second stop."""


class SerialFace:
    """One port, one client; `path` is where a client opens its end."""

    name = "serial"

    def __init__(self, plc: ServedProgram, options: Mapping[str, Any], complain: Callable[[str], None]) -> None:
        self.path = str(options["serial"])
        self._plc, self._complain = plc, complain
        self._speed = (options["baud"], options["parity"])
        self._echo = bool(options["serial_echo"])
        self._silence = 3.5 * _CHARACTER_BITS / options["baud"]
        self._port: serial.Serial | None = None
        self._pair: tuple[int, int] | None = None
        self._reader = asyncio.StreamReader()
        self._task: asyncio.Task[None] | None = None
        self._listens = True
        self._broken = ""

    async def open(self) -> None:
        """Open the port, or make a pair. Raises OSError with a reason."""
        if self.path == OWN_PAIR:
            # The own descriptor of the client's end stays open: without one, reading fails while nobody is there.
            self._pair = pty.openpty()
            tty.setraw(self._pair[1])
            self.path = os.ttyname(self._pair[1])
            self._speed = (self._speed[0], "N")
        else:
            baud, parity = self._speed
            self._port = serial.Serial(self.path, baud, parity=parity, timeout=0, exclusive=True)
        os.set_blocking(self._handle, False)
        asyncio.get_running_loop().add_reader(self._handle, self._receive)
        self._task = asyncio.create_task(self._serve(), name="serial face")

    @property
    def _handle(self) -> int:
        if self._pair is not None:
            return self._pair[0]
        if self._port is None:
            raise OSError("the serial port is not open")
        return int(self._port.fileno())

    async def apply(self, line: CycleFaults) -> None:
        """A serial line knows no connections: what refuses them elsewhere is silence here."""
        self._listens = line.listen

    def ready(self) -> dict[str, object]:
        """Where a client opens its end."""
        return {"path": self.path, "baud": self._speed[0], "parity": self._speed[1]}

    async def close(self) -> None:
        """Let the port go."""
        if self._task is None:
            return
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        asyncio.get_running_loop().remove_reader(self._handle)
        if self._port is not None:
            self._port.close()
        for handle in self._pair or ():
            os.close(handle)
        self._task = self._port = self._pair = None

    def _receive(self) -> None:
        try:
            data = os.read(self._handle, _MAX_READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._complain_once(f"the serial port {self.path} is gone ({error.strerror})")
            asyncio.get_running_loop().remove_reader(self._handle)
            return
        self._reader.feed_data(data)
        if self._echo:
            self._write(data)

    async def _serve(self) -> None:
        while True:
            frame = await RTU.read(self._reader)
            if frame.pdu is None:
                detail = {"peer": self.path, "face": self.name, "bytes": frame.raw.hex()}
                self._plc.event("not Modbus", self._plc.clock.monotonic(), detail)
            elif self._listens:
                request = ModbusRequest(self.path, 0, frame.unit, frame.pdu, face=self.name, rtu=True)
                reply = self._plc.exchange(request, self._plc.clock.monotonic())
                await asyncio.sleep(self._silence)
                if reply is not None:
                    await self._send(reply)

    async def _send(self, reply: ModbusReply) -> None:
        if reply.delay_s > 0:
            await asyncio.sleep(reply.delay_s)
        frame = reply.frame()[: reply.cut]
        piece = reply.piece or max(1, len(frame))
        for start in range(0, len(frame), piece):
            self._write(frame[start : start + piece])
            if reply.piece is not None:
                await asyncio.sleep(_PAUSE_S)

    def _write(self, data: bytes) -> None:
        """What nobody takes is lost, as on a line."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._handle, data)

    def _complain_once(self, sentence: str) -> None:
        if sentence != self._broken:
            self._broken = sentence
            self._complain(sentence)


def make(plc: ServedProgram, options: Mapping[str, Any], complain: Callable[[str], None]) -> SerialFace:
    """The serial face. Raises InputError for a port that is not there."""
    path = str(options["serial"])
    if path != OWN_PAIR and not Path(path).exists():
        raise InputError(f"--serial: there is no {path!r}; give a serial port such as /dev/ttyUSB0, or 'pty'")
    return SerialFace(plc, options, complain)
