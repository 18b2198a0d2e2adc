"""The gap workflow: refit, gap, place, candidates, name or abstain, held-out proof; from traces to a Diagnosis.

The order is that of docs/discrepancy.md. Nothing is named unless the likelihood, the cycles, the free learner's ceiling
and the held-out cycles agree; what is not named is described. Here is the order alone: what the traces are laid out as
is in `layout`, the search for names in `path`, the proof and the verdict in `proving`.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.effects import ROLES
from sim.lab.discrepancy.ceiling import ceiling
from sim.lab.discrepancy.constants import find_absorbed_law
from sim.lab.discrepancy.diagnosis import CandidateLaw, Diagnosis
from sim.lab.discrepancy.evidence import named_effect, small_effects, tried_effects
from sim.lab.discrepancy.fitting import (
    CatalogueEntry,
    Fitted,
    Frame,
    Named,
    build_record,
    catalogue,
    fit,
    model_effects,
    own_roles,
)
from sim.lab.discrepancy.judging import NamingResult, description, systematic, too_short, untested_effects
from sim.lab.discrepancy.law_search import candidate_laws
from sim.lab.discrepancy.layout import DataLayout, SplitCycles, build_layout, measured_signals, split_cycles
from sim.lab.discrepancy.locate import places
from sim.lab.discrepancy.missing_heat import missing_heat
from sim.lab.discrepancy.moved import shifts
from sim.lab.discrepancy.mute_switch import find_chatter, find_mute_switch
from sim.lab.discrepancy.path import name
from sim.lab.discrepancy.posterior import NamesEvidence, posterior, remaining_shares, step_gains
from sim.lab.discrepancy.proving import NamesSearched, ProvenFindings, prove, with_agreed_floor, with_laws
from sim.lab.discrepancy.rules import RULES, DecisionRules
from sim.lab.discrepancy.standing import find_still_reading
from sim.lab.discrepancy.story import diagnosis_course, still_sentence, verdict_sentence
from sim.sha import EffectLine, Model, Trace, display_unit

MAX_NAMES = 3

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
    most: int = MAX_NAMES,
    experiments: Sequence[Trace] = (),
    without: Container[str] = (),
    progress: Progress | None = None,
    rules: DecisionRules = RULES,
) -> DiagnosisOutcome:
    """The diagnosis of `traces` against `model`, with at most `most` names.

    `lines` are engineers' own effects, which are looked for beside the catalogue's. `roles` gives the signal of each
    role of these; those that no trace has take their effects off the table. `experiments` are traces of experiments
    that were made to tell rivals apart: their last cycles are held out, too, where there are enough. Names in `without`
    are not looked for: a cause that has one is then outside of the catalogue. `rules` decide. Raises ValueError, in one
    sentence, when the traces cannot be followed at all.
    """
    report = progress or (lambda _stage, _share: None)
    report("laying out the traces", 0.0)
    roles = {**roles, **own_roles(lines)}
    layout = build_layout(model, traces, experiments, roles, rules)
    count = int(layout.cycles.size)
    if (mute := find_mute_switch(layout, rules)) is not None:
        said = mute.sentence(display_unit(layout.model.unit))
        return DiagnosisOutcome(_too_little(layout.model, count, mute.reason(), said), (), None, None)
    if (chatter := find_chatter(layout, rules)) is not None:
        traces, experiments = ([chatter.settle(trace, rules) for trace in those] for those in (traces, experiments))
        layout = build_layout(model, traces, experiments, roles, rules)
        count = int(layout.cycles.size)
    if count < rules.least_cycles:
        few = f"{count} cycle{'' if count == 1 else 's'} in all; at least {rules.least_cycles} are needed, better ten"
        return DiagnosisOutcome(_too_little(layout.model, count, few), (), None, None)
    readings = layout.record.runs.reading[layout.record.rows]
    if np.ptp(readings) == 0.0:
        still = still_sentence(layout.model.temperature, readings, display_unit(layout.model.unit))
        alike = f"all {readings.size} readings are one value"
        return DiagnosisOutcome(_too_little(layout.model, count, alike, still), (), None, None)
    entries = tuple(entry for entry in catalogue(lines) if entry.name not in without)
    split = split_cycles(layout, rules)
    allowed = min(most, count // rules.each_name_least_cycles) if count >= rules.first_name_least_cycles else 0
    search = search_names(layout, split.training, entries, allowed, seed=seed, rules=rules, report=report)
    report("held-out cycles", 0.85)
    found = prove(layout, search, split.held_out, entries, seed=seed, rules=rules)
    laws = unnamed_laws(layout, split, found, rules, report)
    found = with_agreed_floor(with_laws(found, laws))
    diagnosis = describe(layout, split, search, found, entries, laws=laws, seed=seed, rules=rules, report=report)
    if chatter is not None:
        diagnosis = replace(diagnosis, sentence=f"{diagnosis.sentence} {chatter.sentence()}")
    after, path = found.told.after, found.judged.path
    named = after.state.named if found.kept else ()
    return DiagnosisOutcome(diagnosis, named, after, path, found.against if path.accepted_steps else None)


def search_names(
    layout: DataLayout,
    training: Frame,
    entries: Sequence[CatalogueEntry],
    allowed: int,
    *,
    seed: int,
    rules: DecisionRules,
    report: Progress,
) -> NamesSearched:
    """The refit of the training cycles and the path of names on it; one at least, to say what it would be."""
    # The refit comes first: what parameters that have moved explain is no missing effect.
    report("fitting the model's own parameters", 0.05)
    base = fit(training, model_effects(training.record.model))
    report("what a free learner could still explain", 0.2)
    ceiling_before = ceiling(base, seed, layout.first_made)
    paths = name(base, layout.present, max(allowed, 1), report, rules=rules, entries=entries)
    return NamesSearched(base=base, ceiling=ceiling_before, paths=paths, allowed=allowed)


def describe(
    layout: DataLayout,
    split: SplitCycles,
    search: NamesSearched,
    found: ProvenFindings,
    entries: Sequence[CatalogueEntry],
    *,
    laws: tuple[CandidateLaw, ...],
    seed: int,
    rules: DecisionRules,
    report: Progress,
) -> Diagnosis:
    """What was proved as a diagnosis: with its sentence, its places, what moved, and what else is told beside."""
    model, present, told, kept = layout.model, layout.present, found.told, found.kept
    path, unit, unnamed = found.judged.path, display_unit(model.unit), found.verdict == "unexplained"
    law = None
    if "current" in present:
        law = find_absorbed_law(told.after, present["current"], split.held_out, rules, pump=present.get("pump"))
    report("where the heat is", 0.95)
    where = places(told.base, seed, rules)
    remaining = places(told.after, seed, rules) if kept else where
    shown = told.held.ci95 is not None and told.held.ci95[0] > 0.0
    taken = path.accepted_steps if kept else ()
    sure = [posterior(step_gains(step), found.against, rules) for step in taken]
    effects = [
        replace(named_effect(step, told.after, each.confidence(step.members)), shrinking_shown=shown)
        for step, each in zip(taken, sure, strict=True)
    ]
    # The search may come first to what explains less; whoever reads of several looks at the first.
    effects.sort(key=lambda effect: -effect.gain)
    none_of_these = max((each.none_of_these for each in sure), default=None)
    moved = shifts(told.after, rules)
    unexplained = remaining if unnamed or (kept and systematic(found.judged.ceiling, rules)) else ()
    described = description(path) if unnamed else ""
    still = find_still_reading(layout.record, rules)
    return Diagnosis(
        verdict=found.verdict,
        sentence=verdict_sentence(
            found.verdict,
            effects,
            unexplained=unexplained,
            description=described,
            shifts=moved,
            held=told.held,
            cycles=int(np.unique(split.training.record.window_cycle).size),
            traces=small_effects(path),
            law=law,
            unit=unit,
            began=found.began,
            gap=found.gap,
            little=found.little,
            none_of_these=none_of_these,
            still="" if still is None else still.sentence(unit),
        ),
        reasons=found.reasons,
        effects=tuple(effects),
        shifts=moved,
        places=where,
        unexplained=unexplained,
        ceiling_before=search.ceiling,
        ceiling_after=found.judged.ceiling if kept else None,
        candidates=tried_effects(path.looks, kept),
        material=found.material,
        traces=small_effects(path),
        absorbed=law,
        untested={
            **too_short(entries, path),
            **untested_effects(
                entries, present, layout.roles, following=layout.following, temperature=model.temperature
            ),
        },
        held_out=told.held,
        floor=found.floor,
        began=found.began,
        course=diagnosis_course(told.base, told.after, told.first, told.second),
        settings=path_settings(found, seed, rules),
        model_before=model.sha.name,
        model_after=None,
        unit=model.unit,
        laws=laws,
        description=described,
        missing_heat=missing_heat(told.base, layout.record, np.unique(split.held_out.window_cycle)),
        none_of_these=none_of_these,
    )


def unnamed_laws(
    layout: DataLayout, split: SplitCycles, found: ProvenFindings, rules: DecisionRules, report: Progress
) -> tuple[CandidateLaw, ...]:
    """The laws of what has no name; looked for too where the model's own noise does not cover its errors, though the
    machine might be as rough as that."""
    doubtful = found.excess is not None and found.excess.wide(rules) and not found.kept
    if found.verdict != "unexplained" and not doubtful:
        return ()
    report("laws to look at", 0.9)
    # All that is measured, not only what the catalogue knows a role for: a record of its own on the same knots.
    model = layout.model
    everything = build_record(model, layout.traces, measured_signals(model, layout.traces, rules))
    floor = min(found.floor.error, found.stated)
    return candidate_laws(found.told.base, everything, split.first, floor, rules, fitted_again=layout.first_made)


def path_settings(found: ProvenFindings, seed: int, rules: DecisionRules) -> dict[str, float]:
    """Seed, threshold and noise of the path that was judged, and how far off the fitted cycles were, by name."""
    noise = found.judged.path.fitted.noise
    excesses = {"excess_before": found.excess, "excess_after": found.judged.excess}
    return {
        "seed": float(seed),
        "threshold_nats": rules.least_gain_nats,
        "sensor_sigma": noise.sensor,
        "process_sigma": noise.process,
        "rough_sigma": noise.rough,
        "cycle_scatter": noise.cycle,
        "rough_memory_s": noise.memory,
        "lasting_sigma": noise.lasting,
        **{key: each.median for key, each in excesses.items() if each is not None},
        **(remaining_shares(found.against) if found.kept else {}),
    }


def _too_little(model: Model, cycles: int, reason: str, little: str = "") -> Diagnosis:
    return Diagnosis(
        verdict="too-little-data",
        sentence=verdict_sentence(
            "too-little-data", (), unexplained=(), shifts=(), held=None, cycles=cycles, unit="", little=little
        ),
        reasons=(reason,),
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
