"""Settings of learning methods searched by cross-validation over traces."""

from sim.lab.tuning.methods import METHODS, Settings, Task, Taught
from sim.lab.tuning.search import Objective, StudyPlan, Tuning, final_model, tune
from sim.lab.tuning.study import SEARCHES, Search
