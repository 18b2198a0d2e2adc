"""One gateway for three machines, each a process of its own: what befalls one of them costs the others nothing."""

import json
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest

from gateway.store import machines, reading, stored_rows
from sim.artefacts.model_json import model_text
from sim.lab.recordings.trace_file import write_trace
from tests.cli.support import decanter, only_object
from tests.rig.pair import MAP, ROOT, Gateway, Plc, end, known_model, plc_process, restless_trace

PERIOD = 0.1
TRIES = 10


@dataclass(frozen=True)
class Plant:
    """The running gateway of machines north (armed), south (in shadow) and west (nobody listens there)."""

    file: Path
    gateway: Gateway
    plcs: dict[str, Plc]

    def status(self, machine: str) -> dict[str, Any]:
        return dict(self.gateway.status["machines"][machine])

    def told(self, *words: str) -> dict[str, Any]:
        """What a command of the program answers."""
        return only_object(decanter(*words, "--config", self.file, "--json").stdout)

    def wait_for(self, machine: str, true: Any) -> dict[str, Any]:
        whole = self.gateway.wait_for(lambda status: true(status.get("machines", {}).get(machine) or {"scan": {}}))
        return dict(whole["machines"][machine])


def plant_text(folder: Path, ports: dict[str, int], period: float = PERIOD) -> str:
    rows = "\n".join(f'[[machine]]\nname = "{name}"\ndevice = {{ port = {port} }}' for name, port in ports.items())
    return f"""
[device]
file = {json.dumps(str(MAP))}
timeout = 0.3
heartbeat_period = 0.2
[scan]
period = {PERIOD}
[model]
path = "model.json"
[historian]
path = "h.sqlite"
[log]
path = "log.jsonl"
[forecast]
horizons = [30]
runs = 50
period = 1.0
[writeback]
mode = "shadow"
{rows.replace('name = "south"', f'name = "south"{chr(10)}scan = {{ period = {period} }}')}
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    folder = tmp_path_factory.mktemp("plant")
    write_trace(restless_trace(60.0), folder / "trace.csv")
    (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
    with ExitStack() as ending:
        plcs = {}
        for name in ("north", "south"):
            options = ("--device", MAP, "--trace", folder / "trace.csv", "--cycle", 0.02, "--stdin")
            plcs[name] = plc_process(*options)
            ending.callback(end, plcs[name].process)
        with socket.create_server(("127.0.0.1", 0)) as nobody:
            dead = nobody.getsockname()[1]
        ports = {name: int(plc.ready["port"]) for name, plc in plcs.items()}
        file = folder / "plant.toml"
        file.write_text(plant_text(folder, {**ports, "west": dead}), encoding="utf-8")
        command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(file), "--quiet"]
        process = Popen([*command, "--status", str(folder / "s.json")], stdout=PIPE, stderr=PIPE, text=True, cwd=ROOT)
        ending.callback(end, process)
        yield Plant(file, Gateway(process, folder / "s.json"), plcs)


def test_each_machine_is_read_predicted_and_asked_by_its_name(plant: Plant) -> None:
    for name in ("north", "south"):
        plant.wait_for(name, lambda one: one["scan"].get("count", 0) > 10 and one["prediction"] is not None)
    answer = plant.told("status")
    assert list(answer["machines"]) == ["north", "south", "west"]
    assert answer["health"] == "no readings" and answer["machines"]["west"]["health"] == "no readings"
    assert "west" not in answer["machines"]["north"]["findings"].get("link", "")
    assert plant.told("status", "--machine", "south")["status"]["machine"] == "south"
    rows = plant.told("machine", "list")["machines"]
    assert [row["machine"] for row in rows] == ["north", "south", "west"] and rows[2]["health"] == "no readings"
    refused = decanter("top", "--once", "--machine", "east", "--config", plant.file)
    assert refused.exit_code == 2 and "this gateway has north, south, west" in refused.stderr


def test_only_the_armed_machine_is_written_to_and_its_arming_is_its_own(plant: Plant) -> None:
    words = ("--by", "A. Rossi", "--reason", "trial", "--minutes", "5")
    which = decanter("arm", *words, "--config", plant.file)
    assert which.exit_code == 2 and "name one of them with --machine: north, south, west" in which.stderr
    assert plant.told("arm", *words, "--machine", "north")["ok"]
    plant.wait_for("north", lambda one: one["scan"] and one["writeback"].get("accepted", 0) > 3)
    assert plant.plcs["north"].order("status")["accepted"] > 3
    assert plant.plcs["south"].order("status")["accepted"] == 0
    assert plant.status("south")["writeback"]["mode"] == "shadow"


def scanned_every(period: float, one: dict[str, Any]) -> bool:
    """Whether a machine is scanned with a period, and was a while."""
    return bool(one["scan"]) and one["scan"]["period"] == period and one["scan"]["count"] > 10


def went_on(before: dict[str, Any], after: dict[str, Any]) -> bool:
    """Whether a machine was scanned all the time between two of its statuses.

    To wait for another machine's deadlines would cost three ticks and more for each scan that is done, and so each time
    that it is tried; so does a computer that is busy with other things for as long as it is.
    """
    scans = int(after["scan"]["count"] - before["scan"]["count"])
    missed = int(after["scan"]["missed"] - before["scan"]["missed"])
    return scans >= 5 and missed <= 2 * scans and bool(after["link"]["alive"])


def test_a_machine_that_hangs_costs_the_others_no_scan(plant: Plant) -> None:
    for _ in range(TRIES):
        os.kill(plant.plcs["south"].process.pid, signal.SIGSTOP)
        try:
            before = plant.status("north")
            plant.wait_for("south", lambda one: one["scan"] and not one["link"]["alive"])
            time.sleep(1.0)  # a second of what has to go on
            after = plant.status("north")
        finally:
            os.kill(plant.plcs["south"].process.pid, signal.SIGCONT)
        plant.wait_for("south", lambda one: one["scan"] and one["link"]["alive"])
        if went_on(before, after) and after["writeback"]["accepted"] > before["writeback"]["accepted"]:
            return
    raise AssertionError("north's scans did not go on while south hung, in any of the tries")


def test_a_changed_file_is_taken_over_without_a_scan_lost_where_it_changes_nothing(plant: Plant) -> None:
    text = plant.file.read_text(encoding="utf-8")
    plant.file.write_text(text.replace("[scan]\nperiod", "[scan]\nperiodd"), encoding="utf-8")
    refused = decanter("reload", "--config", plant.file)
    assert refused.exit_code == 2 and "did you mean 'period'" in refused.stderr
    plant.file.write_text(text.replace('"h.sqlite"', '"g.sqlite"'), encoding="utf-8")
    assert "no gateway runs" in decanter("reload", "--config", plant.file).stderr  # another socket, beside g.sqlite
    plant.file.write_text(text.replace("scan = { period = 0.1 }", "scan = { period = 0.05 }"), encoding="utf-8")
    changes = {"south": ["scan.period: 0.1 -> 0.05"]}
    assert plant.told("reload", "--dry-run") == {"ok": True, "changes": changes, "applied": False, "next_start": []}
    for old, new in [(0.1, 0.05), (0.05, 0.1)] * TRIES:
        plant.file.write_text(text.replace("scan = { period = 0.1 }", f"scan = {{ period = {new} }}"), encoding="utf-8")
        changes = {"south": [f"scan.period: {old} -> {new}"]}
        before = plant.status("north")
        assert plant.told("reload") == {"ok": True, "changes": changes, "applied": True, "next_start": []}
        plant.wait_for("south", partial(scanned_every, new))
        after = plant.status("north")
        # The same writer in the same session: it was not begun anew, and its scans went on.
        assert after["writeback"]["writer"] == before["writeback"]["writer"] and after["writeback"]["mode"] == "armed"
        if went_on(before, after):
            break
    assert went_on(before, after)
    assert plant.told("reload")["changes"] == {}


def test_an_eleventh_machine_is_commissioned_while_ten_run(plant: Plant) -> None:
    assert plant.told("machine", "remove", "west")["written"]
    assert plant.told("reload")["changes"] == {"west": ["removed"]}
    extra = plc_process("--device", MAP, "--trace", plant.file.with_name("trace.csv"), "--cycle", 0.02, "--stdin")
    try:
        assert plant.told("machine", "add", "east", "--port", str(extra.ready["port"]))["written"]
        assert plant.told("reload")["changes"] == {"east": ["added"]}
        plant.wait_for("east", lambda one: one["scan"].get("count", 0) > 5 and one["link"]["alive"])
        assert plant.status("north")["writeback"]["mode"] == "armed"
    finally:
        end(extra.process)


def test_the_records_tell_the_machines_apart_and_a_stop_takes_back_what_stands_in_the_plc(plant: Plant) -> None:
    assert plant.gateway.stop()[0] == 0, plant.gateway.words()
    assert plant.plcs["north"].order("status")["usable"] is False
    with reading(plant.file.with_name("h.sqlite")) as connection:
        assert [name for name, _ in machines(connection)] == ["north", "south", "west", "east"]
        verdicts = {
            name: {verdict for _, verdict in stored_rows(connection, "writes", ("time", "verdict"), machine=name)}
            for name in ("north", "south")
        }
    assert "written" in verdicts["north"] and verdicts["south"] == {"shadow"}
