"""Real time that a computer did not give: what was too slow is measured again where the record shows such a stall."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from benchmarks.fault_matrix import Matrix, Row
from sim.plc.record.recording import PlcRecording, read_recording

STILL_S = 0.2
"""A restless or busy trace has a new row each 0.05 s: where the PLC came to none for so long, the computer gave it no
time."""
TRIES = 3
Again = Callable[[Path, str], Matrix]
"""Measure one fault alone, in a folder of its own; the PLC's recording is in it."""


def longest_pause(recording: PlcRecording, since: float = -inf, until: float = inf) -> float:
    """The longest time (plant s) between two moments in which the PLC's own signals moved."""
    moments = np.unique([row.time for row in recording.truth if since <= row.time <= until])
    return float(np.max(np.diff(moments), initial=0.0))


def recovered_in_time(matrix: Matrix, folder: Path, within: Mapping[str, float], again: Again) -> Matrix:
    """The matrix of `folder`, with another row for each fault after which all came back too late on a still computer.

    `within` (s) is by fault; whatever the computer does, no value is wrong and nothing is written elsewhere or twice.
    """
    rows = {row.fault: row for row in matrix.rows}
    for fault, limit in within.items():
        at = folder
        for number in range(1, TRIES):
            if not late(row := rows[fault], limit) or paused(read_recording(at / "plc.jsonl"), row) < STILL_S:
                break
            (at := folder / f"{fault} again {number}").mkdir()
            other = again(at, fault)
            assert (other.examples, other.outside, other.repeated) == ((), 0, 0)
            (rows[fault],) = other.rows
    return replace(matrix, rows=tuple(rows.values()))


def late(row: Row, limit: float) -> bool:
    """Whether good readings did not return within so many seconds."""
    return row.recovered_s is not None and row.recovered_s >= limit


def paused(recording: PlcRecording, row: Row) -> float:
    """The longest pause of the PLC while good readings were waited for."""
    return longest_pause(recording, row.ended, row.ended + (row.recovered_s or 0.0))
