"""The revision of the names that were taken."""

from dataclasses import replace

import pytest

from sim.lab.discrepancy import path
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame
from sim.lab.discrepancy.fitting.candidates import catalogue, rivals
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.named import Named
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.naming import NamingStep, confirm, entries_besides, likeness, step
from sim.lab.discrepancy.path import Judged, name, revise_names
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from tests.discrepancy.plants import model, plant

PUMP = {"pump": "MarciaPmpFango"}


def test_twins_within_a_hundredth_of_the_gain_are_a_class_and_rivals_are_not() -> None:
    record = build_record(model(), [plant(3, days=2)], ())
    base = fit(move_frame(build_frame(record), record))
    found = step(base, [one for one in catalogue() if one.name in ("dead-time", "sensor-lag")], {}, rules=RULES)
    best, second = found.evidence
    names = (best.entry.name, second.entry.name)
    for behind, cosine, members in ((9.0, 0.95, names), (11.0, 0.95, names[:1]), (9.0, 0.8, names[:1])):
        evidence = replace(best, gain=1000.0), replace(second, gain=1000.0 - behind)
        assert replace(found, evidence=evidence, cosines={names[1]: cosine}).members == members


def test_what_lies_between_what_is_done_and_the_reading_is_named_once() -> None:
    """A lag of first order leaves something of heat that comes through two masses, which the sensor would mend."""
    chain = {"dead-time", "sensor-lag", "late-current-heating"}
    for entry in catalogue():
        left = {one.name for one in entries_besides([Named(entry, {}, {})])}
        assert not left & chain if entry.name in chain else chain <= left


@pytest.fixture(scope="module")
def two_names() -> tuple[NamingStep, NamingStep]:
    """Churning, which is not there, and beside it the pump, which is."""
    record = build_record(model(), [plant(3, days=2, pump=2e-4)], tuple(PUMP.values()))
    base = fit(move_frame(build_frame(record), record))
    superfluous = step(base, [one for one in catalogue() if one.name == "startup-churning"], PUMP, rules=RULES)
    assert superfluous.best is not None
    churning = confirm(base, superfluous.best)
    assert churning.fitted is not None
    pump = step(churning.fitted, [one for one in catalogue() if one.name == "pump-cooling"], PUMP, rules=RULES)
    return replace(superfluous, evidence=(churning,)), pump


def looked_at_again(names: tuple[NamingStep, NamingStep]) -> list[Judged]:
    """What is withdrawn when the first of the two names is looked at again; the pump stays alone."""
    superfluous, pump = names
    assert pump.best is not None and pump.best.fitted is not None
    judged, fitted, withdrawn = revise_names(pump.best.fitted, [(superfluous, ""), (pump, "")], PUMP, 1)
    assert [one.entry.name for one in fitted.state.named] == ["pump-cooling"]
    assert [(one.best.entry.name, refusal) for one, refusal in judged if one.best] == [("pump-cooling", "")]
    assert len(judged) == 1
    return withdrawn


def test_a_name_that_adds_nothing_beside_the_others_is_dropped_and_the_others_stay(
    two_names: tuple[NamingStep, NamingStep],
) -> None:
    assert looked_at_again(two_names) == []


def test_a_name_in_whose_place_goes_what_has_none_takes_no_other_down(
    two_names: tuple[NamingStep, NamingStep], monkeypatch: pytest.MonkeyPatch
) -> None:
    pump = two_names[1]
    assert pump.best is not None
    nameless = replace(pump, evidence=(replace(pump.best, entry=rivals()[0], gain=500.0, amplitude=5.0),))
    looks = iter([nameless])
    monkeypatch.setattr(path, "step", lambda *given, **told: next(looks, None) or step(*given, **told))
    assert looked_at_again(two_names) == [(nameless, "goes best with the data, and has no name")]


def test_each_effect_that_is_fitted_is_told_before() -> None:
    """A fit may take many seconds, and a stage has several."""
    record = build_record(model(), [plant(3, days=2, pump=2e-4)], ("MarciaPmpFango",))
    base = fit(move_frame(build_frame(record), record))
    said: list[str] = []
    (found,) = name(
        base, {"pump": "MarciaPmpFango"}, 1, lambda stage, _: said.append(stage), entries=catalogue(), rules=RULES
    )
    fitted = [each.entry.name for each in found.steps[0][0].evidence if each.is_joint]
    assert {f"looking for effect 1: {each}" for each in fitted} <= set(said)
    assert fitted


def test_a_name_that_is_looked_at_again_is_not_taken_for_what_a_later_one_left() -> None:
    """The later one's fit has the very effect in it already: what is left of its shape there is rounding alone."""
    present = {"ambient": "TAmbiente"}
    entries = [one for one in catalogue() if one.name in ("sensor-offset-step", "ambient-coupling")]
    alone = [one for one in entries if one.name == "sensor-offset-step"]
    record = build_record(model(), [plant(1, days=2, offset=1.2, room=0.4)], tuple(present.values()))
    base = fit(move_frame(build_frame(record), record))
    offset = step(base, alone, present, rules=RULES)
    assert offset.best is not None and offset.best.fitted is not None
    room = step(offset.best.fitted, entries, present, rules=RULES)
    assert room.best is not None and room.best.entry.name == "ambient-coupling"
    assert 0.01 < likeness(room, offset.best) < 0.6


def test_more_names_that_are_allowed_never_give_fewer_right_ones() -> None:
    names = {"ambient-coupling", "startup-churning"}
    trace = plant(26, days=4, period=240.0, room=0.4, churning=4e-3)
    one, three = (diagnose(model(), [trace], seed=0, most=most).diagnosis.effects for most in (1, 3))
    assert len(one) == 1 and {effect.name for effect in one} <= {effect.name for effect in three} == names
