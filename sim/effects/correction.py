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

from sim.effects.kinds import kind_of
from sim.sha import FIXED, RELAXING, SHA, Correction, Distribution, Effect, Flow, Input, Location, Model


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
        low=corrected(correction, sha.low),
        high=corrected(correction, sha.high),
        effects=tuple(_effect(effect, correction) for effect in sha.effects),
    )
    return replace(model, sha=scaled, correction=Correction())


def corrected(correction: Correction, temperature: float) -> float:
    """What the sensor reads (degC) when the automaton is at `temperature`."""
    return correction.gain * temperature + correction.offset


def _location(sha: SHA, location: Location, correction: Correction) -> Location:
    law = location.distribution
    absolute = location.entry == "resample" or location.flow.kind in RELAXING
    offset = correction.offset if absolute else 0.0
    try:
        scaled = None if law is None else _law(law, correction.gain, offset)
    except ValueError as error:
        raise ValueError(f"SHA {sha.name!r}, location {location.name!r}: {error}") from None
    return replace(location, flow=_flow(location.flow, correction), distribution=scaled)


def _flow(flow: Flow, correction: Correction) -> Flow:
    """Noise and gains are multiplied, a fixed m is mapped as what it is: a temperature or a rate; 1/s and s stay."""
    params = dict(flow.params)
    params["noise"] = correction.gain * params["noise"]
    if FIXED in params:
        shift = correction.offset if flow.kind in RELAXING else 0.0
        params[FIXED] = correction.gain * params[FIXED] + shift
    inputs = tuple(Input(driver.signal, correction.gain * driver.gain, driver.reference) for driver in flow.inputs)
    return Flow(flow.kind, params, inputs)


def _effect(effect: Effect, correction: Correction) -> Effect:
    """Each parameter as its kind says that it is rescaled; temperature signals keep their own scale.

    A radiated heat falls with the fourth power of temperatures that are all k times as far from absolute zero, so its
    gain is divided by k^3. Raises ValueError for a parameter of which it is not known.
    """
    k, kind = correction.gain, kind_of(effect)
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
                params[name] = corrected(correction, value)
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
