"""`make fuzz`: many inputs of each target, or of one (`make fuzz TARGET=dbc INPUTS=1000000 SEED=7`), with progress."""

import os
import resource
import sys
import tempfile
import time
from pathlib import Path

from hypothesis import HealthCheck, given, seed, settings

from tests.fuzz.mutations import near
from tests.fuzz.targets import TARGETS

MOST_SECONDS = 5.0
"""One input is done by then. It is long for a machine that does other things too, and short for what has no end."""
MOST_GROWTH = 400 << 10
"""KiB by which a target's inputs may raise the peak of memory."""


def fuzz(name: str, inputs: int, number: int, folder: Path) -> int:
    """Run so many inputs of one target; gives how many were not refused. Raises AssertionError for what is neither."""
    target, accepted, peak = TARGETS[name], 0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    @seed(number)
    @settings(max_examples=inputs, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(near(target.examples()))
    def check(data: bytes) -> None:
        nonlocal accepted
        begun = time.monotonic()
        try:
            target.run(data, folder)
        except target.errors as error:
            assert str(error).strip(), f"{name}: refused without a sentence"
        else:
            accepted += 1
        assert time.monotonic() - begun < MOST_SECONDS, f"{name}: longer than {MOST_SECONDS:g} s"
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak
        assert grown < MOST_GROWTH, f"{name}: {grown >> 10} MiB more"

    check()
    return accepted


def main() -> None:
    """TARGET, INPUTS and SEED come from the environment; without TARGET all of the table in its order."""
    inputs, number = int(os.environ.get("INPUTS", "100000")), int(os.environ.get("SEED", "0"))
    names = [os.environ["TARGET"]] if os.environ.get("TARGET") else list(TARGETS)
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            begun = time.monotonic()
            accepted = fuzz(name, inputs, number, Path(folder))
            took = time.monotonic() - begun
            sys.stdout.write(f"{name}: {inputs} inputs in {took:.0f} s, {accepted} not refused\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
