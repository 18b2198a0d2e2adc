"""A model that is promoted while the gateway runs takes over without a restart, if it verifies and suits the plant."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import exp
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import pytest

from gateway.machine.model.loading import load_model
from gateway.machine.model.pickup import Pickup
from gateway.plant.app import run
from gateway.settings.config import Config
from sim.artefacts.model_json import model_hash
from sim.artefacts.store import CURRENT_LINK as CURRENT_FILE
from sim.artefacts.store import Force, promote
from sim.lab.formats.write_model import save, write_model_directory
from sim.sha.model import Model
from tests.checking.verify_models import thesis
from tests.gateway.support import (
    CURRENT,
    RUNNING,
    TEMPERATURE,
    Bench,
    PacedClock,
    config_in,
    logged,
    scan_of,
    two_modes,
)
from tests.gateway.test_app import heating, table

STORE = '[model]\npath = "store"\n'
HOT = replace(thesis(), temperature=TEMPERATURE)
ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
}
FORECASTS = {"forecast__horizons": [10.0], "forecast__runs": 20, "forecast__period": 5.0}
READS, DEED = 300, 100


@dataclass
class Plant(Bench):
    """A bench at which something is done before a certain read."""

    deeds: dict[int, Callable[[], object]] = field(default_factory=dict)

    async def read(self, tags: Any) -> Any:
        if self.reads in self.deeds:
            self.deeds[self.reads]()
        return await super().read(tags)


def other(target: float = 45.0, name: str = "new") -> Model:
    """The model of the tests with another target when running."""
    model = two_modes()
    law = model.sha.locations[2].distribution
    assert law is not None
    warm = replace(model.sha.locations[2], distribution=replace(law, params={"mu": target, "sigma": 1.0}))
    return replace(model, sha=replace(model.sha, name=name, locations=(*model.sha.locations[:2], warm)))


def stocked(folder: Path, *models: Model) -> list[str]:
    """A store with these models, the first one promoted; the versions' names."""
    names = [save(folder / "store", model, created=1.0 + place) for place, model in enumerate(models)]
    promote(folder / "store", names[0])
    return names


def slip_in(folder: Path, version: str) -> None:
    """What no command does: make a version current that was never judged."""
    (folder / "store" / CURRENT_FILE).write_text(version + "\n", encoding="utf-8")


def running(config: Config, *, armed: bool = True) -> Plant:
    """A decanter that starts at read 5 and warms towards 50 degC."""
    plant = Plant(config, PacedClock(pause_s=0.002), armed=armed)
    heating(plant, 5, READS)
    return plant


async def go(config: Config, plant: Plant) -> dict[str, Any]:
    plant.stop_after = READS
    return await asyncio.wait_for(run(config, clock=plant.clock, stop=plant.stop, driver=plant), 300.0)


def hash_word(model: Model) -> int:
    return int(model_hash(model)[-4:], 16)


async def test_a_promoted_model_takes_over_between_two_scans_and_knows_where_the_plant_is(tmp_path: Path) -> None:
    first, second = stocked(tmp_path, two_modes(), other())
    config = config_in(tmp_path, STORE, **ARMED, **FORECASTS)
    plant = running(config)
    plant.deeds[DEED] = lambda: promote(tmp_path / "store", second)
    status = await go(config, plant)
    taken = {
        "name": "new",
        "hash": model_hash(other()),
        "version": second,
        "refused": "",
        "verdict": "",
        "verdict_sentence": "",
    }
    assert status["model"] == taken | {"written": ANY}
    assert status["failures"] == 0 and status["scan"]["missed"] == 0
    words = [int(block["model_hash"]) for block in plant.written if int(block["validity"])]
    swap = words.index(hash_word(other()))
    assert words == [hash_word(two_modes())] * swap + [hash_word(other())] * (len(words) - swap)
    assert DEED - 5 <= swap < READS - 100
    rows = table(config, "SELECT time, location, known, measured, mean FROM predictions ORDER BY time")[10:]
    assert {row[1:3] for row in rows} == {("on", 1)}, "the location is known at the first scan of the new model"
    assert max(abs(measured - mean) for _, _, _, measured, mean in rows) < 0.3, "and so is the temperature"
    assert [row[0] for row in table(config, "SELECT model FROM runs ORDER BY started")] == [
        model_hash(two_modes()),
        model_hash(other()),
    ]
    assert table(config, "SELECT who, reason FROM audit WHERE what LIKE 'model %'") == [
        (second, f"promoted; {first} ran before")
    ]
    invalid = [block for block in plant.written[20:-1] if not int(block["validity"]) & 1]
    assert len(invalid) < 30, "the block is only without a forecast until the new model has made its first"


async def test_a_model_that_does_not_verify_is_refused_once_and_the_former_one_goes_on(tmp_path: Path) -> None:
    first, bad = stocked(tmp_path, two_modes(), HOT)
    config = config_in(tmp_path, STORE, **ARMED, **FORECASTS)
    plant = running(config)
    plant.deeds[DEED] = lambda: slip_in(tmp_path, bad)
    status = await go(config, plant)
    assert status["model"]["version"] == first and status["failures"] == 0
    assert "does not verify: growth refuted: T grows upwards without bound" in status["model"]["refused"]
    said = [line for line in logged(tmp_path) if line["event"].startswith("the promoted model is refused")]
    assert len(said) == 1 and said[0]["level"] == "error" and "growth refuted" in said[0]["reason"]
    ((what, running_then, reason),) = table(config, "SELECT what, who, reason FROM audit WHERE what LIKE '%refused'")
    assert (what, running_then) == ("promoted model refused", first) and "growth refuted" in reason
    assert {int(b["model_hash"]) for b in plant.written if int(b["validity"])} == {hash_word(two_modes())}


async def test_after_a_refusal_the_next_promotion_is_taken(tmp_path: Path) -> None:
    _, bad, good = stocked(tmp_path, two_modes(), HOT, other())
    config = config_in(tmp_path, STORE, **FORECASTS)
    plant = running(config, armed=False)
    plant.deeds = {DEED: lambda: slip_in(tmp_path, bad), 2 * DEED: lambda: promote(tmp_path / "store", good)}
    status = await go(config, plant)
    assert (status["model"]["version"], status["model"]["refused"]) == (good, "")


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: replace(two_modes(), temperature="TCuscinettiAlimentazione"), "predicts 'TCuscinettiAlimentazione'"),
        (lambda: None, "names the version '9999-00000000', which is not there"),
    ],
)
async def test_what_does_not_suit_the_plant_or_is_not_there_is_refused(
    tmp_path: Path, make: Callable[[], Model | None], reason: str
) -> None:
    (first,) = stocked(tmp_path, two_modes())
    strange = make()
    version = "9999-00000000" if strange is None else save(tmp_path / "store", strange, created=2.0)
    config = config_in(tmp_path, STORE, **FORECASTS)
    plant = running(config, armed=False)
    plant.deeds[DEED] = lambda: slip_in(tmp_path, version)
    status = await go(config, plant)
    assert status["model"]["version"] == first and reason in status["model"]["refused"]
    assert status["failures"] == 0


@pytest.mark.parametrize("armed", [True, False])
async def test_a_forced_model_takes_over_with_a_warning_and_never_armed(tmp_path: Path, *, armed: bool) -> None:
    first, bad = stocked(tmp_path, two_modes(), HOT)
    config = config_in(tmp_path, STORE, **(ARMED if armed else {}), **FORECASTS)
    plant = running(config, armed=armed)
    plant.deeds[DEED] = lambda: promote(tmp_path / "store", bad, Force("Anna", "for a look", 2.0))
    status = await go(config, plant)
    if armed:
        assert status["model"]["version"] == first
        assert "writeback.mode: is 'armed'" in status["model"]["refused"]
    else:
        assert status["model"]["version"] == bad
        assert any("Anna promoted it by force" in line.get("reason", "") for line in logged(tmp_path))


async def test_the_other_models_of_an_ensemble_go_on_and_one_of_them_cannot_become_the_first(tmp_path: Path) -> None:
    _, second, third = stocked(tmp_path, two_modes(), other(), other(38.0, "member"))
    write_model_directory(tmp_path / "member", other(38.0, "member"))
    text = '[ensemble]\nmembers = ["member"]\n' + STORE
    config = config_in(tmp_path, text, **FORECASTS)
    plant = running(config, armed=False)
    plant.deeds = {
        DEED: lambda: promote(tmp_path / "store", second),
        2 * DEED: lambda: promote(tmp_path / "store", third),
    }
    status = await go(config, plant)
    assert status["model"]["version"] == second and "one of ensemble.members" in status["model"]["refused"]
    assert [name.split()[0] for name in status["guards"]["ensemble"]["members"]] == ["new", "member"]
    assert not status["guards"]["ensemble"]["failures"]


def test_no_store_is_looked_at_where_the_model_is_a_file_and_no_scan_is_kept(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    pickup = Pickup(config, load_model(config))
    pickup.keep(scan_of({}, 1.0))
    pickup.look(1.0, [])
    assert pickup.collect() == "" and pickup.take() is None and not pickup._recent


async def test_a_model_that_fails_on_the_plants_readings_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = stocked(tmp_path, two_modes(), other())
    config = config_in(tmp_path, STORE, **FORECASTS)

    def broken(predictor: object, scans: object) -> None:
        raise ArithmeticError("not finite")

    monkeypatch.setattr("gateway.machine.model.pickup._follow", broken)
    plant = running(config, armed=False)
    plant.deeds[DEED] = lambda: promote(tmp_path / "store", second)
    status = await go(config, plant)
    assert status["model"]["version"] == first
    assert f"version {second} fails on the plant's recent readings" in status["model"]["refused"]


async def test_the_drift_alarm_is_closed_by_the_promotion_of_the_model_that_was_adopted(tmp_path: Path) -> None:
    _, adopted = stocked(tmp_path, two_modes(), other(47.0, "adopted"))
    config = config_in(tmp_path, STORE, forecast__runs=50, alarms__sensors=False)
    plant = Plant(config, PacedClock(pause_s=0.002))
    for read in range(3, 320):  # as in test_drift: it warms twice as fast as the model, cycle after cycle
        on, age = (read - 3) % 80 < 60, (read - 3) % 80
        reading = 25.0 + min(age, 60) * exp(-max(age - 60, 0) / 8.0)
        plant.plan[read] = {RUNNING: on, CURRENT: 150.0 if on else 0.0, TEMPERATURE: reading}
    plant.deeds[270] = lambda: promote(tmp_path / "store", adopted)
    plant.stop_after = 320
    status = await asyncio.wait_for(run(config, clock=plant.clock, stop=plant.stop, driver=plant), 300.0)
    assert status["model"]["version"] == adopted
    changes = [row for row in logged(tmp_path) if row["event"] == "alarm" and row["condition"] == "drift"]
    assert [(row["state"], row["value"]) for row in changes] == [
        ("unacknowledged", 3.0),
        ("returned unacknowledged", 0.0),
    ]
    assert status["guards"]["drift"]["cycles"] == 0
    assert status["alarms"]["drift"] == "returned unacknowledged"
