"""The Debian package on a Debian of its own: installed without a network, a newcomer's path to a forecast on the page,
the sandbox, the watchdog, upgrade, removal and reinstallation, under a real systemd.

A small Debian is made by debootstrap (once, in --root) and booted in namespaces of this machine, each time on a fresh
layer over it and with no network but its own loopback. It needs root, Linux namespaces and debootstrap's packages. What
a newcomer types is counted, with its seconds; everything else is what the package promises, checked.
"""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from benchmarks.figures import Figure, give
from benchmarks.first_hour import EXPORT, TEMPERATURE, given
from deploy.build_deb import build, version
from tests.rig.pair import ROOT

SUITE = "bookworm"
PACKAGES = "systemd,systemd-sysv,dbus,python3.11,adduser,procps"
NEEDED = ("debootstrap", "unshare", "nsenter", "dpkg-deb", "pivot_root", "ip")
PORT, PAGE_PORT = 15020, 8080
PATIENCE_S = 90.0
MOST_COMMANDS, MOST_S = 6, 600.0
WATCHDOG_S = 8.0
ELSEWHERE = "203.0.113.1"
"""Of a network for examples (RFC 5737): no plant's."""
KEPT = ("/etc/decanter", "/var/lib/decanter", "/var/log/decanter")
_BOOT = """
set -e
mount --make-rprivate /
mount -t tmpfs tmpfs $2
mkdir $2/upper $2/work $2/new
mount -t overlay overlay -o lowerdir=$1,upperdir=$2/upper,workdir=$2/work $2/new
R=$2/new
rm -f $R/usr/sbin/policy-rc.d
mount -t proc proc $R/proc
mount -t sysfs sysfs $R/sys
mount -t cgroup2 none $R/sys/fs/cgroup
mount -t tmpfs tmpfs $R/dev
for n in null zero full random urandom tty; do touch $R/dev/$n; mount --bind /dev/$n $R/dev/$n; done
mkdir -p $R/dev/shm $R/hand
ln -s /proc/self/fd $R/dev/fd
mount --bind $3 $R/hand
mount -t tmpfs tmpfs $R/run
ip link set lo up
cd $R
pivot_root . mnt
exec chroot . sh -c 'umount -l /mnt
    exec env -i container=other PATH=/usr/sbin:/usr/bin:/sbin:/bin /lib/systemd/systemd'
"""


class InstalledError(AssertionError):
    """Something that the package promises is not so; the message has what was said."""


@dataclass(slots=True)
class Box:
    """The booted Debian: the pid of its systemd, and what was typed in it with its seconds."""

    pid: int
    typed: list[tuple[str, float]] = field(default_factory=list)
    checks: list[str] = field(default_factory=list)

    def run(self, line: str, *, check: bool = True, timeout: float = MOST_S) -> str:
        """One command of root's, in /hand; its output. Raises InstalledError where it fails, unless not to `check`."""
        inside = ["nsenter", "-t", str(self.pid), "-m", "-p", "-u", "-i", "-n", "-C", "-r", "-w", "env", "-i"]
        inside += ["PATH=/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/root", "TERM=dumb", "sh", "-c", f"cd /hand; {line}"]
        done = subprocess.run(inside, capture_output=True, text=True, check=False, timeout=timeout)
        if check and done.returncode:
            raise InstalledError(f"{line}: exit code {done.returncode}; it said:\n{done.stdout}{done.stderr}")
        return done.stdout

    def type(self, line: str) -> str:
        """What a newcomer types."""
        begun = time.monotonic()
        printed = self.run(line)
        self.typed.append((line, time.monotonic() - begun))
        click.echo(f"{self.typed[-1][1]:6.1f} s  {line}", err=True)
        return printed

    def checked(self, what: str, fact: object, said: object = "") -> None:
        """Note what was found to be so. Raises InstalledError where it is not."""
        if not fact:
            raise InstalledError(f"not so: {what}; {said}\n{self.journal()}")
        self.checks.append(what)
        click.echo(f"   ok     {what}", err=True)

    def journal(self) -> str:
        """The newest lines of the service."""
        return self.run("journalctl -u decanter --no-pager -n 60", check=False)

    def until(self, what: str, seen: Callable[[], Any], seconds: float = PATIENCE_S) -> Any:
        """What is seen in the end, waited for. Raises InstalledError."""
        begun = time.monotonic()
        while not (found := seen()):
            if time.monotonic() - begun > seconds:
                raise InstalledError(f"not within {seconds:g} s: {what}\n{self.journal()}")
            time.sleep(0.25)
        return found

    def shown(self, name: str, service: str = "decanter") -> str:
        """What systemd knows of a service by this name."""
        return self.run(f"systemctl show {service} -p {name} --value", check=False).strip()

    def api(self, path: str) -> dict[str, Any]:
        """What the page is made of; {} while nothing answers."""
        reader = "import sys, urllib.request; print(urllib.request.urlopen(sys.argv[1], timeout=5).read().decode())"
        address = f"http://127.0.0.1:{PAGE_PORT}{path}"
        answer = self.run(f"python3.11 -c {shlex.quote(reader)} {shlex.quote(address)}", check=False)
        found: dict[str, Any] = json.loads(answer) if answer.strip() else {}
        return found


def make_root(root: Path) -> None:
    """A small Debian in the folder, unless there is one."""
    if (root / "lib/systemd/systemd").exists():
        return
    click.echo(f"debootstrap {SUITE} into {root}", err=True)
    root.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, root], check=True, capture_output=True
    )


@contextmanager
def booted(root: Path, hand: Path) -> Iterator[Box]:
    """Boot it, with the folder `hand` as /hand; nothing of it is left afterwards."""
    with tempfile.TemporaryDirectory(prefix="decanter-box-") as layer:
        command = [
            "unshare",
            "--mount",
            "--pid",
            "--fork",
            "--kill-child",
            "--uts",
            "--ipc",
            "--net",
            "--cgroup",
            "sh",
            "-c",
            _BOOT,
        ]
        outer = subprocess.Popen(
            [*command, "sh", root, layer, hand],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        try:
            children = Path(f"/proc/{outer.pid}/task/{outer.pid}/children")
            deadline = time.monotonic() + PATIENCE_S
            while True:
                pids = children.read_text(encoding="ascii").split() if outer.poll() is None else []
                if pids and Path(f"/proc/{pids[0]}/comm").read_text(encoding="ascii").strip() == "systemd":
                    box = Box(int(pids[0]))
                    if box.run("systemctl is-system-running", check=False).strip() in ("running", "degraded"):
                        break
                if outer.poll() is not None or time.monotonic() > deadline:
                    outer.kill()
                    complaint = outer.stderr.read().decode() if outer.stderr else ""
                    raise InstalledError(f"systemd cannot be booted in namespaces here: {complaint.strip()}")
                time.sleep(0.2)
            yield box
        finally:
            with suppress(ProcessLookupError):
                outer.send_signal(signal.SIGKILL)
            outer.wait()


@contextmanager
def plc(box: Box, hand: Path, warmest: float) -> Iterator[None]:
    """The software PLC, a program of this machine in the box's network: the plant's PLC is no part of the box."""
    command = [
        sys.executable,
        "-m",
        "decanter_gateway",
        "emulate",
        "--device",
        ROOT / "config/devices/decanter_plc.toml",
    ]
    command += ["--trace", hand / "plant.csv", "--offset", str(warmest - 600.0), "--port", str(PORT)]
    inside = ["nsenter", "-t", str(box.pid), "-n"]
    process = subprocess.Popen([*inside, *map(str, command)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        time.sleep(1.0)
        if process.poll() is not None:
            raise InstalledError(f"the software PLC does not run: {process.communicate()[1].decode()}")
        yield
    finally:
        process.terminate()
        process.wait()


def newcomer(box: Box, package: str) -> dict[str, Any]:
    """Everything that somebody types from a bare machine to a forecast on the page; the plant as the page has it."""
    renames = " ".join(f"--rename '{header}={name}'" for header, name in list(EXPORT.items())[:2])
    box.type(f"dpkg -i {package}")
    box.type(
        f"decanter init /etc/decanter --device decanter_plc --host 127.0.0.1:{PORT} "
        f"--temperature {TEMPERATURE} --trace /hand/export.csv {renames}"
    )
    learned = "--map /etc/decanter/columns.toml --out /etc/decanter/models/first"
    box.type(f"decanter model learn --traces /hand/export.csv {learned}")
    box.type("decanter plc bind --config /etc/decanter/plant.toml --keep model.path=models/first")
    box.type("systemctl restart decanter")
    begun = time.monotonic()
    plant: dict[str, Any] = box.until("a forecast on the page", lambda: _forecast(box.api("/api/plant")))
    box.typed.append((f"a browser: http://127.0.0.1:{PAGE_PORT}", time.monotonic() - begun))
    return plant


def _forecast(plant: dict[str, Any]) -> dict[str, Any]:
    """The plant's page once a sentence of it foresees something; {} before."""
    rows = [row for machine in plant.get("machines", {}).values() for row in machine["temperatures"]]
    return plant if any(row["valid"] != "none" for row in rows) else {}


def service(box: Box) -> None:
    """What the unit promises: sandbox and watchdog."""
    line = box.run("systemd-analyze security --no-pager decanter").strip().splitlines()[-1]
    exposure = float(re.findall(r": (\d[\d.]*)", line)[0])
    box.checked(f"systemd-analyze security: {exposure}, 2.0 or better", exposure <= 2.0, line)
    box.checked("it runs as its own user", box.run("ps -o user= -p " + box.shown("MainPID")).strip() == "decanter")
    status = json.loads(box.run("decanter top --once --json", check=False))["status"]
    box.checked(
        "the kernel tells it in its sandbox whether the clock is steered", status["clock"]["synchronised"] is not None
    )
    now, machine = time.time(), next(iter(box.api("/api/plant")["machines"]))
    asked = f"machine={machine}&tag={TEMPERATURE}&start={now - 600:.0f}&end={now:.0f}"
    trend = box.api(f"/api/trend?{asked}")
    box.checked("the page draws what was recorded", bool(trend), trend)
    listening = box.run("cat /proc/net/tcp /proc/net/tcp6")
    open_ports = {
        row.split()[1].rpartition(":")[0]
        for row in listening.splitlines()
        if len(row.split()) > 3 and row.split()[3] == "0A"
    }
    box.checked("nothing listens beyond loopback", open_ports <= {"0100007F", "0" * 24 + "01000000"}, open_ports)
    lines = f"[Service]\\nWatchdogSec={WATCHDOG_S:g}\\nRestartSec=1\\n"
    folder = "/etc/systemd/system/decanter.service.d"
    box.run(f"mkdir -p {folder}; printf '{lines}' > {folder}/quick.conf; systemctl daemon-reload")
    box.run("systemctl restart decanter")
    before = box.shown("MainPID")
    time.sleep(2 * WATCHDOG_S)
    box.checked(f"a gateway that scans outlives its watchdog of {WATCHDOG_S:g} s", box.shown("MainPID") == before)
    begun = time.monotonic()
    box.run(f"kill -STOP {before}")
    box.until(
        "a gateway that hangs is started anew",
        lambda: box.shown("NRestarts") != "0" and box.shown("ActiveState") == "active",
    )
    box.checked(
        f"one that hangs is started anew: after {time.monotonic() - begun:.0f} s", box.shown("MainPID") != before
    )
    box.checked("the watchdog has done it", "watchdog" in box.journal().lower())
    plant = "/etc/decanter/plant.toml"
    subprocess.run(
        ["nsenter", "-t", str(box.pid), "-n", "ip", "addr", "add", f"{ELSEWHERE}/32", "dev", "lo"], check=True
    )
    box.run(f"cp {plant} /hand/plant.here.toml; sed -i 's/^host = .*/host = \"{ELSEWHERE}\"/' {plant}")
    box.run("systemctl restart decanter")
    reached = box.until("an address elsewhere is tried", lambda: _link(box).get("reason"))
    box.checked("an address that is not the plant's is out of reach", "no connection within" in reached, reached)
    box.run(f"cp /hand/plant.here.toml {plant}; systemctl restart decanter")


def _link(box: Box) -> dict[str, Any]:
    """The link of a running gateway; {} before it answers."""
    found = json.loads(box.run("decanter top --once --json", check=False) or "{}")
    link: dict[str, Any] = found.get("status", {}).get("link", {})
    return link


def groups(box: Box) -> None:
    """A second group of machines as a service of its own: both scan, and one that is killed costs the other nothing."""
    other = "decanter@second"
    folder = "/etc/decanter/second"
    box.run(f"decanter init {folder} --device decanter_plc --host 127.0.0.1:{PORT + 1}")
    box.run(f"systemctl enable --now {other}")
    box.until("the group scans", lambda: "scanned" in box.shown("StatusText", other))
    exposure = float(re.findall(r": (\d[\d.]*)", box.run(f"systemd-analyze security --no-pager {other}"))[-1])
    box.checked(f"systemd-analyze security of a group: {exposure}, 2.0 or better", exposure <= 2.0)
    box.checked("its records are its own", box.run("ls /var/lib/decanter/second/historian.sqlite"))
    box.checked("all groups share one bound", box.shown("Slice", other) == "system-decanter.slice")
    before, killed = box.shown("MainPID"), box.shown("MainPID", other)
    box.run(f"kill -KILL {killed}")
    box.until(
        "it is begun anew", lambda: box.shown("NRestarts", other) != "0" and box.shown("ActiveState", other) == "active"
    )
    box.checked("a group that dies is begun anew, and the other service stays", box.shown("MainPID") == before)


_STARTS = """
import sqlite3
line = sqlite3.connect("file:/var/lib/decanter/historian.sqlite?mode=ro", uri=True)
print(line.execute("SELECT count(*) FROM runs").fetchone()[0])
"""


def life(box: Box, package: str, newer: str, broken: str) -> None:
    """Upgrade, removal, reinstallation, purge: all that is the plant's stays."""

    def starts() -> int:
        return int(box.run(f"python3.11 -c {shlex.quote(_STARTS)}"))

    def files() -> str:
        stop = "systemctl stop decanter 'decanter@*' 2>/dev/null"
        return box.run(f"{stop}; find {' '.join(KEPT)} -type f | sort | xargs sha256sum; id decanter")

    def runs() -> bool:
        found = json.loads(box.run("decanter top --once --json", check=False) or "{}")
        return box.shown("ActiveState") == "active" and bool(found.get("status"))

    before = starts()
    box.run("systemctl disable decanter")
    box.run(f"dpkg -i {newer}")
    box.until("it runs after the upgrade, though it is disabled at boot", runs)
    box.checked("upgraded: it runs, and goes on in the same records", starts() > before)
    box.until("the group runs after the upgrade", lambda: box.shown("ActiveState", "decanter@second") == "active")
    before = starts()
    refused = box.run(f"dpkg -i {broken}; systemctl enable decanter", check=False)
    box.until("it runs after an upgrade that failed", runs)
    box.checked("an upgrade that fails leaves it running", starts() > before, refused)
    kept = json.loads(box.run("decanter keep history --json"))["configurations"]
    box.checked(f"{len(kept)} configurations that it took over are kept", len(kept) > 1)
    box.run("decanter keep support /var/lib/decanter/support.zip")
    before, stays = starts(), files()
    box.run("dpkg -r decanter-gateway")
    gone = not box.run("pgrep -u decanter", check=False) and not box.run("ls /usr/lib/decanter", check=False)
    box.checked("removed: nothing runs, and no program is left", gone)
    box.checked(
        f"removed: {len(stays.splitlines()) - 1} files of the plant and its user stay as they are", files() == stays
    )
    box.run(f"dpkg -i {package}")
    box.until("it runs after the reinstallation", runs)
    box.checked("reinstalled, the older version: it runs, and goes on in the same records", starts() > before)
    stays = files()
    box.run("dpkg -P decanter-gateway")
    box.checked("purged: the plant's files and its user stay all the same", files() == stays)


def newer_package(package: Path, folder: Path, name: str, preinst: str = "") -> Path:
    """The same program as a package of a higher version, whose first script this is; gives its file, `name`.deb."""
    tree = folder / name
    subprocess.run(["dpkg-deb", "-R", package, tree], check=True)
    control = tree / "DEBIAN/control"
    control.write_text(re.sub(r"^Version: (.*)$", r"Version: \1+1", control.read_text(), flags=re.M), encoding="utf-8")
    if preinst:
        (tree / "DEBIAN/preinst").write_text(f"#!/bin/sh\n{preinst}\n", encoding="utf-8")
        (tree / "DEBIAN/preinst").chmod(0o755)
    file = folder / f"{name}.deb"
    subprocess.run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", tree, file], check=True, capture_output=True)
    shutil.rmtree(tree)
    return file


@click.command(help=__doc__)
@click.option(
    "--root",
    type=click.Path(path_type=Path),
    default=Path("out/debian"),
    show_default=True,
    help="The small Debian; made where there is none.",
)
@click.option(
    "--package", type=click.Path(path_type=Path, exists=True), help="A package that is there; else one is built."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(root: Path, package: Path | None, as_json: bool) -> None:
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        raise click.ClickException(f"needs root and {', '.join(missing) or 'nothing else'}")
    with tempfile.TemporaryDirectory(prefix="decanter-hand-") as name:
        hand = Path(name)
        hand.chmod(0o755)
        make_root(root.absolute())
        file = package or build(Path("dist").absolute(), version())
        shutil.copyfile(file, hand / file.name)
        newer_package(file, hand, "newer")
        newer_package(file, hand, "broken", "exit 1")
        warmest = given(hand)
        for path in hand.iterdir():
            path.chmod(0o644)
        with booted(root.absolute(), hand) as box, plc(box, hand, warmest):
            begun = time.monotonic()
            newcomer(box, f"/hand/{file.name}")
            service(box)
            groups(box)
            life(box, f"/hand/{file.name}", "/hand/newer.deb", "/hand/broken.deb")
            took = time.monotonic() - begun
    for line, seconds in box.typed:
        click.echo(f"{seconds:7.1f} s  {line}", err=as_json)
    for what in box.checks:
        click.echo(f"    ok     {what}", err=as_json)
    figures = [
        Figure("commands", float(len(box.typed)), "commands", "the target", float(MOST_COMMANDS)),
        Figure("waiting", sum(seconds for _, seconds in box.typed), "s", "the target", MOST_S),
        Figure("package", file.stat().st_size / 1e6, "MB"),
        Figure("checks", float(len(box.checks)), "checks"),
        Figure("all of it", took, "s"),
    ]
    give("installed", figures, as_json=as_json)


if __name__ == "__main__":
    main()
