"""One demonstration from start to end: both processes, the live table, one outage, a clean stop."""

import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console, RenderableType
from rich.live import Live

from gateway.demo.child import DemoError, last_words
from gateway.demo.links import LINKS
from gateway.demo.live import DemoPhase, demo_phase, demo_table, newest_status
from gateway.demo.prepare import DemoRun, write_plant
from gateway.demo.processes import READY_S, PlcProcess, gateway, software_plc

OUTAGE_S = 2.0
REFRESH_S = 0.25


def play(setting: DemoRun, console: Console, *, quiet: bool) -> tuple[Path, Path]:
    """Run it; returns the PLC's recording and the gateway's historian. Raises DemoError.

    The folder has no recording and no historian of an earlier run.
    """
    folder = setting.folder
    recording, historian, status = folder / "plc.jsonl", folder / "historian.sqlite", folder / "status.json"
    link = LINKS[setting.link]
    with ExitStack() as running:
        running.enter_context(link.beside(folder))
        plc = running.enter_context(software_plc(setting, recording))
        write_plant(setting, link.settings(folder, plc.ready))
        process = running.enter_context(gateway(setting, plc.ready, status))
        # The replay stands until the gateway reads: else its first seconds would be lost, on a slow machine the most.
        deadline = time.monotonic() + READY_S
        while (seen := newest_status(status)) is None or not seen["link"]["alive"]:
            if process.poll() is not None or time.monotonic() >= deadline:
                raise DemoError(f"the gateway did not get a good reading: {last_words(folder / 'gateway.out')}")
            time.sleep(0.02)
        plc.command("start")
        plc.command("fault", fault={"kind": "refuse", "start": setting.outage_time, "duration": OUTAGE_S})
        states = _states(setting, plc, process, status)
        if console.is_terminal and not quiet:
            with Live(console=console, refresh_per_second=8) as screen:
                for _, table in states:
                    screen.update(table)
        else:
            # Off a terminal: the table once for each phase.
            shown: DemoPhase | None = None
            for phase, table in states:
                if phase != shown and not quiet:
                    console.print(table)
                shown = phase
    if process.returncode != 0:
        raise DemoError(f"the gateway ended with code {process.returncode}: {last_words(folder / 'gateway.out')}")
    return recording, historian


def _states(
    setting: DemoRun, plc: PlcProcess, process: subprocess.Popen[bytes], status: Path
) -> Iterator[tuple[DemoPhase, RenderableType]]:
    """(phase, table) four times a second, the last at the end of the trace. Raises DemoError."""
    ended, phase = False, DemoPhase.RUNNING
    while not ended:
        if process.poll() is not None:
            words = last_words(setting.folder / "gateway.out")
            raise DemoError(f"the gateway ended early with code {process.returncode}: {words}")
        account, seen = plc.command("status"), newest_status(status)
        ended = bool(account["ended"])
        if seen is not None and seen["prediction"]:
            phase = demo_phase(seen, account, phase)
            yield phase, demo_table(seen, account, setting.model.temperature, phase)
        time.sleep(0.0 if ended else REFRESH_S)
