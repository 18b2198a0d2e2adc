"""UPPAAL's engine `verifyta`, run as a process of its own where a plant has it."""

import os
import shutil
import signal
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import OneLineError
from sim.lab.uppaal.output import Output, failure, parse_output

VARIABLE = "DECANTER_VERIFYTA"
"""The environment variable that says where verifyta is, when no option does."""

GRACE_S = 5.0
"""Seconds to wait for the rest of the output of an engine that was stopped."""


class EngineError(OneLineError, ValueError):
    """The engine is not there, or gave no usable answer: what happened and what would help."""


@dataclass(frozen=True, slots=True)
class Ran:
    """One run of the engine: what it answered, and the sentence of what went wrong (empty when nothing did)."""

    output: Output
    failure: str = ""


def find_engine(option: str | None, environment: Mapping[str, str]) -> Path:
    """The executable: that of the option, else of DECANTER_VERIFYTA, else `verifyta` on PATH.

    Raises EngineError, saying what was looked at and what would be right.
    """
    for source, place in (("--verifyta", option), (VARIABLE, environment.get(VARIABLE))):
        if place:
            path = Path(place) / "verifyta" if Path(place).is_dir() else Path(place)
            executable = shutil.which(str(path), path=environment.get("PATH"))
            if executable is None:
                what = "is not an executable file" if path.exists() else "is not there"
                raise EngineError(f"{source}: {path} {what}; give the path of UPPAAL's bin/verifyta")
            return Path(executable)
    executable = shutil.which("verifyta", path=environment.get("PATH"))
    if executable is None:
        raise EngineError(
            f"no verifyta here: --verifyta is not given, {VARIABLE} is not set and PATH has none; "
            "the exported files can be opened in UPPAAL all the same"
        )
    return Path(executable)


def run_engine(engine: Path, model: Path, queries: Path, wanted: int, timeout: float, seed: int = 0) -> Ran:
    """Lets the engine answer the `wanted` queries of a file about a model, within `timeout` seconds.

    An engine that refuses, stops early or takes too long is no exception: what it answered is kept and `failure` says
    what happened. Raises EngineError where it cannot be started at all.
    """
    command = [str(engine), "-s", "-q", "-r", str(seed), str(model), str(queries)]
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # UPPAAL's verifyta is a script that starts the engine: both must be stopped
        )
    except OSError as error:
        raise EngineError(f"{engine}: cannot be started ({error.strerror}); give the path of bin/verifyta") from None
    late = ""
    try:
        printed = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        late = f"verifyta was stopped after {timeout:g} s; give more with --timeout"
        printed = _stop(process)
    except BaseException:
        _stop(process)
        raise
    stdout, stderr = (text.decode("utf-8", "replace") for text in printed)
    output = parse_output(stdout, stderr)
    return Ran(output, late or failure(output, wanted, process.returncode))


def _stop(process: subprocess.Popen[bytes]) -> tuple[bytes, bytes]:
    """Kills the engine with all that it started; returns what it had printed."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    try:
        return process.communicate(timeout=GRACE_S)
    except subprocess.TimeoutExpired:
        return b"", b""
