"""An automaton with effects made ready: its state beyond X, and what acts in which location, as tables by location.

The state s is X, then the housing's temperature H, the disturbance's heat D, the machine's offset B and the sensor's
lags, each where there is one: `size` of them.
Everything but thermostat and radiation is linear in s and in the stay's mode parameter m, so that inside a segment

    dX/dt = -(k + loss) X + drive m + coupling (H - X) + D + k B + heat(t),    dH/dt = (X - H) / tau,
    dD/dt = -D / memory + white noise,    dB/dt = 0,    dL/dt = rate (before - L)

with k the flow's (0 where it has no target), and the sensor reads the last lag, or X where there is none.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.effects import (
    FEATURES,
    Feature,
    HeldLaw,
    Structural,
    VaryingLaw,
    affects_location,
    effect_kind,
    heat_lag,
    unknown,
)
from sim.sha import FLOWS, RELAXING_FLOWS, SHA, Array, Effect, Mask

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Acting:
    """An effect, and for each of the L locations whether it acts there."""

    effect: Effect
    mask: Mask


@dataclass(frozen=True, slots=True)
class Plant:
    """The tables, each (L,) by location: `rate` (k of the flow, 1/s), `noise`, `drive` (what m is multiplied by).

    `fading` are the locations whose drive falls with the age instead (`FlowKind.fading`). `couplings` (L, 2) (1/s) are
    those of X to the housing and to the machine's offset.
    `lags` first-order lags of the rate `lag_rate` (1/s) follow X. `steady` are the effects with a held law, `startups`
    those that vary since an event, `wears` those that vary with the time alone. `late` are those of `steady` with a
    part that comes late, which goes on in all locations.
    """

    sha: SHA
    rate: Array
    noise: Array
    drive: Array
    fading: tuple[int, ...]
    couplings: Array
    housing_tau: float
    lags: int
    lag_rate: float
    steady: tuple[Acting, ...]
    startups: tuple[Acting, ...]
    wears: tuple[Acting, ...]
    late: tuple[Effect, ...]
    thermostat: Acting | None
    radiation: Acting | None
    disturbance: Effect | None
    machine: Effect | None
    places: Mapping[str, int]
    memo: dict[tuple[int, float, float], Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def is_random(self) -> bool:
        """Whether all that acts is random: a disturbance, the machine's offset."""
        return len(self.sha.effects) == (self.disturbance is not None) + (self.machine is not None)

    @property
    def steady_linear(self) -> bool:
        """Whether all steps are affine with numbers that stay while the signals do."""
        varying = self.startups or self.wears or self.late or self.fading
        return self.linear and not varying

    @property
    def size(self) -> int:
        """The number of states."""
        return 1 + (self.housing_tau < inf) + (self.disturbance is not None) + (self.machine is not None) + self.lags

    @property
    def heat_state(self) -> int:
        """The place of the disturbance's heat among the states, where there is one."""
        return 1 + (self.housing_tau < inf)

    @property
    def offset_state(self) -> int:
        """The place of the machine's offset among the states, where there is one."""
        return self.heat_state + (self.disturbance is not None)

    @property
    def own_states(self) -> tuple[tuple[int, float], ...]:
        """(place, standard deviation before anything is read) of the states that no temperature tells at once."""
        heat = () if self.disturbance is None else ((self.heat_state, self.disturbance.params["sigma"]),)
        return heat if self.machine is None else (*heat, (self.offset_state, self.machine.params["sigma"]))

    @property
    def linear(self) -> bool:
        """True without thermostat and radiation."""
        return self.thermostat is None and self.radiation is None

    @property
    def sensor_state(self) -> int:
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
        acting = Acting(effect, np.array([affects_location(effect, location.name) for location in sha.locations]))
        match effect_kind(effect).law:
            case HeldLaw():
                held.append(acting)
            case VaryingLaw(from_event=from_event):
                (startups if from_event else wears).append(acting)
            case Structural(feature=feature) if feature in FEATURES:
                features[feature] = acting
            case law:
                raise unknown("the simulation", effect.kind, law)
    housing, lag = features.get("housing"), features.get("sensor lag")
    disturbance, machine = features.get("disturbance"), features.get("machine offset")
    order = int(lag.effect.params["order"]) if lag is not None else 0
    rate = np.array([flow.params["k"] if flow.kind in RELAXING_FLOWS else 0.0 for flow in flows])
    coupling = np.where(housing.mask, housing.effect.params["coupling"], 0.0) if housing else np.zeros(len(flows))
    return Plant(
        sha=sha,
        rate=rate,
        noise=np.array([flow.params["noise"] for flow in flows]),
        # The constant that multiplies m in the drift; one that falls with the age is not here (`fading`).
        drive=np.array(
            [flow.params["k"] if flow.kind in RELAXING_FLOWS else float(flow.kind == "linear") for flow in flows]
        ),
        fading=tuple(row for row, flow in enumerate(flows) if FLOWS[flow.kind].fading is not None),
        couplings=np.column_stack([coupling, rate if machine else np.zeros(len(flows))]),
        housing_tau=inf if housing is None else housing.effect.params["tau"],
        lags=order,
        lag_rate=order / lag.effect.params["tau"] if lag is not None else 0.0,
        steady=tuple(held),
        startups=tuple(startups),
        wears=tuple(wears),
        late=tuple(acting.effect for acting in held if heat_lag(acting.effect) > 0),
        thermostat=features.get("thermostat"),
        radiation=features.get("radiation"),
        disturbance=disturbance.effect if disturbance else None,
        machine=machine.effect if machine else None,
        places={location.name: row for row, location in enumerate(sha.locations)},
    )
