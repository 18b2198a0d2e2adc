"""A search in processes of its own, for a test that kills them: each prints its number and a line before each trial.

`python -m tests.validation.tuning_line STUDY TRIALS STARTS`: the processes are forked one after the other, so that what
takes seconds to import is imported once.
"""

import importlib
import os
import sys
import time
from pathlib import Path

from sim.lab.tuning import methods as tuning_methods
from sim.lab.tuning.search import StudyPlan, tune
from tests.validation.tuning_plant import ALPHABET, relaxing, relaxing_method, traces


def search(study: Path, trials: int) -> None:
    """The search itself, a line before each trial."""

    def slowly(task: tuning_methods.Task, settings: tuning_methods.Settings) -> tuning_methods.Taught:
        time.sleep(0.05)  # so that the kill meets a running trial
        return relaxing(task, settings)

    def report(what: str, _share: float) -> None:
        print(what, flush=True)

    known = dict(tuning_methods.METHODS)
    known["bins"] = tuning_methods.Method(relaxing_method().space, slowly)
    tuning_methods.METHODS = known
    tune(traces(), ALPHABET, "T", StudyPlan("bins"), study, trials=trials, progress=report)


def main(study: Path, trials: int, starts: int) -> None:
    importlib.import_module("optuna.storages._rdb.storage")  # which Optuna itself imports at the first study
    for _ in range(starts):
        child = os.fork()
        if child == 0:
            print(os.getpid(), flush=True)
            search(study, trials)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        print(f"ended with {os.waitstatus_to_exitcode(status)}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
