"""The path of names: one after the other, then each looked at again beside the others, and swapped or taken back."""

from collections.abc import Callable, Mapping, Sequence

from sim.lab.discrepancy.fitting import CatalogueEntry, Fitted, fit
from sim.lab.discrepancy.judging import TOO_SMALL, NamingResult, dubious, insignificant
from sim.lab.discrepancy.naming import NamingStep, entries_besides, step
from sim.lab.discrepancy.rules import DecisionRules

Progress = Callable[[str, float], None]
Judged = tuple[NamingStep, str]
"""A step, and why its best entry is refused ("": it is taken)."""
MAX_NUISANCES = 2
"""Effects too small to matter that are fitted along at most: each costs a whole look at the catalogue."""
REFUSED_TOGETHER = "does not pass together with the names before it"


def name(
    base: Fitted,
    present: Mapping[str, str],
    most: int,
    progress: Progress,
    *,
    rules: DecisionRules,
    entries: Sequence[CatalogueEntry] = (),
) -> tuple[NamingResult, ...]:
    """Effects named one after the other, each on top of the ones before, until none deserves it; then revised.

    `entries` are looked for, the catalogue's by default. `present` gives the signal of each role. An effect that is
    clear but for rivals that stand too near is taken for the time being: beside the next name it may be told from them.
    One that is certain and too small to matter is fitted along, so that it hides no other, and is in no fit that is
    given back. The whole path comes first, then its beginnings, the longest first: a further name, whatever becomes of
    it, takes no earlier one down.
    """
    fitted, taken, refused = base, list[Judged](), list[Judged]()
    nuisances = list[tuple[int, NamingStep]]()  # with the number of names before
    while (number := len(taken)) < most:
        stage, share = f"looking for effect {number + 1}", 0.25 + 0.6 * number / (most + 1)
        progress(stage, share)
        told = _stage_reporter(progress, stage, share)
        candidate = step(fitted, entries_besides(fitted.state.named, entries), present, told, rules=rules)
        earlier = [*(judged for judged, _ in taken), *(judged for _, judged in nuisances)]
        chance = insignificant(candidate, earlier)
        refusal = chance or dubious(candidate)
        best = candidate.best
        if chance == TOO_SMALL and len(nuisances) < MAX_NUISANCES and best is not None and best.fitted is not None:
            nuisances.append((number, candidate))
            fitted = best.fitted
            continue
        # Clear beyond doubt but for a rival that stands too near: it stays for the time being, with its refusal.
        clear = best is not None and best.gain >= rules.overwhelming_nats and not chance
        only_rivalled = clear and best is not None and not best.entry.rival and candidate.margin < rules.margin_nats
        if best is None or best.fitted is None or (refusal and not only_rivalled):
            refused = [(candidate, refusal)]
            break
        taken.append((candidate, refusal))
        fitted = best.fitted
    # A name at the end that is still refused had no later one to tell it from its rivals: it goes, and the fit with it.
    while taken and taken[-1][1]:
        refused = [taken.pop()]
    along = tuple(judged for number, judged in nuisances if number <= len(taken))
    if along and not taken and (not refused or insignificant(refused[0][0], along)):
        # Nothing else is there, and the certain one is all that can be told.
        return (NamingResult(base, base, ((along[0], TOO_SMALL),), along[1:]),)
    fitted = _final_fit(base, taken)
    beginnings = [
        NamingResult(
            base,
            _drop_nuisances(_final_fit(base, taken[:count]), along),
            (*taken[:count], (taken[count][0], REFUSED_TOGETHER)),
            tuple(judged for number, judged in nuisances if number <= count),
        )
        for count in range(len(taken) - 1, 0, -1)
        if not any(refusal for _, refusal in taken[:count])
    ]
    if len(taken) > 1:
        stage, share = "looking at each name again", 0.25 + 0.6 * most / (most + 1)
        progress(stage, share)
        told = _stage_reporter(progress, stage, share)
        taken, fitted, withdrawn = revise_names(fitted, taken, present, len(taken) - 1, entries=entries, told=told)
        refused = withdrawn or refused
    if any(refusal for _, refusal in taken):
        return NamingResult(base, base, tuple(taken[-1:]), along), *beginnings
    return NamingResult(base, _drop_nuisances(fitted, along), (*taken, *refused), along), *beginnings


def _drop_nuisances(fitted: Fitted, nuisances: Sequence[NamingStep]) -> Fitted:
    """The fit with its names alone, fitted anew where nuisances were in it."""
    small = {step.best.entry.name for step in nuisances if step.best is not None}
    names = [named for named in fitted.state.named if named.entry.name not in small]
    return fitted if len(names) == len(fitted.state.named) else fit(fitted.frame, names, fitted, rounds=2, iterations=8)


def _final_fit(base: Fitted, taken: Sequence[Judged]) -> Fitted:
    """The fit with all names of a path."""
    last = taken[-1][0].best if taken else None
    return last.fitted if last is not None and last.fitted is not None else base


def _stage_reporter(progress: Progress, stage: str, share: float) -> Callable[[str], None]:
    """What says, at a stage, which effect is being fitted."""
    return lambda what: progress(f"{stage}: {what}", share)


def revise_names(
    fitted: Fitted,
    taken: Sequence[Judged],
    present: Mapping[str, str],
    count: int,
    *,
    entries: Sequence[CatalogueEntry] = (),
    told: Callable[[str], None] = lambda _: None,
) -> tuple[list[Judged], Fitted, list[Judged]]:
    """The first `count` names left out by turns and looked for again, the fit with all that remains, and what took the
    place of the last name that went.

    `fitted` has all names of `taken`. A name that adds nothing beside the others is dropped, and so is one in whose
    place nothing deserves a name; the others are looked at without it. The last one that is refused stays with its
    refusal.
    """
    judged = list(taken)
    for number, (before, _) in enumerate(taken[:count]):
        old = before.best.entry.name if before.best is not None else ""
        others = [named for named in fitted.state.named if named.entry.name != old]
        without = fit(fitted.frame, others, fitted, rounds=2, iterations=8)
        again = step(without, entries_besides(others, entries), present, told, rules=before.rules)
        rest = [other for place, (other, _) in enumerate(judged) if place != number]
        chance = insignificant(again, rest)
        refusal = chance or dubious(again)
        if refusal and rest:
            # Each removal changes what the others must explain, so the round begins anew without it.
            left = [*judged[:number], *judged[number + 1 :]]
            taken, fitted, withdrawn = revise_names(without, left, present, len(left), entries=entries, told=told)
            return taken, fitted, withdrawn or ([] if chance else [(again, refusal)])
        judged[number] = again, refusal
        if refusal or again.best is None or again.best.fitted is None:
            return judged[: number + 1], fitted, []
        fitted = again.best.fitted
    return judged, fitted, []
