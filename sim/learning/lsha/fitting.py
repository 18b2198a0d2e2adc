"""The physical parameters over a learned structure: levels of a `resample` automaton, or a joint free-run fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.learning.free_run import RATES, Fit, Shape, fit_free_run
from sim.learning.lsha.automaton import Skeleton
from sim.learning.lsha.evidence import Sample, between
from sim.learning.lsha.flow_hypotheses import Flowing, flow_of, flow_shape, positions
from sim.learning.lsha.ground import Ground, placed
from sim.learning.lsha.segments import stays_after
from sim.learning.noise import drift_noise, fit_noise
from sim.learning.runs import Indices, Runs, sampled
from sim.learning.shape import with_parameters
from sim.sha.automaton import SHA, Distribution, Entry, Flow, Input, Location
from sim.sha.trace import Mask

FIRST_SCATTER = 1.0
"""degC by which the m of stays are believed to differ before any is seen; it counts for one stay."""


@dataclass(frozen=True, slots=True)
class LocationFit:
    """What was learned about one location: `words` that lead there, its flow, and the law of its parameter.

    `mu` and `sigma` are the law's, in the parameter's unit; `mu_error` is the standard error of the mean and `scatter`
    the standard deviation between segments apart from that; NaN where nothing is known. `segments` tell the parameter,
    `readings` end a step there, `seconds` were spent there; `rate` is k (1/s) or t0 (s).
    """

    name: str
    words: tuple[str, ...]
    flow: str
    entry: str
    segments: int
    readings: int
    seconds: float
    mu: float
    mu_error: float
    sigma: float
    scatter: float
    rate: float


@dataclass(frozen=True, slots=True)
class Fitted:
    """The automaton with all parameters, the sensor's standard deviation, raw values of each law, and the table."""

    sha: SHA
    sensor: float
    values: Mapping[str, tuple[float, ...]]
    locations: tuple[LocationFit, ...]

    @property
    def margin(self) -> float:
        """degC by which runs stray from readings: four standard deviations of sensor and drawn levels together.

        A level near the end of the usual range would be clamped half the time.
        """
        drawn = (each.sigma for each in self.locations if each.entry == "resample")
        return 4.0 * float(np.hypot(self.sensor, max(drawn, default=0.0)))


def fit_levels(
    name: str,
    ground: Ground,
    *,
    sample: Sample,
    skeleton: Skeleton,
    modelled: Sequence[bool],
    words: Sequence[Sequence[str]],
) -> Fitted:
    """A `resample` automaton under constant flows: every location draws its level anew on entry."""
    sensor, drift = _inside(ground.runs)
    unknown = drift_noise(ground.runs)
    place = skeleton.place[sample.segments.place]
    _, after = stays_after(ground.runs)
    reading = np.bincount(skeleton.place[after[np.isfinite(ground.runs.reading)]], minlength=len(skeleton.names))
    locations, values, table = [], {}, []
    for number, title in enumerate(skeleton.names):
        mine = place == number
        if not modelled[number] or not mine.any():
            locations.append(Location(title, Flow("constant", {"noise": unknown}), entry="none"))
            law = (np.nan, np.nan, np.nan)
        else:
            law = between(sample, mine)
            sigma = float(np.hypot(law[1], law[2]))
            distribution = Distribution("normal", {"mu": law[0], "sigma": sigma})
            locations.append(Location(title, Flow("constant", {"noise": drift}), distribution, "resample"))
            values[title] = tuple(sample.segments.value[mine].tolist())
        table.append(
            _row(
                ground,
                skeleton,
                number=number,
                words=words[number],
                location=locations[-1],
                segments=int(mine.sum()),
                readings=int(reading[number]),
                law=law,
            )
        )
    return Fitted(_sha(name, locations, skeleton), sensor, values, tuple(table))


def _inside(runs: Runs) -> tuple[float, float]:
    """(sensor's sigma, random walk in degC/sqrt(s)) inside segments, by the variogram: from the shortest lag to the
    longest one in each segment."""
    stay, _ = stays_after(runs)
    there = np.flatnonzero(np.isfinite(runs.reading))
    same = stay[there[1:]] == stay[there[:-1]]
    near = np.column_stack([there[:-1], there[1:]])[same]
    _, first = np.unique(stay[there], return_index=True)
    ends = np.append(first[1:], there.size) - 1
    far = np.column_stack([there[first], there[ends]])[ends - first >= 2]
    if not len(near):
        return 1e-3, 1e-3
    half, lag = _variogram(runs, near)
    sensor = max(float(np.sqrt(half)), 1e-3)
    if len(far) < 3:
        return sensor, 1e-3 * sensor
    half_far, lag_far = _variogram(runs, far)
    walk = max(half_far - half, 0.0) * 2.0 / max(lag_far - lag, 1e-9)
    return sensor, float(max(np.sqrt(walk), 1e-3 * sensor))


def _variogram(runs: Runs, pairs: Indices) -> tuple[float, float]:
    """(half the robust mean squared difference, mean lag) of pairs of readings."""
    gap = np.abs(runs.reading[pairs[:, 1]] - runs.reading[pairs[:, 0]])
    limit = 4.0 * max(1.4826 * float(np.median(gap)), 1e-9)
    kept = gap <= limit
    return 0.5 * float(np.mean(gap[kept] ** 2)), float(np.mean(runs.time[pairs[:, 1]] - runs.time[pairs[:, 0]]))


def fit_motion(
    name: str,
    ground: Ground,
    *,
    flowing: Flowing,
    skeleton: Skeleton,
    modelled: Sequence[bool],
    words: Sequence[Sequence[str]],
    kinds: Sequence[str],
    budget: int,
) -> Fitted:
    """A `parameter` automaton: all targets, rates and gains together by the likelihood of the free runs."""
    size = len(skeleton.names)
    place = skeleton.place
    where = positions(ground, place, size)
    shape, rated = flow_shape(flowing.hypothesis, ground, where, modelled, kinds)
    runs = sampled(placed(ground.runs, place), budget)
    begin = flowing.rates_of(rated) if all(kind == flowing.hypothesis.kind for kind in kinds) else None
    fit = fit_free_run(runs, shape, begin=begin)
    order = sorted(set(where))
    groups = np.array([order.index(each) for each in where], dtype=np.intp)
    noise = fit_noise(runs, shape, fit, groups)
    bare = _bare(name, ground, shape=shape, skeleton=skeleton, modelled=modelled, unknown=drift_noise(ground.runs))
    sha = with_parameters(bare, shape, fit)
    located = skeleton.place[flowing.sample.segments.place]
    locations, values, table = [], {}, []
    readings = np.bincount(runs.place[np.isfinite(runs.reading) & ~runs.first], minlength=size)
    for number, location in enumerate(sha.locations):
        mine, law = located == number, (np.nan, np.nan, np.nan)
        if shape.target[number] >= 0:
            stays = np.unique(runs.stay[(runs.place == number) & ~runs.first]).size
            law = _law(fit, int(shape.target[number]), float(noise.scatter[number]), stays)
            location = _with_law(location, law, float(noise.process[groups[number]]))
            own = kinds[number] == flowing.hypothesis.kind
            values[location.name] = (_told(flowing.sample, mine, law) if own else ()) or (law[0],)
        locations.append(location)
        table.append(
            _row(
                ground,
                skeleton,
                number=number,
                words=words[number],
                location=location,
                segments=int(mine.sum()),
                readings=int(readings[number]),
                law=law,
            )
        )
    return Fitted(_sha(name, locations, skeleton), noise.sensor, values, tuple(table))


def _told(sample: Sample, mine: Mask, law: tuple[float, float, float]) -> tuple[float, ...]:
    """The parameters of the segments `mine` that are known to within twice the law's sigma."""
    sigma = float(np.hypot(law[1], law[2]))
    return tuple(sample.segments.value[mine & (np.sqrt(sample.segments.variance) <= 2.0 * sigma)].tolist())


def _law(fit: Fit, column: int, scatter: float, stays: int) -> tuple[float, float, float]:
    """(mean, its standard error, scatter between stays); the scatter is drawn towards 1 degC as if one stay had shown
    that."""
    shrunk = float(np.sqrt((stays * scatter**2 + FIRST_SCATTER**2) / (stays + 1)))
    return float(fit.linear[column]), float(fit.errors_at_rates[column]), shrunk


def _with_law(location: Location, law: tuple[float, float, float], noise: float) -> Location:
    distribution = Distribution("normal", {"mu": law[0], "sigma": float(np.hypot(law[1], law[2]))})
    flow = replace(location.flow, params={**location.flow.params, "noise": noise})
    return replace(location, flow=flow, distribution=distribution)


def _bare(
    name: str, ground: Ground, *, shape: Shape, skeleton: Skeleton, modelled: Sequence[bool], unknown: float
) -> SHA:
    """The automaton with flows but without values, as `with_parameters` wants it."""
    entry: Entry = "none"
    locations = []
    for number, title in enumerate(skeleton.names):
        if not modelled[number] or shape.target[number] < 0:
            locations.append(Location(title, Flow("constant", {"noise": unknown}), entry=entry))
            continue
        inputs = tuple(
            Input(signal, 0.0, centre)
            for place, (signal, centre) in enumerate(zip(ground.signals, ground.centre.tolist(), strict=True))
            if shape.gain[number, place] >= 0
        )
        locations.append(Location(title, flow_of(shape.kinds[number], ground.prior.tau, inputs)))
    return _sha(name, locations, skeleton)


def _sha(name: str, locations: Sequence[Location], skeleton: Skeleton) -> SHA:
    return SHA(name, tuple(locations), skeleton.edges(), skeleton.names[0])


def _row(
    ground: Ground,
    skeleton: Skeleton,
    *,
    number: int,
    words: Sequence[str],
    location: Location,
    segments: int,
    readings: int,
    law: tuple[float, float, float],
) -> LocationFit:
    mu, error, scatter = law
    kind = location.flow.kind
    return LocationFit(
        name=skeleton.names[number],
        words=tuple(words),
        flow=kind,
        entry=location.entry,
        segments=segments,
        readings=readings,
        seconds=float(ground.runs.dt[skeleton.place[ground.runs.place] == number].sum()),
        mu=mu,
        mu_error=error,
        sigma=float(np.hypot(error, scatter)),
        scatter=scatter,
        rate=location.flow.params.get(RATES[kind], float("nan")) if kind in RATES else float("nan"),
    )
