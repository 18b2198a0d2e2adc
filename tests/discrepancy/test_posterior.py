"""How sure a name is: shares of what was fitted and of none of these, from what the names leave."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.ceiling import ceiling
from sim.lab.discrepancy.diagnosis import Ceiling, HeldOutProof, NoiseFloor
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame
from sim.lab.discrepancy.fitting.candidates import catalogue_entry
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.held_out import compare_fits
from sim.lab.discrepancy.naming import confirm, step
from sim.lab.discrepancy.posterior import (
    MAX_CONFIDENCE,
    PRIOR_NONE,
    NamesEvidence,
    log_ratio,
    names_evidence,
    posterior,
)
from sim.lab.discrepancy.rules import RULES
from tests.discrepancy.plants import model, plant

GAINS = {"pump-cooling": 60.0, "ambient-coupling": 48.0, "heat-by-the-clock": 30.0}
CLEAR = NamesEvidence(heat_left=0.02, excess_left=0.05, excess_error=0.08)


def none_of(evidence: NamesEvidence) -> float:
    return posterior(GAINS, evidence, RULES).none_of_these


@pytest.mark.parametrize("evidence", [CLEAR, NamesEvidence(), NamesEvidence(heat_left=0.9, excess_left=1.5)])
@pytest.mark.parametrize("gains", [GAINS, {"dead-time": 14.0}, {"dead-time": 5000.0, "sensor-lag": 4990.0}])
def test_the_shares_of_what_was_fitted_and_of_none_of_these_are_one(
    gains: dict[str, float], evidence: NamesEvidence
) -> None:
    found = posterior(gains, evidence, RULES)
    assert set(found.shares) == set(gains)
    assert sum(found.shares.values()) + found.none_of_these == pytest.approx(1.0)
    assert all(share >= 0 for share in (*found.shares.values(), found.none_of_these))
    assert found.confidence(tuple(gains)[:1]) <= MAX_CONFIDENCE


def test_none_of_these_grows_with_what_the_names_leave() -> None:
    shares = np.linspace(0.0, 1.2, 13).tolist()
    for which in ("heat_left", "excess_left"):
        grown = [none_of(replace(CLEAR, **{which: share})) for share in shares]
        assert np.all(np.diff(grown) > 0), which


def test_what_many_cycles_say_counts_for_more_than_what_few_say() -> None:
    errors = (0.05, 0.1, 0.2, 0.4, 0.8)
    good = [none_of(replace(CLEAR, excess_left=0.0, excess_error=error)) for error in errors]
    bad = [none_of(replace(CLEAR, excess_left=0.8, excess_error=error)) for error in errors]
    assert np.all(np.diff(good) > 0) and np.all(np.diff(bad) < 0)
    assert log_ratio(0.5, 100.0, 0.1) == pytest.approx(0.0, abs=1e-3)


def test_a_name_loses_to_a_rival_that_comes_near_whether_it_has_a_name_or_not() -> None:
    for rival in ("ambient-coupling", "heat-by-the-clock"):
        sure = [posterior({**GAINS, rival: gain}, CLEAR, RULES).confidence(("pump-cooling",)) for gain in (54, 57, 60)]
        assert sure[0] > sure[1] > sure[2] and sure[2] < 0.5
    one, both = (
        posterior({**GAINS, "ambient-coupling": 59.0}, CLEAR, RULES).confidence(claim)
        for claim in (("pump-cooling",), ("pump-cooling", "ambient-coupling"))
    )
    assert both > one


def test_a_gain_that_chance_could_make_is_among_none_of_these() -> None:
    shares = [posterior({"pump-cooling": gain}, CLEAR, RULES).none_of_these for gain in (40.0, 14.0, 11.0)]
    assert shares[0] < shares[1] < shares[2]


def test_without_evidence_none_of_these_is_not_surer_than_before_the_data() -> None:
    assert none_of(NamesEvidence()) <= PRIOR_NONE


def test_the_evidence_is_what_the_held_out_cycles_and_the_free_learner_say() -> None:
    held = HeldOutProof(5, 5, 0.6, 0.5, 0.3, 0.2, 0.9, (0.7, 1.0), ())
    before, left = Ceiling(0.5, 0.0, 10.0, ()), Ceiling(0.1, 0.01, 8.0, ())
    found = names_evidence(held, before, left, RULES)
    assert found.heat_left == pytest.approx(0.1 * 64.0 / 50.0)
    assert found.excess_left == pytest.approx(0.1) and found.excess_error == pytest.approx(0.3 / 3.92)
    nothing = names_evidence(replace(held, excess_removed=None, ci95=None), None, None, RULES)
    assert nothing == NamesEvidence()


def test_a_cause_outside_of_the_catalogue_makes_none_of_these_likelier_than_its_true_name_does() -> None:
    """The same traces with a pump that cools, once with that name and once with another."""
    signals, seed = ("MarciaPmpFango", "Assorbimento"), 0
    trace = plant(3, days=2, pump=2e-4)
    record = build_record(model(), [trace], signals)
    early = record.cycle < 4
    base = fit(move_frame(build_frame(record), record.select(early)))
    held_out = record.select(~early).by_cycles()
    present = {"pump": signals[0], "current": signals[1]}
    floor = NoiseFloor(0.06, (0.05, 0.08), np.arange(4, 6), np.full(2, 0.06), "what is given")
    before, none = ceiling(base, seed), dict[str, float]()
    for known, name in (("inside", "pump-cooling"), ("outside", "startup-churning")):
        found = step(base, [catalogue_entry(name)], present, rules=RULES).best
        assert found is not None
        named = confirm(base, found).fitted
        assert named is not None
        held, _, _ = compare_fits(base, named, held_out, seed, floor)
        against = names_evidence(held, before, ceiling(named, seed), RULES)
        none[known] = posterior({name: 40.0}, against, RULES).none_of_these
    assert none["inside"] < 0.1 < PRIOR_NONE < none["outside"]


def test_without_a_margin_names_still_have_a_confidence() -> None:
    found = posterior(GAINS, CLEAR, replace(RULES, margin_nats=0.0))
    assert sum(found.shares.values()) + found.none_of_these == pytest.approx(1.0)
