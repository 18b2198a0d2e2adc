"""The whole diagnosis on small plants: nothing missing is nothing named, a hidden effect is found, named and added."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim.engine.open_loop_run import open_loop
from sim.engine.recursion import linear_recursion
from sim.lab.discrepancy import evidence, judging, path, proving, workflow
from sim.lab.discrepancy.augment import augment_model
from sim.lab.discrepancy.diagnosis import NoiseFloor
from sim.lab.discrepancy.fitting.baseline import build_frame
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.named import model_effects
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.gap import noise_floor
from sim.lab.discrepancy.locate import places
from sim.lab.discrepancy.rules import RULES, DecisionRules
from sim.lab.discrepancy.workflow import DiagnosisOutcome, diagnose
from sim.lab.learning.structure import LearningError
from sim.sha.automaton import Effect, Flow
from tests.discrepancy.plants import PERIOD, model, plant, random_model, simulated

COARSE_S = 60.0
"""A row each so many seconds, where what is asked shows as well: a diagnosis is done in less than half the time."""


@pytest.fixture(scope="module")
def pumped() -> DiagnosisOutcome:
    return diagnose(model(), [plant(3, days=2, pump=2e-4, period=COARSE_S)], seed=0)


@pytest.fixture(scope="module")
def churned() -> DiagnosisOutcome:
    return diagnose(model(), [plant(7, days=2, churning=0.006, period=COARSE_S)], seed=0)


def test_nothing_is_named_where_nothing_is_missing() -> None:
    """`python -m benchmarks.discrepancy` counts over many plants what is named and is not there."""
    found = diagnose(model(), [plant(1, days=2, period=COARSE_S)], seed=0).diagnosis
    assert found.verdict == "agree", found.sentence
    assert found.effects == ()


def test_moved_parameters_are_a_shift_and_no_missing_effect() -> None:
    found = diagnose(model(shift=0.06), [plant(4, days=2, period=COARSE_S)], seed=0).diagnosis
    assert found.verdict == "agree"
    assert {one.location for one in found.shifts if one.parameter == "target"} >= {"LOW", "HIGH"}
    assert all(one.change < 0 for one in found.shifts if one.parameter == "target" and one.location != "OFF")


def test_a_hidden_pump_is_named_with_its_strength_and_the_gap_shrinks(pumped: DiagnosisOutcome) -> None:
    found = pumped.diagnosis
    assert (found.verdict, [one.name for one in found.effects]) == ("named", ["pump-cooling"])
    assert found.effects[0].params["loss"] == pytest.approx(2e-4, rel=0.25)
    assert found.effects[0].margin > 6
    assert found.none_of_these is not None
    assert 0.9 < found.effects[0].confidence <= min(0.99, 1.0 - found.none_of_these)
    held = found.held_out
    assert held is not None
    assert held.rmse_after < 0.6 * held.rmse_before
    assert held.ci95[0] > 0.5


def test_the_heat_is_placed_where_the_pump_runs() -> None:
    record = build_record(model(), [plant(3, pump=2e-4)], ("Assorbimento", "MarciaPmpFango", "TAmbiente"))
    found = places(fit(build_frame(record)), 0, RULES)
    assert found
    assert {one.correlates for one in found} == {"MarciaPmpFango"}


def test_the_augmented_model_runs_as_the_diagnosis_ran(pumped: DiagnosisOutcome) -> None:
    assert pumped.fitted is not None
    fitted = pumped.fitted
    made = augment_model(fitted, name="augmented")
    assert [effect.kind for effect in made.sha.effects] == ["pump-cooling"]
    trace = plant(3, days=2, pump=2e-4, period=COARSE_S)
    record = fitted.frame.record
    cut = trace.between(float(record.runs.time[0]), float(record.runs.time[-1]) + 1.0)
    start = float(fitted.state.course[0])
    signals = {**cut.signals, "T": np.concatenate([[start], cut.signals["T"][1:]])}
    events = tuple(event for event in trace.events if event.time <= cut.times[-1])
    run = open_loop(made, replace(cut, signals=signals, events=events), policy="resync")
    ours = np.interp(run.times, record.runs.time, fitted.state.mean)
    assert np.max(np.abs(run.mean - ours)) < 0.02


def test_an_augmented_model_is_diagnosed_again_and_then_agrees(pumped: DiagnosisOutcome) -> None:
    assert pumped.fitted is not None
    made = augment_model(pumped.fitted)
    assert [one.entry.name for one in model_effects(made)] == ["pump-cooling"]
    again = diagnose(made, [plant(5, days=2, pump=2e-4, period=COARSE_S)], seed=0).diagnosis
    assert again.verdict == "agree", again.sentence


def test_an_offset_of_the_sensor_is_told_from_wear() -> None:
    found = diagnose(model(), [plant(6, days=2, offset=0.8)], seed=0).diagnosis
    assert [one.name for one in found.effects] == ["sensor-offset-step"]
    assert found.effects[0].params["size"] == pytest.approx(0.8, abs=0.25)


def test_churning_of_another_shape_than_the_catalogues_is_recognised(churned: DiagnosisOutcome) -> None:
    assert [effect.name for effect in churned.diagnosis.effects] == ["startup-churning"]


def test_what_is_random_in_the_model_is_no_finding() -> None:
    """A model with heat that has a memory and with an offset of the machine's own, diagnosed on runs of itself."""
    made = random_model(1e-3, 1600.0, 5.0)
    found = diagnose(made, [simulated(made, 10)], seed=0).diagnosis
    assert found.verdict == "agree", found.reasons
    assert (found.effects, found.shifts) == ((), ())
    assert found.settings["rough_sigma"] == pytest.approx(1e-3, rel=0.3)
    assert found.settings["rough_memory_s"] == pytest.approx(1600.0, rel=0.4)
    # The model's own spread is that of a machine whose targets are known: neither more nor less than its error.
    assert found.settings["excess_before"] == pytest.approx(1.0, abs=0.3)


def test_a_hidden_effect_is_named_beside_what_is_random_and_the_new_model_keeps_both() -> None:
    made = random_model(1e-3, 1600.0, 5.0)
    pump = Effect("pump-cooling", {"loss": 2e-4, "sink": 19.0}, {"pump": "MarciaPmpFango"}, locations=("LOW", "HIGH"))
    outcome = diagnose(made, [simulated(random_model(1e-3, 1600.0, 5.0, pump), 10, days=2)], seed=0)
    assert [one.name for one in outcome.diagnosis.effects] == ["pump-cooling"]
    assert outcome.diagnosis.effects[0].params["loss"] == pytest.approx(2e-4, rel=0.25)
    assert outcome.fitted is not None
    new = augment_model(outcome.fitted).sha
    cooling, heat, machine = new.effects
    assert (cooling.kind, heat.kind, machine) == ("pump-cooling", "heat-disturbance", made.sha.effects[1])
    assert heat.params["sigma"] == pytest.approx(1e-3, rel=0.3)
    # The heat is an effect of the new model, and so not in the noise of its flows as well.
    assert all(place.flow.params["noise"] < 0.006 for place in new.locations)


def test_a_sensors_error_that_lasts_is_not_counted_twice() -> None:
    """The new model keeps the error's memory, so its size must be that of one reading and not of what lasts."""
    made, trace, rng = (
        replace(model(), sensor_sigma=0.5, sensor_memory=20.0),
        plant(1, days=2),
        np.random.default_rng(2),
    )
    keep = np.exp(-PERIOD / 20.0)
    fresh = 0.5 * np.sqrt(1.0 - keep**2) * rng.standard_normal(trace.times.size)
    trace = replace(trace, signals={**trace.signals, "T": trace.signals["T"] + linear_recursion(keep, fresh, 0.0)})
    fitted = fit(build_frame(build_record(made, [trace], ())))
    assert augment_model(fitted).sensor_memory == 20.0
    assert fitted.sensor_sigma == pytest.approx(0.5, rel=0.1)


def test_heat_that_is_rougher_than_the_model_has_learned_is_a_gap() -> None:
    made = random_model(3e-4, 400.0, 0.5)
    found = diagnose(made, [simulated(random_model(2.5e-3, 400.0, 0.5), 10, days=2)], seed=0).diagnosis
    assert found.verdict == "unexplained"
    assert found.effects == ()


def test_a_feed_that_acts_by_itself_and_not_by_the_difference_from_the_bearing_is_named_as_what_it_is() -> None:
    found = diagnose(model(), [plant(6, days=2, bowl=2e-4)], seed=0).diagnosis
    assert (found.verdict, [one.name for one in found.effects]) == ("named", ["feed-temperature-coupling"])
    assert found.held_out is not None and found.held_out.rmse_after < 0.5 * found.held_out.rmse_before


def test_a_room_that_counts_for_more_while_the_machine_runs_is_told_with_its_share_at_rest() -> None:
    outcome = diagnose(model(), [plant(6, days=2, room=0.5, period=COARSE_S)], seed=0)
    found = outcome.diagnosis
    assert (found.verdict, [one.name for one in found.effects]) == ("named", ["ambient-coupling"])
    # Heat is lost at 1/3600 s at rest and at 1/1500 s running.
    assert found.effects[0].params["gain"] == pytest.approx(0.5 / 1500, rel=0.25)
    assert found.effects[0].params["at_rest"] == pytest.approx(1500 / 3600, rel=0.3)
    assert found.held_out is not None and found.held_out.excess_removed is not None
    assert found.held_out.excess_removed > 0.95
    assert outcome.fitted is not None
    turning, resting = augment_model(outcome.fitted).sha.effects
    assert (turning.kind, turning.locations) == ("ambient-coupling", ("LOW", "HIGH"))
    assert (resting.kind, resting.locations) == ("ambient-coupling", ("OFF",))
    assert resting.params["gain"] == pytest.approx(turning.params["gain"] * found.effects[0].params["at_rest"])


@pytest.mark.parametrize(("share", "verdict"), [(0.5, "named"), (1.5, "unexplained")])
def test_what_the_held_out_gap_is_made_of_is_named_however_little_it_does_to_the_fitted_cycles(
    share: float, verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (evidence, judging):
        monkeypatch.setattr(module, "immaterial", lambda _step: True)
    rules = DecisionRules(gap_itself_least_share=share)
    found = diagnose(model(), [plant(3, days=2, pump=2e-4, period=COARSE_S)], seed=0, rules=rules).diagnosis
    assert found.verdict == verdict
    assert [one.name for one in found.effects] == ["pump-cooling"] * (verdict == "named")
    assert [one.name for one in found.traces] == ["pump-cooling"] * (verdict != "named")


def test_what_the_held_out_gap_is_made_of_is_named_though_the_fitted_cycles_contradict_one_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(path, "dubious", lambda _step: "does not carry over from cycle to cycle")
    found = diagnose(model(), [plant(3, days=2, pump=2e-4, period=COARSE_S)], seed=0).diagnosis
    assert (found.verdict, [one.name for one in found.effects]) == ("named", ["pump-cooling"])


def test_what_names_leave_of_held_out_cycles_bounds_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A floor that was told too high hides nothing that cycles outside the fit foresee better with a name."""

    def too_high(*given: Any) -> NoiseFloor:
        floor = noise_floor(*given)
        low, high = floor.interval
        return replace(floor, error=20 * floor.error, interval=(20 * low, 20 * high), per_cycle=20 * floor.per_cycle)

    monkeypatch.setattr(proving, "noise_floor", too_high)
    found = diagnose(model(), [plant(3, days=2, pump=2e-4, period=COARSE_S)], seed=0).diagnosis
    assert (found.verdict, [one.name for one in found.effects]) == ("named", ["pump-cooling"])
    held, floor = found.held_out, found.floor
    assert held is not None and floor is not None
    assert held.rmse_after == pytest.approx(held.noise_floor) == pytest.approx(floor.error)
    assert held.rmse_before > floor.interval[1] > floor.error > floor.interval[0]
    assert floor.source == "what the names leave of the held-out cycles"
    clean = diagnose(model(), [plant(3, days=2, period=COARSE_S)], seed=0).diagnosis
    assert clean.verdict != "named" and clean.floor is not None and clean.floor.source != floor.source


def test_a_machine_that_runs_on_is_diagnosed_by_pieces_of_its_run() -> None:
    found = diagnose(model(), [plant(3, days=2, pump=2e-4, runs_on=True, period=COARSE_S)], seed=0).diagnosis
    assert (found.verdict, [one.name for one in found.effects]) == ("named", ["pump-cooling"])
    assert found.effects[0].params["loss"] == pytest.approx(2e-4, rel=0.25)
    # Its evidence is in pieces; of cycles there is one, and that is what is counted as one.
    assert found.held_out is not None and (found.held_out.cycles, found.held_out.pieces >= 3) == (1, True)


def test_a_cycle_or_two_are_too_little() -> None:
    found = diagnose(model(), [plant(8, days=1)], seed=0).diagnosis
    assert found.verdict == "too-little-data"
    assert "too little" in found.sentence.lower()


def test_a_temperature_that_never_changes_tells_nothing() -> None:
    trace = plant(8, days=2, period=240.0)
    still = replace(trace, signals={**trace.signals, "T": np.full(trace.times.size, 34.5)})
    found = diagnose(model(), [still], seed=0).diagnosis
    assert (found.verdict, found.shifts, found.held_out) == ("too-little-data", (), None)
    assert found.sentence == (
        "Too little data: each of the 720 readings of T is 34.5 °C. What never changes tells nothing of the machine: "
        "look at its sensor."
    )


def test_what_explains_the_fitted_cycles_is_told_where_model_and_data_agree_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    why = "the held-out cycles are no nearer with it"
    monkeypatch.setattr(proving, "doubts", lambda *_, **__: (why,))
    monkeypatch.setattr(proving, "matters", lambda *_: False)
    monkeypatch.setattr(workflow, "unnamed_laws", lambda *_: ())
    found = diagnose(model(), [plant(6, days=3, pump=1e-4, period=240.0)], seed=0, most=1).diagnosis
    assert found.verdict == "agree" and found.effects == ()
    (reason,) = found.reasons
    assert reason.startswith("pump-cooling explains the fitted cycles better by") and reason.endswith(why)


def test_missing_signals_take_their_effects_off_the_table_and_the_report_says_which(pumped: DiagnosisOutcome) -> None:
    assert "TFango" in pumped.diagnosis.untested["feed-temperature-coupling"]
    assert "pump-cooling" not in pumped.diagnosis.untested


def test_the_same_seed_gives_the_same_diagnosis(churned: DiagnosisOutcome) -> None:
    again = diagnose(model(), [plant(7, days=2, churning=0.006, period=COARSE_S)], seed=0).diagnosis
    assert again.effects == churned.diagnosis.effects
    assert again.held_out == churned.diagnosis.held_out


def test_traces_without_the_temperature_get_a_sentence() -> None:
    trace = plant(9, days=1)
    bare = replace(trace, signals={name: column for name, column in trace.signals.items() if name != "T"})
    with pytest.raises(LearningError, match="no trace has a reading of 'T'"):
        diagnose(model(), [bare], seed=0)


def test_a_transient_about_a_drawn_temperature_is_refused_by_name() -> None:
    """What such a location adds on entry would be taken for heat, and its amplitude for the law of X."""
    plain = model()
    flow = Flow("transient", {"tau": 60.0, "m": -2.0, "noise": 0.0})
    places = tuple(replace(place, flow=flow, entry="resample") for place in plain.sha.locations)
    odd = replace(plain, sha=replace(plain.sha, locations=places))
    with pytest.raises(LearningError, match=f"location '{places[0].name}' has a transient flow about a temperature"):
        diagnose(odd, [plant(9, days=1)], seed=0)
