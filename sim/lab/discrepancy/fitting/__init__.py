"""Free runs under effects fitted to measured traces, with the noise of a rough plant."""

from sim.lab.discrepancy.fitting.baseline import Frame, build_frame, move_frame, shown_locations, with_priors
from sim.lab.discrepancy.fitting.candidates import CatalogueEntry, catalogue, own_roles, rivals, role_signals
from sim.lab.discrepancy.fitting.course import (
    LATE_TOGETHER,
    CourseState,
    friction_heat,
    heat_response,
    row_later,
    run_frame,
    sensor_view,
    unseen_switches,
    window_grid,
    window_sensitivity,
)
from sim.lab.discrepancy.fitting.effects import (
    follows_course,
    heat_and_loss,
    hold_signal,
    lagged_signal,
    net_heat,
    on_sensor,
    sense_course,
    stated_rate,
)
from sim.lab.discrepancy.fitting.free_run_fit import (
    Fitted,
    averaged_readings,
    fit,
    given_model_fit,
    readings_in_window,
    restore_fit,
    rounding_error,
    slim,
    with_column,
    with_heats,
    without_last,
)
from sim.lab.discrepancy.fitting.named import Named, automaton_effects, model_effects
from sim.lab.discrepancy.fitting.noise import NoiseModel, Whitener, decay_and_pull
from sim.lab.discrepancy.fitting.record import (
    GAP_RATIO,
    Record,
    build_record,
    find_overlap,
    first_new_cycle,
    in_order,
    patiently,
)
