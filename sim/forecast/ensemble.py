"""Several models followed together: one forecast from all of theirs, with weights from how right each was of late.

The combined forecast is the mixture of the members' laws (a linear pool), not an average of their numbers: where
members disagree it is wide, or has two humps. Weights are exponential in the CRPS that members had of late (the
exponentially weighted forecaster: Cesa-Bianchi & Lugosi 2006, ch. 2; for CRPS: Berrisch & Ziel 2021): losses fade with
a stated half-life, each moment's are counted in units of what members lose then or of late, whichever is less, and
weights start from prior ones. They are kept for each context beside the overall ones, and no weight falls below a
floor, so that a member can come back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite

import numpy as np
from numpy.typing import ArrayLike

from sim.forecast.fan import FAN_LEVELS, Forecast
from sim.scores import Estimate, crps_quantiles
from sim.sha import Array

DENSE_LEVELS = tuple(round(0.01 * percent, 2) for percent in range(1, 100))
"""Levels of a member's fan in a mixture: a band of 90 % of the whole may lie in one member's tail."""

HALF_LIFE_FORECASTS = 8.0
"""Independent forecasts (time over horizon) after which a loss counts half: 8 minutes at 60 s ahead."""
MIN_WEIGHT = 0.02
PRIOR_FORECASTS = 4.0
"""Independent forecasts that the overall losses count for in a context, and those of a shorter horizon in the next."""
LEARNING_RATE = 1.0
"""The learning rate: a member that is worse by the best one's whole loss falls behind by e for each independent
forecast."""
MIN_QUANTILE_GAP_DEGC = 1e-3
"""degC: no two neighbouring quantiles are taken to be closer, so that none is a point; a loss below it is none."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Fading sums: `total` (members,) of losses weighed by worth, `evidence` of the worth (independent forecasts).

    A loss is the CRPS in units of the mean of all members' at that moment, at most of the fading mean of that (`scale`,
    degC, its sum over the same `evidence`). Degrees by which all err while a machine heats up would else outweigh all
    that is seen of them in steady running; and in units of the moment alone, a member that is a little sharper while
    nothing happens would outweigh that it is far off whenever something does.

    Members without a forecast are taken to have lost what the pool's weighted mean did.
    """

    total: tuple[float, ...]
    evidence: float = 0.0
    scale: float = 0.0


@dataclass(frozen=True, slots=True)
class Pool:
    """What the members of an ensemble are worth at one horizon: fading losses overall and by context.

    `half_life`, `strength` (both in independent forecasts) and `floor` are as in the module. `prior` are the weights
    before any evidence (equal ones unless given); `fixed` weights never change.
    """

    members: int
    half_life: float = HALF_LIFE_FORECASTS
    floor: float = MIN_WEIGHT
    strength: float = PRIOR_FORECASTS
    prior: tuple[float, ...] | None = None
    fixed: tuple[float, ...] | None = None
    overall: Losses | None = None
    contexts: Mapping[str, Losses] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.members < 1 or not self.half_life > 0 or not self.strength > 0:
            raise ValueError("a pool needs at least one member, and a half-life and a strength above 0")
        if not 0 <= self.floor * self.members < 1:
            raise ValueError(f"a floor of {self.floor:g} leaves {self.members} members nothing; give less")
        for given in (self.fixed, self.prior):
            if given is not None:
                check_weights(given, self.members)


def check_weights(weights: Sequence[float], members: int) -> None:
    """Raises ValueError unless there is one weight a member, none negative, and they sum to 1."""
    if len(weights) != members or not all(isfinite(weight) and weight >= 0 for weight in weights):
        raise ValueError(f"{members} members need {members} weights of at least 0, got {list(weights)}")
    if abs(sum(weights) - 1.0) > 1e-6:
        raise ValueError(f"the weights must sum to 1, and {list(weights)} sum to {sum(weights):g}")


def weights(pool: Pool, context: str = "") -> tuple[float, ...]:
    """The members' weights in a context, by what was seen at this horizon alone; they sum to 1."""
    return weights_by_horizon([pool], context)[0]


def weights_by_horizon(pools: Sequence[Pool], context: str = "") -> list[tuple[float, ...]]:
    """The members' weights in a context for each of the `pools`, which are in the order of their horizons.

    Who is wrong at five minutes is so before anybody can know it at fifteen: the losses at the horizon before stand in
    for `strength` forecasts, and count less the more were seen at a horizon itself.
    """
    made: list[tuple[float, ...]] = []
    before: tuple[Array, float] | None = None
    for pool in pools:
        if pool.fixed is not None:
            made.append(pool.fixed)
            continue
        prior = np.full(pool.members, 1.0 / pool.members) if pool.prior is None else np.array(pool.prior)
        seen = _relative(pool, context)
        if before is not None:
            losses, evidence = before
            lent = min(pool.strength, evidence)
            own, counted = seen or (losses, 0.0)
            seen = (counted * own + lent * losses) / (counted + lent), counted + lent
        plain = prior if seen is None else member_weights(prior, *seen)
        made.append(tuple((pool.floor + (1.0 - pool.floor * pool.members) * plain).tolist()))
        before = seen
    return made


def _relative(pool: Pool, context: str) -> tuple[Array, float] | None:
    """((members,) mean losses in units of the best one's, over how many independent forecasts); None before any."""
    if pool.overall is None or not pool.overall.evidence > 0:
        return None
    mean, evidence = np.array(pool.overall.total) / pool.overall.evidence, pool.overall.evidence
    own = pool.contexts.get(context)
    if own is not None:
        # The overall losses stand in for `strength` forecasts of the context's own.
        borrowed = min(pool.strength, evidence)
        mean = (np.array(own.total) + borrowed * mean) / (own.evidence + borrowed)
        evidence = own.evidence + borrowed
    return mean / max(float(mean.min()), MIN_QUANTILE_GAP_DEGC), evidence


def member_weights(prior: Array, losses: Array, evidence: float) -> Array:
    """(members,) weights from prior ones and mean `losses`, in units of the best member's, over so much `evidence`."""
    raw = prior * np.exp(-LEARNING_RATE * evidence * (losses - losses.min()))
    return np.asarray(raw / raw.sum())


def learn(pool: Pool, context: str, losses: Sequence[float | None], worth: float = 1.0) -> Pool:
    """The pool after a reading, of which each member's forecast had the CRPS `losses` (degC; None: no forecast).

    `worth` (0 to 1) is the part of an independent forecast that it is. Only members that had a forecast are compared:
    an absent one loses what the weighted mean of the others did, so that it neither gains nor loses by it.
    """
    # A loss that is no number (of a fan with a NaN or an end that is nowhere) is no forecast either.
    known = [None if loss is None or not isfinite(loss) else loss for loss in losses]
    present = [place for place, loss in enumerate(known) if loss is not None]
    if pool.fixed is not None or len(present) < 2 or not worth > 0:
        return pool
    now = np.array(weights(pool, context))
    share = now[present].sum()
    mean = sum(now[place] * (known[place] or 0.0) for place in present) / share
    common = sum(known[place] or 0.0 for place in present) / len(present)
    lost = [mean if loss is None else loss for loss in known]
    fade = 0.5 ** (worth / pool.half_life)

    def fade_losses(before: Losses | None) -> Losses:
        before = before or Losses((0.0,) * pool.members)
        evidence = fade * before.evidence + worth
        # Losses of former versions know no scale: theirs is taken to have been today's.
        scale = fade * (before.scale or common * before.evidence) + worth * common
        unit = max(min(common, scale / evidence), MIN_QUANTILE_GAP_DEGC)
        sums = tuple(float(fade * old + worth * new / unit) for old, new in zip(before.total, lost, strict=True))
        return Losses(sums, evidence, scale)

    contexts = {**pool.contexts, context: fade_losses(pool.contexts.get(context))}
    return replace(pool, overall=fade_losses(pool.overall), contexts=contexts)


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
        None if forecast is None else tuple(thin_levels(forecast, FAN_LEVELS).quantiles[:, column].tolist())
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
            losses = [
                None if fan is None else float(crps_quantiles(FAN_LEVELS, fan, temperature)) for fan in awaited.fans
            ]
            pool, last = learn(pool, awaited.context, losses, worth), max(last, awaited.due)
    return PoolEvidence(pool, last, tuple(awaited for awaited in waiting if awaited.due > time or not known))


def thin_levels(forecast: Forecast, levels: tuple[float, ...]) -> Forecast:
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
        borrowed=tuple(
            sum(
                weight * (member.borrowed[h] if member.borrowed else 0.0)
                for weight, member in zip(row, forecasts, strict=True)
            )
            for h, row in enumerate(w.tolist())
        ),
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
    alpha, values = (
        np.asarray(levels),
        np.maximum.accumulate(quantiles + MIN_QUANTILE_GAP_DEGC * 1e-6 * np.arange(len(levels))),
    )
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
    return _quantile_time(clock, total, 0.05), _quantile_time(clock, total, 0.5), _quantile_time(clock, total, 0.95)


def _quantile_time(clock: Array, total: Array, share: float) -> float:
    """When the distribution function `total` over `clock` passes `share`; inf where it never does."""
    if total[-1] < share:
        return inf
    row = int(np.searchsorted(total, share))
    if row == 0:
        return float(clock[0])
    part = (share - total[row - 1]) / (total[row] - total[row - 1])
    return float(clock[row - 1] + part * (clock[row] - clock[row - 1]))
