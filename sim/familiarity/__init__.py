"""How like the training a cycle is: its features, their law, and the error to be expected where it is strange."""

from sim.familiarity.error_classes import (
    RED,
    YELLOW,
    ClassFigures,
    ErrorClass,
    ErrorCurve,
    class_of,
    error_curve,
    measured_classes,
    parse_curve,
)
from sim.familiarity.features import FEATURES, POINT_SECONDS, CycleFeature, CyclePoints, cycle_points
from sim.familiarity.reference import (
    LEAST_CYCLES,
    FamiliarityReference,
    Strangeness,
    fit_reference,
    parse_reference,
    shrunk_covariance,
)

__all__ = [
    "FEATURES",
    "LEAST_CYCLES",
    "POINT_SECONDS",
    "RED",
    "YELLOW",
    "ClassFigures",
    "CycleFeature",
    "CyclePoints",
    "ErrorClass",
    "ErrorCurve",
    "FamiliarityReference",
    "Strangeness",
    "class_of",
    "cycle_points",
    "error_curve",
    "fit_reference",
    "measured_classes",
    "parse_curve",
    "parse_reference",
    "shrunk_covariance",
]
