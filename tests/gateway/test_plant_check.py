"""One judge of a plant file: no command says "in order" of what a start refuses or goes without, or of a limit that
warns of nothing."""

import asyncio
import json
import os
import shutil
import socket
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.settings import ConfigError
from gateway.cli.main import main
from gateway.machine.model.outlook import Outlook
from gateway.machine.model.predict import Predictor
from gateway.outside.status import findings, judge_health, read_status
from gateway.plant import check_plant
from gateway.plant.app import run
from gateway.settings import load_plant
from tests.gateway.support import (
    CURRENT,
    EPOCH,
    MAP,
    RUNNING,
    TEMPERATURE,
    Bench,
    PacedClock,
    config_in,
    plant_file,
    two_modes,
)
from tests.sha.test_calibration import fan

AUDIT = ("writeback.audit", "writeback.audit_key", "writeback.audit_heads")
WRITTEN = ("historian.path", *AUDIT, "log.path", "page.users")
READ = ("plant.toml", "plc.toml", "model.json")


def at(key: str, value: object) -> str:
    """A table with one key of the plant file."""
    section, name = key.rsplit(".", 1)
    return f"[{section}]\n{name} = {json.dumps(value)}\n"


def in_folder(folder: Path, text: str, *, model: bool = True) -> Path:
    """A plant file with a device file of its own, and a model."""
    shutil.copyfile(MAP, folder / "plc.toml")
    (folder / "notes.txt").write_text("notes\n", encoding="utf-8")
    (folder / "folder").mkdir()
    return plant_file(folder, text, model=two_modes() if model else None, device=Path("plc.toml"))


def found(path: Path) -> dict[str, str]:
    """What the judge finds, by its part."""
    return {finding.part: finding.sentence for finding in check_plant(load_plant(path))}


def test_a_plant_file_that_is_in_order_has_no_findings(tmp_path: Path) -> None:
    assert found(in_folder(tmp_path, "")) == {}


@pytest.mark.parametrize("key", WRITTEN)
def test_no_written_file_is_one_that_is_read_or_written_as_another(tmp_path: Path, key: str) -> None:
    """Records in a plant file would set it aside as a damaged database; a log in a device file would spoil it."""
    for place, other in enumerate((*READ, *(name for name in WRITTEN if name != key))):
        folder = tmp_path / str(place)
        folder.mkdir()
        named = other if other in READ else "same"
        text = at(key, named) + (at(other, named) if other not in READ else "")
        if key in AUDIT and other in AUDIT:
            text = f'[writeback]\n{key.split(".")[1]} = "same"\n{other.split(".")[1]} = "same"\n'
        with pytest.raises(ConfigError, match=r"is the file of .* too; give each a path of its own"):
            load_plant(in_folder(folder, text))


@pytest.mark.parametrize("key", WRITTEN[:-1])
def test_a_folder_is_no_file_to_write_and_is_left_as_it_is(tmp_path: Path, key: str) -> None:
    path = in_folder(tmp_path, at(key, "folder"))
    assert "is a folder" in found(path)["records"]


BROKEN: dict[str, tuple[str, str, str]] = {
    "a historian that is a text": (at("historian.path", "notes.txt"), "records", "is no database"),
    "an audit log that is a text": (at("writeback.audit", "notes.txt"), "records", "is no database"),
    "a key that is a text": (at("writeback.audit_key", "notes.txt"), "records", "notes.txt has mode"),
    "a file beneath a file": (at("log.path", "notes.txt/log"), "records", "is no folder"),
    "a socket that is a text": (at("control.path", "notes.txt"), "records", "is no socket"),
    "accounts that are a text": (
        '[page]\nenabled = true\nport = 0\nusers = "notes.txt"\n',
        "page",
        "invalid JSON",
    ),
    "an address of another computer": (
        '[northbound.metrics]\nport = 15\nhost = "203.0.113.5"\n',
        "ports",
        "cannot listen at 203.0.113.5:15",
    ),
    "rarer scans than the model holds": (at("scan.period", 60), "model", "would never foresee"),
    "secrets that are not there": (
        '[notify]\nsecrets = "none.toml"\n[[notify.to]]\nname = "x"\nwebhook = "http://127.0.0.1:9/"\n',
        "messages",
        "none.toml",
    ),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_a_start_goes_without_is_found_and_said_by_every_command(tmp_path: Path, what: str) -> None:
    text, part, words = BROKEN[what]
    path = in_folder(tmp_path, text)
    judged = found(path)
    assert list(judged) == [part] and words in judged[part]
    checked = CliRunner().invoke(main, ["plc", "check", "--offline", "--config", str(path)])
    assert checked.exit_code == 1 and judged[part] in checked.output and words in checked.stderr
    bound = CliRunner().invoke(main, ["plc", "bind", "--keep", "log.level=info", "--config", str(path)])
    assert judged[part] in bound.output and "in order" not in bound.output and "written: " in bound.output
    added = CliRunner().invoke(main, ["machine", "add", "second", "--unit", "7", "--config", str(path)])
    assert judged[part] in added.output, added.output


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_place_that_this_user_may_not_write_is_found(tmp_path: Path) -> None:
    path = in_folder(tmp_path, at("historian.path", "folder/history.sqlite"))
    (tmp_path / "folder").chmod(0o500)
    assert "may not write" in found(path)["records"]


def test_a_port_that_somebody_has_or_that_two_servers_want_is_found(tmp_path: Path) -> None:
    with closing(socket.socket()) as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert "already in use" in found(in_folder(tmp_path, at("serve.port", port)))["ports"]
    twice = tmp_path / "twice"
    twice.mkdir()
    text = f'[serve]\nport = {port}\nhost = "localhost"\n[northbound.metrics]\nport = {port}\n'
    assert "northbound.metrics.port: cannot listen" in found(in_folder(twice, text))["ports"]
    apart = tmp_path / "apart"
    apart.mkdir()
    text = f'[serve]\nport = {port}\nhost = "127.0.0.2"\n[northbound.metrics]\nport = {port}\n'
    assert found(in_folder(apart, text)) == {}


@pytest.mark.parametrize(
    ("limit", "deadband", "words"),
    [
        (8.0, 2.0, "lies below all that the model leads to (20 to 50): it always stands"),
        (149.0, 2.0, "never comes within reach: the model leads to 20 to 50"),
        (800.0, 2.0, "can never be passed: the device file takes readings above 150 for wrong"),
        (-30.0, 2.0, "is passed by every reading: the device file takes those below -20 for wrong"),
        (60.0, 45.0, "has a deadband of 45: below 20 the model never leads"),
    ],
)
def test_a_limit_that_warns_of_nothing_or_always_is_asked_about_by_check_and_by_a_start(
    tmp_path: Path, limit: float, deadband: float, words: str
) -> None:
    path = in_folder(tmp_path, f"[alarms]\nlimit = {limit}\ndeadband = {deadband}\n")
    (config,) = load_plant(path)
    doubts = [finding for finding in check_plant([config]) if finding.part == "limits"]
    assert any(words in finding.sentence for finding in doubts) and not any(finding.grave for finding in doubts)
    assert words in CliRunner().invoke(main, ["plc", "check", "--offline", "--config", str(path)]).output
    near = replace(config, alarms=config.alarms.model_copy(update={"limit": 55.0, "deadband": 2.0}))
    assert check_plant([near]) == ()


def test_of_rare_scans_a_forecast_holds_until_the_next_one(tmp_path: Path) -> None:
    """Forecasts of 10 s held for 30 s: with a scan a minute none was ever usable, and the gateway was "well"."""
    config = config_in(tmp_path, model=two_modes(gap=300.0))
    made = Outlook(Predictor(two_modes(), TEMPERATURE), config.forecast, 80.0, scan_period=60.0)
    made.latest = fan(EPOCH, 50.0, 1.0)
    assert made.fresh(EPOCH + 60.0) is made.latest and made.fresh(EPOCH + 181.0) is None


async def test_that_no_usable_forecast_comes_is_an_alarm_a_finding_with_its_cause_and_not_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Outlook, "begin", lambda *_, **__: None)
    config = config_in(tmp_path, model=two_modes(), forecast__runs=50)
    bench = Bench(config, PacedClock(pause_s=0.002), stop_after=120)
    bench.plan[2] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 26.0}
    plain = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    status = read_status(plain)
    assert plain["alarms"]["no forecast"] == "unacknowledged"
    assert str(judge_health(status)) == "attention"
    (model,) = [finding.sentence for finding in findings(status) if finding.check == "model"]
    assert model == "nothing is foreseen: no forecast has been finished yet"
