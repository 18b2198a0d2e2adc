"""Queries answered by runs of the model."""

from sim.lab.checking.smc.answers import Answer, QuerySettings, Rule, answer, decided
from sim.lab.checking.smc.start import Start, believed, initial
