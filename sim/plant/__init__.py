"""A decanter simulated by physics. It writes synthetic traces and is never the model under test."""

from sim.plant.cooled import CooledPlant, cooled_days
from sim.plant.heat import heat_day, heat_history, uncontrolled_heat_day
from sim.plant.scenarios import SCENARIOS, production, scenario
