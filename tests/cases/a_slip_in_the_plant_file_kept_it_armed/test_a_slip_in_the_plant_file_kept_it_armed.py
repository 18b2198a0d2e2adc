"""A plant file that cannot be used any more keeps nobody from disarming, nor from seeing how the gateway is.

A slip while editing made `plc disarm`, `status` and `alarm list` refuse the file before they had looked for the gateway
that runs by what it was; and a `historian.path` changed in it had `reload` say that no gateway runs.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.settings import gateway_places
from gateway.store.audit import read
from tests.cli.support import decanter
from tests.plc.bench import DECANTER, PATIENCE_S, ROOT, running, wait_until

SLIPS = {
    "an unclosed table": lambda text: text.replace("[scan]", "[scan"),
    "a key without a value": lambda text: text.replace("period = 1.0", "period ="),
    "an unclosed text at the end": lambda text: text + '\n[alarms]\nlimit = "80\n',
    "three quotes": lambda text: text + '\nnote = """\n',
    "an unknown key": lambda text: text.replace("period = 1.0", "perod = 1.0"),
    "a device file that is not there": lambda text: text.replace(DECANTER.name, "other.toml"),
}


def plant_file(folder: Path, port: int = 1502) -> Path:
    shutil.copy(DECANTER, folder / DECANTER.name)
    path = folder / "plant.toml"
    path.write_text(
        f"""[device]
file = "{DECANTER.name}"
port = {port}

[historian]
path = "records/historian.sqlite"

[writeback]
mode = "shadow"

[scan]
period = 1.0
""",
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("slip", SLIPS)
def test_the_places_of_a_spoiled_file_are_those_of_the_whole_one(tmp_path: Path, slip: str) -> None:
    path = plant_file(tmp_path)
    whole = gateway_places(path)
    path.write_text(SLIPS[slip](path.read_text(encoding="utf-8")), encoding="utf-8")
    spoiled = gateway_places(path)
    assert whole.problem is None and spoiled.problem is not None
    assert (spoiled.socket, spoiled.historian, spoiled.audit) == (whole.socket, whole.historian, whole.audit)


def test_of_a_file_that_is_gone_or_unreadable_the_places_are_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    assert gateway_places(path).socket == tmp_path / "out/historian.sock"
    path.write_bytes(b"\xff\xfe\x00" * 1000)
    assert gateway_places(path).audit == tmp_path / "out/audit.sqlite"


@pytest.mark.timeout(300)
def test_a_gateway_whose_file_is_spoiled_is_shown_and_disarmed(tmp_path: Path) -> None:
    with running() as plc:
        path = plant_file(tmp_path, plc.port)
        whole, config = path.read_text(encoding="utf-8"), ("--config", path)
        by = ("--by", "Ada", "--records", tmp_path / "records.jsonl")
        command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(path), "--quiet", "--stdin"]
        gateway = subprocess.Popen(command, stdin=subprocess.PIPE, cwd=ROOT)
        try:
            wait_until(lambda: decanter("top", "--once", *config).exit_code != 3)
            armed = decanter("arm", *config, *by, "--reason", "test", "--minutes", "10")
            assert armed.exit_code == 0, armed.output
            path.write_text(whole.replace("[scan]", "[scan"), encoding="utf-8")
            status = decanter("top", "--once", *config, "--json")
            assert json.loads(status.stdout)["status"]["writeback"]["armed_by"] == "Ada", status.output
            assert "plant.toml" in status.stderr and "is asked all the same" in status.stderr
            assert decanter("alarm", "list", *config, "--json").exit_code in (0, 1)
            assert decanter("reload", *config).exit_code == 2, "what it would take over has to be usable"
            done = decanter("disarm", *config, *by, "--json")
            assert done.exit_code == 0 and json.loads(done.stdout)["was_armed"], done.output
            assert [row.entry.kind for row in read(tmp_path / "records/audit.sqlite")][-1] == "disarmed"
            # Paths that were changed in the file lead nowhere: that is said, and the socket can be named.
            path.write_text(whole.replace("records/", "elsewhere/"), encoding="utf-8")
            lost = decanter("reload", *config)
            assert lost.exit_code == 3 and "stop it and start it anew" in lost.stderr, lost.stderr
            named = decanter("reload", *config, "--socket", tmp_path / "records/historian.sock")
            assert named.exit_code == 1 and "historian.path: " in named.stderr, named.stderr
            assert "is common to all machines; stop the gateway and start it anew" in named.stderr
        finally:
            gateway.terminate()
            gateway.communicate(timeout=PATIENCE_S)


def test_where_no_gateway_runs_the_audit_log_of_a_spoiled_file_is_disarmed(tmp_path: Path) -> None:
    path = plant_file(tmp_path)
    by = ("--by", "Ada", "--records", tmp_path / "records.jsonl")
    (tmp_path / "records").mkdir()
    assert decanter("arm", "--config", path, *by, "--reason", "test", "--minutes", "10").exit_code == 0
    path.write_text(path.read_text(encoding="utf-8").replace("[scan]", "[scan"), encoding="utf-8")
    done = decanter("disarm", "--config", path, *by, "--json")
    assert done.exit_code == 0 and json.loads(done.stdout)["was_armed"], done.output
    assert [row.entry.kind for row in read(tmp_path / "records/audit.sqlite")][-1] == "disarmed"


def test_a_spoiled_file_without_a_gateway_or_a_log_is_refused_as_ever(tmp_path: Path) -> None:
    path = plant_file(tmp_path)
    path.write_text("[device", encoding="utf-8")
    for words in (("status",), ("reload",), ("alarm", "list"), ("disarm", "--records", tmp_path / "r.jsonl")):
        done = decanter(*words, "--config", path)
        assert done.exit_code == 2 and "plant.toml" in done.stderr, (words, done.output)
