"""`make fuzz`: many inputs of each target, or of one (`make fuzz TARGET=dbc INPUTS=1000000 SEED=7`).

It goes on where it stopped: how many inputs of which seed a target has had stands in `out/fuzz`. A target whose input
fails stops there; the input is kept among its corpus, and the target goes on with the next `make fuzz`. JOBS targets
run at a time, each in a process of its own, so that the memory of one is not taken for another's.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from types import FrameType

from hypothesis import HealthCheck, given, seed, settings

from tests.fuzz.mutations import AT_ONCE, near
from tests.fuzz.target import FuzzTarget, Run
from tests.fuzz.targets import TARGETS

MOST_SECONDS = 5.0
"""Of the processor: so many are one input's at most, however busy the machine is."""
MOST_GROWTH = 400 << 10
"""KiB by which a target's inputs may raise the peak of memory."""
BATCH = 2000
"""Inputs between two notes of how far a target is."""
CORPUS = Path(__file__).parent / "corpus"
PROGRESS = Path(__file__).parents[2] / "out/fuzz"


class TooLong(BaseException):
    """An input is not done in time. No Exception, which a parser might take for one of its library's."""


class FuzzFailure(AssertionError):
    """What no refusal and no result is; `data` is the shortest input for it that was found."""

    def __init__(self, data: bytes, reason: Exception) -> None:
        super().__init__(f"{type(reason).__name__}: {reason}: {data[:300]!r}")
        self.data = data


@contextmanager
def bounded() -> Iterator[None]:
    """Raises AssertionError for what takes more than MOST_SECONDS, also if it would have no end."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLong

    before = signal.signal(signal.SIGPROF, stop)
    # Again and again: what is raised inside a callback of the collector of garbage is lost.
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS, 0.1)
    try:
        yield
    except TooLong:
        raise AssertionError(f"longer than {MOST_SECONDS:g} s") from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def corpus(name: str) -> list[bytes]:
    """The inputs that are kept of a target: each was a failure once."""
    return [path.read_bytes() for path in sorted((CORPUS / name).glob("*"))]


def peak() -> int:
    """The most memory that this process has had (KiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def fuzz(target: FuzzTarget, run: Run, examples: Sequence[bytes], inputs: int, number: int) -> int:
    """Run so many inputs, a multiple of AT_ONCE; gives how many were not refused. Raises FuzzFailure for the rest."""
    accepted, before, current, draws = 0, peak(), b"", max(1, inputs // AT_ONCE)

    @seed(number)
    @settings(max_examples=draws, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(near(examples))
    def check(several: list[bytes]) -> None:
        nonlocal accepted, current
        for data in several:
            current = data
            with bounded():
                accepted += target.take(run, data)
            assert peak() - before < MOST_GROWTH, f"{peak() - before >> 10} MiB more"

    try:
        check()
    except Exception as error:
        # hypothesis ends with the shortest one.
        raise FuzzFailure(current, error) from error
    return accepted


@dataclass
class FuzzProgress:
    """How far a target is with one seed: a file of this form in PROGRESS."""

    inputs: int = 0
    accepted: int = 0
    failures: int = 0
    seconds: float = 0.0

    @staticmethod
    def path(name: str, number: int) -> Path:
        """Its file."""
        return PROGRESS / f"{name}-{number}.json"

    @staticmethod
    def of(name: str, number: int) -> "FuzzProgress":
        """What was noted; nothing yet: zeros."""
        path = FuzzProgress.path(name, number)
        return FuzzProgress(**json.loads(path.read_text())) if path.exists() else FuzzProgress()

    def note(self, name: str, number: int) -> None:
        """Replace the file at one moment."""
        path = self.path(name, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_suffix(".new")
        beside.write_text(json.dumps(asdict(self)))
        beside.replace(path)


def go_on(name: str, inputs: int, number: int) -> None:
    """Bring a target to so many inputs of a seed. Raises FuzzFailure, after it is noted and its input kept."""
    target, progress = TARGETS[name], FuzzProgress.of(name, number)
    wanted = min(inputs, target.most)
    # In memory where there is such a folder: making a file on a disk costs more than reading it does.
    shared = Path("/dev/shm")  # noqa: S108 - the folder made in it has a name of its own
    with (
        tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else None) as folder,
        target.bench(Path(folder)) as run,
    ):
        examples = [*target.examples(), *corpus(name)]
        while progress.inputs < wanted:
            begun, batch = time.monotonic(), min(BATCH, wanted - progress.inputs)
            try:
                # Each batch has random numbers of its own, the same ones however often the campaign was stopped.
                progress.accepted += fuzz(target, run, examples, batch, number * 10**9 + progress.inputs)
                progress.inputs += batch
            except FuzzFailure as failure:
                progress.failures += 1
                kept = CORPUS / name / sha256(failure.data).hexdigest()[:12]
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_bytes(failure.data)
                raise
            finally:
                progress.seconds += time.monotonic() - begun
                progress.note(name, number)


def main() -> int:
    """TARGET, INPUTS, SEED and JOBS come from the environment; without TARGET all of the table in its order.

    `--list` prints the targets and how many there are, and runs none.
    """
    if sys.argv[1:] == ["--list"]:
        sys.stdout.write("\n".join([*TARGETS, f"{len(TARGETS)} targets"]) + "\n")
        return 0
    inputs, number = int(os.environ.get("INPUTS", "100000")), int(os.environ.get("SEED", "0"))
    for name in (*sys.argv[1:], *filter(None, [os.environ.get("TARGET")])):
        if name not in TARGETS:
            sys.stderr.write(f"No target {name}: `python -m {__spec__.name} --list` prints all of them\n")
            return 2
    if len(sys.argv) > 1:
        go_on(sys.argv[1], inputs, number)
        return 0
    names = [os.environ["TARGET"]] if os.environ.get("TARGET") else list(TARGETS)
    sys.stdout.write(f"{'target':22}{'inputs':>9}{'accepted':>10}{'failures':>10}{'seconds':>9}\n")

    def one(name: str) -> bool:
        if missing := TARGETS[name].missing():
            sys.stdout.write(f"{name:22}not run: {missing}\n")
            return True
        done = subprocess.run([sys.executable, "-m", __spec__.name, name], check=False).returncode == 0
        state = FuzzProgress.of(name, number)
        verdict = "" if done else "  stopped: see above"
        sys.stdout.write(
            f"{name:22}{state.inputs:>9}{state.accepted:>10}{state.failures:>10}{state.seconds:>9.0f}{verdict}\n"
        )
        sys.stdout.flush()
        return done

    with ThreadPoolExecutor(int(os.environ.get("JOBS", "1"))) as jobs:
        return 0 if all(list(jobs.map(one, names))) else 1


if __name__ == "__main__":
    sys.exit(main())
