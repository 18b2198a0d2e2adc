"""Statistical rivals that our forecasts are measured against: each gets the past up to the origin, nothing more."""

from sim.lab.rivals.past import FittedRival, Past, Rival
from sim.lab.rivals.table import rivals

__all__ = ["FittedRival", "Past", "Rival", "rivals"]
