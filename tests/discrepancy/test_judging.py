"""What withholds a name, and where heat is not judged."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.diagnosis import Ceiling, HeldOutProof
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.fitting.free_run_fit import Fitted, fit
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.gap import Excess
from sim.lab.discrepancy.heat import REACH_DELAYS, implied_heat
from sim.lab.discrepancy.held_out import let_run
from sim.lab.discrepancy.judging import (
    NamingResult,
    beyond_chance,
    doubts,
    gap_evidence,
    leftover_reasons,
    uncertain_strengths,
)
from sim.lab.discrepancy.naming import NamingStep, confirm, step
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.story import verdict_sentence
from tests.discrepancy.plants import model, plant


@pytest.fixture(scope="module")
def base() -> Fitted:
    record = build_record(model(), [plant(3, days=2, pump=2e-4)], ("MarciaPmpFango",))
    return fit(move_frame(build_frame(record), record))


def confirmed(base: Fitted, name: str) -> NamingStep:
    found = step(base, [one for one in catalogue() if one.name == name], {"pump": "MarciaPmpFango"}, rules=RULES)
    assert found.best is not None
    return replace(found, evidence=(confirm(base, found.best),))


@pytest.fixture(scope="module")
def pumped(base: Fitted) -> NamingStep:
    return confirmed(base, "pump-cooling")


@pytest.mark.parametrize(("gain", "after", "withheld"), [(30.0, 0.51, True), (30.0, 0.49, False), (500.0, 0.51, True)])
def test_a_name_under_which_the_held_out_error_grows_is_never_given(
    base: Fitted, pumped: NamingStep, gain: float, after: float, withheld: bool
) -> None:
    best = pumped.evidence[0]
    assert best.fitted is not None
    found = NamingResult(base, best.fitted, ((replace(pumped, evidence=(replace(best, gain=gain),)), ""),))
    record = base.frame.record.by_cycles()
    held = HeldOutProof(5, 5, 0.6, 0.5, after, 0.2, None, None, ())
    reasons = doubts(
        found, let_run(base, record), second=let_run(best.fitted, record), held=held, before=None, left=None
    )
    assert [reason for reason in reasons if "further off" in reason] == list(reasons)
    assert bool(reasons) is withheld


def test_what_is_beyond_chance_and_has_no_name_is_told_with_why(base: Fitted, pumped: NamingStep) -> None:
    best, why = pumped.evidence[0], "the free run over the held-out cycles is further off with it"
    assert best.fitted is not None
    path = NamingResult(base, best.fitted, ((pumped, ""),))
    (said,) = beyond_chance(path, (why,))
    assert said == f"pump-cooling explains the fitted cycles better by {best.gain:.0f} nats, and is not named: {why}"
    assert beyond_chance(path, ()) == ()
    faint = replace(pumped, evidence=(replace(best, gain=3.0),))
    assert beyond_chance(NamingResult(base, base, ((faint, "adds 3.0 nats"),)), (why,)) == ()


@pytest.mark.parametrize(("before", "after"), [(0.5, np.nan), (np.nan, 0.4), (np.nan, np.nan)])
def test_a_name_whose_held_out_run_is_no_number_is_never_given(
    base: Fitted, pumped: NamingStep, before: float, after: float
) -> None:
    best = pumped.evidence[0].fitted
    assert best is not None
    record = base.frame.record.by_cycles()
    second = let_run(best, record)
    lost = replace(second, residual=np.full_like(second.residual, np.nan))
    held = HeldOutProof(5, 5, 0.6, before, after, 0.2, None, None, ())
    found = NamingResult(base, best, ((pumped, ""),))
    reasons = doubts(found, let_run(base, record), second=lost, held=held, before=None, left=None)
    assert any("not better foreseen" in reason for reason in reasons)
    assert any("further off" in reason for reason in reasons)


@pytest.mark.parametrize(("errors", "withheld"), [(1.0, False), (1e6, True), (np.nan, True)])
def test_a_name_is_not_given_whose_strength_its_own_error_does_not_tell_from_nothing(
    base: Fitted, pumped: NamingStep, errors: float, withheld: bool
) -> None:
    """The likelihood of a fit may grow by its noise alone, and its effect do nothing where the fit ends."""
    best = pumped.evidence[0].fitted
    assert best is not None
    strength, error = best.strength("pump-cooling")
    assert strength == best.state.named[0].strength and 0.0 < 5.0 * error < strength
    unsure = replace(best, covariance=errors**2 * best.covariance)
    reasons = uncertain_strengths(NamingResult(base, unsure, ((pumped, ""),)))
    assert bool(reasons) is withheld
    assert all(reason.startswith("pump-cooling is not told from nothing") for reason in reasons)
    assert not any("e+" in reason for reason in reasons), "an exponent is no word"


def test_an_error_that_the_floor_covers_is_no_gap_however_little_the_model_states(
    base: Fitted, pumped: NamingStep
) -> None:
    chance = NamingResult(base, base, ((replace(pumped, evidence=(replace(pumped.evidence[0], gain=1.0),)), "chance"),))
    rougher = Excess(median=2.0, low=1.5)
    assert gap_evidence(chance, None, rougher, covered=False) == (rougher.words(),)
    assert gap_evidence(chance, None, rougher, covered=True) == ()


@pytest.mark.parametrize(("gains", "withheld"), [((50.0,), True), ((40.0, 30.0), False), ((70.0,), False)])
def test_names_that_are_beyond_doubt_together_need_not_bring_the_error_within_the_stated_noise(
    base: Fitted, pumped: NamingStep, gains: tuple[float, ...], withheld: bool
) -> None:
    best = pumped.evidence[0]
    assert best.fitted is not None
    steps = tuple((replace(pumped, evidence=(replace(best, gain=gain),)), "") for gain in gains)
    path = NamingResult(base, best.fitted, steps)
    reasons = leftover_reasons(path, 10.0, Excess(median=3.4, low=2.0), Excess(median=2.4, low=1.5))
    assert bool(reasons) is withheld


def test_heat_is_not_judged_where_a_change_is_on_its_way_through_a_dead_time() -> None:
    trace = plant(3, days=1)
    read = trace.signals["T"]
    late = replace(trace, signals={**trace.signals, "T": np.concatenate([np.full(8, read[0]), read[:-8]])})
    record = build_record(model(), [late], ())
    base = fit(move_frame(build_frame(record), record))
    delayed = confirmed(base, "dead-time").evidence[0].fitted
    assert delayed is not None and delayed.state.named[0].params["delay"] > 120.0
    runs = record.runs
    changes = runs.time[np.diff(runs.place, prepend=-1) != 0]
    soon = np.array(
        [np.any((time > changes + 60.0) & (time < changes + REACH_DELAYS * 120.0)) for time in record.times]
    )
    assert np.isnan(implied_heat(delayed)[soon]).all()
    assert 0.3 < np.isfinite(implied_heat(delayed)).mean() < 0.95
    # Where the switch fell between two rows by more than the sensor errs nothing is known without a delay either.
    unknown = base.grid.first | (base.grid.late > base.noise.sensor**2)
    np.testing.assert_array_equal(np.isnan(implied_heat(base)), unknown)


@pytest.mark.parametrize(
    ("before", "removed", "withheld"), [(0.6, 0.02, True), (0.6, 0.3, False), (0.201, 0.02, False)]
)
def test_a_name_that_leaves_nearly_all_of_a_gap_is_not_given(
    base: Fitted, pumped: NamingStep, before: float, removed: float, withheld: bool
) -> None:
    """A sensor said to have moved by ten degrees took the error from 13.3 to 13.2 over a floor of 5.3."""
    best = pumped.evidence[0]
    assert best.fitted is not None
    found = NamingResult(base, best.fitted, ((pumped, ""),))
    record = base.frame.record.by_cycles()
    held = HeldOutProof(5, 5, 0.6, before, 0.99 * before, 0.2, removed, (0.01, 0.5), ())
    reasons = doubts(
        found, let_run(base, record), second=let_run(best.fitted, record), held=held, before=None, left=None
    )
    assert any("it removes 2%" in reason for reason in reasons) is withheld


@pytest.mark.parametrize(
    ("after", "gain", "withheld"),
    [(0.2, 500.0, False), (0.21, 500.0, True), (0.2, RULES.beyond_doubt_nats - 1.0, True)],
)
def test_heat_of_some_minutes_does_not_speak_against_names_that_bring_the_error_down_to_the_noise(
    base: Fitted, pumped: NamingStep, after: float, gain: float, withheld: bool
) -> None:
    best = pumped.evidence[0]
    assert best.fitted is not None
    found = NamingResult(base, best.fitted, ((replace(pumped, evidence=(replace(best, gain=gain),)), ""),))
    record = base.frame.record.by_cycles()
    held = HeldOutProof(5, 5, 0.6, 0.5, after, 0.2, 0.9, (0.5, 1.0), ())
    found_left = Ceiling(share=0.66, p=0.0005, heat=0.34, drivers=())
    reasons = doubts(
        found,
        let_run(base, record),
        second=let_run(best.fitted, record),
        held=held,
        before=replace(found_left, share=0.2, heat=0.5),
        left=found_left,
    )
    assert any("free learner" in reason for reason in reasons) is withheld


def test_a_gap_within_the_noise_of_held_out_cycles_is_not_said_to_be_beyond_it() -> None:
    held = HeldOutProof(2, 2, 2.6, 2.54, 2.54, 1.8, None, None, ())
    said = {
        gap: verdict_sentence("unexplained", (), unexplained=(), shifts=(), held=held, cycles=6, unit="°C", gap=gap)
        for gap in (False, True)
    }
    assert "further off than noise allows" in said[True]
    assert "by what noise allows" in said[False] and "further off" not in said[False]
