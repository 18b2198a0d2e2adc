"""How like the training a cycle is: its features, their law, and the error to be expected where it is strange."""

from sim.familiarity.error_classes import (
    RED,
    YELLOW,
    ClassFigures,
    ErrorCurve,
    class_of,
    error_curve,
    measured_classes,
    parse_curve,
)
from sim.familiarity.features import (
    COLUMNS,
    FEATURES,
    LONGEST,
    CyclePoint,
    CyclePoints,
    GrowingCycle,
    PointSource,
    cycle_points,
)
from sim.familiarity.reference import (
    LEAST_CYCLES,
    ExcessSoFar,
    FamiliarityReference,
    Strangeness,
    StrangeThing,
    fit_reference,
    parse_reference,
    shrunk_covariance,
)
