"""Traces in the order of their times, and those of which nobody knows when they were recorded."""

from dataclasses import replace

import numpy as np

from sim.lab.discrepancy.fitting.record import MIN_PIECE_ROWS, build_record, find_overlap, in_order
from sim.lab.discrepancy.workflow import diagnose
from sim.sha.events import encode
from sim.sha.trace import Event, Trace
from tests.discrepancy.plants import ALPHABET, model, plant, sparse


def trace(name: str, begin: float, end: float) -> Trace:
    return Trace(name, np.arange(begin, end, 10.0), {}, (Event(begin + 10.0, "W_ON"),))


def test_traces_that_do_not_overlap_are_taken_by_their_times() -> None:
    traces = [trace("second", 5000.0, 6000.0), trace("first", 0.0, 1000.0)]
    assert find_overlap(traces) == ""
    assert [one.name for one in in_order(traces)] == ["first", "second"]
    assert in_order(traces)[1] is traces[0]


def test_traces_that_each_begin_at_zero_are_laid_one_after_the_other_with_their_events() -> None:
    traces = [trace("a", 0.0, 1000.0), trace("b", 0.0, 500.0), Trace("nothing", np.empty(0), {})]
    assert find_overlap(traces) == "b begins before a ends"
    first, second = in_order(traces)
    assert (first.times[0], first.times[-1]) == (0.0, 990.0)
    assert second.times[0] == 990.0 + 3600.0
    assert second.events == (Event(second.times[1], "W_ON"),)


def test_days_without_dates_still_show_when_the_sensor_moved() -> None:
    whole = plant(6, days=3, offset=1.0)
    days = [
        replace(day, name=f"day{number}", times=day.times - day.times[0], events=())
        for number in range(3)
        if (day := whole.between(1.7e9 + 86400.0 * number, 1.7e9 + 86400.0 * (number + 1))).times.size
    ]
    assert len(days) == 3 and find_overlap(days)
    found = diagnose(model(), days, seed=0).diagnosis
    assert [one.name for one in found.effects] == ["sensor-offset-step"]


def test_a_machine_that_runs_on_is_cut_into_pieces_of_several_rows_however_rare_they_are() -> None:
    """Six time constants of 1,500 s are three rows of 50 minutes, as with a transformer that is read by the hour."""
    whole = plant(6, days=40, runs_on=True)
    patient = replace(ALPHABET, gap=7200.0)
    given = replace(model(), alphabet=patient)
    for every in (1, 100):
        rare = sparse(whole, every)
        record = build_record(given, [replace(rare, events=encode(rare, patient))], ())
        pieces, rows = np.unique(record.cycle[record.rows], return_counts=True)
        assert np.median(rows) >= MIN_PIECE_ROWS
        assert pieces.size >= 40
