"""A decanter simulated by physics. It writes synthetic traces and is never the model under test."""

from sim.plant.cooled import CooledPlant, cooled_days
from sim.plant.scenarios import SCENARIOS, history_and_day, production, scenario

__all__ = ["SCENARIOS", "CooledPlant", "cooled_days", "history_and_day", "production", "scenario"]
