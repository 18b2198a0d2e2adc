"""Models compared on the same traces, and settings searched."""

from sim.lab.ranking.ranking import Ranking, Weights, entrants, rank
from sim.lab.ranking.report import as_plain, draw_ranking, write_page
from sim.lab.ranking.tuning import Objective, StudyPlan, Tuning, final_model, tune
from sim.lab.ranking.tuning_methods import METHODS, Settings, Task, Taught

__all__ = [
    "METHODS",
    "Objective",
    "Ranking",
    "Settings",
    "StudyPlan",
    "Task",
    "Taught",
    "Tuning",
    "Weights",
    "as_plain",
    "draw_ranking",
    "entrants",
    "final_model",
    "rank",
    "tune",
    "write_page",
]
