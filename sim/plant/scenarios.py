"""The seeded scenarios cd1..cd17, with the properties of the thesis's traces, and production over several days.

They are synthetic: no plant made them. What is known of the thesis's traces and kept here: cd1 has 401 rows in about
444 s and about 47 events; cd2 is unusually cold; cd5 and cd10 have rapid load transients and long low-power idling; cd8
warms from 18 to 29 degC at a stable load; cd17 is longer, with several load changes.
"""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from sim.plant.decanter import DecanterPlant, Phase, Weather, simulate_decanter
from sim.sha import Trace

EPOCH_S = 1_736_499_600.0
"""2025-01-10 09:00:00 UTC: scenario cdN starts N hours later, so that no two overlap."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What a cd trace is made of: `bearing` is its temperature at the start (degC), `rows` cuts it to so many rows."""

    phases: tuple[Phase, ...]
    bearing: float
    weather: Weather = field(default_factory=Weather)
    period: float = 1.11
    rows: int | None = None
    what: str = ""


def _rest(seconds: float) -> Phase:
    return Phase(seconds, running=False, pump=False)


def _idle(seconds: float) -> Phase:
    return Phase(seconds, running=True, load=0.0, swing=4.0, pump=False)


def _feed(seconds: float, load: float, swing: float = 15.0, memory: float = 20.0) -> Phase:
    return Phase(seconds, running=True, load=load, swing=swing, memory=memory)


def _transients(count: int, low: float, high: float, seconds: float) -> tuple[Phase, ...]:
    """A feed that is switched between two loads every `seconds`."""
    return tuple(_feed(seconds, high if index % 2 else low, swing=10.0) for index in range(count))


SCENARIOS: dict[str, Scenario] = {
    "cd1": Scenario(
        (_rest(12), _feed(480, 197.0, 60.0, 7.0)), 21.0, period=1.122, rows=401, what="wandering load, about 47 events"
    ),
    "cd2": Scenario((_rest(20), _feed(430, 160.0, 25.0)), 5.5, Weather(4.0, 2.0, 8.0), what="unusually cold"),
    "cd3": Scenario((_rest(15), _feed(500, 230.0, 30.0, 15.0)), 24.0, what="high load"),
    "cd4": Scenario((_rest(10), _feed(260, 150.0, 30.0), _rest(120), _feed(200, 180.0, 30.0)), 26.0, what="restart"),
    "cd5": Scenario(
        (_rest(10), _idle(250), *_transients(14, 90.0, 260.0, 18.0), _idle(220)),
        22.0,
        what="rapid transients, long idling",
    ),
    "cd6": Scenario((_rest(15), _feed(600, 120.0, 20.0)), 20.0, what="low load"),
    "cd7": Scenario((_rest(10), _feed(220, 260.0, 40.0, 12.0), _rest(260)), 27.0, what="hard run, then cooling"),
    "cd8": Scenario((_feed(700, 230.0, 2.0, 40.0),), 18.0, Weather(18.0), what="18 to 29 degC, stable"),
    "cd9": Scenario((_rest(25), _feed(420, 205.0, 35.0, 14.0)), 30.0, Weather(22.0), what="warm hall"),
    "cd10": Scenario(
        (_rest(10), _idle(320), *_transients(18, 80.0, 280.0, 14.0), _idle(280)),
        23.0,
        what="rapid transients, long idling",
    ),
    "cd11": Scenario((_rest(20), _feed(380, 175.0, 30.0, 18.0), _rest(90)), 19.0, what="one run with its end"),
    "cd12": Scenario((_rest(10), *_transients(8, 130.0, 230.0, 60.0)), 25.0, what="slow load steps"),
    "cd13": Scenario((_rest(15), _feed(470, 245.0, 35.0, 12.0)), 33.0, Weather(25.0), what="hot, high load"),
    "cd14": Scenario((_rest(30), _idle(180), _feed(300, 165.0, 25.0)), 20.5, what="idling before the feed"),
    "cd15": Scenario(
        (_rest(10), _feed(150, 190.0, 30.0), _idle(150), _feed(200, 220.0, 30.0)), 24.5, what="feed pause"
    ),
    "cd16": Scenario((_rest(400), _feed(200, 150.0, 20.0)), 41.0, what="cooling after a run, short run"),
    "cd17": Scenario(
        (
            _rest(30),
            _feed(420, 150.0, 22.0, 25.0),
            _feed(360, 240.0, 28.0, 25.0),
            _idle(200),
            _feed(420, 185.0, 25.0, 25.0),
            _rest(170),
            _feed(480, 225.0, 28.0, 25.0),
            _feed(320, 120.0, 15.0, 25.0),
        ),
        20.0,
        what="longer, several load changes",
    ),
}


def scenario(name: str, seed: int = 0) -> Trace:
    """The scenario `name` of SCENARIOS; `seed` 0 is the reference set. Raises ValueError with the known names."""
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}: known are {', '.join(SCENARIOS)}")
    spec, number = SCENARIOS[name], int(name.removeprefix("cd"))
    trace = simulate_decanter(
        spec.phases,
        seed=1000 * seed + number,
        name=name,
        period=spec.period,
        start=EPOCH_S + 3600.0 * number,
        bearing=spec.bearing,
        weather=spec.weather,
    )
    if spec.rows is None:
        return trace
    return trace.between(trace.times[0], float(np.nextafter(trace.times[spec.rows - 1], np.inf)))


def _working_day(cycles: int, rng: np.random.Generator) -> list[Phase]:
    """Phases of 24 h: `cycles` runs with loads of their own, idling between feeds, and a rest until midnight."""
    phases: list[Phase] = [_rest(6.5 * 3600 + 1800 * rng.random())]
    room = 15.0 * 3600 / cycles
    for _ in range(cycles):
        share = 0.45 + 0.25 * rng.random()
        for _ in range(3):
            load = float(rng.uniform(110, 270))
            phases.append(_feed(share * room / 3 - 120, load, swing=float(rng.uniform(8, 30)), memory=60.0))
            phases.append(_idle(120))
        phases.append(_rest((1 - share) * room))
    phases.append(_rest(max(0.0, 86400 - sum(phase.seconds for phase in phases))))
    return phases


def production(
    days: int,
    cycles: int = 4,
    *,
    seed: int,
    period: float = 10.0,
    plant: DecanterPlant | None = None,
    name: str = "production",
) -> Trace:
    """`days` days of `cycles` runs each, one row every `period` seconds. Raises ValueError below one of each."""
    if days < 1 or cycles < 1:
        raise ValueError("production needs at least one day and one cycle a day")
    rng = np.random.default_rng([seed, days, cycles])
    phases = [phase for _ in range(days) for phase in _working_day(cycles, rng)]
    return simulate_decanter(
        phases, seed=seed, name=name, period=period, jitter=0.02, start=EPOCH_S - EPOCH_S % 86400, plant=plant, step=2.0
    )


def history_and_day(seed: int = 0) -> tuple[list[Trace], Trace]:
    """What a gateway at a plant would have: three days of production every 10 s, and 56 minutes of another day.

    It begins two minutes before the drum starts, has one row every 2 s, and shares no seed with the history.
    """
    days = production(3, seed=2 * seed + 1, name="history")
    first = float(days.times[0])
    cuts = [first + 86400.0 * day for day in range(4)]
    history = [
        replace(days.between(start, end), name=f"history_day{number}")
        for number, (start, end) in enumerate(pairwise(cuts), start=1)
    ]
    day = production(1, seed=2 * seed + 102, period=2.0, name="new_day")
    start = float(day.times[np.argmax(day.signals["MarciaDecanter"] > 0)])
    return history, day.between(start - 120.0, start + 3240.0)
