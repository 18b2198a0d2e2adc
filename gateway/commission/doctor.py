"""`decanter plc check computer`: is this machine fit for the plant? Nothing is sent to any device."""

import asyncio
import os
import shutil
import time
from contextlib import closing
from math import isinf
from pathlib import Path
from typing import Any

from serial.tools.list_ports import comports

from drivers.driver import Cautions
from drivers.errors import LinkDown
from gateway.clock_sync import clock_error
from gateway.commission.options import SharedOptions
from gateway.commission.session import (
    CheckStep,
    RecordsError,
    Site,
    Target,
    conclude_steps,
    failed_step,
    find_break,
    find_target,
    ok,
    perform,
    running_gateway,
    step_lines,
    versions,
    warning,
)
from gateway.commission.survey import local_end, resolve_host
from gateway.console import CommandResult
from gateway.entry import sentences

LEAST_FREE_MB = 500
OLDEST_TIME_S = 1_735_689_600.0
"""2025-01-01: a clock before it was never set."""
_ARPHRD_CAN = "280"
"""What /sys/class/net/NAME/type says of a CAN interface (linux/if_arp.h)."""
_NET = Path("/sys/class/net")


async def examine_machine(site: Site, records: Path) -> CommandResult:
    """All checks of this machine, and of what the command's options name."""
    target, installed = site.target, versions()
    steps = [ok("software", ", ".join(f"{name} {number}" for name, number in installed.items()))]
    # The clock: every record and every comparison with the HMI has its time.
    now, error = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()), clock_error()
    if time.time() < OLDEST_TIME_S:
        sentence = f"it is {now} by this machine's clock, which was never set: set it before anything else"
        steps.append(failed_step("clock", sentence))
    elif error is None or isinf(error):
        sentence = f"{now}, and no time server steers this clock: compare it with the HMI's, and set up NTP"
        steps.append(warning("clock", sentence))
    else:
        steps.append(ok("clock", f"{now}, steered by a time server, wrong by {1e3 * error:.0f} ms at most"))
    links = [path for path in sorted(_NET.glob("*")) if path.name != "lo" and _word(path / "type") != _ARPHRD_CAN]
    up = [path.name for path in links if _word(path / "operstate") == "up"]
    down = [path.name for path in links if path.name not in up]
    sentence = f"up: {', '.join(up) or 'none'}" + (f"; not up: {', '.join(down)}" if down else "")
    network = ok("network", sentence) if up else warning("network", f"no network interface is up ({sentence})")
    steps.append(network)
    # The folder of the records may not be there yet: what counts is the disk that it will be on.
    folder = records.parent.absolute()
    place = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(place).free / 1e6
    sentence = f"{free:,.0f} MB free at {place}"
    enough = free >= LEAST_FREE_MB
    steps.append(
        ok("disk", sentence) if enough else failed_step("disk", f"only {sentence}: records and history need room")
    )
    if not records.is_file() or not records.stat().st_size:
        steps.append(ok("records", f"{records}: begins with this command"))
    else:
        try:
            line = find_break(records)
        except RecordsError as broken:
            steps.append(failed_step("records", str(broken)))
        else:
            changed = f"{records}: line {line} does not follow the one before it: the file was changed"
            steps.append(ok("records", f"{records}: unbroken") if line is None else failed_step("records", changed))
    steps.append(_can(target))
    steps += await asyncio.to_thread(_serial_ports, target)
    if "host" in target.settings:
        # The way to the device, without asking it anything.
        host = str(target.settings["host"])
        try:
            address = (await resolve_host(host))[0]
            steps.append(ok("way", f"{host} is {address}, reached from {local_end(address)}"))
        except (OSError, UnicodeError) as unreachable:
            sentence = (
                f"there is no way from here to {host!r} ({unreachable}): check the name, the address and the network"
            )
            steps.append(failed_step("way", sentence, LinkDown(sentence)))
    steps += _files(target)
    return conclude_steps(steps, versions=installed)


def _can(target: Target) -> CheckStep:
    interfaces = [path.name for path in sorted(_NET.glob("*")) if _word(path / "type") == _ARPHRD_CAN]
    # Drivers without a carrier, as vcan, stay "unknown" when they are up.
    up = [name for name in interfaces if _word(_NET / name / "operstate") in ("up", "unknown")]
    wanted = str(target.settings.get("channel", ""))
    if target.medium != "can" or target.settings.get("interface", "socketcan") != "socketcan":
        return ok("can", f"interfaces of the kernel: {', '.join(interfaces) or 'none'}")
    if wanted not in interfaces:
        return failed_step(
            "can", f"there is no CAN interface {wanted!r} here (there are: {', '.join(interfaces) or 'none'})"
        )
    if wanted not in up:
        return failed_step("can", f"{wanted} is down: ip link set {wanted} up type can bitrate ...")
    return ok("can", f"{wanted} is up")


def _serial_ports(target: Target) -> list[CheckStep]:
    ports = sorted(port.device for port in comports())
    wanted = str(target.settings.get("serial", ""))
    if not wanted:
        return [ok("serial", f"ports: {', '.join(ports) or 'none'}")]
    if not Path(wanted).exists():
        return [
            failed_step("serial", f"there is no {wanted} here (there are: {', '.join(ports) or 'none'}): plugged in?")
        ]
    if not os.access(wanted, os.R_OK | os.W_OK):
        return [
            failed_step("serial", f"this user may not open {wanted}: add it to the port's group (dialout), log in anew")
        ]
    return [ok("serial", f"{wanted} is there and may be opened")]


def _files(target: Target) -> list[CheckStep]:
    """The plant file or device file (which could be read, or this would not run), certificates, a running gateway."""
    steps: list[CheckStep] = []
    if target.map is not None:
        names = ", ".join(map(str, target.files))
        steps.append(ok("files", f"{names}: {len(target.tags)} tags of driver {target.driver}"))
    if target.driver and target.capabilities.certificates:
        driver: Any = target.make_driver()
        steps += (
            [warning("certificates", sentence) for sentence in driver.cautions()]
            if isinstance(driver, Cautions)
            else []
        )
    line = running_gateway(target)
    if line is not None:
        with closing(line):
            sentence = f"one runs with this plant file (pid {line.ask('status')['pid']}): read and watch go through it"
            steps.append(ok("gateway", sentence))
    return steps


def _word(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""


def doctor(given: SharedOptions) -> None:
    """Carry out `decanter plc check computer`; its options and its help are in commission/commands.py."""
    with sentences():
        anything = given.plant or given.device or given.link or given.settings
        target = find_target(given) if anything else Target("this machine", "", {})
    perform(given, "doctor", {}, lambda site: examine_machine(site, given.records), step_lines, target=target)
