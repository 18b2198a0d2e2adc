"""The gateway against the software PLC as a process of its own, over a real socket."""

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.machine.reading.clock import PlantClock
from gateway.plant.app import run
from gateway.settings.config import Config
from gateway.store.read_back import history, samples
from gateway.store.score import scorecard
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from tests.gateway.support import ROOT, TEMPERATURE, config_in, plant_file, two_modes
from tests.plc.bench import PATIENCE_S, Process, running, wait_until

SPEED = 20.0


def heating_trace(folder: Path, seconds: int = 3000) -> Path:
    """Runs from 20 s on, warming from 25 towards 50 degC as the tests' model says."""
    temperature, rows = 25.0, ["time,MarciaDecanter,Assorbimento,TCuscinettiRiduttore"]
    for second in range(seconds):
        on = second >= 20
        temperature += (50.0 - temperature) * 0.00995 if on else (20.0 - temperature) * 0.002
        rows.append(f"{second},{int(on)},{150 if on else 0},{temperature:.4f}")
    path = folder / "trace.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def clock_of(plc: Process) -> PlantClock:
    return PlantClock(plc.ready["epoch"], plc.ready["monotonic"], plc.ready["speed"])


def config_for(folder: Path, plc: Process, **more: Any) -> Config:
    given = {
        "device__port": plc.port,
        "device__heartbeat_period": 0.02,
        "writeback__mode": "armed",
        "writeback__armed_by": "Ada",
        "writeback__reason": "end to end",
        "writeback__minutes": 60.0,
        "forecast__horizons": [10.0, 30.0],
        "forecast__runs": 100,
        "forecast__period": 5.0,
        "clock__speed": SPEED,
    }
    return config_in(folder, model=two_modes(), **{**given, **more})


async def until(true: Any, seconds: float = PATIENCE_S) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, "it never came true"
        await asyncio.sleep(0.02)


async def test_over_a_real_socket_through_an_outage_to_a_graceful_stop(tmp_path: Path) -> None:
    record, stop = tmp_path / "record.jsonl", asyncio.Event()
    status_path = tmp_path / "status.json"

    def status() -> dict[str, Any]:
        return dict(json.loads(status_path.read_text())) if status_path.exists() else {}

    with running("--trace", heating_trace(tmp_path), "--speed", str(SPEED), "--record", record) as plc:
        config = config_for(tmp_path, plc)
        gateway = asyncio.create_task(
            run(config, clock=clock_of(plc), stop=stop, status_path=status_path), name="gateway"
        )
        await until(lambda: status().get("writeback", {}).get("accepted", 0) > 60)
        await until(lambda: (status().get("writeback") or {}).get("last_validity") == 31)
        # On a busy computer there may be others, before and after the ordered one.
        outages = status()["link"]["outage_count"]
        silence = plc.order("fault", fault={"kind": "silent"})["number"]  # until it is seen
        await until(lambda: status()["link"]["outage_count"] > outages)
        plc.order("clear", number=silence)
        await until(lambda: status()["link"]["alive"] and status()["writeback"]["last_validity"] == 31)
        stop.set()
        last = await asyncio.wait_for(gateway, PATIENCE_S)
        said = plc.order("status")
        plc.stop()
    assert last["failures"] == 0
    counters = last["writeback"]
    # On a busy computer the PLC's timer may end the session between a scan and its block, which is refused then.
    assert counters["accepted"] == said["accepted"] and counters["refused"] == counters["sessions_ended"]
    assert counters["refused"] == said["refused"]
    assert counters["written"] <= said["accepted"] <= counters["written"] + counters["failed"]
    assert len(last["link"]["outages"]) > outages
    assert all(outage["recovered_s"] is not None for outage in last["link"]["outages"])
    judged = read_recording(record)
    assert judged.blocks[-1].fields is not None and judged.blocks[-1].fields["validity"] == 0
    assert wrong_good(judged, samples(config.historian.path), tolerance_s=3.0 * config.scan.period) == []
    card = scorecard(config.historian.path)
    # Of each of most scans: a busy computer leaves some out, and who was held up sees what has happened since.
    seen = history(config.historian.path)
    assert np.nanmedian(np.abs(seen.mean - seen.measured)) < 0.2 and card.one_step.count > 60
    assert card.writes.verdicts["written"] == counters["written"]


async def test_a_plc_that_dies_and_comes_back_is_read_again_and_its_counters_go_on(tmp_path: Path) -> None:
    trace, stop, status_path = heating_trace(tmp_path), asyncio.Event(), tmp_path / "status.json"
    with running("--trace", trace, "--speed", str(SPEED)) as first:
        config = config_for(tmp_path, first)
        clock = clock_of(first)
        gateway = asyncio.create_task(run(config, clock=clock, stop=stop, status_path=status_path))

        def status() -> dict[str, Any]:
            return dict(json.loads(status_path.read_text())) if status_path.exists() else {}

        await until(lambda: status().get("writeback", {}).get("accepted", 0) > 10)
        before = status()["writeback"]["accepted"]
        first.popen.kill()
        first.popen.wait(PATIENCE_S)
        await until(lambda: not status()["link"]["alive"])
        assert status()["values"][TEMPERATURE]["quality"] != "GOOD"
    again = ["--trace", str(trace), "--speed", str(SPEED), "--port", str(first.port)]
    with running(*again, "--epoch", repr(clock.epoch), "--monotonic", repr(clock.start)):
        await until(lambda: status()["link"]["alive"])
        await until(lambda: status()["writeback"]["accepted"] > before + 10)
        stop.set()
        last = await asyncio.wait_for(gateway, PATIENCE_S)
    assert last["failures"] == 0 and last["writeback"]["refused"] == last["writeback"]["sessions_ended"]


SERVE = """
import sys
from pathlib import Path
from gateway.plant.app import serve
from gateway.machine.reading.clock import PlantClock
from gateway.settings.config import load_config
config = load_config(Path(sys.argv[1]), {"device.port": int(sys.argv[2]), "clock.speed": float(sys.argv[5])})
clock = PlantClock(float(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]))
serve([config], clock=clock, status_path=Path(sys.argv[6]), console=False)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_process_stops_gracefully_on_a_signal(tmp_path: Path, number: signal.Signals) -> None:
    text = (
        "heartbeat_period = 0.02\n"
        '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "signal"\nminutes = 60\n'
        "[forecast]\nhorizons = [10]\nruns = 50"
    )
    path, status = plant_file(tmp_path, text, model=two_modes()), tmp_path / "status.json"
    record = tmp_path / "record.jsonl"
    with running("--trace", heating_trace(tmp_path), "--speed", str(SPEED), "--record", record) as plc:
        ready = [str(plc.ready[key]) for key in ("epoch", "monotonic", "speed")]
        command = [sys.executable, "-c", SERVE, str(path), str(plc.port), *ready, str(status)]
        with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as gateway:
            try:
                wait_until(lambda: plc.order("status")["accepted"] > 10 or gateway.poll() is not None)
                os.kill(gateway.pid, number)
                assert gateway.wait(PATIENCE_S) == 0
                assert gateway.stderr is not None and gateway.stderr.read() == ""
            finally:
                gateway.kill()
        plc.stop()
    last = read_recording(record).blocks[-1]
    assert last.fields is not None and last.fields["validity"] == 0
    assert json.loads(status.read_text())["phase"] == "stopped"
