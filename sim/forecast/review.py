"""The 3-sigma review: how often, and how long in a row, readings lie beyond three standard deviations of a prediction.

Three views, never mixed: one-step innovations and matured forecasts while a gateway runs (`follow`, with a memory that
fades and a flag with hysteresis), and an open-loop run over a whole trace (`review_errors`). Under a right model a
Gaussian reading is beyond 3 sigma once in 370.
"""

from dataclasses import dataclass, replace
from math import exp, isfinite

import numpy as np

from sim.engine import Prediction, readings
from sim.forecast.calibration import Calibration, deviation, due_forecasts
from sim.sha import Array, Model, Trace

REVIEW_SIGMAS = 3.0
RAISE, CLEAR = 0.05, 0.01
"""Shares of readings beyond 3 sigma at which a flag is raised and cleared; 0.0027 of a Gaussian's are."""


@dataclass(frozen=True, slots=True)
class ReviewRule:
    """When a model is to be reviewed, in independent readings.

    `memory` is how many it takes until evidence has faded to 1/e, `least` the fewest that a share is taken of, `run`
    how many in a row beyond 3 sigma raise the flag by themselves.
    """

    memory: float
    least: float
    run: float


ONE_STEP = ReviewRule(memory=200.0, least=200.0, run=10.0)
"""Innovations: more than 10 beyond in 200, or 10 in a row. A few in a row, as a sensor's glitch makes them too, do
not raise the flag."""

FORECASTS = ReviewRule(memory=60.0, least=60.0, run=2.0)
"""Matured forecasts, counted by the time that they span over their horizon: more than 3 beyond in 60, or 2 in a row."""


@dataclass(frozen=True, slots=True)
class Review:
    """Readings against their predictions up to now; plain values, so that JSON can carry them.

    `counted` and `outside` are the fading numbers of independent readings and of those beyond 3 sigma, `run` how many
    of them the newest ones are in a row, `longest` the longest such run. `readings` and `review_errors` count all since
    the beginning, overlapping ones too. `flagged` is the verdict, and `since` (s) when it was last changed.
    """

    counted: float = 0.0
    outside: float = 0.0
    run: float = 0.0
    longest: float = 0.0
    readings: int = 0
    beyond: int = 0
    flagged: bool = False
    since: float | None = None


def share(rule: ReviewRule, review: Review) -> float:
    """The fading share of readings beyond 3 sigma, taken of `rule.least` readings while there are fewer."""
    return review.outside / max(review.counted, rule.least)


def follow(rule: ReviewRule, review: Review, time: float, z: float, worth: float = 1.0) -> Review:
    """The review after a reading `z` standard deviations from its prediction, at `time` (s).

    `worth` (0 to 1) is the part of an independent reading that it is. A z that is no number changes nothing. The flag
    is raised when the share passes 5 % or a run the rule's length, and cleared when the share is below 1 % and the
    newest reading within 3 sigma: what lies in between changes nothing, so that it does not chatter.
    """
    if z != z:
        return review
    out, fade = abs(z) > REVIEW_SIGMAS, exp(-worth / rule.memory)
    run = review.run + worth if out else 0.0
    after = Review(
        counted=review.counted * fade + worth,
        outside=review.outside * fade + worth * out,
        run=run,
        longest=max(review.longest, run),
        readings=review.readings + 1,
        beyond=review.beyond + out,
        flagged=review.flagged,
        since=review.since,
    )
    seen = share(rule, after)
    if not after.flagged and (seen > RAISE or run >= rule.run):
        return replace(after, flagged=True, since=time)
    if after.flagged and seen < CLEAR and not out:
        return replace(after, flagged=False, since=time)
    return after


def follow_forecasts(review: Review, state: Calibration, horizon: float, time: float, temperature: float) -> Review:
    """The review of one horizon after a reading, from the forecasts of `state` that it settles (before they are).

    Measured in the bands that the model itself promises, its learned factor included: a band that was widened online
    covers a wrong model, and is no reason to keep it.
    """
    learned = state.horizons[horizon]
    if not isfinite(temperature):
        return review
    last = learned.last
    for waiting in due_forecasts(learned, time, state.tolerance):
        worth = min(max(waiting.due - last, 0.0) / horizon, 1.0)
        last = max(last, waiting.due)
        review = follow(FORECASTS, review, waiting.due, deviation(waiting, temperature) / learned.prior, worth)
    return review


@dataclass(frozen=True, slots=True)
class Beyond:
    """A whole open-loop run: the share of its `readings` beyond 3 sigma and the longest `run` of them in a row.

    `run_seconds` is how long that run lasts. `review` says that the share is above 5 %: a run alone says little here,
    as the error of an open loop persists.
    """

    readings: int
    share: float
    run: int
    run_seconds: float
    review: bool


def standardise(prediction: Prediction, trace: Trace, model: Model) -> tuple[Array, Array]:
    """Times and errors (measured - predicted) of the readings, in standard deviations, the sensor's included.

    The prediction must have been made at every reading (`open_loop` does). NaN where the standard deviation is 0.
    """
    times, values = readings(trace, model.temperature)
    row = np.clip(np.searchsorted(prediction.times, times, side="right") - 1, 0, None)
    sigma = np.sqrt(prediction.variance[row] + model.sensor_sigma**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return times, np.where(sigma > 0, (values - prediction.mean[row]) / sigma, np.nan)


def review_errors(times: Array, z: Array) -> Beyond:
    """The review of standardised errors (n,) at `times` (n,); the first reading, where a run starts, counts too."""
    known = np.isfinite(z)
    times, out = times[known], np.abs(z[known]) > REVIEW_SIGMAS
    if not out.size:
        return Beyond(0, 0.0, 0, 0.0, review=False)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], out, [False]]).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2]
    lengths = ends - begins
    longest = int(lengths.argmax()) if lengths.size else 0
    seconds = float(times[ends[longest] - 1] - times[begins[longest]]) if lengths.size else 0.0
    part = float(out.mean())
    return Beyond(out.size, part, int(lengths.max(initial=0)), seconds, review=part > RAISE)
