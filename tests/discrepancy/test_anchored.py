"""What the fitted cycles hardly show of a model is kept as it was given."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import build_frame, build_record, fit, with_priors
from sim.lab.discrepancy.fitting.baseline import Frame
from sim.sha.events import encode
from tests.discrepancy.plants import ALPHABET, TARGETS, model, plant


def frame_with_high(rows: int) -> Frame:
    """Two days at low current but for so many rows at high one, in the middle of a run; the reading knows of none."""
    trace = plant(5, days=2)
    low = np.minimum(trace.signals["Assorbimento"], 150.0)
    begin = int(np.flatnonzero(np.diff(trace.signals["MarciaDecanter"]) > 0)[1]) + 60
    low[begin : begin + rows] = 250.0
    changed = replace(trace, signals={**trace.signals, "Assorbimento": low}, events=())
    return build_frame(build_record(model(), [replace(changed, events=encode(changed, ALPHABET))], ()))


def test_a_location_of_two_minutes_keeps_its_target() -> None:
    frame = frame_with_high(4)
    kept = with_priors(frame)
    high = frame.names.targets.index("HIGH")
    assert kept.shape.spread[high] == pytest.approx(0.5)  # what the model says of itself
    assert np.delete(kept.shape.spread, high) == pytest.approx(np.delete(frame.shape.spread, high))
    # LOW shows the rate that it shares with HIGH.
    assert kept.shape.rate_spread == pytest.approx(frame.shape.rate_spread)
    assert fit(kept).state.linear[high] == pytest.approx(TARGETS["HIGH"][0], abs=0.6)
    assert abs(fit(frame).state.linear[high] - TARGETS["HIGH"][0]) > 2.0


def test_a_target_of_which_the_given_model_knows_little_is_fitted_all_the_same() -> None:
    frame = frame_with_high(4)
    places = tuple(
        replace(place, distribution=replace(place.distribution, params={**place.distribution.params, "sigma": 50.0}))
        for place in frame.record.model.sha.locations
        if place.distribution is not None
    )
    vague = replace(frame.record.model, sha=replace(frame.record.model.sha, locations=places))
    frame = replace(frame, record=replace(frame.record, model=vague))
    assert with_priors(frame).shape.spread == pytest.approx(frame.shape.spread)


def test_a_location_of_a_quarter_of_an_hour_is_fitted() -> None:
    frame = frame_with_high(30)
    assert with_priors(frame).shape.spread == pytest.approx(frame.shape.spread)
    assert fit(with_priors(frame)).state.linear[frame.names.targets.index("HIGH")] < TARGETS["HIGH"][0] - 5.0
