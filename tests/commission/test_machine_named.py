"""Commands that speak of one machine of several, and ask no device: each takes its name, or asks for it."""

import json
from pathlib import Path
from typing import Any

from gateway.store import AuditEntry, open_audit
from tests.cli.support import decanter
from tests.plc.bench import DECANTER

PLANT = f"""
[device]
file = "{DECANTER.as_posix()}"

[serve]
port = 15020

[[machine]]
name = "north"
device = {{ host = "10.0.0.7" }}

[[machine]]
name = "south"
device = {{ host = "10.0.0.8" }}
serve = {{ unit = 7 }}
"""


def plant(folder: Path) -> Path:
    path = folder / "plant.toml"
    path.write_text(PLANT, encoding="utf-8")
    return path


def answer(command: str, path: Path, *more: str) -> dict[str, Any]:
    result = decanter("plc", command, "--config", path, *more, "--json")
    assert result.exit_code == 0, result.output
    data: dict[str, Any] = json.loads(result.stdout)
    return data


def test_where_peers_find_the_machine_that_is_named(tmp_path: Path) -> None:
    path = plant(tmp_path)
    result = decanter("plc", "served", "--config", path)
    assert result.exit_code == 2 and "name one of them with --machine: north, south" in result.stderr
    units = [answer("served", path, "--machine", name)["unit"] for name in ("north", "south")]
    assert units == [1, 7]


def test_of_the_audit_log_the_rows_of_the_machine_that_is_named(tmp_path: Path) -> None:
    path = plant(tmp_path)
    (tmp_path / "out").mkdir()
    audit = open_audit(tmp_path / "out/audit.sqlite")
    rows = [
        AuditEntry(float(n), "armed", "Ada", name).with_subject(name)
        for n, name in enumerate(("north", "south", "gone"))
    ]
    assert all(audit.record(row) for row in rows) and audit.close()

    def reasons(*more: str) -> list[str]:
        return [row["reason"] for row in answer("audit", path, *more)["entries"]]

    assert reasons() == ["north", "south", "gone"]
    assert reasons("--machine", "south") == ["south"]
    assert reasons("--machine", "gone") == ["gone"], "what a machine did stays on record when it is gone"
    assert reasons("--machine", "north", "--last", "0") == []
    result = decanter("audit", "--config", path, "--machine", "west")
    assert result.exit_code == 2 and "they have north, south, gone" in result.stderr
