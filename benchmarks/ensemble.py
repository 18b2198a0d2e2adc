"""Do several models together forecast better than one? Held-out CRPS and coverage of the 90 % band, by horizon.

Every model follows the same held-out trace and forecasts from the same moments; each has its own bands, which learn
online as in the gateway. Scored are the models alone, equal weights, 0.7 and 0.3 (the thesis's), weights from evidence,
and weights from evidence with a context of their own (running or stopped; the alphabet's symbols).

Synthetic production: two models, of a machine in order and of one with worn bearings (more friction), and a trace of
both states, the change in its middle. With measured data beside the project (../shared/data): SKAB (two models of
different stretches, forecast over the rest) and FEMTO (a model of another bearing, and one of this bearing's start).
These are development figures of one trace each, with the block-bootstrap interval of the difference to the best single
model: where it holds 0, they tell nothing apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, nan
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from sim.engine.belief import Belief, observe, on_event, start, with_inputs
from sim.engine.tracker import Tracker, compile_model
from sim.forecast.calibration import Calibration, calibrate, factors
from sim.forecast.calibration import issue as issue_bands
from sim.forecast.calibration import settle as settle_bands
from sim.forecast.ensemble import (
    DENSE_LEVELS,
    Pool,
    PoolEvidence,
    issue_pool,
    mixture,
    settle_pool,
    thin_levels,
    weights,
)
from sim.forecast.fan import FAN_LEVELS, Forecast, forecast
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.learning.outcomes import clean_readings
from sim.plant.decanter import DecanterPlant
from sim.plant.scenarios import production
from sim.scores import block_bootstrap, coverage, crps_quantiles
from sim.sha.events import Alphabet, Switch, encode
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Array, Event, Trace

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
WORN = replace(
    DecanterPlant(), heat_per_ampere=1.5 * DecanterPlant().heat_per_ampere, idle_heat=1.5 * DecanterPlant().idle_heat
)


@dataclass(frozen=True, slots=True)
class Case:
    """Two models, a trace that neither was learned from, and the horizons (s); forecasts are made every `every` s."""

    name: str
    models: tuple[Model, Model]
    trace: Trace
    horizons: tuple[float, ...]
    every: float


@dataclass(slots=True)
class Follower:
    """One model on its way along the trace."""

    tracker: Tracker
    belief: Belief
    bands: Calibration


@dataclass(slots=True)
class Scheme:
    """A way to weigh the models: its pools by horizon, what a context is, and the fans that it has given."""

    name: str
    context: str
    evidence: dict[float, PoolEvidence]
    fans: list[Array] = field(default_factory=list)


def schemes(horizons: Sequence[float]) -> list[Scheme]:
    """All that are compared; the models alone come first."""
    fixed = {"model 1 alone": (1.0, 0.0), "model 2 alone": (0.0, 1.0), "equal": (0.5, 0.5), "0.7/0.3": (0.7, 0.3)}
    found = [
        Scheme(name, "none", {h: PoolEvidence(Pool(2, fixed=shares)) for h in horizons})
        for name, shares in fixed.items()
    ]
    for context in ("none", "running", "symbols"):
        name = "evidence" if context == "none" else f"evidence by {context}"
        found.append(Scheme(name, context, {h: PoolEvidence(Pool(2)) for h in horizons}))
    return found


def contexts(alphabet: Alphabet, last: Mapping[int, str]) -> dict[str, str]:
    """The context of each kind, from the symbol last told by each channel."""
    channels = alphabet.channels
    running = [last.get(n, "?") for n, channel in enumerate(channels) if isinstance(channel, Switch)]
    return {
        "none": "",
        "running": " ".join(running),
        "symbols": " ".join(last.get(n, "?") for n in range(len(channels))),
    }


def follow(case: Case, runs: int, seed: int) -> tuple[list[Scheme], Array]:
    """Every scheme's fans (forecasts, levels, horizons), and the outcomes (forecasts, horizons)."""
    trace, name = case.trace, case.models[0].temperature
    alphabet = case.models[0].alphabet
    owner = {symbol: n for n, channel in enumerate(alphabet.channels) for symbol in _symbols(channel)}
    ways, outcomes = schemes(case.horizons), list[list[float]]()
    followers = [_begin(model, trace, case.horizons) for model in case.models]
    inputs = set[str]().union(*(one.tracker.inputs for one in followers)) & trace.signals.keys()
    events, upcoming, last = [*trace.events, Event(inf, UNKNOWN)], 0, dict[int, str]()
    due = float(trace.times[0]) + case.every
    readings = trace.signals[name]
    known = clean_readings(trace.times, trace.signals[name], case.models[0].alphabet.gap)
    for row, (time, value) in enumerate(zip(trace.times.tolist(), readings.tolist(), strict=True)):
        while events[upcoming].time <= time:
            event, upcoming = events[upcoming], upcoming + 1
            last = {} if event.symbol == UNKNOWN else {**last, owner[event.symbol]: event.symbol}
            for one in followers:
                one.belief = on_event(one.tracker, one.belief, event)
        held = {signal: float(trace.signals[signal][row]) for signal in inputs}
        for one in followers:
            one.belief = observe(one.tracker, with_inputs(one.tracker, one.belief, time, held), time, value)
            one.bands = settle_bands(one.bands, time, value)
        for way in ways:
            for horizon, kept in way.evidence.items():
                way.evidence[horizon] = settle_pool(kept, horizon, time, value, case.every / 2)
        if time >= due and all(one.belief.seen for one in followers):
            due = time + case.every
            outcome = [nan if (at := known.interpolate(time + horizon)) is None else at for horizon in case.horizons]
            made = [_made(one, case.horizons, runs, (seed, row, n)) for n, one in enumerate(followers)]
            _mix(ways, made, contexts(alphabet, last))
            outcomes.append(outcome)
    return ways, np.array(outcomes)


def _symbols(channel: object) -> tuple[str, ...]:
    return (channel.rising, channel.falling) if isinstance(channel, Switch) else tuple(getattr(channel, "symbols", ()))


def _begin(model: Model, trace: Trace, horizons: Sequence[float]) -> Follower:
    tracker = compile_model(model)
    own = model.calibration or {1.0: 1.0}
    prior = {h: float(np.interp(h, sorted(own), [own[key] for key in sorted(own)])) for h in horizons}
    first = min([float(trace.times[0]), *(event.time for event in trace.events[:1])])
    return Follower(tracker, start(tracker, first), calibrate(prior, tolerance=30.0))


def _made(one: Follower, horizons: Sequence[float], runs: int, seed: tuple[int, ...]) -> Forecast:
    rng = np.random.default_rng(seed)
    found = forecast(
        one.tracker, one.belief, horizons, rng, runs=runs, calibration=factors(one.bands), levels=DENSE_LEVELS
    )
    one.bands = issue_bands(one.bands, thin_levels(found, FAN_LEVELS))
    return found


def _mix(ways: Sequence[Scheme], made: Sequence[Forecast], context: Mapping[str, str]) -> None:
    for way in ways:
        here = context[way.context]
        shares = [weights(kept.pool, here) for kept in way.evidence.values()]
        way.fans.append(mixture(made, shares, FAN_LEVELS).quantiles)
        for horizon, kept in way.evidence.items():
            way.evidence[horizon] = issue_pool(kept, horizon, here, made)


def figures(case: Case, runs: int, seed: int) -> list[Figure]:
    """CRPS and coverage of each way at each horizon, against the better of the two models alone."""
    ways, outcomes = follow(case, runs, seed)
    rng, found = np.random.default_rng(seed), list[Figure]()
    for column, horizon in enumerate(case.horizons):
        there = np.isfinite(outcomes[:, column])
        outcome = outcomes[there, column]
        fans = {way.name: np.array(way.fans)[there][:, :, column] for way in ways}
        scores = {name: crps_quantiles(FAN_LEVELS, fan, outcome) for name, fan in fans.items()}
        best = min(("model 1 alone", "model 2 alone"), key=lambda name: float(scores[name].mean()))
        for name, score in scores.items():
            block = max(round(horizon / case.every), 1) * 4
            low, high = block_bootstrap(score - scores[best], block, 500, rng)
            told = f"{case.name}, {horizon:g} s, {name}"
            apart = "" if name == best else f" (difference {low:+.3f} to {high:+.3f})"
            against = f"best single: {best}{apart}"
            found.append(Figure(f"{told}: CRPS", float(score.mean()), "degC", against, float(scores[best].mean())))
            held = coverage(fans[name][:, 0], fans[name][:, -1], outcome)
            found.append(Figure(f"{told}: coverage", held, "", "nominal", 0.9))
    return found


def synthetic(days: int) -> Case:
    """Production of a machine in order, and then of the same with worn bearings."""
    from sim.sha.events import DECANTER

    name = "TCuscinettiRiduttore"

    def made(seed: int, plant: DecanterPlant, length: int) -> Trace:
        return production(length, seed=seed, plant=plant, period=10.0, name=f"seed {seed}")

    models = [
        learn_bins([made(11 + n, plant, 2)], DECANTER, name, seed=0, name=f"model {n + 1}").model
        for n, plant in enumerate((DecanterPlant(), WORN))
    ]
    before, after = made(21, DecanterPlant(), days), made(22, WORN, days)
    shift = float(before.times[-1] - after.times[0]) + 10.0
    times = np.concatenate([before.times, after.times + shift])
    signals = {key: np.concatenate([column, after.signals[key]]) for key, column in before.signals.items()}
    trace = Trace("in order, then worn", times, signals, synthetic=True)
    trace = replace(trace, events=encode(trace, DECANTER))
    return Case("production with a change", (models[0], models[1]), trace, (300.0, 900.0), 300.0)


def measured() -> list[Case]:
    """What of SKAB and FEMTO is there."""
    from sim.lab.recordings.column_map import load_map
    from sim.lab.recordings.traces import load_traces

    def loaded(file: Path, column_map: str) -> tuple[Trace, Alphabet, str]:
        rules = load_map(ROOT / "config" / "traces" / f"{column_map}.toml")
        traces, _ = load_traces(str(file), rules)
        return max(traces, key=lambda one: one.times.size), rules.alphabet, rules.temperature

    cases = []
    skab, femto = DATA / "skab" / "anomaly-free.csv", DATA / "femto_bearing"
    if skab.is_file():
        trace, alphabet, name = loaded(skab, "skab")
        first, second, rest = (_part(trace, *ends) for ends in ((0.0, 0.3), (0.3, 0.6), (0.6, 1.0)))
        models = [learn_bins([part], alphabet, name, seed=0).model for part in (first, second)]
        cases.append(Case("SKAB", (models[0], models[1]), rest, (60.0, 300.0), 15.0))
    if femto.is_dir():
        (other, alphabet, name), (trace, _, _) = (
            loaded(femto / f"Bearing2_{number}_temp.csv", "femto") for number in (4, 5)
        )
        parts = (other, _part(trace, 0.0, 0.4))
        models = [learn_bins([part], alphabet, name, seed=0).model for part in parts]
        cases.append(Case("FEMTO", (models[0], models[1]), _part(trace, 0.4, 1.0), (60.0, 300.0), 30.0))
    return cases


def _part(trace: Trace, begin: float, end: float) -> Trace:
    """A stretch by shares of the trace's time, with what was known at its beginning told again."""
    first, span = float(trace.times[0]), float(trace.times[-1] - trace.times[0])
    stretch = trace.between(first + begin * span, first + end * span)
    earlier = [replace(event, time=float(stretch.times[0])) for event in trace.events if event.time < stretch.times[0]]
    return replace(stretch, events=(*earlier, *stretch.events))


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="One day of each state, and no measured data.")
@click.option("--seed", default=1, show_default=True, help="Seed of the forecasts.")
def main(as_json: bool, quick: bool, seed: int) -> None:
    cases = [synthetic(1 if quick else 2), *([] if quick else measured())]
    found = [figure for case in cases for figure in figures(case, 100 if quick else 300, seed)]
    give("ensemble, held out", found, as_json=as_json)


if __name__ == "__main__":
    main()
