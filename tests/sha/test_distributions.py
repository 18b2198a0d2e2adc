"""The laws against scipy's, and the law of what is left of a sojourn."""

import numpy as np
import pytest
from scipy import stats

from sim.sha import distributions
from sim.sha.automaton import Distribution

REFERENCE = {
    "normal": (Distribution("normal", {"mu": 40.0, "sigma": 3.0}), stats.norm(40.0, 3.0)),
    "exponential": (Distribution("exponential", {"mean": 60.0}), stats.expon(scale=60.0)),
    "weibull": (Distribution("weibull", {"shape": 1.7, "scale": 60.0}), stats.weibull_min(1.7, scale=60.0)),
    "lognormal": (Distribution("lognormal", {"mu": 3.0, "sigma": 0.8}), stats.lognorm(0.8, scale=np.exp(3.0))),
}


def test_every_law_has_a_reference() -> None:
    assert set(REFERENCE) == set(distributions.LAWS)


@pytest.mark.parametrize("kind", REFERENCE)
def test_moments_and_survival_are_those_of_scipy(kind: str) -> None:
    law, known = REFERENCE[kind]
    assert distributions.mean(law) == pytest.approx(known.mean())
    assert distributions.variance(law) == pytest.approx(known.var())
    times = known.ppf([1e-6, 0.1, 0.5, 0.9, 1 - 1e-9])
    logs = distributions.LAWS[kind].log_survival(law.params, times)
    np.testing.assert_allclose(logs, known.logsf(times), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(distributions.LAWS[kind].exceeded(law.params, logs), times, rtol=1e-6)


@pytest.mark.parametrize("kind", REFERENCE)
def test_draws_follow_the_law(kind: str) -> None:
    law, known = REFERENCE[kind]
    sample = distributions.draw(law, 20_000, np.random.default_rng(5))
    assert stats.kstest(sample, known.cdf).pvalue > 1e-3


@pytest.mark.parametrize("kind", REFERENCE)
@pytest.mark.parametrize("age", [0.0, 45.0])
def test_the_rest_of_a_sojourn_follows_the_law_given_its_age(kind: str, age: float) -> None:
    law, known = REFERENCE[kind]
    rest = distributions.draw_residual(law, age, 20_000, np.random.default_rng(6))
    assert np.all(rest >= 0.0)
    result = stats.kstest(rest, lambda t: 1.0 - known.sf(age + t) / known.sf(age))
    assert result.pvalue > 1e-3


@pytest.mark.parametrize("kind", REFERENCE)
def test_an_age_far_beyond_the_law_still_gives_a_rest(kind: str) -> None:
    rest = distributions.draw_residual(REFERENCE[kind][0], 1e5, 100, np.random.default_rng(7))
    assert np.all(np.isfinite(rest) & (rest >= 0.0))


def test_ages_may_differ_from_run_to_run() -> None:
    law = REFERENCE["weibull"][0]
    ages = np.repeat([0.0, 200.0], 5000)
    rest = distributions.draw_residual(law, ages, 10_000, np.random.default_rng(8))
    assert rest[:5000].mean() > 1.5 * rest[5000:].mean()


def test_a_normal_without_spread_is_its_mean() -> None:
    law = Distribution("normal", {"mu": 10.0, "sigma": 0.0})
    rng = np.random.default_rng(9)
    assert distributions.draw(law, 3, rng).tolist() == [10.0] * 3
    assert distributions.draw_residual(law, 4.0, 3, rng).tolist() == [6.0] * 3
    assert distributions.draw_residual(law, 11.0, 3, rng).tolist() == [0.0] * 3


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (Distribution("cauchy", {}), "unknown distribution 'cauchy'"),
        (Distribution("normal", {"mu": 1.0}), "takes mu, sigma; got mu"),
        (Distribution("normal", {"mu": 1.0, "sigma": -1.0}), "sigma=-1.0 is out of range"),
        (Distribution("normal", {"mu": float("nan"), "sigma": 1.0}), "mu=nan"),
        (Distribution("weibull", {"shape": 0.0, "scale": 1.0}), "shape=0.0"),
        (Distribution("exponential", {"mean": -3.0}), "mean=-3.0"),
    ],
)
def test_an_unusable_law_is_refused(bad: Distribution, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        distributions.check_distribution(bad)
