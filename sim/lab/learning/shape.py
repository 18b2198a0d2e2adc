"""From an automaton to the fitter's parameter vector and back: what is free, shared, believed before."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sim.lab.learning.free_run import RATE_PARAMETERS, FitShape, FreeRunFit
from sim.sha import SHA, Distribution, Flow, Input, Location, distributions


@dataclass(frozen=True, slots=True)
class Prior:
    """Weak beliefs before the data: normal laws of m, of the gains and of log(rate).

    `temperature` (centre, spread) in degC for targets; drifts (degC/s), logarithmic factors and transients (degC) are
    centred at 0 with `drift` and `factor`. `gain` is the spread of a gain by its signal, degC per unit. `tau` is the
    central time constant in seconds (1/k, t0 or tau) and `tau_spread` the spread of its logarithm.
    """

    temperature: tuple[float, float]
    gain: Mapping[str, float] = field(default_factory=dict)
    tau: float = 900.0
    tau_spread: float = 1.5
    drift: float = 0.05
    factor: float = 20.0


@dataclass(frozen=True, slots=True)
class ParameterNames:
    """What the numbers of a Shape stand for: location or group of each rate, each m, each gain (with its signal)."""

    rates: tuple[str, ...]
    targets: tuple[str, ...]
    gains: tuple[tuple[str, str], ...]


def build_shape(
    sha: SHA,
    free: Sequence[str],
    signals: Sequence[str],
    prior: Prior,
    *,
    rates: Mapping[str, str] | None = None,
    gains: Mapping[str, str] | None = None,
) -> tuple[FitShape, ParameterNames]:
    """The parameter vector of the `free` locations of `sha`, whose flows give the structure.

    `rates` and `gains` map a location to the group whose rate or gains it shares (default: its own). The linear
    parameters are the m of the free locations in the order of `sha`, then the gains. Locations that are not free count
    as constant. Raises ValueError when an input is not among `signals`.
    """
    chosen = [location for location in sha.locations if location.name in set(free)]
    targets = [location.name for location in chosen if location.flow.kind != "constant"]
    group_of_rate = {
        each.name: (rates or {}).get(each.name, each.name) for each in chosen if each.flow.kind in RATE_PARAMETERS
    }
    group_of_gain = {
        (each.name, driver.signal): ((gains or {}).get(each.name, each.name), driver.signal)
        for each in chosen
        for driver in each.flow.inputs
    }
    names = ParameterNames(
        tuple(dict.fromkeys(group_of_rate.values())), tuple(targets), tuple(dict.fromkeys(group_of_gain.values()))
    )
    unknown = [signal for _, signal in names.gains if signal not in signals]
    if unknown:
        raise ValueError(f"SHA {sha.name!r} is driven by {unknown[0]!r}, which is not among the inputs to be fitted")
    # The table of gains: their numbers come after those of the targets, and -1 says that there is none.
    gain = np.full((len(sha.locations), len(signals)), -1, dtype=np.intp)
    reference = np.zeros(gain.shape)
    for place, location in enumerate(sha.locations):
        for driver in location.flow.inputs:
            if (location.name, driver.signal) in group_of_gain:
                number = signals.index(driver.signal)
                group = group_of_gain[location.name, driver.signal]
                gain[place, number] = len(names.targets) + names.gains.index(group)
                reference[place, number] = driver.reference
    # The priors: a target is a temperature unless the flow's m is a drift or a factor, and nothing is known of a
    # gain's sign. A group's rate is 1/tau or tau, as the flow of its first location wants it.
    laws = {"linear": (0.0, prior.drift), "logarithmic": (0.0, prior.factor), "transient": (0.0, prior.factor)}
    by_name = sha.by_name
    priors = [laws.get(by_name[name].flow.kind, prior.temperature) for name in names.targets]
    priors += [(0.0, prior.gain.get(signal, 1.0)) for _, signal in names.gains]
    constant_of_group = {
        group_of_rate[each.name]: RATE_PARAMETERS[each.flow.kind]
        for each in reversed(chosen)
        if each.flow.kind in RATE_PARAMETERS
    }
    taus = [1.0 / prior.tau if constant_of_group[group] == "k" else prior.tau for group in names.rates]
    shape = FitShape(
        kinds=tuple(each.flow.kind if each in chosen else "constant" for each in sha.locations),
        rate=_places(sha, group_of_rate, names.rates),
        target=_places(sha, {name: name for name in targets}, names.targets),
        gain=gain,
        reference=reference,
        centre=np.array([centre for centre, _ in priors]),
        spread=np.array([spread for _, spread in priors]),
        rate_centre=np.array([float(np.log(rate)) for rate in taus]),
        rate_spread=np.full(len(names.rates), prior.tau_spread),
    )
    return shape, names


def _places(sha: SHA, groups: Mapping[str, str], order: Sequence[str]) -> NDArray[np.intp]:
    known = [order.index(groups[each.name]) if each.name in groups else -1 for each in sha.locations]
    return np.array(known, dtype=np.intp)


def with_parameters(sha: SHA, shape: FitShape, fit: FreeRunFit) -> SHA:
    """`sha` with the fitted m (mean of each location's law), rates and gains; noise and sigma stay what they are."""
    locations: list[Location] = []
    for place, location in enumerate(sha.locations):
        # Places that are not free count as constant in the shape, whatever their own flow is.
        if shape.kinds[place] != location.flow.kind or shape.target[place] < 0:
            locations.append(location)
            continue
        flow, params = location.flow, dict(location.flow.params)
        if shape.rate[place] >= 0:
            params[RATE_PARAMETERS[flow.kind]] = float(fit.rates[shape.rate[place]])
        columns = [column for column in shape.gain[place] if column >= 0]
        inputs = tuple(
            Input(driver.signal, float(fit.linear[column]), driver.reference)
            for driver, column in zip(flow.inputs, columns, strict=True)
        )
        law = location.distribution
        sigma = float(np.sqrt(distributions.variance(law))) if law is not None else 0.0
        mean = float(fit.linear[shape.target[place]])
        distribution = Distribution("normal", {"mu": mean, "sigma": sigma})
        locations.append(replace(location, flow=Flow(flow.kind, params, inputs), distribution=distribution))
    return replace(sha, locations=tuple(locations))
