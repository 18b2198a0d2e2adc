"""The floor under held-out free runs, and the verdicts that are held against it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine import linear_recursion
from sim.lab.discrepancy.diagnosis import HeldOutProof, NoiseFloor
from sim.lab.discrepancy.fitting import Fitted, Record, build_frame, build_record, fit, move_frame
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.gap import (
    believed_size,
    limit_parameter_errors,
    noise_floor,
    predict_errors,
    scatter_of_equal_cycles,
    size_by_equal_cycles,
    stated_errors,
    told_by_all,
)
from sim.lab.discrepancy.held_out import compare_fits, given_model_run, let_run, mean_squares, reference_runs
from sim.lab.discrepancy.judging import NamingResult, doubts, is_gap, min_noticeable_error
from sim.lab.discrepancy.naming import NamingStep, confirm, step
from sim.lab.discrepancy.proving import Proof, longest_that_passes
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.story import held_out_sentence, little_sentence
from sim.lab.discrepancy.workflow import diagnose
from sim.sha import Distribution, Model, Trace
from tests.discrepancy.plants import TARGETS, model, plant, simulated, sparse

MOST = RULES.floor_parameters_most_times
FOUR_DAYS = 12
"""Cycles of four days."""


def parts(made: Model, trace: Trace, *signals: str) -> tuple[Fitted, Record]:
    """(the fit of the first two thirds of the cycles, the others by cycles)."""
    record = build_record(made, [trace], signals)
    last = 2 * FOUR_DAYS // 3
    base = fit(move_frame(build_frame(record), record.select(record.cycle < last)))
    return base, record.select(record.cycle >= last).by_cycles()


@pytest.fixture(scope="module")
def clean() -> tuple[Fitted, Record]:
    return parts(model(), plant(1))


@pytest.fixture(scope="module")
def pumped() -> tuple[Fitted, Record]:
    return parts(model(), plant(3, pump=2e-4), "MarciaPmpFango")


def floor(made: Model, trace: Trace, base: Fitted, held_out: Record) -> NoiseFloor:
    return noise_floor(stated_errors(made, [trace], base), base, held_out, 0, RULES)


@pytest.mark.parametrize("seed", [1, 2, 11])
def test_where_nothing_is_missing_the_error_lies_within_the_floors_interval(seed: int) -> None:
    base, held_out = parts(model(), plant(seed))
    made = floor(model(), plant(seed), base, held_out)
    held, _, _ = compare_fits(base, base, held_out, 0, made)
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
    least = floor(modest, plant(1), base, held_out)
    assert least.source == "the most that the model's own noise can be taken for"
    assert least.error < 0.8 * made.error


def test_where_nothing_is_missing_held_out_cycles_tell_the_floor_too_and_no_verdict_hangs_on_that() -> None:
    made = NoiseFloor(0.2, (0.1, 0.4), np.arange(3), np.array([0.1, 0.2, 0.3]), "what equal cycles differ by")
    for error in (0.12, 0.2, 0.36):
        all_tell = told_by_all(made, error, 0.3)
        assert all_tell.error**2 == pytest.approx(0.7 * 0.2**2 + 0.3 * error**2)
        assert min(error, 0.2) <= all_tell.error <= max(error, 0.2), "between what both say"
        assert all_tell.interval[0] < error < all_tell.interval[1], "what agreed still does"
        assert all_tell.per_cycle / all_tell.error == pytest.approx(made.per_cycle / 0.2)
    found = diagnose(model(), [plant(1, days=2)], seed=0).diagnosis
    assert found.verdict == "agree" and found.floor is not None and found.held_out is not None
    assert found.floor.source.endswith("and what the held-out ones err by")
    assert found.held_out.noise_floor == found.floor.error
    assert [floor for *_, floor in found.held_out.per_cycle] == found.floor.per_cycle.tolist()


def test_what_the_model_states_draws_the_floor_towards_it_by_as_much_as_the_cycles_leave_open() -> None:
    few, many = (believed_size(0.5, 1.0, pieces, RULES) for pieces in (4, 400))
    assert 0.5 < few[0] < 0.75 and 0.98 < many[0] < 1.0 and many[1] < few[1]
    assert believed_size(3.0, 1.0, 4, RULES)[0] == 1.0, "what is stated beyond may be a cause"
    assert believed_size(float("inf"), 1.0, 4, RULES)[0] == 1.0
    assert few[0] == pytest.approx(
        np.exp(np.log(0.5) * RULES.stated_noise_log_sd**-2 / (RULES.stated_noise_log_sd**-2 + 8))
    )


def test_equal_cycles_are_judged_by_what_the_same_noise_leaves_of_the_same_cycles() -> None:
    """Where nothing is missing they differ by the fit's own noise, and by as much where all of them err alike."""
    record = build_record(model(), [plant(1, days=6)], ())
    base = fit(move_frame(build_frame(record), record), rounds=2)
    trial = let_run(base, base.frame.record.by_cycles())
    alike = replace(trial, residual=trial.residual + 3.0 * (trial.record.window_means(trial.record.running) > 0.5))
    sizes = [size_by_equal_cycles(one, base, np.random.default_rng(0), RULES) for one in (trial, alike)]
    assert 0.8 < sizes[0] < 1.2
    assert sizes[1] == pytest.approx(sizes[0], rel=0.05)


def test_parameters_that_the_fitted_cycles_hardly_show_widen_the_interval_no_more_than_the_floor(
    clean: tuple[Fitted, Record],
) -> None:
    """The car's two held-out trips had a floor of 0.96 degC that was bounded and an interval of 0.08 to 2.2, not."""
    base, held_out = clean
    known = floor(model(), plant(1), base, held_out)
    shown = np.where(np.arange(base.columns.shape[1]) < 3, 0.01, 1.0)
    vague = floor(model(), plant(1), replace(base, columns=base.columns * shown, prior=base.prior * shown**2), held_out)
    assert known.error < vague.error < 2.0 * known.error
    low, high = (limit / vague.error for limit in vague.interval)
    assert low > 0.3 and high < 2.7, (low, high)


def test_what_wrong_parameters_err_by_is_at_most_what_the_noise_does_in_each_cycle(
    clean: tuple[Fitted, Record],
) -> None:
    base, held_out = clean
    trial = let_run(base, held_out)
    noise = trial.whitener.draw(np.random.default_rng(0), 50)
    cycles = mean_squares(trial)[2]
    wrong = trial.record.window_means(trial.record.running)[:, None] * np.random.default_rng(1).standard_normal(50)
    alone, _ = predict_errors(trial, cycles, noise)
    for size, most in ((1e-4, 1.01), (10.0, MOST)):
        errs, drawn = predict_errors(trial, cycles, noise - limit_parameter_errors(trial, size * wrong, noise, MOST))
        assert (errs <= most * alone * (1 + 1e-9)).all() and drawn.size == 50
    assert errs == pytest.approx(MOST * alone), "from the same draws as the interval"


def test_what_turns_between_two_rows_of_a_slow_recorder_is_no_gap() -> None:
    """Learned from rows of seconds, a model states nothing of switches that are known to a minute only."""
    provenance = replace(model().provenance, scores={"held_out_rmse": 0.1})
    proud = replace(model(), alphabet=replace(model().alphabet, gap=60.0), provenance=provenance)
    usual, slow = (sparse(plant(1), every) for every in (1, 4))
    stated = [float(np.mean(stated_errors(proud, [trace], parts(proud, trace)[0]))) for trace in (usual, slow)]
    assert stated[0] < 0.1
    assert stated[1] > 1.5 * stated[0]


def test_what_all_equal_cycles_err_by_alike_is_no_noise() -> None:
    record = build_record(model(), [plant(1, days=6)], ())
    base = fit(move_frame(build_frame(record), record), rounds=2)
    trial = let_run(base, base.frame.record.by_cycles())
    before = scatter_of_equal_cycles(trial.record, trial.residual, RULES)
    # Three degrees more in each cycle's running hours: an error of all alike.
    running = trial.record.window_means(trial.record.running) > 0.5
    missing = replace(trial, residual=trial.residual + 3.0 * running)
    assert scatter_of_equal_cycles(missing.record, missing.residual, RULES) == pytest.approx(before, rel=0.05)
    assert np.sqrt(np.mean(missing.residual**2)) > 5.0 * before
    draws = np.column_stack([trial.residual, missing.residual, 2.0 * trial.residual])
    each = [scatter_of_equal_cycles(trial.record, one, RULES) for one in draws.T]
    assert scatter_of_equal_cycles(trial.record, draws, RULES) == pytest.approx(np.sqrt(np.mean(np.square(each))))


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
    assert is_gap(held, made, sensor=0.1, rules=RULES)
    assert not is_gap(replace(held, rmse_before=0.29), made, sensor=0.1, rules=RULES)
    assert not is_gap(held, made, sensor=2.0, rules=RULES), "nobody feels it"


def test_before_is_told_of_the_model_as_given_and_refitted_and_no_more_than_all_is_removed(
    pumped: tuple[Fitted, Record],
) -> None:
    base, held_out = pumped
    made = NoiseFloor(0.3, (0.1, 0.6), np.arange(8, 12), np.full(4, 0.3), "the sensor alone")
    best = confirmed(base, "pump-cooling").evidence[0].fitted
    assert best is not None
    held, _, second = compare_fits(base, best, held_out, 0, made)
    assert held.rmse_given > held.rmse_before > held.rmse_after
    assert held.rmse_after < 0.3 and held.excess_removed == 1.0 and held.ci95 is not None and held.ci95[1] == 1.0
    assert held.rmse_given == pytest.approx(
        np.sqrt(np.mean(let_run(given_model_run(base), held_out).residual ** 2)), rel=1e-6
    )
    assert mean_squares(second)[2].tolist() == [8, 9, 10, 11]


def confirmed(before: Fitted, name: str) -> NamingStep:
    present = {"pump": "MarciaPmpFango"}
    found = step(before, [one for one in catalogue() if one.name == name], present, rules=RULES)
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
    proof = Proof(held_out, reference_runs(base, held_out), made, np.full(8, 0.1), None, None, 0, RULES)
    judged = longest_that_passes(proof, [whole, beginning])
    assert judged.path is beginning and judged.reasons == ()
    alone = longest_that_passes(proof, [whole])
    assert any("not better foreseen" in reason or "further off" in reason for reason in alone.reasons), alone.reasons
    unsure = replace(beginning, fitted=replace(pump, covariance=1e12 * pump.covariance))
    (reason,) = longest_that_passes(proof, [unsure]).reasons
    assert reason.startswith("pump-cooling is not told from nothing")


def test_a_name_needs_cycles_of_its_own() -> None:
    trace = plant(7, days=2, churning=0.006)
    starts = [event.time for event in trace.events if event.symbol == "W_ON"]
    few = trace.between(float(trace.times[0]), starts[RULES.first_name_least_cycles - 1] - 60.0)
    few = replace(few, events=tuple(event for event in trace.events if event.time <= few.times[-1]))
    found = diagnose(model(), [few], seed=0).diagnosis
    assert found.verdict == "unexplained" and found.effects == ()
    assert any("fewer than 6 cycles" in reason for reason in found.reasons), found.reasons


def test_a_refit_that_foresees_held_out_cycles_worse_than_the_model_as_given_is_refused() -> None:
    """What was warmer for the first half and is as ever since: the fitted cycles ask for other parameters."""
    trace = plant(1, days=4, period=60.0)
    early = np.arange(trace.times.size) < 0.6 * trace.times.size
    warmer = trace.signals["T"] + 4.0 * (early & (trace.signals["MarciaDecanter"] > 0.5))
    found = diagnose(model(), [replace(trace, signals={**trace.signals, "T": warmer})], seed=0, most=1).diagnosis
    held = found.held_out
    assert held is not None and held.rmse_refit is not None and found.floor is not None
    assert held.rmse_before == held.rmse_after == held.rmse_given < 0.5 * held.rmse_refit
    assert found.shifts == () and found.effects == () and found.verdict == "unexplained"
    assert "they stay as given" in found.sentence and "which is refused" in held_out_sentence(found)


def test_no_name_is_given_under_which_the_error_is_greater_than_that_of_the_model_as_given(
    pumped: tuple[Fitted, Record],
) -> None:
    base, held_out = pumped
    first = confirmed(base, "pump-cooling")
    best = first.evidence[0].fitted
    assert best is not None
    path = NamingResult(base, best, ((first, ""),))
    held = HeldOutProof(4, 4, 0.3, 2.0, 0.8, 0.2, 0.85, (0.7, 0.9), ())
    for given, surely, withheld in ((0.3, True, True), (0.3, False, False), (0.9, True, False)):
        reasons = doubts(
            path,
            let_run(base, held_out),
            second=let_run(best, held_out),
            held=replace(held, rmse_given=given),
            before=None,
            left=None,
            given_is_nearer=surely,
        )
        assert any("as it was given" in reason for reason in reasons) is withheld, reasons


def test_where_an_error_of_half_the_temperatures_spread_would_agree_there_is_too_little_data() -> None:
    """A machine temperature that varied by 20 degF "agreed" within 3 to 54 degF."""
    trace = plant(1, days=2, runs_on=True, period=120.0)
    fresh = np.sqrt(1.0 - 0.97**2) * np.random.default_rng(3).standard_normal(trace.times.size)
    wanders = 12.0 * linear_recursion(np.full(fresh.size, 0.97), fresh, 0.0)
    rough = replace(model(), provenance=replace(model().provenance, scores={"held_out_rmse": 12.0}))
    signals = {**trace.signals, "T": trace.signals["T"] + wanders}
    found = diagnose(rough, [replace(trace, signals=signals)], seed=0, most=1).diagnosis
    assert found.floor is not None and found.held_out is not None
    assert found.held_out.rmse_before < found.floor.interval[1] and found.began is None and not found.material
    assert found.verdict == "too-little-data" and found.effects == ()
    assert "would say nothing" in found.sentence and f"{found.floor.interval[1]:.3g} °C by chance" in found.sentence


def test_how_much_is_needed_is_said_or_that_more_of_it_would_not_help() -> None:
    held = HeldOutProof(2, 2, 2.0, 2.0, 2.0, 2.0, None, None, ())
    made = NoiseFloor(2.0, (1.0, 6.0), np.arange(2), np.full(2, 2.0), "the sensor alone")
    assert little_sentence(made, held, 8.0, 4.0, "°C").endswith("About 4 times as much of it is needed.")
    assert "would not help" in little_sentence(made, held, 3.0, 1.5, "°C")
    readings = np.array([10.0, 30.0])
    assert min_noticeable_error(readings, 0.1, RULES) == 5.0 and min_noticeable_error(readings, 20.0, RULES) == 10.0


@pytest.mark.parametrize("seed", [1, 2])
def test_the_floor_of_a_plant_that_is_exact_but_for_its_readings_is_what_windows_of_every_length_err_by(
    seed: int,
) -> None:
    """Windows after a switch have fewer readings than the median one: the floor was 0.87 of the error."""
    made = model()
    flows = {each.name: replace(each.flow, params={**each.flow.params, "noise": 1e-5}) for each in made.sha.locations}
    places = tuple(
        replace(each, flow=flows[each.name], distribution=Distribution("normal", {"mu": target, "sigma": 1e-3}))
        for each, (target, _) in zip(made.sha.locations, TARGETS.values(), strict=True)
    )
    scores = {"held_out_rmse": 0.0668}
    exact = replace(made, sha=replace(made.sha, locations=places), provenance=replace(made.provenance, scores=scores))
    trace = simulated(exact, seed)
    base, held_out = parts(exact, trace)
    told = floor(exact, trace, base, held_out)
    held, _, _ = compare_fits(base, base, held_out, 0, told)
    assert held.rmse_before == pytest.approx(told.error, rel=0.07)
    assert base.sensor_sigma == pytest.approx(0.0668, rel=0.07), "rounding to 0.1 degC is in it"
