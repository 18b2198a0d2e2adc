"""What happens at which minute of the day, and what must come of it, by what the documents promise.

Nothing here is taken from the gateway: alarms are derived from the readings that the software PLC shows, by their
descriptions in docs/alarms.md, and their states by ISA-18.2. Times are plant seconds from the day's beginning.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import exp

import numpy as np

from sim.sha.trace import Array, Trace

MACHINES = ("north", "south", "west")
HOT, COOL = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
RUNNING, CURRENT = "MarciaDecanter", "Assorbimento"
STEP, ROW = 10.0, 2.0
"""Plant seconds between two readings, and between two rows of a trace."""
MINUTE, CYCLE = 60.0, 20.0 * 60.0
SHORTEST_HOURS = 4.0
"""So many hours hold all that happens; in a longer day the same happens with more quiet between."""

# A cycle: rest, then running at these currents (A) from these minutes on; the targets (degC) are of stays.
STARTS_AT = 7.0
COURSE = ((0.0, False, 5.0), (STARTS_AT, True, 150.0), (13.0, True, 250.0), (17.0, True, 150.0))
TARGETS = {(False, 5.0): 20.0, (True, 150.0): 50.0, (True, 250.0): 60.0}
TIME_CONSTANTS = {False: 450.0, True: 450.0}
SCATTER, SENSOR = 0.3, 0.1
"""degC: how targets differ from stay to stay, and the noise of a reading."""
COOLER = 4.0
"""By how much (degC) the other bearing is cooler."""
WORN = 8.0
"""degC by which the worn machine runs warmer."""

LIMIT, DEADBAND, AHEAD, OFF_DELAY = 80.0, 2.0, 300.0, 10.0
NORTHBOUND_DELAY, LINK_DELAY, INPUTS_DELAY = 180.0, 10.0, 30.0
OPERATOR = "operator"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """When what happens (s)."""

    length: float
    freeze: tuple[float, float]
    outage: tuple[float, float]
    link: tuple[float, float]
    overheat: float
    worn: tuple[float, float]
    shelve: float
    flood: float


def plan(hours: float) -> Plan:
    """The day of so many hours. Raises ValueError for one in which not everything has its place."""
    if hours < SHORTEST_HOURS:
        raise ValueError(f"{hours:g} hours are too few for all that happens; give {SHORTEST_HOURS:g} or more")

    def at(cycle: int, minutes: float) -> float:
        # Whole cycles apart, so that everything meets the same phase of its cycle in every day.
        return round(cycle * hours / SHORTEST_HOURS) * CYCLE + minutes * MINUTE

    return Plan(
        length=hours * 3600.0,
        freeze=(at(1, 12.0), at(1, 32.0)),
        outage=(at(3, 2.0), at(3, 12.0)),
        link=(at(3, 4.0), at(3, 10.0)),
        overheat=at(4, 7.0),
        worn=(at(4, 0.0), at(4, 3 * CYCLE / MINUTE)),
        shelve=at(8, 0.0),
        flood=at(8, 9.0),
    )


# ---------------------------------------------------------------- what the PLCs show


def traces(day: Plan, seed: int) -> dict[str, Trace]:
    """What each machine's PLC replays."""
    rng = np.random.default_rng(seed)
    return {machine: _trace(day, machine, rng) for machine in MACHINES}


def _trace(day: Plan, machine: str, rng: np.random.Generator) -> Trace:
    times: Array = np.arange(round((day.length + 600.0) / ROW), dtype=np.float64) * ROW
    running, current, base = np.zeros_like(times), np.zeros_like(times), np.zeros_like(times)
    temperature, former, target = 20.0, (False, -1.0), 20.0
    for row, time in enumerate(times.tolist()):
        on, load = next((on, load) for minute, on, load in reversed(COURSE) if time % CYCLE >= minute * MINUTE)
        if (on, load) != former:
            former, target = (on, load), TARGETS[on, load] + rng.normal(0.0, SCATTER)
        worn = WORN if machine == "west" and on and day.worn[0] <= time < day.worn[1] else 0.0
        running[row], current[row], base[row] = on, load, temperature
        temperature = target + worn + (temperature - target - worn) * exp(-ROW / TIME_CONSTANTS[on])
    extra: Array = np.zeros_like(times)
    if machine == "north":
        extra = extra + _hump(times - day.overheat, rise=14.0, hold=2.0, fall=14.0, height=48.0)
    flooded = _hump(times - day.flood, rise=12.0, hold=2.0, fall=20.0, height=45.0)
    signals = {
        RUNNING: running,
        CURRENT: current,
        HOT: base + extra + flooded + rng.normal(0.0, SENSOR, times.size),
        COOL: base - COOLER + flooded + rng.normal(0.0, SENSOR, times.size),
    }
    return Trace(machine, times, signals, origin="a scripted day", synthetic=True)


def _hump(since: Array, *, rise: float, hold: float, fall: float, height: float) -> Array:
    """degC, linear up to `height` and down again; minutes."""
    at = np.cumsum([0.0, rise, hold, fall]) * MINUTE
    found: Array = np.interp(since, at, [0.0, height, height, 0.0])
    return found


def shown(day: Plan, machine: str, trace: Trace) -> dict[str, Array]:
    """The readings as they stand in the PLC's registers, row by row: as in the trace, but for the sensor that froze."""
    found = dict(trace.signals)
    if machine == "south":
        frozen = found[COOL].copy()
        stands = (trace.times >= day.freeze[0]) & (trace.times < day.freeze[1])
        frozen[stands] = frozen[int(np.argmax(stands))]
        found[COOL] = frozen
    return found


# ---------------------------------------------------------------- what must come of it


@dataclass(frozen=True, slots=True)
class Occurrence:
    """What moves an alarm, not before `earliest` and not after `latest` (s)."""

    change: str
    earliest: float
    latest: float


@dataclass(frozen=True, slots=True)
class Step:
    """A row that the journal must have, within these times (s); `by` begins who did it ("": nobody)."""

    state: str
    earliest: float
    latest: float
    by: str = ""


@dataclass(frozen=True, slots=True)
class Action:
    """What the operator does with an alarm at a time (s); a shelving for so many minutes."""

    time: float
    machine: str
    alarm: str
    change: str = "acknowledge"
    minutes: float | None = None


@dataclass(frozen=True, slots=True)
class Expected:
    """The rows that every alarm must have (alarms that are not here must have none), and which may come besides.

    `may` are kinds of alarms that the model raises by its own judgement, by machine; of these only the moves are
    looked at.
    """

    lives: Mapping[tuple[str, str], Sequence[Step]]
    actions: Sequence[Action]
    may: Mapping[str, frozenset[str]] = field(default_factory=dict)


MOVES: Mapping[tuple[str, str], str] = {
    ("normal", "raise"): "unacknowledged",
    ("unacknowledged", "acknowledge"): "acknowledged",
    ("unacknowledged", "clear"): "returned unacknowledged",
    ("acknowledged", "clear"): "normal",
    ("returned unacknowledged", "raise"): "unacknowledged",
    ("returned unacknowledged", "acknowledge"): "normal",
    ("normal", "shelve"): "shelved",
    ("shelved", "raise"): "shelved",
    ("shelved", "clear"): "shelved",
    ("shelved", "unshelve"): "normal",
}
"""ISA-18.2 for alarms that do not latch; what is shelved here is normal before, and over when it comes out."""


def steps(occurrences: Sequence[Occurrence]) -> list[Step]:
    """The states that occurrences lead through. Raises KeyError for a move that there is not."""
    state, found = "normal", []
    for one in sorted(occurrences, key=lambda one: one.earliest):
        state = MOVES[state, one.change]
        by = OPERATOR if one.change in ("acknowledge", "shelve") else "the gateway" if one.change == "unshelve" else ""
        found.append(Step(state, one.earliest, one.latest, by))
    return found


def expected(day: Plan, played: Mapping[str, Trace], *, late: float, retry: float) -> Expected:
    """What must come of the day. `late` (s) is how late a reading may be seen, `retry` until a broker that is back is
    found."""
    lives: dict[tuple[str, str], list[Occurrence]] = {}
    actions: list[Action] = []

    def pair(machine: str, alarm: str, begin: float, end: float, *, more: float = 0.0) -> None:
        own = lives.setdefault((machine, alarm), [])
        own.append(Occurrence("raise", begin - STEP, begin + late))
        own.append(Occurrence("clear", end - STEP, end + late + more))

    def acknowledged(machine: str, alarm: str, time: float) -> None:
        actions.append(Action(time, machine, alarm))
        lives[machine, alarm].append(Occurrence("acknowledge", time, time + late))

    for number, (machine, trace) in enumerate(played.items()):
        seen = shown(day, machine, trace)
        for place, tag in enumerate((HOT, COOL)):
            over = list(_spans(trace.times, seen[tag], LIMIT, DEADBAND))
            rising = list(_spans(*_straight_on(trace.times, seen[tag]), LIMIT, DEADBAND))
            for begin, end in over:
                pair(machine, f"over limit {tag}", begin, end)
                # In the flood nobody comes to it until it is over; else the operator answers at once.
                flood = begin >= day.flood
                slot = (4 * number + 2 * place) * 30.0
                acknowledged(machine, f"over limit {tag}", day.flood + 40 * MINUTE + slot if flood else begin + 240.0)
            for begin, end in rising:
                name = f"rising {tag}"
                pair(machine, name, begin, end)
                flood = begin >= day.flood
                slot = (4 * number + 2 * place + 1) * 30.0
                if (machine, tag) != ("south", COOL):
                    acknowledged(machine, name, day.flood + 40 * MINUTE + slot if flood else end + late + 240.0)
    shelved, minutes = ("south", f"rising {COOL}"), 40.0
    actions.append(Action(day.shelve, *shelved, "shelve", minutes))
    end = day.shelve + minutes * MINUTE
    lives[shelved] += [
        Occurrence("shelve", day.shelve, day.shelve + late),
        Occurrence("unshelve", end, end + 2 * late),
    ]

    frozen = f"sensor frozen {COOL}"
    begin = _frozen_at(day, played["south"])
    pair("south", frozen, begin, day.freeze[1] + OFF_DELAY, more=STEP)
    acknowledged("south", frozen, begin + 300.0)

    pair("west", "link", day.link[0] + LINK_DELAY, day.link[1] + OFF_DELAY, more=late)
    pair("west", "inputs bad", day.link[0] + INPUTS_DELAY, day.link[1], more=late)
    for alarm in ("link", "inputs bad"):
        acknowledged("west", alarm, day.link[1] + 4 * late + 300.0)
    # The plant has it once, and its first machine looks after it.
    pair(MACHINES[0], "northbound", day.outage[0] + NORTHBOUND_DELAY, day.outage[1], more=retry)
    acknowledged(MACHINES[0], "northbound", day.outage[1] - 120.0)

    # The third start after the wear began judges the third bad cycle; the first good one is judged by the start after.
    third = day.worn[0] + 3 * CYCLE + STARTS_AT * MINUTE
    pair("west", "drift", third, third + CYCLE)
    acknowledged("west", "drift", third + 300.0)

    doubts = frozenset({"predicted over limit", "anomaly", "review"})
    return Expected(
        {key: steps(own) for key, own in lives.items()},
        sorted(actions, key=lambda action: action.time),
        dict.fromkeys(MACHINES, doubts),
    )


def _spans(times: Array, values: Array, limit: float, deadband: float) -> Iterator[tuple[float, float]]:
    """When a value came above the limit, and when it had been below it by the deadband for the off-delay."""
    begun: float | None = None
    over: float | None = None
    for time, value in zip(times.tolist(), values.tolist(), strict=True):
        if begun is None and value > limit:
            begun = time
        elif begun is not None and value <= limit - deadband:
            over = time if over is None else over
            if time - over >= OFF_DELAY:
                yield begun, time
                begun = over = None
        else:
            over = None


def _straight_on(times: Array, values: Array) -> tuple[Array, Array]:
    """Where the straight line through the readings of the last 300 s is 300 s later (least squares), as they come."""
    each, window = round(STEP / ROW), round(AHEAD / STEP) + 1
    times, values = times[::each], values[::each]
    found: Array = np.full_like(values, -np.inf)
    for row in range(window, values.size):
        own = slice(row - window + 1, row + 1)
        slope, height = np.polyfit(times[own] - times[row], values[own], 1)
        found[row] = height + slope * AHEAD
    return times, found


def _frozen_at(day: Plan, trace: Trace) -> float:
    """When the other bearing has moved by 2 degC, and two minutes are over."""
    moved = np.abs(trace.signals[HOT] - np.interp(day.freeze[0], trace.times, trace.signals[HOT])) >= 2.0
    return float(trace.times[moved & (trace.times > day.freeze[0] + 120.0)][0])
