"""One plant in rows of any length: the same cycles, the same levels, nothing unknown, nothing strange to its model."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from sim.familiarity import PointSource, cycle_points, fit_reference
from sim.lab.recordings import split_cycles, with_thresholds
from sim.lab.recordings.alphabet_table import DECANTER_AUTO
from sim.lab.recordings.auto_thresholds import with_gap
from sim.plant import production
from sim.sha import DECANTER, Alphabet, Bins, Trace, encode

LEVELS = ((6, 0.4), (9, 150.0), (9, 95.0), (6, 0.4), (12, 95.0), (6, 150.0))
"""(hours, amperes): two runs a day of two loads each."""
DAYS, STEPS = 4, (1.0, 5.0, 10.0, 30.0, 60.0, 300.0, 600.0, 3600.0)


@pytest.fixture(scope="module")
def plant() -> Trace:
    seconds = np.arange(0.0, DAYS * 24 * 3600.0)
    rng = np.random.default_rng(0)
    ends = np.cumsum([hours for hours, _ in LEVELS]) * 3600.0
    level = np.array([amperes for _, amperes in LEVELS])[np.searchsorted(ends, seconds % ends[-1], side="right")]
    current = level + rng.normal(0.0, 0.8, seconds.size) * (level > 1)
    running = (level > 1).astype(float)
    return Trace("plant", seconds, {"MarciaDecanter": running, "Assorbimento": current})


def in_rows(trace: Trace, step: float) -> Trace:
    """The first row of every `step` s."""
    kept = np.unique(np.floor(trace.times / step), return_index=True)[1]
    return replace(trace, times=trace.times[kept], signals={name: s[kept] for name, s in trace.signals.items()})


def encoded(trace: Trace) -> tuple[Trace, Alphabet]:
    alphabet = with_thresholds(with_gap(DECANTER_AUTO, [trace]), [trace])
    return replace(trace, events=encode(trace, alphabet)), alphabet


@pytest.mark.parametrize("step", STEPS)
def test_cycles_and_levels_are_those_of_the_plant(step: float, plant: Trace) -> None:
    trace, alphabet = encoded(in_rows(plant, step))
    (bins,) = [channel for channel in alphabet.channels if isinstance(channel, Bins)]
    assert len(bins.thresholds) == 2 and 1.0 < bins.thresholds[0] < 95.0 < bins.thresholds[1] < 150.0
    assert "unknown" not in [event.symbol for event in trace.events]
    cycles = split_cycles(trace, alphabet, alphabet.gap)
    assert len(cycles) == DAYS
    starts = [float(cycle.times[0]) for cycle in cycles]
    true = [float(each.times[0]) for each in split_cycles(encoded(in_rows(plant, 10.0))[0], alphabet, inf)]
    assert np.allclose(starts, true, atol=step)


@pytest.mark.parametrize("step", [30.0, 3600.0])
def test_the_days_that_taught_are_familiar(step: float) -> None:
    trace = in_rows(production(5, 4, seed=1, period=30.0), step)
    alphabet = replace(DECANTER, gap=with_gap(DECANTER_AUTO, [trace]).gap)
    trace = replace(trace, events=encode(trace, alphabet))
    cycles = split_cycles(trace, alphabet, alphabet.gap)

    source = PointSource.for_alphabet(alphabet, "TCuscinettiRiduttore")
    points = [cycle_points(trace, source, begin=float(c.times[0]), end=float(c.times[-1])) for c in cycles]
    reference = fit_reference([each.values for each in points])
    strange = [reference.strangeness(each.values, each.times).value for each in points]
    assert len(strange) >= 15 and np.mean(np.array(strange) > 1.0) <= 0.1
