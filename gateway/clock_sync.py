"""Whether a time server steers this computer's clock, by the kernel's own account (adjtimex(2)).

chrony, systemd-timesyncd and ntpd all report there, so that none of them has to be known, or asked over a network.
"""

import ctypes
from math import inf

_MOST_ERROR = 16.0
"""Seconds: what the kernel's estimate grows to, and begins with, where nothing steers the clock (NTP_PHASE_LIMIT). Its
status word says less: chrony leaves STA_UNSYNC set on purpose unless it is to set the hardware clock too."""


class _Timex(ctypes.Structure):
    """struct timex of Linux (sys/timex.h) up to its largest error, and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("rest", ctypes.c_byte * 256),
    )


def clock_error() -> float | None:
    """How far the clock may be from UTC in seconds, as the kernel estimates it; infinite if nothing steers it.

    None where that cannot be asked: on another system, or in a sandbox that refuses the question.
    """
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):
        return None
    # modes 0: the kernel is asked and nothing is set, for which no privilege is needed.
    state = _Timex()
    if adjtimex(ctypes.byref(state)) < 0:
        return None
    error = float(state.maxerror) * 1e-6
    return error if error < _MOST_ERROR else inf
