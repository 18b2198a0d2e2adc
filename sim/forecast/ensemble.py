"""Several models followed together: one forecast from all of theirs, with weights from how right each was of late.

The combined forecast is the mixture of the members' laws (a linear pool), not an average of their numbers: where
members disagree it is wide, or has two humps. The weights are those under which the mixture itself would have given the
readings the greatest density, followed online: each matured forecast credits a member with its share of the mixture's
density (the E-step of EM for a mixture's weights; Raftery et al. 2005 fit the same on a sliding window), and credits
fade with a stated half-life. Weights are kept for each context and drawn towards the overall ones where a context has
little evidence; no weight falls below a floor, so that a member can come back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite, isnan, log

import numpy as np
from numpy.typing import ArrayLike

from sim.forecast.fan import LEVELS, Forecast
from sim.scores import Estimate
from sim.sha import Array

DENSE = tuple(round(0.01 * percent, 2) for percent in range(1, 100))
"""Levels of a member's fan in a mixture: a band of 90 % of the whole may lie in one member's tail."""

HALF_LIFE = 30.0
"""Independent forecasts (time over horizon) after which a credit counts half: 30 minutes at 60 s ahead."""
FLOOR = 0.02
STRENGTH = 4.0
"""Independent forecasts that the weights drawn to (equal ones overall; the overall ones in a context) count for."""
LEAST_WIDTH = 1e-3
"""degC: no two neighbouring quantiles are taken to be closer, so that a density stays finite."""


@dataclass(frozen=True, slots=True)
class Pool:
    """What the members of an ensemble are worth at one horizon: fading credits overall and by context.

    `half_life`, `strength` (both in independent forecasts) and `floor` are as in the module. `fixed` weights never
    change. Credits are one number a member; their sum is the evidence that they stand on.
    """

    members: int
    half_life: float = HALF_LIFE
    floor: float = FLOOR
    strength: float = STRENGTH
    fixed: tuple[float, ...] | None = None
    overall: tuple[float, ...] = ()
    contexts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.members < 1 or not self.half_life > 0 or not self.strength > 0:
            raise ValueError("a pool needs at least one member, and a half-life and a strength above 0")
        if not 0 <= self.floor * self.members < 1:
            raise ValueError(f"a floor of {self.floor:g} leaves {self.members} members nothing; give less")
        if self.fixed is not None:
            check_weights(self.fixed, self.members)


def check_weights(weights: Sequence[float], members: int) -> None:
    """Raises ValueError unless there is one weight a member, none negative, and they sum to 1."""
    if len(weights) != members or not all(isfinite(weight) and weight >= 0 for weight in weights):
        raise ValueError(f"{members} members need {members} weights of at least 0, got {list(weights)}")
    if abs(sum(weights) - 1.0) > 1e-6:
        raise ValueError(f"the weights must sum to 1, and {list(weights)} sum to {sum(weights):g}")


def weights(pool: Pool, context: str = "") -> tuple[float, ...]:
    """The members' weights in a context; they sum to 1."""
    if pool.fixed is not None:
        return pool.fixed
    equal = (1.0 / pool.members,) * pool.members
    return _floored(pool, _drawn(pool, context, _drawn_to(pool, pool.overall, equal)))


def _drawn(pool: Pool, context: str, overall: tuple[float, ...]) -> tuple[float, ...]:
    own = pool.contexts.get(context)
    return overall if own is None else _drawn_to(pool, own, overall)


def _drawn_to(pool: Pool, credits: tuple[float, ...], towards: tuple[float, ...]) -> tuple[float, ...]:
    if not credits:
        return towards
    total = sum(credits) + pool.strength
    return tuple((credit + pool.strength * prior) / total for credit, prior in zip(credits, towards, strict=True))


def _floored(pool: Pool, plain: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(pool.floor + (1.0 - pool.floor * pool.members) * weight for weight in plain)


def learn(pool: Pool, context: str, log_densities: Sequence[float | None], worth: float = 1.0) -> Pool:
    """The pool after a reading, of which each member's forecast had said the log density (nats; None: no forecast).

    `worth` (0 to 1) is the part of an independent forecast that it is. Only members that had a forecast are compared:
    the credit that is shared among them is what the weights already gave them, so an absent one loses nothing by it.
    """
    # A density that is no number (of a fan with a NaN in it) is no forecast either.
    known = {place: nats for place, nats in enumerate(log_densities) if nats is not None and not isnan(nats)}
    if pool.fixed is not None or len(known) < 2 or not worth > 0:
        return pool
    fade = 0.5 ** (worth / pool.half_life)
    equal = (1.0 / pool.members,) * pool.members
    plain = _drawn_to(pool, pool.overall, equal)
    overall = _credited(pool.overall, plain, known, worth=worth, fade=fade)
    floored = _floored(pool, _drawn(pool, context, plain))
    contexts = dict(pool.contexts)
    contexts[context] = _credited(contexts.get(context, ()), floored, known, worth=worth, fade=fade)
    return replace(pool, overall=overall, contexts=contexts)


def _credited(
    credits: tuple[float, ...],
    weights: tuple[float, ...],
    log_densities: Mapping[int, float],
    *,
    worth: float,
    fade: float,
) -> tuple[float, ...]:
    """Credits faded, and `worth` shared by w_i p_i / sum w p; members without a forecast keep their weight's part."""
    after = [fade * credit for credit in credits] or [0.0] * len(weights)
    best = max(log_densities.values())  # only ratios count, and exp of the difference does not underflow for all
    shares = {place: weights[place] * float(np.exp(density - best)) for place, density in log_densities.items()}
    total, room = sum(shares.values()), sum(weights[place] for place in log_densities)
    for place, weight in enumerate(weights):
        after[place] += worth * (room * shares[place] / total if place in shares else weight)
    return tuple(after)


@dataclass(frozen=True, slots=True)
class Awaited:
    """The members' fans for one horizon (quantiles at `forecast.LEVELS`; None: no forecast), waiting for `due` (s)."""

    due: float
    context: str
    fans: tuple[tuple[float, ...] | None, ...]


@dataclass(frozen=True, slots=True)
class PoolEvidence:
    """A pool with the forecasts that wait for their reading; `last` is the due time of the newest that had one."""

    pool: Pool
    last: float = -inf
    pending: tuple[Awaited, ...] = ()


def issue_pool(
    evidence: PoolEvidence, horizon: float, context: str, forecasts: Sequence[Forecast | None]
) -> PoolEvidence:
    """The evidence with the members' forecasts for `horizon` (s) waiting; a single one teaches nothing."""
    present = [forecast for forecast in forecasts if forecast is not None]
    if evidence.pool.fixed is not None or len(present) < 2:
        return evidence
    column = present[0].horizons.tolist().index(horizon)
    fans = tuple(
        None if forecast is None else tuple(thinned(forecast, LEVELS).quantiles[:, column].tolist())
        for forecast in forecasts
    )
    waiting = Awaited(present[0].time + horizon, context, fans)
    return replace(evidence, pending=(*evidence.pending, waiting))


def settle_pool(
    evidence: PoolEvidence, horizon: float, time: float, temperature: float, tolerance: float
) -> PoolEvidence:
    """The evidence after a reading (degC) at `time`: what is due is learned from, what is overdue is dropped.

    Forecasts that overlap err together: one is worth the part of its horizon by which it is newer than the one before.
    A reading that is no number settles nothing, but time passes all the same.
    """
    if not evidence.pending or evidence.pending[0].due > time:
        return evidence
    known, pool, last = isfinite(temperature), evidence.pool, evidence.last
    waiting = [awaited for awaited in evidence.pending if awaited.due >= time - tolerance]
    for awaited in waiting:
        if known and awaited.due <= time:
            worth = min(max(awaited.due - last, 0.0) / horizon, 1.0)
            densities = [None if fan is None else log_density(LEVELS, fan, temperature) for fan in awaited.fans]
            pool, last = learn(pool, awaited.context, densities, worth), max(last, awaited.due)
    return PoolEvidence(pool, last, tuple(awaited for awaited in waiting if awaited.due > time or not known))


def log_density(levels: ArrayLike, quantiles: ArrayLike, outcome: float, least: float = LEAST_WIDTH) -> float:
    """ln of the density (1/degC) of a fan at `outcome`: flat between its quantiles, exponential beyond the outermost.

    The tails begin at the height of the outer bins, and hold the probability that lies beyond: a reading far outside
    costs a member in proportion to its distance, not to its square, so one glitch of a sensor does not decide.
    """
    alpha = np.asarray(levels, dtype=float)
    edges = np.asarray(quantiles, dtype=float)
    widths = np.maximum(np.diff(edges), least)
    if outcome < edges[0]:
        return _tail(float(edges[0] - outcome), float(alpha[0]), _reach(alpha[1] / alpha[0], widths[0]))
    if outcome > edges[-1]:
        beyond = 1.0 - alpha
        return _tail(float(outcome - edges[-1]), float(beyond[-1]), _reach(beyond[-2] / beyond[-1], widths[-1]))
    row = min(max(int(np.searchsorted(edges, outcome)) - 1, 0), widths.size - 1)
    return log(float((alpha[row + 1] - alpha[row]) / widths[row]))


def _reach(ratio: float, width: float) -> float:
    """The scale (degC) at which an exponential tail falls by `ratio` over `width`."""
    return float(width) / log(float(ratio))


def _tail(distance: float, mass: float, reach: float) -> float:
    return log(mass / reach) - distance / reach


def thinned(forecast: Forecast, levels: tuple[float, ...]) -> Forecast:
    """The forecast with only some of its levels. Raises ValueError for one that it lacks."""
    rows = [forecast.levels.index(level) for level in levels]
    return replace(forecast, levels=levels, quantiles=forecast.quantiles[rows])


def mixture(forecasts: Sequence[Forecast], weights: ArrayLike, levels: tuple[float, ...]) -> Forecast:
    """The mixture of forecasts made at one time for the same horizons and limit; its fan is at `levels`.

    `weights` are (members,), or (H, members) with a row a horizon; each row sums to 1. Quantiles are those of the
    weighted sum of distribution functions, linear between the members' quantiles. The exceedance is the weighted mean,
    and so are its interval's ends: half-widths are added as if all erred the same way, so the interval is too wide
    rather than too narrow. `factors` are weighted means too, clamps and cut runs are added up.

    Raises ValueError when the forecasts do not belong together.
    """
    first = forecasts[0]
    for other in forecasts[1:]:
        if other.limit != first.limit or not np.array_equal(other.horizons, first.horizons):
            raise ValueError("only forecasts of the same horizons and limit can be mixed")
    w = np.broadcast_to(np.asarray(weights, dtype=float), (first.horizons.size, len(forecasts)))
    for row in w:
        check_weights(row.tolist(), len(forecasts))
    columns, locations = [], []
    for h, row in enumerate(w):
        columns.append(_mixed_quantiles([(member.levels, member.quantiles[:, h]) for member in forecasts], row, levels))
        shares: dict[str, float] = {}
        for weight, member in zip(row.tolist(), forecasts, strict=True):
            for name, chance in member.locations[h].items():
                shares[name] = shares.get(name, 0.0) + weight * chance
        locations.append({name: chance for name, chance in shares.items() if chance > 0})
    runs = sum(member.runs for member in forecasts)
    # The chance of having reached the limit never falls with the horizon, though the weights may differ from one to
    # the next: the running maximum keeps it so.
    ends = np.array([[(e.probability, e.low, e.high) for e in member.exceedance] for member in forecasts])
    mixed = np.clip(np.maximum.accumulate(np.einsum("hm,mhe->he", w, ends), axis=0), 0.0, 1.0)
    return Forecast(
        time=first.time,
        horizons=first.horizons,
        levels=levels,
        quantiles=np.array(columns).T,
        locations=tuple(locations),
        limit=first.limit,
        exceedance=tuple(Estimate(float(p), float(low), float(high), runs) for p, low, high in mixed),
        minutes_to_limit=_minutes(forecasts, w),
        runs=runs,
        factors=np.array([row @ [member.factors[h] for member in forecasts] for h, row in enumerate(w)]),
        clamps=sum(member.clamps for member in forecasts),
        cut=sum(member.cut for member in forecasts),
    )


def _mixed_quantiles(fans: Sequence[tuple[tuple[float, ...], Array]], w: Array, levels: tuple[float, ...]) -> Array:
    """The mixture's quantiles at one horizon; a member without weight has no say in where the grid lies."""
    counted = [(fan, float(weight)) for fan, weight in zip(fans, w, strict=True) if weight > 0]
    if len(counted) == 1 and set(levels) <= set(counted[0][0][0]):
        own, quantiles = counted[0][0]
        return np.array([quantiles[own.index(level)] for level in levels])
    fences = [_with_ends(*fan) for fan, _ in counted]
    grid = np.unique(np.concatenate([values for _, values in fences]))
    total = np.zeros(grid.size)
    for (alpha, values), (_, weight) in zip(fences, counted, strict=True):
        total += weight * np.interp(grid, values, alpha, left=0.0, right=1.0)
    # Where the distribution function stands still its inverse is not one: only the points at which it rises are kept.
    keep = np.concatenate([[True], np.diff(total) > 0])
    return np.asarray(np.interp(levels, total[keep], grid[keep]))


def _with_ends(levels: tuple[float, ...], quantiles: Array) -> tuple[Array, Array]:
    """A fan closed at 0 and 1 by straight lines that go on as between its two outermost quantiles; values ascend."""
    alpha, values = np.asarray(levels), np.maximum.accumulate(quantiles + LEAST_WIDTH * 1e-6 * np.arange(len(levels)))
    low = values[0] - (values[1] - values[0]) * alpha[0] / (alpha[1] - alpha[0])
    high = values[-1] + (values[-1] - values[-2]) * (1.0 - alpha[-1]) / (alpha[-1] - alpha[-2])
    return np.concatenate([[0.0], alpha, [1.0]]), np.concatenate([[low], values, [high]])


def _minutes(forecasts: Sequence[Forecast], w: Array) -> tuple[float, float, float]:
    """The 5, 50 and 95 % quantiles of the time to the limit, from what the members say of it at horizons and minutes.

    Each member's distribution function is linear between the points known of it; weights are linear between horizons.
    """
    horizons = forecasts[0].horizons / 60.0
    points = []
    for forecast in forecasts:
        known = [(minutes, share) for minutes, share in zip(forecast.minutes_to_limit, (0.05, 0.5, 0.95), strict=True)]
        known += [(h / 60.0, e.probability) for h, e in zip(forecast.horizons, forecast.exceedance, strict=True)]
        known = sorted((minutes, share) for minutes, share in known if minutes < inf)
        # A forecast whose 95 % quantile is 0 minutes was made at the limit: nothing is interpolated from 0 there.
        start = 1.0 if forecast.minutes_to_limit[2] == 0.0 else 0.0
        times, chances = np.array([(0.0, start), *known]).T
        points.append((times, np.maximum.accumulate(chances)))
    clock = np.unique(np.concatenate([times for times, _ in points]))
    total = np.zeros(clock.size)
    for member, (times, chances) in enumerate(points):
        total += np.interp(clock, horizons, w[:, member]) * np.interp(clock, times, chances)
    total = np.maximum.accumulate(total)
    return _until(clock, total, 0.05), _until(clock, total, 0.5), _until(clock, total, 0.95)


def _until(clock: Array, total: Array, share: float) -> float:
    """When the distribution function `total` over `clock` passes `share`; inf where it never does."""
    if total[-1] < share:
        return inf
    row = int(np.searchsorted(total, share))
    if row == 0:
        return float(clock[0])
    part = (share - total[row - 1]) / (total[row] - total[row - 1])
    return float(clock[row - 1] + part * (clock[row] - clock[row - 1]))
