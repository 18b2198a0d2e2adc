"""What the rivals regress: blocks of a log with a temperature, its rate of change, and columns of candidate heats.

Each candidate effect has columns (alternatives of its shape) that a person would write down who knows the vocabulary.
Rates are differences of block means, so columns are block means too. The rivals get the same signals as the tool and
the same structure of the baseline as the given model has.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.discrepancy.log import FIRST
from benchmarks.discrepancy.operation import OFF, STAGES, Array
from benchmarks.discrepancy.visible import FITTED, Family

HALL = 18.0
KELVIN = 273.15
MIDDLES = np.array([0.0, 50.0, 150.0, 250.0, 350.0])


@dataclass(frozen=True, slots=True)
class Log:
    """Rows of a case: `times` (s), `temperature` (degC), the drive's `stage`, seconds since the last start, signals."""

    times: Array
    temperature: Array
    stage: np.ndarray
    age: Array
    signals: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class Column:
    """Heat per unit coefficient: `constant` + `slope` * X by row; `sign` of the coefficient that makes physical sense
    (0: either), `extra` parameters that were chosen to make it. `start`: X of its hidden state, see `kind`."""

    constant: Array
    slope: Array
    sign: int = 1
    extra: int = 0
    kind: str = ""
    memory: float = 0.0


def read_log(path: Path) -> Log:
    """A case's trace by our own loader, last readings held."""
    from gateway.lab.traces.load import load

    trace = load([str(path)], "decanter")[0][0]
    held = {name: _held(column) for name, column in trace.signals.items()}
    running, current = held["MarciaDecanter"], held["Assorbimento"]
    stage = np.where(running > 0, 1 + np.clip(current // 100, 0, 3), OFF).astype(np.intp)
    starts = np.flatnonzero(np.diff(running, prepend=0.0) > 0)
    last = np.searchsorted(starts, np.arange(running.size), side="right") - 1
    age = np.where(last >= 0, trace.times - trace.times[starts[np.maximum(last, 0)]], 1e9) if starts.size else running
    return Log(trace.times, trace.signals[FIRST], stage, age, held)


def _held(values: Array) -> Array:
    seen = np.maximum.accumulate(np.where(np.isnan(values), -1, np.arange(values.size)))
    return np.where(seen >= 0, values[np.maximum(seen, 0)], np.nan_to_num(values[0]))


def low_pass(times: Array, values: Array, memory: float) -> Array:
    """First-order lag of held values on the log's own, perhaps uneven, clock."""
    keep = np.exp(-np.diff(times, append=times[-1]) / memory).tolist()
    out, now = [], float(values[0])
    for value, factor in zip(values.tolist(), keep, strict=True):
        out.append(now)
        now = factor * now + (1 - factor) * value
    return np.array(out)


def baseline(log: Log, family: Family) -> list[Column]:
    """The given model's own terms: heat by stage, loss by group of stages, gain on the current where it has one."""
    zero = np.zeros(log.times.size)
    columns = [Column((log.stage == one).astype(float), zero, 0) for one in range(STAGES) if np.any(log.stage == one)]
    rate, gain = np.asarray(family.rates)[log.stage], np.asarray(family.gains)[log.stage]
    columns += [Column(zero, (rate == one).astype(float), 0) for one in range(max(family.rates) + 1)]
    above = (log.signals["Assorbimento"] - MIDDLES[log.stage]) / 100.0
    columns += [Column(above * (gain == one), zero, 0) for one in range(max(family.gains) + 1)]
    return columns


def candidates(log: Log, heat: Array) -> dict[str, list[Column]]:
    """Alternatives by effect; `heat` is the baseline's fitted heat by row, which delays and lags act on."""
    signals, on, zero = log.signals, (log.stage > 0).astype(float), np.zeros(log.times.size)
    current = signals["Assorbimento"] / 200.0
    found = {
        "current-heating": [Column(on * (current - 1), zero)],
        "quadratic-current-heating": [Column(on * (current**2 - 1), zero)],
        "current-saturation": [Column(on * np.maximum(current - knee, 0), zero, -1, 1) for knee in (0.95, 1.1, 1.25)],
        "startup-churning": [Column(on * np.exp(-log.age / tau), zero, 1, 1) for tau in (120.0, 300.0, 700.0)],
        "wear-drift": [Column(on * (log.times - log.times[0]) / 86400.0, zero)],
        "dead-time": [Column(_delayed(log, heat, by) - heat, zero, 1, 1) for by in (30.0, 60.0, 120.0, 240.0)],
        "sensor-lag": [Column(low_pass(log.times, heat, by) - heat, zero, 1, 1) for by in (30.0, 60.0, 120.0, 240.0)],
        "housing-thermal-mass": [Column(zero, -1 + zero, 1, 1, "housing", by) for by in (1500.0, 3000.0, 6000.0)],
        "thermostatic-cooling": _thermostats(log),
        "radiation-loss": [Column(zero, zero, -1, 0, "radiation")],
    }
    return found | _from_signals(log, on)


def _from_signals(log: Log, on: Array) -> dict[str, list[Column]]:
    """Candidates that need a signal of their own; without it they are not offered."""
    signals, zero, found = log.signals, np.zeros(log.times.size), {}
    for name, signal, scale, powers in (
        ("torque-friction", "Coppia", 45.0, (1.0, 1.5)),
        ("speed-friction", "Differenziale", 15.0, (1.0, 2.0)),
        ("vibration-friction", "LivelloVibrazioni", 3.0, (1.0, 1.5)),
    ):
        if signal in signals:
            found[name] = [Column(on * (signals[signal] / scale) ** power, zero, 1, 1) for power in powers]
    if "TAmbiente" in signals:
        found["ambient-coupling"] = [Column((signals["TAmbiente"] - HALL) / 10.0, zero)]
    if "MarciaPmpFango" in signals:
        pump = signals["MarciaPmpFango"]
        found["pump-cooling"] = [Column(pump * HALL, -pump)]
        if "TFango" in signals:
            found["feed-temperature-coupling"] = [Column(pump * signals["TFango"], -pump)]
    return found


def _delayed(log: Log, values: Array, by: float) -> Array:
    rows = np.searchsorted(log.times, log.times - by, side="right") - 1
    return values[np.maximum(rows, 0)]


def _thermostats(log: Log) -> list[Column]:
    """A valve by the measured temperature, for some pairs of limits."""
    warm = np.nan_to_num(_held(log.temperature)).tolist()
    columns = []
    for opens in (44.0, 47.0, 50.0, 53.0):
        for width in (4.0, 7.0):
            state, out = 0.0, []
            for value in warm:
                state = 1.0 if value > opens else 0.0 if value < opens - width else state
                out.append(state)
            valve = np.array(out)
            columns.append(Column(HALL * valve, -valve, 1, 2))
    return columns


@dataclass(frozen=True, slots=True)
class Blocks:
    """Where to difference: the rows with a reading, the block of each, readings a block, pairs of neighbours to use."""

    rows: np.ndarray
    number: np.ndarray
    count: Array
    pairs: np.ndarray
    seconds: float
    fitted: np.ndarray

    def differences(self, values: Array) -> Array:
        """(pairs,) per second: means of row values (n,) over neighbouring blocks, differenced."""
        total = np.bincount(self.number, values[self.rows], minlength=self.count.size)
        return np.asarray(np.diff(total / np.maximum(self.count, 1))[self.pairs] / self.seconds)


def blocks(log: Log, seconds: float) -> Blocks:
    """Blocks of `seconds`; a pair is used when both have at least half of their readings."""
    rows = np.flatnonzero(np.isfinite(log.temperature))
    number = ((log.times[rows] - log.times[0]) // seconds).astype(np.intp)
    count = np.bincount(number).astype(float)
    enough = count >= 0.5 * np.median(count[count > 0])
    pairs = np.flatnonzero(enough[:-1] & enough[1:])
    first = (log.times[np.argmax(log.stage > 0)] - log.times[0]) // seconds
    pairs = pairs[pairs >= first]
    return Blocks(rows, number, count, pairs, seconds, pairs < FITTED * count.size)


def averaged(log: Log, cut: Blocks, column: Column) -> Array:
    """(pairs,) what the column's heat at the measured temperature adds to the differences of block means.

    The heat is integrated row by row and the integral treated like the temperature, so that nothing is lost to timing.
    """
    heat = rows_of(log, column, _held(log.temperature))
    steps = np.minimum(np.diff(log.times), 120.0)
    return cut.differences(np.concatenate([[0.0], np.cumsum(heat[:-1] * steps)]))


def rows_of(log: Log, column: Column, temperature: Array) -> Array:
    """(n,) the column's heat per unit coefficient at given temperatures."""
    heat = column.constant + column.slope * temperature
    if column.kind == "radiation":
        return np.asarray(((temperature + KELVIN) / 293.0) ** 4 * 73.0)
    if column.kind == "housing":
        return np.asarray(heat + low_pass(log.times, temperature, column.memory))
    return np.asarray(heat)


def free_run(log: Log, columns: list[Column], weights: Array) -> tuple[float, float]:
    """(mean square (degC^2) of a free run over the time held out, its number of readings); each start is measured."""
    begin = int(np.searchsorted(log.times, log.times[0] + FITTED * (log.times[-1] - log.times[0])))
    rows = slice(begin, None)
    plain = [(c, w) for c, w in zip(columns, weights, strict=True) if c.kind != "radiation"]
    constant = sum((w * c.constant[rows] for c, w in plain), np.zeros(log.times[rows].size))
    slope = sum((w * c.slope[rows] for c, w in plain), np.zeros(log.times[rows].size))
    housing = [(w, c.memory) for c, w in plain if c.kind == "housing"]
    radiant = sum(w for c, w in zip(columns, weights, strict=True) if c.kind == "radiation")
    measured, age = log.temperature[rows].tolist(), log.age[rows].tolist()
    steps = np.diff(log.times[rows], append=log.times[-1]).tolist()
    now = next(value for value in measured if value == value)
    stores, errors = [now] * len(housing), []
    for row, (held, gain, step) in enumerate(zip(constant.tolist(), slope.tolist(), steps, strict=True)):
        if row and age[row] < age[row - 1] and measured[row] == measured[row]:
            now = measured[row]
        if measured[row] == measured[row]:
            errors.append((now - measured[row]) ** 2)
        change = held + gain * now + radiant * 73.0 * ((now + KELVIN) / 293.0) ** 4
        for place, (weight, memory) in enumerate(housing):
            change += weight * stores[place]
            stores[place] += min(step / memory, 1.0) * (now - stores[place])
        now = min(max(now + min(step, 120.0) * change, -100.0), 300.0)
    return float(np.mean(errors)), float(len(errors))
