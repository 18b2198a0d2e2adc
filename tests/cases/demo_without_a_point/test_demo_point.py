"""The demo replayed a trace that nothing could change: no alarm, no limit, a PLC that made nothing of the block."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gateway.demo.heat import alarm_rows, align_start, headline
from gateway.demo.lead_time import TRUE_WITHIN_S, ChancesAlong, alarm_times, score, trend_alarm
from sim.plant import heat_day, heat_history, uncontrolled_heat_day
from sim.plc.control import obey
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.live import LivePlant, live_plant
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from sim.plc.program.replay import TraceReplay
from sim.sha.trace import Trace
from tests.gateway.support import TEMPERATURE
from tests.plc.bench import DECANTER, block, crc
from tests.plc.test_writeback import tell

ALARM, SPEED, SEED = 19, 100.0, 3
"""The block's alarm word, plant seconds per second, the day."""


def saying(sequence: int, *, alarms: int, validity: int = 31) -> list[int]:
    words = block(sequence, sequence, validity=validity)[:24]
    words[ALARM] = alarms
    return [*words, crc(words), sequence]


def live() -> tuple[Plc, LivePlant]:
    """A PLC with its live plant, let go at 0 s."""
    plant = live_plant("heat", SEED, 80.0)
    replay = TraceReplay(plant.table, 0.0, rate=SPEED, held=True)
    plc = Plc(read_map(DECANTER), EmulatorClock(0.0, 0.0, SPEED, monotonic=lambda: 0.0), replay, plant=plant)
    plc.begin(0.0)
    return plc, plant


def acted_at(alarms: int, validity: int = 31, moment: float = 20.0) -> LivePlant:
    """The plant after the whole day, with one block at a moment (s)."""
    plc, plant = live()
    plc.cycle(moment)
    tell(plc, saying(1, alarms=alarms, validity=validity), moment)
    plc.cycle(100.0)
    return plant


@pytest.fixture(scope="module")
def without() -> Trace:
    return uncontrolled_heat_day(SEED)


def column(plant: LivePlant) -> Any:
    return np.asarray(plant.table.columns[TEMPERATURE])


def test_a_predicted_limit_turns_the_temperature_and_the_run_before_is_the_same(without: Trace) -> None:
    plant = acted_at(alarms=2)
    acted = int(np.searchsorted(np.asarray(plant.table.times) - plant.table.times[0], 20.0 * SPEED))
    hot, cooled = without.signals[TEMPERATURE], column(plant)
    assert plant.feed == 0.5 and plant.trips == 0
    np.testing.assert_array_equal(cooled[:acted], hot[:acted])
    assert hot.max() >= 80.0 and cooled.max() < 80.0
    # It is the physics that turns: less load, less heat, minutes later a lower temperature.
    assert np.asarray(plant.table.columns["Assorbimento"])[-100:].mean() < 250.0
    assert cooled[-1] < cooled[acted]


@pytest.mark.parametrize(("alarms", "validity"), [(0, 31), (1, 31), (2, 30), (2, 0)], ids=str)
def test_without_a_usable_alarm_of_the_forecast_the_drum_trips(alarms: int, validity: int, without: Trace) -> None:
    plant = acted_at(alarms=alarms, validity=validity)
    assert plant.feed == 1.0 and plant.trips == 1
    np.testing.assert_array_equal(column(plant), without.signals[TEMPERATURE])


def test_a_reduced_feed_stays_until_an_operator_gives_it_back() -> None:
    plc, plant = live()
    plc.cycle(20.0)
    tell(plc, saying(1, alarms=2), 20.0)
    tell(plc, saying(2, alarms=0), 20.1)
    assert plant.feed == 0.5
    answer: Any = obey(plc, '{"command": "feed", "share": 1.0}', 20.2)
    assert answer["ok"] and plant.feed == 1.0
    for order in ('"seek", "position": 1.0', '"loop", "on": true', '"feed", "share": 1.5'):
        refusal: Any = obey(plc, f'{{"command": {order}}}', 20.3)
        assert not refusal["ok"] and "; " in str(refusal["error"])


def test_the_model_has_seen_such_heats_and_never_this_one(without: Trace) -> None:
    days = heat_history(SEED, days=1)
    hottest = max(float(day.signals[TEMPERATURE].max()) for day in days)
    assert 78.0 < hottest < 82.0
    assert max(day.times[-1] for day in days) < without.times[0]
    readings = {tuple(row) for day in days for row in np.lib.stride_tricks.sliding_window_view(
        day.signals[TEMPERATURE], 12)[::12].tolist()}  # fmt: skip
    assert tuple(without.signals[TEMPERATURE][:12].tolist()) not in readings


def test_two_machines_of_one_seed_are_the_same_until_they_are_controlled_differently() -> None:
    one, other = heat_day(SEED), heat_day(SEED)
    assert [one.row() for _ in range(20)] == [other.row() for _ in range(20)]
    assert one.row(0.5) != other.row()


# ------------------------------------------------------------------ what counts as early, late and in vain


def test_an_alarm_that_hovers_is_one_and_a_later_one_is_another() -> None:
    times = np.arange(0.0, 400.0, 10.0)
    met = (times >= 50) & (times < 100) & (times % 30 > 0) | (times >= 300)
    assert alarm_times(times, met) == (50.0, 300.0)
    assert alarm_times(times, np.zeros(times.size, dtype=bool)) == ()


def test_lead_false_and_missed() -> None:
    early, true = 100.0, 1500.0
    one = score("a", (early, true, 2100.0), 2000.0, usable=(1600.0,))
    assert (one.lead_s, one.usable_s, one.missed, one.false, one.raised) == (500.0, 400.0, False, 1, (early, true))
    assert score("a", (), 2000.0).missed and score("a", (early,), 2000.0).missed
    quiet = score("a", (early,), None)
    assert (quiet.lead_s, quiet.missed, quiet.false) == (None, False, 1)
    assert score("a", (2000.0 - TRUE_WITHIN_S,), 2000.0).false == 0


def test_an_alarm_of_the_forecast_has_its_horizon_and_its_chance_and_looks_at_every_scan() -> None:
    times = np.array([0.0, 30.0, 60.0, 90.0])
    seen = ChancesAlong(
        times=times,
        chances=np.array([[0.0, 0.0], [0.0, 0.2], [0.3, 0.6], [0.3, 0.9]]),
        horizons=(300.0, 900.0),
        scans=np.arange(-10.0, 100.0, 10.0),
        familiar=np.arange(-10.0, 100.0, 10.0) >= 80.0,
    )
    assert seen.alarm(ahead=900.0, p_limit=0.5) == ((60.0,), (80.0,))
    assert seen.alarm(ahead=900.0, p_limit=0.1)[0] == (30.0,)
    assert seen.alarm(ahead=300.0, p_limit=0.1) == ((60.0,), (80.0,))
    assert seen.alarm(ahead=300.0, p_limit=0.3) == ((), ())


def test_a_trend_alarm_is_a_line_through_the_last_minutes() -> None:
    times = np.arange(0.0, 3000.0, 2.0)
    # 0.6 degC a minute from 50: it reaches 80 after 50 minutes, so that 15 minutes ahead is 35 minutes from the start.
    moments = trend_alarm(times, 50.0 + 0.01 * times, 80.0, 900.0)
    assert moments == (pytest.approx(2100.0, abs=4.0),)
    assert trend_alarm(times, np.full(times.size, 79.0), 80.0, 900.0) == ()
    assert trend_alarm(times[:40], 70.0 + times[:40], 80.0, 900.0) == ()


# ------------------------------------------------------------------ the sentence

HEAT: dict[str, Any] = {
    "limit": 80.0,
    "alarm_s": 1100.0,
    "acted_s": 1226.0,
    "feed": 0.5,
    "hottest": 70.5,
    "tripped_s": None,
    "without_reached_s": 2120.0,
    "alarms": [score("forecast", (1100.0,), 2120.0).plain(), score("persistence", (), 2120.0).plain()],
}


def test_the_sentence_says_what_happened_and_also_what_went_wrong() -> None:
    assert headline(HEAT) == (
        "Alarm 17.0 min before the limit of 80 °C would have been reached: 2.1 min later the PLC feeds 50 % and the "
        "bearing turns at 70.5 °C; without the gateway the PLC trips at 80 °C after 35.3 min; false alarms: 0"
    )
    assert "BUT THE PLC DID NOT ACT" in headline(HEAT | {"acted_s": None, "feed": None})
    assert "BUT TOO LATE" in headline(HEAT | {"tripped_s": 2500.0})
    missed = HEAT | {"alarms": [score("forecast", (), 2120.0).plain()], "alarm_s": None, "acted_s": None}
    assert headline(missed).startswith("NO ALARM before the limit of 80 °C")
    assert "would not have reached" in headline(HEAT | {"without_reached_s": None})
    assert alarm_rows(HEAT) == [["forecast", "17.0 min", "0"], ["persistence", "missed", "0"]]


def test_the_day_without_the_gateway_begins_when_the_plc_lets_its_plant_go(without: Trace) -> None:
    begin, moved = align_start(without, [{"event": "start", "time": float(without.times[0]) + 900.0}])
    assert begin == moved.times[0] == without.times[0] + 900.0
    np.testing.assert_array_equal(moved.signals[TEMPERATURE], without.signals[TEMPERATURE])
    assert replace(moved, times=without.times) is not moved
