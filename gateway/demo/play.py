"""One demonstration from start to end: both processes, the live table, one outage, a clean stop."""

import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from gateway.demo.live import live_table, read_status
from gateway.demo.prepare import Setting
from gateway.demo.processes import READY_S, DemoError, Plc, gateway, software_plc

OUTAGE_AT = 0.45
"""Where in the replay the PLC refuses its connections, as a share of its duration."""
OUTAGE_S = 2.0
REFRESH_S = 0.25

Show = Callable[[Mapping[str, Any], Mapping[str, Any], str], None]


def play(setting: Setting, console: Console, *, quiet: bool) -> tuple[Path, Path]:
    """Run it; returns the PLC's recording and the gateway's historian. Raises DemoError."""
    folder = setting.folder
    recording, historian, status = folder / "plc.jsonl", folder / "historian.sqlite", folder / "status.json"
    for old in (recording, status, *folder.glob("historian.sqlite*")):
        old.unlink(missing_ok=True)
    with software_plc(setting, recording) as plc, gateway(setting, plc.ready, status) as process:
        _wait_for_readings(status, process, folder)
        plc.command("start")
        plc.command("fault", fault={"kind": "refuse", "start": OUTAGE_AT * setting.seconds, "duration": OUTAGE_S})
        watch = _watch_live if console.is_terminal and not quiet else _watch_plainly
        watch(setting, plc, process, status, console if not quiet else Console(quiet=True))
    if process.returncode != 0:
        raise DemoError(f"the gateway ended with exit code {process.returncode}; {folder / 'gateway.out'} says why")
    return recording, historian


def _wait_for_readings(status: Path, process: "subprocess.Popen[bytes]", folder: Path) -> None:
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        seen = read_status(status)
        if seen is not None and seen["link"]["alive"]:
            return
        if process.poll() is not None:
            break
        time.sleep(0.02)
    raise DemoError(f"the gateway did not get a good reading; {folder / 'gateway.out'} says why")


def _account(plc: Plc, process: "subprocess.Popen[bytes]") -> dict[str, Any]:
    if process.poll() is not None:
        raise DemoError(f"the gateway ended early with exit code {process.returncode}")
    return plc.command("status")


def _phase(account: Mapping[str, Any], status: Mapping[str, Any]) -> str:
    if any(fault["in_force"] for fault in account["faults"]):
        return "OUTAGE: the PLC refuses its connections"
    return "running" if status["link"]["alive"] else "recovering"


def _watch_live(setting: Setting, plc: Plc, process: "subprocess.Popen[bytes]", status: Path, console: Console) -> None:
    with Live(console=console, refresh_per_second=8, transient=False) as screen:
        account = _account(plc, process)
        while not account["ended"]:
            seen = read_status(status)
            if seen is not None:
                screen.update(live_table(seen, account, setting.model.temperature, _phase(account, seen)))
            time.sleep(REFRESH_S)
            account = _account(plc, process)


def _watch_plainly(
    setting: Setting, plc: Plc, process: "subprocess.Popen[bytes]", status: Path, console: Console
) -> None:
    """Off a terminal: the table once for each phase, and at the end."""
    shown = ""
    account = _account(plc, process)
    while not account["ended"]:
        seen = read_status(status)
        if seen is not None and seen["prediction"] and (phase := _phase(account, seen)) != shown:
            console.print(live_table(seen, account, setting.model.temperature, phase))
            shown = phase
        time.sleep(REFRESH_S)
        account = _account(plc, process)
    if (seen := read_status(status)) is not None:
        console.print(live_table(seen, account, setting.model.temperature, "end of the trace"))
