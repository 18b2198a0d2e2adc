"""A step's evidence as the report shows it: every candidate with its fate, and the effects that are added."""

from collections.abc import Sequence

from sim.lab.discrepancy.diagnosis import CANNOT_TELL, NamedEffect, TraceOfEffect, TriedEffect
from sim.lab.discrepancy.fitting import Fitted
from sim.lab.discrepancy.judging import NamingResult, immaterial
from sim.lab.discrepancy.naming import EffectEvidence, NamingStep


def tried_effects(steps: Sequence[tuple[NamingStep, str]], kept: bool) -> tuple[TriedEffect, ...]:
    """Every entry of every step, in the order of their gains; `kept` says whether the names were given in the end."""
    tried = []
    for number, (step, refusal) in enumerate(steps, start=1):
        same, near = step.rules.same_least_cosine, step.rules.near_least_cosine
        size = {name: abs(cosine) for name, cosine in step.cosines.items()}
        for evidence in step.evidence:
            top = evidence is step.best
            refit = evidence.fitted
            tried.append(
                TriedEffect(
                    name=evidence.entry.name,
                    plain=evidence.entry.plain,
                    step=number,
                    gain=evidence.gain,
                    confirmed=evidence.is_joint,
                    visible=evidence.visible,
                    z=evidence.z,
                    robust=evidence.robust,
                    cycles=evidence.cycles,
                    params=dict(refit.state.named[-1].params if refit is not None else evidence.shape.params),
                    twins=tuple(name for name, cosine in size.items() if cosine >= same) if top else (),
                    rivals=tuple(name for name, cosine in size.items() if near <= cosine < same) if top else (),
                    needs=tuple(evidence.shape.signals.values()),
                    experiment=evidence.entry.experiment,
                    fate=fate(evidence, step, refusal, kept),
                )
            )
    return tuple(tried)


def fate(evidence: EffectEvidence, step: NamingStep, refusal: str, kept: bool) -> str:
    """Why an entry of a step was named or not, in words."""
    if evidence is step.best:
        return refusal or ("named" if kept else "the best of all, but the name is withheld")
    if evidence.visible < step.rules.invisible_most_share:
        return "not visible in these data: the model's own parameters imitate it"
    if evidence.entry.name in step.members or any(evidence is each for each in step.alike):
        return CANNOT_TELL
    if step.best is not None and step.best.is_joint and step.best.gain >= step.rules.least_gain_nats:
        return f"explains {step.best.gain - evidence.gain:.1f} nats less than the best"
    return "adds nothing that chance does not"


def small_effects(path: NamingResult) -> tuple[TraceOfEffect, ...]:
    """What the path met that is certain and does not matter."""
    best = [step.best for step, refusal in path.looks if refusal and immaterial(step)]
    return tuple(TraceOfEffect(each.entry.name, each.gain, each.amplitude) for each in best if each is not None)


def named_effect(step: NamingStep, after: Fitted, confidence: float) -> NamedEffect:
    """The step's best entry as it stands in the last fit."""
    best = step.best
    if best is None:
        raise ValueError("a step without evidence names nothing")
    named = next(each for each in after.state.named if each.entry.name == best.entry.name)
    _, error = after.strength(best.entry.name)
    return NamedEffect(
        name=best.entry.name,
        members=step.members,
        confidence=confidence,
        gain=best.gain,
        margin=step.margin,
        params=dict(named.params),
        errors={named.entry.strength: error},
        signals=dict(named.signals),
        signal_to_noise=best.amplitude / max(after.frame.record.model.sensor_sigma, 1e-6),
        plain=best.entry.plain,
        experiment=best.entry.experiment,
        look=best.entry.candidate.look,
    )
