"""A cycle whose like the training never had: from the software PLC over a socket to alarm, block, status and words."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gateway.lab.learning.familiar import familiarity_files, trained_familiarity
from sim.artefacts import read_familiarity
from sim.lab.formats.write_model import write_model_directory
from sim.plc.record.recording import read_recording
from sim.sha import DECANTER, Trace, encode
from sim.sha.automaton import Flow
from sim.sha.model import Model
from tests.rig.pair import CURRENT, RUNNING, TARGETS, TEMPERATURE, known_model, make_rig

SPEED, PERIOD, STEP = 600.0, 24.0, 6.0
"""A plant hour takes 6 s; a scan each 40 ms of real time."""
HOUR = 3600.0
ANOMALY_BIT = 4


def patient(model: Model) -> Model:
    """The known model with slow bearings, and an alphabet that bears the scans of a hurried plant."""
    places = tuple(
        replace(place, flow=Flow("exponential", {"k": 1 / 600.0, "noise": 0.6})) if place.name in TARGETS else place
        for place in model.sha.locations
    )
    return replace(model, alphabet=replace(DECANTER, gap=600.0), sha=replace(model.sha, locations=places))


def course(name: str, seed: int, stays: list[tuple[float, float]]) -> Trace:
    """The plant under `stays` of (A, s), 0 A for rest: the bearing goes to its location's target within ten minutes."""
    rng = np.random.default_rng(seed)
    level = np.concatenate([np.full(round(seconds / STEP), amperes) for amperes, seconds in stays])
    running = (level > 0).astype(float)
    current = np.where(running > 0, level + rng.uniform(-8.0, 8.0, level.size), rng.uniform(0.0, 2.0, level.size))
    names = np.array(["OFF/0-100", "ON/0-100", "ON/100-200", "ON/200-300", "ON/300+"])
    where = np.where(running > 0, 1 + np.minimum(current // 100, 3), 0).astype(int)
    target = np.array([TARGETS[one] for one in names.tolist()])[where]
    temperature, now = np.empty(level.size), TARGETS["OFF/0-100"]
    for row, towards in enumerate(target.tolist()):
        now += (towards - now) * (1.0 - np.exp(-STEP / 600.0))
        temperature[row] = now
    signals = {RUNNING: running, CURRENT: current, TEMPERATURE: temperature + rng.normal(0.0, 0.05, level.size)}
    return Trace(name, STEP * np.arange(level.size), signals, origin=f"made, seed {seed}", synthetic=True)


def ordinary(seed: int, cycles: int) -> list[tuple[float, float]]:
    """Rests of about ten minutes and runs of about fifty, under two loads."""
    rng = np.random.default_rng(seed)
    stays: list[tuple[float, float]] = []
    for _ in range(cycles):
        stays.append((0.0, float(rng.uniform(500.0, 700.0))))
        stays += [(float(rng.uniform(130.0, 270.0)), float(rng.uniform(1300.0, 1700.0))) for _ in range(2)]
    return stays


def test_strange_idling_lowers_confidence_raises_the_alarm_and_is_said_in_plant_words(tmp_path: Path) -> None:
    model = patient(known_model())
    training = course("training", 1, ordinary(1, 24))
    familiar = trained_familiarity(model, [replace(training, events=encode(training, model.alphabet))])
    assert familiar is not None and familiar.curve is not None and not familiar.held_out

    day = course("day", 2, [*ordinary(2, 2), (60.0, 2.5 * HOUR)])
    rig = make_rig(tmp_path, day, period=PERIOD, speed=SPEED)
    write_model_directory(tmp_path / "model", model, more=familiarity_files(familiar))
    assert read_familiarity(tmp_path / "model") is not None
    text = rig.plant.read_text(encoding="utf-8").replace('path = "model.json"', 'path = "model"')
    # At six hundred times the speed of a plant every sensor jumps.
    more = "[alarms]\nsensors = false\n[ensemble]\nmembers = ['model.json']\ncontext = 'familiarity'\n"
    rig.plant.write_text(text + more, encoding="utf-8")
    with rig.plc("--hold") as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(lambda status: status["link"]["alive"] and status["writeback"]["accepted"] > 0)
        assert gateway.status["prediction"]["familiarity"]["zone"] == "unknown", "before an hour nothing is said"
        plc.order("start")
        usual = gateway.wait_for(lambda status: status["prediction"]["familiarity"]["strangeness"] is not None)
        assert not usual["prediction"]["familiarity"]["outside"] and usual["alarms"]["unfamiliar"] == "normal"
        assert usual["guards"]["ensemble"]["context"].endswith(" familiar"), "weights of their own for what is known"
        strange = gateway.wait_for(lambda status: status["alarms"]["unfamiliar"] == "unacknowledged")
        p = strange["prediction"]
        assert strange["guards"]["ensemble"]["context"].endswith(" strange")
        assert p["familiarity"]["outside"] and p["familiarity"]["zone"] in ("yellow", "red")
        assert p["zone"] in ("none", "yellow", "red"), "a green prediction is none any more"
        said = gateway.wait_for(
            lambda status: (
                status["prediction"]["familiarity"]["sentence"].startswith("idling for")
                and status["prediction"]["zone"] in ("yellow", "red")
            )
        )
        assert "min of the last hour: in training at most 0" in said["prediction"]["familiarity"]["sentence"]
        accepted = said["writeback"]["accepted"]
        gateway.wait_for(lambda status: status["writeback"]["accepted"] > accepted + 2)
        assert gateway.stop()[0] == 0, gateway.words()
    blocks = [block.fields for block in read_recording(rig.recording).blocks if block.fields is not None]
    assert any(int(each["zone"]) == 1 and not int(each["alarms"]) & ANOMALY_BIT for each in blocks)
    assert any(int(each["zone"]) >= 2 and int(each["alarms"]) & ANOMALY_BIT for each in blocks)
