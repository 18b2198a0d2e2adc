"""Queries answered by runs of the model."""

from sim.lab.checking.smc.answers import Answer, QuerySettings, Rule, answer, decide_symbolic
from sim.lab.checking.smc.start import Start, believed_start, initial
