"""The Debian package without its environment, which takes minutes to make: unit, scripts, control file, tree.

`make deb-test` installs the whole one under a real systemd.
"""

import hashlib
import re
import shlex
import shutil
import subprocess
from configparser import RawConfigParser
from ipaddress import ip_address, ip_network
from pathlib import Path

import pytest

from deploy import build_deb
from gateway.cli.main import main
from gateway.cli.top import EXITS
from gateway.console import SERVICE_FOLDER, SERVICE_LOG, SERVICE_RECORDS
from gateway.status import Health

DEPLOY = Path(__file__).parents[1] / "deploy"
UNIT = DEPLOY / "decanter.service"
SCRIPTS = [DEPLOY / "decanter.sh", *sorted((DEPLOY / "maintainer").iterdir())]
MOST_EXPOSED = 2.0


def unit() -> RawConfigParser:
    found = RawConfigParser(strict=False)  # SystemCallFilter and DeviceAllow stand there several times
    found.optionxform = str  # type: ignore[assignment,method-assign]
    found.read(UNIT)
    return found


def test_the_unit_may_do_little_by_systemds_own_measure() -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze (apt-get install systemd)")
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(UNIT)],
        capture_output=True,
        text=True,
        check=False,
    )
    if "Overall exposure" not in done.stdout:
        pytest.skip(f"this systemd cannot look at a file: {done.stderr.strip()[:200]}")
    (figure,) = re.findall(r"Overall exposure level for .*: ([\d.]+)", done.stdout)
    assert float(figure) <= MOST_EXPOSED


def test_the_unit_takes_no_more_than_its_share_and_reaches_the_plants_networks_alone() -> None:
    lines = UNIT.read_text(encoding="utf-8").splitlines()
    service = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    high, most = (int(service[key].removesuffix("%")) for key in ("MemoryHigh", "MemoryMax"))
    assert 50 <= high < most <= 90 and service["OOMPolicy"] == "continue"
    # Every recipient, sink and machine has threads of its own.
    assert 500 <= int(service["TasksMax"]) <= 2048 and service["IPAddressDeny"] == "any"
    allowed = [word for line in lines if line.startswith("IPAddressAllow=") for word in line.split("=")[1].split()]
    networks = [ip_network(word) for word in allowed if word[0].isdigit() or ":" in word]
    for place in ("10.1.2.3", "172.31.0.1", "192.168.200.10", "fd00::1"):
        assert any(ip_address(place) in network for network in networks), place
    for place in ("8.8.8.8", "172.32.0.1", "2001:4860:4860::8888"):
        assert not any(ip_address(place) in network for network in networks), place
    assert {"localhost", "link-local"} <= set(allowed)


def test_the_unit_is_told_when_it_is_ready_and_watches_and_never_gives_up() -> None:
    service, start = unit()["Service"], unit()["Unit"]
    assert (service["Type"], service["NotifyAccess"], service["Restart"]) == ("notify", "main", "always")
    assert float(service["WatchdogSec"]) == 60.0 and start["StartLimitIntervalSec"] == "0"
    assert (service["User"], service["CapabilityBoundingSet"], service["ProtectSystem"]) == ("decanter", "", "strict")


def test_the_unit_may_ask_for_the_clock() -> None:
    # The last line counts: @privileged, which is taken away before, has adjtimex in it.
    filters = [line for line in UNIT.read_text(encoding="utf-8").splitlines() if line.startswith("SystemCallFilter=")]
    assert filters[-1] == "SystemCallFilter=adjtimex clock_adjtime" and "ProtectClock" not in unit()["Service"]


def test_the_unit_speaks_of_what_is_there() -> None:
    for name in ("ExecStart", "ExecReload"):
        program, command, *options = shlex.split(unit()["Service"][name])
        assert program == f"/{build_deb.HOME}/bin/decanter"
        found = main.get_command(main.make_context("decanter", ["--help"], resilient_parsing=True), command)
        assert found is not None
        known = {option for parameter in found.params for option in parameter.opts}
        assert {option for option in options if option.startswith("--")} <= known
        assert options[-1] == str(SERVICE_FOLDER / "plant.toml") == unit()["Unit"]["ConditionPathExists"]
    service = unit()["Service"]
    assert Path("/var/lib") / service["StateDirectory"] == SERVICE_RECORDS
    assert Path("/var/log") / service["LogsDirectory"] == SERVICE_LOG


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_the_scripts_are_scripts_and_take_nothing_away(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert text.startswith("#!/bin/sh\n") and re.search(r"^set -eu?$", text, re.M)
    subprocess.run(["sh", "-n", str(script)], check=True)
    assert not re.search(r"\b(rm|rmdir|deluser|userdel|find)\b", text), "removal keeps what is the plant's"


SYSTEM = """#!/bin/sh
# Stands for systemd's and Debian's commands: says what it was asked for, and whether the service runs.
echo "${0##*/} $*" >> "$ASKED"
case "$*" in "is-active decanter.service") echo "$RUNS"; [ "$RUNS" = active ] ;; esac
"""


def script_after_prerm(
    folder: Path, runs: str, *arguments: str, prerm: str | None = "upgrade", system: bool = True
) -> list[str]:
    """What postinst asks the system for, after prerm, in a folder that stands for /, where the service `runs`."""
    run, commands, asked = folder / "run", folder / "commands", folder / "asked"
    (run / "systemd/system" if system else run).mkdir(parents=True)
    commands.mkdir()
    for name in ("systemctl", "deb-systemd-invoke", "deb-systemd-helper", "getent", "adduser", "install"):
        (commands / name).write_text(SYSTEM, encoding="utf-8")
        (commands / name).chmod(0o755)
    given = {"PATH": f"{commands}:/usr/bin:/bin", "ASKED": str(asked), "RUNS": runs}
    for name, words in (("prerm", () if prerm is None else (prerm,)), ("postinst", arguments)):
        if not words:
            continue
        text = (DEPLOY / "maintainer" / name).read_text(encoding="utf-8").replace("/run/", f"{run}/")
        asked.write_text("", encoding="utf-8")
        subprocess.run(["sh", "-c", text, name, *words], check=True, env=given, capture_output=True)
    return asked.read_text(encoding="utf-8").splitlines()


STARTED, STARTED_IF_ENABLED = "systemctl start decanter.service", "deb-systemd-invoke start decanter.service"


@pytest.mark.parametrize("state", ["active", "activating", "reloading"])
@pytest.mark.parametrize("words", [("configure", "0.1.0"), ("abort-upgrade", "0.2.0"), ("abort-remove",)])
def test_what_ran_before_an_upgrade_runs_after_it_even_where_the_upgrade_failed(
    tmp_path: Path, state: str, words: tuple[str, ...]
) -> None:
    # Enabled or not: it may have been started by hand.
    assert STARTED in script_after_prerm(tmp_path, state, *words)


@pytest.mark.parametrize(("state", "prerm"), [("inactive", "upgrade"), ("failed", "upgrade"), ("active", None)])
def test_what_did_not_run_or_is_new_is_started_unless_somebody_has_disabled_it(
    tmp_path: Path, state: str, prerm: str | None
) -> None:
    asked = script_after_prerm(tmp_path, state, "configure", prerm=prerm)
    assert STARTED_IF_ENABLED in asked and STARTED not in asked


def test_without_systemd_nothing_is_asked_of_it(tmp_path: Path) -> None:
    asked = script_after_prerm(tmp_path, "active", "configure", system=False)
    assert not [line for line in asked if line.startswith(("systemctl", "deb-systemd-invoke"))]


def small_environment(tree: Path, _work: Path) -> None:
    """Stands for the environment, which takes minutes to make."""
    start = tree / build_deb.HOME / "bin/decanter"
    start.parent.mkdir(parents=True)
    start.write_text("#!/bin/sh\n", encoding="utf-8")
    start.chmod(0o700)


@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="needs dpkg-deb (apt-get install dpkg)")
def test_the_package_has_what_it_promises_and_is_the_same_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build_deb, "fill_environment", small_environment)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    files = [build_deb.build(tmp_path / name, "1.2.3") for name in ("first", "second")]
    first, second = (hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
    assert first == second and files[0].name.startswith("decanter-gateway_1.2.3_")
    rows = subprocess.run(["dpkg-deb", "-c", files[0]], capture_output=True, text=True, check=True).stdout.splitlines()
    rights = {row.split()[5]: (row.split()[0], row.split()[1]) for row in rows}
    assert rights["./usr/bin/decanter"] == rights["./usr/lib/decanter/bin/decanter"] == ("-rwxr-xr-x", "root/root")
    assert rights["./lib/systemd/system/decanter.service"] == ("-rw-r--r--", "root/root")
    assert "./usr/share/doc/decanter-gateway/operations.md" in rights
    # What is the plant's is nobody's file but its own: no removal or upgrade touches it.
    assert not [name for name in rights if name.startswith(("./etc", "./var"))]
    said = subprocess.run(["dpkg-deb", "-f", files[0]], capture_output=True, text=True, check=True).stdout
    assert "Version: 1.2.3\n" in said and "Depends: python3.11," in said and "util-linux" in said


def test_the_container_is_given_up_for_what_the_gateways_exit_codes_say() -> None:
    text = (DEPLOY / "Dockerfile").read_text(encoding="utf-8")
    codes = {int(code) for code in re.findall(r"case \$\? in ([\d|]+)\) exit 1", text)[0].split("|")}
    assert codes == {int(EXITS[word][0]) for word in (Health.ABSENT, Health.SILENT)}
    assert "USER decanter" in text
