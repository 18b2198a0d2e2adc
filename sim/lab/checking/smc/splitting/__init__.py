"""Rare events by importance splitting."""

from sim.lab.checking.smc.splitting.estimator import refusal, split_estimate
from sim.lab.checking.smc.splitting.pilot import PilotFailed
