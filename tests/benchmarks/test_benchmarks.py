"""Each benchmark runs in a tiny setting and prints its figures as JSON; whether they are fast is not asserted.

`make bench-tests` runs them all; `make test` one of them, and loads the others.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import run, skill, virtual_sensor
from benchmarks.figures import Figure, as_table
from benchmarks.isolation import STOOD_STILL
from benchmarks.latency import Scan, follow
from benchmarks.peers.plcs import judged
from benchmarks.processes import CURRENT, MAP, TEMPERATURE, learned_model, plant_file
from gateway.settings import load_plant
from sim.plc.program.encoding import encode
from sim.plc.program.registers import read_map
from sim.plc.record.recording import BlockRow, RequestRow, TruthRow
from sim.sha import Flow, Trace
from tests.gateway.support import EPOCH, two_modes
from tests.rig.no_bands import without_bands

REGISTERS = read_map(MAP)
TRIES = 3


@pytest.fixture(scope="session")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benchmarks")
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        learned_model(folder)
    return folder


def said(name: str, *options: str) -> dict[str, Any]:
    """What a benchmark prints; `run` has each in a process of its own, here their libraries are loaded once."""
    for _ in range(TRIES):
        done = CliRunner().invoke(import_module(f"benchmarks.{name}").main, ["--json", *options])
        if STOOD_STILL not in done.stderr:
            break
    assert done.exit_code == 0, (done.stderr, done.exception)
    return dict(json.loads(done.stdout))


def by_name(figures: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    assert figures
    for one in figures:
        assert math.isfinite(one["value"]) and one["value"] >= 0.0, one
        assert (one["ratio"] is None) == (not one["other"]), one
    return {one["name"]: one for one in figures}


@pytest.mark.benchmark
def test_latency_follows_every_change_to_its_block(model_folder: Path) -> None:
    options = ("--changes", "6", "--period", "0.2", "--model-folder", str(model_folder))
    figures = by_name(said("latency", *options)["figures"])
    assert figures["changes followed and proven"]["value"] == 6
    assert figures["register read to its block, p50"]["against"] == "two bare round trips, p50"


@pytest.mark.benchmark
def test_footprint_counts_the_scans_of_a_living_gateway(model_folder: Path) -> None:
    figures = by_name(said("footprint", "--seconds", "1.5", "--model-folder", str(model_folder))["figures"])
    assert figures["scans with an accepted block"]["value"] >= 1
    assert figures["peak resident size of the gateway"]["value"] > figures["peak resident size of the gateway"]["other"]


@pytest.mark.benchmark
def test_beside_a_busy_neighbour_a_bare_client_shows_what_is_lost_outside_the_gateway(model_folder: Path) -> None:
    options = ("--neighbours", "1", "--machines", "1", "--seconds", "1.5", "--model-folder", str(model_folder))
    figures = by_name(said("footprint", *options)["figures"])
    ages = figures["  age of a block when followed, p99"]
    assert ages["value"] > 0 < ages["other"] and "bare client" in ages["against"]


@pytest.mark.benchmark
def test_memory_by_import_is_all_of_a_running_gateways_which_loads_nothing_that_it_does_not_need(
    model_folder: Path,
) -> None:
    options = ("--imports", "--seconds", "1.5", "--forecast", "0.3", "--model-folder", str(model_folder))
    figures = by_name(said("footprint", *options)["figures"])
    peak = figures.pop("peak resident size of the gateway")["value"]
    assert sum(one["value"] for one in figures.values()) == pytest.approx(peak, rel=0.1)
    assert {"numpy", "pydantic", "cryptography"} <= figures.keys()


@pytest.mark.benchmark
def test_several_machines_are_one_plant_file_and_a_number_of_none_is_refused(
    tmp_path: Path, model_folder: Path
) -> None:
    plant = plant_file(tmp_path, model_folder / "model", 0.1, forecast=10.0, ports={"east": 1502, "west": 1503})
    assert [(one.machine, one.device.port, one.forecast.period) for one in load_plant(plant)] == [
        ("east", 1502, 10.0),
        ("west", 1503, 10.0),
    ]
    refused = CliRunner().invoke(import_module("benchmarks.footprint").main, ["--machines", "1,none"])
    assert refused.exit_code == 2 and "whole numbers from 1 on" in refused.stderr


@pytest.mark.benchmark
def test_a_newcomers_hour_ends_with_a_prediction_and_a_shadow_block(model_folder: Path) -> None:
    """From `decanter docs --examples` on, with the installed program and without the learning."""
    figures = by_name(said("first_hour", "--quick", "--model-folder", str(model_folder / "model"))["figures"])
    assert figures["commands"]["value"] == 9 <= figures["commands"]["other"]


@pytest.mark.benchmark
def test_the_campaigns_benchmark_times_all_four_models(model_folder: Path) -> None:
    options = ("--quick", "--traces", "1", "--runs", "50", "--rows", "5000", "--model-folder", str(model_folder))
    figures = said("campaign", *options)["figures"]
    assert {"s", "MB"} == {one["unit"] for one in figures} and all(one["value"] > 0 for one in figures)
    assert sum("4 jobs" in one["name"] for one in figures) == 4


@pytest.mark.benchmark
def test_the_semantics_benchmark_holds_each_trace_out_once_and_gives_the_gain_with_its_interval(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The bands, for which each model is fitted three times more: nothing is asked of them here.
    without_bands(monkeypatch)
    figures = {one["name"]: one for one in said("semantics", "--quick")["figures"]}
    carried = figures["cd1..cd17, held out: MAE, carried"]
    (gain,) = (one for name, one in figures.items() if "gain in MAE, 2 traces" in name)
    assert gain["value"] == pytest.approx(carried["other"] - carried["value"])
    assert figures["cd1..cd17, held out: carried is better (MAE)"]["other"] == 2


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("startup", ("--quick",)),
        ("historian", ("--quick",)),
        ("encoder", ("--rows", "3000", "--repeats", "1")),
        ("belief", ("--quick",)),
        ("simulation", ("--quick",)),
        ("can", ("--quick",)),
        ("can_logs", ("--quick", "--repeats", "1")),
        ("guess", ("--cases", "10")),
        ("units", ("--quick",)),
        ("isolation", ("--quick",)),
        ("unit_faults", ("--quick",)),
        ("device_habits", ("--quick",)),
    ],
)
def test_a_benchmark_prints_its_figures_as_json(name: str, options: Sequence[str]) -> None:
    assert by_name(said(name, *options)["figures"])


@pytest.mark.benchmark
def test_what_a_node_does_on_a_shared_bus_costs_the_others_little_and_makes_no_wrong_value_good() -> None:
    figures = by_name(said("isolation", "--quick", "--link", "canopen")["figures"])
    assert figures["wrong values that were good, all machines"]["value"] == 0
    assert figures["faults on the harmed machine"]["value"] > 0
    assert figures["scans done of the others"]["ratio"] > 0.5


@pytest.mark.benchmark
def test_hours_of_the_plants_go_by_in_minutes_with_blocks_that_the_plcs_take() -> None:
    figures = by_name(said("isolation", "--quick", "--speed", "40", "--armed")["figures"])
    assert figures["wrong values that were good, all machines"]["value"] == 0
    assert figures["so many of them"]["value"] > 0 and figures["so many of them"]["other"] > 0


@pytest.mark.benchmark
def test_hostile_peers_are_set_beside_a_gateway_that_has_none() -> None:
    figures = {one["name"]: one for one in said("hostile_northbound", "--quick")["figures"]}
    assert figures["wrong values that were good"]["value"] == 0
    assert figures["threads at the end"]["value"] > figures["threads at the end, without peers"]["value"] > 0
    assert {
        f"connections, {side}" for side in ("mqtt", "postgres", "smtp", "page", "opcua", "control")
    } < figures.keys()


@pytest.mark.benchmark
def test_peers_sets_the_gateway_against_the_loop_in_c_on_the_same_plcs() -> None:
    options = ("--count", "2", "--seconds", "1", "--only", "plant+blocks", "--only", "C loop")
    figures = by_name(said("peers.__main__", *options)["figures"])
    assert figures["2 PLCs, plant+blocks: blocks written"]["value"] > 0
    for name in ("plant+blocks", "C loop"):
        assert figures[f"2 PLCs, {name}: polls done"]["other"] == 20
        assert 0 < figures[f"2 PLCs, {name}: polls done"]["value"] <= 20
    assert figures["polls a second that the PLCs answer"]["ratio"] > 1


def test_peers_counts_a_deadline_once_and_against_the_grid_that_suits_the_contender() -> None:
    # Ten deadlines from 100.03 on; the third poll is 20 ms late, the fifth is not there, the seventh comes twice.
    moments = [100.03 + 0.1 * number for number in range(10) if number != 4]
    moments[2] += 0.02
    moments.append(moments[5] + 0.01)
    polls = judged([np.array(sorted(moments))], 0.1, 100.0, 101.0)
    assert (polls.due, polls.done) == (10, 9)
    assert sorted(polls.lateness) == pytest.approx([0.0] * 8 + [0.02], abs=1e-9)
    # One that is late by more than half a period does not make the others late.
    moments[2] += 0.04
    assert sorted(judged([np.array(sorted(moments))], 0.1, 100.0, 101.0).lateness)[-2] < 1e-9
    assert judged([np.empty(0)], 0.1, 100.0, 101.0).done == 0


@pytest.mark.parametrize("name", sorted(path.stem for path in Path(run.__file__).parent.glob("[a-z]*.py")))
def test_a_benchmark_can_be_loaded_and_explains_itself(name: str) -> None:
    main = getattr(import_module(f"benchmarks.{name}"), "main", None)
    if isinstance(main, click.Command):
        assert "--help" in CliRunner().invoke(main, ["--help"]).stdout


def test_run_gives_the_figures_of_all_and_the_machine() -> None:
    told = said("run", "--only", "simulation")
    assert by_name(told["figures"]["simulation"]) and told["failed"] == []
    assert {"cores", "python", "libraries", "load"} <= set(told["machine"])


def test_a_figure_without_a_counterpart_has_no_ratio_and_a_row_all_the_same() -> None:
    figures = [Figure("a", 3.0, "s", "b", 2.0), Figure("c", 1.0, "s")]
    assert [one.ratio for one in figures] == [1.5, None]
    assert as_table("figures", figures).row_count == 2


@pytest.mark.benchmark
@pytest.mark.real_data
@pytest.mark.skipif(not skill.DATA.is_dir(), reason="the measured data (../shared/data) is not here")
def test_skill_sets_ours_against_the_best_other_method() -> None:
    options = (
        "--quick",
        "--sets",
        "pump",
        "--methods",
        "lsha",
        "--methods",
        "persistence",
        "--period",
        "600",
        "--jobs",
        "1",
    )
    figures = by_name(said("skill", *options)["figures"])
    assert set(figures) == {f"pump, {h} s, lsha: {what}" for h in (60, 300, 900) for what in ("CRPS", "coverage")}
    assert figures["pump, 60 s, lsha: CRPS"]["against"] == "best other: persistence"


def test_skill_without_measured_data_has_no_figures_and_says_so(tmp_path: Path) -> None:
    assert said("skill", "--data", str(tmp_path)) == {"benchmark": "skill", "figures": []}
    done = CliRunner().invoke(skill.main, ["--data", str(tmp_path)])
    assert done.exit_code == 1 and "has none of the sets car, pump, bearing; name their folder" in done.stderr


# ---------------------------------------------------------------- the proof that a block holds a change


def scan(moment: float, version: int, temperature: float, current: float, location: int) -> Scan:
    """A read of holding:101 to 106 that serves these values, and the block 2 ms later."""
    words = [*encode(REGISTERS.tags[CURRENT], current), 0, 0, 0, *encode(REGISTERS.tags[TEMPERATURE], temperature)]
    reply = bytes(9) + b"".join(word.to_bytes(2, "big") for word in words)
    read = RequestRow(moment, moment, "a", 1, 1, 3, 101, len(words), b"", reply, None, 0.0, (), version)
    block = BlockRow(moment + 0.002, moment, "a", 400, (), {"location": float(location)}, "none", True)
    return Scan(read, block)


def change(moment: float, version: int, tag: str, value: float) -> TruthRow:
    return TruthRow(moment, moment, version, tag, value)


def test_a_change_is_followed_to_the_block_of_the_first_read_that_saw_it() -> None:
    scans = [scan(0.0, 1, 20.0, 150.0, 4), scan(1.0, 5, 20.5, 250.0, 5), scan(2.0, 9, 20.5, 250.0, 5)]
    found = follow([change(0.4, 3, TEMPERATURE, 20.5), change(0.6, 4, CURRENT, 250.0)], scans, REGISTERS)
    assert (found.lost, found.unproven) == (0, 0)
    assert found.waited == pytest.approx([0.6, 0.4]) and found.total == pytest.approx([0.602, 0.402])


def test_a_change_that_is_overwritten_before_it_is_read_or_never_read_is_lost() -> None:
    scans = [scan(0.0, 1, 20.0, 150.0, 4), scan(1.0, 5, 21.0, 150.0, 4)]
    changes = [change(0.4, 3, TEMPERATURE, 20.5), change(0.6, 4, TEMPERATURE, 21.0), change(1.5, 8, CURRENT, 250.0)]
    found = follow(changes, scans, REGISTERS)
    assert (len(found.total), found.lost, found.unproven) == (1, 2, 0)


def test_a_reply_without_the_value_or_a_block_without_its_location_proves_nothing() -> None:
    other_reply = follow([change(0.4, 3, TEMPERATURE, 20.5)], [scan(1.0, 5, 20.0, 150.0, 4)], REGISTERS)
    same_location = [scan(0.0, 1, 20.0, 150.0, 4), scan(1.0, 5, 20.0, 250.0, 4)]
    other_block = follow([change(0.4, 3, CURRENT, 250.0)], same_location, REGISTERS)
    assert (other_reply.unproven, other_block.unproven) == (1, 1)


async def test_a_model_that_is_right_holds_where_its_sensor_is_bad_and_the_last_reading_does_not() -> None:
    times = np.arange(0.0, 10_000.0, 20.0)
    truth = 50.0 - 30.0 * np.exp(-0.0005 * times)
    readings = truth + 0.05 * np.random.default_rng(0).standard_normal(times.size)
    signals = {"MarciaDecanter": np.ones(times.size), "Assorbimento": np.full(times.size, 150.0), TEMPERATURE: readings}
    slow = two_modes(gap=120.0)
    *others, on = slow.sha.locations
    on = replace(on, flow=Flow("exponential", {"k": 0.0005, "noise": 0.01}))
    model = replace(slow, sha=replace(slow.sha, locations=(*others, on)))
    rows, _ = await virtual_sensor.failures(model, Trace("heating", EPOCH + times, signals), period=20.0, every=600.0)
    assert {row[0] for row in rows} == set(virtual_sensor.AFTER)
    for figure in virtual_sensor.table_of("plant", rows):
        if figure.name.endswith("mean error"):
            assert figure.other is not None and figure.value < 0.5 * figure.other, figure
        if figure.name.endswith("coverage"):
            assert figure.value >= 0.75, figure
