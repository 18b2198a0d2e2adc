"""Stretches in which the reading stood still though the machine was started and stopped: a sensor, and no heat."""

from dataclasses import dataclass

import numpy as np

from sim.effects import moment_words
from sim.lab.discrepancy.fitting import Record
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import Indices
from sim.sha import Array


@dataclass(frozen=True, slots=True)
class StillReading:
    """The reading was `value` in every row from `begin` to `end` (absolute s), through so many whole `visits`: runs,
    and rests between two of them."""

    value: float
    begin: float
    end: float
    visits: int

    def sentence(self, unit: str) -> str:
        """It as a sentence; `unit` as people read it."""
        through = "a run or a rest" if self.visits == 1 else f"{self.visits} runs and rests"
        return (
            f"The reading stood still at {self.value:.6g} {unit} from {moment_words(self.begin)} to "
            f"{moment_words(self.end)}, through {through}: look at the sensor."
        )


def find_still_reading(record: Record, rules: DecisionRules) -> StillReading | None:
    """The longest stretch of one reading that holds a whole run or a whole rest of about the usual length that had
    some way to go, where such a one moves the temperature by much; None where there is none."""
    reading, time = record.runs.reading[record.rows], record.runs.time[record.rows]
    running, run = record.running[record.rows] > 0.5, record.runs.run[record.rows]
    firsts, lasts = _stretches(np.column_stack([running, run]))
    # What rows without a break begin or end with may go on beyond them.
    joined = run[lasts[:-1]] == run[firsts[1:]]
    whole = np.r_[False, joined] & np.r_[joined, False]
    moved = np.maximum.reduceat(reading, firsts) - np.minimum.reduceat(reading, firsts)
    lasted, on = time[lasts] - time[firsts], running[firsts]
    least_step = np.min(np.diff(np.unique(reading)), initial=np.inf)
    still = np.zeros(firsts.size, dtype=bool)
    for kind in (True, False):
        usual = whole & (on == kind) & (moved > 0)
        least_moved = rules.still_usual_least_moved_share * np.std(reading)
        if usual.sum() < rules.still_least_usual or np.median(moved[usual]) <= least_moved:
            continue
        least_lasted = rules.still_least_lasted_share * np.median(lasted[usual])
        long = np.flatnonzero(whole & (on == kind) & (lasted >= least_lasted))
        begun, ended = reading[firsts[long]], reading[lasts[long]]
        rise = np.median(reading[lasts[usual]] - reading[firsts[usual]])
        # Where all end, and where the one before did: the surroundings are not always as warm.
        ways = np.sign(rise) * (np.stack([np.full(long.size, np.median(ended)), np.r_[ended[:1], ended[:-1]]]) - begun)
        least_way = max(rules.still_least_way_share * np.median(moved[usual]), rules.still_least_way_steps * least_step)
        still[long] |= (moved[long] == 0) & (ways.min(axis=0) > least_way)
    if not still.any():
        return None
    begins, ends = _stretches(np.column_stack([reading, run]))
    held = np.searchsorted(begins, firsts[still], side="right") - 1
    longest = held[np.argmax(time[ends[held]] - time[begins[held]])]
    first, last = begins[longest], ends[longest]
    visits = int((whole & (firsts >= first) & (lasts <= last)).sum())
    return StillReading(float(reading[first]), float(time[first]), float(time[last]), visits)


def _stretches(columns: Array) -> tuple[Indices, Indices]:
    """(the first, the last) row of each stretch of rows that are the same."""
    turns = np.flatnonzero((np.diff(columns, axis=0) != 0).any(axis=1)) + 1
    return np.r_[0, turns], np.r_[turns, columns.shape[0]] - 1
