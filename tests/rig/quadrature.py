"""First-passage probabilities by quadrature: an answer that owes nothing to drawing runs, to hold simulation against.

With known stays and mode parameters the temperature is a mean plus a Brownian motion W on a clock r of its own,

    X(t) = mean(t) + exp(-K(t)) W(r(t)),    K' = k (0 without relaxation),    r' = noise^2 exp(2 K),

so that reaching the limit b is W reaching the curve S = (b - mean) exp(K). The density g of the first passage of W
solves a Volterra equation of the second kind with a kernel that stays finite (Buonocore, Nobile & Ricciardi 1987),

    g(r) = -2 P(r | x0, 0) + 2 int_0^r g(q) P(r | S(q), q) dq,
    P(r | y, q) = (S'(r) - (S(r) - y) / (r - q)) / 2 * density of N(y, r - q) at S(r),

here by the trapezoidal rule on a grid that is finer near the start. Laws of mode parameters are integrated by
Gauss-Hermite.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import erfc, exp, sqrt

import numpy as np

from sim.sha import flows
from sim.sha.automaton import Flow
from sim.sha.flows import RELAXING_FLOWS
from sim.sha.trace import Array


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stay of `seconds` under a flow with noise, whose target is N(mean, sigma^2) (m's unit, offset included)."""

    flow: Flow
    mean: float
    seconds: float
    sigma: float = 0.0


def brownian(x0: float, drift: float, noise: float, limit: float, seconds: float) -> float:
    """P(x0 + drift t + noise W reaches `limit` >= x0 within `seconds`), closed form (inverse Gaussian law)."""
    distance, spread = limit - x0, noise * sqrt(seconds)
    if distance <= 0:
        return 1.0

    def beyond(z: float) -> float:
        return 0.5 * erfc(z / sqrt(2.0))

    reflected = beyond((distance + drift * seconds) / spread)
    factor = 2.0 * drift * distance / noise**2
    return beyond((distance - drift * seconds) / spread) + (exp(factor) * reflected if reflected > 0 else 0.0)


def first_passage(
    stretches: Sequence[Stretch], x0: float, limit: float, *, points: int | None = None, nodes: int | None = None
) -> float:
    """P(the temperature, at `x0` now, reaches `limit` during the stretches); no rate limit, no clamps.

    `points` of the grid (unless given 800, and 60 a time constant), `nodes` of each Gauss-Hermite rule (24
    for one drawn m, fewer for several). Raises ValueError without noise, and for x0 >= limit.
    """
    if x0 >= limit:
        raise ValueError(f"the limit {limit} is reached already at {x0}")
    if not all(one.flow.params["noise"] > 0 for one in stretches):
        raise ValueError("the quadrature needs a flow with noise in every stretch")
    constants = sum(one.flow.params["k"] * one.seconds for one in stretches if one.flow.kind in RELAXING_FLOWS)
    grid = _grid([one.seconds for one in stretches], points or max(800, int(60.0 * constants)))
    spread = [one.sigma > 0 for one in stretches]
    root, weight = np.polynomial.hermite_e.hermegauss(nodes or max(6, 24 // max(sum(spread), 1)))
    weight = weight / weight.sum()
    choices = [list(zip(root.tolist(), weight.tolist(), strict=True)) if wide else [(0.0, 1.0)] for wide in spread]
    total = 0.0
    for combination in product(*choices):
        targets = [one.mean + one.sigma * z for one, (z, _) in zip(stretches, combination, strict=True)]
        share = float(np.prod([w for _, w in combination]))
        if share > 1e-18:
            total += share * _passage(stretches, targets, x0, limit, grid)
    return total


def _grid(lengths: Sequence[float], points: int) -> list[Array]:
    """Each stretch's own times from its start; quadratically finer near it, where the curve has its kink."""
    whole = sum(lengths)
    counts = [max(int(points * length / whole), 40) for length in lengths]
    return [length * np.linspace(0.0, 1.0, count + 1) ** 2 for length, count in zip(lengths, counts, strict=True)]


def _passage(
    stretches: Sequence[Stretch], targets: Sequence[float], x0: float, limit: float, grid: Sequence[Array]
) -> float:
    clock, curve, slope = _curve(stretches, targets, x0, limit, grid)
    density = np.zeros(clock.size)
    width = np.diff(clock)
    weight = 0.5 * (np.append(width, 0.0) + np.append(0.0, width))
    # The first term needs no density, so all rows have it at once.
    free = -2.0 * _kernel(clock[1:], curve[1:], slope[1:], np.zeros(1), np.zeros(1))
    for j in range(1, clock.size):
        inner = _kernel(clock[j], curve[j], slope[j], curve[1:j], clock[1:j])
        density[j] = free[j - 1] + 2.0 * float(np.dot(density[1:j] * weight[1:j], inner))
    return float(np.dot(density, weight))


def _kernel(r: float | Array, s: float | Array, slope: float | Array, y: Array, q: Array) -> Array:
    ahead, rise = r - q, s - y
    normal = np.exp(-0.5 * rise * rise / ahead) / np.sqrt(2.0 * np.pi * ahead)
    return np.asarray(0.5 * (slope - rise / ahead) * normal)


def _curve(
    stretches: Sequence[Stretch], targets: Sequence[float], x0: float, limit: float, grid: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """(r, S, dS/dr) on the grid; the slope at a join is that of the stretch before it."""
    mean, exponent, clock = x0, 0.0, 0.0
    parts: list[tuple[Array, Array, Array]] = []
    for one, target, times in zip(stretches, targets, grid, strict=True):
        k = one.flow.params["k"] if one.flow.kind in RELAXING_FLOWS else 0.0
        noise = one.flow.params["noise"]
        decay, pull, _ = flows.coefficients(one.flow, 0.0, times)
        means = decay * mean + pull * target
        speed = flows.drift(one.flow, means, target, times)
        growth = np.exp(exponent + k * times)
        ticks = clock + noise**2 * exp(2.0 * exponent) * (np.expm1(2.0 * k * times) / (2.0 * k) if k else times)
        slope = (k * (limit - means) - speed) / (noise**2 * growth)
        first = 0 if not parts else 1
        parts.append((ticks[first:], ((limit - means) * growth)[first:], slope[first:]))
        mean, exponent, clock = float(means[-1]), exponent + k * one.seconds, float(ticks[-1])
    r, s, slope = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return r, s, slope
