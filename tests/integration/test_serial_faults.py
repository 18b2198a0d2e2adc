"""A serial line to a PLC that answers late, twice, in pieces, wrongly or not at all: no wrong value is ever good."""

import time
from pathlib import Path

from drivers.driver import open_driver
from drivers.tag import Quality, Sample
from gateway.settings.devices import load_device
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from tests.rig.pair import MAP, Plc, make_rig, restless_trace

FAULTS = (
    {"kind": "late", "delay_s": 0.15, "probability": 0.4},
    {"kind": "duplicate"},
    {"kind": "split", "piece": 3},
    {"kind": "cut_short", "probability": 0.5},
    {"kind": "garbage"},
    {"kind": "wrong_unit"},
    {"kind": "wrong_function"},
    {"kind": "wrong_count"},
    {"kind": "wrong_checksum"},
    {"kind": "silent", "probability": 0.3},
    {"kind": "reset"},
    {"kind": "exception", "code": 6},
)
SECONDS = 0.7


TOLERATED = ("duplicate", "split")
"""What a driver has to bear without losing a sample."""


async def read_under(fault: dict[str, object], plc: Plc, record: list[Sample]) -> None:
    """Poll while the fault lasts. Blocks of four registers: their replies are alike, and could be taken for another."""
    device = load_device(MAP)
    face = plc.ready["faces"]["serial"]
    line = {"transport": "rtu", "serial": face["path"], "baud": 115200, "parity": face["parity"]}
    # Where no sample may be lost, a busy machine must not make a reply late.
    timeout = 2.0 if fault["kind"] in TOLERATED else 0.1
    settings = {**device.settings, **line, "timeout": timeout, "attempts": 1, "max_registers": 4, "longest_reply": 0.5}
    offset = float(plc.ready["epoch"]) - float(plc.ready["monotonic"])
    driver = open_driver("modbus", settings, clock=lambda: time.monotonic() + offset)
    await driver.open()
    plc.order("fault", fault={**fault, "duration": SECONDS, "face": "serial"})
    until = time.monotonic() + SECONDS
    while time.monotonic() < until:
        record += await driver.read(device.tags)
    await driver.close()


async def test_under_every_fault_of_a_line_no_wrong_value_is_good(tmp_path: Path) -> None:
    rig = make_rig(tmp_path, restless_trace(60.0), period=0.1)
    with rig.plc("--serial", "pty") as plc:
        for fault in FAULTS:
            seen: list[Sample] = []
            await read_under(fault, plc, seen)
            bad = sum(sample.quality is not Quality.GOOD for sample in seen)
            # What one late reply cost may be had from the parts of its block, within the same reading.
            if fault["kind"] != "late":
                assert (bad == 0) if fault["kind"] in TOLERATED else (bad > 0), (fault, bad)
            if fault["kind"] in TOLERATED:
                # Nor may it take most of that longer deadline: there would be time for a single round.
                assert sum(sample.tag == seen[0].tag for sample in seen) > 1, fault
            wrong = wrong_good(read_recording(rig.recording), seen)
            assert wrong == [], fault
        plc.order("stop")
        plc.wait_for("stopped")
