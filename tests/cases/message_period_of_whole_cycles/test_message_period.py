"""Messages of 50 ms came every 60 ms: what was due between two cycles of the program waited for the next one."""

import asyncio
from pathlib import Path

from drivers.can.bus.hub import Hub
from sim.plc.can.face import CanFace, make
from sim.plc.canopen.node import OPERATIONAL
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.plc.bench import DECANTER
from tests.plc.test_canopen_node import START, Bench

PERIOD_S, CYCLE_S = 0.05, 0.02
SHOWN = 0x110


async def test_between_two_cycles_a_can_message_keeps_its_period(tmp_path: Path) -> None:
    sent: list[float] = []

    def record(kind: str, moment: float, row: object) -> None:
        if kind == "frame" and isinstance(row, dict) and row["id"] == SHOWN:
            sent.append(moment)

    plc = Plc(read_map(DECANTER), EmulatorClock(0.0, 0.0), record=record)
    with Hub(tmp_path / "bus"):
        options = {"can": DECANTER.parent / "decanter_can.toml", "can_interface": "hub"}
        face: CanFace = make(plc, {**options, "can_channel": str(tmp_path / "bus")}, lambda _: None)
        await face.open()
        # The program runs its cycle once and then stands: whatever comes after comes by the controller's own timer.
        await face.apply(plc.begin(plc.clock.monotonic()))
        async with asyncio.timeout(120.0):
            while len(sent) < 12:
                await asyncio.sleep(0.01)
        await face.close()
    assert sent[-1] - sent[0] > 9 * PERIOD_S  # and not faster than its period


def test_a_late_cycle_puts_no_later_one_off() -> None:
    bench = Bench()
    bench.take(0x000, START)
    assert bench.node.state == OPERATIONAL
    bench.write(0x1800, 5, 50, 2)
    # Noticed up to 19 ms late by a cycle of 20 ms, two seconds long: 40 frames and the first one, not 33.
    frames = [identifier for _ in range(100) for identifier, _ in bench.step(CYCLE_S)]
    assert frames.count(0x181) in (40, 41)
    assert bench.now < bench.node.next_due() <= bench.now + PERIOD_S
