"""Two semantics of the same automaton: the temperature carried over an event, or drawn anew at each one (the thesis).

Under "resampled", the thesis' semantics, a location begins with X ~ N(mu, sigma), whatever the temperature was before;
under "carried" X goes on where it was, and what is drawn is the mode parameter of the stay. Each model gets its
counterpart with the same locations, edges and flows, so that both can be run on the same traces and compared.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Literal

import numpy as np

from sim.effects import in_sensor_scale
from sim.engine import readings, schedule
from sim.sha import (
    FIXED_PARAMETER,
    RELAXING_FLOWS,
    SHA,
    Array,
    Chain,
    Distribution,
    Flow,
    Location,
    Model,
    Trace,
    compile_chain,
    distributions,
    draw_paths,
    encode_trace,
    flows,
    input_moments,
    mode_parameter,
)

Semantics = Literal["carried", "resampled"]
CARRIED: Semantics = "carried"
RESAMPLED: Semantics = "resampled"

RUNS, SPAN = 200, 3600.0
"""Semi-Markov runs from each location, and the seconds that each lasts, where no trace gives the entry laws."""
ENTRY_TOLERANCE_S = 1e-3
"""Seconds that a summed-up entry time may lie before its own row of the trace."""
STILL_FLOW = Flow("constant", {"noise": 0.0})


@dataclass(frozen=True, slots=True)
class EntryLaws:
    """The temperatures (degC) at which each location was entered, by its name, and in words where they come from."""

    temperatures: Mapping[str, Array]
    source: str

    @property
    def all_temperatures(self) -> Array:
        """(n,) all of them."""
        return np.concatenate([np.empty(0), *self.temperatures.values()])


def side_by_side(model: Model, training: Sequence[Trace] | None, *, seed: int = 0) -> Mapping[str, Model]:
    """The model under both semantics: "carried" over events, or "resampled", drawn on entry.

    The one that `model` has is `model` itself. `training` gives the entry laws of a resampled counterpart (best the
    traces that the model was learned from); without it they come from semi-Markov runs of the model itself, drawn by
    `seed`.
    Raises ValueError where neither can give any.
    """
    if model_semantics(model) == RESAMPLED:
        return {CARRIED: carry_temperature(model), RESAMPLED: model}
    entries = entries_of_traces(model, training) if training is not None else entries_of_runs(model, seed)
    return {CARRIED: model, RESAMPLED: resample_temperature(model, entries)}


def model_semantics(model: Model) -> Semantics:
    """ "resampled" as soon as one location draws the temperature on entry."""
    return RESAMPLED if any(location.entry == "resample" for location in model.sha.locations) else CARRIED


def carry_temperature(model: Model) -> Model:
    """The counterpart of a model that draws X on entry: X goes on, under the same flows.

    Where the flow moves towards the law's temperature, that law becomes the target's, drawn once a stay. Elsewhere the
    law said nothing but where X begins and is left out: under a flow that stands still X then never moves.
    """
    model = in_sensor_scale(model)
    locations = []
    for location in model.sha.locations:
        if location.entry == "resample":
            target = location.flow.kind in RELAXING_FLOWS and FIXED_PARAMETER not in location.flow.params
            law = location.distribution if target else None
            location = replace(location, distribution=law, entry="parameter" if target else "none")
        locations.append(location)
    return _counterpart(model, tuple(locations), "carried: temperature carried over events", "the flows of the model")


def resample_temperature(model: Model, entries: EntryLaws) -> Model:
    """The counterpart of a model that carries X: X ~ N(mu, sigma) on entry, under the same flows at their mean m.

    A location's law is that of its own entries. Its sigma counts the scatter of all entries as one entry more, so that
    a single entry makes no certainty; a location that was never entered takes the law of all entries, unless the model
    knows nothing of it either. Raises ValueError when there is no entry at all.
    """
    model, pooled = in_sensor_scale(model), entries.all_temperatures
    if not pooled.size:
        raise ValueError(
            f"model {model.sha.name!r}: no location is entered in {entries.source}, so there is no law of the "
            "temperature on entry; give traces in which events happen while the temperature is read"
        )
    spread = float(np.std(pooled))
    locations = []
    for location in model.sha.locations:
        own = entries.temperatures.get(location.name, np.empty(0))
        if not own.size and location.distribution is None and location.flow.kind == "constant":
            locations.append(location)
            continue
        values = own if own.size else pooled
        deviations = float(np.sum((values - values.mean()) ** 2))
        # One entry more at the scatter of all: with a single entry of its own the deviations alone would be 0.
        sigma = sqrt((deviations + spread**2) / values.size) if own.size else spread
        law = Distribution("normal", {"mu": float(values.mean()), "sigma": sigma})
        # The location has room for one law, now the temperature's: m stays at its mean.
        fixed = {**location.flow.params, FIXED_PARAMETER: mode_parameter(location)[0]}
        locations.append(Location(location.name, replace(location.flow, params=fixed), law, "resample"))
    return _counterpart(model, tuple(locations), "resampled: temperature drawn on entry", entries.source)


def _counterpart(model: Model, locations: tuple[Location, ...], semantics: str, laws: str) -> Model:
    """The model with other locations, without what was measured with the old ones (scores, calibration)."""
    settings = {**model.provenance.settings, "semantics": semantics, "entry_laws": laws}
    provenance = replace(model.provenance, settings=settings, scores={})
    return replace(model, sha=replace(model.sha, locations=locations), calibration={}, provenance=provenance)


def entries_of_traces(model: Model, traces: Sequence[Trace]) -> EntryLaws:
    """The readings held at each entry along `traces`, encoded by the model's alphabet.

    An event without an edge leads where its symbol does most often (`resync`). Where a trace begins nothing is entered:
    X is given there. A trace without a reading of the model's temperature gives nothing.
    """
    # The same locations and edges without flows, so that walking through them needs no input signal.
    still = tuple(Location(location.name, STILL_FLOW, None, "none") for location in model.sha.locations)
    structure = replace(model.sha, locations=still)
    temperatures: dict[str, list[float]] = defaultdict(list)
    for trace in traces:
        if not np.isfinite(trace.signals.get(model.temperature, np.empty(0))).any():
            continue
        times, values = readings(trace, model.temperature)
        events = encode_trace(trace, model.alphabet).events
        steps = schedule(structure, events, times, policy="resync")
        begins = steps.start + np.concatenate([[0.0], np.cumsum(steps.dt[:-1])])
        # Not the first: there the trace begins, and no location was entered.
        entered = np.flatnonzero(steps.entry)[1:]
        # Entry times are sums of steps: one that falls on a row may come out a hair before it, and would then be given
        # the reading of the row before.
        held = np.searchsorted(times, begins[entered] + ENTRY_TOLERANCE_S, side="right") - 1
        for step, row in zip(entered.tolist(), held.tolist(), strict=True):
            temperatures[still[steps.location[step]].name].append(float(values[row]))
    count = sum(map(len, temperatures.values()))
    columns = {name: np.array(entries) for name, entries in temperatures.items()}
    return EntryLaws(columns, f"{count} entries along {len(traces)} traces")


def entries_of_runs(model: Model, seed: int) -> EntryLaws:
    """What the model itself expects: semi-Markov runs over an hour from each location, begun by its initial law.

    Raises ValueError for a model without sojourn laws or without an initial law.
    """
    if model.initial is None or not model.semi_markov:
        lacking = "law of the first temperature" if model.initial is None else "law of its stays"
        raise ValueError(
            f"model {model.sha.name!r} has no {lacking}, so it cannot say at which temperatures its locations are "
            "entered; give the traces that it was learned from"
        )
    initial, model = model.initial, in_sensor_scale(model)
    chain, offsets = compile_chain(model), input_moments(model, {})[:, 0]
    rng = np.random.default_rng(seed)
    entered: dict[int, list[Array]] = defaultdict(list)
    for place, law in enumerate(chain.laws):
        if law is None:
            continue
        x0 = distributions.draw(initial, RUNS, rng)
        for location, temperatures in _iterate_stays(model.sha, chain, start=place, x0=x0, offsets=offsets, rng=rng):
            entered[location].append(temperatures)
    columns = {chain.names[place]: np.concatenate(parts) for place, parts in entered.items()}
    return EntryLaws(columns, f"semi-Markov runs of the model itself, {RUNS} from each location over {SPAN:g} s")


def _iterate_stays(
    sha: SHA, chain: Chain, *, start: int, x0: Array, offsets: Array, rng: np.random.Generator
) -> Iterator[tuple[int, Array]]:
    """(location, the temperatures of the runs that enter it), stay by stay, from the temperatures `x0` in `start`."""
    x = x0.copy()
    paths = draw_paths(chain, start, age=0.0, horizon=SPAN, runs=RUNS, rng=rng)
    ends = np.minimum(np.vstack([paths.entered[1:], np.full((1, RUNS), np.inf)]), SPAN)
    for stay, (places, begin, end) in enumerate(zip(paths.location, paths.entered, ends, strict=True)):
        # Beyond the horizon a path's entries are infinite: those runs have no such stay.
        for place in np.unique(places[np.isfinite(begin)]).tolist():
            runs = np.flatnonzero((places == place) & np.isfinite(begin))
            if stay:  # the first stay is where the runs were put, not where they went
                yield place, x[runs]
            location, age, dt = sha.locations[place], np.zeros(runs.size), end[runs] - begin[runs]
            mean, variance = mode_parameter(location)
            # One step for the whole stay: the flow's closed form is as exact for an hour as for a second.
            target = mean + offsets[place] + sqrt(variance) * rng.standard_normal(runs.size)
            after = flows.mean_step(location.flow, x[runs], target, age=age, dt=dt, max_rate=sha.max_rate)
            noise = np.sqrt(flows.coefficients(location.flow, age, dt)[2]) * rng.standard_normal(runs.size)
            x[runs] = np.clip(after + noise, sha.low, sha.high)
