"""The benchmark's thermal network: its steady state, a clean machine nearly of first order, what is hidden in it."""

import ast
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.discrepancy.network import measure as network_measure
from benchmarks.discrepancy.network import thermal
from benchmarks.discrepancy.network.baseline import left_over, visible
from benchmarks.discrepancy.network.cases import HIDDEN, plant_of, specs
from benchmarks.discrepancy.network.duty import Duty, duty
from benchmarks.discrepancy.network.figures import tables
from benchmarks.discrepancy.network.hidden import INSIDE, OUTSIDE
from benchmarks.discrepancy.network.measure import COUNTS, drawn_order, judged, measure
from benchmarks.discrepancy.network.thermal import CONTACT, SEAT, Addition, NetworkRun, courses
from benchmarks.discrepancy.runner import Case, Outcome
from benchmarks.discrepancy.seal import Label, write_labels
from benchmarks.discrepancy.visible import Family
from sim.effects import EFFECTS

ROOM = Path(thermal.__file__).parent


def test_the_network_shares_no_code_with_what_it_tests() -> None:
    for name in ("duty", "thermal", "hidden", "baseline"):
        tree = ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))
        froms = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not [one for one in froms if one.split(".")[0] in ("sim", "gateway", "drivers")], name


def test_what_is_hidden_is_named_as_the_catalogue_names_it() -> None:
    assert {name for name, _ in INSIDE.values()} <= set(EFFECTS)
    assert not set(OUTSIDE) & set(EFFECTS)
    assert [spec.effects for spec in specs("tuning", "singles", [0])] == [(INSIDE["winding"][0],)]
    with pytest.raises(ValueError, match="there is no stratum 'none'"):
        specs("tuning", "none", [0])


def test_at_a_steady_load_all_heat_leaves_through_the_housing() -> None:
    day = duty(np.random.default_rng(1), 0.1, "shifts")
    steady = np.ones(day.running.size)
    held = replace(day, running=steady, load=200.0 * steady, starts=(0,))
    plant = replace(plant_of(np.random.default_rng(2), False), viscous=0.0, running=60.0, inrush=0.0, hall=18.0)
    last = courses([NetworkRun(duty=held, plant=plant, addition=Addition(), unrest=0.0 * steady)])[0][-1]
    heat = plant.idle + 200.0 * plant.slope
    assert last == pytest.approx(18.0 + heat / 60.0 + SEAT * heat / CONTACT["outer-housing"], abs=0.01)


def test_a_measurement_draws_its_order_and_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = drawn_order("final")
    assert [spec.identifier for spec in order] == [spec.identifier for spec in drawn_order("final")]
    assert len({spec.identifier for spec in order}) == sum(COUNTS.values()) == 500
    assert 2 < sum(spec.stratum == "clean" for spec in order[:12]) < 10
    first = order[:3]
    labels = [
        Label(
            case=spec.identifier,
            spec=asdict(spec),
            strengths={},
            ratios=dict.fromkeys(spec.hidden, spec.ratio),
            outside=tuple(name for name in spec.hidden if name in OUTSIDE),
            baseline_gap=0.0,
            sensor=0.1,
            floor=0.1,
            machine="",
        )
        for spec in order[:12]
    ]
    for label in labels:  # as if made before
        (tmp_path / "cases" / label.case).mkdir(parents=True)
        Label.write_config(tmp_path / "cases" / label.case, {"traces": "t.csv", "seed": 0, "model": "m"})
    write_labels(tmp_path, "made", labels)
    asked: list[str] = []

    def agrees(one: Case, _limit: float) -> Outcome:
        asked.append(one.name)
        return Outcome(one.name, "done", 1.0, {"verdict": "agree"})

    ticks = iter(range(100))
    measure(first, tmp_path, agrees, limit=1.0, seconds=3.0, clock=lambda: float(next(ticks)))
    assert asked == [spec.identifier for spec in first[:1]]
    measure(first, tmp_path, agrees, limit=1.0, seconds=100.0)
    assert asked == [spec.identifier for spec in first]
    monkeypatch.setattr(network_measure, "family_of", lambda _model: Family((0, 1, 1, 1, 1), (-1,) * 5))
    table = tables(judged(first, tmp_path))
    assert table.startswith("3 cases") and "errors and cases over the limit | 0.0 %" in table
    assert "| model without a gain: current-heating named | 0.0 % | 0.0-70.8 | 0/3 |" in table


@pytest.fixture(scope="module")
def half_a_day() -> tuple[Duty, np.ndarray, np.ndarray]:
    work = duty(np.random.default_rng(3), 0.4, "shifts")
    plant, calm = plant_of(np.random.default_rng(4), False), np.zeros(work.running.size)
    cooled = HIDDEN["cooler"](work, 1.0, np.random.default_rng(5))
    runs = [NetworkRun(duty=work, plant=plant, addition=each, unrest=calm) for each in (Addition(), cooled)]
    clean, hidden = courses(runs)
    return work, clean, hidden


def test_a_clean_machine_is_nearly_of_first_order_and_what_is_hidden_is_not(
    half_a_day: tuple[Duty, np.ndarray, np.ndarray],
) -> None:
    work, clean, hidden = half_a_day
    assert left_over(work, clean) < 0.02
    assert visible(work, clean, hidden) > 0.1
