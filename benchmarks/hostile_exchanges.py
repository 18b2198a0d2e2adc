"""Hostile exchanges in virtual time: peers that split, cut, delay, repeat, swap and leave over, and what is GOOD.

`python -m benchmarks.hostile_exchanges [--exchanges N] [--link NAME]... [--seed S] [--json]`. What matches answers to
requests, as it runs (the Modbus drivers whole, of CAN the reception, the SDO client and the ISO-TP receiver), peers in
memory (`benchmarks.hostile_modbus`, `benchmarks.hostile_can`) and a clock on which no time passes by itself. A reading
is wrong if it is GOOD and the device said no such thing to a request of that very reading.
"""

import asyncio
import datetime as dt
import random
import ssl
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest.mock import patch

import click

from benchmarks.figures import Figure, give
from benchmarks.hostile_can import CAN_HABITS, ISOTP_HABITS, SDO_HABITS, can_frames, isotp_messages, sdo_readings
from benchmarks.hostile_modbus import HABITS, LATER_THAN_A_LINE_CAN_TELL, HostileDevice
from benchmarks.hostile_tally import Tally
from benchmarks.memory_net import MemoryLoop, MemoryTransport
from drivers.connections import Connections
from drivers.modbus import serial_line, tls
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.serial_line import LineWire
from drivers.modbus.settings import ModbusSettings
from drivers.tag import DType, Tag

READINGS = 150
"""Of one driver, after which the next one begins with another mixture of habits."""


def _block(area: str, start: int, count: int) -> tuple[Tag, ...]:
    kind = DType.BOOL if area in ("coil", "discrete") else DType.UINT16
    return tuple(Tag(f"{area}_{number}", f"{area}:{number}", kind) for number in range(start, start + count))


# Several of one length: on a line nothing else tells their replies apart.
BLOCKS = (
    _block("holding", 10, 1),
    _block("holding", 50, 1),
    _block("holding", 100, 4),
    _block("holding", 200, 4),
    _block("input", 10, 1),
    _block("coil", 0, 16),
    _block("holding", 300, 20),
)
_FUNCTIONS = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
_PLACE = {"host": "peer", "port": 502}


# ---------------------------------------------------------------- Modbus


class _MemoryPort:
    """A serial port whose far end is the loop's peer."""

    ends = ("peer", "")

    def __init__(self, settings: ModbusSettings, wire: LineWire) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, MemoryLoop) and loop.peer is not None
        self._transport = MemoryTransport(loop, _ToWire(wire), loop.peer)
        loop.peer.connected(self._transport)

    def send(self, data: bytes) -> None:
        """Bytes to the device."""
        self._transport.write(data)

    def close(self) -> None:
        """Nothing comes any more."""
        self._transport.close()


class _ToWire(asyncio.Protocol):
    def __init__(self, wire: LineWire) -> None:
        self._wire = wire

    def data_received(self, data: bytes) -> None:
        self._wire.receive(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._wire.note_loss("the port is gone")


def _settings(link: str, rng: random.Random) -> dict[str, Any]:
    """What a driver of the link is opened with."""
    common = {"timeout": rng.choice((0.1, 0.3)), "attempts": rng.choice((1, 2, 3)), "max_silence": 2.0}
    if link == "rtu":
        return {"transport": "rtu", "serial": "/dev/null", "baud": 115200, **common}
    if link == "rtu-tcp":
        return {"transport": "rtu-tcp", **_PLACE, **common}
    if link == "tls":
        return {"transport": "tls", **_PLACE, "certificates": "none", **common}
    return {"transport": "tcp", **_PLACE, **common}


def habits_of(link: str) -> tuple[str, ...]:
    """What peers of a link do, each drawn some time."""
    own = {"can": CAN_HABITS, "canopen": SDO_HABITS, "iso-tp": ISOTP_HABITS}
    is_line = link.startswith("rtu")
    return own.get(link) or tuple(name for name in HABITS if not (is_line and name in LATER_THAN_A_LINE_CAN_TELL))


async def modbus_readings(link: str, rng: random.Random, tally: Tally) -> None:
    """The readings of one driver, or of three on one connection, and their device."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, MemoryLoop)
    settings, is_line, names = _settings(link, rng), link.startswith("rtu"), habits_of(link)
    device = HostileDevice(
        rng,
        is_line=is_line,
        latest_s=1.9 if is_line else 3.0,
        share=rng.choice((0.1, 0.3, 0.5)),
        habits=tuple(rng.sample(names, rng.randint(2, len(names)))),
    )
    loop.peer = device
    loop.connect_s = lambda: rng.random() * 0.01
    units = rng.choice(((1,), (1,), (1, 2, 3)))
    connections = Connections() if len(units) > 1 or rng.random() < 0.3 else None
    outstanding = rng.choice((1, 2, 4)) if connections is not None and not is_line else 1
    drivers = []
    for unit in units:
        given = {**settings, "unit": unit, "outstanding": outstanding}
        drivers.append((unit, open_modbus(given, clock=loop.time, seed=unit, connections=connections, rng=rng)))
        await drivers[-1][1].open()
    await asyncio.gather(*(_read(unit, driver, device, tally, READINGS // len(units)) for unit, driver in drivers))
    for _, driver in drivers:
        await driver.close()
        for name, part in driver.supervisor.parts().items():
            if part.failure:
                tally.escaped(f"{name}: {part.failure}")
    tally.exchanges += device.requests
    tally.habits.update(device.seen)


async def _read(unit: int, driver: ModbusDriver, device: HostileDevice, tally: Tally, readings: int) -> None:
    rng = device.rng
    for _ in range(readings):
        tags, begin = rng.choice(BLOCKS), asyncio.get_running_loop().time()
        try:
            samples = await driver.read(tags)
        except Exception as error:  # noqa: BLE001 - whatever it is, it has escaped
            tally.escaped(error)
            continue
        good = [(tag, sample) for tag, sample in zip(tags, samples, strict=True) if sample.quality.is_good]
        habits: set[str] = set()
        wrong = ""
        for tag, sample in good:
            area, _, address = tag.address.partition(":")
            place = (unit, _FUNCTIONS[area], int(address))
            assert sample.value is not None and sample.sent is not None
            said = device.habits_of(place, int(sample.value), begin, sample.time)
            if said is None:
                wrong = f"{tag.address} of unit {unit} read as {sample.value} at {sample.time:.3f}"
            habits.update(said or ())
        if good:
            tally.judge(wrong, habits, good=not wrong)
        await asyncio.sleep(rng.choice((0.0, 0.01, 0.1, 0.5)))


# ---------------------------------------------------------------- the command

_Episode = Callable[[str, random.Random, Tally], Coroutine[Any, Any, None]]
LINKS: Mapping[str, _Episode] = {
    **dict.fromkeys(("tcp", "tls", "rtu", "rtu-tcp"), modbus_readings),
    "can": can_frames,
    "canopen": sdo_readings,
    "iso-tp": isotp_messages,
}
# Whose certificates do not matter: on this network nothing is encrypted.
_NOBODY = tls.Identity(Path(), ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), "", dt.datetime.max.replace(tzinfo=dt.UTC))


def suffer(link: str, exchanges: int, seed: int) -> Tally:
    """So many exchanges, or a few more, over the link."""
    tally, episode = Tally(), 0
    with patch.object(serial_line, "_SerialPort", _MemoryPort), patch.object(tls, "load_identity", lambda _: _NOBODY):
        while tally.exchanges < exchanges:
            rng = random.Random(f"{seed} {link} {episode}")
            episode += 1
            before = len(tally.examples)
            with asyncio.Runner(loop_factory=MemoryLoop) as runner:
                runner.get_loop().set_exception_handler(
                    lambda _, context: tally.escaped(context.get("exception") or context["message"])
                )
                runner.run(LINKS[link](link, rng, tally))
            tally.examples[before:] = [f"{link}, episode {episode}: {line}" for line in tally.examples[before:]]
    return tally


@click.command()
@click.option("--exchanges", type=click.IntRange(1), default=100_000, show_default=True, help="Of all links together.")
@click.option("--link", "links", multiple=True, type=click.Choice(tuple(LINKS)), help="One of them; several: again.")
@click.option("--seed", default=1, show_default=True, help="The same exchanges for the same number.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(*, exchanges: int, links: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Count what is wrong and GOOD among hostile exchanges."""
    figures: list[Figure] = []
    chosen = links or tuple(LINKS)
    for link in chosen:
        begin = perf_counter()
        tally = suffer(link, -(-exchanges // len(chosen)), seed)
        figures += [
            Figure(f"{link}: exchanges", tally.exchanges, "", "seconds", perf_counter() - begin),
            Figure(f"{link}: good readings", tally.good, ""),
            Figure(f"{link}: wrong and GOOD", tally.wrong, ""),
            Figure(f"{link}: exceptions that escaped", tally.escapes, ""),
        ]
        for name, count in sorted(tally.habits.items()):
            # Where a reading is not put down to habits, nothing is known of those.
            beside = ("good readings of those", tally.good_by_habit[name]) if tally.good_by_habit else ()
            figures.append(Figure(f"{link}: {name}", count, "", *beside))
        for line in tally.examples[:10]:
            click.echo(line, err=True)
    give("hostile exchanges in virtual time", figures, as_json=as_json)


if __name__ == "__main__":
    main()
