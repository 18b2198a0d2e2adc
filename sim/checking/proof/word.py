"""A timed word as one line of text, with the parameters of each stay, and its replay without clamps.

    @0,T=20,m=31 W_ON@0,m=52 A_2@30,m=80,Assorbimento=280 @600

Each item is SYMBOL@SECONDS and begins a stay; behind it stand, as far as they are not left out, the stay's mode
parameter (m), its input signals, and the temperature (T) at the start or where the location draws it on entry. An item
without a symbol at the very front describes the first stay, at the end it says how long the last one goes on. Seconds
count from the start; t behind the first item is the absolute time of the start, which wear and sensor steps look at.
Items are divided by blanks; one with blanks in it is put in double quotes; # begins a comment.
"""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf, isfinite, nan

from sim.checking.proof.word_effects import Given, felt_at_once, passed
from sim.effects.check import check_sha
from sim.effects.correction import in_sensor_scale
from sim.engine.schedule import Policy, resync_targets
from sim.sha import distributions
from sim.sha.automaton import SHA, Location, transitions
from sim.sha.entry import drawn_temperature, mode_parameter
from sim.sha.flows import mean_step, offset
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Event

TEMPERATURE, MODE, CLOCK = "T", "m", "t"
_ITEM = re.compile(r"(?P<symbol>.*)@(?P<time>[^@,]+)(?P<rest>(?:,[^,=]+=[^,=]+)*)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Step:
    """One stay, begun by `symbol` (empty: the first) `time` seconds after the start.

    What is None or not in `inputs` is left to the model: m at its mean, T at the law's mean, inputs at their reference,
    signals of effects as they were last. `clock` (absolute s, 0 if None) belongs to the first stay alone.
    """

    time: float
    symbol: str = ""
    m: float | None = None
    temperature: float | None = None
    inputs: Mapping[str, float] = field(default_factory=dict)
    clock: float | None = None


@dataclass(frozen=True, slots=True)
class TimedWord:
    """The stays in order, the first one without a symbol, and the end of the last one in seconds from the start."""

    steps: tuple[Step, ...]
    end: float

    @property
    def events(self) -> tuple[Event, ...]:
        """The events alone, times from the start."""
        return tuple(Event(step.time, step.symbol) for step in self.steps[1:])


@dataclass(frozen=True, slots=True)
class Visit:
    """One stay of a replay: from `time` for `seconds` in `location`, from `entered` to `left` (degC) without clamps.

    `clamped` is the temperature at its end in a run that is put back into the model's range at each event. `least` and
    `most` are the extremes in between where effects act: no flow has any there.
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
    least: float = inf
    most: float = -inf

    @property
    def extremes(self) -> tuple[float, float]:
        """The lowest and the highest temperature of the stay (degC)."""
        return min(self.entered, self.left, self.least), max(self.entered, self.left, self.most)


@dataclass(frozen=True, slots=True)
class Replay:
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


def parse_word(text: str) -> TimedWord:
    """The word in a text. Raises ValueError, naming the item, for what is none."""
    try:
        items = shlex.split(text, comments=True)
    except ValueError as error:
        raise ValueError(f"the word cannot be divided into items ({error}); close each quotation") from None
    steps = [_step(item) for item in items]
    if not steps:
        raise ValueError("the word is empty; give items such as W_ON@0 A_2@30 @600")
    if steps[0].symbol or len(steps) == 1:
        steps.insert(0, Step(0.0))
    last = steps[-1]
    if not last.symbol and (last.m is not None or last.temperature is not None or last.inputs) and len(items) > 1:
        raise ValueError(f"{items[-1]!r}: the last item only says when the word ends; put its parameters to an event")
    stays = steps if last.symbol else steps[:-1]
    _check(steps, stays)
    return TimedWord(tuple(stays), last.time)


def _check(steps: Sequence[Step], stays: Sequence[Step]) -> None:
    if steps[0].time != 0:
        raise ValueError(f"the word begins at {steps[0].time:g} s; seconds count from the start, which is 0")
    for before, after in pairwise(steps):
        if after.time < before.time:
            raise ValueError(f"the word goes back from {before.time:g} s to {after.time:g} s ({after.symbol or 'end'})")
    late = next((step for step in stays[1:] if step.clock is not None), None)
    if late is not None:
        raise ValueError(
            f"the item at {late.time:g} s gives {CLOCK}; only the start, @0,{CLOCK}=..., has an absolute time"
        )
    nameless = [step for step in stays[1:] if not step.symbol]
    if nameless:
        raise ValueError(f"the item at {nameless[0].time:g} s has no symbol; only the first and the last may have none")


def _step(item: str) -> Step:
    found = _ITEM.fullmatch(item)
    if found is None:
        raise ValueError(f"{item!r} is no item of a word; write SYMBOL@SECONDS, or SYMBOL@SECONDS,m=80,Signal=280")
    numbers = {}
    for part in filter(None, found["rest"].split(",")):
        name, _, value = part.partition("=")
        numbers[name.strip()] = _number(value, item)
    time = _number(found["time"], item)
    if time < 0:
        raise ValueError(f"{item!r}: seconds count from the start and are never negative")
    m, temperature, clock = (numbers.pop(name, None) for name in (MODE, TEMPERATURE, CLOCK))
    return Step(time, found["symbol"].strip(), m, temperature, numbers, clock)


def _number(text: str, item: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not isfinite(value):
        raise ValueError(f"{item!r}: {text!r} is no finite number")
    return value


def word_text(word: TimedWord) -> str:
    """The word in one line, which `parse_word` reads back; numbers have 12 digits."""
    items = [_item(step) for step in word.steps]
    return " ".join((*items, f"@{word.end:.12g}"))


def _item(step: Step) -> str:
    parts = [f"{step.symbol}@{step.time:.12g}"]
    parts += [f"{TEMPERATURE}={step.temperature:.12g}"] if step.temperature is not None else []
    parts += [f"{CLOCK}={step.clock:.12g}"] if step.clock is not None else []
    parts += [f"{MODE}={step.m:.12g}"] if step.m is not None else []
    parts += [f"{name}={value:.12g}" for name, value in step.inputs.items()]
    text = ",".join(parts)
    plain = re.fullmatch(r"[\w@=,.+:/\-]*", text, re.ASCII)
    return text if plain else '"' + re.sub(r'(["\\])', r"\\\1", text) + '"'


def replay(model: Model, word: TimedWord, policy: Policy = "resync", start: float | None = None) -> Replay:
    """The word as the model runs it, mean for mean, with each stay's own m, in the sensor's scale.

    `start` is the first temperature (degC) where the word has none; else it is the mean of the model's initial law.
    Raises ValueError where the model cannot be run, an event has no edge (under `reject`) or the start is not known.
    """
    model = in_sensor_scale(model)
    check_sha(model.sha)
    x = _start(model, word, start)
    stays = _walk(model.sha, word, policy)
    ends = [*(step.time for step, _ in stays[1:]), word.end]
    felt = felt_at_once(model.sha)
    if felt.effects:
        return _augmented(felt, stays, ends, x)
    bound = min(max(x, model.sha.low), model.sha.high)
    visits = []
    for index, ((step, location), following) in enumerate(zip(stays, ends, strict=True)):
        if index:
            x, bound = (_entered(step, location, each) for each in (x, bound))
        m = mode_parameter(location)[0] if step.m is None else step.m
        added = _offset(location, step)
        seconds = following - step.time
        end, bound = (_moved(model.sha, location, each, m + added, seconds) for each in (x, bound))
        bound = min(max(bound, model.sha.low), model.sha.high)
        visits.append(Visit(step.time, seconds, step.symbol, location.name, m, added, x, end, bound))
        x = end
    return Replay(tuple(visits))


def _augmented(sha: SHA, stays: Sequence[tuple[Step, Location]], ends: Sequence[float], x: float) -> Replay:
    """The replay where effects act."""
    given = []
    for index, (step, location) in enumerate(stays):
        m = mode_parameter(location)[0] if step.m is None else step.m
        fresh = _entered(step, location, nan) if index else nan
        references = {one.signal: one.reference for one in location.flow.inputs}
        given.append(Given(step.time, step.symbol, location, m, fresh, {**references, **step.inputs}))
    done = passed(sha, given, ends[-1], x, stays[0][0].clock or 0.0)
    return Replay(
        tuple(
            Visit(
                stay.time,
                until - stay.time,
                stay.symbol,
                stay.location.name,
                stay.m,
                _offset(stay.location, step),
                one.entered,
                one.left,
                one.clamped,
                one.least,
                one.most,
            )
            for stay, (step, _), until, one in zip(given, stays, ends, done, strict=True)
        )
    )


def _walk(sha: SHA, word: TimedWord, policy: Policy) -> list[tuple[Step, Location]]:
    """The stays with their locations; an event that is ignored begins none."""
    onward, fallback, known = transitions(sha), resync_targets(sha), sha.by_name
    here = sha.initial
    stays = [(word.steps[0], known[here])]
    for number, step in enumerate(word.steps[1:]):
        target = sha.initial if step.symbol == UNKNOWN else onward.get((here, step.symbol))
        if target is None and policy == "reject":
            raise ValueError(
                f"event {number} ({step.symbol!r} at {step.time:g} s): location {here!r} of SHA {sha.name!r} has no "
                f"edge for it; the policies 'ignore' and 'resync' go on all the same"
            )
        if target is None and policy == "ignore":
            continue
        here = fallback.get(step.symbol, sha.initial) if target is None else target
        stays.append((step, known[here]))
    return stays


def _start(model: Model, word: TimedWord, start: float | None) -> float:
    given = word.steps[0].temperature
    if given is not None:
        return given
    if start is not None:
        return start
    if model.initial is None:
        raise ValueError("the word says no start temperature and the model has no initial law; begin it as @0,T=20")
    return distributions.mean(model.initial)


def _entered(step: Step, location: Location, x: float) -> float:
    law = drawn_temperature(location)
    if law is None:
        if step.temperature is not None:
            raise ValueError(
                f"the word sets T at {step.time:g} s, but entering {location.name!r} leaves the temperature as it is"
            )
        return x
    return distributions.mean(law) if step.temperature is None else step.temperature


def _offset(location: Location, step: Step) -> float:
    known = {one.signal: step.inputs.get(one.signal, one.reference) for one in location.flow.inputs}
    return float(offset(location.flow, known))


def _moved(sha: SHA, location: Location, x: float, target: float, seconds: float) -> float:
    return float(mean_step(location.flow, x, target, 0.0, seconds, sha.max_rate)) if seconds > 0 else x
