"""What the fitted cycles leave near is held against the held-out ones; what still begins half-way contradicts names."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy import proving
from sim.lab.discrepancy.diagnosis import GapBeginning, NoiseFloor
from sim.lab.discrepancy.fitting import (
    Fitted,
    Named,
    Record,
    Whitener,
    build_frame,
    build_record,
    catalogue,
    fit,
    move_frame,
    window_sensitivity,
)
from sim.lab.discrepancy.gap import add_leftover
from sim.lab.discrepancy.held_out import foretold, let_run, reference_runs
from sim.lab.discrepancy.judging import NamingResult
from sim.lab.discrepancy.naming import NamingStep, confirm, entries_besides, step
from sim.lab.discrepancy.posterior import NamesEvidence
from sim.lab.discrepancy.proving import (
    Proof,
    as_special_case,
    began_otherwise,
    longest_that_passes,
    readmit_effect,
    separate_rivals,
    unlikely,
    with_the_gap_itself,
)
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.screen import Projector, candidate_shapes
from sim.lab.discrepancy.workflow import diagnose
from sim.sha import Array
from tests.discrepancy.plants import model, plant

ROLES = {"current": "Assorbimento", "pump": "MarciaPmpFango"}
FITTED, ALL = 4, 6
"""Cycles of two days."""


@pytest.fixture(scope="module")
def parts() -> tuple[Fitted, Record]:
    record = build_record(model(), [plant(3, days=2, pump=2e-4)], tuple(ROLES.values()))
    return fit(move_frame(build_frame(record), record.select(record.cycle < FITTED))), record.select(
        record.cycle >= FITTED
    ).by_cycles()


@pytest.fixture(scope="module")
def near(parts: tuple[Fitted, Record]) -> NamingStep:
    """A pump and a churning of which the fitted cycles are made to say the same, but for a nat."""
    wanted = ("pump-cooling", "startup-churning")
    found = step(parts[0], [one for one in catalogue() if one.name in wanted], ROLES, rules=RULES)
    pump, churning = (next(each for each in found.evidence if each.entry.name == name) for name in wanted)
    assert pump.fitted is not None
    churning = confirm(parts[0], churning)
    return replace(found, evidence=(pump, replace(churning, gain=pump.gain - 1.0)))


def proof_of(parts: tuple[Fitted, Record]) -> Proof:
    base, held_out = parts
    cycles = np.unique(held_out.window_whole)
    floor = NoiseFloor(0.1, (0.05, 0.2), cycles, np.full(cycles.size, 0.1), "the sensor alone")
    return Proof(
        held_out=held_out, runs=reference_runs(base, held_out), floor=floor, stated=np.full(FITTED, 0.1),
        before=None, ceiling=None, seed=0, rules=RULES,
    )  # fmt: skip


def test_a_fit_foretells_cycles_as_surely_as_it_knows_its_parameters(parts: tuple[Fitted, Record]) -> None:
    base, held_out = parts
    run = let_run(base, held_out)
    some = Whitener(run.whitener.grid, base.noise)
    noise = np.linalg.inv(some.weigh(np.eye(run.residual.size)))
    columns = run.restart_residual(window_sensitivity(move_frame(base.frame, held_out), run.state, run.start))
    both = noise + columns @ base.covariance @ columns.T
    logs = [float(np.linalg.slogdet(each)[1]) for each in (both, noise)]
    expected = -0.5 * (float(run.residual @ np.linalg.solve(both, run.residual)) + logs[0] - logs[1])
    assert foretold(base, run, some) == pytest.approx(expected, rel=1e-5)


def test_held_out_cycles_tell_apart_what_the_fitted_ones_do_not(parts: tuple[Fitted, Record], near: NamingStep) -> None:
    assert near.margin < RULES.margin_nats
    apart = separate_rivals(proof_of(parts), near)
    assert apart.best is near.best and apart.margin >= RULES.margin_nats
    # They speak for whichever they are: the wrong one in front is no longer in front by enough.
    pump, churning = near.evidence
    wrong = separate_rivals(
        proof_of(parts), replace(near, evidence=(churning, replace(pump, gain=churning.gain - 8.0)))
    )
    assert wrong.margin < RULES.margin_nats
    # Where a free learner still finds something, the best must beat each by so much more.
    plain, unsure = (separate_rivals(proof_of(parts), near, more).margin for more in (0.0, 6.0))
    assert unsure == pytest.approx(plain - 6.0)
    far = replace(near, evidence=(pump, replace(churning, gain=pump.gain - 2.0 * RULES.told_apart_times * 6.0 - 99.0)))
    assert separate_rivals(proof_of(parts), far) is far


def test_a_name_that_only_rivals_held_back_is_given_where_held_out_cycles_tell_it_from_them(
    parts: tuple[Fitted, Record], near: NamingStep
) -> None:
    refused = NamingResult(parts[0], parts[0], ((near, "beats its rivals outside its class by 1.0 nats only"),))
    found = readmit_effect(proof_of(parts), refused)
    assert [each.best.entry.name for each in found.accepted_steps if each.best is not None] == ["pump-cooling"]
    assert near.best is not None and found.fitted is near.best.fitted
    # Chance stays chance, whatever the held-out cycles say.
    little = replace(
        near, evidence=tuple(replace(each, gain=each.gain - near.evidence[0].gain + 9.0) for each in near.evidence)
    )
    chance = replace(refused, steps=((little, "adds 9.0 nats, and a name needs 14.0"),))
    assert readmit_effect(proof_of(parts), chance) is chance


def test_names_are_judged_without_what_a_free_learner_finds_in_an_experiment(
    parts: tuple[Fitted, Record], near: NamingStep, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    monkeypatch.setattr(proving, "ceiling", lambda _fitted, _seed, first_made: asked.append(first_made))
    assert near.best is not None and near.best.fitted is not None
    path = NamingResult(parts[0], near.best.fitted, ((near, ""),))
    longest_that_passes(replace(proof_of(parts), stated=np.full(1, np.nan), first_made=3.0), [path])
    assert asked == [3.0]


def test_what_is_too_little_on_fitted_cycles_counts_with_what_held_out_ones_foretell_of_it(
    parts: tuple[Fitted, Record], near: NamingStep
) -> None:
    best = near.evidence[0]
    for gain, given in ((10.0, True), (6.0, False)):
        little = replace(near, evidence=(replace(best, gain=gain),))
        refused = NamingResult(parts[0], parts[0], ((little, f"adds {gain} nats, and a name needs 14.0"),))
        found = with_the_gap_itself(proof_of(parts), refused)
        assert bool(found.accepted_steps) is given, "held-out cycles count for as much as the fitted ones at most"


def test_what_is_no_better_than_its_special_case_by_all_cycles_is_that_case(
    parts: tuple[Fitted, Record], near: NamingStep
) -> None:
    pump, churning = near.evidence
    assert churning.fitted is not None
    entry = replace(churning.entry, candidate=replace(churning.entry.candidate, special=("pump-cooling",)))
    wider = replace(near, evidence=(replace(churning, entry=entry), replace(pump, gain=churning.gain - 8.0)))
    path = NamingResult(parts[0], churning.fitted, ((wider, ""),))
    found = as_special_case(proof_of(parts), path)
    assert [step.best.entry.name for step in found.accepted_steps if step.best is not None] == ["pump-cooling"]
    assert [named.entry.name for named in found.fitted.state.named] == ["pump-cooling"]
    usual = replace(path, steps=((replace(near, evidence=(churning, pump)), ""),))
    assert as_special_case(proof_of(parts), usual) is usual


@pytest.mark.parametrize(
    ("left", "error", "source"),
    [
        (0.1, 0.1, "what the names leave of the held-out cycles"),
        (0.25, np.sqrt(0.2 * 0.25), "what the names leave of all cycles"),
        (0.31, 0.2, "the sensor alone"),
    ],
)
def test_what_names_leave_of_held_out_cycles_is_noise_where_chance_makes_as_much(
    left: float, error: float, source: str
) -> None:
    made = NoiseFloor(0.2, (0.1, 0.3), np.arange(4), np.full(4, 0.2), "the sensor alone")
    # Known as well as the floor, whose interval holds 99 %: both count for half, in logarithms.
    alike = replace(RULES, left_by_names_log_sd=np.log(0.3 / 0.1) / (2.0 * 2.5758))
    told = add_leftover(made, left, alike)
    assert (told.error, told.source) == (pytest.approx(error, rel=1e-4), source)
    assert told.interval == pytest.approx((0.5 * error, 1.5 * error), rel=1e-4)
    assert told.per_cycle == pytest.approx(np.full(4, error), rel=1e-4)


def test_a_name_that_is_less_likely_than_not_is_none(near: NamingStep, parts: tuple[Fitted, Record]) -> None:
    best = near.best
    assert best is not None
    alone = replace(near, evidence=(best,))
    for nats, withheld in ((-9.0, False), (3.0, True)):
        beside = replace(alone, rivals={"other-surroundings": best.gain + nats})
        path = NamingResult(parts[0], parts[0], ((beside, ""),))
        assert bool(unlikely(path, NamesEvidence(), RULES)) is withheld
    path = NamingResult(parts[0], parts[0], ((alone, ""),))
    little, much = (NamesEvidence(heat_left=left) for left in (0.02, 0.9))
    assert not unlikely(path, little, RULES) and unlikely(path, much, RULES), "what names leave counts as well"


def test_a_name_that_begins_half_way_is_none_that_acts_all_along(
    near: NamingStep, parts: tuple[Fitted, Record]
) -> None:
    path = NamingResult(parts[0], parts[0], ((replace(near, evidence=near.evidence[:1]), ""),))
    began = GapBeginning(time=0.0, interval=(0.0, 1.0), before=3, after=3, moves=0.1, running=True, p=1e-9)
    assert not began_otherwise(path, began), "the mean error steps, and nobody says of what"
    assert not began_otherwise(path, replace(began, acts="speed-friction"))
    assert began_otherwise(path, replace(began, acts="pump-cooling"))


def test_heat_at_starts_from_a_day_on_is_dated_and_not_named_as_if_it_had_always_been() -> None:
    def more(times: Array, on: Array, current: Array) -> tuple[Array, Array]:
        row = np.arange(on.size)
        age = 60.0 * (row - np.maximum.accumulate(np.where(np.diff(on, prepend=0.0) > 0, row, 0)))
        return 30.0 / 3600.0 * on * np.exp(-age / 300.0) * (times - times[0] >= 2.2 * 86400.0), np.zeros(on.size)

    found = diagnose(model(), [plant(4, days=5, period=60.0, more=more)], seed=0).diagnosis
    assert found.verdict == "unexplained" and not found.effects
    assert found.began is not None and found.began.acts == "startup-churning"


def test_a_feed_spread_about_more_than_there_was_would_be_the_pumps_cooling() -> None:
    feed = next(one for one in catalogue() if one.name == "feed-temperature-coupling").candidate
    ends = {"coldest": 10.0, "warmest": 60.0}
    for shift, reference in ((-6000.0, 60.0), (-120.0, 40.0), (300.0, 10.0)):
        assert feed.settled({"scale": 4.0, "shift": shift, **ends})["shift"] == pytest.approx(-3.0 * reference)
    assert feed.settled({"loss": 1e-4}) == {"loss": 1e-4}


def test_beside_a_name_of_what_lies_before_the_reading_no_other_heat_comes_late(parts: tuple[Fitted, Record]) -> None:
    def lags(*names: str) -> list[bool]:
        named = [Named(one, {}, {}) for one in catalogue() if one.name in names]
        entry = next(one for one in entries_besides(named) if one.name == "quadratic-current-heating")
        shapes = candidate_shapes(Projector(parts[0]), [entry], ROLES)
        return ["lag" in each.params for each in shapes]

    assert any(lags()) and any(lags("pump-cooling")) and not all(lags())
    assert lags("dead-time") == [False] == lags("sensor-lag", "pump-cooling")
