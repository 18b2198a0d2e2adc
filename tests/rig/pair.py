"""The gateway against the software PLC, each a process of its own: started, ordered about, killed, stopped, judged."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim.artefacts.model_json import model_text
from sim.lab.learning.structure import contexts, product_sha
from sim.lab.recordings.trace_file import write_trace
from sim.sha.automaton import Distribution, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.trace import Array, Trace

ROOT = Path(__file__).parents[2]
MAP = ROOT / "config/devices/decanter_plc.toml"
TEMPERATURE, CURRENT, RUNNING = "TCuscinettiRiduttore", "Assorbimento", "MarciaDecanter"
PATIENCE_S = 300.0
"""For what only has to come at some time: on a busy machine all takes many times as long as on a quiet one."""
CYCLE_S = 0.02
"""The software PLC's cycle; its heartbeat moves once in each."""
TIMEOUT_S = 0.25
"""The deadline of a request, of which a read has two: a PLC that is silent is noticed within half a second."""

TARGETS = {"OFF/0-100": 20.0, "ON/0-100": 35.0, "ON/100-200": 50.0, "ON/200-300": 65.0, "ON/300+": 80.0}
"""degC, by location: what the known automaton's temperature goes to."""
RATES = {"OFF": 1 / 120.0, "ON": 1 / 80.0}
"""1/s, of the resting and of the running machine."""
SCATTER, NOISE, SENSOR = 0.3, 0.01, 0.05
FOLLOWING = 0.6
"""degC/s^0.5, the noise of a model whose band widens as fast as `restless_trace` moves."""


def known_model(noise: float = NOISE) -> Model:
    """The product of ON/OFF and the current's bins; where a trace cannot go, or nothing is known, nothing moves.

    With much `noise` its estimate follows each reading, however far that is from what it expected.
    """
    still = Flow("constant", {"noise": noise})
    locations = {
        name: Location(
            name,
            Flow("exponential", {"k": RATES[name.partition("/")[0]], "noise": noise}),
            Distribution("normal", {"mu": TARGETS[name], "sigma": SCATTER}),
        )
        if name in TARGETS
        else Location(name, still)
        for name in contexts(DECANTER)
    }
    start = Distribution("normal", {"mu": TARGETS["OFF/0-100"], "sigma": 1.0})
    return Model(product_sha(DECANTER, locations, "known"), DECANTER, TEMPERATURE, SENSOR, initial=start)


def restless_trace(seconds: float, step: float = 0.05) -> Trace:
    """A trace in which every reading moves at each row, so that an old value cannot pass for a present one.

    The current runs up and down between 5 and 345 A, the temperatures between 20 and 60 degC at 0.5 degC/s.
    """
    times: Array = np.arange(round(seconds / step), dtype=np.float64) * step

    def up_and_down(period: float, low: float, high: float) -> Array:
        phase: Array = times / period % 1.0
        up: Array = 1.0 - np.abs(2.0 * phase - 1.0)
        return low + (high - low) * up

    warm = up_and_down(160.0, 20.0, 60.0)
    signals = {
        RUNNING: np.floor(times / 3.0) % 2,
        CURRENT: up_and_down(20.0, 5.0, 345.0),
        "Coppia": up_and_down(17.0, 1.0, 99.0),
        "Differenziale": up_and_down(11.0, 1.0, 60.0),
        "VelocitaPompa": up_and_down(19.0, 5.0, 95.0),
        "TAmbiente": up_and_down(50.0, -5.0, 35.0),
        "LivelloVibrazioni": up_and_down(13.0, 0.0, 40.0),
        "TFango": up_and_down(60.0, 5.0, 95.0),
        TEMPERATURE: warm,
        "TCuscinettiAlimentazione": warm + 7.0,
    }
    return Trace("restless", times, signals, origin="made for a test of faults", synthetic=True)


@dataclass
class Plc:
    """A running software PLC and its control channel on stdin and stdout."""

    process: "subprocess.Popen[str]"
    ready: dict[str, Any]
    events: list[dict[str, Any]] = field(default_factory=list)

    @property
    def clock(self) -> str:
        """The clock as the gateway's --clock takes it."""
        return f"{self.ready['epoch']!r},{self.ready['monotonic']!r},{self.ready['speed']!r}"

    def line(self) -> dict[str, Any]:
        """The next line that the PLC says."""
        assert self.process.stdout is not None
        text = self.process.stdout.readline()
        assert text, "the software PLC has closed its stdout"
        return dict(json.loads(text))

    def order(self, command: str, **keys: Any) -> dict[str, Any]:
        """Give a command; its reply. What else the PLC says on the way is kept in `events`."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"command": command, **keys}) + "\n")
        self.process.stdin.flush()
        while (message := self.line())["event"] != "reply":
            self.events.append(message)
        assert message["ok"], message
        return message

    def wait_for(self, event: str) -> dict[str, Any]:
        """The next event of this name."""
        while (message := self.events.pop(0) if self.events else self.line())["event"] != event:
            pass
        return message


@dataclass
class Gateway:
    """A running gateway and its status file."""

    process: "subprocess.Popen[str]"
    path: Path

    @property
    def status(self) -> dict[str, Any]:
        """The newest status of this process; empty while there is none."""
        try:
            return dict(json.loads(self.path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            return {}

    def wait_for(self, true: Callable[[dict[str, Any]], bool], patience_s: float = PATIENCE_S) -> dict[str, Any]:
        """The first status for which it is true; fails, with the last one, if the gateway ends or it never is."""
        deadline = time.monotonic() + patience_s
        while not ((status := self.status) and true(status)):
            assert self.process.poll() is None, f"the gateway ended with {self.process.returncode}: {self.words()}"
            assert time.monotonic() < deadline, f"it never came true: {brief(status)}"
            time.sleep(0.01)
        return status

    def words(self) -> str:
        """What it has said on standard output and error; only once it has ended."""
        return "".join(pipe.read() for pipe in (self.process.stdout, self.process.stderr) if pipe and not pipe.closed)

    def stop(self, patience_s: float = PATIENCE_S) -> tuple[int, float]:
        """Ask it to stop: exit code, and the seconds that it took."""
        asked = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(patience_s), time.monotonic() - asked


@dataclass(frozen=True)
class Rig:
    """A folder with the trace, the model and the gateway's configuration; where both processes leave their records."""

    folder: Path
    records: Path
    speed: float = 1.0
    environment: Mapping[str, str] | None = None
    """Of the gateway's process; this one's own if it is None."""
    runner: tuple[str, ...] = ()
    """The program that runs the gateway's command; none if it is empty."""

    @property
    def recording(self) -> Path:
        return self.folder / "plc.jsonl"

    @property
    def historian(self) -> Path:
        return self.records / "historian.sqlite"

    @property
    def trace(self) -> Path:
        return self.folder / "trace.csv"

    @property
    def plant(self) -> Path:
        return self.folder / "plant.toml"

    @contextmanager
    def plc(self, *options: str) -> Iterator[Plc]:
        """The PLC as a process, replaying the trace; killed at the end if it still runs."""
        process = _started("sim.plc", *self._plc_options(), *options)
        try:
            yield _ready(process)
        finally:
            end(process)

    def start_plc(self, *options: str) -> Plc:
        """The same, for whoever wants to kill it."""
        return _ready(_started("sim.plc", *self._plc_options(), *options))

    @contextmanager
    def gateway(self, plc: Plc, *options: str) -> Iterator[Gateway]:
        """The gateway as a process on the PLC's clock; killed at the end if it still runs."""
        gateway = self.start_gateway(plc, *options)
        try:
            yield gateway
        finally:
            end(gateway.process)

    def start_gateway(self, plc: Plc, *options: str) -> Gateway:
        """The same, for whoever wants to kill it."""
        status = self.folder / "status.json"
        status.unlink(missing_ok=True)
        port = [] if "[[device.links]]" in self.plant.read_text(encoding="utf-8") else ["--port", plc.ready["port"]]
        arguments = ["run", "--config", self.plant, *port, "--clock", plc.clock, "--quiet"]
        whole = [*map(str, arguments), "--status", str(status), *options]
        process = _started("gateway.cli.main", *whole, environment=self.environment, runner=self.runner)
        return Gateway(process, status)

    def _plc_options(self) -> list[str]:
        options = ["--device", MAP, "--trace", self.trace, "--record", self.recording, "--cycle", CYCLE_S, "--stdin"]
        return [str(option) for option in (*options, "--speed", repr(self.speed))]


def make_rig(
    folder: Path,
    trace: Trace,
    *,
    period: float,
    speed: float = 1.0,
    device: Path = MAP,
    records: Path | None = None,
    mode: str = "armed",
    noise: float = NOISE,
) -> Rig:
    """Write the files of a rig: a gateway with the known model that scans each `period` plant seconds.

    Every reading of every scan is stored (max_interval below the period), so that the judge misses none. `device` is
    the register map that the gateway works by, `records` the folder of historian and log (else `folder` too).
    """
    rig = Rig(folder, records or folder, speed)
    write_trace(trace, rig.trace)
    (folder / "model.json").write_text(model_text(known_model(noise)), encoding="utf-8")
    lines = [
        f"[device]\nfile = {json.dumps(str(device))}\ntimeout = {TIMEOUT_S:g}\nheartbeat_period = {5 * CYCLE_S:g}",
        f"[scan]\nperiod = {period:g}",
        '[model]\npath = "model.json"',
        f"[writeback]\nmode = {json.dumps(mode)}",
        *(['armed_by = "rig"\nreason = "bench on loopback"\nminutes = 480'] if mode == "armed" else []),
        f"[historian]\npath = {json.dumps(str(rig.historian))}\nmax_interval = {period / 100:g}",
        f"[forecast]\nhorizons = [30]\nruns = 50\nperiod = {10 * period:g}",
        f"[log]\npath = {json.dumps(str(rig.records / 'gateway.jsonl'))}",
    ]
    rig.plant.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return rig


def plc_process(*options: object) -> Plc:
    """A software PLC as a process, with these options; the caller ends it."""
    return _ready(_started("sim.plc", *map(str, options)))


def brief(status: dict[str, Any]) -> dict[str, Any]:
    """What of a status tells why it is not well."""
    bad = {name: value for name, value in status.get("values", {}).items() if value["quality"] != "GOOD"}
    return {key: status.get(key) for key in ("phase", "link", "scan", "writeback", "historian")} | {"not good": bad}


def end(process: "subprocess.Popen[str]") -> None:
    """Kill what still runs, wait for it, close its pipes."""
    process.kill()
    process.wait(PATIENCE_S)
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()


def _started(
    module: str, *arguments: str, environment: Mapping[str, str] | None = None, runner: tuple[str, ...] = ()
) -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    command = [*runner, sys.executable, "-m", module, *arguments]
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, cwd=ROOT, env=environment)


def _ready(process: "subprocess.Popen[str]") -> Plc:
    assert process.stdout is not None and process.stderr is not None
    line = process.stdout.readline()
    if not line:
        said = process.stderr.read()
        end(process)
        raise AssertionError(f"the software PLC did not start: {said}")
    return Plc(process, json.loads(line))
