"""Small models that the tests of belief and forecast share, and a plain simulator written apart from the product's."""

from collections.abc import Mapping, Sequence

import numpy as np

from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Input, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model, Stay
from sim.sha.trace import Event, Trace


def normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def relaxing(k: float, noise: float, inputs: Sequence[Input] = ()) -> Flow:
    return Flow("driven" if inputs else "exponential", {"k": k, "noise": noise}, tuple(inputs))


def single(
    flow: Flow, law: Distribution | None, sensor: float = 0.1, entry: Entry = "parameter", **limits: float
) -> Model:
    """One location without edges."""
    return Model(SHA("single", (Location("q", flow, law, entry),), (), "q", **limits), DECANTER, "T", sensor)


def two_states(
    stays: Mapping[str, Stay] | None = None,
    sensor: float = 0.1,
    gain: float = 0.0,
    calibration: Mapping[float, float] | None = None,
    max_rate: float = float("inf"),
) -> Model:
    """`cold` (to 25 +- 1 degC) and `hot` (to 70 +- 3 degC, driven by the current when `gain` is not 0)."""
    inputs = [Input("A", gain, 50.0)] if gain else []
    sha = SHA(
        "two",
        (
            Location("cold", relaxing(0.004, 0.03), normal(25.0, 1.0)),
            Location("hot", relaxing(0.006, 0.05, inputs), normal(70.0, 3.0)),
        ),
        (Edge("cold", "W_ON", "hot"), Edge("hot", "W_OFF", "cold")),
        "cold",
        max_rate=max_rate,
    )
    return Model(sha, DECANTER, "T", sensor, semi_markov=stays or {}, calibration=calibration or {})


def exponential_stays(cold: float = 60.0, hot: float = 90.0) -> dict[str, Stay]:
    return {
        "cold": Stay(Distribution("exponential", {"mean": cold}), {"hot": 1.0}),
        "hot": Stay(Distribution("exponential", {"mean": hot}), {"cold": 1.0}),
    }


def simulate_two(model: Model, seconds: int, rng: np.random.Generator, start: float = 30.0) -> tuple[Trace, np.ndarray]:
    """A trace of `two_states` at 1 Hz with exponential stays, by its own plain loop, and the true temperatures."""
    temperature, place, m = start, "cold", rng.normal(25.0, 1.0)
    left = rng.exponential(60.0)
    events: list[Event] = []
    true = np.empty(seconds)
    for second in range(seconds):
        true[second] = temperature
        done = 0.0
        while done < 1.0:
            dt = min(1.0 - done, left)
            k, s = (0.004, 0.03) if place == "cold" else (0.006, 0.05)
            decay = np.exp(-k * dt)
            temperature = m + (temperature - m) * decay + s * np.sqrt((1 - decay**2) / (2 * k)) * rng.standard_normal()
            done, left = done + dt, left - dt
            if left <= 0:
                place, law, symbol, mean = (
                    ("hot", (70.0, 3.0), "W_ON", 90.0) if place == "cold" else ("cold", (25.0, 1.0), "W_OFF", 60.0)
                )
                m, left = rng.normal(*law), rng.exponential(mean)
                events.append(Event(second + done, symbol))
    times = np.arange(float(seconds))
    readings = true + model.sensor_sigma * rng.standard_normal(seconds)
    return Trace("made", times, {"T": readings}, tuple(e for e in events if e.time <= times[-1]), synthetic=True), true
