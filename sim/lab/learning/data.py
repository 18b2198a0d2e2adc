"""Training traces put in an order of their own: identity by content, copies counted once, spikes set aside."""

from collections.abc import Sequence

import numpy as np

from sim.sha import Array, Trace, content_hash, joint_hash

SPIKE_WINDOW_ROWS = 5
SPIKE_LIMIT_SIGMAS = 6.0


def in_order(traces: Sequence[Trace]) -> tuple[tuple[Trace, ...], str]:
    """(traces sorted by their first moment and the hash of their content with copies left out, SHA-256 over them all).

    The result depends neither on the order in which the traces come nor on their names (of copies the first name by the
    alphabet is kept), so neither does what is learned from them: folds and samples are dealt in this order,
    in which each of them spans the whole time.
    """
    unique: dict[str, Trace] = {}
    for trace in sorted(traces, key=lambda each: each.name):
        unique.setdefault(content_hash(trace), trace)
    ordered = sorted(unique.items(), key=lambda item: (item[1].times[:1].tolist(), item[0]))
    return tuple(trace for _, trace in ordered), joint_hash(unique.values())


def resolution(readings: Array) -> float:
    """The sensor's step: the smallest difference between two different readings (0 when all are equal).

    A sensor that is not rounded gives a value near 0, which then bounds nothing.
    """
    values = np.unique(readings[np.isfinite(readings)])
    gaps = np.diff(values)
    # Rounded decimals differ by a few units in the last place, which is no step of a sensor.
    real = gaps[gaps > 1e-4]
    return float(real.min()) if real.size else 0.0


def without_spikes(readings: Array, step: float) -> Array:
    """The readings with isolated spikes as NaN.

    A spike is a reading further from the median of itself and two neighbours on each side than six robust standard
    deviations of that difference (Hampel's rule with one scale for the whole trace, and never less than the sensor's
    `step` and the usual change from one reading to the next). A lasting jump is kept: the median follows it.
    """
    finite = np.flatnonzero(np.isfinite(readings))
    if finite.size < SPIKE_WINDOW_ROWS:
        return readings
    values = readings[finite]
    # scipy.ndimage has this filter, and takes longer to load than the filter takes for a hundred traces.
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(values, SPIKE_WINDOW_ROWS // 2, mode="edge"), SPIKE_WINDOW_ROWS
    )
    off = np.abs(values - np.partition(around, SPIKE_WINDOW_ROWS // 2, axis=1)[:, SPIKE_WINDOW_ROWS // 2])
    scale = max(1.4826 * float(np.median(off)), float(np.median(np.abs(np.diff(values)))), step, 1e-3)
    cleaned = readings.copy()
    cleaned[finite[off > SPIKE_LIMIT_SIGMAS * scale]] = np.nan
    return cleaned
