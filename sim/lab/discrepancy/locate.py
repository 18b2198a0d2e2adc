"""Where the unexplained heat lies: by location, by time since the last start or stop, and by the size of each signal.

The unit that is trusted is the cycle: a cell's heat is summed cycle by cycle, and its z is that of the cycles' sums.
The family of all cells keeps one error rate: p is where the greatest z of all cells would fall if each cycle's signs
were thrown (Westfall & Young 1993).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim.lab.discrepancy.diagnosis import HeatPlace
from sim.lab.discrepancy.fitting import Fitted, Record
from sim.lab.discrepancy.heat import Blocks, event_names, flips, heat_blocks
from sim.lab.discrepancy.rules import DecisionRules
from sim.sha import Array, Mask

PHASE_EDGES_S = (0.0, 240.0, 900.0, 3600.0, np.inf)
"""Seconds since a start or a stop at which cells are cut."""
NULL_DRAWS = 4000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cell:
    location: int
    after: str
    seconds: tuple[float, float]
    rows: Mask
    signal: str = ""
    when: str = ""


def places(fitted: Fitted, seed: int, rules: DecisionRules) -> tuple[HeatPlace, ...]:
    """The cells in which the heat is not chance, the greatest share first."""
    record = fitted.frame.record
    blocks = heat_blocks(fitted, 240.0)
    cells = _cells(blocks, record)
    if not cells:
        return ()
    numbers, order = np.unique(blocks.cycle, return_inverse=True)
    energy = blocks.heat * blocks.seconds
    sums = np.zeros((numbers.size, len(cells)))
    for column, cell in enumerate(cells):
        np.add.at(sums[:, column], order[cell.rows], energy[cell.rows])
    # Each cycle's sum is one number of unknown scatter, and under "no heat here" as likely of either sign: z is the sum
    # over its root sum of squares, and the flips give the law of the greatest |z| of all cells at once.
    z = _z(sums, np.ones((1, numbers.size)))[0]
    signs = flips(numbers.size, seed, NULL_DRAWS)
    greatest = np.max(np.abs(_z(sums, signs)), axis=1)
    total = float(np.sum(blocks.heat**2 * blocks.seconds))
    significant = []
    for column, cell in enumerate(cells):
        p = float(np.mean(greatest >= abs(z[column]) - 1e-12))
        speaking = sums[:, column] != 0
        share = float(np.sum((blocks.heat**2 * blocks.seconds)[cell.rows])) / max(total, 1e-300)
        if p <= rules.place_most_p and share >= rules.place_least_share:
            same = np.sign(sums[speaking, column]) == np.sign(z[column])
            heat = float(np.sum(energy[cell.rows]) / np.sum(blocks.seconds[cell.rows]))
            significant.append(
                HeatPlace(
                    location=record.model.sha.locations[cell.location].name,
                    after=cell.after,
                    seconds=cell.seconds,
                    share=share,
                    heat=heat,
                    cycles=(int(same.sum()), int(speaking.sum())),
                    p=p,
                    correlates=cell.signal or correlate(blocks, record, cell.rows, rules),
                    when=cell.when,
                )
            )
    return tuple(sorted(significant, key=lambda place: -place.share))


def _z(sums: Array, signs: Array) -> Array:
    """(draws, cells) the cycles' signed sums over their root sum of squares."""
    spread = np.sqrt(np.sum(sums**2, axis=0))
    return np.asarray(signs @ sums / np.where(spread > 0, spread, 1.0))


def _cells(blocks: Blocks, record: Record) -> list[_Cell]:
    """The family of cells that are searched: phases after a start or a stop, and strata of signals, by location."""
    start, stop = event_names(record)
    cells = []
    for location in np.unique(blocks.location).tolist():
        in_location = blocks.location == location
        running = bool(np.median(blocks.running[in_location]) > 0.5)
        phase, after = (blocks.since_start, start) if running else (blocks.since_stop, stop)
        for low, high in pairwise(PHASE_EDGES_S):
            rows = in_location & (phase >= low) & (phase < high)
            if rows.any():
                cells.append(_Cell(location=location, after=after, seconds=(low, high), rows=rows))
        # Strata: the location's blocks above and below the middle of each signal that varies in it. The middle of
        # the range, not the median, cuts a switched signal between its two values.
        for number, name in enumerate(record.signals):
            column = blocks.signals[:, number]
            if np.ptp(column[in_location]) <= 1e-9:
                continue
            middle = 0.5 * (float(np.max(column[in_location])) + float(np.min(column[in_location])))
            for side, when in ((column > middle, "above"), (column <= middle, "up to")):
                rows = in_location & side
                if rows.any():
                    when = f"{name} {when} {middle:.4g}"
                    seconds = (0.0, np.inf)
                    cells.append(
                        _Cell(location=location, after=after, seconds=seconds, rows=rows, signal=name, when=when)
                    )
    return cells


def correlate(blocks: Blocks, record: Record, rows: Mask, rules: DecisionRules) -> str:
    """The signal that the heat in `rows` goes with most, or ""."""
    heat = np.argsort(np.argsort(blocks.heat[rows])).astype(float)
    best, chosen = rules.place_least_correlation, ""
    columns = [(name, blocks.signals[rows, number]) for number, name in enumerate(record.signals)]
    columns += [(record.model.temperature, blocks.course[rows])]
    for name, column in columns:
        if column.size < 8 or np.ptp(column) == 0 or np.ptp(heat) == 0:
            continue
        rank = np.argsort(np.argsort(column)).astype(float)
        size = abs(float(np.corrcoef(heat, rank)[0, 1]))
        if size > best:
            best, chosen = size, name
    return chosen
