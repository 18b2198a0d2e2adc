"""A gateway that was stopped between reading and writing went on with a usable block of age 0 and old readings."""

import random
import signal
import sqlite3
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from sim.plc.record.recording import read_recording
from tests.gateway.support import EPOCH, JumpClock, config_in, scan_of, two_modes
from tests.gateway.test_app import ARMED
from tests.gateway.test_writeback import USABLE, armed
from tests.rig.pair import make_rig, restless_trace

PERIOD, STOPS, SEED = 0.05, 8, 5
LONGEST_S = 1.2
MAX_AGE_S = 0.5
SLACK_S = 0.15
"""From the last look to the PLC's own stamp, on a busy machine."""


def test_a_gateway_that_is_stopped_at_random_moments_sends_nothing_old(tmp_path: Path) -> None:
    rng = random.Random(SEED)
    rig = make_rig(tmp_path, restless_trace(120.0), period=PERIOD)
    text = rig.plant.read_text(encoding="utf-8")
    rig.plant.write_text(text.replace("minutes = 480", f"minutes = 480\nmax_age = {MAX_AGE_S}"), encoding="utf-8")
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        for _ in range(STOPS):
            gateway.wait_for(lambda status: status["writeback"].get("last_verdict") == "written")
            time.sleep(rng.uniform(0.0, 2 * PERIOD))
            gateway.process.send_signal(signal.SIGSTOP)
            time.sleep(rng.uniform(0.1, LONGEST_S))
            gateway.process.send_signal(signal.SIGCONT)
        gateway.wait_for(lambda status: status["writeback"].get("last_verdict") == "written")
        code, _ = gateway.stop()
        assert code == 0
        plc.order("stop")
        plc.wait_for("stopped")
    with closing(sqlite3.connect(rig.historian)) as connection:
        scanned = dict(connection.execute("SELECT sequence, time FROM writes"))
    # A block's own words say when its scan was; the PLC's recording says when it came.
    came = [(block.time, block.fields) for block in read_recording(rig.recording).blocks if block.fields is not None]
    late = [
        (moment - scanned[fields["sequence"]], fields["validity"])
        for moment, fields in came
        if moment - scanned[fields["sequence"]] > MAX_AGE_S + SLACK_S and fields["validity"]
    ]
    assert len(came) > STOPS and late == [], late


async def test_readings_and_permit_count_from_their_first_request_and_the_age_in_the_block_goes_on() -> None:
    writer, wire = await armed()
    clock = writer.clock = JumpClock()
    scan = scan_of({"WritePermit": True, "Challenge": 77.0}, EPOCH)
    clock.time = EPOCH + 0.4
    sent = await writer.offer(scan, {"age": 0.2}, USABLE)
    assert sent is not None and sent.verdict == "written"
    assert wire.blocks[0][5] == 6, "0.2 s when it was read, 0.6 s when it is sent"
    # The reply came when the process went on: its reading is as old as the request.
    frozen = replace(scan_of({"WritePermit": True, "Challenge": 77.0}, EPOCH + 2.4), duration=2.0)
    clock.time = EPOCH + 2.4
    held = await writer.offer(frozen, {"age": 0.0}, USABLE)
    assert held is not None and held.verdict == "held back" and "2.00 s old" in held.reason and len(wire.blocks) == 1


def test_the_bound_follows_the_scans_and_stays_below_the_plcs_timer(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    assert config.map.writeback is not None and config.map.writeback.timeout == 5.0
    for period, bound in ((0.02, 1.0), (0.9, 1.8), (10.0, 2.5)):
        assert replace(config, scan=config.scan.model_copy(update={"period": period})).block_max_age == bound
