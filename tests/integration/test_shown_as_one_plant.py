"""The machines of one gateway as peers, browsers, sinks and metrics are shown them: side by side, each by its name."""

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from subprocess import PIPE, Popen
from threading import Thread
from typing import Any
from urllib.request import urlopen

import pytest
from pymodbus.client import ModbusTcpClient

from gateway.outside.serving import served_rows
from gateway.settings import load_plant
from tests.rig.pair import MAP, ROOT, Gateway, Plc, end, plc_process
from tests.rig.servers import free_port, until

MACHINES = ("a", "b")
TEMPERATURE, HEARTBEAT = "TCuscinettiRiduttore", "PlcHeartbeat"


@dataclass(frozen=True)
class ShownPlant:
    """The running gateway of both machines, and what it tells others."""

    file: Path
    plc: Plc
    client_values: int
    metrics: int
    lines: list[str]


@contextmanager
def served_points(lines: list[str]) -> Iterator[HTTPServer]:
    """A server that takes points of line protocol, and keeps their lines."""

    class Points(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            lines.extend(self.rfile.read(int(self.headers["Content-Length"])).decode().splitlines())
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            return

    with HTTPServer(("127.0.0.1", 0), Points) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShownPlant]:
    folder = tmp_path_factory.mktemp("plant")
    with ExitStack() as ending:
        options = [word for name in MACHINES for word in ("--machine", f"name={name}")]
        plc = plc_process("--device", MAP, "--cycle", 0.02, "--stdin", *options)
        ending.callback(end, plc.process)
        ports = {name: int(own["port"]) for name, own in plc.ready["machines"].items()}
        rows = "\n".join(
            f'[[machine]]\nname = "{name}"\ndevice = {{ port = {port} }}\nserve = {{ unit = {unit} }}'
            for unit, (name, port) in enumerate(ports.items(), start=1)
        )
        lines: list[str] = []
        points, metrics, served = ending.enter_context(served_points(lines)), free_port(), free_port()
        file = folder / "plant.toml"
        file.write_text(
            f"""
[device]
file = {json.dumps(str(MAP))}
heartbeat_period = 0.2
[scan]
period = 0.1
[historian]
path = "h.sqlite"
[log]
path = "log.jsonl"
[serve]
port = {served}
[page]
enabled = true
port = 0
[northbound.metrics]
port = {metrics}
[[northbound.influx]]
name = "it"
url = "http://127.0.0.1:{points.server_port}"
database = "plant"
tables = ["samples"]
{rows}
""",
            encoding="utf-8",
        )
        command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(file), "--quiet"]
        process = Popen([*command, "--status", str(folder / "s.json")], stdout=PIPE, stderr=PIPE, text=True, cwd=ROOT)
        ending.callback(end, process)
        gateway = Gateway(process, folder / "s.json")
        gateway.wait_for(
            lambda now: all(one["link"]["alive"] for one in now.get("machines", {"": {"link": {"alive": 0}}}).values())
        )
        yield ShownPlant(file, plc, served, metrics, lines)


def beats_alike(peer: ModbusTcpClient, direct: ModbusTcpClient, row: Any, unit: int) -> bool:
    """Whether the gateway serves a heartbeat that is good and not long before the PLC's own; late on a busy machine."""
    told = peer.read_holding_registers(row.start, count=row.count, device_id=unit)
    quality, age = peer.read_holding_registers(row.quality, count=2, device_id=unit).registers
    own = direct.read_holding_registers(row.start, count=row.count, device_id=1)
    if told.isError() or own.isError() or quality != 0 or age >= 20:
        return False
    assert told.registers[0] <= own.registers[0], "no count that the PLC had not yet"
    return bool(own.registers[0] - told.registers[0] < 100)


def test_peers_and_browsers_are_shown_all_machines(plant: ShownPlant) -> None:
    configs = {config.machine: config for config in load_plant(plant.file)}
    with ModbusTcpClient("127.0.0.1", port=plant.client_values) as peer:
        for unit, name in enumerate(MACHINES, start=1):
            rows = {row.tag.name: row for row in served_rows(configs[name])}
            plc = ModbusTcpClient("127.0.0.1", port=plant.plc.ready["machines"][name]["port"])
            with plc as direct:
                # Without a trace the PLC's sensors have failed; its words are good.
                row = rows[TEMPERATURE]
                assert peer.read_holding_registers(row.start, count=row.count, device_id=unit).isError()
                quality, age = peer.read_holding_registers(row.quality, count=2, device_id=unit).registers
                assert quality != 0 and age >= 20
                until(partial(beats_alike, peer, direct, rows[HEARTBEAT], unit))
        assert peer.read_holding_registers(0, count=1, device_id=3).isError()
    log = plant.file.with_name("log.jsonl").read_text(encoding="utf-8").splitlines()
    (address,) = (row["address"] for row in map(json.loads, log) if row["event"] == "the page is served")
    with urlopen(f"{address}/api/plant", timeout=60.0) as reply:  # noqa: S310 - its own address
        shown = json.load(reply)
    assert list(shown["machines"]) == list(MACHINES)
    with urlopen(f"{address}/api/live", timeout=60.0) as stream:  # noqa: S310
        assert set(json.loads(stream.readline().removeprefix(b"data: "))["machines"]) == set(MACHINES)


def test_other_systems_are_told_of_all_machines(plant: ShownPlant) -> None:
    until(lambda: len(plant.lines) > 50 and len({line.split(",", 3)[2] for line in list(plant.lines)}) == len(MACHINES))
    told = [line.rpartition(" ")[0].split(" ")[0] + line.rpartition(" ")[2] for line in list(plant.lines)]
    assert len(told) == len(set(told))
    with urlopen(f"http://127.0.0.1:{plant.metrics}/metrics") as answer:
        text = answer.read().decode()
    assert all(f'decanter_link_up{{machine="{name}"}} 1.0' in text for name in MACHINES)
    assert 'decanter_northbound_connected{sink="it"} 1.0' in text
