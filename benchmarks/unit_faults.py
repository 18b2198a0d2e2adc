"""Units behind one connection, one of them under each fault in turn: what that costs the others' readings.

`python -m benchmarks.unit_faults [--units N] [--seconds S] [--outstanding N] [--quick] [--json]`. The drivers of ten
units, each read at absolute deadlines 0.2 s apart, and a device server of this module's own, which serves a connection
in order: what one reply waits for, all behind it wait for. Time is virtual: it stands still while anything computes,
so that a reading is lost by waiting alone and the figures are the same on every machine (`benchmarks.isolation` has
the whole gateway in real time). A reading that was not done was left out because the one before it took longer than
the period.
"""

import asyncio
import contextlib
import random
import struct
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

import click

from benchmarks.figures import Figure, give, percentile
from benchmarks.virtual_time import virtual_loop
from drivers.connections import Connections
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.tag import Tag

TAGS = tuple(Tag(f"value_{number}", f"holding:{number}") for number in range(10))
PERIOD_S, ANSWER_S, TIMEOUT_S = 0.2, 0.003, 0.25
QUIET_S = 5.0
"""So long nothing is wrong before the fault, and after it."""
Sent = Callable[[bytes, random.Random], Awaitable[bytes]]
"""What is sent instead of the honest reply."""


def after(seconds: float, share: float = 1.0) -> Sent:
    """The honest reply so much later, as often as `share` says; meanwhile the connection stands still."""

    async def sent(honest: bytes, rng: random.Random) -> bytes:
        if rng.random() < share:
            await asyncio.sleep(seconds)
        return honest

    return sent


def instead(made: Callable[[bytes, random.Random], bytes]) -> Sent:
    """Other bytes, at once."""

    async def sent(honest: bytes, rng: random.Random) -> bytes:
        return made(honest, rng)

    return sent


def _exception(honest: bytes, code: int) -> bytes:
    return honest[:4] + bytes((0, 3, honest[6], honest[7] | 0x80, code))


async def _late_refusal(honest: bytes, rng: random.Random) -> bytes:
    await asyncio.sleep(0.4)
    return _exception(honest, 11)


FAULTS: dict[str, Sent] = {
    "no fault": instead(lambda honest, rng: honest),
    "silent": instead(lambda honest, rng: b""),
    "silent now and then (0.3)": instead(lambda honest, rng: b"" if rng.random() < 0.3 else honest),
    "0.1 s slow": after(0.1),
    "0.9 s late, and nobody served meanwhile": after(0.9),
    "0.3 s late now and then (0.3)": after(0.3, 0.3),
    "exception 11 after 0.4 s": _late_refusal,
    "exception 4": instead(lambda honest, rng: _exception(honest, 4)),
    "garbage": instead(lambda honest, rng: rng.randbytes(16)),
    "wrong unit": instead(lambda honest, rng: honest[:6] + bytes((honest[6] ^ 1,)) + honest[7:]),
    "wrong transaction": instead(lambda honest, rng: bytes((honest[0] ^ 1,)) + honest[1:]),
    "too few registers": instead(lambda honest, rng: honest[:4] + bytes((0, 5)) + honest[6:8] + b"\2" + honest[9:11]),
    "flood of 40 replies": instead(lambda honest, rng: 40 * honest),
}


@dataclass
class Server:
    """A device server: each register of a unit holds the unit's number; `fault` is of the unit `harmed`."""

    harmed: int
    fault: Sent = FAULTS["no fault"]
    rng: random.Random = field(default_factory=lambda: random.Random(1))
    connections: int = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, a request after the other."""
        self.connections += 1
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            while True:
                request = await reader.readexactly(12)
                unit, count = request[6], int.from_bytes(request[10:12], "big")
                body = struct.pack(f">BBB{count}H", unit, request[7], 2 * count, *[unit] * count)
                reply = request[:4] + len(body).to_bytes(2, "big") + body
                await asyncio.sleep(ANSWER_S)
                writer.write(await self.fault(reply, self.rng) if unit == self.harmed else reply)
        writer.close()


@dataclass
class UnitReader:
    """Reads a unit at absolute deadlines from `begin` on; `rows` are deadline, lateness (s), and if all was good."""

    unit: int
    driver: ModbusDriver
    begin: float
    rows: list[tuple[float, float, bool]] = field(default_factory=list)
    wrong: int = 0

    async def run(self) -> None:
        """Until it is cancelled."""
        loop, tick = asyncio.get_running_loop(), 0
        while True:
            due = self.begin + tick * PERIOD_S
            await asyncio.sleep(due - loop.time())
            samples = await self.driver.read(TAGS)
            good = [sample for sample in samples if sample.quality.is_good]
            self.wrong += any(sample.value != self.unit for sample in good)
            self.rows.append((due, loop.time() - due, len(good) == len(samples)))
            tick = max(tick + 1, int((loop.time() - self.begin) / PERIOD_S) + 1)


@dataclass(frozen=True)
class Cost:
    """Of the others under a fault: readings done and good (%), lateness (ms); connections made anew, wrong values."""

    done: float
    good: float
    lateness: Sequence[float]
    anew: int
    wrong: int


async def suffered(fault: Sent, units: int, seconds: float, outstanding: int) -> Cost:
    """One unit under the fault for `seconds`, after a quiet time."""
    loop, connections, server = asyncio.get_running_loop(), Connections(), Server(units)
    listener = await asyncio.start_server(server.serve, "127.0.0.1", 0)
    place = {"host": "127.0.0.1", "port": listener.sockets[0].getsockname()[1]}
    settings = {**place, "timeout": TIMEOUT_S, "outstanding": outstanding}
    readers: list[UnitReader] = []
    for unit in range(1, units + 1):
        driver = open_modbus({**settings, "unit": unit}, clock=loop.time, connections=connections)
        await driver.open()
        readers.append(UnitReader(unit, driver, loop.time() + unit * PERIOD_S / units))
    tasks = [asyncio.ensure_future(reader.run()) for reader in readers]
    await asyncio.sleep(QUIET_S)
    server.fault, begin, before = fault, loop.time(), server.connections
    await asyncio.sleep(seconds)
    server.fault, end_at = FAULTS["no fault"], loop.time()
    await asyncio.sleep(QUIET_S)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    for reader in readers:
        await reader.driver.close()
    listener.close()
    rows = [row for reader in readers[:-1] for row in reader.rows if begin <= row[0] < end_at]
    due = (units - 1) * (end_at - begin) / PERIOD_S
    return Cost(
        done=100.0 * len(rows) / due,
        good=100.0 * sum(good for _, _, good in rows) / max(1, len(rows)),
        lateness=[1000.0 * late for _, late, _ in rows],
        anew=server.connections - before,
        wrong=sum(reader.wrong for reader in readers),
    )


@click.command()
@click.option("--units", type=click.IntRange(2, 60), default=10, show_default=True, help="Units of the connection.")
@click.option(
    "--seconds", type=click.FloatRange(0.2), default=60.0, show_default=True, help="Each fault, of virtual time."
)
@click.option("--outstanding", type=click.IntRange(1, 16), default=1, show_default=True, help="Requests under way.")
@click.option("--quick", is_flag=True, help="Three units, two seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(*, units: int, seconds: float, outstanding: int, quick: bool, as_json: bool) -> None:
    """Measure the other units' readings under each fault of one."""
    if quick:
        units, seconds = 3, 2.0
    figures: list[Figure] = []
    for name, fault in FAULTS.items():
        with asyncio.Runner(loop_factory=virtual_loop) as runner:
            cost = runner.run(suffered(fault, units, seconds, outstanding))
        p99, p50 = (percentile(cost.lateness, share) for share in (99, 50))
        figures += [
            Figure(f"{name}: readings done", cost.done, "%", "good of those done, %", cost.good),
            Figure(f"{name}: lateness, p99", p99, "ms", "p50", p50),
            Figure(f"{name}: wrong values", cost.wrong, "", "connections made anew", cost.anew),
        ]
    give(f"one of {units} units under each fault for {seconds:g} s, the others' readings", figures, as_json=as_json)


if __name__ == "__main__":
    main()
