"""A neighbour that nobody measures: heat that comes and goes slowly by itself, tied to no signal and to no cycle.

Straight pieces between knots so many hours apart, random and independent at each knot. It is a part of the noise, so it
has no course that could be foreseen, and its likelihood is the one with all that it may have been integrated out: it is
held against a name's as that is.
"""

from dataclasses import dataclass

import numpy as np

from sim.lab.discrepancy.fitting import Fitted, Whitener, heat_response, with_heats
from sim.lab.discrepancy.heat import HOUR_S
from sim.lab.discrepancy.screen import Projector
from sim.sha import Array

KNOT_SPACINGS_H = (1.0, 2.0, 4.0)
"""Hours between knots that are tried."""
MAX_KNOTS = 200
"""Knots at most: in a long record they lie further apart."""
ROUGH_HEAT_FACTORS = (0.5, 0.2, 1.2)
"""Times the plant's own rough heat that it may be before it is fitted, together with the scatter of the cycles: the
first at each distance of the knots, the others at the best."""
TRIED_FACTORS = np.geomspace(0.01, 10.0, 31)
"""The same where its gain is looked at without a fit."""
NEGLIGIBLE_SHARE = 1e-4
"""The share of a column's greatest value below which it is over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowHeat:
    """Such a heat beside a fit: `fitted` has it in its noise, `sigma` degC/s at a knot, `spacing` s between two.

    `heats` (m, c) is what it was fitted with (`with_heats`), `course` (m,) degC what it most likely did to the windows.
    `cycles` says in how many the fit errs less with it, of all.
    """

    fitted: Fitted
    sigma: float
    spacing: float
    heats: Array
    course: Array
    cycles: tuple[int, int]


def slow_heat(before: Fitted) -> SlowHeat:
    """The likeliest heat that comes and goes over hours."""
    sizes = [share * before.noise.rough for share in ROUGH_HEAT_FACTORS]
    spacings = knot_spacings(before)
    columns = {spacing: knot_columns(before, spacing) for spacing in spacings}
    tried = [(with_heats(before, sizes[0] * columns[spacing]), spacing, sizes[0]) for spacing in spacings]
    _, spacing, _ = max(tried, key=lambda each: each[0].likelihood)
    tried += [(with_heats(before, sigma * columns[spacing]), spacing, sigma) for sigma in sizes[1:]]
    fitted, spacing, sigma = max(tried, key=lambda each: each[0].likelihood)
    heats = sigma * columns[spacing]
    size = fitted.noise.cycle / before.noise.cycle
    weighed = Whitener(fitted.grid, fitted.noise).weigh(fitted.residual[:, None])[:, 0]
    old = before.residual * Whitener(before.grid, before.noise).weigh(before.residual[:, None])[:, 0]
    place = np.unique(before.grid.cycle, return_inverse=True)[1]
    less = np.bincount(place, old - fitted.residual * weighed)
    return SlowHeat(
        fitted=fitted,
        sigma=float(size * sigma),
        spacing=spacing,
        heats=heats,
        course=size**2 * heats @ (heats.T @ weighed),
        cycles=(int(np.count_nonzero(less > 0)), int(less.size)),
    )


def gain_at_once(before: Fitted) -> float:
    """nats of the likeliest such heat beside the noise of a fit that is without it."""
    # With the columns Z of the knots and what the fit's parameters leave of V^-1, P, the restricted likelihood changes
    # by -1/2 ln |I + s^2 Z' P Z| + 1/2 r' P Z s^2 (I + s^2 Z' P Z)^-1 Z' P r (Woodbury): a sum over eigenvectors.
    projector, best = Projector(before), 0.0
    for spacing in knot_spacings(before):
        columns = knot_columns(before, spacing)
        _, weighed, _ = projector.clean(columns)
        sizes, turned = np.linalg.eigh(columns.T @ weighed)
        score = turned.T @ (columns.T @ projector.weighed_residual)
        variance = (before.noise.rough * TRIED_FACTORS) ** 2
        grown = np.maximum(sizes, 0.0)[:, None] * variance
        gains = 0.5 * np.sum(score[:, None] ** 2 * variance / (1.0 + grown) - np.log1p(grown), axis=0)
        best = max(best, float(gains.max()))
    return best


def knot_spacings(before: Fitted) -> list[float]:
    """s between knots, each tried."""
    times = before.frame.record.runs.time
    least = float(times[-1] - times[0]) / MAX_KNOTS
    return list(dict.fromkeys(max(hours * HOUR_S, least) for hours in KNOT_SPACINGS_H))


def knot_columns(before: Fitted, spacing: float) -> Array:
    """(m, c) degC what 1 degC/s at each knot, fading to none at its neighbours, does to the windows."""
    record = before.frame.record
    middle = record.runs.time - record.runs.dt / 2.0
    count = max(round(float(middle[-1] - middle[0]) / spacing), 1)
    knots, step = np.linspace(middle[0], middle[-1], count + 1, retstep=True)
    added = heat_response(before.frame, before.state)
    out = np.column_stack([added(np.maximum(1.0 - np.abs(middle - knot) / step, 0.0)) for knot in knots])
    top = np.abs(out).max(axis=0)
    return np.where(np.abs(out) < NEGLIGIBLE_SHARE * top, 0.0, out)[:, top > 0]
