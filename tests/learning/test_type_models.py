"""One model of a type of machine, and what each machine has of its own: forecasts with it, and of a new machine."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from sim.artefacts.model_json import model_hash, model_text, parse_model
from sim.effects import of_machine as of_the_type
from sim.engine import advance, compile_model, errors, on_event, open_loop, start
from sim.files import ArtefactError
from sim.lab.learning.bins.candidates import CANDIDATES
from sim.lab.learning.bins.learn import Learned, learn_bins
from sim.lab.learning.calibrate import score_forecasts
from sim.lab.learning.lsha import LshaSettings
from sim.lab.learning.lsha import learn as lsha
from sim.lab.learning.machines import MachineSpread, machine_corrections
from sim.sha import Correction, Distribution, MachineCorrection, Model, Trace
from sim.sha.events import DECANTER
from tests.learning.plants import with_signal
from tests.learning.test_machines import OFFSETS, of_machine
from tests.rig.no_bands import without_bands

K = {"four": 1.08}
"""The machine whose sensor reads too much."""


def readings(name: str, seed: int, offset: float | None = None) -> list[Trace]:
    own = of_machine(name, OFFSETS[name] if offset is None else offset, seed)
    return [with_signal(trace, T=K.get(name, 1.0) * trace.signals["T"]) for trace in own]


Fleet = tuple[Model, Learned, dict[str, list[Trace]]]


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    """The model of the type with its machines, what it was learned as, and other traces of each machine."""
    traces = [trace for number, name in enumerate(OFFSETS) for trace in readings(name, number)]
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        learned = learn_bins(traces, DECANTER, "T", seed=0, candidates=CANDIDATES[:1])
    model = replace(learned.model, machines=machine_corrections(learned.model, traces, learned.spread))
    yield model, learned, {name: readings(name, 50 + number) for number, name in enumerate(OFFSETS)}


def crps(model: Model, traces: list[Trace]) -> float:
    """Mean CRPS (degC) of forecasts made along traces."""
    begins = [float(trace.times[0]) for trace in traces]
    every = score_forecasts(model, traces, begins, np.random.default_rng(0), origins=24, most_rows=600)
    return float(np.mean([each.crps for each in every]))


def test_each_machine_of_the_training_has_its_targets_and_how_well_they_are_known(fleet: Fleet) -> None:
    model, learned, _ = fleet
    assert set(model.machines) == set(OFFSETS) == set(learned.spread.errors)
    for name, own in model.machines.items():
        assert abs(own.targets) <= abs(learned.spread.offsets[name]), "drawn towards the type, never beyond"
        assert 0 < own.targets_error < learned.spread.between
    order = sorted(("one", "two", "three"), key=lambda name: model.machines[name].targets)
    assert order == ["one", "two", "three"]


def test_forecasts_with_a_machines_own_correction_beat_the_bare_type_on_traces_of_other_days(fleet: Fleet) -> None:
    model, _, held_out = fleet
    for name in ("one", "three", "four"):
        own, days = of_the_type(model, name), held_out[name]
        free = [
            np.mean([errors(open_loop(each, day, "resync"), day, "T").at_samples.mae for day in days])
            for each in (own, model)
        ]
        assert free[0] < 0.85 * free[1], f"{name}: nothing but the events is known, {free}"
    own, days = of_the_type(model, "three"), held_out["three"]
    assert crps(own, days) < crps(model, days), "readings are known too"


def within(model: Model, traces: list[Trace]) -> float:
    """The share of readings in the 90 % band of what events alone say of them, from the first reading on."""
    tracker, held = compile_model(model), []
    for trace in traces:
        readings = trace.signals["T"].tolist()
        belief, events = start(tracker, float(trace.times[0]), readings[0]), list(trace.events)
        for time, reading in zip(trace.times.tolist(), readings, strict=True):
            while events and events[0].time <= time:
                belief = on_event(tracker, belief, events.pop(0))
            belief = advance(tracker, belief, time)
            held.append(abs(reading - belief.x) <= 1.645 * belief.sigma)
    return float(np.mean(held))


def test_the_band_of_a_machine_that_nobody_has_seen_holds_by_the_types_spread(fleet: Fleet) -> None:
    model, *_ = fleet
    effects = tuple(effect for effect in model.sha.effects if effect.kind != "machine-offset")
    alike = replace(model, sha=replace(model.sha, effects=effects))
    for seed, offset in ((77, -8.0), (78, 7.0)):
        new = readings("new", seed, offset)
        assert within(model, new) > 0.85
        assert within(alike, new) < 0.7, "without the spread between machines it would not"


def test_a_machines_model_is_a_model_whose_offset_is_what_is_left_to_learn(fleet: Fleet) -> None:
    model, *_ = fleet
    own = of_the_type(model, "one")
    known = model.machines["one"]
    sigma = {effect.kind: effect.params["sigma"] for effect in own.sha.effects}
    assert sigma["machine-offset"] == known.targets_error and not own.machines
    assert own.provenance.settings["machine"] == "one" and model_hash(own) != model_hash(model)
    for place, its_own in zip(model.sha.locations, own.sha.locations, strict=True):
        if place.flow.kind == "exponential" and place.distribution is not None and its_own.distribution is not None:
            shift = its_own.distribution.params["mu"] - place.distribution.params["mu"]
            assert shift == pytest.approx(known.targets)
    assert own.sha.low <= model.sha.low < model.sha.high <= own.sha.high
    with pytest.raises(ValueError, match="knows no machine 'five'; it knows four, one, three, two"):
        of_the_type(replace(model, machines=dict(sorted(model.machines.items()))), "five")


def test_the_sensors_correction_comes_after_the_types(fleet: Fleet) -> None:
    machines = {"m": MachineCorrection(gain=2.0, offset=-1.0)}
    model = replace(fleet[0], correction=Correction(1.5, 3.0), machines=machines)
    assert of_the_type(model, "m").correction == Correction(3.0, 5.0)


def test_machines_go_through_json_and_a_model_without_them_keeps_its_hash(fleet: Fleet) -> None:
    model, learned, _ = fleet
    assert parse_model(model_text(model)).machines == model.machines
    assert model_hash(replace(model, machines={})) == model_hash(learned.model) != model_hash(model)
    text = model_text(model)
    for before, after, words in (
        ('"gain": 1.0', '"gain": -1.0', "positive gain"),
        ('"targets_error": ', '"targets_err": ', "targets_err"),
    ):
        with pytest.raises(ArtefactError, match=words):
            parse_model(text.replace(before, after, 1))
    law = Distribution("weibull", {"shape": 2.0, "scale": 40.0})
    places = [
        replace(place, distribution=law) if place.flow.kind == "exponential" and place.distribution else place
        for place in model.sha.locations
    ]
    strange = replace(model, sha=replace(model.sha, locations=tuple(places)))
    with pytest.raises(ArtefactError, match="cannot shift a weibull law"):
        model_text(strange)


def test_a_sensor_that_reads_too_much_gets_its_gain_where_enough_days_show_it(fleet: Fleet) -> None:
    model, *_ = fleet
    mean = float(np.mean(list(OFFSETS.values())))
    for gain in (1.0, 1.25):
        days = of_machine("m", mean, 5, cycles=6)
        traces = [with_signal(day, T=gain * day.signals["T"]) for day in days]
        spread = MachineSpread({"m": 0.0}, 1.0, 2.0, {"m": 0.1})
        own = machine_corrections(replace(model, machines={}), traces, spread)["m"]
        assert abs(own.targets) < 0.1 and own.gain * 50.0 + own.offset == pytest.approx(gain * 50.0, abs=4.0)


def test_machines_that_are_alike_have_nothing_of_their_own(fleet: Fleet) -> None:
    _, learned, held_out = fleet
    alike = replace(learned.spread, between=0.0, sigma=0.0)
    assert machine_corrections(learned.model, held_out["one"], alike) == {}


def test_what_lsha_learns_of_several_machines_is_a_model_of_their_type_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without_bands(monkeypatch)
    offsets = {"one": -6.0, "two": 0.0, "three": 6.0}
    traces = [trace for seed, name in enumerate(offsets) for trace in of_machine(name, offsets[name], 10 + seed)]
    settings = LshaSettings(default_flow="exponential", memory="context")
    learned = lsha.learn_lsha(traces, DECANTER, "T", seed=0, settings=settings)
    model = replace(learned.model, machines=machine_corrections(learned.model, traces, learned.spread))
    assert learned.spread.between == pytest.approx(6.0, rel=0.3)
    assert [round(model.machines[name].targets / 6.0) for name in offsets] == [-1, 0, 1]
    for name in ("one", "three"):
        days = of_machine(name, offsets[name], 60)
        free = [
            np.mean([errors(open_loop(each, day, "resync"), day, "T").at_samples.mae for day in days])
            for each in (of_the_type(model, name), model)
        ]
        assert free[0] < 0.6 * free[1], f"{name}: {free}"
