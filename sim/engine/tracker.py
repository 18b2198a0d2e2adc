"""A model made ready to be followed sample by sample: its locations' steps as plain functions of floats, its moves.

The scalar steps here are those of `sim.sha.flows`, which stays the definition (a test holds them equal): making an
array costs more than the whole of a filter's step.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp, expm1, isfinite, log1p, tanh
from typing import Literal

from sim.effects import check_sha, effect_signals, in_sensor_scale
from sim.engine.plant import Plant, compile_plant
from sim.engine.schedules import resync_targets
from sim.sha import (
    UNKNOWN,
    Chain,
    Location,
    Model,
    OfKind,
    by_kind,
    compile_chain,
    distributions,
    draw_temperature,
    mean_step,
    mode_parameter,
    transitions,
)

OnlinePolicy = Literal["ignore", "resync"]
"""What an event without an edge does, as in `sim.engine.schedules`;
online nothing is refused, so there is no `reject`."""

MIN_SENSOR_VARIANCE = 1e-8
"""Least variance of a reading, degC^2: a tenth of a millikelvin, so that a perfect sensor and two readings at one
instant leave the arithmetic well posed."""

Step = Callable[[float, float], tuple[float, float, float]]
Speed = Callable[[float, float, float], float]


@dataclass(frozen=True, slots=True)
class Mode:
    """A location made ready: `step(age, dt)` -> (decay, pull, variance), equal to `flows.coefficients`.

    `speed(x, target, age)` is the greatest |drift| (degC/s) of a step that begins so. `parameter` is (mean, variance)
    of the mode parameter of a stay (`entry.mode_parameter`), `temperature` of the X on entry, None where X goes on.
    """

    location: Location
    step: Step
    speed: Speed
    parameter: tuple[float, float]
    temperature: tuple[float, float] | None

    def mean(self, x: float, target: float, age: float, dt: float, max_rate: float) -> float:
        """The mean temperature (degC) after `dt` seconds, equal to `flows.mean_step`."""
        # Inside a step the drift only shrinks: one that begins within the limit stays within it, and needs no array.
        if self.speed(x, target, age) > max_rate:
            return float(mean_step(self.location.flow, x, target, age=age, dt=dt, max_rate=max_rate))
        decay, pull, _ = self.step(age, dt)
        return decay * x + pull * target

    def offset(self, signals: Mapping[str, float]) -> float:
        """What `signals` add to the target (degC); one that was never read counts as at its reference."""
        total = 0.0
        for driving in self.location.flow.inputs:
            if driving.signal in signals:
                total += driving.gain * (signals[driving.signal] - driving.reference)
        return total


@dataclass(frozen=True, slots=True)
class Tracker:
    """A model made ready (`compile_model`): no state in here, it may be shared.

    `model` is the one that was given, in the sensor's scale (`correction.in_sensor_scale`).
    `moves` are the edges, `fallback` where a symbol leads under `resync`, `inputs` the signals that drive some flow,
    `window` the number of innovations in the anomaly test, `sensor` the variance of a reading (degC^2), `sensor_memory`
    how long its error lasts (s). `inputs` are also those that effects read. `flows` are the locations' by kind, `chain`
    is the process of the stays. `plant` is there where the automaton has effects; the modes' steps know nothing of
    those.
    """

    model: Model
    modes: Mapping[str, Mode]
    moves: Mapping[tuple[str, str], str]
    fallback: Mapping[str, str]
    inputs: frozenset[str]
    policy: OnlinePolicy
    window: int
    sensor: float
    flows: tuple[OfKind, ...]
    chain: Chain
    plant: Plant | None = None
    sensor_memory: float = 0.0


def repeat_factor(memory: float, since: float) -> float:
    """By how much the variance of a reading is multiplied whose error is correlated as exp(-t / memory) with others.

    Such an error is not averaged out by reading often: readings count as those whose errors are independent and whose
    mean over a long time is as uncertain.
    `memory` > 0 and `since` (the time between readings) in s. The mean of many such readings has the variance of one,
    times (1 + r) / (1 - r) for the correlation r of neighbours, over their number (Bartlett 1946).
    """
    # Two readings of one instant say nothing new; a thousandth of the memory keeps that finite.
    return 1.0 / tanh(0.5 * max(since / memory, 1e-3))


def compile_model(model: Model, policy: OnlinePolicy = "resync", window: int = 30) -> Tracker:
    """The model made ready to be followed; `window` is the number of innovations that the anomaly test looks at.

    Raises ValueError for a non-deterministic or guarded automaton, an unusable flow or law, a `sensor_sigma` or
    `sensor_memory` that is negative or no number, an unknown policy, and a window below 1.
    """
    check_sha(model.sha)
    # Its square is what is computed with, and that leaves the floating point numbers earlier.
    if not isfinite(model.sensor_sigma * model.sensor_sigma) or model.sensor_sigma < 0:
        raise ValueError(f"model {model.sha.name!r}: sensor_sigma must be at least 0 degC, got {model.sensor_sigma}")
    if not isfinite(model.sensor_memory) or model.sensor_memory < 0:
        raise ValueError(f"model {model.sha.name!r}: sensor_memory must be at least 0 s, got {model.sensor_memory}")
    if policy not in ("ignore", "resync"):
        raise ValueError(f"unknown policy {policy!r}: online the known ones are ignore and resync")
    if window < 1:
        raise ValueError(f"the anomaly test needs a window of at least 1 innovation, got {window}")
    model = in_sensor_scale(model)
    modes = {}
    for location in model.sha.locations:
        step, speed = _SCALAR[location.flow.kind](location.flow.params)
        law = draw_temperature(location)
        drawn = None if law is None else (distributions.mean(law), distributions.variance(law))
        modes[location.name] = Mode(location, step, speed, mode_parameter(location), drawn)
    return Tracker(
        model=model,
        modes=modes,
        moves=transitions(model.sha),
        fallback=resync_targets(model.sha),
        inputs=frozenset(driving.signal for location in model.sha.locations for driving in location.flow.inputs)
        | frozenset(effect_signals(model.sha)),
        policy=policy,
        window=window,
        sensor=max(model.sensor_sigma * model.sensor_sigma, MIN_SENSOR_VARIANCE),
        flows=by_kind([location.flow for location in model.sha.locations]),
        chain=compile_chain(model),
        plant=compile_plant(model.sha) if model.sha.effects else None,
        sensor_memory=model.sensor_memory,
    )


def compile_tracker(model: Model | Tracker) -> Tracker:
    """The tracker itself, or the one of a model (which costs far more than a sample: compile once where it counts)."""
    return model if isinstance(model, Tracker) else compile_model(model)


def next_location(tracker: Tracker, location: str, symbol: str) -> tuple[str | None, bool]:
    """Where `symbol` leads from `location` (None: nowhere, the stay goes on) and whether an edge says so.

    UNKNOWN always leads to the initial location; a symbol without an edge follows the tracker's policy.
    """
    if symbol == UNKNOWN:
        return tracker.model.sha.initial, True
    target = tracker.moves.get((location, symbol))
    if target is not None or tracker.policy == "ignore":
        return target, target is not None
    return tracker.fallback.get(symbol, tracker.model.sha.initial), False


def _constant(p: Mapping[str, float]) -> tuple[Step, Speed]:
    # All that does not change is worked out here, once a model, and kept in the closures: a step is then a few
    # products.
    density = p["noise"] ** 2
    return lambda age, dt: (1.0, 0.0, density * dt), lambda x, target, age: 0.0


def _linear(p: Mapping[str, float]) -> tuple[Step, Speed]:
    density = p["noise"] ** 2
    return lambda age, dt: (1.0, dt, density * dt), lambda x, target, age: abs(target)


def _relaxing_step(p: Mapping[str, float]) -> tuple[Step, Speed]:
    k, settled = p["k"], p["noise"] ** 2 / (2.0 * p["k"])

    def step(age: float, dt: float) -> tuple[float, float, float]:
        # 1 - decay^2 = -lost (2 + lost) needs one exponential for both, and loses nothing when k dt is small.
        lost = expm1(-k * dt)
        return 1.0 + lost, -lost, -settled * lost * (2.0 + lost)

    return step, lambda x, target, age: k * abs(target - x)


def _logarithmic(p: Mapping[str, float]) -> tuple[Step, Speed]:
    density, t0 = p["noise"] ** 2, p["t0"]

    def step(age: float, dt: float) -> tuple[float, float, float]:
        return 1.0, log1p(dt / (t0 + age)), density * dt

    return step, lambda x, target, age: abs(target) / (t0 + age)


def _transient(p: Mapping[str, float]) -> tuple[Step, Speed]:
    density, tau = p["noise"] ** 2, p["tau"]

    def step(age: float, dt: float) -> tuple[float, float, float]:
        return 1.0, exp(-age / tau) * -expm1(-dt / tau), density * dt

    return step, lambda x, target, age: abs(target) / tau * exp(-age / tau)


_SCALAR: dict[str, Callable[[Mapping[str, float]], tuple[Step, Speed]]] = {
    "constant": _constant,
    "linear": _linear,
    "exponential": _relaxing_step,
    "driven": _relaxing_step,
    "logarithmic": _logarithmic,
    "transient": _transient,
}
