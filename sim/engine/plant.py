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

from sim.effects.kinds import acts_in, of_kind
from sim.sha.automaton import SHA, Effect, Flow
from sim.sha.flows import RELAXING
from sim.sha.trace import Array, Mask

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Acting:
    """An effect, and for each of the L locations whether it acts there."""

    effect: Effect
    there: Mask


@dataclass(frozen=True, slots=True)
class Plant:
    """The tables, each (L,) by location: `rate` (k of the flow, 1/s), `noise`, `drive` (what m is multiplied by).

    `t0` is NaN except for logarithmic flows, whose drive is 1/(t0 + age). `coupling` (1/s) is that of the housing.
    `lags` first-order lags of the rate `lag_rate` (1/s) follow X.
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
    """The tables of an automaton (its effects must have been checked: `entry.check_sha`)."""
    housing, lag = of_kind(sha, "housing-thermal-mass"), of_kind(sha, "sensor-lag")
    flows = [location.flow for location in sha.locations]
    coupled = np.zeros(len(flows))
    if housing is not None:
        coupled[_acting(sha, housing).there] = housing.params["coupling"]
    order = int(lag.params["order"]) if lag is not None else 0
    return Plant(
        sha=sha,
        rate=np.array([flow.params["k"] if flow.kind in RELAXING else 0.0 for flow in flows]),
        noise=np.array([flow.params["noise"] for flow in flows]),
        drive=np.array([_drive(flow) for flow in flows]),
        t0=np.array([flow.params["t0"] if flow.kind == "logarithmic" else np.nan for flow in flows]),
        coupling=coupled,
        housing_tau=inf if housing is None else housing.params["tau"],
        lags=order,
        lag_rate=order / lag.params["tau"] if lag is not None else 0.0,
        steady=_all(sha, *STEADY),
        startups=_all(sha, "startup-churning"),
        wears=_all(sha, "wear-drift"),
        thermostat=next(iter(_all(sha, "thermostatic-cooling")), None),
        radiation=next(iter(_all(sha, "radiation-loss")), None),
    )


STEADY = (
    "current-heating",
    "quadratic-current-heating",
    "current-saturation",
    "torque-friction",
    "speed-friction",
    "vibration-friction",
    "ambient-coupling",
    "feed-temperature-coupling",
    "pump-cooling",
)
"""The effects whose heat and loss stay while the signals do."""


def _drive(flow: Flow) -> float:
    """The constant that multiplies m in the drift; a logarithmic flow's varies, and is not here."""
    if flow.kind in RELAXING:
        return flow.params["k"]
    return 1.0 if flow.kind == "linear" else 0.0


def _acting(sha: SHA, effect: Effect) -> Acting:
    return Acting(effect, np.array([acts_in(effect, location.name) for location in sha.locations]))


def _all(sha: SHA, *kinds: str) -> tuple[Acting, ...]:
    return tuple(_acting(sha, effect) for effect in sha.effects if effect.kind in kinds)
