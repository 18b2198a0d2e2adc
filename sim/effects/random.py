"""What is random in a plant and lasts: heat with a memory, and how one machine differs from the next.

Both have the mean 0, so that a mean course knows nothing of them; a filter estimates them, runs draw them.
"""

from dataclasses import dataclass

import numpy as np

from sim.effects.kind import EffectKind, Parameter, Roles, Structural
from sim.sha import Array


@dataclass(frozen=True, slots=True)
class DisturbanceStep:
    """What a disturbance does over steps, each array (n,): D' = keep D + f, X += carried D + into f.

    f is what is new in D, its variance `fresh` times sigma^2.
    """

    keep: Array
    carried: Array
    into: Array
    fresh: Array


def disturbance_step(memory: float, dt: Array, lasting: Array) -> DisturbanceStep:
    """The steps of `dt` s after which a constant heat of 1 degC/s leaves `lasting` degC in X, each (n,).

    D is exact at the ends of a step. Over it X takes the mean of both ends, which is right to second order in
    dt / memory: those who need it exactly have matrices (`sim.engine.response`).
    """
    keep = np.exp(-dt / memory)
    return DisturbanceStep(keep, lasting * (1.0 + keep) / 2.0, lasting / 2.0, -np.expm1(-2.0 * dt / memory))


RANDOM = (
    EffectKind(
        name="heat-disturbance",
        # heat D with dD = -D / memory dt + sigma sqrt(2 / memory) dW: an Ornstein-Uhlenbeck process, in its stationary
        # law (mean 0, standard deviation sigma) until something was read
        meaning="heat that comes and goes by itself and lasts for a while (Ornstein-Uhlenbeck)",
        parameters={
            "sigma": Parameter(unit="degC/s", low=0.0, rescaled="scaled"),
            "memory": Parameter(unit="s", positive=True, rescaled="stays"),
        },
        roles=Roles(),
        acts="everywhere",
        law=Structural("disturbance"),
        bound=Structural("disturbance"),
        uppaal=Structural("disturbance"),
        # A diagnosis has such a heat in its noise already (`sim.discrepancy.fitting.noise`).
        candidate=None,
    ),
    EffectKind(
        name="machine-offset",
        # heat k B in flows that move towards a target at the rate k, B ~ N(0, sigma) once for each machine
        meaning="what one machine's targets lie above or below the model's",
        parameters={"sigma": Parameter(unit="degC", low=0.0, rescaled="scaled")},
        roles=Roles(),
        acts="everywhere",
        law=Structural("machine offset"),
        bound=Structural("machine offset"),
        uppaal=Structural("machine offset"),
        candidate=None,
    ),
)
