"""The blind benchmark's plant: known answers, clean bearings that a model can follow, effects of the wanted size."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.discrepancy import plant
from benchmarks.discrepancy.bearings import Machine, machine, moved
from benchmarks.discrepancy.effects import EFFECTS, NEEDS
from benchmarks.discrepancy.generator import KINDS, Drawn, scaled
from benchmarks.discrepancy.log import signals_of, written_log
from benchmarks.discrepancy.operation import Operation, lagged, operate
from benchmarks.discrepancy.outside import OUTSIDE
from benchmarks.discrepancy.plant import Bearing, Parts, Roughness, disturbance, run, transported
from benchmarks.discrepancy.strata import Spec
from benchmarks.discrepancy.visible import Family, left_over, signal_to_noise

ROOM = Path(plant.__file__).parent
SMOOTH = Roughness(0.0, 400.0, 0.0, 0.06, 0.01)
DRIVEN = Family(gains=(-1, 0, 0, 0, 0))


@pytest.fixture(scope="module")
def day() -> Operation:
    return operate(np.random.default_rng(5), days=1)


def still(operation: Operation) -> np.ndarray:
    return np.zeros(operation.times.size)


def test_the_generator_shares_no_code_with_what_it_tests() -> None:
    for name in ("operation", "plant", "effects", "outside", "visible"):
        tree = ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))
        froms = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not [one for one in froms if one.split(".")[0] in ("sim", "gateway", "drivers")], name


def test_the_vocabulary_is_that_of_the_design() -> None:
    assert not set(EFFECTS) & set(OUTSIDE)
    assert len(OUTSIDE) >= 6
    assert set(NEEDS) < set(EFFECTS)


def test_every_effect_is_named_as_the_catalogue_names_it() -> None:
    """A kind that was added since has no blind cases: the sets were drawn before."""
    automaton_effects = pytest.importorskip("sim.effects.kinds")
    assert set(EFFECTS) <= set(automaton_effects.EFFECTS)


@pytest.mark.parametrize(("base", "family"), [("stages", Family()), ("linear", DRIVEN)])
def test_a_clean_bearing_is_one_that_the_baseline_can_follow_even_after_it_moved(
    day: Operation, base: str, family: Family
) -> None:
    bearing = moved(machine("development", base, True, 0).bearing, np.random.default_rng(1))
    course = run([(day, bearing, still(day), Parts())])[0]
    assert left_over(day, bearing, family, course.sensor) < 1e-3


def test_a_bearing_that_follows_the_current_is_more_than_one_target_a_stage(day: Operation) -> None:
    bearing = machine("development", "linear", False, 0).bearing
    course = run([(day, bearing, still(day), Parts())])[0]
    assert left_over(day, bearing, Family(), course.sensor) > 0.1


def test_a_bearing_at_rest_stays_at_the_halls_temperature_and_one_that_runs_goes_to_heat_over_loss(
    day: Operation,
) -> None:
    n = day.times.size
    ever = replace(day, running=np.ones(n), current=np.full(n, 150.0))
    never = replace(day, running=np.zeros(n), current=np.zeros(n))
    bearing = Bearing(18.0, (0.0, 0.01, 0.03, 0.04, 0.05), 1 / 3600, 1 / 1500)
    warm, cold = run([(ever, bearing, still(day), Parts()), (never, bearing, still(day), Parts())])
    assert warm.bearing[-1] == pytest.approx(18.0 + 0.03 * 1500)
    assert np.allclose(cold.bearing, 18.0)
    row = int(1500 / day.period)
    assert warm.bearing[row] == pytest.approx(18.0 + 45.0 * (1 - np.exp(-1)), abs=1e-6)


@pytest.mark.benchmark
def test_heuns_method_agrees_with_the_exact_steps(day: Operation) -> None:
    bearing = machine("development", "stages", False, 1).bearing
    parts = EFFECTS["pump-cooling"].make(day, 1.0, np.random.default_rng(0))
    exact = run([(day, bearing, still(day), parts)])[0]
    heun = run([(day, bearing, still(day), replace(parts, ladder=1e-12, ladder_memory=3000.0))])[0]
    assert np.max(np.abs(exact.bearing - heun.bearing)) < 1e-3


def test_transport_keeps_what_goes_in_and_delays_it_by_the_stated_time() -> None:
    values = np.concatenate([np.zeros(20), np.ones(400)])
    out = transported(values, 10.0, 120.0)
    assert out[-1] == pytest.approx(1.0)
    assert 10.0 * (np.sum(values - out) - 0.5) == pytest.approx(120.0, rel=1e-3)  # a row stands for its middle


def test_the_sensors_lag_behind_a_ramp_is_the_stated_one(day: Operation) -> None:
    bearing = Bearing(18.0, (0.0,) * 5, 1e-9, 1e-9)
    course = run([(day, bearing, np.full(day.times.size, 1e-3), Parts(lag=90.0))])[0]
    assert course.bearing[-1] - course.sensor[-1] == pytest.approx(1e-3 * 90.0, rel=1e-3)


@pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
def test_each_effect_acts_beyond_what_the_baseline_can_imitate(day: Operation, name: str) -> None:
    kind = KINDS[name]
    day = operate(np.random.default_rng(5), days=2) if name == "crew-change" else day
    bearing = machine("development", kind.base, False, 0).bearing
    family = DRIVEN if kind.base == "linear" else Family()
    parts = kind.make(day, 1.0, np.random.default_rng(2))
    without, course = run([(day, bearing, still(day), Parts()), (day, bearing, still(day), parts)])
    assert signal_to_noise(day, bearing, family, without.sensor, course.sensor, 0.06) > 0.3
    assert course.bearing.min() > 0.0 and course.bearing.max() < 150.0


def test_what_the_baseline_can_imitate_does_not_count_as_signal(day: Operation) -> None:
    bearing = machine("development", "stages", False, 0).bearing
    warmer = replace(bearing, heat=tuple(1.03 * heat for heat in bearing.heat))
    without, course = run([(day, bearing, still(day), Parts()), (day, warmer, still(day), Parts())])
    assert np.max(np.abs(course.sensor - without.sensor)) > 0.5
    assert signal_to_noise(day, warmer, Family(), without.sensor, course.sensor, 0.06) < 0.02


@pytest.mark.benchmark
def test_strengths_are_scaled_to_the_wanted_ratio(day: Operation) -> None:
    ratio = 3.0
    one = Machine("stages-smooth-0", machine("development", "stages", False, 0).bearing, SMOOTH)
    names = ("torque-friction", "dead-time", "radiation-loss")
    cases = [
        Drawn(Spec("development", "test", n, (name,), ratio), one, one.bearing, day, still(day), Family())
        for n, name in enumerate(names)
    ]
    for found, name in zip(scaled(cases), names, strict=True):
        assert found[name][1] == pytest.approx(ratio, rel=0.15)


def test_a_rough_plants_disturbance_is_about_a_percent_of_its_heat_and_none_at_rest(day: Operation) -> None:
    one = machine("development", "stages", True, 0)
    noise = disturbance(np.random.default_rng(0), day, one.bearing, one.rough)
    assert not noise[day.running == 0].any()
    assert 0.002 < np.std(noise[day.running > 0]) / np.mean(one.bearing.heat[1:]) < 0.03


def test_no_constant_moves_by_more_than_8_percent() -> None:
    bearing = machine("development", "stages", False, 2).bearing
    for seed in range(20):
        after = moved(bearing, np.random.default_rng(seed))
        ratios = [new / old for new, old in zip(after.heat[1:], bearing.heat[1:], strict=True)]
        ratios += [after.loss_rest / bearing.loss_rest, after.loss_running / bearing.loss_running]
        assert max(abs(one - 1) for one in ratios) <= 0.08


@pytest.mark.parametrize("sampling", ["regular", "irregular", "gaps"])
def test_a_log_has_the_plants_columns_without_the_missing_ones(tmp_path: Path, day: Operation, sampling: str) -> None:
    from sim.lab.recordings.column_map import load_map
    from sim.lab.recordings.traces import load_traces

    spec = Spec("development", "test", 0, sampling=sampling, missing=("TAmbiente",))  # type: ignore[arg-type]
    course = run([(day, machine("development", "stages", True, 0).bearing, still(day), Parts())])[0]
    written_log(tmp_path / "one.csv", day, course, SMOOTH, spec, np.random.default_rng(0))
    traces, report = load_traces(tmp_path / "one.csv", load_map("config/traces/decanter.toml"))
    assert not report.refused and traces[0].synthetic
    names = set(traces[0].signals)
    assert names >= (set(signals_of(day, np.random.default_rng(0))) | {"TCuscinettiRiduttore"}) - {"TAmbiente"}
    assert "TAmbiente" not in names
    steps = np.diff(traces[0].times)
    assert (steps.max() <= 43.0) == (sampling != "gaps")
    assert (np.ptp(steps) == 0) == (sampling == "regular")


def test_a_low_pass_begins_at_rest() -> None:
    assert np.allclose(lagged(np.full(50, 7.0), 10.0, 60.0), 7.0)
