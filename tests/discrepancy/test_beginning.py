"""A gap that begins half-way, through the whole workflow: dated, and said in the sentence."""

from dataclasses import replace

import numpy as np

from sim.discrepancy import beginning_sentence, diagnose
from sim.engine import linear_recursion
from tests.discrepancy.plants import model, plant

PERIOD, BEGINS, PUT = 60.0, 2.2 * 86400.0, 8.0 / 3600.0
"""Seconds between rows, the time (s) from which the running machine makes more heat, and how much (degC/s)."""


def test_a_heat_that_begins_half_way_is_dated_whatever_name_was_tried_for_it() -> None:
    trace = plant(4, days=5, period=PERIOD)
    on, since = trace.signals["MarciaDecanter"] > 0.5, trace.times - trace.times[0]
    keep = np.exp(-PERIOD * np.where(on, 1 / 1500, 1 / 3600))
    added = linear_recursion(keep, PERIOD * np.where(on & (since > BEGINS), PUT, 0.0), 0.0)
    signals = {**trace.signals, "T": np.round(trace.signals["T"] + added, 1)}
    found = diagnose(model(), [replace(trace, signals=signals)], seed=0).diagnosis
    assert found.began is not None and found.began.running and found.began.moves > 1.0
    low, high = found.began.interval
    assert low - trace.times[0] <= BEGINS <= high - trace.times[0]
    assert (found.began.before, found.began.after) == (6, 9)
    assert beginning_sentence(found.began, "°C") in found.sentence
    # The picture shows it by itself.
    heat = found.missing_heat
    assert heat is not None
    late = heat.times - trace.times[0] > BEGINS
    more = np.mean(heat.mean[heat.running & late]) - np.mean(heat.mean[heat.running & ~late])
    assert abs(more - 8.0) < 1.5
