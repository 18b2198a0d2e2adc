"""How good forecasts were: rows of forecasts and outcomes, their figures, and what the differences of methods tell."""

from sim.lab.skill.last_reading import persistence
from sim.lab.skill.picture import draw_skill
from sim.lab.skill.report import AHEAD, tables
from sim.lab.skill.rows import NOMINAL, STRETCHES, Skill, SkillRow, common, difference, grouped, skill, stretch
from sim.lab.skill.worth import ForecastSkill, Worth, forecast_skill

__all__ = [
    "AHEAD",
    "NOMINAL",
    "STRETCHES",
    "ForecastSkill",
    "Skill",
    "SkillRow",
    "Worth",
    "common",
    "difference",
    "draw_skill",
    "forecast_skill",
    "grouped",
    "persistence",
    "skill",
    "stretch",
    "tables",
]
