"""The gap workflow: refit, gap, place, candidates, name or abstain, held-out proof; from traces to a Diagnosis.

The order is that of docs/discrepancy.md. Nothing is named unless the likelihood, the cycles, the free learner's ceiling
and the held-out cycles agree; what is not named is described.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.discrepancy.augment import named_of
from sim.discrepancy.baseline import frame_of, on
from sim.discrepancy.catalogue import CATALOGUE, ROLES
from sim.discrepancy.ceiling import ceiling
from sim.discrepancy.course import Named
from sim.discrepancy.diagnosis import Ceiling, Diagnosis, Verdict
from sim.discrepancy.evidence import candidates_of, effect_of
from sim.discrepancy.fit import Fitted, fit
from sim.discrepancy.held_out import Trial, by_cycles, compared
from sim.discrepancy.locate import places
from sim.discrepancy.moved import shifts
from sim.discrepancy.naming import MARGIN, MATERIAL, Step, entries_besides, step
from sim.discrepancy.record import Record, record_of
from sim.discrepancy.story import course_of, sentence_of
from sim.learning.preparation import encoded
from sim.sha.correction import in_sensor_scale
from sim.sha.model import Model
from sim.sha.trace import Trace

HELD_OUT = 0.3
LEAST_CYCLES = 4
"""Cycles below which nothing is said: three to fit, one to judge by."""
MOST_NAMES = 3
ROBUST, SPREAD = 2.0, 3.0
"""The z by cycles that a name needs, where its information is spread over at least so many cycles."""
CEILING_P, CEILING_SHARE = 0.01, 0.08
"""Heat that trees predict with such a p, and to such a share, is systematic."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Outcome:
    """A diagnosis, the effects that it adds to the model, and the fit that has them (None with too little data)."""

    diagnosis: Diagnosis
    named: tuple[Named, ...]
    fitted: Fitted | None


@dataclass(frozen=True, slots=True)
class Found:
    """The path of names: each step with its verdict in words ("" where its best entry was taken), and the last fit."""

    base: Fitted
    fitted: Fitted
    steps: tuple[tuple[Step, str], ...]

    @property
    def taken(self) -> tuple[Step, ...]:
        """The steps whose best entry was taken."""
        return tuple(one for one, refusal in self.steps if not refusal)


def diagnose(
    model: Model,
    traces: Sequence[Trace],
    *,
    seed: int,
    roles: Mapping[str, str] = ROLES,
    most: int = MOST_NAMES,
    progress: Progress | None = None,
) -> Outcome:
    """The diagnosis of `traces` against `model`, with at most `most` names.

    `roles` gives the signal of each role; those that no trace has take their effects off the table. Raises ValueError,
    in one sentence, when the traces cannot be followed at all.
    """
    told = progress or (lambda _stage, _share: None)
    model = in_sensor_scale(model)
    told("laying out the traces", 0.0)
    given = sorted((encoded(trace, model.alphabet) for trace in traces if trace.times.size), key=lambda t: t.times[0])
    present = present_roles(given, roles)
    record = record_of(model, given, signals_needed(model, present))
    cycles = np.unique(record.cycle)
    if cycles.size < LEAST_CYCLES:
        return Outcome(_too_little(model, int(cycles.size)), (), None)
    first = cycles[max(round((1.0 - HELD_OUT) * cycles.size), LEAST_CYCLES - 1)]
    whole = frame_of(record)
    training = on(whole, record.where(record.cycle < first))
    held_out = by_cycles(record.where(record.cycle >= first))
    told("fitting the model's own parameters", 0.05)
    base = fit(training, named_of(model))
    told("what a free learner could still explain", 0.2)
    before = ceiling(base, seed)
    found = name(base, present, seed, most, told)
    told("held-out cycles", 0.85)
    return _judged(model, found, held_out, before, present, roles, seed, told)


def present_roles(traces: Sequence[Trace], roles: Mapping[str, str]) -> dict[str, str]:
    """The roles whose signal some trace has with at least two different values."""
    present = {}
    for role, signal in roles.items():
        columns = [trace.signals[signal] for trace in traces if signal in trace.signals]
        known = np.concatenate([column[np.isfinite(column)] for column in columns]) if columns else np.empty(0)
        if known.size and np.ptp(known) > 0:
            present[role] = signal
    return present


def signals_needed(model: Model, present: Mapping[str, str]) -> tuple[str, ...]:
    """The inputs of the model's flows and the signals of the roles, each once."""
    inputs = [given.signal for location in model.sha.locations for given in location.flow.inputs]
    return tuple(dict.fromkeys([*inputs, *present.values()]))


def name(base: Fitted, present: Mapping[str, str], seed: int, most: int, told: Progress) -> Found:
    """Effects named one after the other, each on top of the ones before, until none deserves it."""
    fitted = base
    steps: list[tuple[Step, str]] = []
    for number in range(most):
        told(f"looking for effect {number + 1}", 0.25 + 0.6 * number / most)
        one = step(fitted, entries_besides(fitted.state.named), present, seed + number)
        refusal = insignificant(one) or dubious(one)
        steps.append((one, refusal))
        best = one.best
        if refusal or best is None or best.fitted is None:
            break
        fitted = best.fitted
    return Found(base, fitted, tuple(steps))


def insignificant(one: Step) -> str:
    """Why the best entry of a step is no more than chance, or a trifle; "" where something is missing."""
    best = one.best
    if best is None or not best.confirmed or best.gain < one.threshold:
        gain = best.gain if best is not None else 0.0
        return f"adds {gain:.1f} nats, and chance alone does {one.threshold:.1f} in one case of a hundred"
    sigma = max(one.before.frame.record.model.sensor_sigma, 1e-6)
    if best.amplitude < MATERIAL * sigma:
        return f"is there but moves the temperature by {best.amplitude:.3f} degC only, less than the sensor's noise"
    return ""


def dubious(one: Step) -> str:
    """Why the best entry of a step does not deserve its name though something is missing; "" where it does."""
    best = one.best
    if best is None:
        return "there is nothing to name"
    if best.spread >= SPREAD and best.robust < ROBUST and best.entry.sign != 0:
        return f"rests on few cycles ({best.cycles[0]} of {best.cycles[1]} speak for it)"
    if best.spread >= SPREAD and best.carried <= 0:
        return "does not carry over from cycle to cycle"
    if one.margin < MARGIN:
        return f"beats its rivals outside its class by {one.margin:.1f} nats only"
    return ""


def _judged(
    model: Model,
    found: Found,
    held_out: Record,
    before: Ceiling | None,
    present: Mapping[str, str],
    roles: Mapping[str, str],
    seed: int,
    told: Progress,
) -> Outcome:
    base, after = found.base, found.fitted
    held, first, second = compared(base, after, held_out, seed)
    left = ceiling(after, seed) if found.taken else before
    reasons = doubts(found, first, second, left)
    named = after.state.named
    verdict: Verdict = "agree"
    if named and reasons:
        verdict, named, after = "unexplained", (), base
        held, first, second = compared(base, base, held_out, seed)
    elif named:
        verdict = "named" if all(len(one.members) == 1 for one in found.taken) else "class"
    elif found.steps and not insignificant(found.steps[0][0]):
        verdict, reasons = "unexplained", (f"{found.steps[0][0].members[0]} {found.steps[0][1]}",)
    elif systematic(before):
        verdict, reasons = "unexplained", ("a free learner predicts heat on cycles that it has not seen",)
    told("where the heat is", 0.95)
    where = places(base, seed)
    remaining = places(after, seed) if named else where
    effects = tuple(effect_of(one, after) for one in found.taken) if named else ()
    moved = shifts(after)
    unexplained = remaining if verdict == "unexplained" or (named and systematic(left)) else ()
    sentence = sentence_of(verdict, effects, unexplained, moved, held, int(np.unique(base.frame.record.cycle).size))
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence=sentence,
        reasons=reasons,
        effects=effects,
        shifts=moved,
        places=where,
        unexplained=unexplained,
        ceiling_before=before,
        ceiling_after=left,
        candidates=candidates_of(found.steps),
        untested=untested(present, roles),
        held_out=held,
        course=course_of(base, after, first, second),
        settings=_settings(found, seed),
        model_before=model.sha.name,
        model_after=None,
    )
    return Outcome(diagnosis, named, after)


def systematic(one: Ceiling | None) -> bool:
    """True where a free learner predicts a share of the heat on unseen cycles that is no chance and no trifle."""
    return one is not None and one.p <= CEILING_P and one.share >= CEILING_SHARE


def doubts(found: Found, first: Trial, second: Trial, left: Ceiling | None) -> tuple[str, ...]:
    """Why names that the likelihood offers are not given after all."""
    reasons = []
    if found.taken and second.likelihood <= first.likelihood:
        reasons.append("the held-out cycles are not better foreseen with it")
    if found.taken and left is not None and systematic(left):
        reasons.append(f"a free learner still predicts {left.share:.0%} of the heat on cycles that it has not seen")
    return tuple(reasons)


def untested(present: Mapping[str, str], roles: Mapping[str, str]) -> dict[str, str]:
    """The effects that were off the table, with the reason."""
    out = {}
    for entry in CATALOGUE:
        missing = [role for role in entry.needs if role not in present]
        if missing:
            signal = roles.get(missing[0], missing[0])
            out[entry.name] = f"needs {signal} ({missing[0]}), which these traces do not have or which never changes"
    return out


def _settings(found: Found, seed: int) -> dict[str, float]:
    noise = found.fitted.noise
    return {
        "seed": float(seed),
        "threshold_nats": found.steps[0][0].threshold if found.steps else 0.0,
        "sensor_sigma": noise.sensor,
        "process_sigma": noise.process,
        "rough_sigma": noise.rough,
        "cycle_scatter": noise.cycle,
        "rough_memory_s": noise.memory,
    }


def _too_little(model: Model, cycles: int) -> Diagnosis:
    return Diagnosis(
        verdict="too-little-data",
        sentence=sentence_of("too-little-data", (), (), (), None, cycles),
        reasons=(f"{cycles} cycles in all; at least {LEAST_CYCLES} are needed, better ten",),
        effects=(),
        shifts=(),
        places=(),
        unexplained=(),
        ceiling_before=None,
        ceiling_after=None,
        candidates=(),
        untested={},
        held_out=None,
        course=None,
        settings={},
        model_before=model.sha.name,
        model_after=None,
    )
