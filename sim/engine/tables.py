"""The segments as affine steps s' = phi s + pull m + added + noise, with the thermostat closed and open.

Radiation is linearised about a course of X that is given for each segment; what the tangent leaves out is a heat of
second order in the distance from it, which `kernel.move` adds for each run.
"""

from dataclasses import dataclass

import numpy as np

from sim.effects import in_scale_of_x, parameter, radiation_tangent
from sim.engine.plant import Plant
from sim.engine.response import respond
from sim.engine.terms import Segments, Terms, terms
from sim.sha import Array


@dataclass(frozen=True, slots=True)
class Half:
    """n steps: `phi` and `noise` (n, d, d); `pull`, `added` and `unit` (n, d), the last left by a heat of 1 degC/s.

    `terms` are what they come from.
    """

    phi: Array
    pull: Array
    added: Array
    unit: Array
    noise: Array
    terms: Terms


@dataclass(frozen=True, slots=True)
class Tables:
    """The steps with the thermostat `closed` and, where there is one, `open`; `dt` (n,) s, `couplings` (n, 2) 1/s.

    `about` (n,) is the X that radiation was linearised about and `radiated` (n,) its gain; None without radiation.
    """

    closed: Half
    open: Half | None
    dt: Array
    couplings: Array
    about: Array | None
    radiated: Array | None


def tables(plant: Plant, segments: Segments, about: Array | None = None) -> Tables:
    """The steps of the segments; `about` (n,) is needed where the plant radiates."""
    sums = terms(plant, segments)
    gain = None
    if plant.radiation is not None and about is not None:
        acting, effect = plant.radiation, plant.radiation.effect
        zero = parameter(effect, "zero")
        if "ambient" in effect.signals and acting.mask[segments.location].any():
            around = in_scale_of_x(effect, "ambient", segments.signals)
        else:
            around = np.full(about.shape, effect.params.get("surroundings", np.nan))
        # Walls that were never read have no temperature; where nothing is radiated any will do.
        radiates = acting.mask[segments.location] & np.isfinite(around)
        gain = np.where(radiates, effect.params["gain"], 0.0)
        loss, heat = radiation_tangent(effect, gain=gain, about=about, around=np.where(radiates, around, zero))
        sums = _more(sums, loss, heat)
    couplings = plant.couplings[segments.location]
    closed = _half(plant, segments, sums)
    if plant.thermostat is None:
        return Tables(closed=closed, open=None, dt=segments.dt, couplings=couplings, about=about, radiated=gain)
    # An open thermostat is one more loss, towards its sink; nothing else differs between the two halves.
    p, acts = plant.thermostat.effect.params, plant.thermostat.mask[segments.location].astype(float)
    cooled = _more(sums, acts * p["loss"], acts * p["loss"] * p["sink"])
    opened = _half(plant, segments, cooled)
    return Tables(closed=closed, open=opened, dt=segments.dt, couplings=couplings, about=about, radiated=gain)


def _more(sums: Terms, loss: Array, heat: Array) -> Terms:
    heats = sums.heat.copy()
    heats[:, 0] += heat  # the constant part of the parabola
    return Terms(sums.loss + loss, heats, sums.drive)


def _half(plant: Plant, segments: Segments, sums: Terms) -> Half:
    answer = respond(plant, sums.loss, plant.couplings[segments.location], segments.dt, sums.powers)
    noise = answer.noise * (plant.noise[segments.location] ** 2)[:, None, None]
    return Half(
        phi=answer.phi,
        pull=np.einsum("ndq,nq->nd", answer.poly, sums.drive),
        added=np.einsum("ndq,nq->nd", answer.poly, sums.heat),
        unit=answer.poly[:, :, 0],
        noise=noise if answer.disturbed is None else noise + answer.disturbed,
        terms=sums,
    )


def noise_root(half: Half) -> Array:
    """(n, d, d) matrices R with R R^T = noise, also where that is singular."""
    if half.noise.shape[1] == 1:
        return np.sqrt(half.noise)
    # Eigenvalues and not Cholesky: a lag gets its noise through X alone, over a short step almost none. What rounding
    # leaves below 0 is 0.
    values, vectors = np.linalg.eigh(half.noise)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


def blend_steps(steps: Tables, opened: Array) -> Half:
    """Each step with the thermostat open for the part `opened` (n,) of it; without the terms of the open ones.

    A step in which it switches is taken between its two halves, which is right to first order in its length.
    """
    if steps.open is None or not opened.any():
        return steps.closed
    # Blended matrices, not blended states: one recursion over all steps can then take them (`moments_augmented`).
    a, b = steps.closed, steps.open
    flat, square = opened[:, None], opened[:, None, None]
    return Half(
        phi=a.phi + square * (b.phi - a.phi),
        pull=a.pull + flat * (b.pull - a.pull),
        added=a.added + flat * (b.added - a.added),
        unit=a.unit + flat * (b.unit - a.unit),
        noise=a.noise + square * (b.noise - a.noise),
        terms=a.terms,
    )
