"""The gateway and the software PLC over raw CAN: a hub between them.

`python -m benchmarks.can_rig [FAULT ...]` measures the fault matrix of this link, as `benchmarks.fault_matrix` does for
Modbus TCP; one row a fault, in real seconds.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.fault_matrix import PERIOD, TOLERANCE_S, Matrix, suffered, table
from gateway.demo.can_bus import can_hub
from sim.plc.program.faults import ONLY_AT
from tests.rig.pair import ROOT, make_rig, restless_trace

DEVICE = ROOT / "config/devices/decanter_can.toml"
TIMEOUT_S = 0.45
"""The longest of the device file's messages: so long what one has said last is good."""

_ROWS: Mapping[str, Mapping[str, Any]] = {
    "node off the bus": {"kind": "refuse", "face": "can", "duration": 1.5},
    "restart": {"kind": "restart", "down_s": 0.7, "zeros_s": 0.7},
    "frozen image": {"kind": "frozen", "duration": 1.6},
    "bus-off": {"kind": "bus_off", "duration": 1.5},
    "frame loss": {"kind": "frame_loss", "share": 0.3, "duration": 1.5},
    "short frame": {"kind": "short_frame", "duration": 1.0},
    "repeated messages": {"kind": "stale_message", "duration": 1.0},
    "corrupt frames": {"kind": "corrupt_frame", "duration": 1.0},
    "babbling node": {"kind": "babbling_node", "rate": 1000.0, "duration": 1.5},
    "babbling node, our identifiers": {"kind": "babbling_node", "rate": 500.0, "known": True, "duration": 1.5},
    "late echo": {"kind": "late", "delay_s": 0.9, "duration": 1.5},
    "no echo": {"kind": "silent", "duration": 1.0},
    "write ignored": {"kind": "write_ignored", "duration": 1.0},
}
_NAMED = {row["kind"] for row in _ROWS.values()}
FAULTS: Mapping[str, Mapping[str, Any]] = {
    **_ROWS,
    **{
        kind: {"kind": kind, "duration": 1.0}
        for kind, faces in ONLY_AT.items()
        if kind not in _NAMED and "can" in faces
    },
}
"""What is ordered from the PLC, by the row's name: also each fault of a node without a row above, at its defaults."""


def measure(folder: Path, faults: Mapping[str, Mapping[str, Any]]) -> Matrix:
    """Run the faults one after the other against one pair of processes, and judge what was recorded."""
    rig = make_rig(folder, restless_trace(160.0), period=PERIOD)
    with can_hub(folder) as path:
        own = {"name": "can", "file": str(DEVICE), "interface": "hub", "channel": str(path)}
        rows = "\n".join(f"{key} = {json.dumps(value)}" for key, value in own.items())
        before, _, after = rig.plant.read_text(encoding="utf-8").partition("[scan]")
        kept = [line for line in before.splitlines() if line.startswith("heartbeat_period")]
        rig.plant.write_text(
            "\n".join(["[device]", *kept, "[[device.links]]", rows, f"[scan]{after}"]), encoding="utf-8"
        )
        options = ["--can", str(DEVICE), "--can-interface", "hub", "--can-channel", str(path)]
        return suffered(rig, faults, options, TOLERANCE_S + TIMEOUT_S)


@click.command()
@click.argument("faults", nargs=-1, type=click.Choice(tuple(FAULTS)), metavar="[FAULT]...")
def main(faults: Sequence[str]) -> None:
    """Measure the fault matrix over raw CAN; exit code 1 if a wrong value was good."""
    with tempfile.TemporaryDirectory(prefix="can-") as folder:
        matrix = measure(Path(folder), {name: FAULTS[name] for name in faults or FAULTS})
    click.echo(table(matrix, TOLERANCE_S + TIMEOUT_S))
    raise SystemExit(1 if any(row.wrong_good for row in matrix.rows) else 0)


if __name__ == "__main__":
    main()
