"""The plant of the day as processes: PLCs, broker and gateway, with an operator and all who look at it meanwhile."""

import asyncio
import http.client
import json
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from asyncua import Client, Node, ua

from benchmarks.day.judge import Change, Look
from benchmarks.day.script import (
    COOL,
    DEADBAND,
    HOT,
    LIMIT,
    MACHINES,
    NORTHBOUND_DELAY,
    OFF_DELAY,
    OPERATOR,
    SENSOR,
    STEP,
    TARGETS,
    TIME_CONSTANTS,
    Action,
)
from gateway.outside.web.access import AccountRole, add_account
from sim.artefacts.model_json import model_text
from sim.lab.learning.structure import contexts, product_sha
from sim.lab.recordings.trace_file import write_trace
from sim.sha.automaton import Distribution, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.trace import Trace
from tests.rig.pair import Plc, end, plc_process
from tests.rig.servers import Line, free_port

ROOT = Path(__file__).parents[2]
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
PASSWORD = "correct horse battery"  # noqa: S105 - of this day's account
LOOK_SECONDS = {"page": 0.25, "metrics": 0.5, "opcua": 0.2}
"""Real seconds between two looks."""
MODEL_NOISE, MODEL_SCATTER = 0.05, 1.0
"""Of the model: more than the machines have, since a tenth of a real second is six of the plant's."""

DEVICE = """[device]
name = "decanter"
driver = "modbus"
unit = 1
heartbeat = "PlcHeartbeat"
[[tags]]
name = "MarciaDecanter"
address = "holding:100"
dtype = "bool"
bit = 0
[[tags]]
name = "Assorbimento"
address = "holding:101"
dtype = "uint16"
scale = 0.1
unit = "A"
low = 0
high = 350
[[tags]]
name = "PlcHeartbeat"
address = "holding:112"
""" + "".join(
    f'[[tags]]\nname = "{tag}"\naddress = "holding:{address}"\ndtype = "float32"\norder = "CDAB"\nunit = "degC"\n'
    f"low = -20\nhigh = 150\nmax_rate = 5\n"
    for tag, address in ((HOT, 105), (COOL, 107))
)


def day_model() -> Model:
    """What is true of the machines while nothing is wrong with them."""
    still = Flow("constant", {"noise": MODEL_NOISE})
    known = {"OFF/0-100": (False, 5.0), "ON/100-200": (True, 150.0), "ON/200-300": (True, 250.0)}
    locations = {name: Location(name, still) for name in contexts(DECANTER)}
    for name, place in known.items():
        flow = Flow("exponential", {"k": 1.0 / TIME_CONSTANTS[place[0]], "noise": MODEL_NOISE})
        locations[name] = Location(name, flow, Distribution("normal", {"mu": TARGETS[place], "sigma": MODEL_SCATTER}))
    start = Distribution("normal", {"mu": 20.0, "sigma": 1.0})
    return Model(product_sha(DECANTER, locations, "day"), DECANTER, HOT, SENSOR, initial=start)


def write_files(folder: Path, played: dict[str, Trace]) -> None:
    """What does not depend on ports: device file, model, traces, PLCs."""
    (folder / "device.toml").write_text(DEVICE, encoding="utf-8")
    (folder / "model.json").write_text(model_text(day_model()), encoding="utf-8")
    rows = []
    for machine, trace in played.items():
        write_trace(trace, folder / f"{machine}.csv")
        rows.append(f'[[machine]]\nname = "{machine}"\ndevice = "device.toml"\ntrace = "{machine}.csv"\n')
    (folder / "plcs.toml").write_text("".join(rows), encoding="utf-8")


def plant_file(folder: Path, plcs: dict[str, int], broker: int, ports: dict[str, int]) -> Path:
    """The gateway's configuration."""
    section = f"""
[device]
file = "device.toml"
timeout = 0.3
heartbeat_period = {STEP}
[scan]
period = {STEP}
[model]
path = "model.json"
[historian]
path = "records/h.sqlite"
max_interval = {6 * STEP}
[log]
path = "records/log.jsonl"
[forecast]
horizons = [600, 1800]
runs = 50
period = 120.0
[writeback]
mode = "off"
[alarms]
limit = {LIMIT}
deadband = {DEADBAND}
off_delay = {OFF_DELAY}
tags = ["{HOT}", "{COOL}"]
twins = ["{HOT}", "{COOL}"]
[[alarm]]
name = "northbound"
on_delay = {NORTHBOUND_DELAY}
[page]
enabled = true
port = {ports["page"]}
session_minutes = 720.0
[northbound.metrics]
port = {ports["metrics"]}
[northbound.opcua]
port = {ports["opcua"]}
period = {LOOK_SECONDS["opcua"]}
"""
    for payload in ("json", "sparkplug"):
        section += f"""[[northbound.mqtt]]
name = "{payload}"
host = "127.0.0.1"
port = {broker}
tls = false
payload = "{payload}"
group = "day"
node = "box"
tables = ["samples", "alarms"]
"""
    rows = "".join(f'[[machine]]\nname = "{name}"\ndevice = {{ port = {port} }}\n' for name, port in plcs.items())
    path = folder / "plant.toml"
    path.write_text(section + rows, encoding="utf-8")
    return path


@dataclass
class Witnesses:
    """What the page, the metrics and OPC UA showed, in seconds of the day; `failures`: looks that were not answered."""

    page: list[Look] = field(default_factory=list)
    metrics: list[Look] = field(default_factory=list)
    notes: list[Change] = field(default_factory=list)
    failures: dict[str, int] = field(default_factory=dict)


class Day:
    """The running plant. `now` is seconds of the day."""

    def __init__(self, folder: Path, speed: float) -> None:
        self.folder, self.speed = folder, speed
        self.witnesses = Witnesses()
        self.begin = 0.0
        self._plc: Plc
        self._ports = {name: free_port() for name in ("page", "metrics", "opcua")}
        self._stop = threading.Event()
        self._cookie = self._token = ""
        self.refused: list[str] = []

    def plant_time(self) -> float:
        """s UTC, as the PLCs' and the gateway's clock has it."""
        ready = self._plc.ready
        return float(ready["epoch"]) + (time.monotonic() - float(ready["monotonic"])) * self.speed

    def now(self) -> float:
        """Seconds of the day."""
        return self.plant_time() - self.begin

    @contextmanager
    def running(self, line: Line, seed: int) -> Iterator[None]:
        """PLCs that hold, and a gateway that reads them and has told all who listen; they look on from then."""
        self._plc = plc_process(
            *("--plant-file", self.folder / "plcs.toml", "--speed", self.speed, "--seed", seed, "--hold", "--stdin")
        )
        try:
            plcs = {name: int(own["port"]) for name, own in self._machines(self._plc.ready).items()}
            (self.folder / "records").mkdir()
            add_account(self.folder / "records/users.json", OPERATOR, AccountRole.OPERATOR, PASSWORD)
            config = plant_file(self.folder, plcs, line.port, self._ports)
            command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(config), "--quiet"]
            with (self.folder / "gateway.txt").open("w", encoding="utf-8") as said:
                gateway = subprocess.Popen(
                    [*command, "--clock", self._plc.clock], cwd=ROOT, stdout=said, stderr=subprocess.STDOUT
                )
            try:
                self._wait_until_read(gateway)
                self._log_in()
                threads = [
                    threading.Thread(target=look, daemon=True)
                    for look in (self._look_at_page, self._look_at_metrics, self._hear_opcua)
                ]
                self._settle()
                self.begin = self.plant_time()
                reply = self._plc.order("start")
                self.begin = min(
                    float(own["plant_time"]) - float(own["position"]) for own in self._machines(reply).values()
                )
                for thread in threads:
                    thread.start()
                yield
                self._stop.set()
                for thread in threads:
                    thread.join(20.0)
                gateway.terminate()
                gateway.wait(60.0)
            finally:
                if gateway.poll() is None:
                    gateway.kill()
                    gateway.wait()
        finally:
            end(self._plc.process)

    def _settle(self) -> None:
        """Wait until nothing stands any more that the start has brought, and have it acknowledged."""
        deadline = time.monotonic() + 30.0
        while alarms := [
            (name, alarm)
            for name, one in self.asked("GET", "/api/plant")["machines"].items()
            for alarm in one["alarms"]
        ]:
            if time.monotonic() > deadline:
                raise RuntimeError(f"an alarm stands before the day has begun: {alarms[0]}")
            for machine, alarm in alarms:
                if alarm["state"] == "returned unacknowledged":
                    self.asked("POST", "/api/alarm", {"machine": machine, "alarm": alarm["name"]})
            time.sleep(0.2)

    @staticmethod
    def _machines(message: dict[str, Any]) -> dict[str, dict[str, Any]]:
        found: dict[str, dict[str, Any]] = message["machines"]
        return found

    def _wait_until_read(self, gateway: "subprocess.Popen[bytes]") -> None:
        deadline = time.monotonic() + 90.0
        while time.monotonic() < deadline:
            if gateway.poll() is not None:
                raise RuntimeError(f"the gateway ended: {(self.folder / 'gateway.txt').read_text()}")
            with suppress(OSError, http.client.HTTPException, ValueError, KeyError):
                machines = self.asked("GET", "/api/plant")["machines"]
                if all(one["status"]["link"]["alive"] for one in machines.values()):
                    self._scraped()
                    with closing(socket.create_connection(("127.0.0.1", self._ports["opcua"]), 1.0)):
                        return
            time.sleep(0.2)
        raise RuntimeError("the gateway does not read all machines")

    # ---------------------------------------------------------------- what happens

    def strike(self, machine: str, kind: str, **more: Any) -> None:
        """Have a PLC misbehave, from now on."""
        self._plc.order("fault", machine=machine, fault={"kind": kind, **more})

    def mend(self, machine: str) -> None:
        """Have a PLC behave again."""
        self._plc.order("clear", machine=machine)

    def act(self, action: Action) -> None:
        """Do at the page what the operator does; again for a while where the alarm has not come yet."""
        body: dict[str, Any] = {"machine": action.machine, "alarm": action.alarm, "change": action.change}
        if action.minutes is not None:
            body |= {"minutes": action.minutes, "reason": "cable is being changed"}
        for _ in range(10):
            reply = self.asked("POST", "/api/alarm", body)
            if "reason" not in reply:
                return
            time.sleep(0.1)
        self.refused.append(
            f"{action.machine}, {action.alarm}: {action.change} at {action.time:.0f} s: {reply['reason']}"
        )

    # ---------------------------------------------------------------- the page

    def asked(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        """What the page's interface answers."""
        connection = http.client.HTTPConnection("127.0.0.1", self._ports["page"], timeout=10.0)
        try:
            headers = {"Content-Type": "application/json", "Cookie": self._cookie, "X-CSRF-Token": self._token}
            connection.request(method, path, None if body is None else json.dumps(body), headers)
            answer = connection.getresponse()
            text = answer.read()
            if (cookie := answer.getheader("Set-Cookie")) is not None:
                self._cookie = cookie.partition(";")[0]
            return json.loads(text)
        finally:
            connection.close()

    def _log_in(self) -> None:
        self._token = self.asked("POST", "/api/session", {"name": OPERATOR, "password": PASSWORD})["token"]

    def _look_at_page(self) -> None:
        def look() -> None:
            for name, one in self.asked("GET", "/api/plant")["machines"].items():
                at = one["status"]["time"] - self.begin
                states = {alarm["name"]: alarm["state"] for alarm in one["alarms"]}
                self.witnesses.page.append(Look(name, at, at, states))

        self._again_and_again("page", look)

    # ---------------------------------------------------------------- metrics

    def _scraped(self) -> str:
        with urlopen(f"http://127.0.0.1:{self._ports['metrics']}/metrics", timeout=10.0) as answer:
            text: str = answer.read().decode()
            return text

    def _look_at_metrics(self) -> None:
        row = re.compile(r'^decanter_alarm_(active|waiting)\{alarm="([^"]*)",machine="([^"]*)",[^}]*\} (\S+)$', re.M)

        def look() -> None:
            before = self.now()
            text = self._scraped()
            after = self.now()
            found: dict[str, dict[str, dict[str, bool]]] = {machine: {} for machine in MACHINES}
            for kind, alarm, machine, value in row.findall(text):
                found[machine].setdefault(alarm, {})[kind] = float(value) > 0
            for machine, alarms in found.items():
                states = {name: flags(**both) for name, both in alarms.items()}
                self.witnesses.metrics.append(Look(machine, before, after, states))

        self._again_and_again("metrics", look)

    def _again_and_again(self, name: str, look: Callable[[], None]) -> None:
        while not self._stop.is_set():
            try:
                look()
            except (OSError, http.client.HTTPException, ValueError, KeyError):
                self.witnesses.failures[name] = self.witnesses.failures.get(name, 0) + 1
            self._stop.wait(LOOK_SECONDS[name])

    # ---------------------------------------------------------------- OPC UA

    def _hear_opcua(self) -> None:
        asyncio.run(self._subscribed())

    async def _subscribed(self) -> None:
        day = self

        class Listener:
            """Keeps what is told."""

            def datachange_notification(self, node: Node, value: Any, data: Any) -> None:
                machine, _, alarm, _ = str(node.nodeid.Identifier).split("/")
                source = data.monitored_item.Value.SourceTimestamp
                at = (source.replace(tzinfo=UTC) - EPOCH).total_seconds() - day.begin
                day.witnesses.notes.append(Change(at, machine, alarm, str(value)))

        client = Client(f"opc.tcp://127.0.0.1:{self._ports['opcua']}/decanter", timeout=20)
        async with client:
            index = await client.get_namespace_index("urn:decanter-gateway:machines")
            nodes = []
            for machine in MACHINES:
                folder = client.get_node(ua.NodeId(f"{machine}/Alarm", index))
                for alarm in await folder.get_children():
                    nodes.append(client.get_node(ua.NodeId(f"{alarm.nodeid.Identifier}/state", index)))
            subscription = await client.create_subscription(100, Listener())
            for node in nodes:
                await subscription.subscribe_data_change(node, queuesize=100)
            while not self._stop.is_set():
                await asyncio.sleep(0.2)


def flags(*, active: bool, waiting: bool) -> str:
    """What metrics tell of a state."""
    return f"{'active' if active else 'over'}, {'waiting' if waiting else 'known'}"


FLAGS = {
    "normal": flags(active=False, waiting=False),
    "unacknowledged": flags(active=True, waiting=True),
    "acknowledged": flags(active=True, waiting=False),
    "returned unacknowledged": flags(active=False, waiting=True),
    "shelved": flags(active=False, waiting=False),
}
"""The states as metrics have them: an alarm that is put aside is as one that is normal."""
