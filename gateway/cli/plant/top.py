"""`decanter top`: how a running gateway is, live or once, asked over its control socket."""

import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from types import FrameType
from typing import Any, NoReturn

import click
from rich.console import Console

from gateway.cli.plant.commands import EXITS, REFRESH_S
from gateway.cli.plant.plant_file import control_socket
from gateway.console import CommandResult, Drawing, conclude
from gateway.entry import fail, sentences
from gateway.outside.panel import follow, panel
from gateway.outside.status import GatewayStatus, GatewayWatch, Health, Sighting, findings, judge_health
from sim.strict_json import strict

ANSWER_S = 5.0
"""How long (s) a gateway has for its first answer."""
WORSE = (Health.WELL, Health.ATTENTION, Health.NO_READINGS)
"""The words of machines that answer, each worse than the one before."""


def top(path: Path, machine: str | None, watches: bool, every: float, socket: Path | None, as_json: bool) -> None:
    """The work of `top`."""
    if watches and as_json:
        raise click.UsageError("--json is for one look: give --once too")
    with sentences(), closing(GatewayWatch(control_socket(path, socket), machine=machine)) as watch:
        sighting = watch.look(ANSWER_S)
        if not watches:
            _conclude_look(sighting, path, as_json=as_json)
            return
        if sighting.gone:
            fail(_absent(sighting, path), EXITS[Health.ABSENT][0])
        # Ctrl-C is the way to end it.
        with suppress(KeyboardInterrupt), _interrupt_signals(signal.SIGTERM, signal.SIGHUP):
            follow(watch, Console(), seconds=every, stop=Event())


def _conclude_look(sighting: Sighting, path: Path, *, as_json: bool) -> None:
    """Show one look at a gateway; leave with the exit code of its health."""
    if sighting.silence or not sighting.machines:
        word, reason = Health.ABSENT if sighting.gone else Health.SILENT, _absent(sighting, path)
        absent = CommandResult({"health": word, "reason": reason}, reason, EXITS[word][0])
        conclude(absent, lambda _: [], as_json=as_json)
    answers = {name: _answer(status) for name, status in sighting.machines.items()}
    # The worst word of all machines is the gateway's.
    word = max((answer["health"] for answer in answers.values()), key=WORSE.index)
    only = sighting.status is not None
    data = next(iter(answers.values())) if only else {"health": word, "machines": answers}
    found = CommandResult(data, failing=EXITS[word][0], ok=word is Health.WELL)
    conclude(found, lambda _: [Drawing(panel(sighting))], as_json=as_json)


def _answer(status: GatewayStatus) -> dict[str, Any]:
    word, found = judge_health(status), findings(status)
    sentences = {finding.check: finding.sentence for finding in found}
    return {"ok": word is Health.WELL, "health": word, "findings": sentences, "status": strict(status)}


@contextmanager
def live_panel(socket_path: Path) -> Iterator[None]:
    """The panel of the gateway that this very process runs, as `decanter top` shows it, while the block lasts."""
    stop, watch = Event(), GatewayWatch(socket_path)
    thread = Thread(
        target=follow, args=(watch, Console()), kwargs={"seconds": REFRESH_S, "stop": stop}, name="panel", daemon=True
    )
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(timeout=ANSWER_S)
        watch.close()


def _absent(sighting: Sighting, plant: Path) -> str:
    return f"{sighting.silence}; start one: decanter run --config {plant}" if sighting.gone else sighting.silence


@contextmanager
def _interrupt_signals(*numbers: signal.Signals) -> Iterator[None]:
    """Let these signals end the block as Ctrl-C does: with the terminal as it was."""

    def interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt

    before = [(number, signal.signal(number, interrupt)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)
