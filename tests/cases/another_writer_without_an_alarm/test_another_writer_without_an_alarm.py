"""A second gateway on the PLC was a line in the log only; and a killed gateway's successor called its own past so."""

import asyncio
from pathlib import Path
from typing import Any

from drivers.tag import Value
from gateway.machine.alarms.states import AlarmState
from gateway.plant.app import run
from gateway.settings.config import Config
from gateway.store.read_back import reading, stored_rows
from tests.gateway.support import Bench, JumpClock, config_in, logged, two_modes

ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
    "alarms__off_delay": 2.0,
}


def refusing(count: int, writer: int) -> dict[str, Value | None]:
    """What a PLC reads as that gave the session to this writer, and has refused so many blocks of others."""
    return {"BlocksAccepted": 0, "BlocksRefused": count, "LastRefusal": 7, "SessionWriter": writer}


class Refused(Bench):
    """A PLC that refuses the blocks of the reads from `first` to `last` for that of `writer`."""

    def refuse(self, first: int, last: int, writer: int) -> None:
        self.plan = {read: refusing(max(read - first, 0), writer) for read in range(last)}


async def go(config: Config, bench: Bench, reads: int) -> dict[str, Any]:
    bench.stop_after = reads
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)


async def test_it_is_an_alarm_while_it_writes_and_status_and_log_say_its_number_and_what_to_do(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    bench = Refused(config, JumpClock(), armed=True)
    bench.refuse(5, 25, 4711)
    status = await go(config, bench, 25)
    assert status["alarms"]["another writer"] == "unacknowledged" and status["writeback"]["other_writer"] == 4711
    assert "number 4711 has the session" in status["writeback"]["rival"]
    assert f"this gateway is number {status['writeback']['writer']}" in status["writeback"]["rival"]
    assert "disarm one of the two" in status["writeback"]["rival"]
    said = [row["reason"] for row in logged(tmp_path) if row["event"] == "the PLC refuses blocks"]
    assert said == [status["writeback"]["rival"]]
    bench = Refused(config, bench.clock, armed=True)
    bench.refuse(5, 25, 4711)
    status = await go(config, bench, 60)
    assert status["alarms"]["another writer"] == "returned unacknowledged" and status["writeback"]["rival"] == ""


async def test_the_start_before_has_the_session_for_a_while_and_that_is_no_other_gateway(tmp_path: Path) -> None:
    config, clock = config_in(tmp_path, model=two_modes(), **ARMED), JumpClock()
    killed = (await go(config, Refused(config, clock, armed=True), 5))["writeback"]["writer"]
    bench = Refused(config, clock, armed=True)
    bench.refuse(2, 7, killed)
    status = await go(config, bench, 20)
    assert status["writeback"]["refused"] == 4 and status["alarms"]["another writer"] == "normal"
    assert "start before, whose session the PLC's timer ends" in logged_reasons(tmp_path)
    # Once that cannot be any more, it is somebody who uses the number: a clone, or what was recorded.
    bench = Refused(config, clock, armed=True)
    bench.refuse(30, 40, killed)
    assert (await go(config, bench, 40))["alarms"]["another writer"] == "unacknowledged"
    with reading(config.historian.path) as connection:
        rows = stored_rows(connection, "alarms", ("condition", "state"))
    assert ("another writer", AlarmState.UNACKNOWLEDGED.value) in rows


def logged_reasons(folder: Path) -> str:
    return "\n".join(str(row.get("reason")) for row in logged(folder))
