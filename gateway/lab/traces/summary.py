"""What `decanter trace synth` and `trace show` say of a trace."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.console import Part, Rows
from sim.sha import Trace


def trace_summary(trace: Trace, file: Path | None) -> dict[str, Any]:
    """Name, size and the range of each signal, as JSON."""
    return {
        "name": trace.name,
        "file": file and str(file),
        "synthetic": trace.synthetic,
        "rows": trace.times.size,
        "seconds": float(trace.times[-1] - trace.times[0]) if trace.times.size else 0.0,
        "events": len(trace.events),
        "signals": {
            name: [float(np.nanmin(column)), float(np.nanmax(column))]
            for name, column in trace.signals.items()
            if not np.all(np.isnan(column))
        },
    }


def show_summaries(title: str, rows: Sequence[dict[str, Any]]) -> Iterator[Part]:
    """One row a trace; of a few also the range of each signal."""
    columns = ("name", "rows", "seconds", "events", "file")
    yield Rows(
        title, columns, [[row["name"], row["rows"], row["seconds"], row["events"], row["file"] or ""] for row in rows]
    )
    for row in rows if len(rows) <= 3 else ():
        ranges = [[name, low, high] for name, (low, high) in row["signals"].items()]
        yield Rows(f"{row['name']}: ranges", ("signal", "lowest", "highest"), ranges)
