"""What a plant has and no name stands for takes the name away, and is said in the plant's words."""

import re
from collections.abc import Callable

import numpy as np
import pytest

from sim.engine.schedules import schedule
from sim.lab.discrepancy.advice import advice_lines
from sim.lab.discrepancy.fitting import build_frame, build_record, heat_and_loss, move_frame, rivals, with_priors
from sim.lab.discrepancy.fitting.free_run_fit import fit, with_heats
from sim.lab.discrepancy.fitting.named import Named, main_effect
from sim.lab.discrepancy.judging import NamingResult, description, dubious
from sim.lab.discrepancy.naming import entries_besides, step
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.unmeasured import TRIED_FACTORS, gain_at_once, knot_columns, knot_spacings
from sim.lab.discrepancy.workflow import diagnose
from sim.sha.automaton import SHA
from sim.sha.trace import Array
from tests.discrepancy.plants import PERIOD, model, plant

BEGIN, DAY, DAYS = 1.7e9, 86400.0, 5
"""The plant's traces begin on 2023-11-14 at 22:13 UTC."""
ROLES = {"current": "Assorbimento", "pump": "MarciaPmpFango", "ambient": "TAmbiente"}
COARSE_S = 60.0
"""A row each so many seconds, where what is asked shows as well: the fits are done in less than half the time."""
Plant = Callable[[Array, Array, Array], tuple[Array, Array]]


def steps(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Heat after each step of the load, two masses of 200 s behind its size."""
    slow, slower, part = current.copy(), current.copy(), 1.0 - np.exp(-(time[1] - time[0]) / 200.0)
    for row in range(1, current.size):
        slow[row] = slow[row - 1] + part * (current[row] - slow[row - 1])
        slower[row] = slower[row - 1] + part * (slow[row] - slower[row - 1])
    return 1e-4 * on * np.abs(current - slower), 0.0 * time


def clock(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Most at 03:00, in a peak."""
    return 1.5e-3 * np.exp(np.cos(2.0 * np.pi * (time - 3 * 3600.0) / DAY)), 0.0 * time


def shift(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """While the machine runs between 13:30 and 22:00."""
    return 4e-3 * on * (np.abs(time % DAY - 17.75 * 3600.0) < 4.25 * 3600.0), 0.0 * time


def event(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Greased at the second day's end: gone after ten running hours, on a straight line."""
    ran = np.cumsum(on * (time >= BEGIN + 2 * DAY)) * (time[1] - time[0])
    return 9e-3 * on * (time >= BEGIN + 2 * DAY) * np.maximum(1.0 - ran / 36000.0, 0.0), 0.0 * time


def greased(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Twice: on the first day and on the third, each gone within some running hours."""
    heat = 0.0 * time
    for days in (0.7, 2.6):
        since = time >= BEGIN + days * DAY
        heat += 4e-3 * since * np.exp(-np.cumsum(on * since) * (time[1] - time[0]) / 14400.0)
    return on * heat, 0.0 * time


def weather(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """A hall that is warmer by half a degree from 2023-11-17 05:25 on: less is lost to it, the more where more is."""
    return 0.5 * np.where(on > 0.5, 1.0 / 1500.0, 1.0 / 3600.0) * (time >= BEGIN + 2.3 * DAY), 0.0 * time


def cooler(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Less cooling from 2023-11-17 05:25 on, within half an hour."""
    return 0.0 * time, -2e-4 * np.clip((time - BEGIN - 2.3 * DAY) / 1800.0, 0.0, 1.0)


def slowly_warmer(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """A hall that is warmer by two degrees after the first day."""
    return 2.0 / 1500.0 * (time >= BEGIN + DAY), 0.0 * time


def dirt(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """Less and less cooling from the first day's end on."""
    return 0.0 * time, -6e-5 * np.maximum((time - BEGIN) / DAY - 1.0, 0.0)


def failing(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """As much less cooling, of what turns with the machine: at rest nothing is seen of it."""
    return 0.0 * time, -2e-4 * on * np.clip((time - BEGIN - 2.3 * DAY) / 1800.0, 0.0, 1.0)


def neighbour(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """A machine next door, on and off for some hours by a plan of its own, and warm a quarter of an hour later."""
    rng = np.random.default_rng(9)
    plan = np.repeat(rng.random(time.size) < 0.5, rng.integers(120, 480, time.size))[: time.size]
    warm, part = np.zeros(time.size), 1.0 - np.exp(-(time[1] - time[0]) / 900.0)
    for row in range(1, time.size):
        warm[row] = warm[row - 1] + part * (plan[row] - warm[row - 1])
    return 2.5e-3 * warm, 0.0 * time


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (steps, r"heat that follows each step of the load and fades over [5-9] min"),
        (clock, r"heat that comes with the clock, most at 0[23]:\d\d UTC"),
        (shift, r"heat that comes with the clock, between 1[34]:\d\d UTC and 2[123]:\d\d UTC while the machine runs"),
        (event, r"heat after an event at 2023-11-1[67] \d\d:\d\d UTC, fading over \d.\d running hours"),
        (
            greased,
            r"heat after an event at 2023-11-15 .* and again at 2023-11-1[67] .*, fading over \d.\d running hours",
        ),
        (weather, r"warmer surroundings since 2023-11-17 0[0-9]:\d\d UTC"),
        (cooler, r"less cooling since 2023-11-17 0[4-6]:\d\d UTC"),
        (failing, r"less cooling while the machine runs, since 2023-11-17 0[4-6]:\d\d UTC"),
        (neighbour, r"heat from something that is not measured, that comes and goes over about [12]\.0 hours"),
        (dirt, r"less cooling more and more since 2023-11-1[56] \d\d:\d\d UTC"),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
)
def test_what_has_no_name_is_held_beside_the_names_and_described(more: Plant, words: str) -> None:
    period = PERIOD if more in (shift, neighbour) else COARSE_S
    record = build_record(model(), [plant(2, days=DAYS, more=more, period=period)], tuple(ROLES.values()))
    base = fit(with_priors(move_frame(build_frame(record), record)))
    found = step(base, entries_besides(()), ROLES, rules=RULES)
    assert found.best is not None and found.best.entry.rival
    refusal = dubious(found)
    assert "has no name" in refusal
    assert re.fullmatch(words, description(NamingResult(base, base, ((found, refusal),))))


def test_what_an_unmeasured_neighbour_adds_at_once_is_told_without_a_fit() -> None:
    """Under the noise of the fit without it, as if it were put into that noise."""
    record = build_record(model(), [plant(2, days=2, more=neighbour)], ())
    base = fit(with_priors(move_frame(build_frame(record), record)))
    columns = [knot_columns(base, spacing) for spacing in knot_spacings(base)]
    sizes = base.noise.rough * TRIED_FACTORS
    put = max(with_heats(base, size * each, iterations=0).likelihood for each in columns for size in sizes)
    assert gain_at_once(base) == pytest.approx(put - base.likelihood, abs=0.1) and gain_at_once(base) > 1.0


@pytest.mark.parametrize("pump", [0.0, 8e-5])
def test_an_unmeasured_neighbour_takes_no_place_of_what_is_there(pump: float) -> None:
    record = build_record(model(), [plant(2, days=DAYS, pump=pump, period=COARSE_S)], tuple(ROLES.values()))
    found = step(fit(with_priors(move_frame(build_frame(record), record))), entries_besides(()), ROLES, rules=RULES)
    assert "unmeasured-neighbour" not in [each.entry.name for each in found.evidence]
    assert found.best is not None and (found.best.entry.name == "pump-cooling") == (pump > 0)


def test_beside_an_unmeasured_neighbour_a_name_that_is_certain_stays() -> None:
    """The neighbour explains more than the pump does, and nothing of what the pump does."""
    record = build_record(model(), [plant(2, days=DAYS, pump=8e-5, more=neighbour)], tuple(ROLES.values()))
    found = step(fit(with_priors(move_frame(build_frame(record), record))), entries_besides(()), ROLES, rules=RULES)
    assert found.best is not None and found.best.entry.name == "pump-cooling"


def test_a_diagnosis_says_that_something_is_not_measured_and_where_to_look() -> None:
    found = diagnose(model(), [plant(2, days=DAYS, more=neighbour)], seed=0).diagnosis
    assert found.verdict == "unexplained" and "that is not measured" in found.sentence
    assert advice_lines(found)[0].startswith("what is beside the machine and not recorded")


def test_the_sentence_says_what_has_no_name_and_the_advice_where_to_look() -> None:
    found = diagnose(model(), [plant(3, days=DAYS, more=cooler, period=COARSE_S)], seed=0).diagnosis
    assert found.verdict == "unexplained" and not found.effects
    assert found.description.startswith("less cooling since 2023-11-17")
    assert found.description in found.sentence and any(found.description in reason for reason in found.reasons)
    assert "in no particular place" not in found.sentence
    assert advice_lines(found)[0] == (
        f"what carries heat away: cooler, fan, filter, flow of oil and water, dirt on the housing ({found.description})"
    )


def test_no_engine_executes_what_has_no_name() -> None:
    made = model()
    for entry in rivals():
        params = dict.fromkeys(entry.kind.parameters, 1.0)
        effect = main_effect(Named(entry, {role: ROLES[role] for role in entry.needs}, params), made)
        sha = SHA(made.sha.name, made.sha.locations, made.sha.edges, made.sha.initial, effects=(effect,))
        with pytest.raises(ValueError, match=entry.name):
            schedule(sha, [], np.array([0.0, 10.0]))


def test_an_events_running_hours_run_on_through_cuts() -> None:
    record = build_record(model(), [plant(1, days=3)], ("Assorbimento",))
    entry = next(each for each in rivals() if each.name == "heat-after-an-event")
    params = {"gain": 1e-3, "at": BEGIN + 0.5 * DAY, "tau": 20000.0}
    effect = main_effect(Named(entry, {}, params), record.model)
    whole, _ = heat_and_loss(record, effect, np.zeros(len(record.runs)))
    later = record.cycle >= 5
    cut = record.select(later)
    # The first step of a piece is no step of the cut record: its middle is its end.
    found, _ = heat_and_loss(cut, effect, np.zeros(len(cut.runs)))
    inside = ~cut.runs.first
    assert np.array_equal(found[inside], whole[later][inside]) and 0.0 < found.max() < 1e-3 * np.exp(-1.0)


CHANGES = [entry for entry in rivals() if entry.name in {"less-cooling", "other-surroundings"}]
"""What is lost to the surroundings is less with either, from a moment on."""


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.parametrize(("more", "words"), [(weather, "warmer surroundings"), (cooler, "less cooling")])
def test_a_cooler_that_fails_and_surroundings_that_step_are_told_apart(more: Plant, words: str, seed: int) -> None:
    record = build_record(model(), [plant(seed, days=4, more=more, period=COARSE_S)], ())
    base = fit(with_priors(move_frame(build_frame(record), record)))
    found = step(base, CHANGES, {}, rules=RULES)
    said = description(NamingResult(base, base, ((found, dubious(found)),)))
    assert re.fullmatch(words + r" since 2023-11-17 0[0-9]:\d\d UTC", said)


@pytest.mark.parametrize("rests", [600, 60, 1, 0])
def test_of_a_machine_that_hardly_rests_both_are_said_where_nothing_tells_them_apart(rests: int) -> None:
    """One load that never changes, and a level that is reached before any course shows how fast; so many rows of rest
    before, of which less than a fiftieth of the record says nothing of how cold rest is."""
    trace = plant(2, days=2, runs_on=True, more=slowly_warmer)
    begin = int(np.argmax(trace.signals["MarciaDecanter"] > 0.5)) - rests
    record = build_record(model(), [trace.between(float(trace.times[begin]), float(trace.times[-1]))], ())
    base = fit(with_priors(move_frame(build_frame(record), record)))
    found = step(base, CHANGES, {}, rules=RULES)
    said = description(NamingResult(base, base, ((found, dubious(found)),)))
    assert "less cooling" in said and "warmer surroundings" in said and " or " in said
