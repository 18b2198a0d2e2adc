"""By how much a model's bands must be widened, learned from forecasts of what the model was not fitted to."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from math import exp, inf, log, nan
from typing import TypeVar

import numpy as np

from sim.anomaly import AnomalyRecord, ScorePeaks
from sim.engine import Belief, Tracker, anomaly, compile_tracker, observe, on_event, start, with_inputs
from sim.forecast import FAN_LEVELS, Z90, fans, member_weights, observe_leap
from sim.lab.learning.anomaly_level import record_scores
from sim.lab.learning.outcomes import clean_readings
from sim.lab.learning.plain import PERSISTENCE
from sim.lab.learning.runs import first_switch
from sim.scores import crps_quantiles
from sim.sha import UNKNOWN, Array, Event, Model, PlainMember, Trace, content_hash, plain_model

DAY_S = 86_400.0
HORIZONS_S = (60.0, 300.0, 900.0)
FORECAST_COUNT = 100
"""Forecasts that are made in all, spread evenly over the time that may be used."""
FORECAST_RUNS = 128
MAX_ROWS = 10_000
"""Rows filtered in all; more are thinned evenly, the forecasts' outcomes are not."""
PRIOR_FORECASTS, PRIOR_FACTOR = 4.0, 1.25
"""A factor of 1.25 counts for four independent forecasts: the model does not know how wrong its own flows may be."""
MAX_PLAIN_ROWS = 4_000
"""The same of a plain member: what it was worth at training is only where its weight begins."""
MAX_PRIOR_FORECASTS = 6.0
"""Independent forecasts at most that a plain member's odds at training count for: another machine is not this one."""
UNSEEN_ODDS, UNSEEN_WIDENING = 20.0, 1.75
"""Where only later times of the training's own traces were held out, nobody knows how the model fits another day: the
plain members together have these odds, and all bands are wider by this."""
UNSEEN_DRIFT = 0.5
"""There another day may drift as this one did not: on the scale of logarithms a factor is drawn so far up towards the
largest one of a shorter horizon."""
LEAST_WIDENING, MOST_WIDENING = 0.5, 5.0
"""Bounds of a factor: what lies outside is a model that does not fit, which a band cannot mend."""
Group = TypeVar("Group")


@dataclass(frozen=True, slots=True)
class UnitScore:
    """The mean CRPS (degC) of a unit's forecasts of one horizon; `moments` is the hash of when each was due, and after
    every how manieth row: those of two models have something in common where it is the same, and only there."""

    crps: float
    moments: str


@dataclass(frozen=True, slots=True)
class Coverage:
    """What was seen at one `horizon` (s): `forecasts`, worth so many `independent` ones (they overlap), the share
    `covered` by the 90 % band as the model gave it, the `factor` that comes of it, their mean CRPS (degC), and that of
    `persistence` at the same moments (NaN where none stood beside the model). `other_days` says whether whole traces or
    machines were held out; else it was later times of the same ones, and `widening` is for what they cannot tell.
    `units` has what was seen in each `Scored.unit`. `width` (degC) is the median width of that band, 0 where not kept.
    """

    horizon: float
    forecasts: int
    independent: float
    covered: float
    factor: float
    crps: float
    persistence: float = nan
    other_days: bool = True
    units: Mapping[str, UnitScore] = field(default_factory=dict)
    width: float = 0.0

    @property
    def widening(self) -> float:
        """The factor that a model has: what was seen, and more where nothing was seen of another day."""
        return self.factor if self.other_days else min(UNSEEN_WIDENING * self.factor, MOST_WIDENING)


@dataclass(frozen=True, slots=True)
class Scored:
    """One forecast for one horizon: when it was due, its error in units of the band (1.645 is its edge), its CRPS, and
    the `width` of its 90 % band (both degC).

    It was made along the `trace` of that name, of a `machine` ("": nobody says of which), in a `unit` of it that errs
    apart: the machine's cycle, or the day where no switch is read. It is called by the hash of the temperature's
    readings and the moment of its beginning, so that another model's forecasts of the same are found. The filter had
    read every `stride`th row.
    """

    horizon: float
    due: float
    z: float
    crps: float
    machine: str = ""
    trace: str = ""
    unit: str = ""
    stride: int = 1
    width: float = 0.0


@dataclass(slots=True)
class HeldOutScores:
    """The anomaly scores along held-out data: their `peaks`, over how many `seconds`, of which (machine, trace)s."""

    peaks: ScorePeaks = field(default_factory=ScorePeaks)
    seconds: float = 0.0
    traces: set[tuple[str, str]] = field(default_factory=set)

    @property
    def record(self) -> AnomalyRecord | None:
        """What a model keeps of it; None where nothing was held out."""
        return record_scores(self.peaks.peaks, self.seconds, _count_units(self.traces))


def score_forecasts(
    model: Model,
    traces: Sequence[Trace],
    since: Sequence[float],
    rng: np.random.Generator,
    *,
    origins: int = FORECAST_COUNT,
    most_rows: int = MAX_ROWS,
    correct: Callable[[Tracker, Belief, float, float], Belief] = observe,
    scores: HeldOutScores | None = None,
) -> list[Scored]:
    """`origins` forecasts with unknown events from moments at or after `since` (one per trace, absolute s), scored.

    The belief is filtered over each whole trace, as it would be on the plant, and `correct` takes in each reading;
    isolated spikes are no outcomes. What the anomaly score does meanwhile is added to `scores`.
    """
    # The factors of an earlier calibration would widen the very bands that are judged here.
    tracker = compile_tracker(replace(model, calibration={}))
    usable = [max(float(trace.times[-1]) - first, 0.0) for trace, first in zip(traces, since, strict=True)]
    every = max(sum(usable) / origins, 1e-9)
    stride = max(sum(trace.times.size for trace in traces) // most_rows, 1)
    seen: list[tuple[Trace, Belief, dict[float, float]]] = []
    for trace, first in zip(traces, since, strict=True):
        raw = trace.signal_course(tracker.model.temperature)
        outcomes = clean_readings(trace.times, raw, tracker.model.alphabet.gap)
        rows = np.arange(0, trace.times.size, stride)
        inputs = {name: trace.signals[name][rows].tolist() for name in sorted(tracker.inputs) if name in trace.signals}
        # The last event never comes: it spares the loop a look at the end of the list.
        events, upcoming = [*trace.events, Event(inf, UNKNOWN)], 0
        belief = start(tracker, min(float(trace.times[0]), events[0].time))
        following = max(first, float(trace.times[0]) + every / 2)
        before = first
        for row, (time, value) in enumerate(zip(trace.times[rows].tolist(), raw[rows].tolist(), strict=True)):
            while events[upcoming].time <= time:
                belief = on_event(tracker, belief, events[upcoming])
                upcoming += 1
            belief = with_inputs(tracker, belief, time, {name: column[row] for name, column in inputs.items()})
            # The filter gets the raw reading, spikes included: on the plant nobody takes them out beforehand.
            belief = correct(tracker, belief, time, value)
            if scores is not None and time >= first:
                scores.peaks.take(anomaly(belief))
                scores.seconds += min(time - before, model.alphabet.gap)
                before = time
            if time >= following and belief.seen:
                due = {horizon: outcomes.interpolate(time + horizon) for horizon in HORIZONS_S}
                seen.append((trace, belief, {horizon: value for horizon, value in due.items() if value is not None}))
                following = max(following + every, time)
        if scores is not None:
            scores.peaks.end()
            scores.traces.add((trace.machine, trace.name))
    judged = [each for each in seen if each[-1]]
    found = fans(tracker, [(belief, tuple(due)) for _, belief, due in judged], rng, runs=FORECAST_RUNS)
    units = {id(trace): _name_units(trace, model) for trace in traces}
    return [
        score
        for (trace, belief, due), fan in zip(judged, found, strict=True)
        for score in _scores(trace, belief.time, due, fan, units[id(trace)](belief.time), stride)
    ]


def _name_units(trace: Trace, model: Model) -> Callable[[float], str]:
    """The name of the cycle (or day) of a moment, which is the same whatever else was read beside the temperature."""
    alone = replace(trace, signals={model.temperature: trace.signals[model.temperature]}, bad={}, held={}, units={})
    begin, switch = float(trace.times[0]), first_switch(model.alphabet)
    if switch is None:
        starts = np.arange(begin, float(trace.times[-1]) + DAY_S, DAY_S)
    else:
        starts = np.array([begin, *(event.time for event in trace.events if event.symbol == switch.rising)])
    recording = content_hash(alone)[:16]
    return lambda time: f"{recording}/{starts[np.searchsorted(starts, time, side='right') - 1] - begin:.0f}"


def _scores(trace: Trace, time: float, due: Mapping[float, float], fan: Array, unit: str, stride: int) -> list[Scored]:
    """The `fan` (L, H) of a forecast made at `time` (s) along a trace against what came true, horizon -> degC."""
    low, median, high = (fan[FAN_LEVELS.index(level)] for level in (0.05, 0.5, 0.95))
    scored = []
    for column, (horizon, outcome) in enumerate(due.items()):
        error = outcome - median[column]
        # The law need not be symmetric: an error counts in units of the half of the band on whose side it lies.
        edge = high[column] - median[column] if error >= 0 else median[column] - low[column]
        z = float(Z90 * abs(error) / max(edge, 1e-9))
        crps = float(crps_quantiles(FAN_LEVELS, fan[:, column], outcome))
        width = float(high[column] - low[column])
        scored.append(Scored(horizon, time + horizon, z, crps, trace.machine, trace.name, unit, stride, width))
    return scored


@dataclass(slots=True)
class HeldOutForecasts:
    """What models of the same kind forecast beyond what they were fitted to, and the `plain` members beside them.

    `seed` draws the plain members' runs; the model's are drawn by whoever adds it. `other_days` is as in `Coverage`.
    """

    plain: Sequence[PlainMember]
    seed: int
    scored: list[Scored] = field(default_factory=list)
    of_plain: dict[str, list[Scored]] = field(default_factory=dict)
    other_days: bool = True
    scores: HeldOutScores = field(default_factory=HeldOutScores)

    def add(
        self,
        model: Model,
        traces: Sequence[Trace],
        since: Sequence[float],
        rng: np.random.Generator,
        *,
        origins: int = FORECAST_COUNT,
    ) -> None:
        """Score the forecasts of a part (`score_forecasts`), the plain members' along the same traces."""
        self.scored += score_forecasts(model, traces, since, rng, origins=origins, scores=self.scores)
        for number, member in enumerate(self.plain):
            own = np.random.default_rng((self.seed, number + 1, len(self.scored)))
            beside = replace(plain_model(model, member), calibration={})
            self.of_plain.setdefault(member.name, []).extend(
                score_forecasts(
                    beside, traces, since, own, origins=origins, most_rows=MAX_PLAIN_ROWS, correct=observe_leap
                )
            )

    @property
    def coverage(self) -> tuple[Coverage, ...]:
        """The model's own coverage and factors, and its CRPS beside persistence's."""
        beside = _horizon_crps(self.of_plain.get(PERSISTENCE, []))
        return tuple(
            replace(row, persistence=beside.get(row.horizon, nan), other_days=self.other_days)
            for row in horizon_coverage(self.scored)
        )

    @property
    def members(self) -> tuple[PlainMember, ...]:
        """The plain members with their factors, and with their odds against the model at each horizon.

        The odds are those that a pool would have come to over as many independent forecasts, MAX_PRIOR_FORECASTS at
        most. Forecasts of one unit err together: who was better on all of n is so on the next with odds of n + 1
        (Laplace's rule of succession), and no odds are above that.
        """
        unseen = UNSEEN_ODDS / max(len(self.plain), 1)
        independent = {row.horizon: row.independent for row in self.coverage}
        own = _horizon_crps(self.scored)
        members = []
        for member in self.plain:
            scored = self.of_plain.get(member.name, [])
            losses, odds = _horizon_crps(scored), {} if self.other_days else dict.fromkeys(HORIZONS_S, unseen)
            for horizon in own.keys() & losses.keys() if self.other_days else ():
                pair = np.array([own[horizon], losses[horizon]])
                weight = member_weights(
                    np.ones(2), pair / max(pair.min(), 1e-3), min(independent[horizon], MAX_PRIOR_FORECASTS)
                )
                most = 1.0 + _count_units((each.machine, each.trace) for each in self.scored if each.horizon == horizon)
                odds[horizon] = float(min(max(weight[1] / max(weight[0], 1e-9), 1.0 / most), most))
            members.append(replace(member, calibration=self._factors(scored), odds=dict(sorted(odds.items()))))
        return tuple(members)

    @property
    def calibration(self) -> dict[float, float]:
        """The model's factor at each horizon; {} where nothing was to be held out."""
        return self._factors(self.scored)

    def _factors(self, scored: Sequence[Scored]) -> dict[float, float]:
        rows = [replace(row, other_days=self.other_days) for row in horizon_coverage(scored)]
        factors = {row.horizon: row.widening for row in rows}
        if not self.other_days:
            # A recording too short to see a horizon through tells no more of it than a longer one.
            cautious, largest = max([UNSEEN_WIDENING * PRIOR_FACTOR, *factors.values()]), 0.0
            for horizon, seen in factors.items():
                largest = max(largest, seen)
                factors[horizon] = seen * (largest / seen) ** UNSEEN_DRIFT
            factors = dict.fromkeys(HORIZONS_S, cautious) | factors
        return factors


def _count_units(traces: Iterable[tuple[str, str]]) -> int:
    """How many of (machine, trace)s err apart: machines where several are told apart, else traces."""
    found = set(traces)
    machines = {machine for machine, _ in found}
    return len(machines) if len(machines) > 1 else len(found)


def _horizon_crps(scored: Sequence[Scored]) -> dict[float, float]:
    """horizon -> mean CRPS, degC."""
    return {horizon: _mean_crps(group) for horizon, group in _group(scored, lambda each: each.horizon).items()}


def _unit_scores(scored: Sequence[Scored]) -> dict[str, UnitScore]:
    """unit -> its score, of forecasts of one horizon in the order of time."""
    found = {}
    for unit, group in _group(scored, lambda each: each.unit).items():
        moments = np.array([(each.due, each.stride) for each in group], dtype="<f8")
        found[unit] = UnitScore(_mean_crps(group), sha256(moments.tobytes()).hexdigest()[:16])
    return found


def _group(scored: Sequence[Scored], key: Callable[[Scored], Group]) -> dict[Group, list[Scored]]:
    found: dict[Group, list[Scored]] = {}
    for each in scored:
        found.setdefault(key(each), []).append(each)
    return found


def _mean_crps(scored: Sequence[Scored]) -> float:
    return float(np.mean([each.crps for each in scored]))


def independent_forecasts(times: Array, horizon: float) -> float:
    """How many forecasts that do not overlap those for one `horizon` (s) at the ascending `times` (n,) are worth.

    Gaps are cut to one horizon: beyond that they have nothing in common anyway.
    """
    return 1.0 + float(np.minimum(np.diff(times), horizon).sum()) / horizon if times.size else 0.0


def horizon_coverage(scored: Sequence[Scored]) -> tuple[Coverage, ...]:
    """The factor of each horizon, from the 90 % quantile of z.

    Forecasts whose spans overlap err together: n of them that span T seconds count as T / horizon. The quantile is
    taken a little above 90 % (split-conformal: 0.9 (1 + 1/n)), and the factor is drawn towards 1.25 on the scale
    of logarithms as if four independent forecasts had said so.
    """
    table = []
    for horizon in HORIZONS_S:
        forecasts = sorted((forecast for forecast in scored if forecast.horizon == horizon), key=lambda each: each.due)
        if not forecasts:
            continue
        due, z = np.array([each.due for each in forecasts]), np.array([each.z for each in forecasts])
        independent = independent_forecasts(due, horizon)
        level = min(0.9 * (1.0 + 1.0 / independent), 0.97)
        seen = min(max(float(np.quantile(z, level)) / Z90, LEAST_WIDENING), MOST_WIDENING)
        factor = exp((independent * log(seen) + PRIOR_FORECASTS * log(PRIOR_FACTOR)) / (independent + PRIOR_FORECASTS))
        covered, crps = float(np.mean(z <= Z90)), _mean_crps(forecasts)
        table.append(
            Coverage(
                horizon=horizon,
                forecasts=len(forecasts),
                independent=independent,
                covered=covered,
                factor=factor,
                crps=crps,
                units=_unit_scores(forecasts),
                width=float(np.median([each.width for each in forecasts])),
            )
        )
    return tuple(table)


def calibrate(
    model: Model, traces: Sequence[Trace], rng: np.random.Generator, since: Sequence[float] | None = None
) -> Mapping[float, float]:
    """Horizon (s) -> factor of the forecast's standard deviation, from encoded traces that `model` was not fitted to.

    Only forecasts from `since` on count (absolute s, one per trace; default: from the start). Horizons that no trace
    is long enough for are left out.
    """
    begins = [-inf] * len(traces) if since is None else since
    first = [max(begin, float(trace.times[0])) for trace, begin in zip(traces, begins, strict=True)]
    coverage = horizon_coverage(score_forecasts(model, traces, first, rng))
    return {row.horizon: row.factor for row in coverage}
