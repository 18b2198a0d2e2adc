"""Real time that a computer did not give: what was too slow is measured again where the record shows such a stall."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path

import numpy as np

from benchmarks.fault_matrix import PERIOD, Matrix
from gateway.store.read_back import reading, stored_rows
from sim.plc.record.recording import PlcRecording, read_recording

STILL_S = 0.2
"""A restless or busy trace has a new row each 0.05 s: where the PLC came to none for so long, the computer gave it no
time."""
TRIES = 10
"""A machine that does much else gives no time again and again; what is wrong by itself is so each time."""
AFTERMATH_S = 1.5
"""So long after a fault a scan may still wait for replies."""
Again = Callable[[Path, str], Matrix]
"""Measure one fault alone, in a folder of its own; the PLC's recording and the historian are in it."""


def longest_pause(recording: PlcRecording) -> float:
    """The longest time (plant s) between two moments in which the PLC's own signals moved."""
    return float(np.max(np.diff(np.unique([row.time for row in recording.truth])), initial=0.0))


def longest_hold_up(historian: Path, recording: PlcRecording, period: float, *, harmless: bool = False) -> float:
    """The longest time (plant s) by which a scan was later than by its period while no fault made it wait for a reply.

    It tells how busy the computer was in a run; what it did to a scan that waited anyway is not to be told apart. For
    `harmless` faults no scan waits.
    """
    with reading(historian) as connection:
        times = [float(time) for (time,) in stored_rows(connection, "scans", ("time",))]
    begun = {row.detail["number"]: row.time for row in recording.events if row.event == "fault began"}
    over = {row.detail["number"]: row.time for row in recording.events if row.event == "fault ended"}
    faults = {} if harmless else begun
    spans = [(begin - period, over.get(number, inf) + AFTERMATH_S) for number, begin in faults.items()]
    gaps = (b - a - period for a, b in pairwise(times) if not any(a < end and begin < b for begin, end in spans))
    return max(gaps, default=0.0)


def measured_again(
    matrix: Matrix, folder: Path, within: Mapping[str, float], again: Again, harmless: Collection[str] = ()
) -> Matrix:
    """The matrix of `folder`, with another row for each fault that cost too much on a still computer.

    That is, after which all came back later than `within` (s, by fault), or a `harmless` one that cost anything at all;
    whatever the computer does, no value is wrong and nothing is written elsewhere or twice. Once it is measured again
    without such a record too: what two processes are late by together shows in neither.
    """
    rows = {row.fault: row for row in matrix.rows}
    for fault in dict.fromkeys((*within, *harmless)):
        at = folder
        for number in range(1, TRIES):
            row = rows[fault]
            is_late = row.recovered_s is not None and row.recovered_s >= within.get(fault, inf)
            has_cost = fault in harmless and row.detected_s is not None
            if not (is_late or has_cost):
                break
            if number > 1 and stood_still(at, harmless=fault in harmless) < STILL_S:
                break
            (at := folder / f"{fault} again {number}").mkdir()
            other = again(at, fault)
            assert (other.examples, other.outside, other.repeated) == ((), 0, 0)
            (rows[fault],) = other.rows
    return replace(matrix, rows=tuple(rows.values()))


def stood_still(folder: Path, *, harmless: bool = False) -> float:
    """The longest time (s) in which the computer gave no time to the PLC or to the gateway of a run."""
    recording = read_recording(folder / "plc.jsonl")
    held_up = longest_hold_up(folder / "historian.sqlite", recording, PERIOD, harmless=harmless)
    return max(longest_pause(recording), held_up)
