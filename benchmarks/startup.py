"""How long `decanter --help` takes, against the promised 0.2 s and against an interpreter that does nothing.

Wall time of fresh processes, taken in turn; the median counts. Compiled modules are there, as after a first call.
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

import click

from benchmarks.figures import Figure, give

PROMISED_MS = 200.0
DECANTER = Path(sys.executable).with_name("decanter")


def wall(command: Sequence[str]) -> float:
    """Milliseconds of one process. Raises CalledProcessError when it fails."""
    begin = perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return 1e3 * (perf_counter() - begin)


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
@click.option("--quick", is_flag=True, help="3 processes of each kind instead of 7.")
def main(as_json: bool, quick: bool) -> None:
    give("startup", measure(3 if quick else 7), as_json=as_json)


if __name__ == "__main__":
    main()
