"""What is noted of runs while they go by."""

from sim.lab.checking.smc.monitors.formula import CompiledFormulas, affine, exists, linear_in_temperature
from sim.lab.checking.smc.monitors.monitor import ExtremeMonitor, Totals, TrajectoryMonitor, follow, inside
from sim.lab.checking.smc.monitors.path import PreparedPath, approximations, cuts, prepare_path
from sim.lab.checking.smc.monitors.response import ResponseMonitor
