"""Measured or simulated behaviour: samples on a clock, and the events that an encoder saw in them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from sim.units import DEFAULT_UNIT

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNKNOWN = "unknown"
"""The encoder's own symbol: from here on the plant's state is not known. It is never a hold and never "stopped"."""


@dataclass(frozen=True, slots=True)
class Event:
    """A discrete change at `time` (absolute seconds)."""

    time: float
    symbol: str


@dataclass(frozen=True, slots=True)
class Trace:
    """n rows on one clock: `times` (n,) in absolute seconds, never decreasing; `signals` name -> (n,) floats.

    Booleans are 0.0 and 1.0. NaN says "no new reading in this row", nothing more; `bad` name -> (n,) marks readings
    whose quality was bad (their value is NaN too). `held` name -> (n,), only of signals whose small changes were kept
    back, marks rows in which no reading of its own stands: the one before holds there to within the deadband,
    `signal_course` gives the likely course. A signal without an entry was read wherever it is finite. `events` are
    empty until encoded. `origin` says where the rows come from (file, scenario and seed), `machine` which of several
    machines they are of ("": nobody says) and `synthetic` that no plant produced them. `units` are those of the
    signals, as far as they are known. Raises ValueError on shapes that do not match and on times that go back.
    """

    name: str
    times: Array
    signals: Mapping[str, Array]
    events: tuple[Event, ...] = ()
    bad: Mapping[str, Mask] = field(default_factory=dict)
    origin: str = ""
    synthetic: bool = False
    machine: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    held: Mapping[str, Mask] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = self.times.shape
        for name, column in (*self.signals.items(), *self.bad.items(), *self.held.items()):
            if column.shape != rows:
                raise ValueError(f"trace {self.name!r}: signal {name!r} has shape {column.shape}, its clock {rows}")
        if self.times.size and not np.all(np.isfinite(self.times)):
            raise ValueError(f"trace {self.name!r}: its clock has values that are no numbers")
        if np.any(np.diff(self.times) < 0):
            row = int(np.argmax(np.diff(self.times) < 0)) + 1
            raise ValueError(f"trace {self.name!r}: the clock goes back at row {row}")

    def between(self, start: float, end: float) -> "Trace":
        """The rows and events with start <= time < end."""
        rows = slice(*np.searchsorted(self.times, [start, end]))
        return Trace(
            name=self.name,
            times=self.times[rows],
            signals={name: column[rows] for name, column in self.signals.items()},
            events=tuple(event for event in self.events if start <= event.time < end),
            bad={name: column[rows] for name, column in self.bad.items()},
            origin=self.origin,
            synthetic=self.synthetic,
            machine=self.machine,
            units=self.units,
            held={name: column[rows] for name, column in self.held.items()},
        )

    def signal_course(self, signal: str) -> Array:
        """(n,) the course of a signal as it most likely was: where a reading only holds, on the way to the next one.

        It came there no more slowly than it went on from there: what held for long, as at rest, moved at its end only.
        """
        column, held = self.signals[signal], self.held.get(signal)
        if held is None:
            return column
        at = np.flatnonzero(np.isfinite(column) & ~held)
        if at.size < 2:
            return column
        times = self.times[at]
        steps = np.diff(times)
        after = np.append(steps[1:], steps[-1])
        moves = np.where(steps > _REST_RATIO * after, after, steps)
        knots = np.column_stack([times[:-1], times[1:] - moves]).ravel()
        course = np.interp(
            self.times, np.append(knots, times[-1]), np.append(np.repeat(column[at[:-1]], 2), column[at[-1]])
        )
        return np.where(np.isfinite(column), course, np.nan)


def holds_roughly(times: Array, values: Array) -> bool:
    """Whether what was stored, `values` (n,) at ascending `times` (n,) s, kept small changes back, as by a deadband.

    A change that is stored because it is one is then larger than the finest step between the values. What comes after
    the longest silence is stored for that, whatever it is.
    """
    known = np.isfinite(values)
    steps, moves = np.diff(times[known]), np.abs(np.diff(values[known]))
    scan = float(np.quantile(steps, 0.05)) if steps.size else 0.0
    told = moves[(steps < EARLY_SHARE * (steps.max(initial=0.0) - scan)) & (moves > 0)]
    finest = np.diff(np.unique(values[known]))
    # Decimals that are rounded differ in their last binary digits too.
    finest = finest[finest > 1e-9 * np.abs(values[known]).max(initial=0.0)]
    return told.size > 0 and bool(np.quantile(told, 0.01) > 2.0 * finest.min())


_REST_RATIO = 3.0
"""A reading that held for so many times as long as the next one did was at rest at first."""
EARLY_SHARE = 0.9
"""Of the longest silence: what comes later is stored because the recorder's longest time is over, give or take a scan
and this share."""


def signal_unit(traces: Iterable[Trace], signal: str, otherwise: str = DEFAULT_UNIT) -> str:
    """The unit in which the traces have a signal; `otherwise` where none of them says it.

    Raises ValueError for traces that have it in different units.
    """
    said = {trace.units[signal]: trace.name for trace in traces if trace.units.get(signal)}
    if len(said) > 1:
        (one, first), (other, second) = list(said.items())[:2]
        raise ValueError(
            f"{signal!r} is in {one} in trace {first!r} and in {other} in trace {second!r}; convert one of them"
        )
    return next(iter(said), otherwise)


def content_hash(trace: Trace) -> str:
    """SHA-256 (hex) over a trace's clock, readings and bad marks; name, origin and derived events do not count."""
    digest = sha256(_bytes(trace.times))
    for name in sorted(trace.signals):
        bad = trace.bad.get(name, np.zeros(trace.times.shape, dtype=bool))
        digest.update(f"\n{name}\n".encode())
        digest.update(_bytes(trace.signals[name]))
        digest.update(np.packbits(bad).tobytes())
    return digest.hexdigest()


def joint_hash(traces: Iterable[Trace]) -> str:
    """SHA-256 (hex) over the contents of several traces, whatever their order."""
    return sha256("".join(sorted(content_hash(trace) for trace in traces)).encode()).hexdigest()


def _bytes(values: Array) -> bytes:
    """Little-endian doubles in which all NaNs are one and -0 is 0."""
    return np.where(np.isnan(values), np.nan, values + 0.0).astype("<f8").tobytes()
