"""An automaton with effects made ready: its state beyond X, and what acts in which location, as tables by location.

The state s is X, then the housing's temperature H, then the sensor's lags, each where there is one: `size` of them.
Everything but thermostat and radiation is linear in s and in the stay's mode parameter m, so that inside a segment

    dX/dt = -(k + loss) X + drive m + coupling (H - X) + heat(t),    dH/dt = (X - H) / tau,    dL/dt = rate (before - L)

with k the flow's, and the sensor reads the last lag, or X where there is none.
"""

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from sim.effects import FEATURES, Feature, HeldLaw, Structural, VaryingLaw, acts_in, kind_of, unknown
from sim.sha import RELAXING, SHA, Array, Effect, Mask

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Acting:
    """An effect, and for each of the L locations whether it acts there."""

    effect: Effect
    mask: Mask


@dataclass(frozen=True, slots=True)
class Plant:
    """The tables, each (L,) by location: `rate` (k of the flow, 1/s), `noise`, `drive` (what m is multiplied by).

    `t0` is NaN except for logarithmic flows, whose drive is 1/(t0 + age). `coupling` (1/s) is that of the housing.
    `lags` first-order lags of the rate `lag_rate` (1/s) follow X. `steady` are the effects with a held law, `startups`
    those that vary since an event, `wears` those that vary with the time alone.
    """

    sha: SHA
    rate: Array
    noise: Array
    drive: Array
    t0: Array
    coupling: Array
    housing_tau: float
    lags: int
    lag_rate: float
    steady: tuple[Acting, ...]
    startups: tuple[Acting, ...]
    wears: tuple[Acting, ...]
    thermostat: Acting | None
    radiation: Acting | None

    @property
    def size(self) -> int:
        """The number of states."""
        return 1 + (self.housing_tau < inf) + self.lags

    @property
    def linear(self) -> bool:
        """True without thermostat and radiation."""
        return self.thermostat is None and self.radiation is None

    @property
    def sensed(self) -> int:
        """The state that the sensor reads: the last lag, or X."""
        return self.size - 1 if self.lags else 0


def compile_plant(sha: SHA) -> Plant:
    """The tables of an automaton (its effects must have been checked: `check.check_sha`).

    Raises ValueError, naming the kind, for an effect whose law these engines do not know.
    """
    flows = [location.flow for location in sha.locations]
    held: list[Acting] = []
    startups: list[Acting] = []
    wears: list[Acting] = []
    features: dict[Feature, Acting] = {}
    for effect in sha.effects:
        acting = Acting(effect, np.array([acts_in(effect, location.name) for location in sha.locations]))
        match kind_of(effect).law:
            case HeldLaw():
                held.append(acting)
            case VaryingLaw(from_event=from_event):
                (startups if from_event else wears).append(acting)
            case Structural(feature=feature) if feature in FEATURES:
                features[feature] = acting
            case law:
                raise unknown("the simulation", effect.kind, law)
    housing, lag = features.get("housing"), features.get("sensor lag")
    order = int(lag.effect.params["order"]) if lag is not None else 0
    return Plant(
        sha=sha,
        rate=np.array([flow.params["k"] if flow.kind in RELAXING else 0.0 for flow in flows]),
        noise=np.array([flow.params["noise"] for flow in flows]),
        # The constant that multiplies m in the drift; a logarithmic flow's falls with the age, and is not here (`t0`).
        drive=np.array([flow.params["k"] if flow.kind in RELAXING else float(flow.kind == "linear") for flow in flows]),
        t0=np.array([flow.params["t0"] if flow.kind == "logarithmic" else np.nan for flow in flows]),
        coupling=np.where(housing.mask, housing.effect.params["coupling"], 0.0) if housing else np.zeros(len(flows)),
        housing_tau=inf if housing is None else housing.effect.params["tau"],
        lags=order,
        lag_rate=order / lag.effect.params["tau"] if lag is not None else 0.0,
        steady=tuple(held),
        startups=tuple(startups),
        wears=tuple(wears),
        thermostat=features.get("thermostat"),
        radiation=features.get("radiation"),
    )
