"""What comes late across a gap of the recorder: when in it the load changed is not known."""

from dataclasses import replace

import numpy as np

from sim.lab.discrepancy.fitting.effects import deviation, lagged_signal
from sim.lab.discrepancy.fitting.record import Record, build_record
from sim.sha.automaton import Effect
from sim.sha.events import encode
from tests.discrepancy.plants import ALPHABET, PERIOD, model, plant

LATE = Effect("late-current-heating", {"gain": 1e-4, "reference": 200.0, "lag": 120.0}, {"current": "Assorbimento"})


def recorded(hours_lost: float) -> tuple[Record, float]:
    """A record that lacks the last minutes before its first stop and some hours after it, and when it goes on."""
    trace = plant(3, days=1)
    stop = int(np.flatnonzero(np.diff(trace.signals["MarciaDecanter"]) < 0)[0])
    kept = np.ones(trace.times.size, dtype=bool)
    end = stop + int(hours_lost * 3600.0 / PERIOD)
    kept[stop - 5 : end] = False
    signals = {name: column[kept] for name, column in trace.signals.items()}
    rows = replace(trace, times=trace.times[kept], signals=signals, events=())
    return build_record(model(), [replace(rows, events=encode(rows, ALPHABET))], ("Assorbimento",)), float(
        trace.times[end]
    )


def test_no_heat_of_before_a_gap_comes_after_it() -> None:
    record, resumed = recorded(0.7)
    late = deviation(record, LATE)
    after = (record.runs.time > resumed) & (record.runs.time < resumed + 900.0)
    before = record.runs.time < resumed - 0.7 * 3600.0
    assert np.count_nonzero(after) > 5
    np.testing.assert_allclose(late[after], 0.0, atol=1e-9)
    assert np.abs(late[before]).max() > 1e-3


def test_a_lagged_signal_begins_after_a_gap_with_what_is_read_there() -> None:
    record, resumed = recorded(0.7)
    late = lagged_signal(record, record.history("Assorbimento"), 600.0)
    after = (record.runs.time >= resumed) & (record.runs.time < resumed + 900.0)
    np.testing.assert_allclose(late[after], 0.0, atol=1e-9)
