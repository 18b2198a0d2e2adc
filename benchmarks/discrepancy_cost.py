"""What a diagnosis costs against the days that it is given: seconds of processor time and peak memory.

A bearing's model is learned from three simulated days before a pump begins to cool it (`decanter demo --discrepancy`);
the days after it are diagnosed, one row each ten seconds, each number of days in a process of its own with one thread.
The exponent is the slope of log(seconds) over log(days) from the least days to the most: 1 is a cost that grows as the
rows do. The seconds are those of the diagnosis alone: without imports, reading, report and pictures. `--profile` prints
where the time of the last process goes besides.
"""

import cProfile
import json
import os
import pstats
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import click
import numpy as np

from benchmarks.figures import Figure, give
from sim.lab.discrepancy import diagnose
from sim.lab.formats import find_model, write_model_directory
from sim.lab.learning.bins import learn_bins
from sim.lab.tree_regressor import tree_regressor
from sim.plant import CooledPlant, cooled_days
from sim.sha import DECANTER

PERIOD = 10.0
COOLING = 7e-5
"""1/s: what the pump takes from the bearing, an eighth of its own loss."""
TEMPERATURE = "TCuscinettiRiduttore"
LEARNED_DAYS, LATER = 3, 30
"""Days that the model is learned from, and days until those begin that are diagnosed."""
PROMISED = {4: 10.0, 60: 60.0}
"""Seconds at most, by days."""
MOST_EXPONENT, MOST_MB = 1.2, 300.0
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def learned_model(folder: Path, seed: int) -> Path:
    """The directory of the model of the days before, in `folder`."""
    learned = learn_bins(cooled_days(LEARNED_DAYS, seed=seed, period=20.0), DECANTER, TEMPERATURE, seed=0, name="cost")
    write_model_directory(folder / "model", learned.model, learned.values)
    return folder / "model"


def diagnosed(model: Path, days: int, seed: int, *, profile: bool) -> dict[str, Any]:
    """The cost of one diagnosis in this process."""
    tree_regressor()  # loaded before the clock starts: what an import costs hangs on the installation
    traces = cooled_days(days, seed=seed, first_day=LATER, period=PERIOD, plant=CooledPlant(cooling=COOLING))
    said = [process_time()]
    found = find_model(model).runnable()
    profiler = cProfile.Profile()
    begun = process_time()
    if profile:
        profiler.enable()
    outcome = diagnose(found, traces, seed=0, progress=lambda _stage, _share: said.append(process_time()))
    if profile:
        profiler.disable()
        pstats.Stats(profiler, stream=sys.stderr).sort_stats("tottime").print_stats(25)
        pstats.Stats(profiler, stream=sys.stderr).sort_stats("cumtime").print_stats(60)
    said.append(process_time())
    return {
        "days": days,
        "seconds": said[-1] - begun,
        "silent": float(np.max(np.diff(said))),
        "mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "said": f"{outcome.diagnosis.verdict} {', '.join(effect.name for effect in outcome.diagnosis.effects)}",
    }


def measure(days: list[int], seed: int, *, profile: bool) -> list[Figure]:
    """A process for each number of days, one after the other."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        model = learned_model(Path(folder), seed)
        for number in days:
            child = [sys.executable, "-m", "benchmarks.discrepancy_cost", "--days", str(number), "--seed", str(seed)]
            child += ["--child", str(model), *(["--profile"] if profile and number == days[-1] else [])]
            done = subprocess.run(
                child, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **ONE_THREAD}
            )
            results.append(json.loads(done.stdout))
    figures = []
    for one in results:
        promised = PROMISED.get(one["days"])
        name = f"{one['days']} days: {one['said']}"
        figures += [
            Figure(f"{name}, processor time", one["seconds"], "s", "promised, at most" if promised else "", promised),
            Figure(f"{name}, longest without a word", one["silent"], "s"),
            Figure(f"{name}, peak memory", one["mb"], "MB", "promised, at most", MOST_MB),
        ]
    if len(results) > 1:
        first, last = results[0], results[-1]
        slope = np.log(last["seconds"] / first["seconds"]) / np.log(last["days"] / first["days"])
        words = f"exponent from {first['days']} to {last['days']} days"
        figures.append(Figure(words, float(slope), "", "promised, at most", MOST_EXPONENT))
    return figures


@click.command(help=__doc__)
@click.option("--days", default="1,2,4,8", show_default=True, help="Numbers of days, with commas between.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The plant's.")
@click.option("--profile", is_flag=True, help="Print where the time of the last process goes.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--child", hidden=True, type=click.Path(path_type=Path), help="The model, in the process that is timed.")
def main(days: str, seed: int, profile: bool, as_json: bool, child: Path | None) -> None:
    try:
        numbers = sorted({int(number) for number in days.split(",")})
    except ValueError:
        raise click.BadParameter(f"{days!r} is no list of numbers", param_hint="--days") from None
    if child is not None:
        click.echo(json.dumps(diagnosed(child, numbers[0], seed, profile=profile)))
        return
    give("discrepancy_cost", measure(numbers, seed, profile=profile), as_json=as_json)


if __name__ == "__main__":
    main()
