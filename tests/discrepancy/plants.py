"""A small plant with one hidden effect at will (one mass, two levels of heat, rough as plants are), and model runs."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.sha.automaton import SHA, Distribution, Edge, Effect, Flow, Location
from sim.sha.events import Alphabet, Bins, Switch, encode
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Array, Trace

ALPHABET = Alphabet(
    (Switch("MarciaDecanter", "W_ON", "W_OFF"), Bins("Assorbimento", (200.0,), ("A_0", "A_1"))), gap=600.0
)
TARGETS = {"OFF": (17.0, 1 / 3600), "LOW": (48.0, 1 / 1500), "HIGH": (62.0, 1 / 1500)}
PERIOD = 30.0


def model(shift: float = 0.0) -> Model:
    """The plant's own structure and parameters; `shift` moves the targets of the running locations (share)."""
    edges = [Edge(source, "W_OFF", "OFF") for source in TARGETS]
    edges += [Edge("OFF", "W_ON", "LOW"), Edge("OFF", "A_1", "OFF"), Edge("OFF", "A_0", "OFF")]
    edges += [
        Edge(source, symbol, target)
        for source in ("LOW", "HIGH")
        for symbol, target in (("A_0", "LOW"), ("A_1", "HIGH"))
    ]
    edges += [Edge(source, UNKNOWN, "OFF") for source in TARGETS]
    locations = tuple(
        Location(
            name,
            Flow("exponential", {"k": k, "noise": 0.004}),
            Distribution("normal", {"mu": target * (1 + shift * (name != "OFF")), "sigma": 0.5}),
        )
        for name, (target, k) in TARGETS.items()
    )
    return Model(SHA("small", locations, tuple(edges), "OFF"), ALPHABET, "T", 0.06)


def plant(
    seed: int,
    days: int = 4,
    *,
    pump: float = 0.0,
    churning: float = 0.0,
    offset: float = 0.0,
    bowl: float = 0.0,
    winding: float = 0.0,
    room: float = 0.0,
    runs_on: bool = False,
    period: float = PERIOD,
    more: Callable[[Array, Array, Array], tuple[Array, Array]] | None = None,
) -> Trace:
    """`days` days of three cycles, or one run of them all. `pump` 1/s cools towards 19 degC, `churning` degC/s dies
    away after each start over 400 s as a logistic, `winding` degC/s at 200 A goes with the square of the current and
    comes through two masses of 120 s and 60 s, `room` is the share of all heat
    that is lost to a room of its own days, `offset` degC is read too much from 40 % of the time on. A row
    each `period` s. `more` gives (heat in degC/s, loss in 1/s) of each row from times, running and current."""
    rng = np.random.default_rng(seed)
    size = int(days * 86400 / period)
    on, current, pumping = operation(rng, size, runs_on, period)
    temperature = np.empty(size)
    x, heat, friction, since, warmed = 17.0, 0.0, 1.0, 1e9, 0.0
    copper, rotor = 0.0, 0.0
    days_of_room = 17.0 + 6.0 * np.sin(2.0 * np.pi * period * np.arange(size) / 86400.0 + seed)
    feed = np.repeat(np.random.default_rng([seed, 1]).uniform(10.0, 40.0, size // 200 + 1), 200)[:size]
    gained, lost = np.zeros(size), np.zeros(size)
    if more is not None:
        gained, lost = more(1.7e9 + period * np.arange(size), on, current)
    for row in range(size):
        temperature[row] = x
        if row and on[row] > on[row - 1]:
            friction, since = 1.0 + 0.01 * rng.standard_normal(), 0.0
        target, k = TARGETS["OFF" if not on[row] else "LOW" if current[row] < 200 else "HIGH"]
        keep = np.exp(-period / 400.0)
        heat = keep * heat + 4e-4 * np.sqrt(1 - keep**2) * rng.standard_normal()
        drive = k * (target - x) + on[row] * ((friction - 1) * k * (target - 17.0) + heat)
        drive += room * k * (days_of_room[row] - 17.0)
        drive -= pump * pumping[row] * (x - 19.0)
        drive += churning * on[row] / (1 + np.exp(min((since - 400.0) / 100.0, 50.0)))
        warmed += period / 150.0 * (pumping[row] * (feed[row] - 22.0) - warmed)
        drive += bowl * warmed
        copper += (1.0 - np.exp(-period / 120.0)) * ((current[row] / 200.0) ** 2 - copper)
        rotor += (1.0 - np.exp(-period / 60.0)) * (copper - rotor)
        drive += winding * rotor
        drive += gained[row] - lost[row] * (x - 17.0)
        x += period * drive + 0.003 * np.sqrt(period) * rng.standard_normal()
        since += period
    read = temperature + 0.06 * rng.standard_normal(size)
    read[int(0.4 * size) :] += offset
    signals = {
        "MarciaDecanter": on,
        "Assorbimento": current,
        "MarciaPmpFango": pumping,
        "TAmbiente": 17.0 + np.cumsum(0.02 * rng.standard_normal(size)),
        "T": np.round(read, 1),
    }
    if room:
        signals["TAmbiente"] = days_of_room
    if bowl:
        signals["TFango"] = feed
    trace = Trace(f"plant{seed}", 1.7e9 + period * np.arange(size), signals, origin="a test's plant", synthetic=True)
    return replace(trace, events=encode(trace, ALPHABET))


def sparse(trace: Trace, every: int) -> Trace:
    """Every so-manyth row of a trace, as a slow recorder has them: what switches is known from the next row on."""
    kept = slice(None, None, every)
    signals = {name: column[kept] for name, column in trace.signals.items()}
    rows = replace(trace, times=trace.times[kept], signals=signals, events=())
    return replace(rows, events=encode(rows, ALPHABET))


def random_model(sigma: float, memory: float, machine: float, *more: Effect) -> Model:
    """The plant's model with heat (`sigma` degC/s) that has a `memory` (s); machines differ by `machine` degC."""
    made = model()
    places = tuple(
        replace(place, distribution=Distribution("normal", {"mu": TARGETS[place.name][0], "sigma": 0.2}))
        for place in made.sha.locations
    )
    effects = (
        Effect("heat-disturbance", {"sigma": sigma, "memory": memory}),
        Effect("machine-offset", {"sigma": machine}),
        *more,
    )
    return replace(made, sha=replace(made.sha, locations=places, effects=effects))


def simulated(source: Model, seed: int, days: int = 4) -> Trace:
    """`days` days of three cycles of the very automaton, everything that is random in it drawn, read to 0.1 degC."""
    rng = np.random.default_rng(seed)
    size = int(days * 86400 / PERIOD)
    on, current, pumping = operation(rng, size)
    signals = {"MarciaDecanter": on, "Assorbimento": current, "MarciaPmpFango": pumping}
    trace = Trace(f"drawn{seed}", 1.7e9 + PERIOD * np.arange(size), signals, synthetic=True)
    trace = replace(trace, events=encode(trace, ALPHABET))
    course = simulate(schedule(source.sha, trace.events, trace.times, inputs=trace, policy="resync"), 17.0, 1, rng)
    read = course.temperatures[0] + source.sensor_sigma * rng.standard_normal(size)
    return replace(trace, signals={**signals, "T": np.round(read, 1)})


def operation(
    rng: np.random.Generator, size: int, runs_on: bool = False, period: float = PERIOD
) -> tuple[Array, Array, Array]:
    """(running, current, pump) of so many rows: three cycles a day, or one run of them all."""
    on, current, pumping = np.zeros(size), np.zeros(size), np.zeros(size)
    hour = 3600 / period
    for begin in range(int(5 * hour), size, size if runs_on else int(24 * hour)):
        at = begin
        for _ in range(1 if runs_on else 3):
            end = size if runs_on else min(at + int(rng.uniform(2.5, 3.5) * hour), size)
            on[at:end] = 1
            while at < end:
                until = min(end, at + int(rng.uniform(0.3, 0.8) * hour))
                current[at:until] = rng.choice([150.0, 250.0]) + 5 * rng.standard_normal()
                pumping[at:until] = rng.random() < 0.6
                at = until
            at = end + int(rng.uniform(1.0, 2.0) * hour)
    return on, current, pumping
