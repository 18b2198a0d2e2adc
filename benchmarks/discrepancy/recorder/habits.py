"""What a recorder makes of a day: uneven, late, missing and repeated rows, gaps, coarse readings, a clock set anew."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.work import DAY, STEP, Work

TEMPERATURE = "TCuscinettiRiduttore"
LATE_INTERVALS = 3
"""Usual intervals after which a late row comes; what would have come between is not asked for."""
LONGEST_OF_SECONDS = 2.0 * 3600.0
"""Seconds that a record goes on in rows of a second at most, so that the file stays a file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Habit:
    """`periods` (s), changing by turns; `jitter` as a share of the period; shares of rows that are `late`, `missing`,
    `doubled` or have no reading (`blank`); `gaps` and `settings` of the clock a day; `noise` (degC) and `quantum`
    (degC) of the reading; `daily`: a file a day."""

    periods: tuple[int, ...] = (10,)
    jitter: float = 0.0
    late: float = 0.0
    missing: float = 0.0
    doubled: float = 0.0
    blank: float = 0.0
    gaps: float = 0.0
    settings: float = 0.0
    noise: float = 0.06
    quantum: float = 0.1
    daily: bool = False

    @property
    def sigma(self) -> float:
        """degC: noise and rounding of one reading."""
        return float(np.hypot(self.noise, self.quantum / np.sqrt(12.0)))


HABITS: Mapping[str, Habit] = {
    "tidy": Habit(quantum=0.01),
    "uneven": Habit(jitter=0.4, late=0.02, missing=0.02),
    "lossy": Habit(periods=(20,), jitter=0.2, missing=0.05, gaps=2.0, doubled=0.01, blank=0.01, noise=0.1),
    "slow": Habit(periods=(60,), jitter=0.1, missing=0.01, late=0.01),
    "mixed": Habit(periods=(10, 60, 30, 1), jitter=0.2, missing=0.01),
    "coarse": Habit(periods=(30,), jitter=0.1, quantum=0.5, noise=0.1),
    "set": Habit(settings=0.7, daily=True, doubled=0.005),
    "all": Habit(
        periods=(10, 30, 60), jitter=0.4, late=0.02, missing=0.03, doubled=0.01, blank=0.01, gaps=1.0, settings=0.5,
        quantum=0.5, noise=0.1,
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """What a recorder kept of m rows: true times and the times it states (s since the record began), readings (degC,
    NaN: none)."""

    times: Array
    stated: Array
    reading: Array


def record(rng: np.random.Generator, course: Array, habit: Habit) -> Rows:
    """The rows of a noise-free course (n,) on the plant's grid."""
    times = _times(rng, STEP * (course.size - 1), habit)
    noisy = np.interp(times, STEP * np.arange(course.size), course) + habit.noise * rng.standard_normal(times.size)
    reading = np.round(noisy / habit.quantum) * habit.quantum
    reading[rng.random(times.size) < habit.blank] = np.nan
    return Rows(times=times, stated=times + _clock(rng, times, habit), reading=reading)


def _times(rng: np.random.Generator, lasts: float, habit: Habit) -> Array:
    parts, at, turn = [], 0.0, 0
    while at < lasts:
        period = habit.periods[turn % len(habit.periods)]
        stays = lasts if len(habit.periods) == 1 else rng.uniform(4.0, 14.0) * 3600.0
        until = min(at + (min(stays, LONGEST_OF_SECONDS) if period == 1 else stays), lasts)
        parts.append(_uneven(rng, np.arange(at, until, float(period)), period, habit))
        at, turn = until, turn + 1
    times = np.concatenate(parts)
    times = times[(times >= 0.0) & (times <= lasts)]
    for _ in range(rng.poisson(habit.gaps * lasts / DAY)):
        begin = rng.uniform(0.0, lasts)
        times = times[(times < begin) | (times > begin + np.exp(rng.uniform(*np.log([240.0, 5400.0]))))]
    times = np.sort(times[rng.random(times.size) >= habit.missing])
    return np.sort(np.concatenate([times, times[rng.random(times.size) < habit.doubled]]))


def _uneven(rng: np.random.Generator, grid: Array, period: int, habit: Habit) -> Array:
    """The grid with jitter to either side; after a usual row there may be none until three intervals are over."""
    kept = np.ones(grid.size, dtype=bool)
    for row in np.flatnonzero(rng.random(grid.size) < habit.late):
        kept[row + 1 : row + LATE_INTERVALS] = False
    moved = grid + habit.jitter * period * rng.uniform(-0.5, 0.5, grid.size)
    return np.asarray(np.sort(moved)[kept])


def _clock(rng: np.random.Generator, times: Array, habit: Habit) -> Array:
    """(m,) s: how far the recorder's clock is off after it was set, each time by some seconds to two minutes."""
    off = np.zeros(times.size)
    for _ in range(rng.poisson(habit.settings * times[-1] / DAY)):
        off[times > rng.uniform(0.1, 0.9) * times[-1]] += rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 120.0)
    return off


def write_rows(path: Path, work: Work, rows: Rows, habit: Habit, rng: np.random.Generator) -> None:
    """Wide CSV under the plant's names at `path`, a file, or a folder with a file a day."""
    at = np.minimum((rows.times / STEP).astype(int), work.running.size - 1)
    m = at.size
    columns = {
        "time": np.round(rows.stated, 2),
        "MarciaDecanter": work.running[at].astype(int),
        "MarciaPmpFango": work.pump[at].astype(int),
        "Assorbimento": np.round(work.current[at], 1),
        "Coppia": np.round(np.maximum(work.torque[at] + 0.3 * work.running[at] * rng.standard_normal(m), 0.0), 1),
        "Differenziale": np.round(work.differential[at], 2),
        "LivelloVibrazioni": np.round(work.vibration[at] + 0.05 * np.abs(rng.standard_normal(m)), 2),
        "VelocitaPompa": np.round(work.flow[at], 1),
        "TFango": np.round(work.feed[at] + 0.06 * rng.standard_normal(m), 1),
        "TAmbiente": np.round(work.ambient[at] + 0.06 * rng.standard_normal(m), 1),
        TEMPERATURE: np.round(rows.reading, 2),
    }
    table = pd.DataFrame(columns)
    first = np.diff(rows.times, prepend=-1.0) > 0  # a repeated row says what the row before it said
    table = table.take(np.maximum.accumulate(np.where(first, np.arange(m), 0)))
    if not habit.daily:
        _write(path, table)
        return
    for day, part in table.groupby((table["time"] // DAY).astype(int)):
        _write(path / f"day-{day:02d}.csv", part)


def _write(path: Path, table: pd.DataFrame) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("# SYNTHETIC: the plant of benchmarks/discrepancy/recorder\n")
        table.to_csv(file, index=False)
