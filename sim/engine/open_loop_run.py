"""A model let run along a measured trace without looking at it again, and how far off it comes out."""

from dataclasses import dataclass
from math import nan
from typing import Literal

import numpy as np

from sim.engine.moment_equations import Prediction, moments
from sim.engine.schedules import Policy, Schedule, schedule
from sim.sha import Array, Distribution, Model, Trace, distributions

Start = Literal["measured", "law"]
"""Where an open-loop run starts: at the first measured temperature, or at the model's initial law."""


@dataclass(frozen=True, slots=True)
class Score:
    """Root mean square, mean absolute and mean (predicted - measured) error in degC over `count` instants.

    Without any instant the errors are NaN.
    """

    rmse: float
    mae: float
    bias: float
    count: int


@dataclass(frozen=True, slots=True)
class Errors:
    """A prediction against a trace, three views that are not to be mixed.

    `at_events`: at the event times, against the reading held there (the thesis's way). `at_samples`: at every reading
    of the sensor. `final`: predicted - measured at the last reading (degC), `final_percent` its size in percent of
    the measured value (NaN when that is 0 degC).
    """

    at_events: Score
    at_samples: Score
    final: float
    final_percent: float


def readings(trace: Trace, signal: str) -> tuple[Array, Array]:
    """Times and values (degC) of the readings of `signal`. Raises ValueError when there is none."""
    if signal not in trace.signals:
        raise ValueError(f"trace {trace.name!r} has no signal {signal!r}; it has {', '.join(trace.signals) or 'none'}")
    read = np.isfinite(trace.signals[signal])
    if not read.any():
        raise ValueError(f"trace {trace.name!r}: signal {signal!r} has no reading")
    return trace.times[read], trace.signals[signal][read]


def open_loop_schedule(model: Model, trace: Trace, policy: Policy = "reject") -> Schedule:
    """The steps from the first reading of the temperature to the last, with an output at each reading and event."""
    times, _ = readings(trace, model.temperature)
    events = np.array([event.time for event in trace.events], dtype=float)
    events = events[(events >= times[0]) & (events <= times[-1])]
    outputs = np.union1d(times, events)
    return schedule(model, trace.events, outputs, inputs=trace, policy=policy)


def start_law(model: Model, trace: Trace, start: Start = "measured") -> Distribution:
    """The law of X0: the first reading (without spread), or the model's initial law, which `law` demands."""
    if start == "law":
        if model.initial is None:
            raise ValueError(f"model {model.sha.name!r} has no initial law; start at the measured temperature")
        return model.initial
    return Distribution("normal", {"mu": float(readings(trace, model.temperature)[1][0]), "sigma": 0.0})


def open_loop(model: Model, trace: Trace, policy: Policy = "reject", start: Start = "measured") -> Prediction:
    """Mean and variance at every reading and event of an encoded trace, from its first reading on.

    Raises ValueError as `schedule` does, when the trace has no reading of the model's temperature, and when `law` is
    asked of a model without an initial law.
    """
    law = start_law(model, trace, start)
    steps = open_loop_schedule(model, trace, policy)
    return moments(steps, distributions.mean(law), distributions.variance(law))


def errors(prediction: Prediction, trace: Trace, signal: str) -> Errors:
    """How far the predicted mean is from the readings of `signal`.

    Raises ValueError when the prediction has no value at a reading within its time span.
    """
    times, values = readings(trace, signal)
    inside = (times >= prediction.times[0]) & (times <= prediction.times[-1])
    times, values = times[inside], values[inside]
    if times.size == 0:
        raise ValueError(f"trace {trace.name!r} has no reading of {signal!r} within the prediction's time span")
    predicted = _predicted_mean(prediction, times)
    events = np.array([event.time for event in trace.events], dtype=float)
    events = events[(events >= times[0]) & (events <= prediction.times[-1])]
    held = values[np.searchsorted(times, events, side="right") - 1]
    final = float(predicted[-1] - values[-1])
    return Errors(
        at_events=score(_predicted_mean(prediction, events) - held),
        at_samples=score(predicted - values),
        final=final,
        final_percent=100.0 * abs(final) / abs(float(values[-1])) if values[-1] else nan,
    )


def score(residual: Array) -> Score:
    """The score of residuals (predicted - measured)."""
    if residual.size == 0:
        return Score(nan, nan, nan, 0)
    return Score(
        rmse=float(np.sqrt(np.mean(residual**2))),
        mae=float(np.mean(np.abs(residual))),
        bias=float(np.mean(residual)),
        count=int(residual.size),
    )


def _predicted_mean(prediction: Prediction, times: Array) -> Array:
    """The predicted mean at `times`, each of which must be an output time; the last of equal ones counts."""
    row = np.searchsorted(prediction.times, times, side="right") - 1
    matches = (row >= 0) & (prediction.times[row] == times)
    if not matches.all():
        missing = float(times[int(np.argmin(matches))])
        raise ValueError(f"the prediction has no value at {missing:.3f} s: let it run at every reading and event")
    return prediction.mean[row]
