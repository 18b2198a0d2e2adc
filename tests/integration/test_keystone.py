"""The keystone: a known automaton -> software PLC -> Modbus -> gateway -> historian -> learner -> the same one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gateway.store.read_back import events, to_trace
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.lab.learning.bins.learn import Learned, learn_bins
from sim.lab.learning.structure import announcements
from sim.sha.automaton import SHA, transitions
from sim.sha.events import DECANTER, encode
from sim.sha.trace import UNKNOWN, Event, Trace
from tests.rig.no_bands import without_bands
from tests.rig.pair import CURRENT, RATES, RUNNING, TARGETS, TEMPERATURE, known_model, make_rig

SPEED = 50.0
PERIOD = 3.2
"""Plant seconds between two scans, 64 ms of real time: a fortieth of the fastest time constant."""
CYCLES = 5
SHORTEST_STAY = 50.0
LONGEST_GAP = 0.6 * SHORTEST_STAY
"""Plant seconds without a reading after which a trip tells of the computer, not of the gateway: 0.4 s of real time."""
TRIES = 3
REACH = 35.0
"""A by which the currents of a stay lie beside the middle of their bin, at most."""
MOST_MOVED = 2.0
"""degC by which a target may move over that reach, where one that followed the current from bin to bin would by 5.25:
how late a busy computer reads decides by chance whether a gain that says nothing is kept."""


def plan(rng: np.random.Generator) -> list[tuple[float, float]]:
    """(current, seconds) of each stay, 0 A for rest: in each cycle all bins in a drawn order and two once more.

    The currents lie all over their bins, so that a target which followed them would be told from one that does not.
    """
    stays = [(0.0, 60.0)]
    for _ in range(CYCLES):
        order = [int(place) for place in (*rng.permutation(4), *rng.permutation(4)[:2])]
        for number, place in enumerate(order):
            place = (place + 1) % 4 if number and place == order[number - 1] else place
            order[number] = place
            middle, reach = (325.0, 15.0) if place == 3 else (50.0 + 100.0 * place, REACH)
            stays.append((middle + float(rng.uniform(-reach, reach)), float(rng.uniform(SHORTEST_STAY, 85.0))))
        stays.append((0.0, float(rng.uniform(120.0, 170.0))))
    return stays


def known_trace(seed: int) -> Trace:
    """The known automaton's exact course under a drawn current, one row a second."""
    rng = np.random.default_rng(seed)
    stays = plan(rng)
    level = np.concatenate([np.full(round(seconds), amperes) for amperes, seconds in stays])
    times = np.arange(level.size, dtype=float)
    running = (level > 0).astype(float)
    current = np.where(running > 0, level + rng.uniform(-8.0, 8.0, level.size), rng.uniform(0.0, 2.0, level.size))
    inputs = Trace("inputs", times, {RUNNING: running, CURRENT: current})
    steps = schedule(known_model(), encode(inputs, DECANTER), times)
    course = simulate(steps, TARGETS["OFF/0-100"], 1, rng)
    assert course.flags == ()
    signals = {**inputs.signals, TEMPERATURE: course.temperatures[0]}
    return Trace("keystone", times, signals, origin=f"known automaton, seed {seed}", synthetic=True)


def changes(word: Sequence[Event]) -> list[str]:
    """The word without announcements: only symbols that tell of a channel what was not the last thing told of it."""
    owner = {symbol: number for number, channel in enumerate(DECANTER.channels) for symbol in announcements(channel)}
    known: dict[int, str] = {}
    told = []
    for event in word:
        if event.symbol != UNKNOWN and known.get(owner[event.symbol]) != event.symbol:
            known[owner[event.symbol]] = event.symbol
            told.append(event.symbol)
    return told


def visited(sha: SHA, word: Sequence[str]) -> list[str]:
    """The locations that a word leads through."""
    moves, here = transitions(sha), [sha.initial]
    for symbol in word:
        here.append(moves[here[-1], symbol])
    return here


@dataclass(frozen=True)
class RoundTrip:
    """What went in, what the gateway has stored of it, what it saw while it ran, and what was learned."""

    given: Trace
    stored: Trace
    online: tuple[Event, ...]
    learned: Learned


def travel(folder: Path) -> RoundTrip:
    """Replay the known trace, let the gateway read it, and learn from what its historian holds.

    On a computer that stood still for most of a stay the gateway had no chance to see it: such a trip is made again.
    """
    given = known_trace(seed=18)
    gaps = []
    for number in range(TRIES):
        (at := folder / f"trip{number}").mkdir()
        stored, online = replayed(at, given)
        readings = stored.times[np.isfinite(stored.signals[CURRENT]) & np.isfinite(stored.signals[RUNNING])]
        gaps.append(float(np.diff(readings).max()))
        if gaps[-1] <= LONGEST_GAP:
            learned = learn_bins([replace(stored, synthetic=True)], DECANTER, TEMPERATURE, seed=0)
            return RoundTrip(given, stored, online, learned)
    raise AssertionError(f"no trip in {TRIES} was read without a gap of {LONGEST_GAP:g} s; the longest in each: {gaps}")


def replayed(folder: Path, given: Trace) -> tuple[Trace, tuple[Event, ...]]:
    """What the historian holds of one replay of the trace, and the events that the gateway saw meanwhile."""
    rig = make_rig(folder, given, period=PERIOD, speed=SPEED)
    with rig.plc("--hold", "--cycle", "0.005") as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(lambda status: status["link"]["alive"] and status["writeback"]["accepted"] > 0)
        begin = plc.order("start")["plant_time"]
        end = plc.wait_for("end_of_trace")["plant_time"]
        code, _ = gateway.stop()
        assert code == 0, gateway.words()
    stored = to_trace(rig.historian, start=begin, end=end)
    return stored, tuple(event for event in events(rig.historian) if event.time < end)


def assert_the_same_word(trip: RoundTrip) -> None:
    """Stored and seen online: the word that the known automaton was given."""
    given = changes(encode(trip.given, DECANTER))
    assert len(given) > 30
    assert changes(encode(trip.stored, DECANTER)) == given
    assert changes(trip.online) == given


def assert_the_same_locations(trip: RoundTrip) -> None:
    """The word leads through the same locations, and those and no others were fitted."""
    known, word = known_model().sha, changes(encode(trip.given, DECANTER))
    sha = trip.learned.model.sha
    assert visited(sha, word) == visited(known, word)
    assert sha.initial == known.initial
    assert set(transitions(sha).items()) == set(transitions(known).items())
    fitted = {one.name for one in trip.learned.locations if one.source == "fitted"}
    assert fitted == set(TARGETS)
    assert {name for name in visited(known, word) if name in TARGETS} == set(TARGETS)


def assert_the_same_flow(trip: RoundTrip, name: str) -> None:
    """Target within three standard errors and 0.5 degC, rate within 15 %, and inside a bin the current has no say."""
    one = next(one for one in trip.learned.locations if one.name == name)
    assert abs(one.mu - TARGETS[name]) < 3.0 * one.mu_error + 0.5, one
    assert one.mu_error < 1.0
    assert one.k == pytest.approx(RATES[name.partition("/")[0]], rel=0.15), one
    flow = trip.learned.model.sha.by_name[name].flow
    assert flow.kind in ("exponential", "driven")
    assert sum(abs(driver.gain) * REACH for driver in flow.inputs) < MOST_MOVED, one


def assert_the_same_course(trip: RoundTrip) -> None:
    """Open loop over the whole trace, from its first temperature: the two automata say the same."""
    word = encode(trip.given, DECANTER)
    free = [
        simulate(
            schedule(sha, word, trip.given.times, inputs=trip.given),
            TARGETS["OFF/0-100"],
            200,
            np.random.default_rng(1),
        )
        for sha in (known_model().sha, trip.learned.model.sha)
    ]
    known, learned = (runs.temperatures.mean(axis=0) for runs in free)
    assert np.sqrt(np.mean((known - learned) ** 2)) < 1.0


def test_a_known_automaton_comes_back_from_plc_fieldbus_gateway_historian_and_learner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    trip = travel(tmp_path)
    assert_the_same_word(trip)
    assert_the_same_locations(trip)
    for name in TARGETS:
        assert_the_same_flow(trip, name)
    assert_the_same_course(trip)
