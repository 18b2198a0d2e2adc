"""The steps that a schedule is made of: boundaries, ages, held inputs, and events without an edge."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.engine.schedules import Schedule, resync_targets, schedule, step_coefficients
from sim.sha.automaton import SHA, Edge, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Event, Trace
from tests.sha.models import ALL, EVERYWHERE

NAMES = [location.name for location in ALL]
STILL = Flow("constant", {"noise": 0.0})


def names(steps: Schedule) -> list[str]:
    return [steps.sha.locations[index].name for index in steps.location]


def current(times: list[float], values: list[float]) -> Trace:
    return Trace("inputs", np.array(times), {"Assorbimento": np.array(values)})


def test_steps_end_at_events_and_outputs_and_carry_their_age() -> None:
    steps = schedule(EVERYWHERE, [Event(3.0, "load"), Event(7.0, "hold")], [0.0, 5.0, 10.0])
    assert names(steps) == ["off", "off", "load", "load", "hold"]
    assert steps.dt.tolist() == [0.0, 3.0, 2.0, 2.0, 3.0]
    assert steps.age.tolist() == [0.0, 0.0, 0.0, 2.0, 0.0]
    assert steps.entry.tolist() == [True, False, True, False, True]
    assert steps.output.tolist() == [0, -1, 1, -1, 2]
    assert steps.checked.all()
    assert steps.stay.tolist() == [0, 0, 1, 1, 2]


def test_at_one_instant_events_come_first_each_with_its_stay() -> None:
    steps = schedule(EVERYWHERE, [Event(2.0, "load"), Event(2.0, "hold")], [1.0, 2.0, 2.0], start=0.0)
    assert names(steps) == ["off", "off", "load", "hold", "hold"]
    assert steps.dt.tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]
    assert steps.output_location.tolist() == [NAMES.index("off"), NAMES.index("hold"), NAMES.index("hold")]


def test_an_event_at_the_start_begins_a_second_stay() -> None:
    steps = schedule(EVERYWHERE, [Event(0.0, "load")], [0.0, 4.0])
    assert names(steps) == ["off", "load", "load"]
    assert steps.output.tolist() == [-1, 0, 1]


def test_events_before_the_start_settle_location_and_age_only() -> None:
    steps = schedule(EVERYWHERE, [Event(-9.0, "hold"), Event(-4.0, "load")], [1.0], start=0.0)
    assert names(steps) == ["load"]
    assert steps.age.tolist() == [4.0]
    assert steps.dt.tolist() == [1.0]


def test_events_after_the_last_output_are_not_looked_at() -> None:
    assert names(schedule(EVERYWHERE, [Event(9.0, "never heard of")], [0.0, 8.0])) == ["off", "off"]


def test_inputs_cut_steps_only_where_the_location_is_driven_and_the_reading_is_new() -> None:
    readings = current([0, 1, 2, 3, 4, 5, 6], [50, 60, 60, 80, np.nan, 90, 10])
    steps = schedule(EVERYWHERE, [Event(1.5, "idle"), Event(5.5, "off")], [0.0, 7.0], inputs=readings)
    ends = np.cumsum(steps.dt)
    assert ends.tolist() == [0.0, 1.5, 3.0, 5.0, 5.5, 7.0]
    np.testing.assert_allclose(steps.offset, [0.0, 0.0, 1.0, 3.0, 4.0, 0.0])
    assert steps.checked.tolist() == [True, True, False, False, True, True]


def test_a_reading_at_an_output_time_holds_from_there_and_needs_no_cut() -> None:
    readings = current([0.0, 5.0], [50.0, 100.0])
    steps = schedule(EVERYWHERE, [Event(0.0, "idle")], [0.0, 5.0, 10.0], inputs=readings)
    assert steps.dt.tolist() == [0.0, 0.0, 5.0, 5.0]
    np.testing.assert_allclose(steps.offset[-2:], [0.0, 5.0])


def test_rows_at_one_instant_count_by_the_last_of_them() -> None:
    readings = current([0.0, 2.0, 2.0], [50.0, 70.0, 90.0])
    steps = schedule(EVERYWHERE, [Event(0.0, "idle")], [1.0, 4.0], inputs=readings)
    assert steps.offset[-1] == pytest.approx(4.0)
    assert np.all(steps.dt[1:] > 0)


def test_before_its_first_reading_a_signal_adds_nothing() -> None:
    readings = current([0.0, 3.0], [np.nan, 90.0])
    steps = schedule(EVERYWHERE, [Event(-2.0, "idle")], [5.0], start=-1.0, inputs=readings)
    np.testing.assert_allclose(steps.offset, [0.0, 4.0])


@pytest.mark.parametrize("inputs", [None, Trace("other", np.zeros(1), {"Coppia": np.zeros(1)})])
def test_a_missing_input_is_named_with_its_location(inputs: Trace | None) -> None:
    with pytest.raises(ValueError, match="'idle' is driven by the signal 'Assorbimento'"):
        schedule(EVERYWHERE, [Event(0.0, "idle")], [1.0], inputs=inputs)
    assert names(schedule(EVERYWHERE, [], [1.0], inputs=inputs)) == ["off"]  # not asked for where never visited


@given(
    events=st.lists(st.tuples(st.integers(0, 40), st.sampled_from(NAMES)), max_size=12),
    outputs=st.lists(st.integers(0, 40), min_size=1, max_size=20),
    readings=st.lists(st.tuples(st.integers(-5, 45), st.sampled_from([50.0, 60.0, np.nan])), max_size=20),
)
@settings(max_examples=150, deadline=None)
def test_steps_tile_the_run_and_every_output_ends_one(
    events: list[tuple[int, str]], outputs: list[int], readings: list[tuple[int, float]]
) -> None:
    timed = [Event(float(t), name) for t, name in sorted(events, key=lambda e: e[0])]
    rows = sorted(readings, key=lambda r: r[0])
    inputs = current([float(t) for t, _ in rows], [v for _, v in rows])
    steps = schedule(EVERYWHERE, timed, sorted(outputs), start=0.0, inputs=inputs)
    ends = np.cumsum(steps.dt)
    assert np.all(steps.dt >= 0)
    assert ends[-1] == max(outputs)
    assert ends[steps.output >= 0].tolist() == sorted(outputs)
    begins = ends - steps.dt
    for time, here, age, offset in zip(begins, names(steps), steps.age, steps.offset, strict=True):
        assert here == "off" or here in [event.symbol for event in timed if event.time <= time]
        assert age <= time
        read = [v for t, v in rows if t <= time and not np.isnan(v)]
        assert offset == pytest.approx(0.1 * (read[-1] - 50.0) if here == "idle" and read else 0.0)
    for row, time in enumerate(sorted(outputs)):
        past = [event.symbol for event in timed if event.time <= time]
        assert NAMES[steps.output_location[row]] == (past[-1] if past else "off")


SPARSE = SHA(
    "sparse",
    tuple(Location(name, STILL) for name in ("rest", "low", "high")),
    (
        Edge("rest", "on", "low"),
        Edge("low", "up", "high"),
        Edge("high", "down", "low"),
        Edge("high", "off", "rest"),
        Edge("low", "off", "rest"),
        Edge("rest", "tie", "high"),
        Edge("low", "tie", "rest"),
    ),
    "rest",
)


def test_reject_names_index_location_symbol_and_time() -> None:
    with pytest.raises(ValueError, match=r"event 1 \('on' at 2\.500 s\): location 'low' of SHA 'sparse' has no edge"):
        schedule(SPARSE, [Event(1.0, "on"), Event(2.5, "on")], [4.0], start=0.0)


def test_ignore_goes_on_with_the_stay_and_tells() -> None:
    steps = schedule(SPARSE, [Event(1.0, "on"), Event(2.0, "on")], [4.0], start=0.0, policy="ignore")
    assert names(steps) == ["rest", "low"]
    assert steps.unmatched == (1,)


@pytest.mark.parametrize(("symbol", "target"), [("down", "low"), ("off", "rest"), ("up", "high"), ("new", "rest")])
def test_resync_goes_where_the_symbol_leads_most_often(symbol: str, target: str) -> None:
    events = [Event(1.0, "on"), Event(1.5, "on"), Event(2.0, "up"), Event(2.5, "up"), Event(3.0, symbol)]
    steps = schedule(SPARSE, events, [4.0], start=0.0, policy="resync")
    assert names(steps)[-1] == target
    assert steps.unmatched[:2] == (1, 3)
    assert steps.entry.sum() == 6  # a jump is an entry


def test_resync_breaks_ties_by_the_models_order() -> None:
    assert resync_targets(SPARSE)["tie"] == "rest"
    turned = replace(SPARSE, locations=SPARSE.locations[::-1], edges=SPARSE.edges[::-1])
    assert resync_targets(turned)["tie"] == "high"


@pytest.mark.parametrize("policy", ["reject", "ignore", "resync"])
def test_unknown_always_leads_to_the_initial_location(policy: str) -> None:
    steps = schedule(SPARSE, [Event(1.0, "on"), Event(2.0, UNKNOWN)], [4.0], start=0.0, policy=policy)
    assert names(steps) == ["rest", "low", "rest"]
    assert steps.unmatched == ()


def test_a_model_is_taken_like_its_automaton() -> None:
    model = Model(SPARSE, DECANTER, "TCuscinettiRiduttore", 0.1)
    assert names(schedule(model, [Event(1.0, "on")], [4.0], start=0.0)) == ["rest", "low"]


@pytest.mark.parametrize(
    ("events", "outputs", "start", "said"),
    [
        ([Event(3.0, "on"), Event(2.0, "off")], [4.0], None, "event 1 .*never going back"),
        ([Event(float("nan"), "on")], [4.0], None, "event 0 .*must be numbers"),
        ([], [], None, "non-empty"),
        ([], [[1.0]], None, "shape"),
        ([], [2.0, 1.0], None, "output times must be numbers and never go back"),
        ([], [float("inf")], None, "output times must be numbers"),
        ([], [1.0], 2.0, "lies before the start"),
        ([], [1.0], float("nan"), "lies before the start"),
    ],
)
def test_unusable_times_are_refused(events: list[Event], outputs: list[float], start: float | None, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        schedule(SPARSE, events, outputs, start=start)


def test_an_unknown_policy_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown policy 'guess'"):
        schedule(SPARSE, [], [1.0], policy="guess")


def test_two_million_rows_take_no_python_loop() -> None:
    # One row at a time would need minutes under the test's time limit of the project; this is a matter of tenths.
    clock = np.arange(2_000_000, dtype=float)
    inputs = Trace("long", clock, {"Assorbimento": np.sin(clock)})
    events = [Event(10.0 * i, NAMES[i % len(NAMES)]) for i in range(200)]
    steps = schedule(EVERYWHERE, events, clock, inputs=inputs)
    decay, _, variance = step_coefficients(steps)
    assert steps.dt.sum() == clock[-1]
    assert decay.shape == variance.shape == steps.dt.shape == (2_000_200,)
