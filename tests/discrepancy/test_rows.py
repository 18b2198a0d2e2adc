"""A slow recorder knows a switch to a row only: what that does is known, and no name rests on it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine import linear_recursion
from sim.lab.discrepancy.fitting import Whitener, build_frame, build_record, fit, move_frame, window_grid
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.fitting.course import LATE_APART, LATE_TOGETHER, inrush, lateness, run_free
from sim.lab.discrepancy.fitting.free_run_fit import with_reading_error
from sim.lab.discrepancy.fitting.named import Named
from sim.lab.discrepancy.fitting.noise import NoiseModel
from sim.lab.discrepancy.gap import noise_floor
from sim.lab.discrepancy.held_out import let_run
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from sim.sha.events import encode
from tests.discrepancy.plants import ALPHABET, TARGETS, model, plant, sparse


def test_a_switch_between_two_rows_moves_the_temperature_by_no_more_than_the_stated_jump() -> None:
    trace = plant(1, days=1, period=5.0)
    fine, coarse = (build_record(model(), [each], ()) for each in (trace, sparse(trace, 12)))
    courses = []
    for record in (fine, coarse):
        frame = build_frame(record)
        courses.append(run_free(frame, *np.split(frame.centre, [frame.count[0]]), np.array([17.0])))
    jump = lateness(build_frame(coarse), courses[1])
    begun = int(np.flatnonzero(np.diff(coarse.running) > 0)[1])  # the first one is at a row of both
    x = courses[1].course[begun]
    (rest, at_rest), (low, running) = TARGETS["OFF"], TARGETS["LOW"]
    assert jump[begun] == pytest.approx(60.0 * (running * (low - x) - at_rest * (rest - x)), rel=1e-6)
    # Two rows on, the finer record is ahead by a part of it between nothing and all.
    at = coarse.runs.time[begun + 2]
    ahead = np.interp(at, fine.runs.time, courses[0].course) - courses[1].course[begun + 2]
    assert 0.1 * jump[begun] < ahead < jump[begun]


def test_a_step_of_the_load_is_known_to_a_row_and_what_is_restless_or_on_its_way_does_not_step() -> None:
    trace = sparse(plant(1, days=1, period=5.0), 12)
    record = build_record(model(), [trace], ("Assorbimento",))
    frame = build_frame(record)
    state = run_free(frame, *np.split(frame.centre, [frame.count[0]]), np.array([17.0]))
    late, runs = lateness(frame, state), record.runs
    stepped = np.append((np.diff(runs.place) != 0) & (np.diff(record.running) == 0), False)
    (low, k), (high, _) = TARGETS["LOW"], TARGETS["HIGH"]
    assert stepped.sum() > 5
    assert np.abs(late[stepped]) == pytest.approx(60.0 * k * (high - low), rel=1e-6)
    # From 100 A to 300 A in twenty rows, and a load that is another one in each row: both cross the bin's boundary.
    running = trace.signals["MarciaDecanter"] > 0.5
    ramp = 200.0 + 100.0 * np.abs((np.arange(running.size) / 20.0) % 4.0 - 2.0) - 100.0
    restless = np.random.default_rng(0).uniform(100.0, 300.0, running.size)
    for current in (ramp, restless):
        rows = replace(trace, signals={**trace.signals, "Assorbimento": running * current}, events=())
        moving = build_record(model(), [replace(rows, events=encode(rows, ALPHABET))], ("Assorbimento",))
        inside = (np.diff(moving.runs.place) != 0) & (np.diff(moving.running) == 0)
        beside = np.convolve(np.diff(moving.running) != 0, np.ones(13), "same") == 0  # where starts and stops are far
        assert (inside & beside).sum() > 5 and np.mean(moving.turned[:-1][inside & beside]) < 0.05


def test_what_a_start_draws_in_its_first_seconds_is_believed_of_no_law() -> None:
    trace = plant(1, days=1, period=5.0)
    on = trace.signals["MarciaDecanter"]
    starts = np.flatnonzero(np.diff(on) > 0) + 1
    current = trace.signals["Assorbimento"].copy()
    current[starts] = 400.0
    rows = replace(trace, signals={**trace.signals, "Assorbimento": current}, events=())
    rushing = replace(rows, events=encode(rows, ALPHABET))
    saturation = next(entry for entry in catalogue() if entry.name == "current-saturation")
    heat = Named(saturation, {"current": "Assorbimento"}, {"gain": 1e-4, "knee": 300.0})
    jumps = []
    for one in (trace, rushing):
        frame = build_frame(build_record(model(), [one], ("Assorbimento",)))
        state = run_free(frame, *np.split(frame.centre, [frame.count[0]]), np.array([17.0]), named=[heat])
        jumps.append(inrush(frame, state))
        quiet = np.flatnonzero(jumps[-1])
    assert not jumps[0].any()
    (low, k), (high, _) = TARGETS["LOW"], TARGETS["HIGH"]
    # One row of each start in the upper bin, which the effect cools by 100 A beyond its knee.
    after = {5.0 * (k * (high - level) - 1e-4 * 100.0) for level in (low, high)}
    assert quiet.size == starts.size
    assert all(min(abs(jump - one) for one in after) < 1e-9 for jump in jumps[1][quiet])


def test_what_a_start_draws_comes_late_where_the_heat_of_the_current_does() -> None:
    """All of it, and afterwards: else a lag of the sensor would be what is left of it."""
    trace = plant(1, days=1, period=5.0)
    on = trace.signals["MarciaDecanter"]
    starts = np.flatnonzero(np.diff(on) > 0) + 1
    current = trace.signals["Assorbimento"].copy()
    after = current[starts + 1]
    current[starts] = 400.0
    rows = replace(trace, signals={**trace.signals, "Assorbimento": current}, events=())
    frame = build_frame(build_record(model(), [replace(rows, events=encode(rows, ALPHABET))], ("Assorbimento",)))
    late = next(entry for entry in catalogue() if entry.name == "late-current-heating")
    jumps = []
    for gain in (1e-9, 1e-4):
        heat = Named(late, {"current": "Assorbimento"}, {"gain": gain, "reference": 200.0, "lag": 60.0})
        state = run_free(frame, *np.split(frame.centre, [frame.count[0]]), np.array([17.0]), named=[heat])
        jumps.append(inrush(frame, state))
    of_heat = jumps[1] - jumps[0]
    rushed = frame.record.rushed
    assert np.sum(of_heat) == pytest.approx(1e-4 * np.sum(400.0 - after) * 5.0, rel=0.02)
    assert np.sum(of_heat[~rushed]) > 0.8 * np.sum(of_heat)


def test_jumps_are_in_the_covariance_of_the_windows_after_them() -> None:
    record = build_record(model(), [sparse(plant(1, days=1, period=5.0), 12)], ())
    frame = build_frame(record)
    state = run_free(frame, *np.split(frame.centre, [frame.count[0]]), np.array([17.0]))
    grid, late = window_grid(frame, state), lateness(frame, state)
    assert np.sum(grid.late) == pytest.approx(np.sum((LATE_APART * late) ** 2))
    assert pytest.approx(1.0 / 3.0) == LATE_TOGETHER**2 + LATE_APART**2
    quiet = replace(grid, late=0.0 * grid.late, shared=0.0 * grid.shared)
    jumped = linear_recursion(np.where(grid.first, 0.0, np.exp(-grid.k * grid.dt)), np.sqrt(grid.late), 0.0)
    noise = NoiseModel(sensor=0.06, process=0.004, rough=3e-4, cycle=0.01)
    for column in (jumped, grid.shared):
        # What switches do costs far less likelihood than it would without them.
        costs = [float(column @ Whitener(each, noise).weigh(column[:, None])[:, 0]) for each in (grid, quiet)]
        assert costs[0] < 0.2 * costs[1]


def test_an_event_with_a_time_of_its_own_is_known_to_it() -> None:
    trace = sparse(plant(1, days=1, period=5.0), 12)
    events = tuple(replace(event, time=event.time - 30.0) for event in trace.events)
    record = build_record(model(), [replace(trace, events=events)], ())
    frame = build_frame(record)
    state = run_free(frame, *np.split(frame.centre, [frame.count[0]]), np.array([17.0]))
    assert not lateness(frame, state).any()


def test_the_row_of_a_start_is_not_in_the_piece_that_ends_with_it() -> None:
    record = build_record(model(), [sparse(plant(1, days=1, period=5.0), 12)], ())
    starts = np.flatnonzero(np.diff(record.cycle) != 0)
    assert starts.size == 2 and np.isfinite(record.runs.reading[starts]).all()
    cut = record.by_cycles()
    assert np.isnan(cut.runs.reading[starts]).all()
    first = record.select(record.cycle == 0)
    assert np.isnan(first.runs.reading[-1]) and first.rows[-1] == len(first.runs) - 2


def test_what_all_that_turns_is_late_by_is_told_by_the_fitted_cycles_and_is_no_error_of_others() -> None:
    """At rows of five minutes half a row at each switch was most of the held-out error, and the floor as much."""
    fine = plant(5, days=6, period=15.0)
    sampled = sparse(fine, 20)
    # The same rows of a plant that turns at them alone: no row is late.
    on_time = plant(5, days=6, period=300.0)
    for trace, behind in ((sampled, 0.5 * 19 / 20), (on_time, 0.0)):
        record = build_record(model(), [trace], ())
        base = fit(move_frame(build_frame(record), record.select(record.cycle < 12)))
        held_out = record.select(record.cycle >= 12).by_cycles()
        rows, error = base.behind
        assert 0.0 < error < 0.15 and abs(rows - behind) < 3.0 * error, base.behind
        blind = replace(base, behind=(0.0, LATE_TOGETHER))
        runs = [let_run(each, held_out) for each in (blind, base)]
        errors = [float(np.sqrt(np.mean(run.residual**2))) for run in runs]
        assert errors[1] < (0.9 if behind else 1.05) * errors[0], errors
        if behind:
            stated = np.full(np.unique(base.frame.record.whole).size, np.inf)
            floors = [noise_floor(stated, each, held_out, 0, RULES).error for each in (blind, base)]
            assert floors[1] < 0.95 * floors[0], floors


def test_a_fit_begins_from_one_of_cycles_that_stand_on_the_steps_of_their_rounding_or_do_not() -> None:
    record = build_record(model(), [plant(1, days=2)], ())
    frame = move_frame(build_frame(record), record)
    before = fit(frame, rounds=1)
    assert before.noise.lasting == 0.0
    stands = replace(before, noise=replace(before.noise, lasting=0.1, fades=30.0))
    assert fit(frame, begin=stands, rounds=1).noise.lasting == 0.0
    centre = replace(before.noise, lasting=0.2)
    assert with_reading_error(before.noise, centre).lasting == 0.2


def test_no_second_name_makes_up_for_starts_that_lie_between_two_rows() -> None:
    """With the times of the switches taken as known, a step of the sensor was named beside the pump, and did harm."""
    found = diagnose(model(), [sparse(plant(4, days=3, period=10.0, pump=2e-4), 6)], seed=0).diagnosis
    assert [effect.name for effect in found.effects] == ["pump-cooling"]
    assert found.effects[0].params["loss"] == pytest.approx(2e-4, rel=0.3)
    assert found.held_out is not None and found.held_out.rmse_after < 0.3 * found.held_out.rmse_before
