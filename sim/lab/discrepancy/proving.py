"""What the held-out cycles prove: which names stand, whether there is a gap without one, since when; the verdict."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.lab.discrepancy.beginning import beginning
from sim.lab.discrepancy.ceiling import ceiling
from sim.lab.discrepancy.diagnosis import CandidateLaw, Ceiling, GapBeginning, HeldOutProof, NoiseFloor, Verdict
from sim.lab.discrepancy.fitting import CatalogueEntry, Fitted, Record, fit, given_model_fit, move_frame, restore_fit
from sim.lab.discrepancy.gap import (
    Excess,
    add_leftover,
    excess,
    noise_floor,
    sensor_noise,
    stated_errors,
    told_by_all,
)
from sim.lab.discrepancy.held_out import (
    HeldOutRun,
    RunsBefore,
    compare_fits,
    foretold,
    let_run,
    reference_runs,
    surely_nearer,
)
from sim.lab.discrepancy.judging import (
    NamingResult,
    beyond_chance,
    contradiction,
    description,
    doubts,
    foreseen_better,
    gap_evidence,
    insignificant,
    is_gap,
    is_noticeable,
    leftover_reasons,
    matters,
    min_noticeable_error,
    refusal_reason,
    systematic,
    uncertain_strengths,
)
from sim.lab.discrepancy.layout import DataLayout
from sim.lab.discrepancy.naming import NamingStep, margin_of_class
from sim.lab.discrepancy.onset import find_onset
from sim.lab.discrepancy.posterior import NamesEvidence, names_evidence, posterior, step_gains
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.story import beginning_reason, little_sentence
from sim.sha import Array, display_unit

DATED_EFFECT = "sensor-offset-step"
"""The name that has a moment of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NamesSearched:
    """What the fitted cycles gave: the refit `base`, what a free learner could still explain of it, and the path of
    names with its beginnings, the longest first; `allowed` is how many names there may be."""

    base: Fitted
    ceiling: Ceiling | None
    paths: Sequence[NamingResult]
    allowed: int


@dataclass(frozen=True, slots=True)
class Proof:
    """What names are judged by: held-out cycles with their floor and the `runs` over them before there are names, what
    the model states, excess and ceiling before; `first_made` is the first piece of evidence of an experiment."""

    held_out: Record
    runs: RunsBefore
    floor: NoiseFloor
    stated: Array
    before: Excess | None
    ceiling: Ceiling | None
    seed: int
    rules: DecisionRules
    first_made: float = np.inf


@dataclass(frozen=True, slots=True)
class JudgedPath:
    """A path of names with the reasons against them (none: they are given), and what the reasons were drawn from;
    `floor` is the one that `held` was told with."""

    path: NamingResult
    reasons: tuple[str, ...]
    floor: NoiseFloor
    held: HeldOutProof
    second: HeldOutRun
    ceiling: Ceiling | None
    excess: Excess | None

    @property
    def names_hold(self) -> bool:
        """Whether there are names and nothing speaks against them."""
        return bool(self.path.accepted_steps) and not self.reasons


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldFits:
    """The fits of the report: `base` before anything was added (the refit, or the model as given where the refit is
    refused), `after` with the names, where they are kept; `first` and `second` are their held-out runs."""

    base: Fitted
    after: Fitted
    held: HeldOutProof
    first: HeldOutRun
    second: HeldOutRun


@dataclass(frozen=True, slots=True, kw_only=True)
class ProvenFindings:
    """What was proved: the `verdict` with its `reasons`, and the figures that it follows from.

    `names_hold`: the names of the judged path are given; `against` is what speaks against them. `excess` is that of the
    fitted cycles before, and `stated` (degC rms) what the given model allows itself on them. `gap`: the error is beyond
    the floor's interval. `little` says why agreement would say nothing, "" where it does.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    judged: JudgedPath
    kept: bool
    against: NamesEvidence
    told: ToldFits
    floor: NoiseFloor
    excess: Excess | None
    stated: float
    began: GapBeginning | None
    gap: bool
    material: bool
    little: str


def prove(
    layout: DataLayout,
    search: NamesSearched,
    held_out: Record,
    entries: Sequence[CatalogueEntry],
    *,
    seed: int,
    rules: DecisionRules,
) -> ProvenFindings:
    """The names that stand on held-out cycles, or what else there is, with the verdict."""
    base, paths = search.base, search.paths
    training = base.frame.record
    sensor = sensor_noise(training)
    stated = stated_errors(layout.model, layout.traces, base)
    floor = noise_floor(stated, paths[0].best_fit, held_out, seed, rules)
    proof = Proof(
        held_out=held_out,
        runs=reference_runs(base, held_out),
        floor=floor,
        stated=stated,
        before=excess(stated, base, rules),
        ceiling=search.ceiling,
        seed=seed,
        rules=rules,
        first_made=layout.first_made,
    )
    paths = (as_special_case(proof, paths[0]), *paths[1:])
    longer = readmit_effect(proof, paths[0]), with_the_gap_itself(proof, paths[0])
    paths = (*(path for path in longer if path is not paths[0]), *paths)
    if not search.allowed:
        few = f"would be named from fewer than {rules.first_name_least_cycles} cycles"
        paths = tuple(replace(path, fitted=base, steps=((path.steps[0][0], few),)) for path in paths[:1])
    judged = longest_that_passes(proof, paths)
    told, began = _report_fits(proof, layout, entries, judged)
    while judged.names_hold and began is not None and began_otherwise(judged.path, began):
        shorter = [path for path in paths if len(path.accepted_steps) < len(judged.path.accepted_steps)]
        other = longest_that_passes(proof, shorter) if shorter else None
        judged = other if other is not None and other.names_hold else replace(judged, reasons=(onset_refusal(began),))
        told, still = _report_fits(proof, layout, entries, judged)
        began = still if judged.names_hold else still or began
    path, kept = judged.path, judged.names_hold
    floor = judged.floor if kept else floor
    gap = is_gap(told.held, floor, sensor, rules)
    covered = told.held.rmse_before <= rules.covered_most_times * floor.error
    # For a gap speaks what an experiment's repetitions tell of one another, too; against names it would say too much.
    whole = ceiling(base, seed) if np.isfinite(layout.first_made) else search.ceiling
    evidence = gap_evidence(path, whole, proof.before, covered=covered)
    material = matters(told.held, sensor, rules) and (gap or kept or bool(evidence))
    # What has no name need not act while the last cycles run: a greasing fades, a neighbour comes and goes.
    material = material or bool(description(judged.path))
    unit, little = display_unit(layout.model.unit), ""
    if kept:
        verdict: Verdict = "named" if all(len(step.members) == 1 for step in path.accepted_steps) else "class"
        reasons = judged.reasons
    elif material or began is not None:
        verdict = "unexplained"
        # Names that held-out cycles contradict are no evidence by themselves. Where only the beginning shows a gap,
        # what is said against names is that there is none but for that.
        reasons = (judged.reasons if material else ()) or evidence
        reasons = reasons if began is None else (beginning_reason(began, unit), *reasons)
        # The free run says it by itself: further off than chance makes of the noise.
        if gap:
            error, limit = f"{told.held.rmse_before:.3g}", f"{floor.interval[1]:.3g} {unit}"
            reasons = (*reasons, f"over held-out cycles the free run is off by {error}, noise alone by {limit} at most")
    else:
        verdict, reasons = "agree", beyond_chance(judged.path, judged.reasons)
        readings = layout.record.reading
        least = min_noticeable_error(readings, sensor, rules)
        if floor.interval[1] > least:
            verdict = "too-little-data"
            little = little_sentence(floor, told.held, float(np.std(readings)), least, unit)
            reasons = (f"noise alone would have to be less than {least:.3g} {unit} for that",)
    return ProvenFindings(
        verdict=verdict,
        reasons=reasons,
        judged=judged,
        kept=kept,
        against=names_evidence(judged.held, search.ceiling, judged.ceiling, rules),
        told=told,
        floor=floor,
        excess=proof.before,
        stated=float(np.sqrt(np.mean(stated**2))),
        began=began,
        gap=gap,
        material=material,
        little=little,
    )


def _report_fits(
    proof: Proof, layout: DataLayout, entries: Sequence[CatalogueEntry], judged: JudgedPath
) -> tuple[ToldFits, GapBeginning | None]:
    """The fits of the report, and since when there is a gap that they leave."""
    rules, training = proof.rules, judged.path.base.frame.record
    least = rules.material_sigmas * sensor_noise(training)
    told = told_fits(proof, judged, kept=judged.names_hold)
    # Fitted and held-out cycles by one fit: a refused name's errors are others, and would begin where it was held out.
    # Of an experiment nothing is told: what a machine lacks shows there as it never did, and would begin with it.
    usual, second = training.select(training.cycle < layout.first_made), told.second
    if layout.made.size:
        held_out = proof.held_out.select(proof.held_out.cycle < layout.first_made)
        second = let_run(told.after, held_out.by_cycles())
    trials = let_run(told.after, usual.by_cycles()), second
    since = with_all_cycles(told.after, layout)
    return told, find_onset(since, entries, layout.present, least, rules) or beginning(trials, least, rules)


def began_otherwise(path: NamingResult, began: GapBeginning) -> bool:
    """Whether what begins says that the names are none: one of them acts from a moment on that the model would have
    act all along, or a sensor is said to have moved at a moment and the gap still begins at one."""
    names = {name for step in path.accepted_steps for name in step.members}
    return bool(began.acts) and (began.acts in names or DATED_EFFECT in names)


def onset_refusal(began: GapBeginning) -> str:
    """Why names are withheld from a gap that begins."""
    return f"the gap begins with it half-way still (most like {began.acts}), and a name would act all along"


def with_laws(found: ProvenFindings, laws: Sequence[CandidateLaw]) -> ProvenFindings:
    """The findings, with a gap where a law foresees what the model's own noise does not cover: noise follows none."""
    if found.verdict == "unexplained" or found.excess is None or not laws:
        return found
    words = f"{found.excess.words()}, and a law of what is measured foresees it"
    return replace(found, verdict="unexplained", reasons=(words,), material=True, little="")


def with_agreed_floor(found: ProvenFindings) -> ProvenFindings:
    """The findings; where nothing is missing, with a floor that the held-out cycles tell as well as the fitted ones.

    What they agreed by is the floor that was told without them: no verdict hangs on this one.
    """
    if found.verdict != "agree":
        return found
    held, fitted = found.told.held, np.unique(found.told.base.frame.record.window_cycle).size
    floor = told_by_all(found.floor, held.rmse_before, held.pieces / (held.pieces + fitted))
    each = zip(held.per_cycle, floor.per_cycle.tolist(), strict=True)
    per_cycle = tuple((before, after, own) for (before, after, _), own in each)
    held = replace(held, noise_floor=floor.error, per_cycle=per_cycle)
    return replace(found, floor=floor, told=replace(found.told, held=held))


def with_all_cycles(after: Fitted, layout: DataLayout) -> Fitted:
    """The fit, with its names, of all cycles, the held-out ones included: what begins may begin with any of them."""
    record = layout.record
    if np.isfinite(layout.first_made):
        record = record.select(record.cycle < layout.first_made)
    begin = replace(after, start=record.reading[record.window_first])
    return fit(move_frame(after.frame, record), after.state.named, begin, rounds=2)


def told_fits(proof: Proof, judged: JudgedPath, *, kept: bool) -> ToldFits:
    """The fits before and after that the report shows: with the names, where these are `names_hold`.

    Where nothing is added, both are the refit itself, or the model as given, if held-out cycles say that it is better.
    """
    base, runs = judged.path.base, proof.runs
    if kept:
        return ToldFits(base=base, after=judged.path.fitted, held=judged.held, first=runs.refit, second=judged.second)
    refit, sensor = judged.held.rmse_before, sensor_noise(base.frame.record)
    worse = is_noticeable(refit, judged.held.rmse_given, sensor, proof.rules)
    refused = worse and surely_nearer(runs.given, runs.refit, proof.seed)
    if refused:
        base = given_model_fit(base)
        runs = reference_runs(base, proof.held_out)
    held, first, second = compare_fits(base, base, proof.held_out, proof.seed, proof.floor, runs=runs)
    held = replace(held, rmse_refit=refit if refused else None)
    return ToldFits(base=base, after=base, held=held, first=first, second=second)


def longest_that_passes(proof: Proof, paths: Sequence[NamingResult]) -> JudgedPath:
    """The first of the paths, the longest first, whose names pass on held-out cycles; the first one where none does."""
    judged = []
    for path in paths:
        shorter = next(
            (
                each
                for each in paths
                if len(each.accepted_steps) == len(path.accepted_steps) - 1 and each.accepted_steps
            ),
            None,
        )
        judged.append(_judge_path(proof, path, shorter))
        if not judged[-1].reasons:
            return judged[-1]
    return judged[0]


def _judge_path(proof: Proof, path: NamingResult, shorter: NamingResult | None) -> JudgedPath:
    held, first, second = compare_fits(path.base, path.fitted, proof.held_out, proof.seed, proof.floor, runs=proof.runs)
    floor = proof.floor
    foreseen = foreseen_better(first, second)
    if path.accepted_steps and foreseen >= proof.rules.margin_nats:
        floor = add_leftover(floor, held.rmse_after, proof.rules)
        held, *_ = compare_fits(
            path.base, path.fitted, proof.held_out, proof.seed, floor, runs=proof.runs, second=second
        )
    left = ceiling(path.fitted, proof.seed, proof.first_made) if path.accepted_steps else proof.ceiling
    # What a free learner still finds says that the shapes are not quite right, and by so little one may beat another.
    more = proof.rules.margin_nats if path.accepted_steps and systematic(left, proof.rules) else 0.0
    apart = tuple(step if why else separate_rivals(proof, step, more) for step, why in path.steps)
    if any(one is not step for one, (step, _) in zip(apart, path.steps, strict=True)):
        path = replace(path, steps=tuple((one, why) for one, (_, why) in zip(apart, path.steps, strict=True)))
    excess_after = excess(proof.stated, path.fitted, proof.rules) if path.accepted_steps else proof.before
    reasons = (
        *doubts(
            path,
            first,
            second=second,
            held=held,
            before=proof.ceiling,
            left=left,
            shorter=None if shorter is None else let_run(shorter.fitted, proof.held_out),
            given_is_nearer=surely_nearer(proof.runs.given, second, proof.seed),
        ),
        *uncertain_strengths(path),
        *leftover_reasons(path, foreseen, proof.before, excess_after),
        *(f"{step.members[0]} {why}" for step in path.accepted_steps if (why := refusal_reason(step))),
        *unlikely(path, names_evidence(held, proof.ceiling, left, proof.rules), proof.rules),
    )
    return JudgedPath(
        path=path, reasons=reasons, floor=floor, held=held, second=second, ceiling=left, excess=excess_after
    )


def unlikely(path: NamingResult, against: NamesEvidence, rules: DecisionRules) -> tuple[str, ...]:
    """Why names are withheld that are less likely than not by their own confidence: what has no name, or none of these,
    is likelier."""
    sure = [posterior(step_gains(step), against, rules).confidence(step.members) for step in path.accepted_steps]
    return tuple(
        f"{step.members[0]} is less likely than what has no name or than none of these ({confidence:.2g})"
        for step, confidence in zip(path.accepted_steps, sure, strict=True)
        if confidence < rules.named_least_confidence
    )


def separate_rivals(proof: Proof, step: NamingStep, more: float = 0.0) -> NamingStep:
    """The step with the gains of what stands near its best by all cycles: the held-out ones count as each foretells
    them from the fitted, and `more` nats for each that the best must beat."""
    best, rules = step.best, step.rules
    if best is None or best.fitted is None:
        return step
    reach = rules.told_apart_times * margin_of_class(best.gain, rules)
    near = [each for each in step.evidence[1:] if each.fitted is not None and best.gain - each.gain < reach]
    if not near:
        return step
    run = let_run(best.fitted, proof.held_out)
    first = foretold(best.fitted, run, run.whitener)
    moved = {
        each.entry.name: foretold(each.fitted, let_run(each.fitted, proof.held_out), run.whitener) - first + more
        for each in near
        if each.fitted is not None
    }
    others = (replace(each, gain=each.gain + moved.get(each.entry.name, 0.0)) for each in step.evidence[1:])
    return replace(step, evidence=(best, *others))


def as_special_case(proof: Proof, path: NamingResult) -> NamingResult:
    """The path whose last name is the special case of itself, where by all cycles it does no better than that."""
    step = path.accepted_steps[-1] if path.accepted_steps else None
    if step is None or step.best is None:
        return path
    wider, apart = step.best, separate_rivals(proof, step)
    near = wider.gain - margin_of_class(wider.gain, step.rules)
    special = [each for each in apart.evidence[1:] if each.entry.name in wider.entry.candidate.special]
    same = [each for each in special if each.fitted is not None and each.gain > near]
    if not same or same[0].fitted is None:
        return path
    fitted = restore_fit(same[0].fitted)
    names = [[each.entry.name for each in one.state.named if each.entry.name != own.entry.name]
             for one, own in ((fitted, same[0]), (path.fitted, wider))]  # fmt: skip
    if names[0] != names[1]:
        return path
    mine = next(each for each in step.evidence if each.entry.name == same[0].entry.name)
    others = (each for each in step.evidence if each is not wider and each is not mine)
    narrower = replace(step, evidence=(replace(mine, fitted=fitted), *others))
    return replace(path, fitted=fitted, steps=(*((each, "") for each in path.accepted_steps[:-1]), (narrower, "")))


def readmit_effect(proof: Proof, path: NamingResult) -> NamingResult:
    """The path with the effect that was refused for its rivals alone, where held-out cycles tell it from them."""
    step = path.steps[-1][0]
    best = step.best
    names = [each.best.entry.name for each in path.accepted_steps if each.best is not None]
    before = [named.entry.name for named in step.before.state.named if named.existing is None]
    if best is None or best.fitted is None or best.entry.rival or names != before:
        return path
    if step.margin >= step.rules.margin_nats or insignificant(step, path.accepted_steps) or contradiction(step):
        return path
    if refusal_reason(separate_rivals(proof, step)):
        return path
    return replace(path, fitted=best.fitted, steps=(*((each, "") for each in path.accepted_steps), (step, "")))


def with_the_gap_itself(proof: Proof, path: NamingResult) -> NamingResult:
    """The path with the effect beyond chance that was refused as too little or too small, as a leftover of the names
    before or since the fitted cycles contradict one another, where the gap of the held-out cycles is that effect.

    What it does to the fitted cycles says little of what the model's parameters, which have made room for it there, are
    off by elsewhere; and what grows is greatest in the cycles that were kept. These count for its being beyond chance,
    by as much as the fitted ones at most.
    """
    step = path.nuisances[0] if path.nuisances and not path.accepted_steps else path.steps[-1][0]
    best, rules = step.best, step.rules
    names = [each.best.entry.name for each in path.accepted_steps if each.best is not None]
    before = [named.entry.name for named in step.before.state.named if named.existing is None]
    if best is None or best.fitted is None or refusal_reason(step) or names != before:
        return path
    held, first, second = compare_fits(path.fitted, best.fitted, proof.held_out, proof.seed, proof.floor)
    removed, interval = held.excess_removed, held.ci95
    if not matters(held, sensor_noise(path.base.frame.record), rules) or removed is None or interval is None:
        return path
    foreseen = foreseen_better(first, second)
    if removed < rules.gap_itself_least_share or foreseen < rules.least_gain_nats:
        return path
    # Of five cycles some samples have no excess at all, however well the others are foreseen.
    if interval[0] <= 0 and foreseen < 2.0 * rules.overwhelming_nats:
        return path
    foretold_better = foretold(best.fitted, second, second.whitener) - foretold(path.fitted, first, second.whitener)
    if best.gain + min(foretold_better, best.gain) < rules.least_gain_nats:
        return path
    return replace(path, fitted=best.fitted, steps=(*((each, "") for each in path.accepted_steps), (step, "")))
