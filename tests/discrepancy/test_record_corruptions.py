"""Whatever a recorder does to its rows, a record is made of them, holds what every record does, and can be followed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.discrepancy.corrupted.cases import DROPPED, CorruptedRecord
from benchmarks.discrepancy.corrupted.habits import CORRUPTIONS, FAULTS, only
from sim.lab.discrepancy.fitting import build_frame, build_record, fit, in_order, move_frame, patiently, window_grid
from sim.lab.discrepancy.fitting.course import run_free
from sim.lab.discrepancy.fitting.record import Record, RecordFault, record_faults
from sim.lab.discrepancy.gap import noise_floor
from sim.lab.discrepancy.held_out import compare_fits, let_run
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from sim.lab.learning import LearningError
from sim.sha.trace import Trace
from tests.discrepancy.plants import model, plant, sparse

SIGNALS = ("Assorbimento", "MarciaPmpFango", "TAmbiente")


def records() -> list[list[Trace]]:
    """Five small records: usual, slow, of three days by themselves, of a machine that runs on, and of few starts."""
    days = plant(2, days=3, period=60.0)
    begin = float(days.times[0])
    by_day = [replace(days.between(begin + 86400.0 * day, begin + 86400.0 * (day + 1)), events=()) for day in range(3)]
    return [
        [plant(1, days=2, period=60.0)],
        [sparse(plant(3, days=2, period=30.0), 6)],
        [replace(day, name=f"day{number}") for number, day in enumerate(by_day)],
        [plant(4, days=2, runs_on=True, period=60.0)],
        [plant(5, days=1, period=30.0)],
    ]


def corrupted(traces: Sequence[Trace], seed: int) -> list[Trace]:
    """The traces after one to three habits of a recorder; some also cut where a clock went back to nought."""
    rng = np.random.default_rng(seed)
    habits = tuple(CORRUPTIONS.values())
    chosen = rng.choice(len(habits), size=rng.integers(1, 4), replace=False)
    out = []
    for trace in traces:
        made = replace(trace, events=())
        for number in chosen:
            if made.times.size > 2:
                made = habits[number](rng, made)
        out.append(made)
    if rng.random() < 0.1 and out[0].times.size > 10:
        at = float(out[0].times[rng.integers(1, out[0].times.size)])
        before, after = out[0].between(-np.inf, at), out[0].between(at, np.inf)
        out[:1] = [before, replace(after, name="again", times=after.times - after.times[0] + before.times[0])]
    return out


def followed(traces: Sequence[Trace], seed: int, *, fits: bool) -> str:
    """What becomes of a record: "" where it is followed to its held-out cycles, else why it cannot be used."""
    try:
        laid_out = [patiently(trace, model().alphabet) for trace in in_order(traces)]
        record = build_record(model(), laid_out, SIGNALS, windows=300)
    except LearningError as error:
        return str(error)
    cycles = np.unique(record.window_cycle)
    last = cycles[min(max(round(0.7 * cycles.size), 1), cycles.size - 1)]
    parts = [record, record.by_cycles(), record.select(record.cycle >= last).by_cycles()]
    parts += [record.select(record.cycle < last)] if cycles.size > 1 else []
    for part in parts:
        assert not record_faults(part)
        assert np.isfinite(part.times).all() and np.isfinite(part.reading).all()
        assert part.window_first.sum() == part.runs.run[-1] + 1
        frame = build_frame(part)
        state = run_free(frame, *np.split(frame.centre, [frame.count[0]]), part.reading[part.window_first])
        grid = window_grid(frame, state)
        assert np.isfinite(state.mean).all() and (grid.dt > 0).all()
        assert np.isfinite(grid.heats).all() and np.isfinite(grid.late).all() and (grid.late > -1e-12).all()
    if fits and cycles.size > 1:
        base = fit(move_frame(build_frame(record), parts[3]), rounds=1, iterations=2)
        assert np.isfinite(let_run(base, parts[2]).residual).all()
        stated = np.full(np.unique(base.frame.record.whole).size, 0.06)
        held, _, _ = compare_fits(base, base, parts[2], seed, noise_floor(stated, base, parts[2], seed, RULES))
        assert np.isfinite(held.rmse_before)
    return ""


def test_no_habit_of_a_recorder_is_an_error() -> None:
    traces = records()
    for seed in range(150):
        assert followed(corrupted(traces[seed % 5], seed), seed, fits=seed % 10 == 0) == ""


@pytest.mark.parametrize("fault", FAULTS)
def test_what_befell_a_sensor_or_a_signal_is_no_error(fault: str) -> None:
    """What cannot be followed is said in one sentence."""
    for seed, traces in enumerate(records()):
        made = [FAULTS[fault](np.random.default_rng([seed, 1]), replace(trace, events=())) for trace in traces]
        assert "\n" not in followed(made, seed, fits=False)


@pytest.mark.parametrize("seed", [3, 6, 8, 10, 12])
def test_what_a_recorder_did_ends_no_diagnosis(seed: int) -> None:
    traces = [plant(6, days=2, pump=2e-4, period=60.0)]
    found = diagnose(model(), corrupted(traces, seed), seed=0, most=1).diagnosis
    assert found.sentence and found.held_out is not None and np.isfinite(found.held_out.rmse_after)


@pytest.mark.parametrize(
    ("record", "number"),
    [
        ("nothing missing", 0),
        ("cooled by its pump", 0),
        ("a part exchanged half-way", 0),
        ("churning after starts", 12),
    ],
)
def test_two_rows_of_a_hundred_that_are_missing_change_neither_verdict_nor_first_name(record: str, number: int) -> None:
    """Of the last one a name was withheld, since on three cycles the model as given was by a hundredth nearer."""
    said = []
    for one in (CorruptedRecord(record), CorruptedRecord(record, DROPPED, number)):
        found = diagnose(model(), [one.trace()], seed=0, most=1).diagnosis
        said.append((found.verdict, [effect.name for effect in found.effects]))
    assert said[0] == said[1]


def test_a_row_that_is_missing_before_a_start_ends_no_diagnosis_and_changes_no_name() -> None:
    trace = plant(6, days=2, pump=2e-4, period=60.0)
    starts = np.flatnonzero(np.diff(trace.signals["MarciaDecanter"]) > 0)
    without = only(trace, np.delete(np.arange(trace.times.size), starts[-1]))
    whole, less = (diagnose(model(), [each], seed=0, most=1).diagnosis for each in (trace, without))
    assert [effect.name for effect in whole.effects] == [effect.name for effect in less.effects] == ["pump-cooling"]


def test_a_cycle_without_a_reading_is_none_that_is_judged() -> None:
    trace = plant(6, days=2, period=60.0)
    starts = trace.times[1:][np.diff(trace.signals["MarciaDecanter"]) > 0]
    third = (trace.times >= starts[2] - 60.0) & (trace.times <= starts[3] + 60.0)
    unheard = replace(trace, signals={**trace.signals, "T": np.where(third, np.nan, trace.signals["T"])}, events=())
    numbers = [
        np.unique(build_record(model(), [patiently(each, model().alphabet)], SIGNALS).window_cycle)
        for each in (trace, unheard)
    ]
    assert numbers[0].size == 6 and numbers[1].tolist() == [0, 1, 3, 4, 5]
    found = diagnose(model(), [unheard], seed=0, most=1).diagnosis
    assert found.held_out is not None and found.held_out.cycles == 1


def test_a_record_says_what_does_not_hold_of_it() -> None:
    record = build_record(model(), [plant(1, days=1, period=60.0)], SIGNALS)
    runs = record.runs
    unread = np.where(runs.run == runs.run[-1], np.nan, runs.reading)
    wrong: list[tuple[dict[str, object], str]] = [
        ({"runs": replace(runs, run=runs.run + 1)}, "runs are numbered"),
        ({"runs": replace(runs, reading=unread)}, "the rows are the knots with a reading"),
        ({"runs": replace(runs, time=runs.time[::-1])}, "times rise within a run"),
        ({"runs": replace(runs, dt=1.5 * runs.dt)}, "a row is as late as it is"),
        ({"cycle": record.cycle[::-1]}, "cycles follow one another"),
        ({"begins": record.begins[1:]}, "every window has a reading"),
        ({"running": record.running[1:]}, "every column has one value for each knot"),
        ({"begins": np.array([0])}, "a window lies in one run and one cycle"),
    ]
    for change, words in wrong:
        with pytest.raises(RecordFault, match=words):
            replace(record, **change)


def test_cycles_without_a_reading_are_input_that_cannot_be_used() -> None:
    record: Record = build_record(model(), [plant(1, days=1, period=60.0)], SIGNALS)
    with pytest.raises(LearningError, match="none of these cycles has a reading of 'T'"):
        record.select(record.cycle > record.cycle[-1])
