"""The flows: how the temperature moves inside a location, as an exact step in closed form with no event inside.

Every flow without saturation is affine in the temperature and in the mode parameter: over a step of `dt` seconds,

    X(t+dt) = decay * X(t) + pull * (m + offset) + noise,    noise ~ N(0, variance)

where offset = sum of input gain * (signal - reference) over the inputs (0 except for `driven`). One table row gives
the three coefficients and the saturated mean map; simulator, filter and learner use these and nothing else.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sim.sha.automaton import Flow
from sim.sha.kinds import Indices, OfKind
from sim.sha.trace import Array, Mask

Coefficients = tuple[Array, Array, Array]

Constants = Mapping[str, Any]
"""The constants of one flow, numbers, or of a flow for each step, arrays."""

FIXED_PARAMETER = "m"
"""The one constant that every flow may have besides its own: a mode parameter that no entry draws."""


class SaturatedStep(Protocol):
    """The mean temperature after a step whose drift is limited."""

    def __call__(self, params: Constants, x: Array, target: Array, /, *, age: Array, dt: Array, rate: float) -> Array:
        """degC after `dt` s, begun `age` s after entry; |drift| is at most `rate` (degC/s)."""
        ...


@dataclass(frozen=True, slots=True)
class FlowKind:
    """One kind of flow: the names of its constants, its drift, its affine step and its step under a saturated rate.

    `drift(params, x, target, age)` -> degC/s at one instant; it never grows in size while the target stays.
    `coefficients(params, age, dt)` -> (decay, pull, variance), all broadcast over `age` (s since entry) and `dt` (s).
    `saturated(params, x, target, age=, dt=, rate=)` -> the mean after `dt` with |drift| limited to `rate` (degC/s);
    `target` is m + offset. `fade_ages(params, part)` -> the ages (s) at which the drift per unit of m has fallen to
    `part` of what it is on entry, for a flow whose drift falls with the age; None where it does not.
    """

    params: tuple[str, ...]
    drift: Callable[[Constants, Array, Array, Array], Array]
    coefficients: Callable[[Constants, Array, Array], Coefficients]
    saturated: SaturatedStep
    fading: Callable[[Constants, Array], Array] | None = None


def _drift_free(params: Constants, age: Array, dt: Array) -> Coefficients:
    return np.ones_like(dt), np.zeros_like(dt), params["noise"] ** 2 * dt


def _keep_target(params: Constants, x: Array, target: Array, *, age: Array, dt: Array, rate: float) -> Array:
    return x + np.zeros_like(dt)


def _linear(params: Constants, age: Array, dt: Array) -> Coefficients:
    return np.ones_like(dt), dt, params["noise"] ** 2 * dt


def _saturate_linear(params: Constants, x: Array, target: Array, *, age: Array, dt: Array, rate: float) -> Array:
    return x + np.clip(target, -rate, rate) * dt


def _relaxing_coefficients(params: Constants, age: Array, dt: Array) -> Coefficients:
    # expm1 and not 1 - exp: with a slow plant and a short step k dt is 1e-5, of which 1 - exp would lose five digits.
    k = params["k"]
    pull = -np.expm1(-k * dt)
    # A fit of the means asks without noise, thousands of times: the second expm1 would be half of its time.
    noise = params["noise"]
    variance = noise**2 * -np.expm1(-2.0 * k * dt) / (2.0 * k) if np.any(noise) else np.zeros_like(dt)
    return 1.0 - pull, pull, variance


def _saturate_relaxation(params: Constants, x: Array, target: Array, *, age: Array, dt: Array, rate: float) -> Array:
    """Runs at the limit until k|m - x| has fallen to it, then relaxes."""
    k = params["k"]
    distance = target - x
    # The drift k |distance| only falls, so there is one ramp, at the start, and after it the plain flow from `reached`.
    free = np.maximum(np.abs(distance) - rate / k, 0.0) / rate
    ramp = np.minimum(dt, free)
    reached = x + np.sign(distance) * rate * ramp
    return np.asarray(target + (reached - target) * np.exp(-k * (dt - ramp)))


def _logarithmic(params: Constants, age: Array, dt: Array) -> Coefficients:
    return np.ones_like(dt), np.log1p(dt / (params["t0"] + age)), params["noise"] ** 2 * dt


def _saturate_logarithmic(params: Constants, x: Array, target: Array, *, age: Array, dt: Array, rate: float) -> Array:
    """The drift a/(t0+u) falls with u: at the limit first, logarithmic once |a|/(t0+u) is below it."""
    start = params["t0"] + age
    ramp = np.minimum(dt, np.maximum(np.abs(target) / rate - start, 0.0))
    return np.asarray(x + np.sign(target) * rate * ramp + target * np.log1p((dt - ramp) / (start + ramp)))


def _transient(params: Constants, age: Array, dt: Array) -> Coefficients:
    # exp(-u/tau) at the step's start less that at its end; as a product, which loses no digits when dt is small.
    tau = params["tau"]
    left = np.exp(-age / tau)
    return np.ones_like(dt), left * -np.expm1(-dt / tau), params["noise"] ** 2 * dt


def _saturate_transient(params: Constants, x: Array, target: Array, *, age: Array, dt: Array, rate: float) -> Array:
    """The drift (a/tau) exp(-u/tau) falls with u: at the limit first, transient once it is below it."""
    tau = params["tau"]
    # Below the limit from the age tau ln(|a| / (tau R)) on, at once where that is negative. The floor keeps the
    # logarithm finite at a = 0.
    free = tau * np.log(np.maximum(np.abs(target) / (tau * rate), 1.0))
    ramp = np.minimum(dt, np.maximum(free - age, 0.0))
    rest = np.exp(-(age + ramp) / tau) * -np.expm1(-(dt - ramp) / tau)
    return np.asarray(x + np.sign(target) * rate * ramp + target * rest)


FLOWS: dict[str, FlowKind] = {
    "constant": FlowKind(("noise",), lambda p, x, m, u: np.zeros_like(x), _drift_free, _keep_target),
    "linear": FlowKind(("noise",), lambda p, x, m, u: m, _linear, _saturate_linear),
    "exponential": FlowKind(
        ("k", "noise"), lambda p, x, m, u: p["k"] * (m - x), _relaxing_coefficients, _saturate_relaxation
    ),
    "driven": FlowKind(
        ("k", "noise"), lambda p, x, m, u: p["k"] * (m - x), _relaxing_coefficients, _saturate_relaxation
    ),
    "logarithmic": FlowKind(
        ("t0", "noise"),
        lambda p, x, m, u: m / (p["t0"] + u),
        _logarithmic,
        _saturate_logarithmic,
        lambda p, part: p["t0"] * (1.0 / part - 1.0),
    ),
    "transient": FlowKind(
        ("tau", "noise"),
        lambda p, x, m, u: m / p["tau"] * np.exp(-u / p["tau"]),
        _transient,
        _saturate_transient,
        lambda p, part: np.asarray(-p["tau"] * np.log(part)),
    ),
}


RELAXING_FLOWS = ("exponential", "driven")
"""The flows whose m is a temperature (degC), and whose drift depends on x: they move towards m."""


def check_flow(flow: Flow) -> None:
    """Raises ValueError, saying what would be right, for an unknown kind or unusable constants."""
    kind = FLOWS.get(flow.kind)
    if kind is None:
        raise ValueError(f"unknown flow {flow.kind!r}: known are {', '.join(FLOWS)}")
    if set(flow.params) - {FIXED_PARAMETER} != set(kind.params):
        raise ValueError(
            f"flow {flow.kind!r} takes the constants {', '.join(kind.params)} (and {FIXED_PARAMETER}, where nothing "
            "draws it); "
            f"got {', '.join(flow.params) or 'none'}"
        )
    for name, value in flow.params.items():
        ranges = {"noise": (value >= 0, "at least 0 and finite"), FIXED_PARAMETER: (True, "finite")}
        inside, right = ranges.get(name, (value > 0, "positive and finite"))
        if not isfinite(value) or not inside:
            raise ValueError(f"flow {flow.kind!r}: {name} must be {right}, got {value}")
    if bool(flow.inputs) != (flow.kind == "driven"):
        raise ValueError("a driven flow needs inputs, every other kind takes none")
    for driver in flow.inputs:
        if not isfinite(driver.gain) or not isfinite(driver.reference):
            raise ValueError(
                f"input {driver.signal!r}: gain {driver.gain} and reference {driver.reference} must be finite"
            )


def coefficients(flow: Flow, age: ArrayLike, dt: ArrayLike) -> Coefficients:
    """(decay, pull, variance) of an unsaturated step, broadcast over `age` and `dt` in seconds."""
    ages, steps = np.broadcast_arrays(np.asarray(age, dtype=float), np.asarray(dt, dtype=float))
    return FLOWS[flow.kind].coefficients(flow.params, ages, steps)


def coefficients_along(flows: tuple[OfKind, ...], location: Indices, age: Array, dt: Array) -> Coefficients:
    """(decay, pull, variance) of unsaturated steps, each in a `location` of its own; all arrays of one shape.

    `flows` are those of all locations (`kinds.by_kind`): a kind is worked out once, however many locations have it.
    """
    parts = np.empty((3, *dt.shape))
    for kind, params, rows in _kinds_along(flows, location):
        parts[:, rows] = kind.coefficients(params, age[rows], dt[rows])
    return parts[0], parts[1], parts[2]


def mean_along(
    flows: tuple[OfKind, ...], location: Indices, x: Array, target: Array, *, age: Array, dt: Array, max_rate: float
) -> Array:
    """`mean_step` of steps that are each in a `location` of its own, under a finite `max_rate`; see above."""
    mean = np.empty(dt.shape)
    for kind, params, rows in _kinds_along(flows, location):
        mean[rows] = kind.saturated(params, x[rows], target[rows], age=age[rows], dt=dt[rows], rate=max_rate)
    return mean


def drift_along(flows: tuple[OfKind, ...], location: Indices, x: Array, target: Array, age: Array) -> Array:
    """`drift` in a `location` of its own each; see above."""
    drifts = np.empty(x.shape)
    for kind, params, rows in _kinds_along(flows, location):
        drifts[rows] = kind.drift(params, x[rows], target[rows], age[rows])
    return drifts


def _kinds_along(
    flows: tuple[OfKind, ...], location: Indices
) -> Iterator[tuple[FlowKind, Mapping[str, Array], Mask | slice]]:
    """Each kind of flow with its constants and the rows in which it is met."""
    for each in flows:
        rows = each.members[location] if len(flows) > 1 else slice(None)
        yield FLOWS[each.kind], each.at(location[rows]), rows


def mean_step(flow: Flow, x: ArrayLike, target: ArrayLike, *, age: ArrayLike, dt: ArrayLike, max_rate: float) -> Array:
    """The mean temperature (degC) after `dt` seconds from `x`; `target` is m + offset; arguments broadcast."""
    xs, targets, ages, steps = np.broadcast_arrays(
        np.asarray(x, dtype=float),
        np.asarray(target, dtype=float),
        np.asarray(age, dtype=float),
        np.asarray(dt, dtype=float),
    )
    if isfinite(max_rate):
        return np.asarray(FLOWS[flow.kind].saturated(flow.params, xs, targets, age=ages, dt=steps, rate=max_rate))
    decay, pull, _ = FLOWS[flow.kind].coefficients(flow.params, ages, steps)
    return np.asarray(decay * xs + pull * targets)


def drift(flow: Flow, x: ArrayLike, target: ArrayLike, age: ArrayLike) -> Array:
    """dX/dt (degC/s) without a rate limit at the temperature `x`, `age` seconds after entry; arguments broadcast."""
    xs, targets, ages = np.broadcast_arrays(
        np.asarray(x, dtype=float), np.asarray(target, dtype=float), np.asarray(age, dtype=float)
    )
    return np.asarray(FLOWS[flow.kind].drift(flow.params, xs, targets, ages))


def fade_ages(flow: Flow, part: ArrayLike) -> Array:
    """The ages (s) at which the drift has fallen to `part` (0 to 1) of that on entry; inf where it never does."""
    parts = np.asarray(part, dtype=float)
    law = FLOWS[flow.kind].fading
    return np.full(parts.shape, inf) if law is None else np.asarray(law(flow.params, parts))


def free_distance(flow: Flow, max_rate: float) -> float:
    """|target - x| (degC) up to which no part of a step is limited; inf where the drift does not depend on x."""
    return max_rate / flow.params["k"] if flow.kind in RELAXING_FLOWS else inf


def offset(flow: Flow, signals: Mapping[str, ArrayLike]) -> Array:
    """What the flow's inputs add to its target (degC): sum of gain * (signal - reference); 0.0 without inputs."""
    total = np.asarray(0.0)
    for driver in flow.inputs:
        total = total + driver.gain * (np.asarray(signals[driver.signal], dtype=float) - driver.reference)
    return total
