"""How like the training a cycle is: its features, their law, and the error to be expected where it is strange."""

from sim.familiarity.error_classes import (
    ClassFigures,
    ErrorCurve,
    classify_error,
    error_curve,
    measured_classes,
    parse_curve,
)
from sim.familiarity.features import (
    COLUMNS,
    FEATURES,
    MAX_CYCLE_S,
    CyclePoint,
    CyclePoints,
    GrowingCycle,
    PointSource,
    cycle_points,
)
from sim.familiarity.reference import (
    MIN_CYCLES,
    ExcessSoFar,
    FamiliarityReference,
    Strangeness,
    StrangeThing,
    fit_reference,
    parse_reference,
    shrunk_covariance,
)
