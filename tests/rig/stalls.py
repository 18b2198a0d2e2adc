"""Real time that a computer did not give: what was too slow is measured again where the record shows such a stall."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from pathlib import Path

import numpy as np

from benchmarks.fault_matrix import PERIOD, Matrix, Row
from gateway.store.read_back import reading, stored_rows
from sim.plc.record.recording import PlcRecording, read_recording
from tests.rig.pair import PATIENCE_S, TIMEOUT_S

STILL_S = 0.2
"""A restless or busy trace has a new row each 0.05 s: where the PLC came to none for so long, the computer gave it no
time."""
TRIES = 10
"""A machine that does much else gives no time again and again; what is wrong by itself is so each time."""
Again = Callable[[Path, str], Matrix]
"""Measure one fault alone, in a folder of its own; the PLC's recording and the historian are in it."""


@dataclass(frozen=True, slots=True)
class Waits:
    """How long a scan may wait for the replies to its reading and to its block (s)."""

    read_s: float = 0.0
    write_s: float = 0.0


OUTAGE_WAITS = Waits(2 * TIMEOUT_S, TIMEOUT_S)


def longest_pause(recording: PlcRecording, since: float = -inf, until: float = inf) -> float:
    """The longest time (plant s) between two moments in which the PLC's own signals moved."""
    moments = np.unique([row.time for row in recording.truth if since <= row.time <= until])
    return float(np.max(np.diff(moments), initial=0.0))


def longest_hold_up(historian: Path, period: float, waits: Waits, since: float = -inf, until: float = inf) -> float:
    """The longest time (plant s) by which a scan came later than by its period and what may be waited for replies."""
    with reading(historian) as connection:
        rows = stored_rows(connection, "scans", ("time", "duration"), since, until)
    gaps = (b - a - period - min(read, waits.read_s) - waits.write_s for (a, _), (b, read) in pairwise(rows))
    return max(gaps, default=0.0)


def measured_again(
    matrix: Matrix, folder: Path, within: Mapping[str, float], again: Again, harmless: Collection[str] = ()
) -> Matrix:
    """The matrix of `folder`, with another row for each fault that cost too much on a still computer.

    That is, after which all came back later than `within` (s, by fault), or a `harmless` one that cost anything at all;
    whatever the computer does, no value is wrong and nothing is written elsewhere or twice.
    """
    rows = {row.fault: row for row in matrix.rows}
    for fault in dict.fromkeys((*within, *harmless)):
        at = folder
        for number in range(1, TRIES):
            row = rows[fault]
            is_late = row.recovered_s is not None and row.recovered_s >= within.get(fault, inf)
            has_cost = fault in harmless and row.detected_s is not None
            if not (is_late or has_cost) or stood_still(at, row, is_late=is_late) < STILL_S:
                break
            (at := folder / f"{fault} again {number}").mkdir()
            other = again(at, fault)
            assert (other.examples, other.outside, other.repeated) == ((), 0, 0)
            (rows[fault],) = other.rows
    return replace(matrix, rows=tuple(rows.values()))


def stood_still(folder: Path, row: Row, *, is_late: bool) -> float:
    """The longest time (s) in which the computer gave no time to the PLC, or to the gateway, while it mattered."""
    back = row.ended + min(row.recovered_s or 0.0, PATIENCE_S) + PERIOD
    # The scan under way when it began shows it too. Without harm no reply is waited for.
    begun, waits = (row.ended, OUTAGE_WAITS) if is_late else (row.began - STILL_S - PERIOD, Waits())
    held_up = longest_hold_up(folder / "historian.sqlite", PERIOD, waits, begun, back)
    return max(longest_pause(read_recording(folder / "plc.jsonl"), begun, back), held_up)
