"""Numbers that devices send for "no reading": a table that people know, and what in a column behaves like one."""

import numpy as np

from sim.sha import Array

CODES = (
    -32768.0, 32767.0, 32768.0, 65535.0, 65536.0, 65534.0, -3276.8, 3276.7, 6553.5, -327.68, 327.67, 655.35,
    -127.0, 85.0, -200.0, 850.0, -242.0, 988.0, -99.0, -99.9, -999.0, 999.0, -999.9, 999.9, -9999.0, 9999.0, -9999.9,
    9999.9, 99999.0, -99999.0, 999999.0, -1e6, 2147483647.0, -2147483648.0, 4294967295.0, 1e30, -1e30,
    3.4028235e38, -3.4028235e38,
)  # fmt: skip
"""Ends of integers (also in tenths and hundredths), of a Pt100 and of a float, DS18B20's -127 and 85, rows of nines."""
AMBIGUOUS_CODES = frozenset({85.0, 850.0, 988.0, 999.0, 999.9})
"""Codes that a speed, a valve or a pressure may well reach: they count only where they are rare."""
_MAX_CODE_SHARE = 0.05
"""Share of the readings up to which a possible number is a code."""
_MIN_DISTINCT = 10
"""Distinct other readings from which on a signal moves by itself: what is 0 or 850 is switched, and has no code."""
_EQUAL_TOLERANCE = 1e-6
_MIN_RANGE_SHARE = 0.25
"""Of the range of all other readings: so far a code lies from the readings beside it."""
_MAX_TIMES_USUAL = 1e7
"""Times the usual reading: no quantity of a plant is so large, but what a float holds that nobody has written is."""
_MAX_QUANTITY = 1e12
"""What no quantity of a plant is in any unit, however many different numbers of this size there are."""
_MAX_CODES = 3
"""Different large numbers that may be codes; more are readings, as of a pressure in pascals."""
_TEMPERATURE_CODES = (0.0, -1.0, -17.78, -17.8, -40.0, -50.0, -55.0)
"""What programs write for a temperature that they do not have (0 degF too), and where its sensors' ranges begin.

It passes these numbers, and does not jump to them; in a pause it may come to them.
"""
_TIMES_USUAL_SPAN = 3.0
"""Times the usual time between readings, beyond which there is a pause between them."""
_MAX_CODED_SHARE = 0.5
"""Share of the readings beyond which a value is what the plant does."""


def find_codes(values: Array, *, slow_at: Array | None = None) -> dict[float, int]:
    """The codes among readings in the order of time, and how often: values of the table that jump out of the others.

    `slow_at` are the times of slow readings, as of a temperature, which have codes that others reach in one step.
    """
    read = np.isfinite(values)
    finite = values[read]
    found: dict[float, int] = {}
    least, most = finite.min(initial=np.inf), finite.max(initial=-np.inf)
    known = np.zeros(finite.shape, dtype=bool)
    if max(-least, most) > _MAX_TIMES_USUAL:
        sizes = np.abs(finite)
        # What rests at 0 says nothing of how large its readings are.
        moved = sizes[(sizes > 0.0) & (sizes <= _MAX_QUANTITY)]
        absurd = sizes > _MAX_TIMES_USUAL * max(1.0, float(np.median(moved)) if moved.size else 0.0)
        known |= absurd if np.unique(finite[absurd]).size <= _MAX_CODES else absurd & (sizes > _MAX_QUANTITY)
    for code in (*CODES, *(_TEMPERATURE_CODES if slow_at is not None else ())):
        width = _EQUAL_TOLERANCE * max(1.0, abs(code))
        if least - width <= code <= most + width:
            known |= np.abs(finite - code) <= width
    others = finite[~known]
    if not known.any() or others.size < 2 or known.mean() > _MAX_CODED_SHARE:
        return {}
    span = float(np.ptp(np.quantile(others, (0.001, 0.999)))) or 1.0
    where = np.flatnonzero(~known)
    # Each code beside the readings before and after it: a temperature that passes 85 degC has neighbours near 85.
    at = np.searchsorted(where, np.flatnonzero(known))
    left, right = others[(at - 1).clip(min=0)], others[at.clip(max=others.size - 1)]
    away = np.minimum(np.abs(finite[known] - left), np.abs(finite[known] - right))
    follows = np.zeros(finite.size + 1, dtype=bool)
    if slow_at is not None:
        spans = np.diff(slow_at[read])
        follows[1:-1] = spans <= _TIMES_USUAL_SPAN * np.median(spans)
    # The first of some codes in a row follows a reading, or a reading follows the last of them.
    begins, ends = np.append(0, where + 1)[at], np.append(where, finite.size)[at]
    jumped = follows[begins] | follows[ends]
    varied = np.unique(others).size >= _MIN_DISTINCT
    for code in np.unique(finite[known]).tolist():
        own = finite[known] == code
        if code in _TEMPERATURE_CODES and slow_at is not None and not jumped[own].any():
            continue
        possible = (
            code in AMBIGUOUS_CODES or code in _TEMPERATURE_CODES or (-1000.0 < code < 0.0 and others.min() < 0.0)
        )
        if possible and not (varied and own.sum() <= _MAX_CODE_SHARE * finite.size):
            continue
        if np.all(away[own] > _MIN_RANGE_SHARE * span):
            found[float(code)] = int(own.sum())
    return found
