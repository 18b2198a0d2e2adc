"""Radiation that stands in for a part of the loss is named, however little loss there is at rest."""

import numpy as np

from sim.lab.discrepancy.diagnosis import Diagnosis
from sim.lab.discrepancy.fitting.baseline import build_frame
from sim.lab.discrepancy.fitting.candidates import catalogue_entry
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.named import Named
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.workflow import diagnose
from tests.discrepancy.plants import model
from tests.discrepancy.valves import plant

ROOM, ZERO, GAIN = 17.0, 273.15, 6e-12


def bent(_time: float, x: float, _signals: dict[str, float]) -> float:
    """Radiates towards ROOM, in the place of a draught that takes as much at 45 degC and is more than all at rest."""
    warm, cold, hot = x + ZERO, ROOM + ZERO, 45.0 + ZERO
    instead = (hot**4 - cold**4) / (hot - cold)
    return float(-GAIN * (warm**4 - cold**4 - instead * (x - ROOM)))


def found_on(seed: int) -> Diagnosis:
    return diagnose(model(), [plant(seed, bent)], seed=0).diagnosis


def test_radiation_in_the_place_of_a_draught_is_no_thermostat() -> None:
    found = found_on(12)
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.params["linear"]) == ("named", "radiation-loss", 1.0)
    assert 0.5 * GAIN < effect.params["gain"] < 2.0 * GAIN
    assert found.held_out is not None
    assert found.held_out.rmse_after < 0.6 * found.held_out.rmse_before


def test_the_rate_at_rest_keeps_what_the_radiation_takes_over() -> None:
    """Whole radiation of that strength would need a rate below nothing at rest."""
    frame = build_frame(build_record(model(), [plant(3, bent, days=3)], ()))
    params = {"gain": 1e-12, "surroundings": ROOM, "walls": 1.0, "linear": 1.0}
    beyond, whole = (
        fit(frame, [Named(catalogue_entry("radiation-loss"), {}, {**params, "linear": linear})])
        for linear in (1.0, 0.0)
    )
    assert beyond.likelihood > whole.likelihood + 10.0
    assert 0.7 * GAIN < beyond.state.named[0].strength < 1.4 * GAIN
    assert np.exp(beyond.state.parameters[frame.count[0]]) > 0.5 / 3600
