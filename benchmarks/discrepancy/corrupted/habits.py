"""Habits of a recorder, each at random: what they make of a trace's rows."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from sim.sha import Array, Trace

Corruption = Callable[[np.random.Generator, Trace], Trace]


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
