"""A plant split over two processes under one supervisor: the same records, status and commands as with one."""

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from itertools import pairwise
from pathlib import Path
from subprocess import PIPE, Popen
from threading import Thread
from typing import Any
from urllib.request import urlopen

import pytest
from pymodbus.client import ModbusTcpClient

from gateway.outside.serving import served_rows
from gateway.settings import load_plant
from gateway.store import machines, read, reading, stored_rows, verify
from tests.cli.support import decanter, only_object
from tests.rig.pair import MAP, ROOT, Gateway, Plc, end, plc_process
from tests.rig.servers import free_port, until

MACHINES = ("a", "b", "c", "d")
TEMPERATURE, HEARTBEAT = "TCuscinettiRiduttore", "PlcHeartbeat"


@dataclass(frozen=True)
class SplitPlant:
    """The running gateway of machines a and c in one worker process, b and d in another."""

    file: Path
    gateway: Gateway
    plc: Plc
    served: int
    metrics: int
    lines: list[str]

    def ask(self, *words: str) -> dict[str, Any]:
        """What a command of the program answers."""
        return only_object(decanter(*words, "--config", self.file, "--json").stdout)

    def machines(self) -> dict[str, Any]:
        return dict(self.gateway.status.get("machines", {}))

    def wait_for(self, machine: str, true: Any) -> dict[str, Any]:
        whole = self.gateway.wait_for(lambda status: true(status.get("machines", {}).get(machine) or {"scan": {}}))
        return dict(whole["machines"][machine])

    def accepted(self, machine: str) -> int:
        """The blocks that a machine's PLC has accepted."""
        return int(self.plc.order("status", machine=machine)["accepted"])

    def workers(self) -> set[int]:
        """The ids of the worker processes."""
        pid = self.gateway.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
        return {pid for pid in map(int, children) if is_worker(pid)}


def is_worker(pid: int) -> bool:
    with suppress(OSError):
        return "gateway.plant.worker" in Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8")
    return False


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
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SplitPlant]:
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
[plant]
workers = 2
[device]
file = {json.dumps(str(MAP))}
heartbeat_period = 0.2
[scan]
period = 0.1
[historian]
path = "h.sqlite"
[log]
path = "log.jsonl"
[writeback]
mode = "shadow"
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
        yield SplitPlant(file, Gateway(process, folder / "s.json"), plc, served, metrics, lines)


def test_the_machines_of_all_processes_are_read_and_shown_as_one_plants(plant: SplitPlant) -> None:
    for name in MACHINES:
        plant.wait_for(name, lambda one: one["scan"].get("count", 0) > 5 and one["link"]["alive"])
    assert len(plant.workers()) == 2
    assert list(plant.ask("status")["machines"]) == list(MACHINES)
    assert plant.ask("status", "--machine", "d")["status"]["machine"] == "d"
    refused = decanter("status", "--machine", "e", "--config", plant.file)
    assert refused.exit_code == 2 and "this gateway has a, b, c, d" in refused.stderr


def beats_alike(peer: ModbusTcpClient, direct: ModbusTcpClient, row: Any, unit: int) -> bool:
    """Whether the gateway serves a heartbeat that is good and not long before the PLC's own; late on a busy machine."""
    told = peer.read_holding_registers(row.start, count=row.count, device_id=unit)
    quality, age = peer.read_holding_registers(row.quality, count=2, device_id=unit).registers
    own = direct.read_holding_registers(row.start, count=row.count, device_id=1)
    if told.isError() or own.isError() or quality != 0 or age >= 20:
        return False
    assert told.registers[0] <= own.registers[0], "no count that the PLC had not yet"
    return bool(own.registers[0] - told.registers[0] < 100)


def test_peers_and_browsers_are_shown_the_machines_of_all_processes(plant: SplitPlant) -> None:
    configs = {config.machine: config for config in load_plant(plant.file)}
    with ModbusTcpClient("127.0.0.1", port=plant.served) as peer:
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
        assert peer.read_holding_registers(0, count=1, device_id=5).isError()
    log = plant.file.with_name("log.jsonl").read_text(encoding="utf-8").splitlines()
    (address,) = (row["address"] for row in map(json.loads, log) if row["event"] == "the page is served")
    with urlopen(f"{address}/api/plant", timeout=60.0) as reply:  # noqa: S310 - its own address
        shown = json.load(reply)
    assert list(shown["machines"]) == list(MACHINES)
    with urlopen(f"{address}/api/live", timeout=60.0) as stream:  # noqa: S310
        assert set(json.loads(stream.readline().removeprefix(b"data: "))["machines"]) == set(MACHINES)


def test_other_systems_are_told_of_the_machines_of_all_processes(plant: SplitPlant) -> None:
    until(lambda: len({line.split(",", 3)[2] for line in list(plant.lines)}) == len(MACHINES))
    told = [line.rpartition(" ")[0].split(" ")[0] + line.rpartition(" ")[2] for line in list(plant.lines)]
    assert len(told) == len(set(told)) > 100
    with urlopen(f"http://127.0.0.1:{plant.metrics}/metrics") as answer:
        text = answer.read().decode()
    assert all(f'decanter_link_up{{machine="{name}"}} 1.0' in text for name in MACHINES)
    assert 'decanter_northbound_connected{sink="it"} 1.0' in text


def test_one_machine_is_armed_and_disarmed_by_its_name(plant: SplitPlant) -> None:
    words = ("--by", "A. Rossi", "--reason", "trial", "--minutes", "5")
    for name in ("b", "c"):
        assert plant.ask("plc", "arm", *words, "--machine", name)["ok"]
        plant.wait_for(name, lambda one: one["scan"] and one["writeback"].get("accepted", 0) > 2)
    assert plant.accepted("a") == plant.accepted("d") == 0
    assert plant.ask("plc", "disarm", "--by", "A. Rossi", "--reason", "enough", "--machine", "b")["ok"]
    assert plant.machines()["d"]["writeback"]["mode"] == "shadow"
    plant.wait_for("b", lambda one: one["writeback"]["mode"] == "shadow")


def scan_times(plant: SplitPlant, machine: str, since: float) -> list[float]:
    """When a machine was scanned from then on (plant s), as far as it is on record."""
    with reading(plant.file.with_name("h.sqlite")) as connection:
        return [float(time) for (time,) in stored_rows(connection, "scans", ("time",), since, machine=machine)]


def test_a_process_that_is_killed_is_begun_anew_and_costs_the_others_no_scan(plant: SplitPlant) -> None:
    arming = ("--by", "B", "--reason", "r", "--minutes", "5", "--machine", "a")
    assert plant.ask("plc", "arm", *arming)["ok"]
    before, processes = plant.machines(), plant.workers()
    killed = min(processes)  # the first one that was begun: that of a and c
    os.kill(killed, signal.SIGKILL)
    down = plant.wait_for("c", lambda one: not one["link"]["alive"])
    assert "was ended by SIGKILL" in down["link"]["reason"] and down["phase"] == "starting"
    assert set(plant.ask("status")["machines"]) == set(MACHINES)
    refused = decanter("plc", "arm", *arming, "--config", plant.file)
    assert refused.exit_code != 0 and "is being begun anew" in refused.stderr
    # What takes away needs no process: the next one finds it on record.
    assert plant.ask("plc", "disarm", "--by", "A. Rossi", "--reason", "doubt", "--machine", "c")["ok"]
    restarted = plant.wait_for("c", lambda one: one["link"]["alive"] and one["phase"] == "running")
    after = plant.machines()
    assert killed not in plant.workers() and len(plant.workers()) == 2
    assert restarted["parts"]["process"]["restarts"] == 1 and restarted["writeback"]["mode"] == "shadow"
    # A person's word outlives the process, as it does that of a whole gateway.
    plant.wait_for("a", lambda one: one["writeback"]["mode"] == "armed" and one["writeback"]["accepted"] > 2)
    # On a busy machine any scan may be late. To wait for the process that is begun anew would cost as long as that.
    begun = before["c"]["time"]
    until(lambda: all(scan_times(plant, name, restarted["time"]) for name in MACHINES))
    gaps = {name: max(b - a for a, b in pairwise([begun, *scan_times(plant, name, begun)])) for name in MACHINES}
    for name in ("b", "d"):
        assert after[name]["scan"]["count"] - before[name]["scan"]["count"] > 5
        assert after[name]["writeback"]["writer"] == before[name]["writeback"]["writer"]
        assert gaps[name] < gaps["c"] / 2, gaps


def test_a_changed_file_is_taken_over_by_the_process_that_it_concerns(plant: SplitPlant) -> None:
    text = plant.file.read_text(encoding="utf-8")
    plant.file.write_text(text.replace("workers = 2", "workers = 3"), encoding="utf-8")
    refused = decanter("reload", "--config", plant.file)
    assert refused.exit_code == 1 and "plant.workers: 2 -> 3: is common to all machines" in refused.stderr
    plant.file.write_text(text.replace('name = "d"', 'name = "d"\nscan = { period = 0.05 }'), encoding="utf-8")
    processes = plant.workers()
    before = plant.machines()
    assert plant.ask("reload")["changes"] == {"d": ["scan.period: 0.1 -> 0.05"]}
    plant.wait_for("d", lambda one: one["scan"].get("period") == 0.05 and one["link"]["alive"])
    assert plant.workers() == processes
    assert plant.machines()["b"]["writeback"]["writer"] == before["b"]["writeback"]["writer"]


def test_a_stop_takes_back_what_stands_in_the_plcs_and_the_records_are_one_and_whole(plant: SplitPlant) -> None:
    for name in ("c", "d"):
        assert plant.ask("plc", "arm", "--by", "A", "--reason", "r", "--minutes", "5", "--machine", name)["ok"]
        plant.wait_for(name, lambda one: one["writeback"]["mode"] == "armed" and one["writeback"]["accepted"] > 2)
    processes = plant.workers()
    code, _ = plant.gateway.stop()
    assert code == 0  # the process that ended by SIGKILL was begun anew, and the stop is in order
    assert not any(is_worker(pid) for pid in processes)
    assert not any(plant.plc.order("status", machine=name)["usable"] for name in MACHINES)
    log = plant.file.with_name("audit.sqlite")
    assert not verify(log).problem
    rows = [row.entry.subject for row in read(log, ["write"])]
    for name in MACHINES:
        # Each block is on record before it is sent, and a PLC has accepted no other.
        assert plant.accepted(name) <= rows.count(name)
    with reading(plant.file.with_name("h.sqlite")) as connection:
        assert {name for name, _ in machines(connection)} == set(MACHINES)
        scans = {name: len(stored_rows(connection, "scans", ("time",), machine=name)) for name in MACHINES}
    assert min(scans.values()) > 20
