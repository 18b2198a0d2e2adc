"""One small plant, written as exporters write: the same 240 rows behind every dialect, clock, layout and defect."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

STEP, ROWS = 10.0, 240
"""Seconds between rows, and rows: forty minutes with two runs at two loads."""
BEGIN = datetime(2024, 3, 13, 9, 58)
LOADS = ((30, 0.4), (60, 150.0), (60, 120.0), (30, 0.4), (60, 120.0))
"""(rows, amperes): standstill, two loads, standstill, a load again."""


@dataclass(frozen=True)
class Recording:
    """Seconds since the first row, bearing temperature (degC), motor current (A), and whether the motor runs."""

    seconds: np.ndarray
    heat: np.ndarray
    current: np.ndarray
    running: np.ndarray

    @property
    def moments(self) -> list[datetime]:
        """The local times of the rows."""
        return [BEGIN + timedelta(seconds=each) for each in self.seconds.tolist()]


def recording(seed: int = 0, *, step: float = STEP, ambient: float = 21.5, times: int = 1) -> Recording:
    """The plant's record, `times` over, with rows every `step` s."""
    rng = np.random.default_rng(seed)
    per_row = [level for rows, level in LOADS * times for _ in range(round(rows * STEP / step))]
    current = np.array(per_row) + np.where(np.array(per_row) > 1, rng.normal(0, 0.8, len(per_row)), 0.0)
    heat, temperature = [], ambient
    for level in per_row:
        temperature += (ambient + 0.3 * level - temperature) * (1 - np.exp(-step / 300.0))
        heat.append(temperature)
    noisy = np.array(heat) + rng.normal(0, 0.02, len(heat))
    running = (np.array(per_row) > 1).astype(int)
    return Recording(np.arange(len(heat)) * step, noisy.round(2), current.round(2), running)


def written(path: Path, header: str, rows: Sequence[str]) -> Path:
    """A file of a header and rows."""
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def wide(
    path: Path,
    *,
    header: str = "Time,Bearing temperature,Motor current,Running",
    clock: Callable[[datetime], str] = lambda moment: moment.strftime("%Y-%m-%d %H:%M:%S"),
    cells: Sequence[Callable[[float], str]] = (str, str, str),
    mark: str = ",",
    of: Recording | None = None,
) -> Path:
    """A file of one row a time, with a clock and three cells written as they are told."""
    plant = of or recording()
    columns = (plant.heat.tolist(), plant.current.tolist(), plant.running.tolist())
    rows = [
        mark.join([clock(moment), *(cell(value) for cell, value in zip(cells, values, strict=False))])
        for moment, *values in zip(plant.moments, *columns, strict=True)
    ]
    return written(path, header, rows)


def comma(value: float) -> str:
    """A number with a decimal comma."""
    return str(value).replace(".", ",")


def on_change(plant: Recording, deadband: float, every: float = np.inf) -> list[str]:
    """Rows `time,heat,current,running` of a historian that stores a value where it changes, one scan after another.

    A value is also told anew when it is `every` s old.
    """
    kept, last, told = list[str](), [np.nan] * 3, [-np.inf] * 3
    bands = (deadband, max(4 * deadband, 4.0), 0.5)
    for time, moment, *values in zip(
        plant.seconds, plant.moments, plant.heat, plant.current, plant.running, strict=True
    ):
        cells = []
        for place, (value, band) in enumerate(zip(values, bands, strict=True)):
            says = not abs(value - last[place]) < band or time - told[place] >= every
            cells.append(f"{value:g}" if says else "")
            last[place], told[place] = (value, time) if says else (last[place], told[place])
        if any(cells):
            kept.append(",".join([f"{moment:%Y-%m-%d %H:%M:%S}", *cells]))
    return kept
