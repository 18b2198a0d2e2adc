"""The revision of the names that were taken."""

from dataclasses import replace

from sim.discrepancy.baseline import frame_of, on
from sim.discrepancy.catalogue import CATALOGUE
from sim.discrepancy.fit import fit
from sim.discrepancy.naming import confirm, step
from sim.discrepancy.path import revised
from sim.discrepancy.record import record_of
from tests.discrepancy.plants import model, plant


def test_a_name_that_adds_nothing_beside_the_others_is_dropped_and_the_others_stay() -> None:
    present = {"pump": "MarciaPmpFango"}
    record = record_of(model(), [plant(3, pump=2e-4)], tuple(present.values()))
    base = fit(on(frame_of(record), record))
    superfluous = step(base, [one for one in CATALOGUE if one.name == "startup-churning"], present, 0)
    assert superfluous.best is not None
    churning = confirm(base, superfluous.best)
    assert churning.fitted is not None
    superfluous = replace(superfluous, evidence=(churning,))
    pump = step(churning.fitted, [one for one in CATALOGUE if one.name == "pump-cooling"], present, 0)
    assert pump.best is not None and pump.best.fitted is not None
    judged, fitted = revised(pump.best.fitted, [(superfluous, ""), (pump, "")], present, 0, 1)
    assert [one.entry.name for one in fitted.state.named] == ["pump-cooling"]
    assert [(one.best.entry.name, refusal) for one, refusal in judged if one.best] == [("pump-cooling", "")]
    assert len(judged) == 1
