"""Moments as people read them: a date with its zone, or seconds where a clock counts from a start of its own."""

from datetime import UTC, datetime

WORLD_CLOCK_S = 1e8
"""Seconds from which a clock is taken for that of the world (1973)."""
END_OF_DATES_S = 253_402_300_800.0
"""Seconds from which no date can be said (the year 10000): a time in milliseconds is beyond it."""


def has_date(time: float) -> bool:
    """Whether a moment (absolute s) is one of the world's clock, so that it has a date."""
    return WORLD_CLOCK_S <= time < END_OF_DATES_S


def exact_moment(time: float) -> str:
    """A moment (absolute s) to its millisecond: its date in UTC, or its seconds where it has none."""
    if not has_date(time):
        return f"{time:.3f} s"
    whole, thousandths = divmod(round(time * 1000.0), 1000)
    parts = f".{thousandths:03d}" if thousandths else ""
    return f"{datetime.fromtimestamp(min(whole, END_OF_DATES_S - 1.0), UTC):%Y-%m-%d %H:%M:%S}{parts} UTC"


def exact_moments(one: float, other: float) -> tuple[str, str]:
    """Two different moments (absolute s) as `exact_moment` says them, or their numbers where that is the same text."""
    said = exact_moment(one), exact_moment(other)
    return said if said[0] != said[1] else (f"{one!r} s", f"{other!r} s")
