"""What has no name is held beside the names, so that none is given in its place."""

from dataclasses import replace

import numpy as np
import pytest

from sim.discrepancy.fitting import frame_of, heat_and_loss, on, record_of, rivals
from sim.discrepancy.fitting.candidates import catalogue
from sim.discrepancy.fitting.free_run_fit import fit
from sim.discrepancy.fitting.named import Named, effect_of
from sim.discrepancy.naming import step, without_idle_rivals
from sim.discrepancy.workflow import diagnose
from sim.engine.schedules import schedule
from tests.discrepancy.plants import PERIOD, model, plant

CURRENT = {"current": "Assorbimento"}
LATE = {"gain": 1e-7, "reference": 3e4, "power": 2.0, "lag": 300.0}


def test_late_heat_goes_on_after_a_stop_and_no_engine_executes_it() -> None:
    record = record_of(model(), [plant(1, days=1)], ("Assorbimento",))
    effect = effect_of(Named(rivals()[0], CURRENT, LATE), record.model)
    heat, loss = heat_and_loss(record, effect, np.zeros(len(record.runs)))
    stop = int(np.flatnonzero(np.diff(record.running) < 0)[0]) + 1
    assert heat[stop] > 0 and not loss.any()
    assert heat[stop + 5] == pytest.approx(heat[stop] * np.exp(-5 * PERIOD / LATE["lag"]))
    assert "late-current-heating" not in [entry.name for entry in catalogue()]
    made = model()
    with pytest.raises(ValueError, match="late-current-heating"):
        schedule(replace(made, sha=replace(made.sha, effects=(effect,))), [], np.array([0.0, 10.0]))


def test_a_rival_that_does_no_better_than_its_special_case_is_that_case() -> None:
    record = record_of(model(), [plant(3, days=2)], ("Assorbimento",))
    base = fit(on(frame_of(record), record))
    few = [entry for entry in catalogue() if entry.name == "quadratic-current-heating"]
    found = step(base, [*few, *rivals()], CURRENT, 0).before
    (special,) = step(found, few, CURRENT, 0).evidence
    (rival,) = (replace(special, entry=entry, gain=special.gain) for entry in rivals())
    for ahead, left in ((5.0, 1), (7.0, 2)):
        evidence = [special, replace(rival, gain=special.gain + ahead)]
        assert len(without_idle_rivals(evidence)) == left


def test_the_heat_of_a_winding_is_no_lag_of_the_sensor() -> None:
    found = diagnose(model(), [plant(2, winding=0.006)], seed=0).diagnosis
    assert {name for effect in found.effects for name in effect.members} <= {"quadratic-current-heating"}
