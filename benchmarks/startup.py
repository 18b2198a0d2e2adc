"""How long `decanter --help` takes, against the promised 0.2 s and against an interpreter that does nothing.

Wall time of fresh processes, taken in turn; the median counts. Compiled modules are there, as after a first call. Of
commands that touch models or the plant the processor time before they begin, against 0.5 s: that of their `--help`.
"""

import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

import click

from benchmarks.figures import Figure, give

PROMISED_MS = 200.0
BEGIN_MS = 500.0
BEGINNING = ("model show", "model judge proof", "model learn", "plc probe", "run")
"""Commands whose beginning is measured: each has other rooms to load."""
DECANTER = Path(sys.executable).with_name("decanter")


def wall(command: Sequence[str]) -> float:
    """Milliseconds of one process. Raises CalledProcessError when it fails."""
    begin = perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return 1e3 * (perf_counter() - begin)


def processor(command: Sequence[str]) -> float:
    """Milliseconds of processor time of one process, its own and the system's for it."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    wall(command)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


def beginnings(repeats: int) -> list[Figure]:
    """The processor time of each of BEGINNING, the least of the repeats: what else the machine does only adds to it."""
    commands = {words: [str(DECANTER), *words.split(), "--help"] for words in BEGINNING}
    return [
        Figure(
            f"decanter {words}, before it begins",
            min(processor(command) for _ in range(repeats)),
            "ms",
            "promised, at most",
            BEGIN_MS,
        )
        for words, command in commands.items()
    ]


def measure(repeats: int) -> list[Figure]:
    """The two in turn, after one call of each that is not counted."""
    helped, idle = [str(DECANTER), "--help"], [sys.executable, "-c", "pass"]
    for command in (helped, idle):
        wall(command)
    times = [(wall(helped), wall(idle)) for _ in range(repeats)]
    ours, bare = median(ours for ours, _ in times), median(bare for _, bare in times)
    return [
        Figure("decanter --help, median", ours, "ms", "python -c pass, median", bare),
        Figure("decanter --help, median", ours, "ms", "promised, at most", PROMISED_MS),
        Figure("decanter --help, worst", max(ours for ours, _ in times), "ms", "promised, at most", PROMISED_MS),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="3 processes of --help instead of 7, one of each other.")
def main(as_json: bool, quick: bool) -> None:
    give("startup", measure(3 if quick else 7) + beginnings(1 if quick else 7), as_json=as_json)


if __name__ == "__main__":
    main()
