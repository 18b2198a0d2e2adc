"""Our own CSV of a trace, one row a time, and the fingerprint by which a model names its training data."""

from pathlib import Path

import numpy as np

from drivers.csv_rows import write_rows
from drivers.named_files import name_write_errors
from sim.lab.recordings.traces import SYNTHETIC_MARK
from sim.sha import Trace


def write_trace(trace: Trace, path: str | Path) -> None:
    """Write a trace as CSV: comments that begin with `#`, a header, then `time` in seconds and a column a signal.

    Doubles are written so that reading gives them back to the last bit. An empty cell is no new reading, `nan` one of
    bad quality. `config/traces/decanter.toml` reads it, and the software PLC replays it. Raises ValueError for a signal
    whose name cannot be a column, OSError when the file cannot be written.
    """
    for name in trace.signals:
        if not name or name == "time" or name != name.strip() or any(mark in name for mark in ',"\n\r#'):
            raise ValueError(f"trace {trace.name!r}: {name!r} cannot be a column's name; rename the signal")
    columns: list[list[object]] = []
    for name, values in trace.signals.items():
        cells: list[object] = [None if value != value else value for value in values.tolist()]
        for row in np.flatnonzero(trace.bad[name]).tolist() if name in trace.bad else ():
            cells[row] = "nan"
        columns.append(cells)
    rows = zip(trace.times.tolist(), *columns, strict=True)
    with name_write_errors(path), Path(path).open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(f"# origin: {' '.join((trace.origin or trace.name).split())}\n")
        if trace.synthetic:
            stream.write(f"# {SYNTHETIC_MARK}: not measured on a plant\n")
        write_rows(stream, [("time", *trace.signals)])
        write_rows(stream, rows)
