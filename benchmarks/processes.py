"""The processes that are measured: the software PLC, the gateway, and what the kernel says of them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.bare import TEST_REGISTERS, WRITTEN
from sim.lab.formats.write_model import write_model_directory
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.recordings.trace_file import write_trace
from sim.plant.scenarios import scenario
from sim.sha.events import DECANTER

ROOT = Path(__file__).parents[1]
MAP = ROOT / "config/devices/decanter_plc.toml"
TEMPERATURE, CURRENT = "TCuscinettiRiduttore", "Assorbimento"
LEARNED_FROM = ("cd4", "cd12")
REPLAYED, OFFSET = "cd1", 60.0
CYCLE_S = 0.007
"""The PLC's cycle. 20 ms, its default, and a scan every 50 ms would meet in five phases only; 7 ms meet in all."""
SLOW_CYCLE_S = 0.05
"""The cycle of many PLCs in one process, which takes as much time for each of them."""
FORECAST_SCANS = 10
"""A forecast every so many scans, as config/plant.toml has it, whatever the period that is measured."""
PATIENCE_S = 120.0


class BenchmarkError(click.ClickException):
    """What was to be measured did not happen; the message says what. A command ends with it and with exit code 1."""


def learned_model(folder: Path) -> Path:
    """The model that the gateway runs: learned from two synthetic scenarios, unless it is in `folder` already."""
    out = folder / "model"
    if not (out / "model.json").exists():
        traces = [scenario(name) for name in LEARNED_FROM]
        learned = learn_bins(traces, DECANTER, TEMPERATURE, seed=0, name="benchmark")
        write_model_directory(out, learned.model, learned.values)
    return out


@dataclass(frozen=True, slots=True)
class Plc:
    """The running software PLC: its first line, its recording, and commands over its standard input."""

    process: "subprocess.Popen[str]"
    ready: dict[str, Any]
    recording: Path

    @property
    def port(self) -> int:
        """Where it serves Modbus TCP."""
        return int(self.ready["port"])

    def order(self, command: str, **keys: object) -> dict[str, Any]:
        """Give a command and wait for its reply. Raises BenchmarkError when it is refused or the PLC is gone."""
        put, get = self.process.stdin, self.process.stdout
        if put is None or get is None:
            raise BenchmarkError("the software PLC was started without pipes")
        put.write(json.dumps({"command": command, **keys}) + "\n")
        put.flush()
        for line in get:
            reply: dict[str, Any] = json.loads(line)
            if reply["event"] == "reply":
                if not reply["ok"]:
                    raise BenchmarkError(f"the software PLC refused {command!r}: {reply['error']}")
                return reply
        raise BenchmarkError(f"the software PLC ended before it answered {command!r}")

    def statuses(self) -> list[dict[str, Any]]:
        """What it says of its one machine, or of each."""
        status = self.order("status")
        return list(status["machines"].values()) if "machines" in status else [status]


def recording_of(folder: Path, machine: str) -> Path:
    """Where one of several recorded machines of the software PLC records."""
    return folder / f"{machine}.jsonl"


@contextmanager
def software_plc(
    folder: Path, speed: float = 1.0, machines: Sequence[str] = (), *, recorded: bool = False
) -> Iterator[Plc]:
    """The software PLC at `speed` plant seconds a second, recording everything; it replays a synthetic run.

    With `machines` it is as many, each at another place of that run, which record nothing; if `recorded` each into
    a file of its own, as `recording_of` names it.
    """
    trace, recording = folder / "replay.csv", folder / "plc.jsonl"
    write_trace(scenario(REPLAYED), trace)
    options = ["--device", MAP, "--trace", trace, "--loop", "--stdin", "--speed", speed]
    options += ["--writable", f"holding:{TEST_REGISTERS}-{TEST_REGISTERS + WRITTEN - 1}"]
    if machines:
        rows = []
        for number, name in enumerate(machines):
            rows.append(f'[[machine]]\nname = "{name}"\nport = 0\noffset = {OFFSET + 7 * number}\n')
            if recorded:
                rows.append(f"record = {json.dumps(str(recording_of(folder, name)))}\n")
        (folder / "machines.toml").write_text("".join(rows), encoding="utf-8")
        options += ["--plant-file", folder / "machines.toml", "--cycle", SLOW_CYCLE_S]
    else:
        options += ["--offset", OFFSET, "--record", recording, "--cycle", CYCLE_S]
    command = [sys.executable, "-m", "sim.plc", *map(str, options)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as process:
        try:
            line = process.stdout.readline() if process.stdout else ""
            if not line:
                raise BenchmarkError("the software PLC did not start")
            yield Plc(process, json.loads(line), recording)
        finally:
            _end(process)


@contextmanager
def gateway(
    folder: Path,
    plc: Plc,
    model: Path,
    period: float,
    speed: float = 1.0,
    *,
    forecast: float | None = None,
    source: Path = ROOT,
    program: Sequence[str] = ("-m", "gateway.cli.main"),
) -> Iterator["subprocess.Popen[bytes]"]:
    """`decanter run`, armed, with historian, log and model, scanning every `period` seconds of plant time.

    It reads all machines of the PLC; `forecast`: see `plant_file`; `source` is the checkout whose code runs, and
    `program` what Python is given to run `decanter`.
    """
    ports = {name: int(one["port"]) for name, one in plc.ready.get("machines", {}).items()}
    plant = plant_file(folder, model, period, speed, forecast=forecast, ports=ports)
    command = [sys.executable, *program, "run", "--config", str(plant)]
    command += [] if ports else ["--port", str(plc.port)]
    with subprocess.Popen([*command, "--quiet"], stdin=subprocess.DEVNULL, cwd=source) as process:
        try:
            yield process
        finally:
            _end(process)


def plant_file(
    folder: Path,
    model: Path,
    period: float,
    speed: float = 1.0,
    *,
    forecast: float | None = None,
    ports: Mapping[str, int] | None = None,
) -> Path:
    """The configuration of that gateway, written into `folder`: a forecast every `forecast` s of plant time.

    `ports` are those of several machines, by name.
    """
    place = folder / "plant.toml"
    text = f"""[device]
file = {json.dumps(str(MAP))}
timeout = 0.3
heartbeat_period = 1.0
[clock]
speed = {speed:g}
[scan]
period = {period:g}
[model]
path = {json.dumps(str(model.resolve()))}
temperature = "{TEMPERATURE}"
[writeback]
mode = "armed"
armed_by = "benchmarks"
reason = "measured against the software PLC on loopback"
minutes = 480
[historian]
path = "historian.sqlite"
[log]
path = "gateway.log.jsonl"
[forecast]
period = {FORECAST_SCANS * period if forecast is None else forecast:g}
"""
    text += "".join(
        f'[[machine]]\nname = "{name}"\ndevice = {{ port = {port} }}\n' for name, port in (ports or {}).items()
    )
    place.write_text(text, encoding="utf-8")
    return place


def until_usable(plc: Plc, process: "subprocess.Popen[bytes]") -> None:
    """Return when the PLC holds a block that it may use in full: model, forecast, location and inputs are good.

    Of many machines nine in ten are enough: some are always where their run begins again, which no model expects.

    Raises BenchmarkError when that takes longer than PATIENCE_S, or the gateway has ended.
    """
    deadline = time.monotonic() + PATIENCE_S
    while sum(usable := [one["usable"] for one in plc.statuses()]) < 0.9 * len(usable):
        if process.poll() is not None:
            raise BenchmarkError(f"the gateway ended with code {process.returncode}")
        if time.monotonic() > deadline:
            raise BenchmarkError(f"no usable block within {PATIENCE_S:g} s")
        time.sleep(0.05)


def _end(process: "subprocess.Popen[Any]") -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()


# ---------------------------------------------------------------- what the kernel says (Linux)


def family_of(pid: int) -> list[int]:
    """A process and all that it has begun."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    return [pid, *(each for child in children for each in family_of(int(child)))]


def cpu_seconds(pid: int) -> float:
    """CPU time of a process and all its threads so far, user and system (fields 14 and 15 of /proc/PID/stat, s)."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    fields = text.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def peak_megabytes(pid: int) -> float:
    """The largest resident size so far (VmHWM of /proc/PID/status, in 10^6 bytes)."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6


def resident_kilobytes(pid: int) -> float:
    """The resident size now (VmRSS of /proc/PID/status, in 10^3 bytes)."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) * 1024 / 1e3


def growth(minutes: NDArray[np.float64], size: NDArray[np.float64]) -> tuple[float, float]:
    """How fast a size (n,) grows over the last half of its times (n,), a minute, and two standard errors of that.

    The line goes through the medians of ten parts, which are more nearly independent than the samples.
    """
    late = np.array_split(np.arange(minutes.size // 2, minutes.size), 10)
    at, median = (np.array([float(np.median(each[part])) for part in late]) for each in (minutes, size))
    (slope, _), covariance = np.polyfit(at, median, 1, cov=True)
    return float(slope), 2.0 * float(np.sqrt(covariance[0, 0]))
