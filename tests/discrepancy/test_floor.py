"""The floor under held-out free runs, and the verdicts that are held against it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.discrepancy import workflow
from sim.discrepancy.diagnosis import HeldOutProof, NoiseFloor
from sim.discrepancy.fitting import Fitted, Record, fit, frame_of, on, record_of
from sim.discrepancy.fitting.candidates import catalogue
from sim.discrepancy.gap import floor_of, scatter_of_equal_cycles, stated_errors
from sim.discrepancy.held_out import as_given, compared, let_run, mean_squares
from sim.discrepancy.judging import NamingResult, above
from sim.discrepancy.naming import NamingStep, confirm, step
from sim.discrepancy.workflow import FIRST_NAME_CYCLES, diagnose
from sim.sha import Model, Trace
from tests.discrepancy.plants import model, plant, sparse

FOUR_DAYS = 12
"""Cycles of four days."""


def parts(made: Model, trace: Trace, *signals: str) -> tuple[Fitted, Record]:
    """(the fit of the first two thirds of the cycles, the others by cycles)."""
    record = record_of(made, [trace], signals)
    last = 2 * FOUR_DAYS // 3
    base = fit(on(frame_of(record), record.where(record.cycle < last)))
    return base, record.where(record.cycle >= last).by_cycles()


@pytest.fixture(scope="module")
def clean() -> tuple[Fitted, Record]:
    return parts(model(), plant(1))


@pytest.fixture(scope="module")
def pumped() -> tuple[Fitted, Record]:
    return parts(model(), plant(3, pump=2e-4), "MarciaPmpFango")


def floor(made: Model, trace: Trace, base: Fitted, held_out: Record) -> NoiseFloor:
    return floor_of(stated_errors(made, [trace], base), base, held_out, 0)


@pytest.mark.parametrize("seed", [1, 2, 11])
def test_where_nothing_is_missing_the_error_lies_within_the_floors_interval(seed: int) -> None:
    base, held_out = parts(model(), plant(seed))
    made = floor(model(), plant(seed), base, held_out)
    held, _, _ = compared(base, base, held_out, 0, made)
    low, high = made.interval
    assert low < held.rmse_before < high and low < made.error < high
    assert held.noise_floor == made.error and made.per_cycle.size == held.cycles == 4


def test_a_model_that_takes_everything_for_noise_does_not_lift_the_floor(clean: tuple[Fitted, Record]) -> None:
    """One that was learned without a cause states it as its own noise: what it leaves of the fitted cycles counts."""
    proud = replace(model(), provenance=replace(model().provenance, scores={"held_out_rmse": 5.0}))
    base, held_out = clean
    made = floor(proud, plant(1), base, held_out)
    assert made.error < 0.5 and made.source != "what the model states of its own free runs"
    modest = replace(model(), provenance=replace(model().provenance, scores={"held_out_rmse": 0.07}))
    assert floor(modest, plant(1), base, held_out).source == "what the model states of its own free runs"


def test_what_turns_between_two_rows_of_a_slow_recorder_is_no_gap() -> None:
    """Learned from rows of seconds, a model states nothing of switches that are known to a minute only."""
    provenance = replace(model().provenance, scores={"held_out_rmse": 0.1})
    proud = replace(model(), alphabet=replace(model().alphabet, gap=60.0), provenance=provenance)
    usual, slow = (sparse(plant(1), every) for every in (1, 4))
    stated = [float(np.mean(stated_errors(proud, [trace], parts(proud, trace)[0]))) for trace in (usual, slow)]
    assert stated[0] < 0.1
    assert stated[1] > 1.5 * stated[0]


def test_what_all_equal_cycles_err_by_alike_is_no_noise() -> None:
    record = record_of(model(), [plant(1, days=6)], ())
    base = fit(on(frame_of(record), record), rounds=2)
    trial = let_run(base, base.frame.record.by_cycles())
    before = scatter_of_equal_cycles(trial)
    # Three degrees more in each cycle's running hours: an error of all alike.
    running = trial.record.windowed(trial.record.running) > 0.5
    missing = replace(trial, residual=trial.residual + 3.0 * running)
    assert scatter_of_equal_cycles(missing) == pytest.approx(before, rel=0.05)
    assert np.sqrt(np.mean(missing.residual**2)) > 5.0 * before


def test_neither_another_column_nor_its_digits_nor_names_move_floor_or_verdict() -> None:
    trace = plant(1, days=2)
    other = {**trace.signals, "TAmbiente": trace.signals["TAmbiente"] + 0.01, "Nota": np.arange(trace.times.size) % 7.0}
    renamed = replace(trace, name="something else", origin="", signals=other)
    seen = replace(model(), provenance=replace(model().provenance, contents=("0" * 64,)))
    found = [diagnose(each, [one], seed=0).diagnosis for each, one in ((model(), trace), (seen, renamed))]
    assert found[0].verdict == found[1].verdict == "agree"
    assert found[0].floor is not None and found[1].floor is not None
    assert found[0].floor.error == pytest.approx(found[1].floor.error, rel=1e-6)


def test_an_error_beyond_the_interval_that_could_be_felt_is_a_gap_and_within_it_none() -> None:
    made = NoiseFloor(0.2, (0.1, 0.3), np.arange(4), np.full(4, 0.2), "the sensor alone")
    held = HeldOutProof(4, 4, 0.5, 0.31, 0.31, 0.2, None, None, ())
    assert above(held, made, sensor=0.1)
    assert not above(replace(held, rmse_before=0.29), made, sensor=0.1)
    assert not above(held, made, sensor=2.0), "nobody feels it"


def test_before_is_told_of_the_model_as_given_and_refitted_and_no_more_than_all_is_removed(
    pumped: tuple[Fitted, Record],
) -> None:
    base, held_out = pumped
    made = NoiseFloor(0.3, (0.1, 0.6), np.arange(8, 12), np.full(4, 0.3), "the sensor alone")
    best = confirmed(base, "pump-cooling").evidence[0].fitted
    assert best is not None
    held, _, second = compared(base, best, held_out, 0, made)
    assert held.rmse_given > held.rmse_before > held.rmse_after
    assert held.rmse_after < 0.3 and held.excess_removed == 1.0 and held.ci95 is not None and held.ci95[1] == 1.0
    assert held.rmse_given == pytest.approx(np.sqrt(np.mean(let_run(as_given(base), held_out).residual ** 2)), rel=1e-6)
    assert mean_squares(second)[2].tolist() == [8, 9, 10, 11]


def confirmed(before: Fitted, name: str) -> NamingStep:
    present = {"pump": "MarciaPmpFango"}
    found = step(before, [one for one in catalogue() if one.name == name], present, 0)
    assert found.best is not None
    mine = next(each for each in found.evidence if each.entry.name == name)
    return replace(found, evidence=(confirm(before, mine),))


def test_a_superfluous_second_name_does_not_take_the_first_one_down(pumped: tuple[Fitted, Record]) -> None:
    base, held_out = pumped
    first = confirmed(base, "pump-cooling")
    pump = first.evidence[0].fitted
    assert pump is not None
    # A second one that does harm on other cycles: two degrees too much while the machine runs.
    targets = pump.state.linear + 2.0
    second = replace(pump, state=replace(pump.state, linear=targets))
    evidence = (replace(confirmed(base, "startup-churning").evidence[0], fitted=second),)
    harmful = replace(first, before=pump, evidence=evidence)
    whole = NamingResult(base, second, ((first, ""), (harmful, "")))
    beginning = NamingResult(base, pump, ((first, ""), (harmful, "does not pass")))
    made = floor(model(), plant(3, pump=2e-4), pump, held_out)
    proof = workflow._Proof(held_out, made, np.full(8, 0.1), None, None, 0)
    judged = workflow._longest_that_passes(proof, [whole, beginning])
    assert judged.path is beginning and judged.reasons == ()
    alone = workflow._longest_that_passes(proof, [whole])
    assert any("not better foreseen" in reason or "further off" in reason for reason in alone.reasons), alone.reasons


def test_a_name_needs_cycles_of_its_own() -> None:
    trace = plant(7, days=2, churning=0.006)
    starts = [event.time for event in trace.events if event.symbol == "W_ON"]
    few = trace.between(float(trace.times[0]), starts[FIRST_NAME_CYCLES - 1] - 60.0)
    few = replace(few, events=tuple(event for event in trace.events if event.time <= few.times[-1]))
    found = diagnose(model(), [few], seed=0).diagnosis
    assert found.verdict == "unexplained" and found.effects == ()
    assert any("fewer than 6 cycles" in reason for reason in found.reasons), found.reasons
