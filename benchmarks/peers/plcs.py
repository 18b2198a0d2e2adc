"""The PLCs that all contenders read, and what a contender's polls were, as the PLCs saw them."""

import shutil
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers import REGISTERS
from benchmarks.processes import BenchmarkError

SOURCE = Path(__file__).with_name("plcs.c")
_ROW = struct.Struct("<d5H6x")
_LAST_REGISTER = REGISTERS - 1
Moments = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Polls:
    """What became of the polls that were due: how many were `done`, and by how much (s) each done one was late."""

    due: int
    done: int
    lateness: Moments


def built(folder: Path) -> Path:
    """The program of `plcs.c`. Raises BenchmarkError where there is no compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise BenchmarkError("there is no C compiler (gcc or cc): the PLCs of this benchmark are a C program")
    program = folder / "plcs"
    subprocess.run([compiler, "-O2", "-o", str(program), str(SOURCE)], check=True)
    return program


def free_ports(count: int) -> int:
    """The first of `count` consecutive ports of loopback that are free. Raises BenchmarkError without."""
    for first in range(23_000, 60_000, count):
        held: list[socket.socket] = []
        try:
            for port in range(first, first + count):
                held.append(socket.create_server(("127.0.0.1", port)))
        except OSError:
            continue
        else:
            return first
        finally:
            for each in held:
                each.close()
    raise BenchmarkError(f"there are no {count} consecutive free ports on 127.0.0.1")


@contextmanager
def serving(program: Path, count: int, rows: Path) -> Iterator[int]:
    """`count` PLCs, whose requests go to the file `rows`; gives the first one's port."""
    port = free_ports(count)
    with rows.open("wb") as out:
        command = [str(program), "serve", str(port), str(count)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out, stderr=subprocess.PIPE, text=True) as process:
            if process.stderr is None or process.stderr.readline() != "ready\n":
                raise BenchmarkError("the PLCs did not start")
            try:
                yield port
            finally:
                if process.stdin is not None:
                    process.stdin.close()


def most_polls(program: Path, folder: Path, count: int, seconds: float) -> float:
    """How many polls a second the PLCs answer at most, asked by a loop in C, one after another."""
    with serving(program, count, folder / "limit.rows") as port:
        command = [str(program), "poll", str(port), str(count), "0", str(seconds)]
        return float(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def answered(rows: Path, count: int) -> list[Moments]:
    """When each PLC had answered for its last register, which every contender asks for last: the end of a poll.

    Monotonic seconds, in their order.
    """
    data = rows.read_bytes()
    found: list[list[float]] = [[] for _ in range(count)]
    for at, plc, _, function, address, asked in _ROW.iter_unpack(data[: len(data) // _ROW.size * _ROW.size]):
        if function == 3 and address <= _LAST_REGISTER < address + asked:
            found[plc].append(at)
    return [np.array(moments) for moments in found]


def written_after(rows: Path, count: int, since: float, until: float) -> Moments:
    """How long (s) after its PLC had answered the poll before it each block in [since, until) was answered."""
    data = rows.read_bytes()
    polled, after = [0.0] * count, []
    for at, plc, _, function, address, asked in _ROW.iter_unpack(data[: len(data) // _ROW.size * _ROW.size]):
        if function == 3 and address <= _LAST_REGISTER < address + asked:
            polled[plc] = at
        elif function == 16 and since <= at < until:
            after.append(at - polled[plc])
    return np.array(after)


def judged(moments: list[Moments], period: float, since: float, until: float) -> Polls:
    """The polls in [since, until) against absolute deadlines, one every `period` seconds (s).

    A PLC's deadlines are a grid without drift. Where the grid lies is the contender's own affair: it is put at the one
    of its polls from which all together are least late. A deadline counts as met by the first poll between it and the
    next; its lateness is the time between.
    """
    due = int((until - since) / period) * len(moments)
    done, lateness = 0, [np.empty(0)]
    for each in moments:
        inside = each[(each >= since) & (each < until)] - since
        if not inside.size:
            continue
        phases = inside % period
        begin = phases[np.argmin(((phases - phases[:, None]) % period).sum(axis=1))]
        number = np.floor((inside - begin) / period + 1e-9)
        _, first = np.unique(number, return_index=True)
        done += min(first.size, due // len(moments))
        lateness.append((inside - begin - number * period)[first])
    return Polls(due, done, np.maximum(np.concatenate(lateness), 0.0))


def python_contender(module: str, *arguments: object) -> list[str]:
    """The command of a contender that is a module of this package."""
    return [sys.executable, "-m", f"benchmarks.peers.{module}", *map(str, arguments)]
