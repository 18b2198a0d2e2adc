"""The engineer's hour against an emulated unknown PLC: every command, from `probe` to a sealed report, and back.

The PLC: words swapped (CDAB), addresses one higher than the I/O list says, one forbidden register, 16 registers a
request, one client at a time. Nothing but the command line is used, and no file is edited by hand. `--record FOLDER`
keeps the terminal recording (asciinema's format) and the transcript of it.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

import click

from benchmarks.cast import Cast, show
from benchmarks.figures import Figure, give
from benchmarks.unknown_plc import BLOCK, LATER, LIMIT, Person, Unknown, make_unknown, start
from tests.rig.pair import ROOT, TEMPERATURE, Plc, end

BOUND_S = 180.0
"""Machine time that the whole walk may take."""
FLAGS = (
    *("MarciaDecanter", "MarciaPmpFango", "CicloAttivo", "AllarmeVibrazioni", "AllarmeTCuscinetti"),
    "PresenzaAllarme",
)
ANALOGUE = (
    *("Assorbimento", "Coppia", "Differenziale", "LivelloVibrazioni", TEMPERATURE, "TCuscinettiAlimentazione"),
    *("TFango", "VelocitaPompa", LATER),
)
REFUSALS = (
    *("none", "layout version", "sequence and its copy differ", "CRC", "heartbeat did not change", "length or start"),
    *("another challenge", "another writer", "sequence not 1 to 100 ahead", "no permit"),
)
HERE, BETWEEN, THERE = 12.0, 27.0, 41.0
"""Two places of the plant's trace at which every signal is another."""
USABLE_S = 45.0


class WalkError(AssertionError):
    """A command did not end as it had to; the message has what it said."""


@dataclass(slots=True)
class Walk:
    """One walk: where it is done, what is shown, and the machine time of each command."""

    unknown: Unknown
    plc: Plc
    person: Person
    cast: Cast
    seconds: dict[str, float] = field(default_factory=dict)
    commands: int = 0
    computed: float = 0.0

    @property
    def folder(self) -> Path:
        return self.unknown.folder

    def note(self, text: str) -> None:
        """What the engineer thinks."""
        self.cast.say(f"\n\x1b[2m# {text}\x1b[0m\n")

    def run(self, *arguments: object, expect: int = 0, answers: Callable[[str], str] | None = None) -> str:
        """One command of `decanter plc`; its output. Raises WalkError for another exit code."""
        return self.decanter("plc", *arguments, expect=expect, answers=answers)

    def decanter(self, *arguments: object, expect: int = 0, answers: Callable[[str], str] | None = None) -> str:
        """One command of `decanter`."""
        words = [str(argument) for argument in arguments]
        self.cast.say(f"\x1b[1m$ decanter {' '.join(map(_quoted, words))}\x1b[0m\n")
        begun = time.monotonic()
        code, said = show(
            self.cast,
            [sys.executable, "-m", "gateway.cli.main", *words],
            cwd=self.folder,
            environment=_environment(),
            answers=answers,
        )
        self.commands += 1
        own = words[1:] if words[0] == "plc" else words
        name = " ".join(takewhile(str.isalpha, own[: 2 if own[0] in ("check", "scan") else 1]))
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - begun
        if code != expect:
            raise WalkError(f"decanter {' '.join(words)}: exit code {code} instead of {expect}; it said:\n{said}")
        return said

    def record(self) -> dict[str, Any]:
        """The record of the last command, from the engineer's own file."""
        lines = (self.folder / "out/commissioning.jsonl").read_text(encoding="utf-8").splitlines()
        return dict(json.loads(lines[-1]))


def _environment() -> dict[str, str]:
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {"PYTHONPATH": path, "DECANTER_BY": "M. Rossi"}


def _quoted(word: str) -> str:
    return f'"{word}"' if not word or set(word) & set(" \"'[]*") else word


# ---------------------------------------------------------------- the walk


def walk(walked: Walk, *, soak_s: float, conformance: bool) -> None:
    """The whole walk. Raises WalkError where a command did not end as it had to."""
    _look(walked)
    _understand(walked)
    _configure(walked)
    _prove(walked, soak_s)
    _write(walked, conformance=conformance)
    _run_armed(walked)
    _sign(walked)


def _at(walked: Walk) -> tuple[str, ...]:
    ready = walked.plc.ready
    return "--host", f"{ready['host']}:{ready['port']}"


def _look(walked: Walk) -> None:
    """This machine, the way there, what can be read."""
    walked.note("Is this machine fit, is the PLC there, and what can be read?")
    walked.run("check", "computer")
    walked.run("probe", *_at(walked))
    walked.run("scan", "registers", "holding:90-430", *_at(walked))
    found = walked.record()["result"]
    if found["largest_block"] != LIMIT:
        raise WalkError(f"the largest block is {found['largest_block']}, and the PLC takes {LIMIT}")


def _understand(walked: Walk) -> None:
    """Two readings of the HMI tell type, order and by how much the list is off."""
    walked.note(
        f"The I/O list says {TEMPERATURE} is a REAL at {_listed(walked, TEMPERATURE)}; the HMI shows it. Twice."
    )
    place = _listed(walked, TEMPERATURE)
    walked.person.moves_plant(HERE, {})
    walked.run("read", place, "--count", 4, *_at(walked))
    walked.run("guess", place, walked.person.reads(TEMPERATURE), *_at(walked))
    walked.person.moves_plant(THERE, {})
    walked.run("guess", place, walked.person.reads(TEMPERATURE), *_at(walked))
    best = walked.record()["result"]["candidates"][0]
    if (best["dtype"], best["order"], best["shift"]) != ("float32", "CDAB", 1):
        raise WalkError(f"the guess is {best}")


def _listed(walked: Walk, name: str) -> str:
    """The address that the I/O list gives a tag."""
    lines = walked.unknown.list.read_text(encoding="cp1252").splitlines()
    return next(cells[2] for line in lines if (cells := line.split(";"))[0] == name)


def _configure(walked: Walk) -> None:
    """The files, all by commands."""
    walked.note("CDAB, and the list counts one too low. The list's spare is the register that is refused.")
    settings = [f"max_registers={LIMIT}", "max_gap=0", "one_client=true", "scan.period=1.0", 'model.path="model.json"']
    keep = [word for setting in settings for word in ("--keep", setting)]
    read = ("--shift", 1, "--order", "CDAB", "--without", "Riserva", "--heartbeat", "PlcHeartbeat")
    walked.run(
        "import", walked.unknown.list.name, "--config", "plant.toml", *_at(walked), "--set", "timeout=0.2", *read, *keep
    )
    walked.note(f"The list has forgotten {LATER}: it lies after the last signal, by the HMI.")
    walked.person.moves_plant(HERE, {})
    after = f"holding:{_number(walked, 'VelocitaPompa') + 1}"
    config = ("--config", "plant.toml")
    walked.run("guess", after, walked.person.reads(LATER), *config)
    walked.person.moves_plant(THERE, {})
    walked.run("guess", after, walked.person.reads(LATER), *config)
    walked.run(
        "bind", LATER, "--guess", 1, "--units", "degC", "--low", -40, "--high", 80, "--sentinel", -32768, *config
    )
    labels = [word for code, name in enumerate(REFUSALS) for word in ("--label", f"{code}={name}")]
    walked.run("bind", "LastRefusal", *labels, *config)
    walked.note("What the gateway may write: one block, of as many words as this PLC takes in one request.")
    walked.run("bind", "--block", f"holding:{BLOCK}", "--timer", 5, "--keep", "writeback.mode=shadow", *config)
    walked.run("check", *config)
    walked.run("check", "plan", *config)


def _number(walked: Walk, name: str) -> int:
    """The PDU address of a tag in the device file that the walk has made."""
    import tomllib

    tags = tomllib.loads((walked.folder / "devices/plant.toml").read_text(encoding="utf-8"))["tags"]
    return int(next(tag["address"] for tag in tags if tag["name"] == name).partition(":")[2])


def _prove(walked: Walk, soak_s: float) -> None:
    """Every value against the HMI, at three states of the plant; then the same scan for a while."""
    config = ("--config", "plant.toml")
    walked.note("Somebody at the HMI writes down what it shows, in three states of the plant.")
    for number, (position, on) in enumerate(((HERE, True), (BETWEEN, True), (THERE, False)), start=1):
        walked.person.moves_plant(position, dict.fromkeys(FLAGS, on))
        walked.person.writes_down(walked.folder / f"hmi{number}.csv", (*FLAGS, *ANALOGUE))
        complete = ("--complete",) if number == 3 else ()
        walked.run("check", "hmi", "--against", f"hmi{number}.csv", *complete, *config)
    walked.plc.order("release")
    walked.plc.order("resume")
    walked.run("check", "soak", "--seconds", soak_s, "--record", "out/soak.csv", *config)
    walked.run("replay", "out/soak.csv", *config)


def _write(walked: Walk, *, conformance: bool) -> None:
    """The write-back: its plan, the PLC's side, the arming, the loop tests with somebody at the HMI."""
    config = ("--config", "plant.toml")
    walked.note("The write-back: the PLC's programmer gets the function block, then the loop tests with the HMI.")
    walked.run("codegen", "--device", "devices/plant.toml", "--out", "out/decanter.st")
    walked.run("check", "plan", "--write", *config)
    walked.run("check", "write", "heartbeat", *config, expect=6)
    walked.decanter("arm", "--reason", "commissioning of line 2", "--minutes", 30, *config)
    walked.run("check", "write", "alarms", "--ask", *config, answers=walked.person.answers)
    walked.run("check", "write", "heartbeat", *config)
    if conformance:
        walked.run("check", "write", "conformance", "--ask", *config, answers=walked.person.answers)


def _run_armed(walked: Walk) -> None:
    """The gateway itself, armed, until the PLC calls its prediction usable; asked by its own socket meanwhile."""
    walked.note("The gateway runs, armed; the PLC serves one client, so it is asked through the gateway.")
    command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", "plant.toml", "--quiet"]
    walked.cast.say("\x1b[1m$ decanter run --config plant.toml --quiet &\x1b[0m\n")
    begun = time.monotonic()
    with (walked.folder / "gateway.out").open("wb") as words:
        environment = {**os.environ, **_environment()}
        process = subprocess.Popen(command, cwd=walked.folder, env=environment, stdout=words, stderr=words)
    try:
        while not walked.plc.order("status")["usable"]:
            if process.poll() is not None or time.monotonic() - begun > USABLE_S:
                said = (walked.folder / "gateway.out").read_text(encoding="utf-8")
                raise WalkError(f"the PLC found no prediction usable: {walked.plc.order('status')}; {said}")
            time.sleep(0.1)
        walked.seconds["run"] = time.monotonic() - begun
        names = ("WritePermit", "BlocksAccepted", "BlocksRefused", "PredictionUsable", TEMPERATURE)
        walked.run("read", *names, "--config", "plant.toml")
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(20.0)


def _sign(walked: Walk) -> None:
    """Take the arming back, make the report, and see that a changed byte is found."""
    walked.decanter("disarm", "--config", "plant.toml")
    walked.run("report", "--config", "plant.toml", "--site", "line 2", "--out", "out/acceptance")
    walked.run("report", "--verify", "--out", "out/acceptance")
    page = walked.folder / "out/acceptance/report.html"
    whole = page.read_bytes()
    page.write_bytes(whole.replace(b"line 2", b"line 3", 1))
    walked.note("Somebody changes one byte of the page:")
    walked.run("report", "--verify", "--out", "out/acceptance", expect=1)
    page.write_bytes(whole)
    walked.decanter("audit", "--config", "plant.toml", "--last", 6)


# ---------------------------------------------------------------- the command


def made(folder: Path, *, soak_s: float, conformance: bool, kind: type[Walk] = Walk) -> tuple[Walk, float]:
    """One walk of this kind in a folder; gives it and the seconds that it took. Raises WalkError."""
    unknown = make_unknown(folder)
    plc = start(unknown)
    walked = kind(unknown, plc, Person(plc), Cast("An unknown PLC, from probe to a signed report"))
    begun, used = time.monotonic(), _computed()
    try:
        walk(walked, soak_s=soak_s, conformance=conformance)
        walked.computed = _computed() - used
    finally:
        end(plc.process)
    return walked, time.monotonic() - begun


def _computed() -> float:
    """Processor seconds of the commands that have ended so far."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def figures_of(walked: Walk, seconds: float) -> list[Figure]:
    """The whole walk against its bound, and what took longest."""
    longest = sorted(walked.seconds.items(), key=lambda item: item[1], reverse=True)[:6]
    whole = Figure(f"the whole walk, {walked.commands} commands", seconds, "s", "the bound", BOUND_S)
    busy = Figure("of it computed by the commands (processor time)", walked.computed, "s", "the whole walk", seconds)
    return [whole, busy, *(Figure(name, spent, "s", "the whole walk", seconds) for name, spent in longest)]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="A shorter soak and no conformance suite.")
@click.option("--record", type=click.Path(path_type=Path, file_okay=False), help="Keep recording and transcript here.")
def main(as_json: bool, quick: bool, record: Path | None) -> None:
    with tempfile.TemporaryDirectory(prefix="decanter-walk-", ignore_cleanup_errors=True) as folder:
        began = time.time()
        try:
            walked, seconds = made(Path(folder), soak_s=3.0 if quick else 15.0, conformance=not quick)
        except WalkError as error:
            raise click.ClickException(str(error)) from None
    if record is not None:
        record.mkdir(parents=True, exist_ok=True)
        walked.cast.write(record / "commissioning.cast", began)
        (record / "commissioning_transcript.txt").write_text(walked.cast.plain(), encoding="utf-8")
    give("commissioning", figures_of(walked, seconds), as_json=as_json)


if __name__ == "__main__":
    main()
