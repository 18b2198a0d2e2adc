"""What is not believed: effects too short for the rows, and heats that no machine has."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import (
    CatalogueEntry,
    Fitted,
    Record,
    build_frame,
    build_record,
    catalogue,
    fit,
    move_frame,
    rivals,
    with_priors,
)
from sim.lab.discrepancy.judging import NamingResult, dubious, fastest_movement, greatest_heat, too_short
from sim.lab.discrepancy.naming import NamingStep, step
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.screen import TIME_PARAMETERS, Projector, Shape, refine_shape, screen, shortest_visible
from sim.sha import Trace
from tests.discrepancy.plants import PERIOD, model, plant, sparse


def laid_out(trace: Trace) -> Record:
    return build_record(model(), [trace], ())


def fitted(trace: Trace) -> Fitted:
    return fit(with_priors(move_frame(build_frame(laid_out(trace)), laid_out(trace))))


def entry(name: str) -> CatalogueEntry:
    return next(each for each in catalogue() if each.name == name)


def times_of(shape: Shape) -> list[float]:
    return [shape.params[name] for name in TIME_PARAMETERS if name in shape.params]


@pytest.fixture(scope="module")
def churned() -> Fitted:
    """A start-up heat of 400 s in rows of 30 s."""
    return fitted(plant(3, days=2, churning=0.02))


@pytest.fixture(scope="module")
def named(churned: Fitted) -> NamingStep:
    return step(churned, [entry("startup-churning")], {}, rules=RULES)


def test_what_is_shorter_than_two_rows_is_not_offered(churned: Fitted) -> None:
    for rows, base in ((1, churned), (10, fitted(sparse(plant(3, days=2, churning=0.02), 10)))):
        shortest = 2.0 * rows * PERIOD
        assert shortest_visible(base.frame.record) == pytest.approx(shortest)
        offered = screen(base, catalogue(), {})[0].shapes
        times = [time for shape in offered for time in times_of(shape)]
        assert times and min(times) >= shortest
        names = {shape.entry.name for shape in offered}
        assert ("dead-time" in names, "startup-churning" in names) == (rows == 1, True)


def test_a_refinement_stops_at_two_rows() -> None:
    """The reading is a row late: what fits best is shorter than what can be seen."""
    trace = plant(3, days=2)
    read = trace.signals["T"]
    base = fitted(replace(trace, signals={**trace.signals, "T": np.concatenate([read[:1], read[:-1]])}))
    found = refine_shape(Projector(base), Shape(entry("dead-time"), {}, {"delay": 80.0, "blur": 0.0}), 1.0)
    assert found.params["delay"] == pytest.approx(2.0 * PERIOD, abs=0.1)


def test_of_effects_that_these_rows_cannot_show_it_is_said() -> None:
    base = fitted(sparse(plant(3, days=2, churning=0.02), 10))
    entries = [entry(name) for name in ("dead-time", "startup-churning", "wear-drift", "pump-cooling")]
    path = NamingResult(base, base, ((step(base, entries, {}, rules=RULES), "adds nothing"),))
    said = too_short([entry for entry in entries if entry.name != "pump-cooling"], path)
    assert list(said) == ["dead-time"]
    assert "600 s" in said["dead-time"]
    slow = fitted(sparse(plant(3, days=2, churning=0.02), 19))
    path = NamingResult(slow, slow, ((step(slow, entries[:1], {}, rules=RULES), "adds nothing"),))
    assert " 1140 s" in too_short(entries[:1], path)["dead-time"]


def test_what_does_no_better_than_its_special_case_was_looked_for() -> None:
    trace = plant(3, days=2, period=60.0)
    record = build_record(model(), [trace], ("Assorbimento",))
    base = fit(move_frame(build_frame(record), record), rounds=1, iterations=3)
    entries = [entry(name) for name in ("late-current-heating", "current-heating")]
    made = step(base, entries, {"current": "Assorbimento"}, rules=RULES)
    assert "late-current-heating" not in {each.entry.name for each in made.evidence}
    assert too_short(entries, NamingResult(base, base, ((made, "adds nothing"),))) == {}


def with_strength(named: NamingStep, times: float) -> NamingStep:
    """The step whose best effect has so many times its strength."""
    best = named.best
    assert best is not None and best.fitted is not None
    (effect,) = best.fitted.state.named
    params = {**effect.params, "gain": effect.params["gain"] * times}
    state = replace(best.fitted.state, named=(replace(effect, params=params),))
    return replace(named, evidence=(replace(best, fitted=replace(best.fitted, state=state)),))


def test_a_heat_beyond_what_a_machine_does_is_refused_in_degrees_an_hour(named: NamingStep) -> None:
    assert dubious(named) == ""
    assert dubious(with_strength(named, 10.0)) == ""
    best = named.best
    assert best is not None and best.fitted is not None
    heat = greatest_heat(named.before, best.fitted.state.named[0])
    assert 0.2 * fastest_movement(named.before) < heat < fastest_movement(named.before)
    said = dubious(with_strength(named, 1000.0))
    assert said.startswith(
        f"would heat or cool by up to {heat * 3.6e6:.3g} °C/h, and the fastest movement in these data"
    )


def test_a_time_that_the_joint_fit_made_shorter_than_two_rows_is_refused(named: NamingStep) -> None:
    best = named.best
    assert best is not None and best.fitted is not None
    (effect,) = best.fitted.state.named
    short = replace(effect, params={**effect.params, "tau": 40.0})
    state = replace(best.fitted.state, named=(short,))
    found = replace(named, evidence=(replace(best, fitted=replace(best.fitted, state=state)),))
    assert dubious(found) == "lasts 40 s, and nothing shorter than 60 s is visible in these rows"


@pytest.mark.parametrize(("days", "offered"), [(2, False), (3, True)])
def test_the_clock_is_no_rival_on_a_record_that_has_an_hour_but_once_or_twice(days: int, offered: bool) -> None:
    """A cooler that failed, in a record of a day and a half, was heat of a shift "between 06:09 and 22:04"."""
    names = {shape.entry.name for shape in screen(fitted(plant(3, days=days)), rivals(), {})[0].shapes}
    clocks = {"heat-by-the-clock", "heat-in-a-shift"}
    assert names & clocks == (clocks if offered else set())
