"""From which score on the anomaly alarm comes at most once a week: by what the score did on held-out data.

The peaks of a score that is in squares of standard deviations have an exponential tail where what the model does not
know is Gaussian. So the rate at which a level is passed falls by e with each mean excess (peaks over threshold,
Pickands 1975). The excess is taken at its upper confidence limit, by the units that err apart rather than by the peaks:
a single day tells nothing of how the next one differs.
"""

from collections.abc import Sequence
from math import log

from scipy.special import gammaincinv

from sim.anomaly import MAX_LEVEL, MIN_PEAK, AnomalyRecord

WEEK_S = 7 * 86_400.0
TAIL_SHARE, MIN_TAIL = 0.25, 5
"""The share of the peaks that are the tail, and the fewest that make one."""
CONFIDENCE = 0.75
"""With which the tail is no longer than what is taken."""
MAX_PEAKS = 200
"""Of each model at most, in its file."""


def record_scores(peaks: Sequence[float], seconds: float, units: int) -> AnomalyRecord | None:
    """The record of the `peaks` of a score over `seconds` of so many `units`; None where nothing was held out."""
    if seconds <= 0 or units < 1:
        return None
    highest = sorted(peaks, reverse=True)
    return AnomalyRecord(
        seconds=seconds,
        units=units,
        peaks=tuple(round(peak, 2) for peak in highest[:MAX_PEAKS]),
        level=round(min(weekly_level(highest, seconds, units), MAX_LEVEL), 1),
    )


def weekly_level(highest: Sequence[float], seconds: float, units: int) -> float:
    """The level that is passed once a week at most; `highest` are the peaks, in descending order."""
    tail = min(max(int(TAIL_SHARE * len(highest)), MIN_TAIL), len(highest))
    if not tail:
        return MIN_PEAK
    least = highest[tail] if tail < len(highest) else MIN_PEAK
    excess = sum(peak - least for peak in highest[:tail]) / tail
    independent = min(tail, units)
    # The quantile of chi-square: scipy.stats, which has it by name, takes half a second to load.
    quantile = 2.0 * float(gammaincinv(independent, 1.0 - CONFIDENCE))
    longest = excess * 2 * independent / quantile
    return least + longest * max(log(tail * WEEK_S / seconds), 0.0)
