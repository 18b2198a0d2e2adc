"""What has no name is held beside the names, so that none is given in its place."""

from dataclasses import replace

import numpy as np
import pytest

from sim.discrepancy import naming
from sim.discrepancy.fitting import frame_of, heat_and_loss, on, record_of, rivals
from sim.discrepancy.fitting.candidates import catalogue
from sim.discrepancy.fitting.free_run_fit import fit
from sim.discrepancy.fitting.named import Named, effect_of
from sim.discrepancy.naming import begins, step, without_idle_rivals
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


def test_a_special_case_stands_for_its_rival_where_it_says_a_good_part_and_goes_better_than_every_other_name() -> None:
    record = record_of(model(), [plant(3, days=1)], ("Assorbimento",))
    base = fit(on(frame_of(record), record))
    wanted = ("quadratic-current-heating", "sensor-lag")
    few = [entry for entry in catalogue() if entry.name in wanted]
    by_name = {each.entry.name: each for each in step(base, [*few, *rivals()], CURRENT, 0).evidence}
    special, lag = (replace(by_name[name], fitted=base) for name in wanted)
    rival = replace(special, entry=rivals()[0])

    def kept(of_special: float, of_rival: float, of_lag: float) -> bool:
        gains = ((special, of_special), (rival, of_rival), (lag, of_lag))
        left = without_idle_rivals([replace(each, gain=gain) for each, gain in gains])
        return any(each.entry.candidate.rival for each in left)

    assert not kept(150.0, 345.0, 126.0)
    assert kept(100.0, 345.0, 50.0)
    assert kept(150.0, 345.0, 146.0)
    unfitted = [replace(special, gain=150.0, fitted=None), replace(rival, gain=345.0)]
    assert len(without_idle_rivals(unfitted)) == 2


def test_a_rivals_special_cases_are_fitted_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(naming, "CONFIRMED", 1)
    record = record_of(model(), [plant(3, days=2, winding=0.01)], ("Assorbimento",))
    special = rivals()[0].candidate.rival
    few = [entry for entry in catalogue() if entry.name in special]
    found = step(fit(on(frame_of(record), record)), [*few, *rivals()], CURRENT, 0)
    assert {each.entry.name for each in found.evidence if each.confirmed} == {*special, "late-current-heating"}


def test_where_the_plant_is_rough_and_the_sensor_may_err_for_long_a_fit_begins_from_a_quiet_plant_too() -> None:
    record = record_of(model(), [plant(3, days=1)], ("Assorbimento",))
    fitted = fit(on(frame_of(record), record))
    rough = replace(fitted, noise=replace(fitted.noise, process=0.1))
    assert begins(rough) == (rough,)
    lasting = replace(rough, noise=replace(rough.noise, lasting=0.3))
    same, quiet = begins(lasting)
    assert same is lasting and quiet.state is lasting.state
    assert quiet.noise.process < 0.01 and quiet.noise.lasting > 0
    assert begins(quiet) == (quiet,)


def test_the_heat_of_a_winding_is_no_lag_of_the_sensor() -> None:
    found = diagnose(model(), [plant(2, winding=0.006)], seed=0).diagnosis
    assert {name for effect in found.effects for name in effect.members} <= {"quadratic-current-heating"}
