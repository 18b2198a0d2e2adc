"""All benchmarks one after another, each in a process of its own: one table of figures, and the machine they are from.

`python -m benchmarks.run [--json] [--thorough]`: the short form of each; `--thorough` repeats more and goes to greater
sizes. A benchmark's figures are shown as soon as it has them. What is no matter of speed has a command of its own:
`python -m benchmarks.fault_matrix`, `benchmarks.canopen_rig` and `benchmarks.can_rig` (the same over CANopen and raw
CAN), `benchmarks.broken_starts` (starts by damaged file), `benchmarks.commissioning` (the engineer's hour),
`benchmarks.discrepancy` (hidden effects), `benchmarks.engines` (pairs of engines), `benchmarks.resident` (memory over
hours), `benchmarks.kills`, `benchmarks.record_kills` and `benchmarks.power_cuts` (what the records lose),
`benchmarks.hostile_northbound` (peers that mean ill), `benchmarks.attack_matrix` (what was tried),
`benchmarks.hostile_exchanges` (replies of other requests), `benchmarks.device_habits` (devices with several habits),
`benchmarks.demo_seeds` (the demonstration's alarms),
`benchmarks.machine_rates` (what is not modelled of other machines), `benchmarks.hollow` (thresholds on other data),
`benchmarks.first_hour` (from a wheel to a prediction), `benchmarks.installed` (the Debian package under systemd),
`benchmarks.mistakes` (what they are answered) and `benchmarks.house` (the code itself).
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from time import monotonic

import click

from benchmarks.figures import Figure, show, taken

BENCHMARKS = (
    "latency",
    "footprint",
    "startup",
    "historian",
    "encoder",
    "can",
    "canopen",
    "redundant",
    "belief",
    "simulation",
    "queries",
    "campaign",
    "smc",
    "formulas",
    "semantics",
    "verification",
    "lsha",
    "known_automata",
    "can_logs",
    "guess",
    "skill",
    "peers",
)
LONGEST = 600.0
"""Seconds after which a benchmark is given up: many times what it takes on a quiet machine."""
WITH_MODEL = frozenset({"latency", "footprint", "campaign"})
LIBRARIES = ("pymodbus", "numpy", "scipy", "pydantic", "structlog", "click")
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, slots=True)
class Machine:
    """Where the figures come from; `load` is the average of the last minute before the first benchmark."""

    system: str
    processor: str
    cores: int
    memory_gb: float
    python: str
    libraries: dict[str, str]
    load: float


def machine() -> Machine:
    """The facts of this machine (Linux)."""
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    processor = next((line.partition(":")[2].strip() for line in info if line.startswith("model name")), "unknown")
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return Machine(
        system=platform.platform(),
        processor=processor,
        cores=len(os.sched_getaffinity(0)),
        memory_gb=round(memory, 1),
        python=platform.python_version(),
        libraries={name: version(name) for name in LIBRARIES},
        load=round(os.getloadavg()[0], 2),
    )


def figures_of(name: str, options: Sequence[str]) -> list[Figure]:
    """Run one benchmark. Raises SubprocessError when it fails or takes LONGEST; its words are on standard error."""
    command = [sys.executable, "-m", f"benchmarks.{name}", "--json", *options]
    done = subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True, timeout=LONGEST)
    return taken(done.stdout)


def as_text(here: Machine) -> str:
    """The machine in three lines."""
    libraries = ", ".join(f"{name} {number}" for name, number in here.libraries.items())
    return (
        f"{here.system}, {here.cores} cores of {here.processor}, {here.memory_gb:g} GB\n"
        f"Python {here.python}, {libraries}\nload average before: {here.load:g}"
    )


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--thorough", is_flag=True, help="More runs and greater sizes: figures to be quoted.")
@click.option("--only", multiple=True, type=click.Choice(BENCHMARKS), help="Only this one; may be given again.")
def main(as_json: bool, thorough: bool, only: Sequence[str]) -> None:
    here, found, failed = machine(), {}, []
    with tempfile.TemporaryDirectory(prefix="decanter-bench-") as folder:
        for name in only or BENCHMARKS:
            click.echo(f"{name} ...", err=True)
            begun = monotonic()
            options = [] if thorough else ["--quick"]
            options += ["--model-folder", folder] if name in WITH_MODEL else []
            try:
                found[name] = figures_of(name, options)
            except subprocess.SubprocessError:
                failed.append(name)
            else:
                if not as_json:
                    show(name, found[name])
            click.echo(f"{name}: {monotonic() - begun:.0f} s", err=True)
    if as_json:
        plain = {name: [figure.plain() for figure in figures] for name, figures in found.items()}
        click.echo(json.dumps({"machine": asdict(here), "thorough": thorough, "figures": plain, "failed": failed}))
    else:
        click.echo(as_text(here))
    if failed:
        raise click.ClickException(f"without figures: {', '.join(failed)}; what they said is above")


if __name__ == "__main__":
    main()
