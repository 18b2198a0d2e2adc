"""The gateway and the software PLC over CANopen: a hub, the PLC's node on it, the gateway as its master.

`python -m benchmarks.canopen_rig [FAULT ...]` measures the fault matrix of this link, as `benchmarks.fault_matrix` does
over Modbus TCP; one row a fault, in real seconds.
"""

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

from benchmarks.fault_matrix import PAUSE_S, PERIOD, TOLERANCE_S, Matrix, Seen, suffered, table
from gateway.demo.can_bus import can_hub
from sim.plc.program.faults import FAULT_FACES
from sim.plc.record.recording import PlcRecording
from sim.sha.trace import Trace
from tests.rig.pair import ROOT, Rig, make_rig, restless_trace

DEVICE = ROOT / "config/devices/decanter_canopen.toml"
NODE = 1
EVENT_TIMER_S = 0.1
"""The device file's: so much later than its count stands still a PLC may send the count that it stands at."""
BLOCK = 0x2100
WRITES = (1, 6)
"""Command specifiers of an SDO client's first frame that writes (download, block download)."""


def with_every_kind(rows: Mapping[str, Mapping[str, Any]], face: str) -> Mapping[str, Mapping[str, Any]]:
    """The rows, and each fault of a face alone that has none of them, at its defaults."""
    named = {row["kind"] for row in rows.values()}
    others = [kind for kind, faces in FAULT_FACES.items() if kind not in named and face in faces]
    return {**rows, **{kind: {"kind": kind, "duration": 1.0} for kind in others}}


ROWS: Mapping[str, Mapping[str, Any]] = {
    "missing heartbeat": {"kind": "missing_heartbeat", "duration": 1.0},
    "short PDO": {"kind": "short_pdo", "duration": 1.0},
    "long PDO": {"kind": "long_pdo", "pdo": 2, "duration": 1.0},
    "EMCY": {"kind": "emcy", "code": 0x5000, "duration": 1.0},
    "SDO abort": {"kind": "sdo_abort", "duration": 1.0},
    "SDO late": {"kind": "sdo_late", "delay_s": 1.0, "duration": 1.5},
    "SDO silent": {"kind": "silent", "face": "canopen", "duration": 1.0},
    "node reset": {"kind": "node_reset"},
    "bus-off": {"kind": "bus_off", "duration": 1.5},
    "node off the bus": {"kind": "refuse", "face": "canopen", "duration": 1.5},
    "restart": {"kind": "restart", "down_s": 0.7, "zeros_s": 0.7},
    "frozen image": {"kind": "frozen", "duration": 1.6},
    "frame loss": {"kind": "frame_loss", "share": 0.3, "duration": 1.5},
    "babbling node": {"kind": "babbling_node", "rate": 1000.0, "duration": 1.5},
    "babbling node, our identifiers": {"kind": "babbling_node", "rate": 500.0, "known": True, "duration": 1.5},
    "write ignored": {"kind": "write_ignored", "duration": 1.0},
}
FAULTS = with_every_kind(ROWS, "canopen")
"""What is ordered from the PLC, by the row's name."""
TOLERATED = ("SDO abort", "SDO late", "SDO silent")
"""While the PDOs come, nothing is lost to these."""


@contextmanager
def canopen_rig(folder: Path, trace: Trace, *, period: float, **settings: object) -> Iterator[tuple[Rig, list[str]]]:
    """A rig whose gateway speaks CANopen, and the options with which its PLC has a node; the hub runs meanwhile.

    `settings` are the driver's own, beside those of the device file.
    """
    rig = make_rig(folder, trace, period=period)
    with can_hub(folder) as path:
        over_hub(rig, path, DEVICE, {"name": "canopen", "configure": True, **settings})
        yield rig, face(path)


def over_hub(rig: Rig, path: Path, device: Path, settings: Mapping[str, object]) -> None:
    """Have the rig's gateway speak over the hub at `path`, by a device file, with settings of the link."""
    own = {"file": str(device), "interface": "hub", "channel": str(path), **settings}
    rows = "\n".join(f"{key} = {_toml(value)}" for key, value in own.items())
    before, _, after = rig.plant.read_text(encoding="utf-8").partition("[scan]")
    kept = [line for line in before.splitlines() if line.startswith("heartbeat_period")]
    head = "\n".join(["[device]", *kept, "[[device.links]]", rows])
    rig.plant.write_text(f"{head}\n[scan]{after}", encoding="utf-8")


def face(path: Path, device: Path = DEVICE) -> list[str]:
    """The software PLC's options for a node on the hub at `path`."""
    return ["--canopen", str(device), "--can-interface", "hub", "--can-channel", str(path)]


def _toml(value: object) -> str:
    """Numbers, truths and text are written as in JSON; a table of them inline."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {_toml(inner)}" for key, inner in value.items()) + " }"
    return json.dumps(value)


def measure(
    folder: Path,
    faults: Mapping[str, Mapping[str, Any]],
    *,
    pause: float = PAUSE_S,
    held: Mapping[str, Seen] = MappingProxyType({}),
) -> Matrix:
    """Run the faults one after the other against one pair of processes, and judge what was recorded."""
    with canopen_rig(folder, restless_trace(160.0), period=PERIOD) as (rig, options):
        return suffered(rig, faults, options, TOLERANCE_S + EVENT_TIMER_S, pause=pause, held=held)


def outside(recording: PlcRecording) -> list[str]:
    """The objects that the gateway wrote by SDO and that are neither the block nor parameters of communication."""
    strange = []
    for row in recording.frames:
        if row.sent or row.id != 0x600 + NODE or not row.data or row.data[0] >> 5 not in WRITES:
            continue
        if row.data[0] >> 5 == 6 and row.data[0] & 1:
            continue  # the end of a block download
        index = int.from_bytes(row.data[1:3], "little")
        if index != BLOCK and index != 0x1017 and not 0x1400 <= index < 0x1C00:
            strange.append(f"0x{index:04X}:{row.data[3]}")
    return strange


def repeated(recording: PlcRecording) -> int:
    """How many first RPDOs of a block carry a sequence number that was there before."""
    sequences = [row.data[2:4] for row in recording.frames if not row.sent and row.id == 0x200 + NODE and row.data]
    return len(sequences) - len(set(sequences))


@click.command()
@click.argument("faults", nargs=-1, type=click.Choice(tuple(FAULTS)), metavar="[FAULT]...")
def main(faults: Sequence[str]) -> None:
    """Measure the fault matrix over CANopen; exit code 1 if a wrong value was good."""
    with tempfile.TemporaryDirectory(prefix="canopen-") as folder:
        matrix = measure(Path(folder), {name: FAULTS[name] for name in faults or FAULTS})
    click.echo(table(matrix, TOLERANCE_S + EVENT_TIMER_S))
    raise SystemExit(1 if any(row.wrong_good for row in matrix.rows) else 0)


if __name__ == "__main__":
    main()
