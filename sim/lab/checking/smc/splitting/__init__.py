"""Rare events by importance splitting."""

from sim.lab.checking.smc.splitting.estimator import refusal, split
from sim.lab.checking.smc.splitting.pilot import PilotFailed
