"""Runs a diagnosis on each case of a folder, once: what it said, or that it failed or took too long, as one JSON each.

The tool under test is only known by its command line and its `diagnosis.json`. `process` starts it anew for each case
(which is what is timed for the table); `call` runs the same command line inside a worker that has imported everything.
"""

import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, field, replace
from io import StringIO
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.discrepancy.seal import CONFIG, committed, index

DECANTER = f"{shlex.quote(sys.executable)} -m gateway.cli.main"
ROOT = Path(__file__).parents[2]
RUN, RESULTS = "run.json", "results"
WORDS = 600
"""Characters of an error that are kept."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one case: `status` done, error or timeout; `seconds`; the diagnosis, or what went wrong."""

    case: str
    status: str
    seconds: float
    diagnosis: dict[str, Any] = field(default_factory=dict)
    message: str = ""


@dataclass(frozen=True, slots=True)
class Case:
    """What the runner knows of a case."""

    name: str
    traces: Path
    model: Path
    seed: int
    options: tuple[str, ...] = ()

    def with_options(self, *options: str) -> "Case":
        """The same case with further options of the command line."""
        return replace(self, options=options)

    def arguments(self, out: Path) -> list[str]:
        """The command line of the tool under test, after its name."""
        where = ["--model", str(self.model), "--traces", str(self.traces), "--out", str(out)]
        return ["diagnose", *where, "--json", "--seed", str(self.seed), *self.options]


Diagnose = Callable[[Case, float], Outcome]


def case(folder: Path, name: str) -> Case:
    """The case `name` of a folder, by its configuration."""
    folder = folder.resolve()
    config = json.loads((folder / "cases" / name / CONFIG).read_text(encoding="utf-8"))
    return Case(name, folder / "cases" / name / config["traces"], folder / config["model"], config["seed"])


def by_process(command: str) -> Diagnose:
    """A process for each case; `command` is what stands before `diagnose`."""

    def diagnose(one: Case, limit: float) -> Outcome:
        with tempfile.TemporaryDirectory(prefix="decanter-case-") as scratch:
            out = Path(scratch) / "out"
            began = perf_counter()
            process = subprocess.Popen(
                [*shlex.split(command), *one.arguments(out)],
                cwd=ROOT,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
            try:
                _, words = process.communicate(timeout=limit)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                return Outcome(one.name, "timeout", perf_counter() - began, message=f"over {limit:g} s")
            seconds = perf_counter() - began
            if process.returncode != 0:
                return Outcome(one.name, "error", seconds, message=words[-WORDS:])
            return read_diagnosis(one.name, out, seconds)

    return diagnose


class OverLimit(BaseException):
    """A case took too long. No command under test takes it for an error of its input, as it would a TimeoutError."""


def by_call(one: Case, limit: float) -> Outcome:
    """The same command line inside this process and without a report, for speed; needs the main thread (its limit)."""
    from gateway.cli.main import main

    words = StringIO()
    with tempfile.TemporaryDirectory(prefix="decanter-case-") as scratch:
        out = Path(scratch) / "out"
        began = perf_counter()
        try:
            with _limited(limit), redirect_stdout(StringIO()), redirect_stderr(words):
                main([*one.arguments(out), "--no-report"], standalone_mode=False)
        except OverLimit:
            return Outcome(one.name, "timeout", perf_counter() - began, message=f"over {limit:g} s")
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a tool under test raises is its score
            if not isinstance(error, SystemExit) or error.code:
                # A command's last words are its error; what it says before are warnings of the traces.
                message = f"{type(error).__name__}: {error} "[:WORDS] + words.getvalue()[-WORDS:]
                return Outcome(one.name, "error", perf_counter() - began, message=message)
        return read_diagnosis(one.name, out, perf_counter() - began)


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """OverLimit inside the block once `seconds` are over."""

    def over(_signal: int, _frame: object) -> None:
        raise OverLimit

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def read_diagnosis(name: str, out: Path, seconds: float) -> Outcome:
    """The outcome of a tool that said it was done: its diagnosis, or an error when it left none."""
    try:
        found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
        verdict = found["verdict"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        return Outcome(name, "error", seconds, message=f"no diagnosis.json: {type(error).__name__}: {error}")
    if verdict not in ("agree", "named", "class", "unexplained", "too-little-data"):
        return Outcome(name, "error", seconds, message=f"the verdict {verdict!r} is none of the five")
    return Outcome(name, "done", seconds, found)


def run_all(
    folder: Path,
    name: str,
    diagnose: Diagnose,
    *,
    jobs: int,
    limit: float,
    only: Sequence[str] = (),
    again: bool = False,
    told: Callable[[str], None] = lambda _words: None,
) -> Path:
    """Run every case that has no result yet, and return the folder of results.

    `again`: those that failed or took too long too. The hash of the labels is noted when the first case is run.
    """
    from joblib import Parallel, delayed

    results = folder / RESULTS / name
    results.mkdir(parents=True, exist_ok=True)
    if not (results / RUN).exists():
        (results / RUN).write_text(json.dumps({"commitment": committed(folder), "limit": limit}) + "\n", "utf-8")
    wanted = [one for one in index(folder) if not only or one in only]
    left = [one for one in wanted if not _finished(results / f"{one}.json", again)]
    work = (delayed(_one)(diagnose, folder, one, limit, results) for one in left)
    began, count = perf_counter(), dict.fromkeys(("done", "error", "timeout"), 0)
    for status in Parallel(n_jobs=jobs, return_as="generator_unordered")(work):
        count[status] += 1
        done = sum(count.values())
        rest = (perf_counter() - began) / done * (len(left) - done)
        bad = f"{count['error']} errors, {count['timeout']} late"
        told(f"{name}: {done} of {len(left)} cases ({bad}), {rest:.0f} s left")
    return results


def _finished(path: Path, again: bool) -> bool:
    return path.exists() and not (again and json.loads(path.read_text(encoding="utf-8"))["status"] != "done")


def _one(diagnose: Diagnose, folder: Path, name: str, limit: float, results: Path) -> str:
    outcome = diagnose(case(folder, name), limit)
    draft = results / f".{name}.draft"
    draft.write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")
    draft.replace(results / f"{name}.json")
    return outcome.status


def outcomes(results: Path) -> tuple[str, dict[str, Outcome]]:
    """(hash of the labels under which they were made, outcomes by case)."""
    commitment = json.loads((results / RUN).read_text(encoding="utf-8"))["commitment"]
    found = [
        Outcome(**json.loads(path.read_text(encoding="utf-8")))
        for path in sorted(results.glob("*.json"))
        if path.name != RUN
    ]
    return commitment, {one.case: one for one in found}
