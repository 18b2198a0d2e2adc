"""An ensemble without a gateway: a mixture is one, weights follow the evidence, contexts borrow, nobody is lost."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.stats import norm

from sim.forecast.ensemble import (
    DENSE_LEVELS,
    Pool,
    PoolEvidence,
    issue_pool,
    learn,
    mixture,
    settle_pool,
    thin_levels,
    weights,
    weights_by_horizon,
)
from sim.forecast.fan import FAN_LEVELS, Forecast
from sim.scores import Estimate

HORIZONS = np.array([60.0, 300.0])


def gaussian(
    mean: float, sigma: float, p: float = 0.0, minutes: tuple[float, float, float] = (np.inf,) * 3
) -> Forecast:
    column = norm.ppf(DENSE_LEVELS, mean, sigma)
    return Forecast(
        time=0.0,
        horizons=HORIZONS,
        levels=DENSE_LEVELS,
        quantiles=np.column_stack([column, column]),
        locations=({"on": 1.0}, {"on": 0.5, "off": 0.5}),
        limit=80.0,
        exceedance=(Estimate(p, max(p - 0.1, 0.0), min(p + 0.1, 1.0), 100),) * 2,
        minutes_to_limit=minutes,
        runs=100,
        factors=np.ones(2),
    )


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(-30.0, 30.0), st.floats(0.2, 5.0))
def test_the_quantiles_of_a_mixture_are_those_of_the_weighted_distribution_functions(
    weight: float, apart: float, spread: float
) -> None:
    mixed = mixture([gaussian(50.0, 1.0), gaussian(50.0 + apart, spread)], [weight, 1.0 - weight], FAN_LEVELS)

    def below(x: float) -> float:
        return weight * norm.cdf(x, 50.0, 1.0) + (1 - weight) * norm.cdf(x, 50.0 + apart, spread)

    for level, value in zip(FAN_LEVELS, mixed.quantiles[:, 0], strict=True):
        # In levels, as a quantile is not sharp where the mixture has a gap; 0.01 is the grain of the members' fans.
        assert below(value + 1e-6) >= level - 0.011 and below(value - 1e-6) <= level + 0.011
    assert np.all(np.diff(mixed.quantiles[:, 0]) >= 0)


def test_a_known_mixture_to_a_hundredth_of_a_degree() -> None:
    mixed = mixture([gaussian(50.0, 1.0), gaussian(53.0, 2.0)], [0.7, 0.3], FAN_LEVELS)
    for level, value in zip(FAN_LEVELS, mixed.quantiles[:, 1], strict=True):
        exact = brentq(lambda x, p=level: 0.7 * norm.cdf(x, 50, 1) + 0.3 * norm.cdf(x, 53, 2) - p, 0.0, 100.0)
        assert value == pytest.approx(exact, abs=0.02)


def test_a_member_with_all_the_weight_is_the_mixture() -> None:
    one, other = gaussian(50.0, 1.0, 0.2), gaussian(60.0, 1.0, 0.9)
    mixed = mixture([one, other], [1.0, 0.0], FAN_LEVELS)
    np.testing.assert_array_equal(mixed.quantiles, thin_levels(one, FAN_LEVELS).quantiles)
    assert mixed.exceedance[0].probability == pytest.approx(0.2)
    assert mixed.locations[1] == one.locations[1]


def test_exceedance_is_the_weighted_mean_never_falls_with_the_horizon_and_so_do_its_ends() -> None:
    one, other = gaussian(50.0, 1.0, 0.2), gaussian(60.0, 1.0, 0.6)
    mixed = mixture([one, other], [0.5, 0.5], FAN_LEVELS)
    e = mixed.exceedance[0]
    assert (e.probability, e.low, e.high) == pytest.approx((0.4, 0.3, 0.5))
    falling = mixture([one, other], [[0.0, 1.0], [1.0, 0.0]], FAN_LEVELS)
    assert [e.probability for e in falling.exceedance] == pytest.approx([0.6, 0.6])


def test_minutes_to_the_limit_come_from_the_mixed_chances() -> None:
    sure = gaussian(79.0, 1.0, 1.0, (0.2, 0.5, 0.8))
    never = gaussian(40.0, 1.0, 0.0)
    low, median, high = mixture([sure, never], [0.5, 0.5], FAN_LEVELS).minutes_to_limit
    assert low == pytest.approx(0.2 + 0.3 * 0.05 / 0.45), "5 % of all are 10 % of the sure one's"
    assert median == pytest.approx(1.0) and high == np.inf
    assert mixture([sure, sure], [0.5, 0.5], FAN_LEVELS).minutes_to_limit == pytest.approx((0.2, 0.5, 0.8))
    assert mixture([never, never], [0.5, 0.5], FAN_LEVELS).minutes_to_limit == (np.inf,) * 3


def test_forecasts_of_other_horizons_or_limits_and_weights_that_are_none_are_refused() -> None:
    one = gaussian(50.0, 1.0)
    with pytest.raises(ValueError, match="same horizons"):
        mixture([one, replace(one, limit=90.0)], [0.5, 0.5], FAN_LEVELS)
    for wrong in ([0.5, 0.6], [1.5, -0.5], [1.0]):
        with pytest.raises(ValueError, match=r"weights"):
            mixture([one, one], wrong if len(wrong) > 1 else [0.4, 0.4], FAN_LEVELS)
    with pytest.raises(ValueError, match="floor"):
        Pool(2, floor=0.5)


def taught(pool: Pool, seen: list[tuple[str, tuple[float | None, ...]]]) -> Pool:
    for context, losses in seen:
        pool = learn(pool, context, losses)
    return pool


def test_weights_go_to_the_member_that_was_right_and_come_back_after_a_change() -> None:
    first = taught(Pool(2), [("", (1.0, 1.5))] * 20)
    assert weights(first)[0] > 0.95 and sum(weights(first)) == pytest.approx(1.0)
    assert weights(first)[1] >= first.floor
    after = taught(first, [("", (1.5, 1.0))] * 60)
    assert weights(after)[1] > 0.5, "two half-lives"


def test_what_all_got_wrong_while_the_machine_heated_up_does_not_outweigh_steady_running() -> None:
    """Ten degrees of error each at the start, tenths of a degree after it: who is better now is told by the latter."""
    pool = taught(Pool(2), [("", (9.0, 11.0))] * 5 + [("", (0.15, 0.1))] * 10)
    assert weights(pool)[1] > 0.9
    once, again = (taught(Pool(2), [("", (scale, 2.0 * scale))] * 3) for scale in (1.0, 100.0))
    assert weights(once) == pytest.approx(weights(again)), "the unit of the losses does not matter"


def test_who_is_a_little_sharper_while_nothing_happens_does_not_outweigh_being_far_off_when_something_does() -> None:
    """In nine moments of ten the first is better by a hundredth of a degree, and in the tenth worse by three."""
    pool = taught(Pool(2), ([("", (0.01, 0.02))] * 9 + [("", (6.0, 3.0))]) * 6)
    assert weights(pool)[1] > 0.5


def test_losses_of_a_version_without_a_scale_go_on() -> None:
    pool = taught(Pool(2), [("", (2.0, 1.0))] * 5)
    assert pool.overall is not None
    old = replace(pool, overall=replace(pool.overall, scale=0.0), contexts={})
    assert weights(taught(old, [("", (2.0, 1.0))]))[1] > weights(old)[1]


def test_a_few_forecasts_are_enough_against_a_member_that_is_far_off() -> None:
    assert weights(taught(Pool(3), [("", (1.0, 9.0, 1.1))] * 3))[1] < 0.03
    assert weights(taught(Pool(3), [("", (1.0, 9.0, 1.1))] * 3))[2] > 0.2


def test_losses_fade_with_the_stated_half_life() -> None:
    pool = taught(Pool(2, half_life=10.0), [("", (0.0, 50.0))] * 5)
    assert pool.overall is not None
    before = pool.overall.total[1]
    after = taught(pool, [("", (0.0, 0.0))] * 10)
    assert after.overall is not None and after.overall.total[1] == pytest.approx(before / 2.0)


def test_the_loss_of_the_pool_is_hardly_more_than_the_best_members() -> None:
    """Members whose quality changes by turns: the regret against the best fixed one, over all, is small."""
    rng = np.random.default_rng(7)
    pool, spent, alone = Pool(3), 0.0, np.zeros(3)
    for number in range(2000):
        losses = rng.gamma(4.0, np.array([1.0, 1.3, 2.0]) if number // 200 % 2 else np.array([1.3, 1.0, 2.0])) / 4.0
        spent += float(np.array(weights(pool)) @ losses)
        alone += losses
        pool = learn(pool, "", tuple(losses.tolist()))
    assert spent < 1.02 * alone.min()


def test_prior_weights_hold_until_there_is_evidence() -> None:
    pool = Pool(2, prior=(0.9, 0.1), floor=0.0)
    assert weights(pool) == pytest.approx((0.9, 0.1))
    assert weights(taught(pool, [("", (2.0, 1.0))] * 5))[1] > 0.95


def test_a_longer_horizon_goes_by_the_shorter_one_until_it_has_evidence_of_its_own() -> None:
    short = taught(Pool(2), [("", (3.0, 1.0))] * 5)
    assert weights_by_horizon([short, Pool(2)])[1][1] > 0.95
    little = taught(Pool(2), [("", (1.0, 2.0))])
    much = taught(Pool(2), [("", (1.0, 2.0))] * 20)
    first, later = (weights_by_horizon([short, pool])[1][0] for pool in (little, much))
    assert first < 0.5 < later, "four forecasts of the shorter horizon outweigh one, and not twenty"
    assert weights_by_horizon([short])[0] == weights(short)
    assert weights_by_horizon([Pool(2, fixed=(0.7, 0.3)), little])[1] == weights(little)


def test_contexts_have_weights_of_their_own_and_one_without_evidence_has_the_overall_ones() -> None:
    pool = taught(Pool(2), [("on", (1.0, 1.6)), ("off", (1.6, 1.0))] * 40)
    assert weights(pool, "on")[0] > 0.9 and weights(pool, "off")[1] > 0.9
    assert weights(pool, "never seen") == weights(pool)
    little = learn(pool, "new", (1.0, 1.6))
    assert weights(little)[0] < weights(little, "new")[0] < weights(little, "on")[0]


def test_a_member_without_a_forecast_loses_what_the_others_did() -> None:
    pool = taught(Pool(3), [("", (1.0, 2.0, None))] * 10)
    w = weights(pool)
    assert w[0] >= w[2] > w[1]
    assert learn(pool, "", (None, None, 1.0)) is pool


def test_fixed_weights_stay() -> None:
    pool = taught(Pool(2, fixed=(0.7, 0.3)), [("", (9.0, 0.0))] * 50)
    assert weights(pool) == (0.7, 0.3)


def test_evidence_waits_for_the_reading_counts_overlap_once_and_drops_what_is_overdue() -> None:
    good, bad = gaussian(50.0, 1.0), gaussian(60.0, 1.0)
    evidence = PoolEvidence(Pool(2, strength=1e-9, floor=0.0))
    for second in (0.0, 6.0, 200.0):
        at = [replace(one, time=second) for one in (good, bad)]
        evidence = issue_pool(evidence, 60.0, "on", at)
    assert settle_pool(evidence, 60.0, 59.0, 50.0, 5.0) is evidence
    first = settle_pool(evidence, 60.0, 61.0, 50.0, 5.0)
    second = settle_pool(first, 60.0, 66.0, 50.0, 5.0)
    assert first.pool.overall is not None and second.pool.overall is not None
    assert first.pool.overall.evidence == pytest.approx(1.0)
    assert second.pool.overall.evidence == pytest.approx(1.1, abs=0.01), "six seconds newer: a tenth of a forecast"
    assert second.pool.contexts.keys() == {"on"}
    late = settle_pool(second, 60.0, 300.0, 50.0, 5.0)
    assert late.pending == () and late.pool == second.pool
    assert settle_pool(second, 60.0, 260.0, float("nan"), 5.0).pending == second.pending
    assert issue_pool(evidence, 60.0, "on", [good, None]) is evidence


def test_a_pool_is_plain_enough_for_json() -> None:
    pool = taught(Pool(2), [("on", (0.0, 1.0))] * 3)
    assert json.loads(json.dumps(asdict(pool)))["contexts"]["on"]["total"] == list(pool.contexts["on"].total)
