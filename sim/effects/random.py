"""What is random in a plant and lasts: heat with a memory, and how one machine differs from the next.

Both have the mean 0, so that a mean course knows nothing of them; a filter estimates them, runs draw them. What a heat
with a memory does over a step is said once, here (`disturbance_step`): the learner that fits it, forecasts, statistical
checking and the noise of a diagnosis take it from here. The engines of a model with further states have matrices
(`sim.engine.response`), which a test holds to the same law.
"""

from dataclasses import dataclass

import numpy as np

from sim.effects.kind import EffectKind, Parameter, Roles, Structural
from sim.sha import Array

SERIES_TOLERANCE = 1e-11
"""What the Taylor series may leave out, of what it begins with: far less than a memory is ever known to."""
BLOCK_STEPS = 4096
"""Steps that are worked out at a time."""


@dataclass(frozen=True, slots=True)
class DisturbanceStep:
    """What a disturbance D does over steps, each array (n,): D' = keep D + d, X' = decay X + carried D + x.

    `carried` (s) is the gain into X; d and x are what is new in D since the step began and what that leaves in X, with
    the covariance `xx` (s^2), `xd` (s), `dd` (1) for a D whose standard deviation is 1 degC/s.
    """

    keep: Array
    carried: Array
    xx: Array
    xd: Array
    dd: Array

    @property
    def coupling(self) -> Array:
        """(n,) s by which d shows in X: x = into d + what is independent of d (`own`)."""
        return np.asarray(self.xd / np.where(self.dd > 0, self.dd, 1.0))

    @property
    def own(self) -> Array:
        """(n,) s^2 the variance of x that d does not explain, for a standard deviation of 1 degC/s."""
        return np.asarray(np.maximum(self.xx - self.coupling * self.xd, 0.0))


def disturbance_step(memory: float, k: Array, dt: Array) -> DisturbanceStep:
    """The exact law of dX = (D - k X) dt, dD = -D / memory dt + sqrt(2 / memory) dW over steps of `dt` s.

    `k` (1/s), of the shape of `dt`, is the rate at which X forgets, 0 where it does not. White heat comes to it by the
    flow's own variance.
    """
    rates, spans = np.ravel(k), np.ravel(dt)
    # The many passes over the same numbers are made block by block, while these lie in the processor's cache.
    blocks = [
        _exact_step(memory, rates[at : at + BLOCK_STEPS], spans[at : at + BLOCK_STEPS])
        for at in range(0, max(rates.size, 1), BLOCK_STEPS)
    ]
    return DisturbanceStep(*(np.concatenate(parts).reshape(dt.shape) for parts in zip(*blocks, strict=True)))


def _exact_step(memory: float, k: Array, dt: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The fields of a DisturbanceStep, each (n,)."""
    # The covariance obeys Lyapunov's equation. Its closed form subtracts numbers that are nearly equal where k is near
    # 1 / memory or the step is short; so it is taken by Taylor's series over a piece of the step, short enough for all
    # steps, and doubled until the piece is the step (C(2h) = C(h) + F C(h) F', as in `sim.engine.response`). Nothing is
    # subtracted in the doubling, so that each number keeps its digits whatever the rates and the step are.
    a, b = k * dt, dt / memory
    fastest = 2.0 * float(np.max(a + b, initial=0.0))
    doublings = max(int(np.ceil(np.log2(max(2.0 * fastest, 1.0)))), 0)
    a, b, fastest = a * 0.5**doublings, b * 0.5**doublings, fastest * 0.5**doublings
    both, twice = a + b, 2.0 * b
    # In units of the piece's length, which xx has squared and xd once. The series of xx begins with the third power of
    # the length; what comes i powers later is at most fastest^i / i! beside it.
    more_xx, more_xd, more_dd = np.zeros_like(b), np.zeros_like(b), twice
    xx, xd, dd = more_xx, more_xd, more_dd
    order, left = 2, 1.0
    while left > SERIES_TOLERANCE:
        more_xx, more_xd, more_dd = (
            (more_xd - a * more_xx) * (2.0 / order),
            (more_dd - both * more_xd) * (1.0 / order),
            twice * more_dd * (-1.0 / order),
        )
        xx, xd, dd = xx + more_xx, xd + more_xd, dd + more_dd
        left *= fastest / (order - 2) if order > 2 else 1.0
        order += 1
    decay, keep = np.exp(-a), np.exp(-b)
    # (keep - decay) / (a - b) = e^{-(a + b) / 2} sinh(z) / z with z = (a - b) / 2, whose series needs no difference.
    z = ((a - b) / 2.0) ** 2
    carried = np.exp(-both / 2.0) * (1.0 + z / 6.0 * (1.0 + z / 20.0 * (1.0 + z / 42.0)))
    for _ in range(doublings):
        xx = (xx + decay * (decay * xx + 2.0 * carried * xd) + carried**2 * dd) / 4.0
        xd = (xd + keep * (decay * xd + carried * dd)) / 2.0
        dd = dd + keep**2 * dd
        decay, carried, keep = decay**2, carried * (decay + keep) / 2.0, keep**2
    return keep, dt * carried, dt**2 * xx, dt * xd, dd


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
        # It is no cause that could be named: a diagnosis has it in its noise (`sim.lab.discrepancy.fitting.noise`).
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
