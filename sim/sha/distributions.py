"""The laws: normal for mode parameters; exponential, Weibull and log-normal for sojourn times; one table, no hierarchy.

A quantile function is all that sampling needs; the rest of a sojourn that has lasted u seconds is sampled by it too,
from S(u + t) / S(u) = v.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp, gamma, inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sim.sha.automaton import Distribution
from sim.sha.kinds import Indices, OfKind
from sim.sha.trace import Array
from sim.special import log_normal_cdf, normal_quantile_of_log

Params = Mapping[str, Any]
"""The constants of one law, numbers, or of one law for each of n draws, arrays (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Law:
    """One kind of law. `log_survival(params, t)` = ln P(T > t); `exceeded(params, s)` is its inverse in t."""

    params: tuple[str, ...]
    positive: tuple[str, ...]
    mean: Callable[[Params], float]
    variance: Callable[[Params], float]
    log_survival: Callable[[Params, Array], Array]
    exceeded: Callable[[Params, Array], Array]


def _log_survival_normal(p: Params, t: Array) -> Array:
    if p["sigma"] == 0:
        return np.where(t < p["mu"], 0.0, -np.inf)
    # P(T > t) = Phi(-(t - mu) / sigma). By its logarithm it is kept far out, where 1 - Phi is 0 in floating point and a
    # stay that has lasted longer than it should would have no law left.
    return log_normal_cdf(-(t - p["mu"]) / p["sigma"])


def _exceeded_normal(p: Params, s: Array) -> Array:
    return np.asarray(p["mu"] - p["sigma"] * np.where(p["sigma"], normal_quantile_of_log(s), 0.0))


def _log_survival_lognormal(p: Params, t: Array) -> Array:
    with np.errstate(divide="ignore"):  # the logarithm of 0 s is -inf, where the survival is 1: as it should be
        return log_normal_cdf(-(np.log(np.maximum(t, 0.0)) - p["mu"]) / p["sigma"])


LAWS: dict[str, Law] = {
    "normal": Law(
        params=("mu", "sigma"),
        positive=(),
        mean=lambda p: p["mu"],
        variance=lambda p: p["sigma"] ** 2,
        log_survival=_log_survival_normal,
        exceeded=_exceeded_normal,
    ),
    "exponential": Law(
        params=("mean",),
        positive=("mean",),
        mean=lambda p: p["mean"],
        variance=lambda p: p["mean"] ** 2,
        log_survival=lambda p, t: -np.maximum(t, 0.0) / p["mean"],
        exceeded=lambda p, s: -p["mean"] * s,
    ),
    "weibull": Law(
        params=("shape", "scale"),
        positive=("shape", "scale"),
        mean=lambda p: p["scale"] * gamma(1 + 1 / p["shape"]),
        variance=lambda p: p["scale"] ** 2 * (gamma(1 + 2 / p["shape"]) - gamma(1 + 1 / p["shape"]) ** 2),
        log_survival=lambda p, t: -((np.maximum(t, 0.0) / p["scale"]) ** p["shape"]),
        exceeded=lambda p, s: p["scale"] * (-s) ** (1 / p["shape"]),
    ),
    "lognormal": Law(
        params=("mu", "sigma"),
        positive=("sigma",),
        mean=lambda p: exp(p["mu"] + p["sigma"] ** 2 / 2),
        variance=lambda p: (exp(p["sigma"] ** 2) - 1) * exp(2 * p["mu"] + p["sigma"] ** 2),
        log_survival=_log_survival_lognormal,
        exceeded=lambda p, s: np.exp(p["mu"] - p["sigma"] * normal_quantile_of_log(s)),
    ),
}


def check_distribution(law: Distribution) -> None:
    """Raises ValueError, saying what would be right, for an unknown kind or unusable parameters."""
    kind = LAWS.get(law.kind)
    if kind is None:
        raise ValueError(f"unknown distribution {law.kind!r}: known are {', '.join(LAWS)}")
    if set(law.params) != set(kind.params):
        raise ValueError(f"distribution {law.kind!r} takes {', '.join(kind.params)}; got {', '.join(law.params)}")
    for name, value in law.params.items():
        if not isfinite(value) or (name in kind.positive and value <= 0) or (name == "sigma" and value < 0):
            raise ValueError(f"distribution {law.kind!r}: {name}={value} is out of range")
    # Its moments must be numbers too: exp, gamma and powers leave the range of floating point long before their
    # arguments do, and OverflowError would come where the model runs.
    try:
        moments = (kind.mean(law.params), kind.variance(law.params))
    except OverflowError:
        moments = (inf, inf)
    if not all(map(isfinite, moments)):
        shown = ", ".join(f"{name}={value:g}" for name, value in law.params.items())
        raise ValueError(f"distribution {law.kind!r}: its mean or variance is beyond all numbers with {shown}")


def mean(law: Distribution) -> float:
    """The law's mean, in the unit of its variable."""
    return LAWS[law.kind].mean(law.params)


def variance(law: Distribution) -> float:
    """The law's variance."""
    return LAWS[law.kind].variance(law.params)


def draw(law: Distribution, runs: int, rng: np.random.Generator) -> Array:
    """`runs` independent draws."""
    # Elsewhere ln P(T > t) of the drawn t is minus a standard exponential number: the inverse of the survival function,
    # without the 1 - u of a uniform one, which loses the tail.
    if law.kind == "normal":
        return rng.normal(law.params["mu"], law.params["sigma"], runs)
    return np.asarray(LAWS[law.kind].exceeded(law.params, -rng.exponential(size=runs)))


def draw_each(laws: tuple[OfKind, ...], which: Indices, rng: np.random.Generator) -> Array:
    """(n,) a draw by the law with each of the numbers `which` (n,), among those of `kinds.by_kind`; inf by none."""
    survived, drawn = -rng.exponential(size=which.size), np.full(which.size, inf)
    for each in laws:
        rows = each.members[which]
        drawn[rows] = LAWS[each.kind].exceeded(each.at(which[rows]), survived[rows])
    return drawn


def draw_residual(law: Distribution, age: ArrayLike, runs: int, rng: np.random.Generator) -> Array:
    """`runs` draws of the time still to stay, given that `age` seconds have passed: law of T - age given T > age."""
    kind = LAWS[law.kind]
    ages = np.asarray(age, dtype=float)
    survived = kind.log_survival(law.params, ages)
    return np.asarray(np.maximum(kind.exceeded(law.params, survived - rng.exponential(size=runs)) - ages, 0.0))
