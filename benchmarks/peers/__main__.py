"""The gateway beside what users would take instead: many PLCs with ten registers each, all read ten times a second.

The same PLCs for every contender, one process of C that answers at once and records when; the C loop's polls a second,
as fast as they go, say how far from its limit it is. The contenders, each a process of its own, one after another:

    plant        `decanter run` with a [[machine]] for each PLC: quality and the historian
    plant+blocks the same with a belief at each scan, a forecast every ten seconds, and a block after each scan
    streams      of the gateway a stream of scans a PLC with quality, and one historian: what reading alone takes
    pymodbus     its asynchronous client in a loop a PLC; it keeps nothing
    C loop       the same polls from C, one after another: the limit
    ThingsBoard  the ThingsBoard IoT gateway 3.8.5, one request a value, storage in memory, sending all it reads to a
                 stub of its server; in an environment of its own (--environment), which --install makes from PyPI

A poll is done when its PLC has answered for the last of the ten registers. Lateness is measured against absolute
deadlines, a grid without drift for each PLC that lies where the contender's polls are least late; a deadline that no
poll meets before the next one is a poll not done. Processor time is the kernel's account of the contender's processes
with all their threads, memory their resident sizes at the end (what they share counts for each), bytes what the
historian has grown by. A block is late by the time from the PLC's answer to a poll to the block that follows it. Growth
is the exponent of the processor time from the least number of PLCs to the most.
"""

import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import log
from pathlib import Path

import click

from benchmarks.figures import Figure, give, percentile
from benchmarks.peers.plant import plant_command
from benchmarks.peers.plcs import (
    Moments,
    Polls,
    answered,
    built,
    judged,
    most_polls,
    python_contender,
    serving,
    written_after,
)
from benchmarks.peers.thingsboard import configure, environment
from benchmarks.processes import ROOT, BenchmarkError, cpu_seconds, family_of, resident_kilobytes

PLANTS = {
    "plant": {"blocks": False},
    "plant+blocks": {"blocks": True},
}
"""The gateway as users run it, by the name of the contender."""
CONTENDERS = (*PLANTS, "streams", "pymodbus", "C loop", "ThingsBoard")
WARM_UP_S, START_S = 4.0, 180.0
ENVIRONMENT = ROOT / "out/peers/thingsboard"


@dataclass(frozen=True, slots=True)
class PeerRun:
    """What a contender did: its polls, its blocks and how long (s) after the poll each came, the share of a core (%),
    the resident size (MB), the bytes it stored."""

    polls: Polls
    blocks: Moments
    core: float
    megabytes: float
    stored: int


@contextmanager
def started(command: Sequence[str], folder: Path, variables: dict[str, str]) -> Iterator["subprocess.Popen[bytes]"]:
    """A contender's process, its words in `folder`; it ends with its standard input, or is told to."""
    with (folder / "words.txt").open("wb") as words:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=words,
            stderr=words,
            cwd=ROOT if not variables else folder,
            env=variables or None,
        )
        try:
            yield process
        finally:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(3.0)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()


@contextmanager
def running(
    name: str, program: Path, folder: Path, *, port: int, count: int, period: float, seconds: float, python: Path | None
) -> Iterator["subprocess.Popen[bytes]"]:
    """The contender called `name` (of CONTENDERS) at work."""
    variables: dict[str, str] = {}
    if name == "ThingsBoard":
        stub = subprocess.Popen(
            python_contender("thingsboard"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        try:
            line = stub.stdout.readline() if stub.stdout else ""
            config = configure(folder, broker=int(line), port=port, count=count, period=period)
            variables = {"TB_GW_CONFIG_DIR": str(config), "HOME": str(folder), "PATH": "/usr/bin:/bin"}
            with started([str(python), "-m", "thingsboard_gateway.tb_gateway"], folder, variables) as process:
                yield process
        finally:
            if stub.stdin is not None:
                stub.stdin.close()
            stub.wait(5.0)
        return
    if name in PLANTS:
        with started(
            plant_command(folder, port=port, count=count, period=period, **PLANTS[name]), folder, variables
        ) as process:
            yield process
        return
    commands = {
        "streams": python_contender("ours", port, count, period, folder),
        "pymodbus": python_contender("bare", port, count, period),
        "C loop": [str(program), "poll", str(port), str(count), str(period), str(seconds + WARM_UP_S + 1.0)],
    }
    with started(commands[name], folder, variables) as process:
        yield process


def measured(
    name: str, program: Path, folder: Path, *, count: int, period: float, seconds: float, python: Path | None
) -> PeerRun:
    """Let one contender read `count` PLCs for `seconds`, after its start. Raises BenchmarkError where it ends."""
    folder.mkdir(parents=True)
    rows = folder / "requests.rows"
    with serving(program, count, rows) as port:
        with running(
            name, program, folder, port=port, count=count, period=period, seconds=seconds, python=python
        ) as process:
            until_polled(rows, count, process, min(WARM_UP_S, seconds))
            before = sum(path.stat().st_size for path in folder.glob("historian*"))
            family = family_of(process.pid)
            since, cpu = time.monotonic(), sum(map(cpu_seconds, family))
            time.sleep(seconds)
            until, cpu_after = time.monotonic(), sum(map(cpu_seconds, family))
            megabytes = sum(map(resident_kilobytes, family)) / 1e3
            if process.poll() is not None:
                raise BenchmarkError(f"{name} ended while it was measured")
        stored = sum(path.stat().st_size for path in folder.glob("historian*")) - before
    polls = judged(answered(rows, count), period, since, until)
    blocks = written_after(rows, count, since, until)
    return PeerRun(polls, blocks, 100.0 * (cpu_after - cpu) / (until - since), megabytes, max(stored, 0))


def until_polled(rows: Path, count: int, process: "subprocess.Popen[bytes]", warm_up: float) -> None:
    """Wait until every PLC was polled, and `warm_up` seconds more. Raises BenchmarkError after START_S."""
    deadline = time.monotonic() + START_S
    while not all(moments.size for moments in answered(rows, count)):
        if process.poll() is not None:
            raise BenchmarkError(f"the contender ended with code {process.returncode} before it had polled all PLCs")
        if time.monotonic() > deadline:
            raise BenchmarkError(f"not all PLCs were polled within {START_S:g} s")
        time.sleep(0.2)
    time.sleep(warm_up)


def figures_of(name: str, count: int, run: PeerRun, bare: PeerRun | None) -> list[Figure]:
    """A contender's figures, processor time and memory against the bare client's in the same run."""
    title, due = f"{count} PLCs, {name}", float(run.polls.due)
    late = run.polls.lateness.tolist() or [0.0]
    other = "pymodbus" if bare is not None else ""
    blocks = []
    if run.blocks.size:
        after = run.blocks.tolist()
        blocks = [
            Figure(f"{title}: blocks written", float(run.blocks.size), "", "polls done", float(run.polls.done)),
            Figure(f"{title}: register read to its block, p50", 1e3 * percentile(after, 50), "ms"),
            Figure(f"{title}: register read to its block, p99", 1e3 * percentile(after, 99), "ms"),
        ]
    return [
        Figure(f"{title}: polls done", float(run.polls.done), "", "due", due),
        Figure(f"{title}: lateness, p50", 1e3 * percentile(late, 50), "ms"),
        Figure(f"{title}: lateness, p99", 1e3 * percentile(late, 99), "ms"),
        Figure(f"{title}: processor time", run.core, "% of a core", other, bare.core if bare else None),
        Figure(f"{title}: resident size", run.megabytes, "MB", other, bare.megabytes if bare else None),
        Figure(f"{title}: stored a poll", run.stored / max(run.polls.done, 1), "bytes"),
        *blocks,
    ]


def growth_of(name: str, runs: dict[int, PeerRun]) -> list[Figure]:
    """The exponent with which a contender's processor time grows with the number of PLCs; none from one number."""
    least, most = min(runs, default=0), max(runs, default=0)
    if least == most or not runs[least].core:
        return []
    exponent = log(runs[most].core / runs[least].core) / log(most / least)
    return [Figure(f"{name}: growth of its processor time from {least} to {most} PLCs", exponent, "(exponent)")]


def measure(
    counts: Sequence[int], names: Sequence[str], period: float, seconds: float, python: Path | None
) -> list[Figure]:
    """All contenders at all sizes. Raises BenchmarkError."""
    figures = []
    runs: dict[str, dict[int, PeerRun]] = {name: {} for name in names}
    with tempfile.TemporaryDirectory(prefix="decanter-peers-") as place:
        folder = Path(place)
        program = built(folder)
        most = most_polls(program, folder, max(counts), min(seconds, 2.0))
        due = max(counts) / period
        figures.append(Figure("polls a second that the PLCs answer", most, "", "the most that are due", due))
        for count in counts:
            bare = None
            # The bare client first: the others' figures stand against it.
            for name in sorted(names, key=lambda name: name != "pymodbus"):
                run = measured(
                    name,
                    program,
                    folder / f"{name} {count}".replace(" ", "_"),
                    count=count,
                    period=period,
                    seconds=seconds,
                    python=python,
                )
                figures += figures_of(name, count, run, bare)
                runs[name][count] = run
                bare = run if name == "pymodbus" else bare
    return [*figures, *(figure for name, own in runs.items() for figure in growth_of(name, own))]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="10 PLCs for 4 seconds, without ThingsBoard.")
@click.option("--count", "counts", type=click.IntRange(1, 200), multiple=True, help="How many PLCs [1 10 50 100].")
@click.option("--only", "names", type=click.Choice(CONTENDERS), multiple=True, help="Only this contender; repeatable.")
@click.option("--seconds", type=click.FloatRange(1.0), help="How long each is measured [20].")
@click.option("--period", type=click.FloatRange(0.02), default=0.1, show_default=True, help="Of the polls (s).")
@click.option("--install", is_flag=True, help="Install the ThingsBoard gateway into its environment, from PyPI.")
@click.option("--environment", "place", type=click.Path(path_type=Path), default=ENVIRONMENT, help="Its environment.")
def main(
    as_json: bool,
    quick: bool,
    counts: tuple[int, ...],
    names: tuple[str, ...],
    seconds: float | None,
    period: float,
    install: bool,
    place: Path,
) -> None:
    chosen = names or (CONTENDERS[:-1] if quick else CONTENDERS)
    python = None
    if "ThingsBoard" in chosen:
        try:
            python = environment(place, install=install)
        except BenchmarkError as error:
            click.echo(f"without ThingsBoard: {error.message}", err=True)
            chosen = tuple(name for name in chosen if name != "ThingsBoard")
    sizes = counts or ((10,) if quick else (1, 10, 50, 100))
    figures = measure(sizes, chosen, period, seconds or (4.0 if quick else 20.0), python)
    give(f"peers, {1.0 / period:g} polls a second of each PLC", figures, as_json=as_json)


if __name__ == "__main__":
    main()
