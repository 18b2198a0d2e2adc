"""A plant of another make goes from its own I/O list and export to a prediction, a diagnosis, proofs and UPPAAL."""

import os
import re
import signal
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from benchmarks.first_hour import MOST_COMMANDS, Hour, walk_foreign
from benchmarks.foreign_plants import FOREIGN
from sim.artefacts import read_model
from tests.rig.no_bands import without_bands

DECANTERS = re.compile("Marcia|Assorbimento|Cuscinett|TFango|TAmbiente|Coppia|Differenziale|LivelloVibrazioni")
"""Names that are the shipped decanter's and nobody else's."""


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", FOREIGN)
def test_a_plant_of_another_make_is_foreseen_diagnosed_and_proven_by_its_own_names(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    plant = FOREIGN[name]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("DECANTER")}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"
    hour = Hour(tmp_path, environment, quick=True)
    try:
        found = walk_foreign(hour, plant)
    finally:
        for kept in ("plc.pid", "run.pid"):
            with suppress(FileNotFoundError, ProcessLookupError):
                os.kill(int((tmp_path / kept).read_text(encoding="ascii")), signal.SIGTERM)
    assert len(hour.typed) <= MOST_COMMANDS and found["ok"]
    model = read_model(tmp_path / "models/first/model.json")
    signals = {model.temperature, *(channel.signal for channel in model.alphabet.channels)}
    assert signals == set(plant.tags[:3]) and model.roles == {}
    for line in (
        "decanter model judge models/first",
        f"decanter model check models/first 'E<> {plant.tags[0]}'",
        "decanter model check models/first 'Pr[<=600](<> Temp >= 60)' --runs 20",
        "decanter model export models/first --uppaal --trace export.csv --map columns.toml --out uppaal",
    ):
        hour.type(line)
    written = [path for folder in ("uppaal", "diagnosis", "devices") for path in (tmp_path / folder).rglob("*")]
    texts = [*(typed.printed for typed in hour.typed), *(path.read_text("utf-8") for path in written if path.is_file())]
    assert [said.group() for text in texts if (said := DECANTERS.search(text))] == []
