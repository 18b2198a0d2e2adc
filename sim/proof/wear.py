"""What a verification says of a wear: it grows without end, so that a proof holds until a day that is told."""

from datetime import UTC, datetime

from sim.effects import growth_starts
from sim.sha import SHA

DAY_S = 86_400.0
_FIRST_CLOCK, _LAST_CLOCK = 3.0e7, 2.5e11
"""Absolute seconds that are taken as seconds since 1970; others count from a start of their own."""


def wear_sentence(sha: SHA, horizon: float, longest: float) -> str:
    """The sentence: until when what is proven holds, and that it does not hold for `longest` where that is so (s)."""
    until = min(growth_starts(sha)) + horizon
    moment = f"{until:.6g} s on the traces' clock"
    if _FIRST_CLOCK <= until <= _LAST_CLOCK:
        moment = datetime.fromtimestamp(until, UTC).strftime("%Y-%m-%d %H:%M UTC")
    sentence = f"what is said of temperatures holds for {horizon / DAY_S:g} days of wear, until {moment}"
    if horizon < longest:
        return f"{sentence}, and not for {longest / DAY_S:g}: diagnose or learn anew before then"
    return f"{sentence}: the drift goes on growing, so verify anew before then (--wear DAYS looks further)"
