"""Free runs under effects fitted to measured traces, with the noise of a rough plant."""

from sim.lab.discrepancy.fitting.baseline import Frame, anchored, frame_of, on, shown_locations
from sim.lab.discrepancy.fitting.candidates import CatalogueEntry, catalogue, own_roles, rivals, signals_of
from sim.lab.discrepancy.fitting.course import (
    LATE_TOGETHER,
    CourseState,
    as_read,
    at,
    friction_heat,
    grid_at,
    heat_filter,
    row_later,
    unseen_switches,
    window_sensitivity,
)
from sim.lab.discrepancy.fitting.effects import (
    as_sensed,
    heat_and_loss,
    held,
    lagged_signal,
    net_heat,
    on_sensor,
    stated_rate,
)
from sim.lab.discrepancy.fitting.free_run_fit import (
    Fitted,
    averaged_readings,
    fit,
    given_fit,
    readings_in_window,
    restored,
    rounding,
    slim,
    with_column,
    with_heats,
)
from sim.lab.discrepancy.fitting.named import Named, effects_of, named_of
from sim.lab.discrepancy.fitting.noise import NoiseModel, Whitener, decay_and_pull
from sim.lab.discrepancy.fitting.record import (
    SLOW,
    Record,
    first_cycle_after,
    in_order,
    overlapping,
    patiently,
    record_of,
)
