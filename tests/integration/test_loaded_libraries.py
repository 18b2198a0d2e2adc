"""What a gateway has loaded that reads, foresees and writes: a process of its own, asked at its end."""

import json
from pathlib import Path

import pytest

from benchmarks.processes import ROOT, gateway, learned_model, software_plc, until_usable
from tests.rig.no_bands import without_bands

NEVER = {
    *("scipy", "rich", "pygments", "tomlkit", "smtplib", "http"),
    *("jinja2", "starlette", "pandas", "matplotlib", "sklearn"),
}
"""What only learning, checking, commissioning, the page and messages need. Of `email` the standard library's own
importlib.metadata loads the half that reads headers."""


def test_a_running_gateway_loads_no_library_of_the_laboratory_and_none_that_draws_edits_or_sends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    model, out = learned_model(tmp_path), tmp_path / "imports.json"
    program = (str(ROOT / "benchmarks/import_memory.py"), str(ROOT), str(out))
    with (
        software_plc(tmp_path) as plc,
        gateway(tmp_path, plc, model, 0.1, forecast=0.3, program=program) as process,
    ):
        until_usable(plc, process)  # a block that the PLC may use in full has a forecast in it
    loaded = json.loads(out.read_text(encoding="utf-8")).keys()
    assert {"numpy", "pymodbus", "gateway", "sim"} <= loaded
    assert loaded.isdisjoint(NEVER)
