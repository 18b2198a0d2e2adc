"""The models that are followed beside the first one, and the forecast that all of them make together.

Every member has an encoder, a belief and bands of its own, so its alphabet need not be the first model's; what they
share is the temperature. The first model alone gives the one-step prediction, its band, the location and the anomaly
score; the forecast is the mixture (`sim.forecast.ensemble`), whose bands are kept honest on top of its members'. A
model brings its plain members (persistence, a damped trend), which are there unless the configuration says otherwise;
beside them stands a local trend, whose smoothing is estimated as it runs (`sim.forecast.local_trend`). A member that
fails is left out, said so, and begun anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import inf
from typing import Any

import numpy as np

from gateway.machine.model.familiar import FamiliarityWord
from gateway.machine.model.predict import Predictor
from gateway.machine.reading import Scan
from gateway.settings import EnsembleSection, ForecastSection
from sim.engine import Belief, Tracker, observe
from sim.forecast import (
    DENSE_LEVELS,
    FAN_LEVELS,
    Calibration,
    Forecast,
    LocalOutlook,
    LocalTrend,
    Losses,
    Pool,
    PoolEvidence,
    calibrate,
    factors,
    forecast,
    issue_pool,
    mixture,
    observe_leap,
    recent_coverage,
    reshape,
    settle_pool,
    thin_levels,
    walk_outlook,
    weights_by_horizon,
)
from sim.forecast import issue as issue_bands
from sim.forecast import settle as settle_bands
from sim.sha import Array, Model, Switch, plain_model
from sim.strict_json import shallow_dict

FAULTS = (ValueError, ArithmeticError, LookupError)
"""What following a model may raise that concerns this model alone; anything else is a defect of the program."""

PLAIN_RUNS = 64
"""Runs of a plain member's forecast at most."""

RETRY_SECONDS = 60.0
"""Plant seconds after which a member that failed is begun anew."""


@dataclass(frozen=True, slots=True)
class ForecastJob:
    """One member's forecast: all that a thread needs, none of it changing meanwhile.

    `calibration` is what its fan's shape is taken from. For a `plain` member no event matters: its fan is exact, and a
    few runs are enough for its way to the limit.
    """

    tracker: Tracker
    belief: Belief
    factors: Mapping[float, float]
    calibration: Calibration
    seed: tuple[int, ...]
    plain: bool = False


@dataclass(frozen=True, slots=True)
class TrendJob:
    """The local trend's forecast, or a walk's, as `ForecastJob` is a model's; it is drawn from nothing."""

    outlook: LocalOutlook
    factors: Mapping[float, float]
    calibration: Calibration


@dataclass(frozen=True, slots=True)
class MixedForecast:
    """The forecasts of all members, the first one's first: a forecast, None where there was no job, or why it failed.

    `mixed` is the mixture of those that there are, `context` the one that its weights were taken for.
    """

    mixed: Forecast
    members: tuple[Forecast | str | None, ...]
    context: str


@dataclass(slots=True)
class LocalTrendMember:
    """The local trend beside the models, with its bands. It begins anew with the gateway, and needs minutes."""

    trend: LocalTrend
    calibration: Calibration


@dataclass(slots=True)
class Member:
    """One model beside the first: `failed` is when it last did (plant s) and `failure` the reason; "" while it runs."""

    name: str
    predictor: Predictor
    calibration: Calibration
    known: bool = False
    failure: str = ""
    failed: float = 0.0


LOCAL_TREND = "local trend"
LOCAL_TREND_ODDS = 0.1
"""Its odds against persistence before any evidence: on most days there is no trend to follow."""
LOCAL_TREND_WIDENING = 1.5
"""Its bands' factor before any evidence: it says how far off its best smoother was."""
MEMBER_MEMORY = 5.0
"""Independent forecasts after which what a member's band has seen fades to 1/e: the mixture has its own on top."""


def bands(model: Model, section: ForecastSection, scan_period: float, *, member: bool = True) -> Calibration:
    """The bands of a model, not yet taught: its own factors at the configured horizons.

    Those of a `member` of an ensemble forget sooner than those that are published.
    """
    own = model.calibration
    known = sorted(own)
    by_horizon = {h: float(np.interp(h, known, [own[k] for k in known])) if own else 1.0 for h in section.horizons}
    memory = {"memory": MEMBER_MEMORY} if member else {}
    return calibrate(by_horizon, tolerance=max(5.0, 3.0 * scan_period), **memory)


def run_job(job: ForecastJob | TrendJob, section: ForecastSection, limit: float, levels: tuple[float, ...]) -> Forecast:
    """The forecast of one member. Raises what the model raises."""
    if isinstance(job, TrendJob):
        widening = np.array([job.factors[horizon] for horizon in section.horizons])
        return reshape(job.outlook.forecast(widening, limit=limit, levels=levels), job.calibration)
    made = forecast(
        job.tracker,
        job.belief,
        section.horizons,
        np.random.default_rng(job.seed),
        limit=limit,
        runs=min(section.runs, PLAIN_RUNS) if job.plain else section.runs,
        events=() if job.plain else None,
        calibration=job.factors,
        levels=levels,
    )
    return reshape(made, job.calibration)


def foresee(
    first: ForecastJob,
    others: Sequence[ForecastJob | TrendJob | None],
    *,
    shares: Array,
    context: str,
    section: ForecastSection,
    limit: float,
    levels: tuple[float, ...] = FAN_LEVELS,
) -> MixedForecast:
    """All forecasts one after another, and their mixture by `shares` (H, members), renewed where some are missing.

    The mixture's fan is at `levels`.

    Raises what the first model raises; what another one raises is its entry in the result.
    """
    outcomes: list[Forecast | str | None] = [run_job(first, section, limit, DENSE_LEVELS)]
    for job in others:
        try:
            outcomes.append(None if job is None else run_job(job, section, limit, DENSE_LEVELS))
        except FAULTS as error:
            outcomes.append(repr(error))
    forecasts = [forecast for forecast in outcomes if isinstance(forecast, Forecast)]
    weight = shares[:, [place for place, forecast in enumerate(outcomes) if isinstance(forecast, Forecast)]]
    # The weights of the members that have no forecast go to the others; where none of these had any, all count alike.
    total = weight.sum(axis=1, keepdims=True)
    weight = np.where(total > 0, weight / np.where(total > 0, total, 1.0), 1.0 / len(forecasts))
    mixed = mixture(forecasts, weight, levels)
    return MixedForecast(mixed, tuple(outcomes), context)


class Ensemble:
    """The members beside the first model, and what each of them, the first included, is worth at each horizon.

    `hashes` are those of all models, the first one's first; `models` are the others, without the first one's plain
    members. `joint` are the bands of the mixture. `familiarity` is how like the training the present cycle is, as
    whoever follows that says.
    """

    def __init__(
        self,
        first: Predictor,
        hashes: Sequence[str],
        models: Sequence[Model],
        *,
        section: EnsembleSection,
        forecasts: ForecastSection,
        scan_period: float,
    ) -> None:
        self.first, self.section, self.forecasts = first, section, forecasts
        plain = first.model.plain if section.plain else ()
        self.hashes = [*hashes, *(f"{hashes[0]} {member.name}" for member in plain)]
        corrections = [observe] * len(models) + [observe_leap] * len(plain)
        models = [*models, *(plain_model(first.model, member) for member in plain)]
        names = [f"{m.sha.name} {key[:8]}" for key, m in zip(hashes, (first.model, *models), strict=False)]
        names += [member.name for member in plain]
        self.members = [
            Member(name, Predictor(model, first.temperature, correct), bands(model, forecasts, scan_period))
            for name, model, correct in zip(names[1:], models, corrections, strict=True)
        ]
        self.given = 1 + len(self.members) - len(plain)
        # A reading may come some scans after the moment that a forecast spoke of, and still counts as of that moment.
        self.tolerance = max(5.0, 3.0 * scan_period)
        self.trend: LocalTrendMember | None = None
        if plain:
            widening = dict.fromkeys(forecasts.horizons, LOCAL_TREND_WIDENING)
            self.trend = LocalTrendMember(
                LocalTrend(forecasts.horizons, scan_period),
                calibrate(widening, tolerance=self.tolerance, memory=MEMBER_MEMORY),
            )
            names.append(LOCAL_TREND)
        self.names = names
        count = len(names)

        def pool(horizon: float) -> Pool:
            if isinstance(section.weights, tuple):
                return Pool(count, fixed=(*section.weights, *(0.0,) * (count - self.given)))
            if section.weights == "equal":
                return Pool(count, fixed=(1.0 / count,) * count)
            odds = np.array([1.0] * self.given + [_interpolate_odds(member.odds, horizon) for member in plain])
            if plain:
                odds = np.append(odds, LOCAL_TREND_ODDS * odds[self.given])
            prior = tuple((odds / odds.sum()).tolist())
            return Pool(count, half_life=section.half_life, floor=section.floor, prior=prior)

        self.evidence = {horizon: PoolEvidence(pool(horizon)) for horizon in forecasts.horizons}
        # Only the integral part: what the members' own bands learn from a miss, these must not learn once more.
        self.joint = calibrate(dict.fromkeys(forecasts.horizons, 1.0), weight=inf, tolerance=self.tolerance)
        self.complaints: list[tuple[str, str]] = []
        self.familiarity: FamiliarityWord = "unknown"

    def keep(self, former: "Ensemble") -> None:
        """Go on with the configured members as `former` has followed them; plain members are the first model's own."""
        self.members[: self.given - 1] = former.members[: former.given - 1]

    @property
    def context(self) -> str:
        """What the first model's encoder last told of the plant, as far as the configuration asks for it."""
        if self.section.context == "none":
            return ""
        channels = self.first.model.alphabet.channels
        symbols = self.first.encoder.state.announced
        wanted = [
            symbol
            for channel, symbol in zip(channels, symbols, strict=False)
            if self.section.context == "symbols" or isinstance(channel, Switch)
        ]
        words = [symbol or "unknown" for symbol in wanted]
        return " ".join([*words, self.familiarity] if self.section.context == "familiarity" else words)

    def shares(self, context: str) -> Array:
        """(H, members) the weights in a context, the first model's first."""
        # The settings' horizons ascend, as those are that weights are passed on along.
        return np.array(weights_by_horizon([state.pool for state in self.evidence.values()], context))

    def follow(self, scan: Scan, measured: float | None) -> None:
        """Move all members on by a scan, and learn from its reading what the forecasts that were due are worth."""
        reading = float("nan") if measured is None else measured
        for member in self.members:
            self._track(member, scan)
            # Also of one that failed: forecasts that it made while it was well are still due.
            member.calibration = settle_bands(member.calibration, scan.time, reading)
        if self.trend is not None:
            self.trend.trend.take(scan.time, reading)
            self.trend.calibration = settle_bands(self.trend.calibration, scan.time, reading)
        self.joint = settle_bands(self.joint, scan.time, reading)
        for horizon, state in self.evidence.items():
            self.evidence[horizon] = settle_pool(state, horizon, scan.time, reading, self.tolerance)

    def _track(self, member: Member, scan: Scan) -> None:
        """Move a member on; one that failed rests for a while, then begins without a past: its state may be why."""
        if member.failure and scan.time - member.failed >= RETRY_SECONDS:
            former = member.predictor
            member.predictor, member.failure = Predictor(former.model, former.temperature, former.correct), ""
        if not member.failure:
            try:
                member.known = member.predictor.track(scan)
            except FAULTS as error:
                self._fail(member, scan.time, repr(error))

    def widen(self, own: Mapping[float, float]) -> dict[float, float]:
        """A member's factors times those of the mixture: its runs are widened by both, on the way to the limit too."""
        joint = factors(self.joint)
        return {horizon: factor * joint.get(horizon, 1.0) for horizon, factor in own.items()}

    def _fail(self, member: Member, now: float, reason: str) -> None:
        member.known, member.failure, member.failed = False, reason, now
        self.complaints.append((member.name, reason))

    def jobs(self) -> list[ForecastJob | TrendJob | None]:
        """What each member has to do for a forecast; None where its state is not known."""
        jobs: list[ForecastJob | TrendJob | None] = []
        for place, member in enumerate(self.members, start=1):
            belief = member.predictor.belief
            if not member.known or belief is None or not belief.seen:
                jobs.append(None)
                continue
            # The place, counted from 1, is part of the seed, or its errors would be like the first model's. Not from 0:
            # numpy's SeedSequence takes a 0 at the end for nothing, and the draws would be the first model's again.
            seed = (self.forecasts.seed, int(belief.time * 1000.0), place)
            widening, plain = self.widen(factors(member.calibration, integral=False)), place >= self.given
            tracker = member.predictor.tracker
            walk = walk_outlook(tracker, belief, self.forecasts.horizons) if plain else None
            jobs.append(
                ForecastJob(tracker, belief, widening, member.calibration, seed, plain)
                if walk is None
                else TrendJob(walk, widening, member.calibration)
            )
        if self.trend is not None:
            outlook, own = self.trend.trend.look_ahead(), self.trend.calibration
            widening = self.widen(factors(own, integral=False))
            jobs.append(None if outlook is None else TrendJob(outlook, widening, own))
        return jobs

    def take(self, mixed: MixedForecast, now: float) -> None:
        """Let finished forecasts wait for their readings."""
        followed: list[Member | LocalTrendMember] = [*self.members]
        if self.trend is not None:
            followed.append(self.trend)
        for member, outcome in zip(followed, mixed.members[1:], strict=True):
            if isinstance(outcome, str):
                if isinstance(member, Member):
                    self._fail(member, now, outcome)
            elif outcome is not None:
                member.calibration = issue_bands(member.calibration, thin_levels(outcome, FAN_LEVELS))
        published = factors(self.joint)
        joint = np.array([published[horizon] for horizon in mixed.mixed.horizons.tolist()])
        self.joint = issue_bands(self.joint, replace(thin_levels(mixed.mixed, FAN_LEVELS), factors=joint))
        forecasts = [entry if isinstance(entry, Forecast) else None for entry in mixed.members]
        for horizon, state in self.evidence.items():
            self.evidence[horizon] = issue_pool(state, horizon, mixed.context, forecasts)

    def plain(self) -> dict[str, Any]:
        """Members, their weights by horizon in the present context, and who has failed, as plain values."""
        context = self.context
        return {
            "members": self.names,
            "context": context,
            "weights": {f"{h:g}": row for h, row in zip(self.evidence, self.shares(context).tolist(), strict=True)},
            "evidence": {f"{h:g}": _evidence(state.pool) for h, state in self.evidence.items()},
            "held": {f"{h:g}": recent_coverage(self.joint, h) for h in self.evidence},
            "failures": {member.name: member.failure for member in self.members if member.failure},
        }

    def snapshot(self) -> dict[str, Any]:
        """Beliefs, bands and credits as JSON can carry them; forecasts that wait are not kept."""
        return {
            "hashes": self.hashes,
            "members": [member.predictor.snapshot() for member in self.members],
            "losses": {f"{h:g}": shallow_dict(state.pool) for h, state in self.evidence.items()},
        }

    def restore(self, saved: Mapping[str, Any], now: float) -> bool:
        """Go on from a snapshot of the same members under the same settings; says whether it did.

        Raises KeyError, TypeError or ValueError for what `snapshot` did not write.
        """
        if saved["hashes"] != self.hashes:
            return False
        for member, snapshot in zip(self.members, saved["members"], strict=True):
            if snapshot is not None:
                member.predictor.restore(snapshot, now)
        for horizon, state in self.evidence.items():
            # Former versions counted losses in degC, under another name: those cannot be gone on from.
            kept = saved.get("losses", {}).get(f"{horizon:g}")
            if kept is not None and self.trend is not None and kept["members"] == state.pool.members - 1:
                kept = _with_local_trend(kept, state.pool)
            if kept is not None and _settings(kept) == _settings(asdict(state.pool)):
                contexts = {name: _losses(losses) for name, losses in kept["contexts"].items()}
                overall = None if kept["overall"] is None else _losses(kept["overall"])
                self.evidence[horizon] = PoolEvidence(replace(state.pool, overall=overall, contexts=contexts))
        return True


def _interpolate_odds(odds: Mapping[float, float], horizon: float) -> float:
    """The odds at a horizon (s): linear between those known, constant outside, 1 without any."""
    known = sorted(odds)
    return float(np.interp(horizon, known, [odds[each] for each in known])) if known else 1.0


def _evidence(pool: Pool) -> float:
    return pool.overall.evidence if pool.overall is not None else 0.0


def _losses(saved: Mapping[str, Any]) -> Losses:
    return Losses(tuple(saved["total"]), saved["evidence"], saved.get("scale", 0.0))


def _with_local_trend(kept: Mapping[str, Any], pool: Pool) -> dict[str, Any]:
    """What a version without a local trend kept of a pool: it is taken to have lost what the others did on average."""

    def extend(losses: Mapping[str, Any] | None) -> dict[str, Any] | None:
        if losses is None:
            return None
        return {**losses, "total": [*losses["total"], float(np.mean(losses["total"]))]}

    contexts = {name: extend(losses) for name, losses in kept["contexts"].items()}
    same = {"members": pool.members, "prior": pool.prior, "fixed": pool.fixed}
    return {**kept, **same, "overall": extend(kept["overall"]), "contexts": contexts}


def _settings(pool: Mapping[str, Any]) -> list[Any]:
    """What must be equal for credits to mean the same; JSON has turned tuples into lists."""
    plain = [pool[key] for key in ("members", "half_life", "floor", "strength")]
    return plain + [pool[key] and list(pool[key]) for key in ("prior", "fixed")]
