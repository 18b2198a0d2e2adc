"""Statistical rivals that our forecasts are measured against: each gets the past up to the origin, nothing more."""

from sim.rivals.past import FittedRival, Past, Rival
from sim.rivals.table import rivals

__all__ = ["FittedRival", "Past", "Rival", "rivals"]
