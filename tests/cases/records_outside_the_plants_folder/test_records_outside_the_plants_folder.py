"""A bare plant.toml kept its records in `../out`; `plc audit` in its folder looked beside the commissioning records."""

import json
from pathlib import Path

import pytest

from gateway.settings import load_config
from gateway.store import ARMED, AuditEntry, open_audit
from tests.cli.support import decanter
from tests.plc.bench import DECANTER

PLANT = f'''[device]
file = "{DECANTER}"
host = "127.0.0.1"
[model]
temperature = "TCuscinettiRiduttore"
'''


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a plant file that names no place of its records, as working folder."""
    home = tmp_path / "plant"
    home.mkdir()
    (home / "plant.toml").write_text(PLANT, encoding="utf-8")
    monkeypatch.chdir(home)
    return home


def test_records_lie_in_the_folder_of_a_plant_file_that_names_no_place(folder: Path) -> None:
    config = load_config(folder / "plant.toml")
    assert config.historian.path == folder / "out/historian.sqlite"
    assert config.audit == folder / "out/audit.sqlite"
    assert config.control_socket == folder / "out/historian.sock"


def test_records_that_are_where_the_default_was_stay_in_use_until_there_are_others(folder: Path) -> None:
    former = folder.parent / "out/historian.sqlite"
    former.parent.mkdir()
    former.touch()
    assert load_config(folder / "plant.toml").historian.path.resolve() == former
    named = PLANT + '[historian]\npath = "out/historian.sqlite"\n'
    (folder / "named.toml").write_text(named, encoding="utf-8")
    assert load_config(folder / "named.toml").historian.path == folder / "out/historian.sqlite"
    (folder / "out").mkdir()
    (folder / "out/historian.sqlite").touch()
    assert load_config(folder / "plant.toml").historian.path == folder / "out/historian.sqlite"


def test_audit_takes_the_plant_file_of_the_folder_unless_a_log_is_named(folder: Path) -> None:
    log = open_audit(load_config(folder / "plant.toml").audit)
    log.record(AuditEntry(1.0, ARMED, "Ada", "a test", {}))
    log.close()
    found = decanter("audit", "--json")
    assert [row["who"] for row in json.loads(found.stdout)["entries"]] == ["Ada"]
    other = decanter("audit", "--json", "--audit", "none.sqlite")
    assert "none.sqlite" in other.stdout + other.stderr and "Ada" not in other.stdout
