"""What `model show` and `model learn` say in words: the disturbance, machines, plain members, borrowed locations."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from gateway.lab.models.show import spread_sentence
from sim.anomaly import MAX_LEVEL, AnomalyRecord
from sim.lab.formats.write_model import write_model_directory
from sim.lab.learning.machines import MachineSpread
from sim.sha.automaton import Effect
from sim.sha.model import PlainMember
from tests.cli.support import decanter, only_object
from tests.gateway.support import two_modes


def test_show_names_disturbance_machines_plain_members_and_borrowed_locations(tmp_path: Path) -> None:
    model = two_modes()
    effects = (
        Effect("heat-disturbance", {"sigma": 0.004, "memory": 300.0}),
        Effect("machine-offset", {"sigma": 7.5}),
    )
    members = (
        PlainMember("persistence", 0.05, 0.02, odds={60.0: 0.25}),
        PlainMember("damped trend", 0.05, 0.0, 0.01, 90),
    )
    sha = replace(model.sha, effects=effects)
    write_model_directory(tmp_path / "m", replace(model, sha=sha, plain=members, borrowed=frozenset({"start"})))
    text = decanter("model", "show", tmp_path / "m").stdout
    assert "disturbance: heat that comes and goes by 0.004 °C/s, with a memory of 300 s" in text
    assert "machines: the next one's targets lie off the model's by 7.5 °C" in text
    assert "plain member persistence: odds against the model 60 s 0.25" in text
    assert "plain member damped trend: no odds were learned" in text
    assert "borrowed, as no data have shown them: start" in text
    data = only_object(decanter("model", "show", tmp_path / "m", "--json").stdout)
    assert data["borrowed"] == ["start"]
    assert [member["name"] for member in data["plain"]] == ["persistence", "damped trend"]
    assert data["plain"][0]["memory"] in (None, inf)


RARE, OFTEN = "once a week at most", "more often than once a week"


@pytest.mark.parametrize(("level", "often"), [(17.3, RARE), (MAX_LEVEL, OFTEN)])
def test_how_often_a_score_is_passed_is_true_of_the_highest_level_too(tmp_path: Path, level: float, often: str) -> None:
    record = AnomalyRecord(seconds=7200.0, units=2, peaks=(), level=level)
    write_model_directory(tmp_path / "m", replace(two_modes(), anomalies=record))
    text = decanter("model", "show", tmp_path / "m").stdout
    assert f"anomaly: a score of {level:g} is passed {often}, by 2 h of 2 recordings" in text


@pytest.mark.parametrize(
    ("spread", "words"),
    [
        (MachineSpread({}, 0.0, 0.0), "fewer than two are told apart"),
        (
            MachineSpread({}, 0.0, 0.0, told_apart=3, has_targets=False),
            "machines: 3 are told apart, but nothing is known of how they differ: no flow of the model has a target",
        ),
        (
            MachineSpread({"A": 1.0}, 0.0, 0.0, told_apart=3),
            "of fewer than two of them the runs tell where its targets",
        ),
        (
            MachineSpread({"A": 1.0, "B": -2.0}, 1.5, 9.0),
            "two machines only: wide bands; targets off the model's by A +1",
        ),
        (MachineSpread({"A": 0.0, "B": 0.0}, 0.0, 0.0), "the 2 of the training differ by no more than their errors"),
        (MachineSpread(dict.fromkeys("ABCD", 1.0), 1.5, 2.0), "machines: targets off the model's by A +1, B +1"),
    ],
)
def test_the_spread_between_machines_is_told_in_words(spread: MachineSpread, words: str) -> None:
    assert words in spread_sentence(spread, "°C")
