"""A newcomer's hour, without the newcomer: from an empty environment and a wheel to a prediction and a shadow block.

What is given: a wheel, a PLC that nobody knows (emulated: words swapped, addresses one higher than its I/O list says,
16 registers a request, one client), and an export of the SCADA under the SCADA's own names. What is typed is counted,
with its seconds; no file is written by hand. `--quick` takes the program that is installed here. `--plant` walks with
a machine of another make, from its own I/O list and export to a prediction and a diagnosis of its own records; a
command that is refused ends the hour.
"""

import csv
import json
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import chdir, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.testing import CliRunner

from benchmarks.figures import Figure, give
from benchmarks.foreign_plants import FOREIGN, ForeignPlant
from gateway.cli.main import main as decanter
from gateway.store import HistorianError, recent
from sim.lab.recordings.trace_file import write_trace
from sim.plant import production
from sim.sha.trace import Trace
from tests.rig.pair import ROOT

TEMPERATURE = "TCuscinettiRiduttore"
EXPORT = {
    "Stato marcia": "MarciaDecanter",
    "Corrente motore [A]": "Assorbimento",
    f"Linea2.{TEMPERATURE} [°C]": TEMPERATURE,
    "Linea2.TAmbiente [°C]": "TAmbiente",
}
"""Header in the SCADA's export -> signal; the first two are not called as in the I/O list."""
MOST_COMMANDS, MOST_S = 12, 600.0
PATIENCE_S = 300.0
RECORDED_SCANS = 10
_RUNNING: tuple[str, ...] = ("plc.pid", "run.pid")


class HourError(AssertionError):
    """A command did not end as it had to, or the prediction did not come; the message has what was said."""


@dataclass(frozen=True, slots=True)
class Typed:
    """One command, its seconds, the last line of what it answered, and all of that."""

    line: str
    seconds: float
    answer: str
    printed: str = ""


@dataclass(slots=True)
class Hour:
    """One hour in a folder, with the environment of its shell; `quick` saves what costs time and shows nothing."""

    folder: Path
    environment: Mapping[str, str]
    quick: bool = False
    typed: list[Typed] = field(default_factory=list)

    def call(self, line: str) -> tuple[int, str, str]:
        """Exit code, standard output and error of one command in a shell; if quick, of a plain one in this process."""
        if self.quick and line.startswith("decanter ") and not set("&|;<>$") & set(line):
            with chdir(self.folder):
                done = CliRunner().invoke(decanter, shlex.split(line)[1:])
            return done.exit_code, done.stdout, done.stderr
        shell = subprocess.run(
            ["bash", "-c", line],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=MOST_S,
        )
        return shell.returncode, shell.stdout, shell.stderr

    def type(self, line: str) -> str:
        """One command; its standard output. Raises HourError unless it ends well."""
        begun = time.monotonic()
        code, printed, complaints = self.call(line)
        if code != 0:
            raise HourError(f"{line}: exit code {code}; it said:\n{printed}{complaints}")
        spoken = [text for text in printed.splitlines() if text.strip()]
        self.typed.append(Typed(line, time.monotonic() - begun, spoken[-1].strip() if spoken else "", printed))
        return printed


def given(folder: Path) -> float:
    """The SCADA's export, and the plant that the emulated PLC is connected to; the second at which that is warmest."""
    day = production(1, seed=3)
    begin = datetime(2026, 3, 1, 6, tzinfo=UTC)
    with (folder / "export.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, delimiter=";")
        writer.writerow(("Data", *EXPORT))
        for row, at in enumerate(day.times - day.times[0]):
            cells = [day.signals[name][row] for name in EXPORT.values()]
            texts = ["MARCIA" if cells[0] else "FERMO", *(f"{cell:.1f}".replace(".", ",") for cell in cells[1:])]
            writer.writerow(((begin + timedelta(seconds=float(at))).strftime("%d/%m/%Y %H:%M:%S"), *texts))
    other = production(1, seed=5)
    times = other.times - other.times[0]
    signals = {name: np.asarray(values).round(2) for name, values in other.signals.items()}
    write_trace(Trace("plant", times, signals, origin="of another day", synthetic=True), folder / "plant.csv")
    return float(times[np.argmax(signals[TEMPERATURE])])


def asked(port: int, command: str, **keys: Any) -> dict[str, Any]:
    """What the emulator's control port answers: the plant is moved, the HMI is read; nothing that a newcomer types."""
    with socket.create_connection(("127.0.0.1", port), 5.0) as line, line.makefile("rw", encoding="utf-8") as stream:
        stream.write(json.dumps({"command": command, **keys}) + "\n")
        stream.flush()
        reply: dict[str, Any] = json.loads(stream.readline())
    time.sleep(0.2)  # until the PLC's program and the HMI show it
    return reply


def hmi(port: int, position: float) -> str:
    """What the HMI shows for the temperature at a place of the plant's day."""
    asked(port, "seek", position=position)
    return f"{asked(port, 'values')['values'][TEMPERATURE]:.1f}".replace(".", ",")


def free_ports(count: int) -> list[int]:
    """So many ports of this machine that nobody listens on."""
    held = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [int(each.getsockname()[1]) for each in held]
    for each in held:
        each.close()
    return ports


def walk(hour: Hour, wheel: Path | None, warmest: float, model: Path | None = None) -> dict[str, Any]:
    """All that is typed; the status in the end. Without a wheel the program is installed.

    With a `model` that one is taken, and none learned. Raises HourError.
    """
    port, control = free_ports(2)
    at = f"--host 127.0.0.1 --port {port}"
    if wheel is not None:
        hour.type(f"python3 -m venv venv && venv/bin/pip install --quiet {wheel}")
    hour.type("decanter docs --examples .")
    hour.type(
        "decanter emulate --device unknown_plc.toml --trace plant.csv --max-registers 16 --max-clients 1 "
        f"--port {port} --control-port {control} > plc.log 2>&1 & echo $! > plc.pid; "
        "until grep -q ready plc.log; do sleep 0.1; done"
    )
    asked(control, "pause")
    hour.type(f"decanter plc guess 40107 {hmi(control, 0.0)} {at}")
    hour.type(f"decanter plc guess 40107 {hmi(control, warmest)} {at}")
    renames = " ".join(f"--rename '{header}={name}'" for header, name in list(EXPORT.items())[:2])
    hour.type(
        f"decanter init --list io_list.csv {at} --shift 1 --order CDAB --without Riserva --set max_registers=16 "
        f"--temperature {TEMPERATURE} --trace export.csv {renames}"
    )
    hour.type("decanter plc check")
    if model is not None:
        shutil.copytree(model, hour.folder / "models/first")
    else:
        hour.type("decanter model learn --traces export.csv --map columns.toml --out models/first")
    hour.type("decanter plc bind --block holding:401 --keep writeback.mode=shadow --keep model.path=models/first")
    asked(control, "resume")
    hour.type("decanter run > run.log 2>&1 & echo $! > run.pid")
    return _watched(hour)


def walk_foreign(hour: Hour, plant: ForeignPlant) -> dict[str, Any]:
    """All that is typed at a plant of another make; the diagnosis of its own records. Raises HourError."""
    port, control = free_ports(2)
    plant.write(hour.folder)
    # The PLC is there already: this is typed by nobody.
    begun = (
        f"decanter emulate --device emulated.toml --trace plant.csv --port {port} --control-port {control} "
        "> plc.log 2>&1 & echo $! > plc.pid; until grep -q ready plc.log; do sleep 0.1; done"
    )
    if (ended := hour.call(begun))[0]:
        raise HourError(f"the emulated PLC does not start: {ended}")
    hour.type(
        f"decanter init --list io.csv --host 127.0.0.1 --port {port} {plant.options} "
        f"--temperature {plant.temperature} --trace export.csv"
    )
    hour.type("decanter plc check")
    hour.type("decanter model learn --traces export.csv --map columns.toml --out models/first --name machine")
    hour.type("decanter plc bind --keep model.path=models/first")
    hour.type("decanter plc check")
    hour.type("decanter run > run.log 2>&1 & echo $! > run.pid")
    _watched(hour, lambda status: bool(status.get("prediction") and status.get("forecast")))
    hour.type("decanter model show models/first")
    _wait_for_records(hour.folder / "out/historian.sqlite")
    printed = hour.type(
        "decanter diagnose --model models/first --historian out/historian.sqlite --out diagnosis --json"
    )
    found: dict[str, Any] = json.loads(printed)
    return found


def _wait_for_records(historian: Path) -> None:
    """Until so many scans are on disk that somebody may look at them. Raises HourError."""
    begun = time.monotonic()
    while time.monotonic() - begun < PATIENCE_S:
        with suppress(HistorianError, ValueError):
            if recent(historian, "14d").times.size >= RECORDED_SCANS:
                return
        time.sleep(0.5)
    raise HourError(f"fewer than {RECORDED_SCANS} scans are in {historian.name} after {PATIENCE_S:g} s")


def _has_block(status: Mapping[str, Any]) -> bool:
    shadow = status.get("writeback", {}).get("mode")
    return bool(status.get("prediction") and status.get("forecast") and shadow == "shadow")


def _watched(hour: Hour, enough: Callable[[Mapping[str, Any]], bool] = _has_block) -> dict[str, Any]:
    """`decanter top --once`, as often as somebody looks, until it shows `enough`; it counts once."""
    begun = time.monotonic()
    while True:
        data: dict[str, Any] = json.loads(hour.call("decanter top --once --json")[1] or "{}")
        status = data.get("status") or {}
        if enough(status):
            break
        if time.monotonic() - begun > PATIENCE_S:
            said = (hour.folder / "run.log").read_text(encoding="utf-8")
            raise HourError(f"no prediction within {PATIENCE_S:g} s: {data.get('findings')}; run said:\n{said}")
        time.sleep(0.5)
    seen = status["prediction"]
    words = (
        f"{seen['measured']:.1f} degC measured, {seen['mean']:.1f} predicted, write-back {status['writeback']['mode']}"
    )
    hour.typed.append(Typed("decanter top --once", time.monotonic() - begun, words))
    return status


def _code(text: str) -> str:
    plain = text.replace("`", "'")
    return f"`{plain}`" if plain else ""


def page(hour: Hour) -> str:
    """The hour as a table in Markdown."""
    rows = [
        f"| {number} | `{typed.line}` | {typed.seconds:.1f} | {_code(typed.answer)} |"
        for number, typed in enumerate(hour.typed, 1)
    ]
    total = sum(typed.seconds for typed in hour.typed)
    last = f"| | {len(hour.typed)} commands, 0 files written by hand | {total:.1f} | |"
    text = "\n".join(["| | typed | seconds | its last line |", "|---|---|---|---|", *rows, last])
    return text.replace(str(hour.folder), ".") + "\n"


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="The program that is installed, no wheel.")
@click.option(
    "--model-folder", "model", type=click.Path(path_type=Path), help="A model that is there; none is learned."
)
@click.option("--plant", "other", type=click.Choice(list(FOREIGN)), help="A machine of another make; --quick.")
@click.option("--wheel", type=click.Path(path_type=Path, exists=True), help="A wheel that is there; else one is built.")
def main(as_json: bool, quick: bool, model: Path | None, other: str | None, wheel: Path | None) -> None:
    if other is not None and not (quick and model is None):
        raise click.UsageError("--plant belongs to --quick, and learns its own model")
    with tempfile.TemporaryDirectory(prefix="decanter-hour-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        if wheel is None and not quick:
            build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "wheel")]
            subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
            (wheel,) = (folder / "wheel").glob("*.whl")
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "DECANTER"))}
        programs = Path(sys.executable).parent if quick else folder / "venv" / "bin"
        environment["PATH"] = f"{programs}:{environment['PATH']}"
        hour = Hour(folder, environment, quick)
        try:
            if other is not None:
                walk_foreign(hour, FOREIGN[other])
            else:
                walk(hour, None if wheel is None or quick else wheel.absolute(), given(folder), model)
        except HourError as error:
            raise click.ClickException(str(error)) from None
        finally:
            for kept in _RUNNING:
                with suppress(FileNotFoundError, ProcessLookupError):
                    os.kill(int((folder / kept).read_text(encoding="ascii")), signal.SIGTERM)
            time.sleep(1.0)
        text = page(hour)
    if not as_json:
        click.echo(text)
    seconds = sum(typed.seconds for typed in hour.typed)
    figures = [
        Figure("commands", float(len(hour.typed)), "commands", "the target", float(MOST_COMMANDS)),
        Figure("waiting", seconds, "s", "the target", MOST_S),
    ]
    if not quick:
        figures.append(Figure("of it the installation", hour.typed[0].seconds, "s", "all waiting", seconds))
    give("first hour", figures, as_json=as_json)


if __name__ == "__main__":
    main()
