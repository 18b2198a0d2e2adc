"""A search in a process of its own, for a test that kills it: prints a line before each trial.

`python -m tests.validation.tuning_line STUDY TRIALS`
"""

import sys
import time
from pathlib import Path

from sim.ranking import tuning_methods
from sim.ranking.tuning import StudyPlan, tune
from tests.validation.tuning_plant import ALPHABET, relaxing, relaxing_method, traces


def main(study: Path, trials: int) -> None:
    def slowly(task: tuning_methods.Task, settings: tuning_methods.Settings) -> tuning_methods.Taught:
        time.sleep(0.05)  # so that the kill meets a running trial
        return relaxing(task, settings)

    def report(what: str, _share: float) -> None:
        print(what, flush=True)

    known = dict(tuning_methods.METHODS)
    known["bins"] = tuning_methods.Method(relaxing_method().space, slowly)
    tuning_methods.METHODS = known
    tune(traces(), ALPHABET, "T", StudyPlan("bins"), study, trials=trials, progress=report)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
