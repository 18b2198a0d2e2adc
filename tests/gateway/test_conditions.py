"""What a plant file makes of the kinds of alarms: each condition's name, tag, limit, delays, word and sentence."""

from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from gateway.machine import Machine
from gateway.machine.alarms import make_conditions
from gateway.machine.alarms.conditions import acknowledge_words, on_tag, suppressing_tags
from gateway.plant import open_log
from gateway.settings import ALARM_KINDS, ANOMALY_FLOOR, Config, load_config
from sim.anomaly import AnomalyRecord
from sim.artefacts.model_json import model_text
from tests.gateway.support import (
    TEMPERATURE,
    Bench,
    JumpClock,
    as_driver,
    config_in,
    logged,
    plant_file,
    two_modes,
)

OTHER = "TCuscinettiAlimentazione"


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """A machine that predicts both of its bearings, each against its own limit."""
    folder = tmp_path_factory.mktemp("both")
    (folder / "first.json").write_text(model_text(two_modes()), encoding="utf-8")
    (folder / "second.json").write_text(model_text(replace(two_modes(), temperature=OTHER)), encoding="utf-8")
    text = (
        "[scan]\nperiod = 0.5\n[alarms]\noff_delay = 7.0\ntrend = 300\np_limit = 0.25\n"
        f'[[temperature]]\ntag = "{TEMPERATURE}"\nmodel = "first.json"\n'
        f'[[temperature]]\ntag = "{OTHER}"\nmodel = "second.json"\nlimit = 61.5\n'
        '[[alarm]]\nname = "anomaly"\npriority = 4\non_delay = 11.0\n'
        f'[[alarm]]\nname = "anomaly"\ntag = "{OTHER}"\npriority = 2\nresponse = "call the shift"\nlatch = true\n'
        f'[[alarm]]\nname = "over limit"\ntag = "{OTHER}"\nsuppressed_by = "MarciaDecanter=0"\nlatch = false\n'
        '[[alarm]]\nname = "disk"\nenabled = false\n[[alarm]]\nname = "link"\nenabled = true\n'
    )
    return load_config(plant_file(folder, text))


def test_an_alarm_of_each_bearing_is_its_own(both: Config) -> None:
    conditions = make_conditions(both, (TEMPERATURE, "Assorbimento"))
    unit = both.map.by_name[OTHER].unit
    hot, other = (conditions[on_tag("over limit", tag)] for tag in (TEMPERATURE, OTHER))
    assert (hot.tag, hot.limit, hot.temperature, hot.kind) == (
        TEMPERATURE,
        both.alarms.limit,
        TEMPERATURE,
        "over limit",
    )
    assert (other.tag, other.limit, other.temperature) == (OTHER, 61.5, OTHER)
    assert other.response == f"{OTHER} is above 61.5 {unit}: reduce the load and check the lubrication" and unit
    assert other.suppressed_by == ("MarciaDecanter", 0.0) and other.latches is False
    assert suppressing_tags(conditions) == {"MarciaDecanter"}
    # The first temperature's alarms of its model are plain; each is in the block of its own temperature alone.
    first, second = conditions["predicted over limit"], conditions[f"predicted over limit {OTHER}"]
    assert [(each.tag, each.temperature, each.bit, each.kind) for each in (first, second)] == [
        (tag, tag, 1, "predicted over limit") for tag in (TEMPERATURE, OTHER)
    ]
    assert (second.limit, second.deadband, second.off_delay) == (0.25, 0.125, 7.0)
    assert second.response == f"{OTHER} will pass its limit: look at load and lubrication while there is time"


def test_what_the_file_says_of_a_kind_holds_for_all_and_of_a_tag_for_that_one(both: Config) -> None:
    conditions = make_conditions(both, ())
    first, second = conditions["anomaly"], conditions[f"anomaly {OTHER}"]
    assert (first.priority, first.on_delay, first.latches, first.own_response) == (4, 11.0, False, False)
    assert (second.priority, second.on_delay, second.latches, second.own_response) == (2, 11.0, True, True)
    assert second.response == "call the shift" != first.response
    assert first.consequence == second.consequence == str(ALARM_KINDS["anomaly"].consequence)
    assert "disk" not in conditions and "link" in conditions
    assert {condition.kind for condition in conditions.values() if condition.own_response} == {"anomaly", "drift"}


def test_a_bearing_that_drifts_is_told_from_its_twin_once(both: Config) -> None:
    def drifting(config: Config) -> dict[str, str]:
        found = make_conditions(config, ()).values()
        return {condition.tag: condition.response for condition in found if condition.kind == "sensor drifting"}

    said = (
        "compare {} and {} with a hand-held thermometer, then look at sensor, cable and input of the one that is wrong"
    )
    assert drifting(both) == {TEMPERATURE: said.format(TEMPERATURE, OTHER)}
    turned = both.alarms.model_copy(update={"twins": (OTHER, TEMPERATURE)})
    turned.model_fields_set.add("twins")
    assert drifting(replace(both, alarms=turned)) == {OTHER: said.format(OTHER, TEMPERATURE)}
    three = turned.model_copy(update={"twins": (OTHER, TEMPERATURE, "Assorbimento")})
    assert drifting(replace(both, alarms=three)) == {OTHER: said.format(OTHER, f"{TEMPERATURE} and Assorbimento")}


def test_the_machines_own_alarms_name_it_and_wait_for_what_may_be_held(both: Config) -> None:
    conditions = make_conditions(both, (TEMPERATURE, "Assorbimento"))
    inputs = conditions["inputs bad"]
    assert (inputs.tag, inputs.on_delay, inputs.off_delay) == (f"{TEMPERATURE}, Assorbimento", 1.5, 0.0)
    assert make_conditions(both, ())["inputs bad"].tag == both.machine
    assert conditions["link"].tag == both.machine and conditions["link"].temperature == ""
    assert "device" not in conditions
    assert make_conditions(both, (), complains=True)["device"].limit == 0.5


def test_only_the_first_machine_of_several_looks_after_the_plant(both: Config) -> None:
    plants = {name for name, kind in ALARM_KINDS.items() if kind.subject == "plant"}
    text = replace(both, alarm=())
    for leads, several, tag in ((True, True, "plant"), (True, False, both.machine), (False, True, "")):
        found = make_conditions(replace(text, leads=leads, several=several), ())
        own = [condition for name, condition in found.items() if name in plants]
        assert bool(own) == leads and {condition.tag for condition in own} <= {tag}


def test_conditions_of_one_tag_stand_together_in_the_order_of_the_kinds(both: Config) -> None:
    kinds = list(ALARM_KINDS)
    order = [(condition.tag, kinds.index(condition.kind)) for condition in make_conditions(both, ()).values()]
    watched = [place for place, (tag, _) in enumerate(order) if tag == OTHER]
    for kind in ("over limit", "sensor out of range"):
        assert (TEMPERATURE, kinds.index(kind)) in order and (OTHER, kinds.index(kind)) in order
    runs = [order[place] for place in watched if place + 1 in watched]
    assert runs and all(order[place][1] < order[place + 1][1] for place in watched if place + 1 in watched)


def test_an_alarm_of_a_lone_temperature_is_in_every_block(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    assert {condition.temperature for condition in make_conditions(config, ()).values()} == {""}
    assert acknowledge_words(config) == {"AcknowledgeBits": frozenset({TEMPERATURE})}


def test_without_a_block_alarms_are_acknowledged_by_the_usual_word(both: Config) -> None:
    (link, *_) = both.links
    unwritten = replace(both, links=(replace(link, map=replace(link.map, writebacks=())),))
    assert acknowledge_words(unwritten) == {"AcknowledgeBits": frozenset({TEMPERATURE, OTHER})}


def test_each_block_has_its_own_acknowledgements(both: Config) -> None:
    behind = both.map.writebacks[1].acknowledge_bits
    assert acknowledge_words(both) == {
        "AcknowledgeBits": frozenset({TEMPERATURE}),
        behind: frozenset({OTHER}),
    }


def test_the_anomaly_alarm_begins_where_the_record_says_and_the_file_overrides_it(tmp_path: Path, both: Config) -> None:
    def limits(config: Config, **levels: float) -> tuple[float, float]:
        condition = make_conditions(config, (), anomaly_levels=levels)["anomaly"]
        return condition.limit, condition.deadband

    default, stated = (
        config_in(tmp_path, model=two_modes()),
        config_in(tmp_path, model=two_modes(), alarms__anomaly=7.0),
    )
    assert limits(default) == limits(default, **{TEMPERATURE: 4.2}) == pytest.approx((ANOMALY_FLOOR, ANOMALY_FLOOR / 3))
    assert limits(default, **{TEMPERATURE: 24.0}) == pytest.approx((24.0, 8.0))
    assert limits(stated, **{TEMPERATURE: 24.0}) == limits(stated) == pytest.approx((7.0, 7.0 / 3))
    # Of several bearings each has its own model's.
    conditions = make_conditions(both, (), anomaly_levels={OTHER: 31.0})
    assert (conditions["anomaly"].limit, conditions[f"anomaly {OTHER}"].limit) == (ANOMALY_FLOOR, 31.0)


def test_a_machine_takes_the_level_of_its_model_and_says_once_that_an_old_one_has_none(tmp_path: Path) -> None:
    record = AnomalyRecord(seconds=86_400.0, units=3, peaks=(12.0, 8.0), level=23.5)
    for name, model, limit in (("own", replace(two_modes(), anomalies=record), 23.5), ("old", two_modes(), 10.0)):
        folder = tmp_path / name
        folder.mkdir()
        config = config_in(folder, model=model)
        bench = Bench(config, JumpClock())
        with open_log(config.log.path, "info") as log:
            machine = Machine(config, driver=as_driver(bench), clock=bench.clock, log=log, rng=Random(0))
            assert machine.alarms.conditions["anomaly"].limit == limit
            machine.close()
        said = [row for row in logged(folder) if "has no record of its anomaly scores" in row["event"]]
        assert len(said) == (name == "old")
