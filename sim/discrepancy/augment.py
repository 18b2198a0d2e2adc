"""From a fit to a model: the augmented automaton is an ordinary one, effects beside its flows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.discrepancy.fitting import Fitted, effects_of
from sim.learning import RATES, with_inputs
from sim.sha import SHA, Distribution, Flow, Input, Location, Model, Provenance, Trace, distributions


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
