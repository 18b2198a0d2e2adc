"""Parameters of the given model that have moved: a finding of its own, and no missing effect."""

import numpy as np

from sim.effects import of_feature
from sim.lab.discrepancy.diagnosis import Shift
from sim.lab.discrepancy.fitting import Fitted, shown_locations
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import RATE_PARAMETERS
from sim.sha import RELAXING_FLOWS

DIFFERENCE_VARIANCE_RATIO = 2.0
"""Variance of the difference over that of one fit: the given value is as uncertain as the fitted one."""


def shifts(fitted: Fitted, rules: DecisionRules) -> tuple[Shift, ...]:
    """The moved parameters of a fit, the surest first; a target that lies off as machines do has not moved.

    A parameter is told in a location that the record shows; what no shown location has is not told at all: that it is
    fitted elsewhere than the model says is the belief's doing, or that of what else it is tied to.
    """
    frame = fitted.frame
    where = first_locations(fitted)
    sha = frame.record.model.sha
    p, r = frame.count
    variance = np.maximum(np.diag(fitted.covariance)[: p + r], 1e-300) * DIFFERENCE_VARIANCE_RATIO
    targets = [n for n, name in enumerate(frame.names.targets) if sha.by_name[name].flow.kind in RELAXING_FLOWS]
    for machine in of_feature(sha, "machine offset"):
        variance[targets] += machine.params["sigma"] ** 2
    errors = np.sqrt(variance)
    off = fitted.off[: p + r]
    moved = [
        _shift(fitted, number, where[number], float(off[number]), float(off[number] / errors[number]))
        for number in np.flatnonzero(np.abs(off) >= rules.moved_least_sigmas * errors).tolist()
        if number in where
    ]
    significant = [shift for shift in moved if _matters(shift, rules.moved_least_share)]
    return tuple(sorted(significant, key=lambda shift: -abs(shift.sigma)))


def _matters(shift: Shift, least: float) -> bool:
    change = (shift.after - shift.before) / max(abs(shift.before), 1e-12) if shift.change is None else shift.change
    return abs(change) >= least


def first_locations(fitted: Fitted) -> dict[int, str]:
    """number of a parameter, counted as the fit lays them out -> the first location that has it and is shown."""
    frame = fitted.frame
    shape, linear = frame.shape, frame.shape.centre.size
    where: dict[int, str] = {}
    for place in np.flatnonzero(shown_locations(frame)).tolist():
        rate = [linear + shape.rate[place]] if shape.rate[place] >= 0 else []
        for number in (shape.target[place], *shape.gain[place], *rate):
            where.setdefault(int(number), frame.record.model.sha.locations[place].name)
    where.pop(-1, None)
    return where


def _shift(fitted: Fitted, number: int, location: str, off: float, sigma: float) -> Shift:
    """The parameter of this number, counted through targets, gains and rates as the fit lays them out, as moved."""
    frame = fitted.frame
    targets, gains, rates = frame.names.targets, frame.names.gains, frame.names.rates
    model = frame.record.model
    by_name = model.sha.by_name
    before = float(frame.centre[number])
    if number < len(targets):
        name = targets[number]
        kind = by_name[name].flow.kind
        unit = f"{model.unit}/s" if kind == "linear" else model.unit
        size = before
        if RATE_PARAMETERS.get(kind) == "k":
            # A target stands for the heat that holds it above rest, so its change is told as a share of that height:
            # of the zero of degC it would say nothing. Within a degree of the lowest there is no height to speak of.
            height = before - float(np.min(frame.shape.centre[: len(targets)]))
            size = height if height > 1.0 else 0.0
        what = {"linear": "drift", "logarithmic": "factor", "transient": "amplitude"}.get(kind, "target")
        return Shift(
            location=location,
            parameter=what,
            before=before,
            after=before + off,
            unit=unit,
            change=_share(off, size),
            sigma=sigma,
        )
    if number < len(targets) + len(gains):
        group, signal = gains[number - len(targets)]
        return Shift(
            location=location,
            parameter=f"gain of {signal}",
            before=before,
            after=before + off,
            unit=f"{model.unit} per unit",
            change=_share(off, before),
            sigma=sigma,
        )
    group = rates[number - len(targets) - len(gains)]
    rate = RATE_PARAMETERS[by_name[group].flow.kind]
    old, new = float(np.exp(before)), float(np.exp(before + off))
    return Shift(
        location=location,
        parameter=rate,
        before=old,
        after=new,
        unit="1/s" if rate == "k" else "s",
        change=_share(new - old, old),
        sigma=sigma,
    )


def _share(off: float, size: float) -> float | None:
    """A change as a share of a size; None beyond all of it, where a share says nothing."""
    return off / abs(size) if 0 < abs(off) <= abs(size) else None
