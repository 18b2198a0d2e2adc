"""A timed word as the model runs it: the mean course of the simulator, with each stay's own m, inputs and temperature.

A word says what acts and when, so that a dead time plays no part. Under effects a signal that a stay does not name is
as the stay before had it; one that was never named counts as not read, and adds nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np

from sim.effects import (
    check_sha,
    effect_signals,
    in_sensor_scale,
    of_feature,
    offset_times,
    sensor_offset,
    sensor_offsets,
)
from sim.engine import Policy, Schedule, compile_plant, longest, mean_readings, resync_targets, schedule, stay_draws
from sim.proof.word import TimedWord, WordStep
from sim.sha import (
    SHA,
    UNKNOWN,
    Event,
    Location,
    Model,
    Trace,
    distributions,
    draw_temperature,
    mode_parameter,
    offset,
    transitions,
)

POINTS_PER_STAY = 32
"""Looks into each stay: with effects its highest temperature need not be at an end."""
MAX_SEGMENTS = 200_000
"""Pieces of a word's course at most, where a thermostat or radiation asks for short ones."""

Stays = Sequence[tuple[WordStep, Location]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Visit:
    """One stay of a replay: from `time` for `seconds` in `location`, from `entered` to `left` (degC) without clamps.

    `clamped` is the temperature at its end in a run that is put back into the model's range at each event. `least` and
    `most` are the extremes of the points looked at in between; a flow alone has its extremes at the ends.
    """

    time: float
    seconds: float
    symbol: str
    location: str
    m: float
    offset: float
    entered: float
    left: float
    clamped: float
    least: float
    most: float

    @property
    def extremes(self) -> tuple[float, float]:
        """The lowest and the highest temperature of the stay (degC)."""
        return min(self.entered, self.left, self.least), max(self.entered, self.left, self.most)


@dataclass(frozen=True, slots=True)
class WordReplay:
    """A word as the model runs it, without noise."""

    visits: tuple[Visit, ...]

    @property
    def lowest(self) -> float:
        """The lowest temperature of all stays (degC)."""
        return min(visit.extremes[0] for visit in self.visits)

    @property
    def highest(self) -> float:
        """The highest temperature of all stays (degC)."""
        return max(visit.extremes[1] for visit in self.visits)

    def leaves(self, low: float, high: float) -> Visit | None:
        """The first stay in which the temperature is outside low..high; None when there is none."""
        return next(
            (visit for visit in self.visits if visit.extremes[0] < low or visit.extremes[1] > high),
            None,
        )


def replay(model: Model, word: TimedWord, policy: Policy = "resync", start: float | None = None) -> WordReplay:
    """The word as the model runs it, mean for mean, in the sensor's scale.

    `start` is the first temperature (degC) where the word has none; else it is the mean of the model's initial law.
    Raises ValueError where the model cannot be run, an event has no edge (under `reject`), the start is not known, or
    the course would have too many pieces.
    """
    model = in_sensor_scale(model)
    check_sha(model.sha)
    own = word.steps[0].temperature
    x = start if own is None else own
    if x is None:
        if model.initial is None:
            raise ValueError("the word says no start temperature and the model has no initial law; begin it as @0,T=20")
        x = distributions.mean(model.initial)
    # A word says when things act, so the dead time is taken out rather than followed.
    late = of_feature(model.sha, "dead time")
    sha = replace(model.sha, effects=tuple(each for each in model.sha.effects if each not in late))
    stays = _stays(sha, word, policy)
    part = dict(zip((place.name for place in sha.locations), longest(compile_plant(sha)).tolist(), strict=True))
    ends = [*(step.time for step, _ in stays[1:]), word.end]
    pieces = sum((until - step.time) / part[place.name] for (step, place), until in zip(stays, ends, strict=True))
    if pieces > MAX_SEGMENTS:
        raise ValueError(
            f"the word lasts {word.end:.6g} s, which are {pieces:.3g} pieces of a course with thermostat or radiation; "
            f"{MAX_SEGMENTS} can be followed, so give a shorter one"
        )
    clock = (word.steps[0].clock or 0.0) if sha.effects else 0.0  # without effects nothing depends on it
    steps = _schedule(sha, stays, word.end, clock)
    modes = [mode_parameter(location)[0] if step.m is None else step.m for step, location in stays]
    # X where a location draws it on entry: the word's, or the law's mean; NaN where X goes on.
    fresh = [nan]
    for step, location in stays[1:]:
        law = draw_temperature(location)
        if law is None and step.temperature is not None:
            what = f"entering {location.name!r} leaves the temperature as it is"
            raise ValueError(f"the word sets T at {step.time:g} s, but {what}")
        mean = nan if law is None else distributions.mean(law)
        fresh.append(mean if step.temperature is None else step.temperature)
    drawn = replace(
        stay_draws(steps), mode=np.array(modes)[steps.stay], fresh=np.nan_to_num(np.array(fresh))[steps.stay]
    )
    # Twice the same course: free, where nothing is put back into the range, and as a run of the model is held in it.
    free = mean_readings(steps, x, replace(drawn, checked=np.zeros_like(steps.checked)))
    first = sensor_offset(sha, clock)
    held = mean_readings(steps, min(max(x, sha.low + first), sha.high + first), drawn)
    # Behind a lag the sensor does not see at once that X was drawn anew.
    lagged = compile_plant(sha).lags > 0
    bounds = np.searchsorted(steps.stay, np.arange(len(stays) + 1))
    visits: list[Visit] = []
    for number, (step, location) in enumerate(stays):
        entered = x if number == 0 else visits[-1].left
        if fresh[number] == fresh[number] and not lagged:
            entered = fresh[number] + sensor_offset(sha, clock + step.time)
        inside = free[bounds[number] : bounds[number + 1]]
        until = word.end if number == len(stays) - 1 else stays[number + 1][0].time
        references = {driver.signal: driver.reference for driver in location.flow.inputs}
        visits.append(
            Visit(
                time=step.time,
                seconds=until - step.time,
                symbol=step.symbol,
                location=location.name,
                m=modes[number],
                offset=float(offset(location.flow, {**references, **step.inputs})),
                entered=entered,
                left=float(inside[-1]),
                clamped=float(held[bounds[number + 1] - 1]),
                least=float(inside.min()),
                most=float(inside.max()),
            )
        )
    return WordReplay(tuple(visits))


def _stays(sha: SHA, word: TimedWord, policy: Policy) -> list[tuple[WordStep, Location]]:
    """The stays with their locations; an event that is ignored begins none."""
    onward, fallback, known = transitions(sha), resync_targets(sha), sha.by_name
    current = sha.initial
    stays = [(word.steps[0], known[current])]
    for number, step in enumerate(word.steps[1:]):
        target = sha.initial if step.symbol == UNKNOWN else onward.get((current, step.symbol))
        if target is None and policy == "reject":
            raise ValueError(
                f"event {number} ({step.symbol!r} at {step.time:g} s): location {current!r} of SHA {sha.name!r} has no "
                f"edge for it; the policies 'ignore' and 'resync' go on all the same"
            )
        if target is None and policy == "ignore":
            continue
        current = fallback.get(step.symbol, sha.initial) if target is None else target
        stays.append((step, known[current]))
    return stays


def _schedule(sha: SHA, stays: Stays, end: float, clock: float) -> Schedule:
    """The steps of the stays, which begin at `clock` (absolute s): one each, or as many as there are looks into it."""
    begins = np.array([step.time for step, _ in stays])
    looks = np.linspace(begins, np.append(begins[1:], end), POINTS_PER_STAY + 1) if sha.effects else np.array([end])
    events = [Event(clock + step.time, step.symbol) for step, _ in stays[1:]]
    inputs = [
        {**{driver.signal: driver.reference for driver in place.flow.inputs}, **step.inputs} for step, place in stays
    ]
    names = {driver.signal for place in sha.locations for driver in place.flow.inputs} | set(effect_signals(sha))
    signals = {name: np.array([each.get(name, nan) for each in inputs]) for name in names}
    trace = Trace("word", clock + begins, signals)
    return schedule(sha, events, np.unique(looks) + clock, start=clock, inputs=trace, policy="resync")


def offset_range(sha: SHA) -> tuple[float, float]:
    """The least and the greatest that the sensor ever reads too much (degC)."""
    times = np.array([-inf, *offset_times(sha)])
    values = sensor_offsets(sha, times)
    return float(values.min()), float(values.max())
