"""From named effects to a model and back: the augmented automaton is an ordinary one, effects beside its flows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.discrepancy.catalogue import CATALOGUE
from sim.discrepancy.fitting.course import Named
from sim.discrepancy.fitting.fit import Fitted
from sim.discrepancy.fitting.forms import BLURRED
from sim.effects.kinds import EFFECTS
from sim.learning.free_run import RATES
from sim.learning.runs import first_switch
from sim.learning.semi_markov import with_inputs
from sim.learning.structure import contexts
from sim.sha import distributions
from sim.sha.automaton import SHA, Distribution, Effect, Flow, Input, Location
from sim.sha.model import Model, Provenance
from sim.sha.trace import Trace

RUNNING_ONLY = (
    "current-heating",
    "quadratic-current-heating",
    "current-saturation",
    "torque-friction",
    "speed-friction",
    "vibration-friction",
    "startup-churning",
    "wear-drift",
)
"""Effects that heat only while the machine runs."""


def augmented(
    fitted: Fitted,
    *,
    name: str = "",
    data_hash: str = "",
    traces: Sequence[str] = (),
    readings: Sequence[Trace] = (),
) -> Model:
    """The fit as a model: its parameters in the flows, its effects in the automaton, its noise, and its lineage.

    The forecast bands' calibration is not carried over: it belonged to the model before. Each location's own scatter is
    that of the cycles in the fit. `readings` are encoded traces from which the stays learn what the effects' signals
    are like; without them a forecast holds the last readings, and verification must be told their ranges.
    """
    model = fitted.frame.record.model
    sha = replace(
        _with_parameters(fitted),
        name=name or model.sha.name,
        effects=tuple(effect for one in fitted.state.named for effect in effects_of(one, model)),
    )
    strengths = {f"{one.entry.name}.{one.entry.strength}": one.strength for one in fitted.state.named}
    new = replace(
        model,
        sha=sha,
        sensor_sigma=fitted.sensor_sigma,
        calibration={},
        provenance=Provenance(
            method="diagnose",
            data_hash=data_hash,
            traces=tuple(traces),
            synthetic=model.provenance.synthetic,
            settings={"effects": ", ".join(one.entry.name for one in fitted.state.named)},
            scores={"log_likelihood": fitted.likelihood, **strengths},
            parent=model.provenance.data_hash or model.sha.name,
        ),
    )
    return with_inputs(new, readings) if readings else new


def effects_of(named: Named, model: Model) -> tuple[Effect, ...]:
    """A named effect as the automaton takes it; the blur of a dead time is a lag of the sensor there."""
    blur = named.params.get("blur", 0.0) * named.strength
    lag = (Effect("sensor-lag", {"tau": blur, "order": float(BLURRED)}),) if blur > 0 else ()
    return effect_of(named, model), *lag


def effect_of(named: Named, model: Model) -> Effect:
    """The effect that bears a named one's name."""
    kind = EFFECTS[named.entry.name]
    params = {key: value for key, value in named.params.items() if key in kind.params}
    switch = first_switch(model.alphabet)
    where: tuple[str, ...] = ()
    if not kind.everywhere:
        names = tuple(location.name for location in model.sha.locations)
        where = _where_known(model, running_locations(model) if named.entry.name in RUNNING_ONLY else names)
    return Effect(
        named.entry.name,
        params,
        {} if named.params.get("walls") else dict(named.signals),
        locations=where if len(where) < len(model.sha.locations) else (),
        event=switch.rising if kind.event and switch is not None else "",
    )


def named_of(model: Model) -> tuple[Named, ...]:
    """The effects that a model has already, as the catalogue speaks of them."""
    entries = {entry.name: entry for entry in CATALOGUE}
    found = []
    for effect in model.sha.effects:
        entry = entries[effect.kind]
        extra = (
            {"power": 2.0 if effect.kind.startswith("quadratic") else 1.0} if "current-heating" in effect.kind else {}
        )
        found.append(Named(entry, dict(effect.signals), {**EFFECTS[effect.kind].defaults, **extra, **effect.params}))
    return tuple(found)


def _where_known(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    """Those whose flow says how the temperature moves: a constant one holds what is not known and adds up a heat."""
    flows = model.sha.by_name
    return tuple(name for name in names if flows[name].flow.kind != "constant") or tuple(names)


def running_locations(model: Model) -> tuple[str, ...]:
    """The locations in which the machine runs: all without a switch, or where the names are not the alphabet's."""
    switch = first_switch(model.alphabet)
    if switch is None:
        return tuple(location.name for location in model.sha.locations)
    place = model.alphabet.channels.index(switch)
    known = contexts(model.alphabet)
    running = [one.name for one in model.sha.locations if known.get(one.name, ())[place : place + 1] == (1,)]
    if running:
        return tuple(running)
    return tuple(sorted(_reached_running(model, switch.rising, switch.falling)))


def _reached_running(model: Model, rising: str, falling: str) -> set[str]:
    """Locations entered by `rising`, or from those by anything but `falling`."""
    found = {edge.target for edge in model.sha.edges if edge.symbol == rising}
    while True:
        more = {e.target for e in model.sha.edges if e.source in found and e.symbol not in (falling, "UNKNOWN")} - found
        if not more:
            return found
        found |= more


def _with_parameters(fitted: Fitted) -> SHA:
    frame = fitted.frame
    sha = frame.record.model.sha
    return replace(
        sha, locations=tuple(_fitted(fitted, location, place) for place, location in enumerate(sha.locations))
    )


def _fitted(fitted: Fitted, location: Location, place: int) -> Location:
    shape, flow = fitted.frame.shape, location.flow
    if shape.kinds[place] != flow.kind or shape.target[place] < 0:
        return location
    params = dict(flow.params)
    if shape.rate[place] >= 0:
        params[RATES[flow.kind]] = float(np.exp(fitted.state.log_rates[shape.rate[place]]))
    if "noise" in params:
        params["noise"] = process_noise(fitted, params.get("k", 0.0))
    columns = [column for column in shape.gain[place] if column >= 0]
    inputs = tuple(
        Input(given.signal, float(fitted.state.linear[column]), given.reference)
        for given, column in zip(flow.inputs, columns, strict=True)
    )
    mean = float(fitted.state.linear[shape.target[place]])
    law = location.distribution
    sigma = float(np.sqrt(distributions.variance(law))) if law is not None else 0.0
    return replace(
        location,
        flow=Flow(flow.kind, params, inputs),
        distribution=Distribution("normal", {"mu": mean, "sigma": sigma}),
    )


def process_noise(fitted: Fitted, k: float) -> float:
    """degC/sqrt(s): the fit's process noise, and the rough heat as what it amounts to over its memory."""
    noise = fitted.noise
    heat = noise.rough * np.sqrt(2.0 * noise.memory) / (1.0 + k * noise.memory)
    return float(np.hypot(noise.process, heat))
