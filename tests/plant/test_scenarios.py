"""The synthetic scenarios have the properties known of the thesis's traces, and say that they are synthetic."""

from functools import cache

import numpy as np
import pytest

from sim.plant.decanter import DecanterPlant, Phase, Weather, simulate_decanter
from sim.plant.scenarios import SCENARIOS, production, scenario
from sim.sha.trace import Trace

BEARING = "TCuscinettiRiduttore"

simulated = cache(scenario)
"""A scenario of the reference set, simulated once for all tests that only read it."""


def changes(trace: Trace) -> int:
    """Changes of the working status and of the 100 A bin of the current."""
    bins = np.digitize(trace.signals["Assorbimento"], [100.0, 200.0, 300.0])
    return int((np.diff(bins) != 0).sum() + (np.diff(trace.signals["MarciaDecanter"]) != 0).sum())


def duration(trace: Trace) -> float:
    return float(trace.times[-1] - trace.times[0])


def test_cd1_has_401_rows_in_about_444_s_and_about_47_events() -> None:
    trace = simulated("cd1")
    assert trace.times.size == 401
    assert duration(trace) == pytest.approx(444, abs=5)
    assert changes(trace) == pytest.approx(47, abs=3)


def test_cd8_warms_from_18_to_29_degc_at_a_stable_load() -> None:
    trace = simulated("cd8")
    bearing, current = trace.signals[BEARING], trace.signals["Assorbimento"]
    assert bearing[0] == pytest.approx(18, abs=0.3)
    assert bearing[-1] == pytest.approx(29, abs=0.5)
    assert np.std(current[trace.times - trace.times[0] > 60]) < 5


def test_cd2_is_colder_than_every_other_scenario() -> None:
    coldest = {name: float(simulated(name).signals[BEARING].max()) for name in SCENARIOS}
    assert min(coldest, key=lambda name: coldest[name]) == "cd2"


@pytest.mark.parametrize("name", ["cd5", "cd10"])
def test_cd5_and_cd10_have_rapid_transients_and_long_idling_at_low_power(name: str) -> None:
    trace = simulated(name)
    running = trace.signals["MarciaDecanter"] > 0
    current = trace.signals["Assorbimento"]
    assert np.mean(current[running] < 80) > 0.5
    swings = np.abs(np.diff(np.digitize(current, [100.0, 200.0])))
    assert (swings > 0).sum() > 25


def test_cd17_is_the_longest_and_changes_its_load_several_times() -> None:
    lengths = {name: duration(simulated(name)) for name in SCENARIOS}
    assert max(lengths, key=lambda name: lengths[name]) == "cd17"
    assert sum(phase.load > 0 for phase in SCENARIOS["cd17"].phases) >= 4


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_every_scenario_is_seeded_plausible_and_says_that_it_is_synthetic(name: str) -> None:
    trace, again, other = simulated(name), scenario(name), scenario(name, seed=5)
    assert trace.synthetic
    assert "simulated" in trace.origin
    assert np.array_equal(trace.signals[BEARING], again.signals[BEARING])
    assert not np.array_equal(trace.signals[BEARING], other.signals[BEARING][: trace.times.size])
    assert np.all((trace.signals["Assorbimento"] >= 0) & (trace.signals["Assorbimento"] <= 350))
    assert np.all((trace.signals[BEARING] > -5) & (trace.signals[BEARING] < 80))
    assert np.all(np.diff(trace.times) > 0)


def test_unknown_scenario_is_refused_with_the_known_names() -> None:
    with pytest.raises(ValueError, match=r"unknown scenario 'cd18': known are cd1, cd2"):
        scenario("cd18")


def test_bearings_cool_towards_the_hall_when_the_drum_rests() -> None:
    trace = simulate_decanter(
        [Phase(6 * 3600, running=False, pump=False)],
        seed=1,
        name="rest",
        period=60,
        bearing=50.0,
        step=2.0,
        weather=Weather(mean=15.0, swing=0.0),
    )
    bearing = trace.signals[BEARING]
    assert bearing[-1] < 25
    assert bearing[-1] > 14


def test_more_load_and_more_friction_make_a_hotter_bearing() -> None:
    def end(load: float, plant: DecanterPlant) -> float:
        phases = [Phase(3600, running=True, load=load)]
        return float(simulate_decanter(phases, seed=3, name="x", period=30, plant=plant).signals[BEARING][-1])

    assert end(250, DecanterPlant()) > end(120, DecanterPlant()) + 3
    assert end(250, DecanterPlant(heat_per_ampere=2 * DecanterPlant().heat_per_ampere)) > end(250, DecanterPlant()) + 5


def test_the_step_of_integration_does_not_matter() -> None:
    quiet = DecanterPlant(roughness=0.0, cycle_scatter=0.0, sensor_noise=0.0, sensor_step=1e-6)
    phases = [Phase(1800, running=True, load=180)]
    ends = [
        simulate_decanter(phases, seed=1, name="x", period=1800, jitter=0.0, plant=quiet, step=step).signals[BEARING][
            -1
        ]
        for step in (0.25, 0.5, 2.0)
    ]
    assert max(ends) - min(ends) < 0.05


def test_production_runs_every_day_and_rests_at_night() -> None:
    trace = production(2, 4, seed=1, period=30.0)
    running = trace.signals["MarciaDecanter"]
    assert duration(trace) == pytest.approx(2 * 86400, rel=0.001)
    starts = np.flatnonzero(np.diff(running) > 0)
    assert len(starts) == 8
    assert 0.2 < running.mean() < 0.6


@pytest.mark.parametrize(("days", "cycles"), [(0, 4), (1, 0)])
def test_production_of_nothing_is_refused(days: int, cycles: int) -> None:
    with pytest.raises(ValueError, match="at least one day"):
        production(days, cycles, seed=1)


def test_no_phase_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one phase"):
        simulate_decanter([], seed=1, name="none")
