"""From a fit to a model: the augmented automaton is an ordinary one, effects beside its flows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.effects import of_feature
from sim.lab.discrepancy.fitting import Fitted, automaton_effects
from sim.lab.learning import RATE_PARAMETERS, with_inputs
from sim.sha import Distribution, Flow, Input, Location, Model, Provenance, Trace, content_hash, distributions

EVERYWHERE_REST_SHARE = 2 / 3
"""The share of a rough heat that acts at rest from which on it counts as heat of all locations: it is then stated at
most half as wide again there, and the model keeps its memory. A half is what is believed before the data."""


def augment_model(
    fitted: Fitted,
    *,
    name: str = "",
    data_hash: str = "",
    traces: Sequence[str] = (),
    readings: Sequence[Trace] = (),
) -> Model:
    """The fit as a model: its parameters in the flows, its effects in the automaton, its noise, and its lineage.

    The forecast bands' calibration is not carried over: it belonged to the model before. What is random in the model
    stays so, heat with a memory as the fit found it; where there was none, the fit's is in the noise of the flows, and
    so is what of it acts only while the machine runs (`kept_share`).
    `readings` are encoded traces from which the stays learn what the effects' signals are like; without them a forecast
    holds the last readings, and verification must be told their ranges.
    """
    model = fitted.frame.record.model
    sha = replace(
        model.sha,
        locations=tuple(_fit_location(fitted, location, place) for place, location in enumerate(model.sha.locations)),
        name=name or model.sha.name,
        effects=(
            *(effect for named in fitted.state.named for effect in automaton_effects(named, model)),
            *(
                replace(heat, params={"sigma": kept_share(fitted) * fitted.noise.rough, "memory": fitted.noise.memory})
                for heat in of_feature(model.sha, "disturbance")
            ),
            *of_feature(model.sha, "machine offset"),
        ),
    )
    strengths = {f"{named.entry.name}.{named.entry.strength}": named.strength for named in fitted.state.named}
    new = replace(
        model,
        sha=sha,
        sensor_sigma=float(np.hypot(fitted.sensor_sigma, fitted.noise.lasting)),
        sensor_memory=sensor_memory(fitted),
        calibration={},
        provenance=Provenance(
            method="diagnose",
            data_hash=data_hash,
            traces=tuple(traces),
            contents=tuple(sorted({*model.provenance.contents, *(content_hash(trace) for trace in readings)})),
            synthetic=model.provenance.synthetic,
            settings={"effects": ", ".join(named.entry.name for named in fitted.state.named)},
            scores={"log_likelihood": fitted.likelihood, **strengths},
            parent=model.provenance.data_hash or model.sha.name,
        ),
    )
    return with_inputs(new, readings) if readings else new


def _fit_location(fitted: Fitted, location: Location, place: int) -> Location:
    """The location, the model's `place`-th, with the fit's parameters; as it was where the traces never came."""
    shape, flow = fitted.frame.shape, location.flow
    if shape.kinds[place] != flow.kind or shape.target[place] < 0:
        return location
    params = dict(flow.params)
    if shape.rate[place] >= 0:
        params[RATE_PARAMETERS[flow.kind]] = float(np.exp(fitted.state.log_rates[shape.rate[place]]))
    if "noise" in params:
        params["noise"] = location_noise(fitted, place, params.get("k", 0.0))
    columns = [column for column in shape.gain[place] if column >= 0]
    inputs = tuple(
        Input(driver.signal, float(fitted.state.linear[column]), driver.reference)
        for driver, column in zip(flow.inputs, columns, strict=True)
    )
    mean = float(fitted.state.linear[shape.target[place]])
    law = location.distribution
    sigma = float(np.sqrt(distributions.variance(law))) if law is not None else 0.0
    return replace(
        location,
        flow=Flow(flow.kind, params, inputs),
        distribution=Distribution("normal", {"mu": mean, "sigma": sigma}),
    )


def sensor_memory(fitted: Fitted) -> float:
    """s: the model's own, or that of the error of the reading that lasts, where this is the greater part of it."""
    noise = fitted.noise
    return noise.fades if noise.lasting > fitted.sensor_sigma else fitted.frame.record.model.sensor_memory


def location_noise(fitted: Fitted, place: int, k: float) -> float:
    """degC/sqrt(s): the process noise of the model's `place`-th location, and what of the rough heat acts there and is
    not kept as heat with a memory."""
    record, noise = fitted.frame.record, fitted.noise
    seconds = np.where((record.runs.place == place) & ~record.runs.first, record.runs.dt, 0.0)
    running = float(record.running @ seconds / seconds.sum()) if seconds.sum() > 0 else 1.0
    process = noise.process * np.sqrt(running + (1.0 - running) * noise.still**2)
    acting = noise.rest + (1.0 - noise.rest) * running
    left = np.sqrt(max(acting**2 - kept_share(fitted) ** 2, 0.0))
    return float(np.hypot(process, left * as_white(noise.rough, noise.memory, k)))


def kept_share(fitted: Fitted) -> float:
    """The share of the rough heat that stays heat with a memory, which an automaton has in all locations alike.

    All of it where it acts at rest too, 0 where the model has no such heat; what is left is in the noise of the flows.
    """
    if not of_feature(fitted.frame.record.model.sha, "disturbance"):
        return 0.0
    return 1.0 if fitted.noise.rest >= EVERYWHERE_REST_SHARE else fitted.noise.rest


def as_white(sigma: float, memory: float, k: float) -> float:
    """degC/sqrt(s): white noise for heat of `sigma` (degC/s) with a `memory` (s), under the plant's rate `k` (1/s)."""
    # Slowly seen, an Ornstein-Uhlenbeck heat of memory M is white noise of intensity sigma sqrt(2 M). The longer M is
    # beside the plant's own time constant 1/k, the less of it the relaxation turns into scatter.
    return float(sigma * np.sqrt(2.0 * memory) / (1.0 + k * memory))
