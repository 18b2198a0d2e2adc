"""Following a running gateway: the panel on a terminal, one line for each change anywhere else."""

from threading import Event
from time import monotonic

from rich.console import Console
from rich.live import Live

from gateway.outside.panel.draw import panel
from gateway.outside.status import ChangeLines, GatewayWatch, opening_lines

PATIENCE_S = 0.5
"""How long (s) one look waits for an answer before the panel says for how long there has been none."""


def follow(watch: GatewayWatch, console: Console, *, seconds: float, stop: Event) -> None:
    """Look every `seconds` until `stop` is set; on a terminal the panel, else lines. Raises as GatewayWatch.look."""
    if console.is_terminal and not console.is_dumb_terminal:
        _draw(watch, console, seconds, stop)
    else:
        _speak(watch, console, seconds, stop)


def _draw(watch: GatewayWatch, console: Console, seconds: float, stop: Event) -> None:
    # On a screen of its own, which goes with the program: no number of it stays behind on the terminal.
    with Live(console=console, screen=True, auto_refresh=False) as screen:
        while not stop.is_set():
            screen.update(panel(watch.look(PATIENCE_S)), refresh=True)
            stop.wait(seconds)


def _speak(watch: GatewayWatch, console: Console, seconds: float, stop: Event) -> None:
    def say(line: str) -> None:
        console.print(line, markup=False, highlight=False, soft_wrap=True)

    lines: dict[str, ChangeLines] = {}
    silent = False
    while not stop.is_set():
        sighting = watch.look(PATIENCE_S)
        if sighting.silence:
            if not silent:
                say(f"no answer for {sighting.age:.1f} s: {sighting.silence}")
            silent = True
        else:
            if silent:
                say("it answers again")
            silent = False
            for name, status in sighting.machines.items():
                machine = f"{name}: " if len(sighting.machines) > 1 else ""
                if name not in lines:
                    lines[name] = ChangeLines()
                    for line in opening_lines(status):
                        say(machine + line)
                for line in lines[name].take(status, monotonic()):
                    say(machine + line)
        stop.wait(seconds)
