"""What the plant's recorder makes of a case: rows of readings, decoys, irregular clocks, gaps, missing signals."""

from pathlib import Path

import numpy as np

from benchmarks.discrepancy.operation import Array, Operation
from benchmarks.discrepancy.plant import Course, Roughness, measured
from benchmarks.discrepancy.strata import Spec

FIRST, SECOND = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
SWITCHES = ("MarciaDecanter", "MarciaPmpFango")
DIGITS = {"Assorbimento": 1, "VelocitaPompa": 1}


def written_log(
    path: Path, operation: Operation, course: Course, rough: Roughness, spec: Spec, rng: np.random.Generator
) -> None:
    """Write a wide CSV under the plant's names (column map `decanter`)."""
    import pandas as pd

    kept, times = _rows(operation, spec, rng)
    table = pd.DataFrame({"time": np.round(times[kept], 2)})
    for name, column in signals_of(operation, rng).items():
        table[name] = np.round(column[kept], DIGITS.get(name, 2))
    for name, temperature in ((FIRST, course.sensor), (SECOND, course.second)):
        table[name] = np.round(measured(rng, np.interp(times[kept], operation.times, temperature), rough), 2)
    if spec.sampling == "gaps":
        table.loc[rng.random(len(table)) < 0.01, FIRST] = np.nan
    switches = [name for name in SWITCHES if name not in spec.missing]
    table = table.drop(columns=list(spec.missing)).astype(dict.fromkeys(switches, int))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("# SYNTHETIC: the plant of benchmarks/discrepancy\n")
        table.to_csv(file, index=False)


def signals_of(operation: Operation, rng: np.random.Generator) -> dict[str, Array]:
    """All but the temperatures by the plant's names, with their sensors' noise; whether they act is not known here."""
    n = operation.times.size
    running = operation.running
    return {
        "MarciaDecanter": running,
        "MarciaPmpFango": operation.pump,
        "Assorbimento": operation.current,
        "Coppia": np.clip(operation.torque + running * rng.normal(0, 0.4, n), 0, None),
        "Differenziale": np.clip(operation.speed + running * rng.normal(0, 0.05, n), 0, None),
        "LivelloVibrazioni": np.clip(operation.vibration + rng.normal(0, 0.03, n), 0, None),
        "VelocitaPompa": operation.pump_speed,
        "TFango": operation.feed + rng.normal(0, 0.08, n),
        "TAmbiente": operation.hall + rng.normal(0, 0.08, n),
    }


def _rows(operation: Operation, spec: Spec, rng: np.random.Generator) -> tuple[np.ndarray, Array]:
    """(rows that were recorded (n,), their times (n,))."""
    n, times = operation.times.size, operation.times
    kept = np.ones(n, dtype=bool)
    if spec.sampling == "irregular":
        kept = rng.random(n) > 0.4
        kept[::4] = True
        return kept, times + rng.uniform(0.0, 0.3 * operation.period, n)
    if spec.sampling == "gaps":
        for _ in range(int(rng.integers(2, 4)) * spec.days):
            at = int(rng.integers(n))
            kept[at : at + int(rng.uniform(600, 5400) / operation.period)] = False
    return kept, times
