"""Habits of a recorder, each at random: what they make of a trace's rows, or of the lines of its file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sim.sha import Array, Trace

Corruption = Callable[[np.random.Generator, Trace], Trace]
Filing = Callable[[np.random.Generator, Sequence[str]], list[list[str]]]
"""What becomes of a file's rows: those of each file that there is then."""


def only(trace: Trace, rows: Array) -> Trace:
    """These rows of a trace, without events: what happened is to be told from the rows."""
    signals = {name: column[rows] for name, column in trace.signals.items()}
    return replace(trace, times=trace.times[rows], signals=signals, events=())


def dropped(rng: np.random.Generator, trace: Trace) -> Trace:
    """Up to a third of the rows, each by itself."""
    return only(trace, np.flatnonzero(rng.random(trace.times.size) > rng.choice([0.02, 0.1, 0.33])))


def jittered(rng: np.random.Generator, trace: Trace) -> Trace:
    """Each row up to 40 % of a period early or late."""
    usual = float(np.median(np.diff(trace.times)))
    return replace(trace, times=np.sort(trace.times + usual * rng.uniform(-0.4, 0.4, trace.times.size)))


def late(rng: np.random.Generator, trace: Trace) -> Trace:
    """After some rows none until three usual intervals are over."""
    keep = np.ones(trace.times.size, dtype=bool)
    for row in np.flatnonzero(rng.random(trace.times.size) < 0.05):
        keep[row + 1 : row + 3] = False
    return only(trace, np.flatnonzero(keep))


def stretched(rng: np.random.Generator, trace: Trace) -> Trace:
    """A clock that says three intervals where one was: the machine seems to stand still, and to be slower."""
    times = np.diff(trace.times) * np.where(rng.random(trace.times.size - 1) < 0.05, 3.0, 1.0)
    return replace(trace, times=trace.times[0] + np.append(0.0, np.cumsum(times)))


def gapped(rng: np.random.Generator, trace: Trace) -> Trace:
    """A few gaps from minutes to hours."""
    keep = np.ones(trace.times.size, dtype=bool)
    for begin in rng.uniform(trace.times[0], trace.times[-1], rng.integers(1, 6)):
        keep &= (trace.times < begin) | (trace.times > begin + np.exp(rng.uniform(5.0, 10.0)))
    return only(trace, np.flatnonzero(keep))


def repeated(rng: np.random.Generator, trace: Trace) -> Trace:
    """Some rows twice, as a recorder keeps them that is told to."""
    return only(trace, np.repeat(np.arange(trace.times.size), 1 + (rng.random(trace.times.size) < 0.05)))


def set_forward(rng: np.random.Generator, trace: Trace) -> Trace:
    """A clock that is set forward."""
    at = rng.integers(1, trace.times.size)
    return replace(
        trace, times=trace.times + np.where(np.arange(trace.times.size) >= at, rng.uniform(1.0, 7200.0), 0.0)
    )


def set_back(rng: np.random.Generator, trace: Trace) -> Trace:
    """A clock that is set back: its rows sorted, the hours in one another, or those before the row ahead left out."""
    at = rng.integers(1, trace.times.size)
    times = trace.times - np.where(np.arange(trace.times.size) >= at, rng.uniform(1.0, 7200.0), 0.0)
    rows = (
        np.argsort(times, kind="stable")
        if rng.random() < 0.5
        else np.flatnonzero(times >= np.maximum.accumulate(times))
    )
    signals = {name: column[rows] for name, column in trace.signals.items()}
    return replace(trace, times=times[rows], signals=signals, events=())


def alone(rng: np.random.Generator, trace: Trace) -> Trace:
    """Single rows with half an hour of nothing on either side."""
    keep = np.ones(trace.times.size, dtype=bool)
    for at in rng.integers(0, trace.times.size, 4):
        keep[np.abs(trace.times - trace.times[at]) < 1800.0] = False
        keep[at] = True
    return only(trace, np.flatnonzero(keep))


def beside_starts(rng: np.random.Generator, trace: Trace) -> Trace:
    """Rows missing just before, at or after some starts and stops."""
    turns = np.flatnonzero(np.diff(trace.signals["MarciaDecanter"]) != 0)
    missing = (turns + rng.integers(-2, 4, turns.size))[rng.random(turns.size) < 0.7]
    return only(trace, np.setdiff1d(np.arange(trace.times.size), missing))


def unread(rng: np.random.Generator, trace: Trace) -> Trace:
    """Stretches, up to whole cycles, in which the sensor reads nothing."""
    reading = trace.signals["T"].copy()
    for begin in rng.uniform(trace.times[0], trace.times[-1], rng.integers(1, 4)):
        reading[(trace.times >= begin) & (trace.times < begin + np.exp(rng.uniform(3.0, 10.5)))] = np.nan
    return replace(trace, signals={**trace.signals, "T": reading})


def rounded(rng: np.random.Generator, trace: Trace) -> Trace:
    """Readings to half a degree, or to one."""
    step = rng.choice([0.5, 1.0])
    return replace(trace, signals={**trace.signals, "T": step * np.round(trace.signals["T"] / step)})


def mixed(rng: np.random.Generator, trace: Trace) -> Trace:
    """Every row for a while, then every third or tenth."""
    at = rng.integers(1, trace.times.size)
    every = int(rng.choice([3, 10]))
    rows = np.arange(trace.times.size)
    return only(trace, rows[(rows < at) | (rows % every == 0)])


def gone(rng: np.random.Generator, trace: Trace) -> Trace:
    """Stretches without a value in one column or several, some of them in all columns at once."""
    signals = {name: column.astype(float) for name, column in trace.signals.items()}
    for begin in rng.uniform(trace.times[0], trace.times[-1], rng.integers(1, 6)):
        rows = (trace.times >= begin) & (trace.times < begin + np.exp(rng.uniform(3.0, 11.0)))
        for name in signals if rng.random() < 0.3 else [str(rng.choice(list(signals)))]:
            signals[name][rows] = np.nan
    return replace(trace, signals=signals, events=())


def held(rng: np.random.Generator, trace: Trace) -> Trace:
    """A sensor that says the same from some row on: to the end, or for hours."""
    reading, begin = trace.signals["T"].copy(), int(rng.integers(0, trace.times.size))
    until = trace.times[begin] + (np.inf if rng.random() < 0.3 else np.exp(rng.uniform(6.0, 11.0)))
    reading[(np.arange(trace.times.size) >= begin) & (trace.times < until)] = reading[begin]
    return replace(trace, signals={**trace.signals, "T": reading})


def constant(rng: np.random.Generator, trace: Trace) -> Trace:
    """One column or two that say one value all along: a switch that never moves, a load, a room, the reading itself."""
    signals = dict(trace.signals)
    for name in rng.choice(list(signals), size=rng.integers(1, 3), replace=False):
        signals[str(name)] = np.full(trace.times.size, rng.choice(signals[str(name)]))
    return replace(trace, signals=signals, events=())


def struck(rng: np.random.Generator, trace: Trace) -> Trace:
    """Single readings at an end of the transmitter's range, or at what stands for a broken wire."""
    reading = trace.signals["T"].copy()
    reading[rng.random(reading.size) < rng.choice([0.001, 0.01, 0.05])] = rng.choice([0.0, -50.0, 850.0, 3276.7])
    return replace(trace, signals={**trace.signals, "T": reading})


def chattered(rng: np.random.Generator, trace: Trace) -> Trace:
    """A switch that turns for a single row now and then."""
    name = str(rng.choice(["MarciaDecanter", "MarciaPmpFango"]))
    turned = rng.random(trace.times.size) < rng.choice([0.002, 0.02, 0.2])
    switch = np.where(turned, 1.0 - trace.signals[name], trace.signals[name])
    return replace(trace, signals={**trace.signals, name: switch}, events=())


def shortened(rng: np.random.Generator, trace: Trace) -> Trace:
    """Only a part of the record, from a few rows to most of them."""
    begin, end = np.sort(rng.uniform(trace.times[0], trace.times[-1], 2))
    rows = np.flatnonzero((trace.times >= begin) & (trace.times <= end))
    return only(trace, rows if rows.size > 1 else np.arange(2))


def out_of_order(rng: np.random.Generator, rows: Sequence[str]) -> list[list[str]]:
    """Blocks of rows, or all of them, in another order in the file."""
    blocks = np.array_split(np.arange(len(rows)), int(rng.choice([2, 10, len(rows)])))
    return [[rows[row] for block in rng.permutation(len(blocks)) for row in blocks[block]]]


def overlapping(rng: np.random.Generator, rows: Sequence[str]) -> list[list[str]]:
    """Two or three files, each of which begins with rows that the one before it has, too."""
    cuts = [0, *np.sort(rng.integers(1, len(rows), rng.integers(1, 3))).tolist(), len(rows)]
    back = int(rng.integers(1, 200))
    return [list(rows[max(begin - back, 0) : end]) for begin, end in pairwise(cuts) if end > begin]


FILINGS: Mapping[str, Filing] = {"rows out of order": out_of_order, "files that overlap": overlapping}
"""By what they do to a file, in a fixed order."""
CORRUPTIONS: Mapping[str, Corruption] = {
    "rows dropped": dropped,
    "jitter of 40 %": jittered,
    "rows three times as late": late,
    "intervals said three times as long": stretched,
    "gaps": gapped,
    "rows repeated": repeated,
    "clock set forward": set_forward,
    "clock set back": set_back,
    "rows by themselves": alone,
    "rows missing beside starts": beside_starts,
    "nothing read": unread,
    "readings rounded": rounded,
    "mixed periods": mixed,
}
"""By what they do, in a fixed order."""
FAULTS: Mapping[str, Corruption] = {
    "columns without values": gone,
    "a reading that stands still": held,
    "columns of one value": constant,
    "readings at an end of the range": struck,
    "a switch that chatters": chattered,
    "a part of the record": shortened,
}
"""What befell a sensor, a signal or the copy that was made, and no recorder's habit; in a fixed order."""
