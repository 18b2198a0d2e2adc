"""Several models followed by a running gateway, and the guards of the first: reviews, clamps, correction."""

import asyncio
import json
import sqlite3
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from drivers.settings import ConfigError
from gateway.machine.model.ensemble import Ensemble, Member
from gateway.machine.model.loading import load_members, load_model
from gateway.machine.model.predict import Predictor
from gateway.machine.pipeline import Machine
from gateway.machine.reading.scan import Scan
from gateway.plant.app import run
from gateway.plant.log import open_log
from gateway.settings.config import Config, load_config
from gateway.store.historian import open_historian
from gateway.store.score import scorecard
from sim.artefacts.model_json import model_text
from sim.engine.belief import advance
from sim.sha.automaton import Distribution
from sim.sha.model import Correction, Model, PlainMember
from tests.gateway.support import (
    CURRENT,
    EPOCH,
    RUNNING,
    TEMPERATURE,
    Bench,
    PacedClock,
    config_in,
    logged,
    one_machine,
    plant_file,
    scan_of,
    two_modes,
)
from tests.gateway.test_app import heating, table

FAST = {"forecast__horizons": [10.0, 60.0], "forecast__runs": 50, "forecast__period": 2.0}


def other(target: float = 38.0, name: str = "cooler") -> Model:
    """`two_modes`, in which the running machine warms to another temperature."""
    model = two_modes()
    places = [
        replace(place, distribution=Distribution("normal", {"mu": target, "sigma": 0.1}))
        if place.name == "on"
        else place
        for place in model.sha.locations
    ]
    return replace(model, sha=replace(model.sha, name=name, locations=tuple(places)))


def together(folder: Path, keys: str = "", *others: Model, **overrides: Any) -> Config:
    """A configuration with members beside `two_modes`."""
    names = []
    for place, model in enumerate(others or (other(),)):
        (folder / f"other{place}.json").write_text(model_text(model), encoding="utf-8")
        names.append(f"other{place}.json")
    text = f"[ensemble]\nmembers = {json.dumps(names)}\n{keys}"
    return config_in(folder, text, model=two_modes(), **{**FAST, **overrides})


async def go(config: Config, bench: Bench, reads: int) -> dict[str, Any]:
    bench.stop_after = reads
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)


async def test_the_model_that_is_right_gets_the_weight_and_status_and_historian_say_so(tmp_path: Path) -> None:
    config = together(tmp_path, "half_life = 5.0")
    bench = Bench(config, PacedClock(pause_s=0.002))
    heating(bench, 3, 300)
    status = await go(config, bench, 300)
    said = status["guards"]["ensemble"]
    assert [name.split()[0] for name in said["members"]] == ["two", "cooler"]
    assert said["context"] == "W_ON" and said["failures"] == {}
    assert said["weights"]["60"][0] > 0.7 and sum(said["weights"]["60"]) == pytest.approx(1.0)
    rows = [json.loads(content) for (content,) in table(config, "SELECT content FROM guards ORDER BY time")]
    assert len(rows) > 20
    assert rows[0]["ensemble"]["weights"]["60"] == [0.5, 0.5]
    assert rows[-1]["ensemble"]["weights"]["60"][0] > 0.7
    forecasts = table(config, "SELECT count(*) FROM forecasts")[0][0]
    assert forecasts == 2 * len(rows), "what is stored is the mixture: one fan a horizon"


async def test_with_all_the_weight_on_the_first_model_the_forecast_is_that_of_a_gateway_without_an_ensemble(
    tmp_path: Path,
) -> None:
    fans = []
    for name, keys in (("alone", None), ("both", "weights = [1.0, 0.0]")):
        folder = tmp_path / name
        folder.mkdir()
        config = config_in(folder, model=two_modes(), **FAST) if keys is None else together(folder, keys)
        bench = Bench(config, PacedClock(pause_s=0.002))
        heating(bench, 3, 60)
        await go(config, bench, 60)
        query = "SELECT time, horizon, quantiles, p_limit FROM forecasts ORDER BY time, horizon"
        fans.append({row[:2]: row[2:] for row in table(config, query)})
    # Later ones differ in their factors: in a thread a forecast may end one reading sooner, and be learned from sooner.
    common = [key for key in fans[0].keys() & fans[1].keys() if key[0] < EPOCH + 10.0]
    assert common
    for key in common:
        assert json.loads(fans[1][key][0]) == pytest.approx(json.loads(fans[0][key][0]), abs=2e-4)
        assert fans[1][key][1] == fans[0][key][1]


class Broken(Predictor):
    """Fails at its 20th scan, as a model with a defect would."""

    steps = 0

    def track(self, scan: Scan) -> bool:
        self.steps += 1
        if self.steps == 20:
            raise ZeroDivisionError("nothing to divide by")
        return super().track(scan)


async def test_a_member_that_fails_is_left_out_said_so_and_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Ensemble.__init__

    def with_a_broken_member(self: Ensemble, *arguments: Any, **keys: Any) -> None:
        made(self, *arguments, **keys)
        sound: Member = self.members[0]
        self.members[0] = replace(sound, predictor=Broken(sound.predictor.model, TEMPERATURE))

    monkeypatch.setattr(Ensemble, "__init__", with_a_broken_member)
    config = together(tmp_path)
    bench = Bench(config, PacedClock(pause_s=0.002))
    heating(bench, 3, 60)
    status = await go(config, bench, 60)
    assert status["failures"] == 0 and status["forecast"] is not None
    assert "nothing to divide by" in next(iter(status["guards"]["ensemble"]["failures"].values()))
    (said,) = [row for row in logged(tmp_path) if "left out" in row["event"]]
    assert said["member"].startswith("cooler ")
    later = tmp_path / "later"
    later.mkdir()
    config = together(later)
    bench = Bench(config, PacedClock(pause_s=0.002))
    heating(bench, 3, 120)
    status = await go(config, bench, 120)
    assert status["guards"]["ensemble"]["failures"] == {}, "60 s after its failure it was begun anew"


async def test_weights_beliefs_and_reviews_outlive_a_restart(tmp_path: Path) -> None:
    config = together(tmp_path, "half_life = 5.0")
    bench = Bench(config, PacedClock(pause_s=0.002))
    heating(bench, 3, 300)
    before = (await go(config, bench, 300))["guards"]
    with open_log(None, "info") as log:
        machine = Machine(config, driver=bench, clock=bench.clock, log=log, rng=Random(0))
        try:
            assert machine.model is not None
            after = machine.model.guard_report()
        finally:
            machine.close()
    assert after["ensemble"]["weights"] == before["ensemble"]["weights"]
    assert after["reviews"] == before["reviews"] and before["reviews"]["one step"]["readings"] > 200


def test_a_member_is_where_its_model_alone_would_be_at_each_scan_and_after_a_restart(tmp_path: Path) -> None:
    config = together(tmp_path)
    first, alone = Predictor(two_modes(), TEMPERATURE), Predictor(other(), TEMPERATURE)
    ensemble = Ensemble(
        first, ["a", "b"], [other()], section=config.ensemble, forecasts=config.forecast, scan_period=1.0
    )
    for number in range(25):
        running = number > 4
        scan = scan_of(
            {RUNNING: running, CURRENT: 150.0 if running else 0.0, TEMPERATURE: 30.0 + 0.1 * number}, EPOCH + number
        )
        first.step(scan)
        alone.track(scan)
        ensemble.follow(scan, scan.good(TEMPERATURE))
        (job,) = ensemble.jobs()
        assert job is None or job.belief == alone.belief, "a forecast begins from the newest scan"
    assert job is not None
    assert ensemble.snapshot()["members"] == [alone.snapshot()]
    assert ensemble.members[0].predictor.belief == alone.belief


def test_a_trend_of_the_model_takes_a_leap_for_no_slope_and_a_given_member_takes_each_reading_as_its_model_does(
    tmp_path: Path,
) -> None:
    config = together(tmp_path)
    first = Predictor(replace(two_modes(), plain=(PlainMember("damped trend", 0.01, 0.04, 0.01, 100.0),)), TEMPERATURE)
    ensemble = Ensemble(
        first, ["a", "b"], [other()], section=config.ensemble, forecasts=config.forecast, scan_period=1.0
    )
    alone = Predictor(other(), TEMPERATURE)
    for number in range(31):
        reading = 53.0 if number < 30 else 22.0
        scan = scan_of({RUNNING: True, CURRENT: 150.0, TEMPERATURE: reading}, EPOCH + number)
        first.step(scan)
        alone.track(scan)
        ensemble.follow(scan, scan.good(TEMPERATURE))
    given, trend = (member.predictor for member in ensemble.members)
    assert given.belief == alone.belief
    assert trend.belief is not None
    assert advance(trend.tracker, trend.belief, EPOCH + 90.0).x == pytest.approx(22.0, abs=1.0)


def test_what_was_learned_before_there_was_a_local_trend_goes_on(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **FAST)
    model = replace(two_modes(), plain=(PlainMember("persistence", 0.0, 0.1),))

    def ensemble() -> Ensemble:
        first = Predictor(model, TEMPERATURE)
        return Ensemble(first, ["a"], [], section=config.ensemble, forecasts=config.forecast, scan_period=1.0)

    begun = ensemble()
    assert begun.names[1:] == ["persistence", "local trend"]
    former = json.loads(json.dumps(begun.snapshot()))
    for pool in former["losses"].values():
        pool |= {"members": 2, "prior": [0.5, 0.5], "overall": {"total": [9.0, 3.0], "evidence": 5.0}}
    assert ensemble().restore(former, EPOCH)
    begun.restore(former, EPOCH)
    model_share, persistence, _ = begun.shares("")[0].tolist()
    assert persistence > 2.0 * model_share
    again = ensemble()
    assert again.restore(json.loads(json.dumps(begun.snapshot())), EPOCH)
    assert np.array_equal(again.shares(""), begun.shares(""))


def test_a_context_is_what_the_first_models_encoder_told(tmp_path: Path) -> None:
    seen = {}
    for context in ("none", "running", "symbols", "familiarity"):
        config = together(tmp_path, f'context = "{context}"')
        first = Predictor(two_modes(), TEMPERATURE)
        ensemble = Ensemble(
            first, ["a", "b"], [other()], section=config.ensemble, forecasts=config.forecast, scan_period=1.0
        )
        first.step(scan_of({RUNNING: True, CURRENT: 150.0, TEMPERATURE: 30.0}, EPOCH))
        seen[context] = ensemble.context
    assert seen == {"none": "", "running": "W_ON", "symbols": "W_ON A_1", "familiarity": "W_ON unknown"}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ('[ensemble]\nmembers = ["nowhere.json"]', "ensemble.members: there is nothing at"),
        ("[ensemble]\nweights = [0.7, 0.2]", "ensemble.weights: [0.7, 0.2] must be numbers from 0 that sum to 1"),
        ("[ensemble]\nweights = [0.7, 0.3]", "ensemble.weights: has 2 weights for 1 models"),
        (
            '[ensemble]\nweights = "best"',
            "ensemble.weights: must be 'evidence', 'equal' or a list of numbers such as [0.7, 0.3], got 'best'",
        ),
        ('[ensemble]\nmembers = ["model.json"]\nfloor = 0.5', "ensemble.floor: 0.5 is too much for 2 models"),
    ],
)
def test_an_ensemble_that_cannot_be_is_refused_with_its_key(tmp_path: Path, keys: str, words: str) -> None:
    path = plant_file(tmp_path, keys, model=two_modes())
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert any(words in problem for problem in caught.value.problems), caught.value.problems


def test_members_need_a_first_model(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(model_text(other()), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"ensemble\.members: members are followed beside model\.path"):
        config_in(tmp_path, '[ensemble]\nmembers = ["other.json"]')


def test_the_same_model_twice_and_a_member_of_another_temperature_are_refused(tmp_path: Path) -> None:
    same = together(tmp_path, "", two_modes())
    with pytest.raises(ConfigError, match=r"ensemble\.members\[0\]: is the same model as model\.path"):
        load_members(same, load_model(same))
    strange = together(tmp_path, "", replace(other(), temperature="TCuscinettiAlimentazione"))
    with pytest.raises(ConfigError, match=r"TCuscinettiAlimentazione"):
        load_members(strange, load_model(strange))


async def test_readings_beyond_three_sigma_raise_the_review_alarm_and_its_bit(tmp_path: Path) -> None:
    keys = {
        "writeback__mode": "armed",
        "writeback__armed_by": "Ada",
        "writeback__reason": "test",
        "writeback__minutes": 60.0,
    }
    config = config_in(tmp_path, model=two_modes(), **{**FAST, **keys})
    bench = Bench(config, PacedClock(pause_s=0.002), armed=True)
    heating(bench, 3, 200)
    for read in range(100, 200):  # ever faster than any location of the model
        bench.plan[read] = {**bench.plan[read], TEMPERATURE: 35.0 + 0.02 * (read - 100) ** 1.7}
    status = await go(config, bench, 200)
    assert status["guards"]["review"] and status["guards"]["reviews"]["one step"]["flagged"]
    assert status["alarms"]["review"] == "unacknowledged"
    standing = [int(block["alarms"]) >> 5 & 1 for block in bench.written]
    assert standing[90] == 0 and standing[-2] == 1 and sum(a != b for a, b in pairwise(standing)) == 1
    assert scorecard(config.historian.path).guards["review"]


async def test_a_belief_beyond_the_models_range_is_counted_logged_and_stored(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **FAST)
    bench = Bench(config, PacedClock(pause_s=0.002))
    for read in range(3, 120):  # a winter's night: the model's range ends at 0 degC, the sensor's does not
        bench.plan[read] = {TEMPERATURE: max(28.0 - read, -6.0)}
    status = await go(config, bench, 120)
    clamps = status["guards"]["clamps"]
    assert clamps["belief"] > 50 and clamps["forecast_runs"] > 0 and clamps["forecasts"] > 0
    assert len([row for row in logged(tmp_path) if "left its range" in row["event"]]) == 1
    assert scorecard(config.historian.path).guards["clamps"]["belief"] > 0


async def test_a_corrected_model_predicts_what_the_sensor_reads(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=replace(two_modes(), correction=Correction(1.0, 10.0)), **FAST)
    bench = Bench(config, PacedClock(pause_s=0.002))
    for read in range(3, 200):
        reading = 60.0 - 35.0 * float(np.exp(-0.01 * (read - 3)))
        bench.plan[read] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: reading}
    status = await go(config, bench, 200)
    assert status["guards"]["correction"] == {"gain": 1.0, "offset": 10.0}
    assert not status["guards"]["review"]
    assert status["prediction"]["free_run"] == pytest.approx(status["prediction"]["measured"], abs=0.5)


def test_a_historian_of_an_earlier_gateway_gets_the_table_of_the_guards(tmp_path: Path) -> None:
    path = tmp_path / "old.sqlite"
    open_historian(path).close()
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TABLE guards")
    connection.close()
    assert scorecard(path).guards == {}
    again_store, again = one_machine(path, [])
    again.put("guards", [(1.0, "{}")])
    assert again.flush(60.0)
    again_store.close()
