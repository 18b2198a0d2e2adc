"""The two processes of the demonstration: started, spoken to, stopped; never left behind.

Each has a process group of its own, so that Ctrl-C reaches the demonstration alone and it stops them in order, and each
stops when its standard input ends, so that none outlives a demonstration that was killed.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from gateway.demo.child import DemoError, last_words, stop
from gateway.demo.links import LINKS
from gateway.demo.prepare import DemoRun

READY_S = 120.0
"""Real seconds within which a process must be up; one that ends is noticed at once."""


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONUNBUFFERED": "1"}


class PlcProcess:
    """The software PLC as a process: commands go to its standard input, answers come as lines of JSON."""

    def __init__(self, process: subprocess.Popen[str], ready: Mapping[str, Any]) -> None:
        self.process, self.ready = process, ready

    @property
    def pipes(self) -> tuple[IO[str], IO[str]]:
        """Standard input and output. Raises DemoError when the process has none."""
        if self.process.stdin is None or self.process.stdout is None:
            raise DemoError("the software PLC was started without pipes")
        return self.process.stdin, self.process.stdout

    def command(self, command: str, **arguments: object) -> dict[str, Any]:
        """Send one command and return the answer. Raises DemoError when it is refused or the process is gone."""
        put, get = self.pipes
        try:
            put.write(json.dumps({"command": command, **arguments}) + "\n")
            put.flush()
        except BrokenPipeError:
            raise DemoError(f"the software PLC is gone (exit code {self.process.poll()})") from None
        for line in get:
            answer: dict[str, Any] = json.loads(line)
            if answer.get("event") == "reply" and answer.get("command") == command:
                if not answer.get("ok"):
                    raise DemoError(f"the software PLC refused {command!r}: {answer.get('error')}")
                return answer
        raise DemoError(f"the software PLC ended before it answered {command!r}")


@contextmanager
def software_plc(setting: DemoRun, recording: Path) -> Iterator[PlcProcess]:
    """Start the PLC with its replay, or its live plant, held; terminated on leaving.

    Raises DemoError when it does not come up.
    """
    epoch = float(setting.trace.times[0])
    arguments: list[object] = [
        "--device",
        setting.device,
        "--record",
        recording,
        "--stdin",
        "--hold",
    ]
    if setting.live:
        arguments += ["--plant", "heat", "--seed", setting.seed, "--trip", setting.limit]
    else:
        arguments += ["--trace", setting.replay]
    arguments += ["--speed", repr(setting.speed), "--epoch", repr(epoch)]
    arguments += LINKS[setting.link].arguments(setting.folder)
    log = setting.folder / "plc.log"
    with log.open("w", encoding="utf-8") as complaints:
        process = subprocess.Popen(
            [sys.executable, "-m", "sim.plc", *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complaints,
            text=True,
            env=_environment(),
            process_group=0,
        )
        try:
            plc = PlcProcess(process, {})
            line = plc.pipes[1].readline()
            if not line:
                raise DemoError(f"the software PLC did not start: {last_words(log)}")
            plc.ready = json.loads(line)
            yield plc
        finally:
            stop(process)


@contextmanager
def gateway(setting: DemoRun, ready: Mapping[str, Any], status: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start the gateway on the PLC's clock; asked to stop on leaving."""
    clock = f"{ready['epoch']!r},{ready['monotonic']!r},{ready['speed']!r}"
    arguments = ["run", "--config", setting.plant, "--clock", clock, "--status", status]
    arguments += ["--quiet", "--stdin"]
    with (setting.folder / "gateway.out").open("wb") as words:
        process = subprocess.Popen(
            [sys.executable, "-m", "gateway.cli.main", *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=words,
            stderr=subprocess.STDOUT,
            env=_environment(),
            process_group=0,
        )
        try:
            yield process
        finally:
            stop(process)
