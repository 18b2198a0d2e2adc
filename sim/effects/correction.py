"""The calibration correction T' = k T + b: a model written in the scale of the sensor that it is compared with.

T is the automaton's temperature, T' what the sensor reads. Every flow is affine in T and in the mode parameter m, so
the corrected model is again a model, with every temperature mapped by k T + b and every difference, rate, gain and
noise multiplied by k; so are the effects' heats and the temperatures in them. All that runs a model (`schedule`,
`compile_model`, and with them simulation, open loop, belief and forecast) takes this form of it, so start temperatures,
readings, limits and quantiles are all of T', and the sensor's noise, which is measured in T', stays as it is. The
automaton's range becomes [k low + b, k high + b].
"""

from collections.abc import Mapping
from dataclasses import replace
from math import log
from typing import Any

from sim.effects.kinds import effect_kind
from sim.sha import FIXED_PARAMETER, RELAXING_FLOWS, SHA, Correction, Distribution, Effect, Flow, Input, Location, Model


def in_sensor_scale(model: Model) -> Model:
    """The model with its correction worked into the automaton: it speaks of T' and has no correction left.

    An identity gives the very same model. Raises ValueError, naming the location, where an offset meets a law that
    cannot be shifted: only normal ones can.
    """
    correction = model.correction
    if correction.identity:
        return model
    sha = model.sha
    scaled = SHA(
        sha.name,
        tuple(_location(sha, location, correction) for location in sha.locations),
        sha.edges,
        sha.initial,
        max_rate=correction.gain * sha.max_rate,
        low=apply_correction(correction, sha.low),
        high=apply_correction(correction, sha.high),
        effects=tuple(_effect(effect, correction) for effect in sha.effects),
    )
    return replace(model, sha=scaled, correction=Correction())


def apply_correction(correction: Correction, temperature: float) -> float:
    """What the sensor reads (degC) when the automaton is at `temperature`."""
    return correction.gain * temperature + correction.offset


def of_machine(model: Model, name: str) -> Model:
    """The model of one machine of the type: its targets are its own, and as sure as they are known.

    A machine that the type's training did not see is the type itself, whose offset between machines is its uncertainty.
    Raises ValueError for a machine that the model does not know, and where targets have laws that cannot be shifted.
    """
    if name not in model.machines:
        known = ", ".join(model.machines) or "none"
        raise ValueError(f"the model knows no machine {name!r}; it knows {known}")
    own, sha, type_wide = model.machines[name], model.sha, model.correction
    locations = with_targets(sha, own.targets).locations
    # Drawn once for each machine: of a known one only the error of what was learned is left to be drawn.
    effects = tuple(
        replace(effect, params={**effect.params, "sigma": own.targets_error})
        if effect.kind == "machine-offset"
        else effect
        for effect in sha.effects
    )
    return replace(
        model,
        sha=replace(
            sha,
            locations=locations,
            effects=effects,
            low=sha.low + min(own.targets, 0.0),
            high=sha.high + max(own.targets, 0.0),
        ),
        correction=Correction(own.gain * type_wide.gain, own.gain * type_wide.offset + own.offset),
        provenance=replace(model.provenance, settings={**model.provenance.settings, "machine": name}),
        machines={},
    )


def with_targets(sha: SHA, targets: float) -> SHA:
    """The automaton whose targets lie `targets` (degC) higher.

    Flows without a target stay as they are. Raises ValueError where a target's law cannot be shifted.
    """
    locations = tuple(
        replace(location, **_shift_location(sha, location, targets))
        if location.flow.kind in RELAXING_FLOWS
        else location
        for location in sha.locations
    )
    return replace(sha, locations=locations)


def _shift_location(sha: SHA, location: Location, targets: float) -> dict[str, Any]:
    """Law and flow of a location whose target lies `targets` (degC) higher."""
    flow, law = location.flow, location.distribution
    try:
        moved = None if law is None or location.entry == "resample" else _law(law, 1.0, targets)
    except ValueError as error:
        raise ValueError(f"SHA {sha.name!r}, location {location.name!r}: {error}") from None
    fixed = {FIXED_PARAMETER: flow.params[FIXED_PARAMETER] + targets} if FIXED_PARAMETER in flow.params else {}
    return {"flow": replace(flow, params={**flow.params, **fixed}), "distribution": law if moved is None else moved}


def _location(sha: SHA, location: Location, correction: Correction) -> Location:
    """The location's law and flow in the sensor's scale; 1/s and s stay as they are."""
    law, flow, gain = location.distribution, location.flow, correction.gain
    # What is drawn is a temperature where X is drawn on entry or the flow has a target, and is mapped with the offset;
    # else it is a slope or a factor, a difference, which is multiplied alone. A fixed m is always the flow's.
    absolute = location.entry == "resample" or flow.kind in RELAXING_FLOWS
    try:
        scaled = None if law is None else _law(law, gain, correction.offset if absolute else 0.0)
    except ValueError as error:
        raise ValueError(f"SHA {sha.name!r}, location {location.name!r}: {error}") from None
    params = {**flow.params, "noise": gain * flow.params["noise"]}
    if FIXED_PARAMETER in params:
        params[FIXED_PARAMETER] = gain * params[FIXED_PARAMETER] + (
            correction.offset if flow.kind in RELAXING_FLOWS else 0.0
        )
    inputs = tuple(Input(driver.signal, gain * driver.gain, driver.reference) for driver in flow.inputs)
    return replace(location, flow=Flow(flow.kind, params, inputs), distribution=scaled)


def _effect(effect: Effect, correction: Correction) -> Effect:
    """Each parameter as its kind says that it is rescaled; temperature signals keep their own scale.

    A radiated heat falls with the fourth power of temperatures that are all k times as far from absolute zero, so its
    gain is divided by k^3. Raises ValueError for a parameter of which it is not known.
    """
    k, kind = correction.gain, effect_kind(effect)
    params = {}
    for name, each in kind.parameters.items():
        value = effect.params.get(name, each.default)
        if value is None:
            continue
        match each.rescaled:
            case "stays":
                params[name] = value
            case "scaled":
                params[name] = k * value
            case "mapped":
                params[name] = apply_correction(correction, value)
            case "inverse cube":
                params[name] = value * k**-3
            case strange:
                raise ValueError(f"the correction does not know effects of the kind {effect.kind!r} ({name} {strange})")
    return replace(effect, params=params)


def _law(law: Distribution, gain: float, offset: float) -> Distribution:
    """The law of gain * value + offset."""
    if law.kind == "normal":
        mu, sigma = law.params["mu"], law.params["sigma"]
        return Distribution("normal", {"mu": gain * mu + offset, "sigma": gain * sigma})
    if offset:
        raise ValueError(f"a correction with an offset cannot shift a {law.kind} law; give a gain alone")
    multiplied: Mapping[str, Mapping[str, float]] = {
        "exponential": {"mean": gain},
        "weibull": {"shape": 1.0, "scale": gain},
    }
    if law.kind == "lognormal":
        return Distribution(law.kind, {**law.params, "mu": law.params["mu"] + log(gain)})
    factors = multiplied.get(law.kind, {})
    return Distribution(law.kind, {name: factors.get(name, 1.0) * value for name, value in law.params.items()})
