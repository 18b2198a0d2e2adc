"""A transient after each event is learned where the readings show one, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from sim.artefacts.model_directory import read_model_directory
from sim.engine.open_loop_run import open_loop
from sim.lab.formats.foreign.bundle import read_artefacts
from sim.lab.formats.foreign.convert import to_sha
from sim.lab.formats.write_model import write_model_directory
from sim.lab.learning.lsha.flow_hypotheses import hold_out_levels
from sim.lab.learning.lsha.learn import LearnedLsha, learn_lsha
from sim.lab.learning.lsha.segments import find_next_stays
from sim.lab.learning.lsha.teacher import Teacher, make_teacher, renumber_places
from sim.lab.learning.lsha.transients import TransientLaw, transient_law
from sim.lab.learning.lsha.words import build_classes
from sim.sha.trace import Array, Trace
from tests.learning.lsha_plants import PLANT, by_context, random_traces
from tests.rig.no_bands import without_bands

TAU, AMPLITUDE = 9.0, 6.0
"""Of the transient with which the plant enters its locations at a high load."""


def ages(trace: Trace) -> Array:
    """Seconds since the last event, from the trace alone."""
    happened = np.array([event.time for event in trace.events])
    return trace.times - happened[np.searchsorted(happened, trace.times, side="right") - 1]


def with_transient(trace: Trace, amplitude: float = AMPLITUDE) -> Trace:
    off = np.where(trace.signals["Load"] > 2.0, amplitude, 0.0) * np.exp(-ages(trace) / TAU)
    return replace(trace, signals={**trace.signals, "T": trace.signals["T"] + off})


def plants(seed: int, count: int, amplitude: float = AMPLITUDE) -> list[Trace]:
    return [with_transient(trace, amplitude) for trace in random_traces(by_context, seed, count=count, jumps=True)]


@pytest.fixture(scope="module")
def known() -> LearnedLsha:
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        return learn_lsha(plants(5, 8), PLANT, "T", seed=0)


def test_a_known_transient_comes_back_where_it_is_and_nowhere_else(known: LearnedLsha) -> None:
    assert known.model.provenance.settings["flow"] == "transient, resampled on entry"
    high = {name for name in known.model.sha.by_name if "/2+" in name}
    for location in known.model.sha.locations:
        assert location.flow.kind == ("transient" if location.name in high else "constant"), location.name
        if location.name in high:
            level = 80.0 if location.name.startswith("ON") else 20.0
            assert location.flow.params["tau"] == pytest.approx(TAU, rel=0.05)
            assert location.flow.params["m"] == pytest.approx(-AMPLITUDE, rel=0.05)
            assert location.distribution is not None
            assert location.distribution.params["mu"] == pytest.approx(level + AMPLITUDE, abs=0.5)
    # What is left is the sensor's noise: the transient is no part of it.
    assert known.model.sensor_sigma == pytest.approx(0.1, rel=0.2)


def test_a_plant_without_a_transient_gets_none_and_no_rival() -> None:
    """No location shows an amplitude, so that nothing is compared that was not compared before."""
    for seed in range(5, 9):
        teacher = make_teacher(random_traces(by_context, seed, count=8, jumps=True), PLANT, "T", 5, 5)
        law, amplitude = amplitudes(teacher)
        assert law is not None and not amplitude.any(), seed


def test_new_traces_are_foretold_by_the_transient(known: LearnedLsha) -> None:
    """A run of the model from the events alone is off by the levels' scatter, from the first second of a stay on."""
    errors, early = [], []
    for trace in plants(105, 4):
        run = open_loop(replace(known.model, calibration={}), trace, "resync")
        row = np.searchsorted(run.times, trace.times, side="right") - 1
        begun = trace.times >= trace.events[1].time
        errors.append((run.mean[row] - trace.signals["T"])[begun])
        early.append((ages(trace) < TAU)[begun])
    error, first = np.concatenate(errors), np.concatenate(early)
    # The levels scatter by 1 degC from stay to stay: E|N(0, 1)| = 0.8. Six degrees more at entry would show.
    assert np.mean(np.abs(error[first])) == pytest.approx(0.8, abs=0.15)
    assert np.mean(np.abs(error[~first])) == pytest.approx(0.8, abs=0.15)


def test_the_model_is_written_and_read_again_as_json_and_as_artefacts(known: LearnedLsha, tmp_path) -> None:
    write_model_directory(tmp_path / "model", known.model, known.values)
    assert read_model_directory(tmp_path / "model").sha == known.model.sha
    name = known.model.sha.name
    public = to_sha(read_artefacts(tmp_path / "model", name)).sha
    assert {each.name: each.flow for each in public.locations} == {
        each.name: each.flow for each in known.model.sha.locations
    }


def test_the_amplitude_does_not_depend_on_which_levels_belong_together() -> None:
    """Levels that differ from stay to stay by far more than the transient: within stays nothing of that is seen."""
    teacher = make_teacher([with_transient(trace) for trace in wild_levels()], PLANT, "T", 5, 5)
    law, amplitude = amplitudes(teacher)
    assert law is not None and law.tau == pytest.approx(TAU, rel=0.1)
    shown = amplitude[amplitude != 0.0]
    assert shown.size and shown == pytest.approx(AMPLITUDE, rel=0.1)


def wild_levels() -> list[Trace]:
    return random_traces(by_context, 11, count=8, jumps=True, scatter=30.0)


def amplitudes(teacher: Teacher) -> tuple[TransientLaw | None, Array]:
    classes = build_classes(teacher.words, "context")
    runs = renumber_places(teacher.runs, classes.of_state)
    law = transient_law(runs, len(classes), 0.05, 5)
    return law, np.zeros(0) if law is None else law.amplitudes(runs, len(classes))


@pytest.mark.parametrize("tau", [3.0, 40.0])
def test_settling_takes_off_what_the_law_says(tau: float) -> None:
    teacher = make_teacher(plants(5, 2, amplitude=0.0), PLANT, "T", 5, 5)
    law, size = TransientLaw(tau, 0.05, 5), len(teacher.words.states)
    amplitude = np.arange(float(size))
    settled = law.remove_transients(teacher.runs, amplitude)
    back = law.remove_transients(settled, -amplitude)
    np.testing.assert_allclose(back.reading, teacher.runs.reading)
    _, place = find_next_stays(teacher.runs)
    # Readings at an event belong to the stay that it begins: they are off by the whole amplitude.
    runs = teacher.runs
    entered = np.append((np.diff(runs.stay) != 0) & (np.diff(runs.run) == 0), False) & np.isfinite(runs.reading)
    assert entered.any()
    off = (teacher.runs.reading - settled.reading)[entered]
    assert off == pytest.approx(amplitude[place[entered]])


@pytest.mark.parametrize("law", [None, TransientLaw(TAU, 0.05, 5)])
def test_what_is_foretold_of_a_run_that_is_held_out_does_not_depend_on_its_readings(law: TransientLaw | None) -> None:
    teacher = make_teacher(plants(5, 8), PLANT, "T", 5, 5)
    runs = renumber_places(teacher.runs, build_classes(teacher.words, "direction").of_state)
    own = np.isfinite(runs.reading) & (np.cumsum(runs.first) == 3)
    changed = replace(runs, reading=np.where(own, 90.0 - 0.5 * runs.reading, runs.reading))
    first, second = (
        each.reading[np.isfinite(each.reading)] - hold_out_levels(each, law).error for each in (runs, changed)
    )
    held = own[np.isfinite(runs.reading)]
    assert held.sum() > 50
    np.testing.assert_allclose(first[held], second[held], rtol=1e-12)
    assert not np.allclose(first[~held], second[~held]), "the others are foretold by it"
