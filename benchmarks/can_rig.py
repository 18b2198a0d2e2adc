"""The gateway and the software PLC over raw CAN: a hub between them.

`python -m benchmarks.can_rig [FAULT ...]` measures the fault matrix of this link, as `benchmarks.fault_matrix` does for
Modbus TCP; one row a fault, in real seconds.
"""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.canopen_rig import ROWS, over_hub, with_every_kind
from benchmarks.fault_matrix import PERIOD, TOLERANCE_S, Matrix, suffered, table
from gateway.demo.can_bus import can_hub
from tests.rig.pair import ROOT, make_rig, restless_trace

DEVICE = ROOT / "config/devices/decanter_can.toml"
TIMEOUT_S = 0.45
"""The longest of the device file's messages: so long what one has said last is good."""

_SHARED = (
    "restart", "frozen image", "bus-off", "frame loss", "babbling node", "babbling node, our identifiers",
    "write ignored",
)  # fmt: skip
FAULTS = with_every_kind(
    {
        "node off the bus": {"kind": "refuse", "face": "can", "duration": 1.5},
        **{name: ROWS[name] for name in _SHARED},
        "short frame": {"kind": "short_frame", "duration": 1.0},
        "repeated messages": {"kind": "stale_message", "duration": 1.0},
        "repeated pages, heartbeat well": {"kind": "stale_message", "messages": ["Service"], "duration": 1.5},
        "corrupt frames": {"kind": "corrupt_frame", "duration": 1.0},
        "late echo": {"kind": "late", "delay_s": 0.9, "duration": 1.5},
        "no echo": {"kind": "silent", "duration": 1.0},
    },
    "can",
)
"""What is ordered from the PLC, by the row's name."""


def measure(folder: Path, faults: Mapping[str, Mapping[str, Any]]) -> Matrix:
    """Run the faults one after the other against one pair of processes, and judge what was recorded."""
    rig = make_rig(folder, restless_trace(160.0), period=PERIOD)
    with can_hub(folder) as path:
        over_hub(rig, path, DEVICE, {"name": "can"})
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
