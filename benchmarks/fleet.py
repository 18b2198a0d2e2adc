"""What `model learn fleet` costs as a fleet grows, and whether it finds the machine that is not like the others.

Synthetic machines (`sim.plant`, production; bearings whose heat scatters by 5 % between machines) lie as CSV, one
folder a machine; one of ten and more makes half as much heat again. Each fleet is studied by the command as a process
of its own with one worker and with two: processor time and the greatest memory of it and its workers, wall time, and
how the processor time of the machines alone grows with their number. What ten thousand machines would cost is that
time for one, ten thousand times: on paper, as no such fleet was studied.

With --law nothing is learned: offsets are drawn, machine by machine and group by group, that scatter and are known as
those of the learned fleet of ten are, and every error is an estimate from eight runs. Printed is the share of ordinary
fleets in which any machine is said to stand out, and how often an odd one is named: running, at rest only, or in one
load stage only (which is half of its running).
"""

import csv
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import monotonic
from typing import Any

import click
import numpy as np

from benchmarks.figures import Figure, give
from sim.lab.learning import FALSE_FINDING_CHANCE, GroupTargets, find_outliers
from sim.lab.recordings import write_trace
from sim.plant import production
from sim.plant.decanter import DecanterPlant
from sim.sha import Trace

ODD_FROM, ODD_HEAT, SCATTER = 10, 1.5, 0.05
ON_PAPER = 10_000
RUNS, ERRORS_DIFFER = 8, 0.5
"""Runs that an error comes from, and by how much the logarithms of the true errors differ between machines."""
REST, RUNNING, LOW, HIGH = "OFF", "ON", "ON/100-200", "ON/200-300"
KNOWN_AS = {REST: (0.1, 0.16), RUNNING: (0.55, 0.35), LOW: (1.2, 0.8), HIGH: (1.0, 0.7)}
"""By group: what machines differ by, and the standard error of a machine's offset (degC)."""
ODD = {
    "running": {RUNNING: 1.0, LOW: 1.0, HIGH: 1.0},
    "at rest only": {REST: 1.0},
    "one stage only": {RUNNING: 0.5, HIGH: 1.0},
}
"""Where an odd machine is odd, and which share of that each group shows."""
DEGREES = (2.0, 3.0, 5.0)


def machine(number: int, heat: float, days: int, seed: int) -> Trace:
    """Production of a machine whose bearings make `heat` times what the plant's make."""
    new = DecanterPlant()
    plant = DecanterPlant(idle_heat=new.idle_heat * heat, heat_per_ampere=new.heat_per_ampere * heat)
    return production(days, seed=seed + number, plant=plant)


def write_fleet(folder: Path, size: int, days: int, seed: int) -> str:
    """The machines' traces; the name of the odd one, if there is one."""
    rng = np.random.default_rng(seed)
    odd = f"m{int(rng.integers(size)):03d}" if size >= ODD_FROM else ""
    for number in range(size):
        name = f"m{number:03d}"
        heat = float(np.exp(SCATTER * rng.standard_normal())) * (ODD_HEAT if name == odd else 1.0)
        (own := folder / name).mkdir(parents=True)
        write_trace(machine(number, heat, days, 1000 * seed), own / f"{name}.csv")
    return odd


def studied(folder: Path, out: Path, jobs: int) -> tuple[dict[str, Any], float, float]:
    """What the command says, the processor time of it and all its workers (s), and the wall time (s)."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), monotonic()
    command = ["model", "learn", "fleet", str(folder), "--out", str(out), "--jobs", str(jobs), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "gateway.cli.main", *command], capture_output=True, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return json.loads(done.stdout), spent, monotonic() - begin


def drawn(rng: np.random.Generator, size: int, odd: dict[str, float]) -> dict[str, dict[str, GroupTargets]]:
    """What the machines of a fleet say of themselves; the first is off by so many degrees in each group of `odd`."""
    fleet = {f"m{number:03d}": dict[str, GroupTargets]() for number in range(size)}
    for group, (differ, error) in KNOWN_AS.items():
        true = error * np.exp(ERRORS_DIFFER * rng.standard_normal(size))
        offset = rng.normal(0.0, np.hypot(differ, true))
        offset[0] += odd.get(group, 0.0)
        told = true * np.sqrt(rng.chisquare(RUNS - 1, size) / (RUNS - 1))
        for own, one, its in zip(fleet.values(), offset.tolist(), told.tolist(), strict=True):
            own[group] = GroupTargets(one, its, RUNS)
    return fleet


def law(sizes: list[int], fleets: int, seed: int) -> list[Figure]:
    """False findings of ordinary fleets beside the stated rate, and how often an odd machine is named."""
    rng, figures = np.random.default_rng(seed), list[Figure]()
    for size in sizes:
        found = [find_outliers(drawn(rng, size, {})) for _ in range(fleets)]
        rate = 100.0 * float(np.mean([bool(each) for each in found]))
        figures.append(
            Figure(f"{size} machines alike: fleets with a finding", rate, "%", "stated", 100.0 * FALSE_FINDING_CHANCE)
        )
        for where, shares in ODD.items():
            for degrees in DEGREES:
                odd = {group: share * degrees for group, share in shares.items()}
                found = [find_outliers(drawn(rng, size, odd)) for _ in range(max(fleets // 10, 1))]
                named = 100.0 * float(np.mean(["m000" in each for each in found]))
                others = 100.0 * float(np.mean([bool(set(each) - {"m000"}) for each in found]))
                figures.append(Figure(f"  odd {where}, {degrees:g} degC: named", named, "%", "others", others))
    return figures


@click.command(help=__doc__)
@click.option("--sizes", default="1,10,100", show_default=True, help="Machines of each fleet.")
@click.option("--days", default=4, show_default=True, type=click.IntRange(1), help="Of record of each machine.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0))
@click.option("--law", "drawn_only", is_flag=True, help="Of drawn offsets; nothing is learned.")
@click.option("--fleets", default=5000, show_default=True, type=click.IntRange(1), help="Drawn, with --law.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(sizes: str, days: int, seed: int, drawn_only: bool, fleets: int, as_json: bool) -> None:
    if drawn_only:
        wanted = [size for each in sizes.split(",") if (size := int(each)) >= ODD_FROM]
        give("which machine stands out, of drawn offsets", law(wanted, fleets, seed), as_json=as_json)
        return
    figures, growth = [], list[tuple[int, float]]()
    for size in (int(each) for each in sizes.split(",")):
        with tempfile.TemporaryDirectory(prefix="decanter-fleet-") as scratch:
            folder = Path(scratch)
            odd = write_fleet(folder / "machines", size, days, seed)
            for jobs in (1, 2):
                said, spent, wall = studied(folder / "machines", out := folder / f"out{jobs}", jobs)
                with (out / "fleet.csv").open(encoding="utf-8") as file:
                    rows = list(csv.DictReader(file))
                name = f"{size} machines, {jobs} workers"
                alone = sum(float(row["cpu_s"]) for row in rows)
                figures.append(Figure(f"{name}: processor time", spent, "s", "of which the machines", alone))
                figures.append(Figure("  wall time", wall, "s"))
                figures.append(Figure("  most memory of a process", max(float(row["peak_mb"]) for row in rows), "MB"))
                found = said["outstanding"]
                figures.append(Figure("  stand out, of them false", len(found), "", "false", len(set(found) - {odd})))
                if odd in found:
                    lead = found[odd][0]
                    name = f"  odd one {lead['where']}: beyond the others"
                    figures.append(Figure(name, lead["beyond"], "degC", "they differ by", lead["differ"]))
                if jobs == 1:
                    growth.append((size, alone))
    if len(growth) > 1:
        (small, first), (large, last) = growth[0], growth[-1]
        exponent = float(np.log(last / first) / np.log(large / small))
        figures.append(Figure(f"exponent of the machines' processor time, {small} to {large}", exponent, ""))
        figures.append(Figure(f"{ON_PAPER} machines, on paper, of one core", ON_PAPER * last / large / 3600.0, "h"))
    give("a fleet, machine by machine", figures, as_json=as_json)


if __name__ == "__main__":
    main()
