"""What executes an automaton: along a schedule, as moments, runs and paths, and sample by sample."""

from sim.engine.belief import (
    advance,
    anomaly,
    filter_trace,
    machine_offset,
    observe,
    on_event,
    restart,
    start,
    with_inputs,
    with_machine_offset,
)
from sim.engine.belief_state import Belief, Hidden, restore_belief
from sim.engine.cuts import fastest, longest
from sim.engine.kernel import move
from sim.engine.moment_equations import Prediction, mean_outputs, mean_readings, moments, stay_draws
from sim.engine.moments_augmented import drawn_start
from sim.engine.open_loop_run import Score, Start, errors, open_loop, open_loop_schedule, readings, score, start_law
from sim.engine.particles import (
    BLOCK_ROWS,
    Layout,
    PathRuns,
    draw_belief,
    draw_layout,
    draw_states,
    joined,
    run,
    survival,
)
from sim.engine.particles_augmented import acting_paths, acting_stays, augmented_path_runs, real_age
from sim.engine.plant import Plant, compile_plant
from sim.engine.recursion import linear_recursion, matrix_recursion
from sim.engine.schedules import Policy, Schedule, resync_targets, schedule, step_coefficients
from sim.engine.simulation import SamplingPlan, SimulatedRuns, augmented_plan, simulate
from sim.engine.terms import held_terms
from sim.engine.tracker import Tracker, compile_model, compile_tracker, next_location, repeat_factor
