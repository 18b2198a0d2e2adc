"""Several machines in one process: each with its own trace, unit, faults and record; one control channel for all."""

import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.can.bus.hub import Hub
from sim.plc.record.recording import read_recording
from tests.plc.bench import ROOT, Process, Raw, client, ramp, refusal, running, wait_until

CANOPEN = ROOT / "config/devices/decanter_canopen.toml"
CURRENT = struct.pack(">BHH", 3, 101, 1)

PLANT = """
[[machine]]
name = "north"
trace = "{folder}/north/trace.csv"
record = "north.jsonl"
canopen = "{canopen}"

[[machine]]
name = "south"
behind = "north"
unit = 2
trace = "{folder}/south/trace.csv"
offset = 0.3
record = "south.jsonl"
permit = false
canopen = "{canopen}"
node = 2

[[machine]]
name = "east"
unit = 7
"""


def current_of(raw: Raw, unit: int) -> int:
    """One unit's current in tenths of an ampere."""
    sent = raw.send(CURRENT, unit)
    transaction, answered, reply = raw.frame()
    assert (transaction, answered) == (sent, unit)
    return int(struct.unpack(">H", reply[2:])[0])


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, Path]]:
    folder = tmp_path_factory.mktemp("machines")
    for name in ("north", "south"):
        (folder / name).mkdir()
        ramp(folder / name)
    plant, bus = folder / "machines.toml", folder / "can.hub"
    plant.write_text(PLANT.format(folder=folder, canopen=CANOPEN), encoding="utf-8")
    options = ("--can-interface", "hub", "--can-channel", bus, "--control-port", "0", "--hold")
    with Hub(bus), running("--plant-file", plant, *options) as process:
        yield process, folder


def test_the_ready_line_names_each_machine_with_its_places(machines: tuple[Process, Path]) -> None:
    told = machines[0].ready["machines"]
    assert list(told) == ["north", "south", "east"]
    assert told["north"]["port"] == told["south"]["port"] != told["east"]["port"]
    assert [place["unit"] for place in told.values()] == [1, 2, 7]
    assert [told[name]["faces"]["canopen"]["node"] for name in ("north", "south")] == [1, 2]
    assert told["south"]["replay"]["position"] == 0.3 and told["east"]["replay"] is None
    assert machines[0].ready["control_port"] > 0 and "port" not in machines[0].ready


def test_units_behind_one_port_replay_their_own_traces_and_a_command_names_its_machine(
    machines: tuple[Process, Path],
) -> None:
    process, _ = machines
    with client(process.ready["machines"]["north"]["port"]) as raw:
        assert process.order("seek", machine="north", position=1.25)["machine"] == "north"
        wait_until(lambda: current_of(raw, 1) == 120)
        assert current_of(raw, 2) == 30
        # Without a name: for all, and each answers for itself; one that cannot makes the whole false.
        status = process.order("status")
        assert status["ok"] and [own["permit"] for own in status["machines"].values()] == [True, False, True]
        both = process.order("pause")
        assert not both["ok"] and "there is no trace to replay" in both["error"]
        assert [own["ok"] for own in both["machines"].values()] == [True, True, False]
        unknown = process.order("status", machine="west")
        assert not unknown["ok"] and "no 'west'; known are north, south, east" in unknown["error"]


def test_a_fault_strikes_the_machine_that_it_was_ordered_for(machines: tuple[Process, Path]) -> None:
    process, folder = machines
    with client(process.ready["machines"]["north"]["port"]) as raw:
        process.order("fault", machine="south", fault={"kind": "silent"})
        raw.send(CURRENT, 2)
        assert raw.silent_for(0.1)
        assert current_of(raw, 1) >= 0
        # What closes the port of a machine is silence behind another one's.
        process.order("clear", machine="south")
        process.order("fault", machine="south", fault={"kind": "refuse"})
        before = process.order("status", machine="south")["heartbeat"]
        wait_until(lambda: process.order("status", machine="south")["heartbeat"] > before)
        raw.send(CURRENT, 2)
        assert raw.silent_for(0.1)
        assert current_of(raw, 1) >= 0
        process.order("clear", machine="south")
        wait_until(lambda: not process.order("status", machine="south")["faults"])
        before = process.order("status", machine="south")["heartbeat"]
        wait_until(lambda: process.order("status", machine="south")["heartbeat"] > before)
        assert current_of(raw, 2) >= 0
    records = [read_recording(folder / f"{name}.jsonl") for name in ("north", "south")]
    assert [{row.unit for row in record.requests} for record in records] == [{1}, {2}]


def test_a_machine_stops_alone_and_the_process_with_the_last(machines: tuple[Process, Path]) -> None:
    process, _ = machines
    assert process.order("stop", machine="east")["ok"]
    north = process.ready["machines"]["north"]["port"]
    with client(north) as raw:
        assert current_of(raw, 1) >= 0
    assert process.order("stop")["ok"]
    assert process.popen.wait(120) == 0


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds something else than [[machine]] tables"),
        ("[[machine]]\nport = 0", "machine 1: key 'name': is missing"),
        ('[[machine]]\nname = "a"\n[[machine]]\nname = "a"', "machine 2: key 'name': 'a' is taken"),
        ('[[machine]]\nname = "a"\ntrcae = "x.csv"', "machine 1 (a): key 'trcae': is not known; known are name, "),
        ('[[machine]]\nname = "a"\nspeed = 2.0', "machine 1 (a): key 'speed': is not known"),
        ('[[machine]]\nname = "a"\nport = "many"', "machine 1 (a): Invalid value for '--port': 'many'"),
        ('[[machine]]\nname = "a"\nloop = 1', "machine 1 (a): key 'loop': 1 is neither true nor false"),
        ('[[machine]]\nname = "a"\n[[machine]]\nname = "b"\nbehind = "c"', "'c' is no machine with a port"),
        ('[[machine]]\nname = "a"\n[[machine]]\nname = "b"\nbehind = "a"', "key 'unit': 1 is taken behind a"),
        (
            '[[machine]]\nname = "a"\n[[machine]]\nname = "b"\nbehind = "a"\nunit = 2\nserial = "pty"',
            "--serial: a machine behind another one answers over its faces",
        ),
        (
            '[[machine]]\nname = "a"\nrecord = "r"\n[[machine]]\nname = "b"\nrecord = "r"',
            "is given to several machines; give each a file of its own",
        ),
    ],
)
def test_a_file_of_machines_that_cannot_be_used_is_refused_in_one_sentence(
    tmp_path: Path, text: str, sentence: str
) -> None:
    path = tmp_path / "machines.toml"
    path.write_text(text, encoding="utf-8")
    code, words = refusal("--plant-file", path)
    assert code == 2 and words.count("\n") == 1 and sentence in words, words


def test_machines_are_named_on_the_command_line_too() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ("--machine", f"name=a,port={port}", "--machine", f"name=b,unit=2,permit=false,port={port}")
    with running(*options) as process, client(port) as raw:
        assert list(process.ready["machines"]) == ["a", "b"]
        assert process.order("status", machine="b")["permit"] is False
        assert [current_of(raw, unit) for unit in (1, 2)] == [65535, 65535], "one port, given twice, is shared"
    code, words = refusal("--machine", "north")
    assert code == 2 and "give name=north,device=FILE,port=15020" in words
