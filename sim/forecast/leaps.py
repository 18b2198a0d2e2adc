"""Leaps: readings that a trend cannot have foreseen, and from which no slope follows.

A valve that turns gives thirty degrees between two readings. A heat with a memory would have to explain them by itself,
and foretell thirty more by the next ones. The level goes to such a reading, and the heat stays what it was (an
innovation outlier, as level shifts are in Harrison & Stevens 1976).
"""

from dataclasses import replace

from sim.engine import Belief, Tracker, advance, observe, restart

LEAP_SIGMAS = 10.0
"""A reading so many standard deviations off what was expected is a leap; right after one the same way it is a slope
after all, and one back again ends a spike."""


def observe_leap(tracker: Tracker, belief: Belief, time: float, temperature: float) -> Belief:
    """The belief after a reading (degC) at `time`, as `observe` has it, but that a leap moves the level alone."""
    after = observe(tracker, belief, time, temperature)
    if after.samples == belief.samples or after.last is None or not after.last.square > LEAP_SIGMAS**2:
        return after
    before = belief.last
    if before is not None and before.square > LEAP_SIGMAS**2 and before.value * after.last.value > 0:
        return after
    moved = restart(tracker, advance(tracker, belief, time), temperature)
    return replace(after, x=moved.x, xx=moved.xx, xm=moved.xm, hidden=moved.hidden)
