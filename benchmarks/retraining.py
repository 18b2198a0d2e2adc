"""What a retraining costs and is worth: processor time, memory, forecasts on cycles held out, kills at any moment.

A plant runs for `--days` at a scan every `--period` s (`sim.plant`, production of four runs a day), its friction being
`--wear` times what it was when the present model was learned, from `--learned-days` of it. Its historian is written
as a gateway writes it; then `decanter model version retrain` runs as a process of its own, and its processor time and
greatest resident memory are printed, against the goals of ten minutes and 500 MB for thirty days at 1 Hz.

With `--kills` the same retraining is killed (SIGKILL) at random moments, begun anew each time, and has to come to the
same version as the one that nobody killed, while the store's current version stays what it was and loads.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from time import monotonic, sleep

import click
import numpy as np

from benchmarks.figures import Figure, give
from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading import Scan
from gateway.machine.records import Keeper
from gateway.store import open_historian
from sim.artefacts import current, load, model_hash, promote
from sim.lab.formats import save
from sim.lab.learning.bins import learn_bins
from sim.plant import production
from sim.plant.decanter import DecanterPlant
from sim.sha import DECANTER, Trace

TEMPERATURE = "TCuscinettiRiduttore"
GOAL_SECONDS, GOAL_MB = 600.0, 500.0
AT_A_TIME = 10_000


def worn(wear: float) -> DecanterPlant:
    """A plant whose bearings make `wear` times the heat."""
    new = DecanterPlant()
    return DecanterPlant(idle_heat=new.idle_heat * wear, heat_per_ampere=new.heat_per_ampere * wear)


def write_historian(path: Path, trace: Trace) -> None:
    """The historian of a gateway that has scanned a trace, row by row."""
    store = open_historian(path)
    tags = [Tag(name, f"holding:{number}") for number, name in enumerate(trace.signals)]
    historian, keeper = store.view("decanter", tags), Keeper({tag.name: tag for tag in tags}, 5.0)
    historian.put("runs", [(float(trace.times[0]), TEMPERATURE, "", 1.0, 5.0)])
    columns = {name: column.tolist() for name, column in trace.signals.items()}
    for row, time in enumerate(trace.times.tolist()):
        read = {name: Sample(name, column[row], Quality.GOOD, time, time) for name, column in columns.items()}
        historian.put("scans", [(time, 0.0, 0)])
        historian.put("samples", keeper.rows(Scan(row, time, read, 0, 0.0)))
        if row % AT_A_TIME == AT_A_TIME - 1 and not store.flush(60.0):
            raise click.ClickException(f"{path}: the disk does not take it")
    # What is old is packed after a batch is committed, and a second batch waits for that: a gateway that runs has it
    # packed, and reads a cycle of its months without going through all the rest.
    if not (store.flush(60.0) and store.flush(60.0) and store.close()):
        raise click.ClickException(f"{path}: rows were lost")


def command(folder: Path, library: str) -> list[str]:
    """The retraining as it is called, its diagnosis included."""
    program = [sys.executable, "-m", "decanter_gateway", "model", "version", "retrain", str(folder / "store")]
    given = ("--historian", str(folder / "historian.sqlite"), "--library", str(folder / library))
    # At the lowest priority it would wait for whatever else runs here, which is not what is measured.
    return [*program, *given, "--full-speed", "--json"]


def measured(line: list[str]) -> tuple[dict[str, object], float, float]:
    """What a command printed, its processor time (s) and its greatest resident memory (MB).

    The memory is what the command says of itself: what the system says of a child is never below what this process had
    when it began it, and this one has held weeks of readings.
    """
    process = subprocess.Popen(line, stdout=subprocess.PIPE)
    assert process.stdout is not None
    text = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise click.ClickException(f"the retraining ended with status {status}")
    said = json.loads(text)
    return said, usage.ru_utime + usage.ru_stime, said["cost"]["peak_mb"]


def killed_until_done(folder: Path, longest: float, seed: int) -> tuple[int, dict[str, object]]:
    """How often a retraining was killed before it came to its end, and what it printed then."""
    rng, kills, before = np.random.default_rng(seed), 0, current(folder / "store")
    # In a copy of its own: the version that it makes must not meet the one of the other run.
    while True:
        process = subprocess.Popen(command(folder, "killed"), stdout=subprocess.PIPE)
        assert process.stdout is not None
        # Every kill leaves more time than the one before it: the longest step has to come to its end at last.
        patience = monotonic() + float(rng.uniform(0.5, longest * (1.0 + 0.3 * kills)))
        while process.poll() is None and monotonic() < patience:
            sleep(0.05)
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            process.wait()
            kills += 1
            if current(folder / "store") != before:
                raise click.ClickException("a kill has changed the current version")
            load(folder / "store")
            continue
        return kills, json.loads(process.stdout.read())


@click.command()
@click.option("--days", type=click.IntRange(6), default=30, show_default=True)
@click.option("--period", type=click.FloatRange(0.5), default=1.0, show_default=True, help="s between two scans.")
@click.option("--learned-days", type=click.IntRange(1), default=2, show_default=True)
@click.option("--wear", type=click.FloatRange(0.5), default=1.25, show_default=True)
@click.option("--kills", is_flag=True, help="Kill it at random moments too.")
@click.option("--keep", type=click.Path(path_type=Path), help="Leave the historian and what came of it here.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(
    days: int,
    period: float,
    learned_days: int,
    wear: float,
    kills: bool,
    keep: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Print what a retraining costs and what its forecasts are worth."""
    with tempfile.TemporaryDirectory(prefix="retraining-") as place:
        folder = keep or Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        history = production(learned_days, seed=2 * seed + 1, name="learned_from")
        model = learn_bins([history], DECANTER, TEMPERATURE, seed=seed, name="decanter").model
        store = folder / "store"
        promote(store, save(store, model, created=0.0))
        trace = production(days, seed=2 * seed + 78, period=period, plant=worn(wear))
        write_historian(folder / "historian.sqlite", trace)
        scans = trace.times.size
        del trace
        if kills:
            shutil.copytree(store, folder / "untouched")
        found, seconds, memory = measured(command(folder, "library"))
        goal = GOAL_SECONDS * days / 30.0 / period
        figures = [
            Figure("scans in the historian", scans, ""),
            Figure("processor time", seconds, "s", "the goal, by days and rate", goal),
            Figure("greatest resident memory", memory, "MB", "the goal", GOAL_MB),
            Figure("cycles cut", float(str(found["cut"])), ""),
            Figure("scans learned from", float(str(found["rows"])), ""),
        ]
        for each in found["comparisons"]:  # type: ignore[attr-defined]
            name = f"CRPS, {each['subject']}, {each['horizon']:g} s"
            figures.append(Figure(name, each["crps"]["new"], "°C", "present", each["crps"]["present"]))
            figures.append(Figure(f"{name}: p", each["shown_p"], ""))
            covered = each["coverage"]
            figures.append(Figure(f"{name}: 90 % band", covered["new"], "", "present", covered["present"]))
        if kills:
            # The same store as before the first run: what a version is called depends on those before it.
            shutil.rmtree(store)
            (folder / "untouched").rename(store)
            count, again = killed_until_done(folder, seconds / 3.0, seed)
            same = again["new_hash"] == found["new_hash"] and again["version"] == found["version"]
            figures.append(Figure("kills before the second one ended", count, ""))
            figures.append(Figure("the same model and version as without kills", float(same), "yes"))
        if not as_json:
            click.echo(found["sentence"])
            click.echo(f"present model {model_hash(model)[:8]}, new model {str(found['new_hash'])[:8]}")
        give("retraining", figures, as_json=as_json)


if __name__ == "__main__":
    main()
