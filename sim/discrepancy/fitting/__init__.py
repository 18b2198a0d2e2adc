"""Free runs under effects fitted to measured traces, with the noise of a rough plant."""

from sim.discrepancy.fitting.baseline import Frame, anchored, frame_of, on, shown_locations
from sim.discrepancy.fitting.candidates import CatalogueEntry, catalogue, own_roles, rivals, signals_of
from sim.discrepancy.fitting.course import (
    CourseState,
    as_read,
    at,
    filtered,
    friction_heat,
    grid_at,
    unseen_switches,
    window_sensitivity,
)
from sim.discrepancy.fitting.effects import as_sensed, heat_and_loss, held, lagged_signal, on_sensor
from sim.discrepancy.fitting.free_run_fit import (
    Fitted,
    averaged_readings,
    fit,
    given_fit,
    readings_in_window,
    rounding,
    with_column,
    with_heats,
)
from sim.discrepancy.fitting.named import Named, effects_of, named_of
from sim.discrepancy.fitting.noise import Grid, NoiseModel, Whitener, decay_and_pull
from sim.discrepancy.fitting.record import (
    SLOW,
    Record,
    first_cycle_after,
    in_order,
    overlapping,
    patiently,
    record_of,
)

__all__ = [
    "SLOW",
    "CatalogueEntry",
    "CourseState",
    "Fitted",
    "Frame",
    "Grid",
    "Named",
    "NoiseModel",
    "Record",
    "Whitener",
    "anchored",
    "as_read",
    "as_sensed",
    "at",
    "averaged_readings",
    "catalogue",
    "decay_and_pull",
    "effects_of",
    "filtered",
    "first_cycle_after",
    "fit",
    "frame_of",
    "friction_heat",
    "given_fit",
    "grid_at",
    "heat_and_loss",
    "held",
    "in_order",
    "lagged_signal",
    "named_of",
    "on",
    "on_sensor",
    "overlapping",
    "own_roles",
    "patiently",
    "readings_in_window",
    "record_of",
    "rivals",
    "rounding",
    "shown_locations",
    "signals_of",
    "unseen_switches",
    "window_sensitivity",
    "with_column",
    "with_heats",
]
