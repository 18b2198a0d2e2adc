"""Which parameters are said to have moved."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import Fitted, build_frame, build_record, fit, move_frame, with_priors
from sim.lab.discrepancy.moved import shifts
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.story import verdict_sentence
from sim.sha import Model
from sim.sha.events import encode
from tests.discrepancy.plants import ALPHABET, model, plant
from tests.discrepancy.test_anchored import frame_with_high


def of_one_rate(k: float) -> Model:
    """The plant's model with one rate (1/s) for all its locations, OFF among them, as a learner ties them."""
    given = model()
    locations = tuple(
        replace(each, flow=replace(each.flow, params={**each.flow.params, "k": k})) for each in given.sha.locations
    )
    return replace(given, sha=replace(given.sha, locations=locations))


def never_off(k: float) -> Fitted:
    """Two days, without a stop, of a plant whose rate is 1/1500 s, fitted from one rate `k`."""
    ran = plant(5, days=2, runs_on=True)
    on_rows = ran.signals["MarciaDecanter"] > 0
    signals = {name: column[on_rows] for name, column in ran.signals.items()}
    kept = replace(ran, times=ran.times[on_rows], signals=signals, events=())
    record = build_record(of_one_rate(k), [replace(kept, events=encode(kept, ALPHABET))], ())
    assert {record.model.sha.locations[place].name for place in record.runs.place.tolist()} == {"LOW", "HIGH"}
    return fit(with_priors(move_frame(build_frame(record), record)))


def test_a_rate_that_moved_is_said_of_a_location_in_which_the_machine_was() -> None:
    found = shifts(never_off(1 / 700), RULES)
    rates = [each for each in found if each.parameter == "k"]
    assert [each.location for each in rates] == ["LOW"]
    assert rates[0].after == pytest.approx(1 / 1500, rel=0.2)
    assert "OFF" not in {each.location for each in found}


@pytest.mark.parametrize(("rows", "told"), [(4, False), (30, True)])
def test_only_of_a_location_that_the_record_shows_a_target_is_said_to_have_moved(rows: int, told: bool) -> None:
    """Two minutes, and a quarter of an hour, at high current in two days: the fit is surely off in both."""
    fitted = fit(frame_with_high(rows))
    high = fitted.frame.names.targets.index("HIGH")
    off = fitted.off.copy()
    off[high] = 10.0 * np.sqrt(2.0 * fitted.covariance[high, high])
    assert ("HIGH" in {each.location for each in shifts(replace(fitted, off=off), RULES)}) is told


@pytest.mark.parametrize(
    ("heights", "said"), [(0.1, "target in HIGH +4.5 °C (+10%)"), (-2.8, "target in HIGH -126 °C, ")]
)
def test_a_target_moves_by_degrees_and_by_a_share_where_that_says_something(heights: float, said: str) -> None:
    """HIGH stands 45 degC above rest; a transformer's target was said to have moved by -280 %."""
    fitted = fit(frame_with_high(30))
    high = fitted.frame.names.targets.index("HIGH")
    off = np.zeros_like(fitted.off)
    off[high] = heights * 45.0
    covariance = np.where(np.arange(off.size) == high, 1e-4, 1e4)
    found = shifts(replace(fitted, off=off, covariance=np.diag(covariance)), RULES)
    assert [each.location for each in found] == ["HIGH"]
    assert found[0].change == (pytest.approx(0.1) if heights == 0.1 else None)
    sentence = verdict_sentence("agree", (), unexplained=(), shifts=found, held=None, cycles=6, unit="°C")
    assert said in sentence and "280" not in sentence
