"""An experiment that tells rivals apart: proposed from what a person can set, made on the plant, diagnosed again."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.lab.discrepancy import ceiling as ceiling_room
from sim.lab.discrepancy import proving
from sim.lab.discrepancy.advice import experiment_lines
from sim.lab.discrepancy.beginning import beginning
from sim.lab.discrepancy.diagnosis import GapBeginning, ProposedExperiment
from sim.lab.discrepancy.experiment import (
    ExperimentSchedule,
    barred_loads,
    closer_rows,
    machine_operation,
    propose_experiment,
    rivals_to_tell,
    schedule_steps,
    schedule_trace,
    schedules,
)
from sim.lab.discrepancy.fitting import build_frame, build_record, first_new_cycle, move_frame, rivals
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.heat import Blocks
from sim.lab.discrepancy.held_out import HeldOutRun
from sim.lab.discrepancy.judging import NamingResult, systematic
from sim.lab.discrepancy.naming import NamingStep, step
from sim.lab.discrepancy.proving import JudgedPath, Proof
from sim.lab.discrepancy.rules import RULES, DecisionRules
from sim.lab.discrepancy.workflow import diagnose
from sim.lab.formats import write_model_directory
from sim.lab.recordings import write_trace
from sim.sha import Array
from sim.sha.automaton import Effect, Flow, Input
from sim.sha.events import encode
from sim.sha.model import Model
from sim.sha.trace import Trace
from tests.discrepancy.plants import ALPHABET, model, plant, random_model, simulated, sparse

CURRENT = {"current": "Assorbimento"}
ROLES = {**CURRENT, "pump": "MarciaPmpFango"}
WEAK = Effect("quadratic-current-heating", {"gain": 3e-8, "reference": 200.0, "lag": 150.0}, CURRENT, ("LOW", "HIGH"))
GIVEN, TRUE = random_model(2e-4, 400.0, 0.2), random_model(2e-4, 400.0, 1e-6, WEAK)  # one machine, always the same
EVERY = 2


def looked_at(traces: list[Trace]) -> NamingStep:
    """A weak heat of the current that comes late, and the rival of which it is a case."""
    record = build_record(GIVEN, traces, ("Assorbimento",))
    entries = [entry for entry in catalogue() if entry.name in (WEAK.kind, "late-current-heating")]
    return step(fit(move_frame(build_frame(record), record)), [*entries, *rivals()], CURRENT, rules=RULES)


@pytest.fixture(scope="module")
def first() -> Trace:
    return sparse(simulated(TRUE, 3, days=2), EVERY)


@pytest.fixture(scope="module")
def path(first: Trace) -> NamingResult:
    found = looked_at([first])
    return NamingResult(found.before, found.before, ((found, "is not told from its rival"),))


@pytest.fixture(scope="module")
def proposed(path: NamingResult, first: Trace) -> ProposedExperiment:
    found = propose_experiment(path, [first], ROLES)
    assert found is not None
    return found


def made(proposed: ProposedExperiment, truth: Model, seed: int) -> Trace:
    """The recording of an experiment on a plant that is `truth`, whose current is as restless as ever."""
    rng, rows = np.random.default_rng(seed), proposed.trace
    current = rows.signals["Assorbimento"]
    restless = np.where(current > 0, current + 5 * rng.standard_normal(current.size), 0.0)
    rows = replace(rows, signals={**rows.signals, "Assorbimento": restless})
    rows = replace(rows, events=encode(rows, ALPHABET))
    course = simulate(schedule(truth.sha, rows.events, rows.times, inputs=rows, policy="resync"), 17.0, 1, rng)
    read = course.temperatures[0] + truth.sensor_sigma * rng.standard_normal(rows.times.size)
    return replace(rows, signals={**rows.signals, "T": np.round(read, 1)})


def test_what_is_set_lies_within_what_was_seen_and_a_room_is_not_set() -> None:
    trace = plant(1, days=2, room=0.3)
    operation = machine_operation(model(), [trace], {**ROLES, "ambient": "TAmbiente"})
    assert set(operation.levels) == {"Assorbimento", "MarciaPmpFango"}
    on_ = trace.signals["MarciaDecanter"] > 0.5
    found = schedules(operation, 1500.0)
    assert len({each.what for each in found}) == 6
    for each in found:
        assert {one.signal for one in schedule_steps(each)} <= {"MarciaDecanter", "Assorbimento", "MarciaPmpFango"}
        assert sum(one.seconds for one in schedule_steps(each)) == pytest.approx(each.seconds)
        assert all(one.value in (0.0, 1.0) for one in schedule_steps(each) if one.signal != "Assorbimento")
        values = [one.value for one in schedule_steps(each) if one.signal == "Assorbimento"]
        assert all(trace.signals["Assorbimento"][on_].min() <= value <= 260.0 for value in values), (each.what, values)


def test_a_pump_rests_with_the_machine_and_a_room_goes_on_as_it_went() -> None:
    trace = plant(1, days=2, room=0.3)
    operation = machine_operation(model(), [trace], {**ROLES, "ambient": "TAmbiente"})
    shown = max(schedules(operation, 1500.0), key=lambda each: each.seconds)
    rows = schedule_trace(shown, operation, operation.end + 3600.0)
    rests = rows.signals["MarciaDecanter"] == 0
    assert rests.any() and not rows.signals["MarciaPmpFango"][rests].any()
    # The day after the record is as its last one.
    before = np.interp(rows.times - 86400.0, trace.times, trace.signals["TAmbiente"])
    day = rows.times < operation.end + 86400.0
    assert rows.signals["TAmbiente"][day] == pytest.approx(before[day]) and np.ptp(before[day]) > 5.0


def test_a_load_is_set_where_the_model_knows_what_it_does() -> None:
    trace = plant(1, days=2)
    record = build_record(model(), [trace], ("Assorbimento",))
    operation = machine_operation(model(), [trace], ROLES)
    low, high = operation.levels["Assorbimento"]
    (edge,) = barred_loads(operation, record)
    assert edge == pytest.approx((200.0 - 0.05 * (high - low), 200.0 + 0.05 * (high - low)))
    follows = [
        replace(place, flow=Flow("driven", place.flow.params, (Input("Assorbimento", 0.1, 250.0),)))
        if place.name == "HIGH"
        else place
        for place in model().sha.locations
    ]
    driven = replace(model(), sha=replace(model().sha, locations=tuple(follows)))
    barred = replace(operation, barred=barred_loads(operation, build_record(driven, [trace], ("Assorbimento",))))
    seen = trace.signals["Assorbimento"]
    seen = seen[(seen > 0) & (seen < 200.0)]
    assert barred.nearest_level(180.0) in (
        pytest.approx(np.quantile(seen, 0.95), rel=0.01),
        pytest.approx(edge[1], rel=0.01),
    )
    assert barred.nearest_level(240.0) == 240.0 and barred.nearest_level(150.0) == 150.0
    assert operation.nearest_level(180.0) == 180.0 and replace(operation, barred=(edge,)).nearest_level(201.0) > 204.0


def test_what_is_set_at_once_is_one_step_with_a_time() -> None:
    steps = schedule_steps(
        ExperimentSchedule("", (({"W": 0.0}, 60.0), ({"W": 1.0, "A": 5.0}, 120.0), ({"W": 1.0, "A": 5.0}, 30.0)))
    )
    assert [(one.signal, one.value, one.seconds) for one in steps] == [
        ("W", 0.0, 60.0),
        ("W", 1.0, 0.0),
        ("A", 5.0, 120.0),
        ("W", 1.0, 30.0),
    ]


def test_nothing_is_proposed_where_nothing_is_to_be_told_apart(path: NamingResult, first: Trace) -> None:
    ((found, _),) = path.steps
    alone = replace(found, evidence=found.evidence[:1])
    assert rivals_to_tell(path) and not rivals_to_tell(replace(path, steps=((alone, "is dubious"),)))
    chance = replace(found, rules=replace(RULES, least_gain_nats=1e6))
    assert propose_experiment(replace(path, steps=((chance, "is chance"),)), [first], ROLES) is None


def test_an_experiment_makes_the_margin_that_it_promises(proposed: ProposedExperiment, first: Trace) -> None:
    """Of days with two loads the pair is not told apart; with the experiment it is."""
    (pair,) = proposed.pairs
    assert {pair.one, pair.other} == {WEAK.kind, "late-current-heating"}
    both = looked_at([first, made(proposed, TRUE, 0)])
    assert both.members == (WEAK.kind,)
    assert both.margin > 6.0


def test_the_experiment_is_written_as_a_list_a_table_of_steps_and_a_trace(
    proposed: ProposedExperiment, tmp_path: Path
) -> None:
    lines = experiment_lines(proposed)
    assert lines[0].startswith("experiment: ") and lines[1].startswith("  1. ")
    assert any(line.startswith("  tells ") for line in lines)
    write_trace(proposed.trace, tmp_path / "rows.csv")
    assert proposed.trace.times[-1] - proposed.trace.times[0] == pytest.approx(proposed.seconds, rel=0.02)


def test_an_experiment_has_cycles_that_prove_what_it_shows(proposed: ProposedExperiment) -> None:
    """A name was withheld since days on which nothing showed were all that was held out."""
    runs = proposed.trace.signals["MarciaDecanter"] > 0.5
    assert np.count_nonzero(np.diff(runs.astype(int), prepend=0) > 0) >= RULES.least_cycles


def test_a_pair_that_no_experiment_tells_apart_is_said_with_what_is_expected(proposed: ProposedExperiment) -> None:
    (pair,) = proposed.pairs
    assert pair.most >= pair.nats and pair.most >= proposed.least and not proposed.inseparable
    assert proposed.least < proposed.needed
    twins = replace(pair, nats=0.2, most=0.3)
    weak = replace(pair, nats=proposed.needed - 2.0, most=proposed.needed + 2.0)
    (said,) = experiment_lines(replace(proposed, pairs=(twins,)))[-1:]
    assert (
        f"no experiment within the machine's ranges and two days tells {pair.one} from {pair.other}: 0.3 nats" in said
    )
    assert "may have to be made again" in experiment_lines(replace(proposed, pairs=(twins, weak)))[-1]


def test_what_may_be_too_short_for_the_rows_is_promised_only_in_closer_ones(proposed: ProposedExperiment) -> None:
    """82 nats were promised between a delay and a lag that the experiment showed to be shorter than two rows."""
    assert not any(pair.rows for pair in proposed.pairs), "the time of the heat is no shape that is refused"
    late = Effect("dead-time", {"delay": 66.0}, {}, ())
    trace = simulated(random_model(2e-4, 400.0, 1e-6, late), 3, days=1)  # two rows are 60 s
    record = build_record(GIVEN, [trace], ())
    entries = [entry for entry in catalogue() if entry.name in ("dead-time", "sensor-lag")]
    found = step(fit(move_frame(build_frame(record), record)), entries, {}, rules=RULES)
    twins = replace(found, evidence=tuple(replace(each, gain=100.0) for each in found.evidence))
    twins_path = NamingResult(found.before, found.before, ((twins, "is not told from its rival"),))
    experiment = propose_experiment(twins_path, [trace], ROLES)
    assert experiment is not None
    (pair,) = experiment.pairs
    assert pair.rows == 20.0 and pair.nats >= experiment.needed and not experiment.enough
    assert "only where days and experiment are recorded in rows of 20 s or less" in experiment_lines(experiment)[-1]
    delayed = next(each.fitted for each in found.evidence if each.entry.name == "dead-time")
    assert delayed is not None
    for delay, rows in ((120.0, None), (66.0, 20.0), (45.0, 10.0)):
        named = replace(delayed.state.named[-1], params={"delay": delay, "blur": 0.0})
        assert closer_rows(replace(delayed, state=replace(delayed.state, named=(named,)))) == rows


@pytest.mark.parametrize("long", [1, 2])
def test_of_an_experiment_of_four_cycles_the_last_are_held_out_and_no_gap_begins_with_it(
    long: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    free: list[float] = []
    proofs: list[Proof] = []
    judge = proving.longest_that_passes

    def judged(proof: Proof, paths: Sequence[NamingResult]) -> JudgedPath:
        proofs.append(proof)
        return judge(proof, paths)

    def looked_for(trials: tuple[HeldOutRun, ...], least: float, rules: DecisionRules) -> GapBeginning | None:
        asked.extend(float(trial.record.times.max()) for trial in trials)
        return beginning(trials, least, rules)

    def learned_from(features: Array, heat: Array, blocks: Blocks, *_: object) -> Array:
        free.append(float(blocks.time.max()))
        return np.zeros(heat.size)

    monkeypatch.setattr(proving, "beginning", looked_for)
    monkeypatch.setattr(ceiling_room, "_out_of_fold", learned_from)
    monkeypatch.setattr(proving, "longest_that_passes", judged)
    days, later = plant(1, days=2), plant(5, days=long)
    later = replace(later, times=later.times + 3 * 86400.0, events=())
    record = build_record(model(), [days, replace(later, events=encode(later, ALPHABET))], ())
    assert first_new_cycle(record, [days]) == 6 and first_new_cycle(record, [days, later]) == np.inf
    found = diagnose(model(), [days], seed=0, experiments=[later]).diagnosis
    course = found.course
    assert course is not None
    assert course.held_out[(course.times < later.times[0])].any()
    made = course.held_out[(course.times >= later.times[0])] > 0.5
    assert made.any() == (long > 1) and not made.all()
    assert len(asked) == 2 and max(asked) < later.times[0]
    # Asked about names without the experiment; for a gap speaks what it finds with it.
    assert len(free) == 2 and free[0] < later.times[0] <= free[1]
    assert proofs and all(proof.first_made == 6 for proof in proofs)


def test_a_free_learner_is_not_asked_about_the_repetitions_of_an_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    """A right name was withheld: from one repetition trees foresaw what the model is off by at the same set-points."""
    cycle, rng, size = np.repeat(np.arange(16), 20), np.random.default_rng(0), 320
    made_there = cycle >= 10
    seconds = np.full(size, 600.0)
    blocks = Blocks(
        heat=rng.standard_normal(size) + 1.5 * made_there, seconds=seconds, time=np.cumsum(seconds),
        location=np.zeros(size, int), cycle=cycle, since_start=np.tile(np.cumsum(np.full(20, 600.0)), 16),
        since_stop=np.zeros(size), running=np.ones(size), course=rng.uniform(20.0, 30.0, size),
        signals=np.where(made_there, 150.0, rng.uniform(100.0, 200.0, size))[:, None],
    )  # fmt: skip
    monkeypatch.setattr(ceiling_room, "heat_blocks", lambda _: blocks)
    record = SimpleNamespace(signals=("Assorbimento",), model=SimpleNamespace(temperature="T"))
    fitted: Any = SimpleNamespace(frame=SimpleNamespace(record=record))
    assert systematic(ceiling_room.ceiling(fitted, 0), RULES)
    assert not systematic(ceiling_room.ceiling(fitted, 0, 10.0), RULES)
    assert ceiling_room.ceiling(fitted, 0, 3.0) is None, "of fewer than four cycles nothing is said"


def test_the_command_proposes_and_writes_the_experiment(tmp_path: Path) -> None:
    # A little more of it than above: beside the whole catalogue less of it is its own.
    more = replace(WEAK, params={**WEAK.params, "gain": 4e-8})
    first = sparse(simulated(random_model(2e-4, 400.0, 1e-6, more), 3, days=2), EVERY)
    named = {("TCuscinettiRiduttore" if name == "T" else name): column for name, column in first.signals.items()}
    write_trace(replace(first, signals=named, events=()), tmp_path / "days.csv")
    write_model_directory(tmp_path / "model", replace(GIVEN, temperature="TCuscinettiRiduttore"))
    arguments = ["diagnose", "--model", str(tmp_path / "model"), "--traces", str(tmp_path / "days.csv")]
    arguments += ["--out", str(tmp_path / "out"), "--experiment-trace", str(tmp_path / "rows.csv"), "--no-report"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert "experiment: " in result.output
    assert document["experiment"]["steps"][0].keys() == {"signal", "value", "seconds"}
    assert (tmp_path / "rows.csv").read_text().count("\n") > 100
