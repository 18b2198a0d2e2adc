"""Configurations that were taken over: kept, listed, compared, and the way back to one, never armed."""

import asyncio
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.plant import configurations
from gateway.plant.app import run
from gateway.settings import load_plant
from gateway.store import BackupError
from tests.gateway.support import MAP, Bench, JumpClock, load_config


@dataclass(frozen=True)
class PlantFolder:
    """A plant with a device file of its own."""

    folder: Path

    @property
    def plant(self) -> Path:
        return self.folder / "plant.toml"

    @property
    def device(self) -> Path:
        return self.folder / "devices/plc.toml"

    def write(self, limit: float, more: str = "", page: str = "") -> None:
        text = f'[device]\nfile = "devices/plc.toml"\n[alarms]\nlimit = {limit}\n[historian]\npath = "out/h.sqlite"\n'
        self.plant.write_text(f"{text}{more}\n{page}\n", encoding="utf-8")

    def replace_machines(self, note: str = "reload") -> None:
        configurations.keep_configuration(load_plant(self.plant), now=1_700_000_000.0, note=note)

    def type(self, *words: str) -> tuple[int, str]:
        done = CliRunner().invoke(main, ["keep", *words, "--config", str(self.plant)])
        return done.exit_code, done.output


@pytest.fixture
def there(tmp_path: Path) -> Iterator[PlantFolder]:
    made = PlantFolder(tmp_path)
    made.device.parent.mkdir()
    shutil.copyfile(MAP, made.device)
    yield made


def test_each_configuration_is_kept_once_with_the_files_it_is_made_of(there: PlantFolder) -> None:
    for limit in (80.0, 80.0, 75.0):
        there.write(limit)
        there.replace_machines()
    there.device.write_text(there.device.read_text() + "\n# seen\n", encoding="utf-8")
    there.replace_machines()
    code, printed = there.type("history", "--json")
    rows = json.loads(printed)["configurations"]
    assert code == 0 and [row["number"] for row in rows] == [1, 2, 3]
    assert {Path(file).name for row in rows for file in row["files"]} == {"plant.toml", "plc.toml"}
    # A web hook in a plant file may hold a token.
    assert (there.folder / "out/configurations/0001").stat().st_mode & 0o77 == 0, (
        "a web hook's address may hold a token"
    )
    assert "reload" in there.type("history")[1]
    difference = there.type("diff", "1", "2")[1]
    assert "-limit = 80.0" in difference and "+limit = 75.0" in difference and "seen" not in difference
    assert "+# seen" in there.type("diff", "2")[1]
    assert there.type("diff")[1].strip() == "nothing differs"


def test_a_file_that_changed_after_it_was_read_is_not_taken_for_what_runs(there: PlantFolder) -> None:
    there.write(80.0)
    read = load_plant(there.plant)
    there.write(75.0)
    os.utime(there.plant, ns=(1, 1))
    with pytest.raises(BackupError, match="was changed after it had been read"):
        configurations.keep_configuration(read, now=0.0, note="start")


def test_only_the_newest_are_kept(there: PlantFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(configurations, "MOST_KEPT", 3)
    for limit in range(70, 76):
        there.write(float(limit))
        there.replace_machines()
    assert [row["number"] for row in json.loads(there.type("history", "--json")[1])["configurations"]] == [4, 5, 6]


def test_the_way_back_keeps_what_it_replaces_and_arms_nothing(there: PlantFolder) -> None:
    armed = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "test"\nminutes = 5\n'
    there.write(80.0, armed)
    there.replace_machines()
    there.write(75.0, "# not taken over yet\n")
    code, printed = there.type("rollback", "1", "--reason", "too low", "--by", "Rossi")
    assert code == 0, printed
    assert "no gateway runs" in printed
    config = load_config(there.plant)
    assert config.alarms.limit == 80.0 and config.writeback.mode == "shadow"
    rows = json.loads(there.type("history", "--json")[1])["configurations"]
    assert rows[-1]["note"] == "before going back to 1: too low (Rossi)"
    assert "not taken over yet" in there.type("diff", "1", "2")[1]


def test_every_machines_arming_is_taken_out() -> None:
    plant = b'[[machine]]\nname = "a"\n[machine.writeback]\nmode = "armed" # why\n[[machine]]\nname = "b"\n'
    assert configurations.without_arming(plant) == plant.replace(b"armed", b"shadow")


def test_a_plant_file_that_cannot_be_used_any_more_has_its_way_back(there: PlantFolder) -> None:
    there.write(80.0)
    there.replace_machines()
    there.plant.write_text("[device\n", encoding="utf-8")
    code, printed = there.type("rollback", "1", "--reason", "a slip", "--by", "Rossi")
    assert code == 0, printed
    assert load_config(there.plant).alarms.limit == 80.0


def test_a_configuration_that_cannot_be_used_any_more_is_refused_and_nothing_changes(there: PlantFolder) -> None:
    model = there.folder / "model.json"
    model.write_text("{}", encoding="utf-8")
    there.write(80.0, '[model]\npath = "model.json"\n')
    there.replace_machines()
    model.unlink()
    there.write(75.0)
    before = there.plant.read_bytes()
    code, printed = there.type("rollback", "1", "--reason", "x", "--by", "Rossi")
    assert code == 2 and "cannot be used any more" in printed and there.plant.read_bytes() == before
    code, printed = there.type("rollback", "9", "--reason", "x")
    assert code == 2 and "there is no configuration 9" in printed


def test_without_a_history_one_sentence_says_so(there: PlantFolder) -> None:
    there.write(80.0)
    code, printed = there.type("history")
    assert code == 2 and "no configuration is kept there" in printed and "Traceback" not in printed


async def test_a_gateway_keeps_what_it_starts_with_and_what_it_takes_over(there: PlantFolder) -> None:
    there.write(80.0)
    config = load_config(there.plant)
    bench = Bench(config, JumpClock())
    hangup = asyncio.Event()

    def read_anew() -> tuple[Any, ...]:
        return load_plant(there.plant)

    work = asyncio.create_task(
        run(config, clock=bench.clock, stop=bench.stop, driver=bench, read_anew=read_anew, hangup=hangup)
    )
    kept = there.folder / "out/configurations"
    async with asyncio.timeout(120.0):
        while not (kept / "0001").exists():
            await asyncio.sleep(0.01)
        there.write(75.0)
        hangup.set()
        while not (kept / "0002").exists():
            await asyncio.sleep(0.01)
    bench.stop.set()
    await work
    notes = [one.manifest.note for one in configurations.kept_configurations(kept)]
    assert notes == ["start", "reload"]
