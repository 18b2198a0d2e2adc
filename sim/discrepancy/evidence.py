"""A step's evidence as the report shows it: every candidate with its fate, and the effects that are added."""

from collections.abc import Sequence

import numpy as np

from sim.discrepancy.diagnosis import NamedEffect, TriedEffect
from sim.discrepancy.fitting import Fitted
from sim.discrepancy.naming import INVISIBLE, NEAR, SAME, EffectEvidence, NamingStep


def candidates_of(steps: Sequence[tuple[NamingStep, str]], kept: bool) -> tuple[TriedEffect, ...]:
    """Every entry of every step, in the order of their gains; `kept` says whether the names were given in the end."""
    return tuple(
        _candidate(one, number, each, refusal, kept)
        for number, (each, refusal) in enumerate(steps)
        for one in each.evidence
    )


def _candidate(one: EffectEvidence, number: int, step: NamingStep, refusal: str, kept: bool) -> TriedEffect:
    cosine = {name: abs(value) for name, value in step.cosines.items()}
    top = one is step.best
    return TriedEffect(
        name=one.entry.name,
        plain=one.entry.plain,
        step=number + 1,
        gain=one.gain,
        confirmed=one.confirmed,
        visible=one.visible,
        z=one.z,
        robust=one.robust,
        cycles=one.cycles,
        params=dict(one.fitted.state.named[-1].params if one.fitted is not None else one.shape.params),
        twins=tuple(name for name, value in cosine.items() if value >= SAME) if top else (),
        rivals=tuple(name for name, value in cosine.items() if NEAR <= value < SAME) if top else (),
        needs=tuple(one.shape.signals.values()),
        experiment=one.entry.experiment,
        fate=_fate(one, step, refusal, kept),
    )


def _fate(one: EffectEvidence, step: NamingStep, refusal: str, kept: bool) -> str:
    if one is step.best:
        return refusal or ("named" if kept else "the best of all, but the name is withheld")
    if one.visible < INVISIBLE:
        return "not visible in these data: the model's own parameters imitate it"
    if one.entry.name in step.members:
        return "these data cannot tell it from the best"
    if step.best is not None and not refusal:
        return f"explains {step.best.gain - one.gain:.1f} nats less than the best"
    return "adds nothing that chance does not"


def effect_of(step: NamingStep, after: Fitted) -> NamedEffect:
    """The step's best entry as it stands in the last fit."""
    best = step.best
    if best is None:
        raise ValueError("a step without evidence names nothing")
    number = next(n for n, one in enumerate(after.state.named) if one.entry.name == best.entry.name)
    named = after.state.named[number]
    error = float(np.sqrt(max(after.covariance[after.own + number, after.own + number], 0.0)))
    return NamedEffect(
        name=best.entry.name,
        members=step.members,
        confidence=confidence(step),
        gain=best.gain,
        margin=step.margin,
        params=dict(named.params),
        errors={named.entry.strength: error},
        signals=dict(named.signals),
        signal_to_noise=best.amplitude / max(after.frame.record.model.sensor_sigma, 1e-6),
        plain=best.entry.plain,
        experiment=best.entry.experiment,
    )


def confidence(step: NamingStep) -> float:
    """The share of the best name among all that the likelihood allows, equal odds before the data; at most 0.99."""
    gains = np.array([one.gain for one in step.evidence])
    null = step.threshold - np.log(99.0)  # what makes "nothing is missing" as likely as 1 in 100 at the threshold
    weights = np.exp(np.minimum(np.append(gains, null) - gains[0], 0.0))
    return float(min(1.0 / weights.sum(), 0.99))
