"""The Debian package without its environment, which takes minutes to make: unit, scripts, control file, tree.

`make deb-test` installs the whole one under a real systemd.
"""

import hashlib
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from configparser import RawConfigParser
from ipaddress import ip_address, ip_network
from pathlib import Path

import pytest
from click.testing import CliRunner

from deploy import build_deb
from gateway.cli.main import main
from gateway.cli.plant.commands import EXITS
from gateway.console import SERVICE_FOLDER, find_service
from gateway.outside.status import Health
from gateway.settings import load_config

DEPLOY = Path(__file__).parents[1] / "deploy"
UNIT, TEMPLATE = DEPLOY / "decanter.service", DEPLOY / "decanter@.service"
SCRIPTS = [DEPLOY / "decanter.sh", *sorted((DEPLOY / "maintainer").iterdir())]
MOST_EXPOSED = 2.0


def unit(path: Path = UNIT) -> RawConfigParser:
    found = RawConfigParser(strict=False)  # SystemCallFilter and DeviceAllow stand there several times
    found.optionxform = str  # type: ignore[assignment,method-assign]
    found.read(path)
    return found


def of_group(folder: Path, group: str = "north") -> Path:
    """The unit of a group of machines, as systemd makes it of the template."""
    path = folder / f"decanter@{group}.service"
    path.write_text(TEMPLATE.read_text(encoding="utf-8").replace("%i", group), encoding="utf-8")
    return path


@pytest.mark.parametrize("of", [lambda _: UNIT, of_group], ids=["plain", "of a group"])
def test_the_unit_may_do_little_by_systemds_own_measure(of: Callable[[Path], Path], tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze (apt-get install systemd)")
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(of(tmp_path))],
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
    # The last lines count: @privileged, which is taken away before, has adjtimex in it.
    filters = [line for line in UNIT.read_text(encoding="utf-8").splitlines() if line.startswith("SystemCallFilter=")]
    assert filters[-2:] == ["SystemCallFilter=adjtimex clock_adjtime", "SystemCallFilter=setpriority"]
    assert "ProtectClock" not in unit()["Service"]


def test_the_unit_speaks_of_what_is_there() -> None:
    for name in ("ExecStart", "ExecReload"):
        program, command, *options = shlex.split(unit()["Service"][name])
        assert program == f"/{build_deb.HOME}/bin/decanter"
        found = main.get_command(main.make_context("decanter", ["--help"], resilient_parsing=True), command)
        assert found is not None
        known = {option for parameter in found.params for option in parameter.opts}
        assert {option for option in options if option.startswith("--")} <= known
        assert options[-1] == str(SERVICE_FOLDER / "plant.toml") == unit()["Unit"]["ConditionPathExists"]


def test_records_and_log_lie_where_the_commands_look_for_them(tmp_path: Path) -> None:
    for path, folder in ((UNIT, SERVICE_FOLDER), (of_group(tmp_path), SERVICE_FOLDER / "north")):
        service, places = unit(path)["Service"], find_service(folder)
        assert places is not None and f"{places.unit}.service" == path.name
        assert Path("/var/lib") / service["StateDirectory"] == Path(service["WorkingDirectory"]) == places.records
        assert Path("/var/log") / service["LogsDirectory"] == places.log
    for folder in (tmp_path, SERVICE_FOLDER / "a group", SERVICE_FOLDER / "north/models"):
        assert find_service(folder) is None


def test_a_group_has_a_plant_with_its_own_places_and_is_told_its_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.console.places.SERVICE_FOLDER", tmp_path)
    command = ["init", "--device", "decanter_plc", "--host", "127.0.0.1"]
    for folder, unit, page in ((tmp_path, "restart decanter", True), (tmp_path / "north", "decanter@north", False)):
        done = CliRunner().invoke(main, [*command, str(folder)])
        assert done.exit_code == 0 and unit in done.output, done.output
        config = load_config(folder / "plant.toml")
        place = Path("/var/lib/decanter", *folder.relative_to(tmp_path).parts)
        assert config.historian.path.parent == place and config.page.enabled is page


def test_the_service_of_a_group_is_the_plain_one_in_folders_of_its_own_and_all_share_one_bound() -> None:
    plain, template = (
        [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith(("#", "Description"))]
        for path in (UNIT, TEMPLATE)
    )
    bounds = [line for line in plain if line.startswith(("MemoryHigh", "MemoryMax", "CPUWeight", "IOWeight"))]
    assert [line.replace("/%i", "") for line in template] == [line for line in plain if line not in bounds]
    own = [line for line in template if re.search(r"(/etc|/var/lib)/decanter|Directory=decanter", line)]
    assert own and all("decanter/%i" in line for line in own), "no group writes where another one does"
    common = (DEPLOY / "system-decanter.slice").read_text(encoding="utf-8").splitlines()
    assert len(bounds) == 4 and set(bounds) <= set(common)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_the_scripts_are_scripts_and_take_nothing_away(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert text.startswith("#!/bin/sh\n") and re.search(r"^set -eu?$", text, re.M)
    subprocess.run(["sh", "-n", str(script)], check=True)
    assert not re.search(r"\b(rm|rmdir|deluser|userdel|find)\b", text), "removal keeps what is the plant's"


SYSTEM = """#!/bin/sh
# Stands for systemd's and Debian's commands: says what it was asked for, and whether the service runs.
echo "${0##*/} $*" >> "$ASKED"
case "$*" in
    "is-active decanter.service") echo "$RUNS"; [ "$RUNS" = active ] ;;
    list-units*) for name in $GROUPS_RUNNING; do echo "decanter@$name.service loaded active running Gateway"; done ;;
esac
"""


def script_after_prerm(
    folder: Path, runs: str, *arguments: str, prerm: str | None = "upgrade", system: bool = True, groups: str = ""
) -> list[str]:
    """What postinst asks the system for, after prerm, in a folder that stands for /, where the service `runs`, and
    those of these `groups`."""
    run, commands, asked = folder / "run", folder / "commands", folder / "asked"
    (run / "systemd/system" if system else run).mkdir(parents=True, exist_ok=True)
    commands.mkdir(exist_ok=True)
    for name in ("systemctl", "deb-systemd-invoke", "deb-systemd-helper", "getent", "adduser", "install"):
        (commands / name).write_text(SYSTEM, encoding="utf-8")
        (commands / name).chmod(0o755)
    given = {"PATH": f"{commands}:/usr/bin:/bin", "ASKED": str(asked), "RUNS": runs, "GROUPS_RUNNING": groups}
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


def test_the_groups_that_ran_before_an_upgrade_are_stopped_and_run_after_it_and_no_other(tmp_path: Path) -> None:
    asked = script_after_prerm(tmp_path, "inactive", groups="north south")
    assert asked[-1].split()[1:] == ["stop", "decanter.service", "decanter@north.service", "decanter@south.service"]
    asked = script_after_prerm(tmp_path, "inactive", "configure", prerm=None)
    assert [line for line in asked if "decanter@" in line] == [
        "systemctl start decanter@north.service", "systemctl start decanter@south.service",
    ]  # fmt: skip
    asked = script_after_prerm(tmp_path, "inactive", "configure", prerm=None)
    assert not [line for line in asked if "decanter@" in line]


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
    for name in ("decanter.service", "decanter@.service", "system-decanter.slice"):
        assert rights[f"./lib/systemd/system/{name}"] == ("-rw-r--r--", "root/root")
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
