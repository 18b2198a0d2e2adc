"""The gap workflow: refit, gap, place, candidates, name or abstain, held-out proof; from traces to a Diagnosis.

The order is that of docs/discrepancy.md. Nothing is named unless the likelihood, the cycles, the free learner's ceiling
and the held-out cycles agree; what is not named is described.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.discrepancy.beginning import beginning
from sim.discrepancy.ceiling import ceiling
from sim.discrepancy.consequence import follows
from sim.discrepancy.constants import absorbed
from sim.discrepancy.diagnosis import CandidateLaw, Ceiling, Diagnosis, HeldOutProof, NoiseFloor, Verdict
from sim.discrepancy.evidence import candidates_of, effect_of, traces_of
from sim.discrepancy.fitting import (
    Fitted,
    Named,
    Record,
    anchored,
    catalogue,
    first_cycle_after,
    fit,
    frame_of,
    given_fit,
    in_order,
    named_of,
    on,
    own_roles,
    patiently,
    record_of,
)
from sim.discrepancy.gap import Excess, excess, floor_of, sensor_noise, stated_errors
from sim.discrepancy.held_out import HeldOutRun, as_given, compared, let_run, surely_nearer
from sim.discrepancy.judging import (
    NamingResult,
    above,
    description,
    doubts,
    dubious,
    evidence_of,
    felt,
    immaterial,
    least_told,
    left_over,
    matters,
    systematic,
    too_short,
    untested,
)
from sim.discrepancy.law_search import candidate_laws
from sim.discrepancy.locate import places
from sim.discrepancy.missing_heat import missing_heat
from sim.discrepancy.moved import shifts
from sim.discrepancy.path import name
from sim.discrepancy.posterior import NamesEvidence, gains_of, names_evidence, posterior, shares_left
from sim.discrepancy.rules import RULES, DecisionRules
from sim.discrepancy.story import beginning_reason, course_of, little_sentence, sentence_of
from sim.effects import ROLES, in_sensor_scale, signals_of
from sim.sha import Array, EffectLine, Model, Trace, shown_unit, unit_of

MOST_NAMES = 3
TEMPERATURE_ROLES = ("ambient", "feed", "sink")
"""Roles of temperatures, which may as well be warmed by the machine as warm it."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class DiagnosisOutcome:
    """A diagnosis, the effects that it adds to the model, the fit that has them and the path to it (None with too
    little data). `against` is what speaks against the names of the path, given or withheld; None where it has none."""

    diagnosis: Diagnosis
    named: tuple[Named, ...]
    fitted: Fitted | None
    path: NamingResult | None
    against: NamesEvidence | None = None


def diagnose(
    model: Model,
    traces: Sequence[Trace],
    *,
    seed: int,
    roles: Mapping[str, str] = ROLES,
    lines: Sequence[EffectLine] = (),
    most: int = MOST_NAMES,
    experiments: Sequence[Trace] = (),
    without: Container[str] = (),
    progress: Progress | None = None,
    rules: DecisionRules = RULES,
) -> DiagnosisOutcome:
    """The diagnosis of `traces` against `model`, with at most `most` names.

    `lines` are engineers' own effects, which are looked for beside the catalogue's. `roles` gives the signal of each
    role of these; those that no trace has take their effects off the table. `experiments` are traces of experiments
    that were made to tell rivals apart: all of them are fitted, and none is held out. Names in `without` are not looked
    for: a cause that has one is then outside of the catalogue. `rules` decide. Raises ValueError, in one sentence, when
    the traces cannot be followed at all.
    """
    report = progress or (lambda _stage, _share: None)
    # Artefacts of the public learner know no unit: then that of the traces is the model's.
    model = replace(in_sensor_scale(model), unit=unit_of(traces, model.temperature, model.unit))
    report("laying out the traces", 0.0)
    usual = in_order(traces)
    laid_out = [patiently(trace, model.alphabet) for trace in (*usual, *in_order(experiments))]
    entries = tuple(entry for entry in catalogue(lines) if entry.name not in without)
    roles = {**roles, **own_roles(lines)}
    following = following_roles(model, laid_out, roles, rules)
    present = present_roles(laid_out, {role: each for role, each in roles.items() if role not in following})
    record = record_of(model, laid_out, signals_needed(model, present))
    first_made = first_cycle_after(record, usual)
    cycles = np.unique(record.window_cycle)  # those in which something was read
    cycles = cycles[cycles < first_made]
    if cycles.size < rules.least_cycles:
        return DiagnosisOutcome(_too_little(model, int(cycles.size), rules), (), None, None)

    # The last cycles are held out from everything but the proof: not even the screen may have seen them.
    first_held_out = cycles[max(round((1.0 - rules.held_out_share) * cycles.size), rules.least_cycles - 1)]
    to_fit = (record.cycle < first_held_out) | (record.cycle >= first_made)
    training = anchored(on(frame_of(record), record.where(to_fit)))
    held_out = record.where(~to_fit).by_cycles()

    # The refit comes first: what parameters that have moved explain is no missing effect.
    report("fitting the model's own parameters", 0.05)
    base = fit(training, named_of(model))
    report("what a free learner could still explain", 0.2)
    ceiling_before = ceiling(base, seed)
    enough = cycles.size >= rules.first_name_least_cycles
    allowed = min(most, int(cycles.size) // rules.each_name_least_cycles if enough else 0)
    paths = name(base, present, max(allowed, 1), report, rules=rules, entries=entries)

    report("held-out cycles", 0.85)
    by_cycles, sensor = training.record.by_cycles(), sensor_noise(training.record)
    stated = stated_errors(model, laid_out, base)
    floor = floor_of(stated, paths[0].explained, held_out, seed, rules)
    proof = _Proof(
        held_out=held_out,
        floor=floor,
        stated=stated,
        before=excess(stated, base, rules),
        ceiling=ceiling_before,
        seed=seed,
        rules=rules,
    )
    paths = (_with_the_gap_itself(paths[0], held_out, seed, floor), *paths[1:])
    if not allowed:
        few = f"would be named from fewer than {rules.first_name_least_cycles} cycles"
        paths = tuple(replace(path, fitted=base, steps=((path.steps[0][0], few),)) for path in paths[:1])
    judged = _longest_that_passes(proof, paths)
    path, kept = judged.path, bool(judged.path.taken) and not judged.reasons
    if kept:
        after, held, first, second = path.fitted, judged.held, let_run(base, held_out), judged.second
    else:
        # Nothing is added: what the report shows is the refit itself, or the model as given, if that is better.
        refit = judged.held.rmse_before
        given, fitted = let_run(as_given(base), held_out), let_run(base, held_out)
        refused = felt(refit, judged.held.rmse_given, sensor, rules) and surely_nearer(given, fitted, seed)
        base = after = given_fit(base) if refused else base
        held, first, second = compared(base, base, held_out, seed, floor)
        held = replace(held, rmse_refit=refit if refused else None)
    gap = above(held, floor, sensor, rules)
    # Fitted and held-out cycles by one fit: a refused name's errors are others, and would begin where it was held out.
    began = beginning((let_run(after, by_cycles), second), rules.material_sigmas * sensor, rules)
    material = matters(held, sensor, rules) and (gap or kept or bool(evidence_of(path, ceiling_before, proof.before)))
    ceiling_after, reasons = judged.ceiling, judged.reasons
    verdict: Verdict = "agree"
    if kept:
        verdict = "named" if all(len(step.members) == 1 for step in path.taken) else "class"
    elif material or began is not None:
        # Names that held-out cycles contradict are no evidence by themselves.
        verdict = "unexplained"
        # Where only the beginning shows it, what is said against names is that there is no gap but for that.
        reasons = (reasons if material else ()) or evidence_of(path, ceiling_before, proof.before)
        if began is not None:
            reasons = (beginning_reason(began, shown_unit(model.unit)), *reasons)
        # The free run says it by itself: further off than chance makes of the noise.
        if gap:
            error, limit = f"{held.rmse_before:.3g}", f"{floor.interval[1]:.3g} {shown_unit(model.unit)}"
            reasons = (*reasons, f"over held-out cycles the free run is off by {error}, noise alone by {limit} at most")
    else:
        reasons = ()
    varies, least = float(np.std(record.reading)), least_told(record.reading, sensor, rules)
    little = ""
    if verdict == "agree" and floor.interval[1] > least:
        verdict = "too-little-data"
        little = little_sentence(floor, held, varies, least, shown_unit(model.unit))
        reasons = (f"noise alone would have to be less than {least:.3g} {shown_unit(model.unit)} for that",)
    described = description(path) if verdict == "unexplained" else ""

    law = None
    if "current" in present:
        law = absorbed(after, present["current"], held_out, rules, pump=present.get("pump"))
    report("where the heat is", 0.95)
    where = places(base, seed, rules)
    remaining = places(after, seed, rules) if kept else where
    shown = held.ci95 is not None and held.ci95[0] > 0.0
    taken = path.taken if kept else ()
    against = names_evidence(judged.held, ceiling_before, judged.ceiling, rules)
    sure = [posterior(gains_of(step), against, rules) for step in taken]
    effects = tuple(
        replace(effect_of(step, after, each.confidence(step.members)), shrinking_shown=shown)
        for step, each in zip(taken, sure, strict=True)
    )
    none_of_these = max((each.none_of_these for each in sure), default=None)
    moved = shifts(after, rules)
    unexplained = remaining if verdict == "unexplained" or (kept and systematic(ceiling_after, rules)) else ()
    laws: tuple[CandidateLaw, ...] = ()
    if verdict == "unexplained":
        report("laws to look at", 0.97)
        # All that is measured, not only what the catalogue knows a role for: a record of its own on the same knots.
        everything = record_of(model, laid_out, measured_signals(model, laid_out, rules))
        until = int(first_held_out)
        laws = candidate_laws(base, everything, until, floor.error, rules, fitted_again=first_made)
    fitted_cycles = int(np.unique(base.frame.record.window_cycle).size)
    noise = path.fitted.noise
    excesses = {"excess_before": proof.before, "excess_after": judged.excess}
    diagnosis = Diagnosis(
        verdict=verdict,
        sentence=sentence_of(
            verdict,
            effects,
            unexplained=unexplained,
            description=described,
            shifts=moved,
            held=held,
            cycles=fitted_cycles,
            traces=traces_of(path),
            law=law,
            unit=shown_unit(model.unit),
            began=began,
            gap=gap,
            little=little,
            none_of_these=none_of_these,
        ),
        reasons=reasons,
        effects=effects,
        shifts=moved,
        places=where,
        unexplained=unexplained,
        ceiling_before=ceiling_before,
        ceiling_after=ceiling_after if kept else None,
        candidates=candidates_of(path.looks, kept),
        material=material,
        traces=traces_of(path),
        absorbed=law,
        untested={
            **too_short(entries, path),
            **untested(entries, present, roles, following=following, temperature=model.temperature),
        },
        held_out=held,
        floor=floor,
        began=began,
        course=course_of(base, after, first, second),
        settings={
            "seed": float(seed),
            "threshold_nats": rules.least_gain_nats,
            "sensor_sigma": noise.sensor,
            "process_sigma": noise.process,
            "rough_sigma": noise.rough,
            "cycle_scatter": noise.cycle,
            "rough_memory_s": noise.memory,
            "lasting_sigma": noise.lasting,
            **{key: each.median for key, each in excesses.items() if each is not None},
            **(shares_left(against) if kept else {}),
        },
        model_before=model.sha.name,
        model_after=None,
        unit=model.unit,
        laws=laws,
        description=described,
        missing_heat=missing_heat(base, record, cycles[cycles >= first_held_out]),
        none_of_these=none_of_these,
    )
    return DiagnosisOutcome(diagnosis, after.state.named if kept else (), after, path, against if path.taken else None)


def present_roles(traces: Sequence[Trace], roles: Mapping[str, str]) -> dict[str, str]:
    """The roles whose signal some trace has with at least two different values."""
    present = {}
    for role, signal in roles.items():
        columns = [trace.signals[signal] for trace in traces if signal in trace.signals]
        known = np.concatenate([column[np.isfinite(column)] for column in columns]) if columns else np.empty(0)
        if known.size and np.ptp(known) > 0:
            present[role] = signal
    return present


def following_roles(
    model: Model, traces: Sequence[Trace], roles: Mapping[str, str], rules: DecisionRules
) -> frozenset[str]:
    """The roles of temperatures whose signal follows the model's own (`follows`); one that the model reads is kept."""
    read = set(_inputs(model)) | {*signals_of(model.sha)}
    asked = {role: roles[role] for role in TEMPERATURE_ROLES if role in roles and roles[role] not in read}
    return frozenset(role for role, signal in asked.items() if follows(traces, model.temperature, signal, rules))


def _inputs(model: Model) -> tuple[str, ...]:
    """The signals that the model's flows are driven by, each as often as it drives one."""
    return tuple(driving.signal for location in model.sha.locations for driving in location.flow.inputs)


def signals_needed(model: Model, present: Mapping[str, str]) -> tuple[str, ...]:
    """The inputs of the model's flows and the signals of the roles, each once."""
    return tuple(dict.fromkeys([*_inputs(model), *present.values()]))


def measured_signals(model: Model, traces: Sequence[Trace], rules: DecisionRules) -> tuple[str, ...]:
    """All signals that some trace has with at least two different values, none of which follows the temperature."""
    names = dict.fromkeys(name for trace in traces for name in trace.signals if name != model.temperature)
    present = present_roles(traces, {name: name for name in names})
    causes = [name for name in present if not follows(traces, model.temperature, name, rules)]
    return tuple(dict.fromkeys([*_inputs(model), *causes]))


@dataclass(frozen=True, slots=True)
class _Proof:
    """What names are judged by: held-out cycles with their floor, what the model states, excess and ceiling before."""

    held_out: Record
    floor: NoiseFloor
    stated: Array
    before: Excess | None
    ceiling: Ceiling | None
    seed: int
    rules: DecisionRules


@dataclass(frozen=True, slots=True)
class _JudgedPath:
    """A path of names with the reasons against them (none: they are given), and what the reasons were drawn from."""

    path: NamingResult
    reasons: tuple[str, ...]
    held: HeldOutProof
    second: HeldOutRun
    ceiling: Ceiling | None
    excess: Excess | None


def _longest_that_passes(proof: _Proof, paths: Sequence[NamingResult]) -> _JudgedPath:
    """The first of the paths, the longest first, whose names pass on held-out cycles; the first one where none does."""
    judged = []
    for path in paths:
        shorter = next((each for each in paths if len(each.taken) == len(path.taken) - 1 and each.taken), None)
        judged.append(_judge_path(proof, path, shorter))
        if not judged[-1].reasons:
            return judged[-1]
    return judged[0]


def _judge_path(proof: _Proof, path: NamingResult, shorter: NamingResult | None) -> _JudgedPath:
    held, first, second = compared(path.base, path.fitted, proof.held_out, proof.seed, proof.floor)
    left = ceiling(path.fitted, proof.seed) if path.taken else proof.ceiling
    excess_after = excess(proof.stated, path.fitted, proof.rules) if path.taken else proof.before
    reasons = (
        *doubts(
            path,
            first,
            second=second,
            held=held,
            before=proof.ceiling,
            left=left,
            shorter=None if shorter is None else let_run(shorter.fitted, proof.held_out),
        ),
        *left_over(path, proof.before, excess_after),
    )
    return _JudgedPath(path=path, reasons=reasons, held=held, second=second, ceiling=left, excess=excess_after)


def _with_the_gap_itself(path: NamingResult, held_out: Record, seed: int, floor: NoiseFloor) -> NamingResult:
    """The path with the certain effect that was refused as too small, where the held-out gap is that effect.

    What it does to the fitted cycles says little of what the model's parameters, which have made room for it there, are
    off by elsewhere.
    """
    step = path.nuisances[0] if path.nuisances else path.steps[-1][0]
    rules = step.rules
    if path.taken or not immaterial(step) or dubious(step) or step.best is None or step.best.fitted is None:
        return path
    held, _, _ = compared(path.base, step.best.fitted, held_out, seed, floor)
    removed, interval = held.excess_removed, held.ci95
    if not matters(held, sensor_noise(path.base.frame.record), rules) or removed is None or interval is None:
        return path
    if removed < rules.gap_itself_least_share or interval[0] <= 0:
        return path
    return replace(path, fitted=step.best.fitted, steps=((step, ""),))


def _too_little(model: Model, cycles: int, rules: DecisionRules) -> Diagnosis:
    needed = f"at least {rules.least_cycles} are needed, better ten"
    return Diagnosis(
        verdict="too-little-data",
        sentence=sentence_of("too-little-data", (), unexplained=(), shifts=(), held=None, cycles=cycles, unit=""),
        reasons=(f"{cycles} cycle{'' if cycles == 1 else 's'} in all; {needed}",),
        effects=(),
        shifts=(),
        places=(),
        unexplained=(),
        ceiling_before=None,
        ceiling_after=None,
        candidates=(),
        material=False,
        traces=(),
        absorbed=None,
        untested={},
        held_out=None,
        floor=None,
        began=None,
        course=None,
        settings={},
        model_before=model.sha.name,
        model_after=None,
        unit=model.unit,
    )
