"""The path of names: one after the other, then each looked at again beside the others, and swapped or taken back."""

from collections.abc import Callable, Mapping, Sequence

from sim.discrepancy.fitting import CatalogueEntry, Fitted, fit
from sim.discrepancy.judging import NamingResult, dubious, insignificant
from sim.discrepancy.naming import NamingStep, entries_besides, step
from sim.discrepancy.rules import DecisionRules

Progress = Callable[[str, float], None]
Judged = tuple[NamingStep, str]
"""A step, and why its best entry is refused ("": it is taken)."""
BEYOND = "does not pass together with the names before it"


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
    The whole path comes first, then its beginnings, the longest first: a further name, whatever becomes of it, takes no
    earlier one down.
    """
    fitted, taken, refused = base, list[Judged](), list[Judged]()
    for number in range(most):
        stage, share = f"looking for effect {number + 1}", 0.25 + 0.6 * number / (most + 1)
        progress(stage, share)
        told = _told(progress, stage, share)
        offered = entries_besides(fitted.state.named, entries)
        candidate = step(fitted, offered, present, told, rules=rules)
        earlier = [judged for judged, _ in taken]
        chance = insignificant(candidate, earlier)
        refusal = chance or dubious(candidate)
        best = candidate.best
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
    fitted = _last_fit(base, taken)
    beginnings = [
        NamingResult(base, _last_fit(base, taken[:count]), (*taken[:count], (taken[count][0], BEYOND)))
        for count in range(len(taken) - 1, 0, -1)
        if not any(refusal for _, refusal in taken[:count])
    ]
    if len(taken) > 1:
        stage, share = "looking at each name again", 0.25 + 0.6 * most / (most + 1)
        progress(stage, share)
        told = _told(progress, stage, share)
        taken, fitted = revised(fitted, taken, present, len(taken) - 1, entries=entries, told=told)
    if any(refusal for _, refusal in taken):
        return NamingResult(base, base, tuple(taken[-1:])), *beginnings
    return NamingResult(base, fitted, (*taken, *refused)), *beginnings


def _last_fit(base: Fitted, taken: Sequence[Judged]) -> Fitted:
    """The fit with all names of a path."""
    last = taken[-1][0].best if taken else None
    return last.fitted if last is not None and last.fitted is not None else base


def _told(progress: Progress, stage: str, share: float) -> Callable[[str], None]:
    """What says, at a stage, which effect is being fitted."""
    return lambda what: progress(f"{stage}: {what}", share)


def revised(
    fitted: Fitted,
    taken: Sequence[Judged],
    present: Mapping[str, str],
    count: int,
    *,
    entries: Sequence[CatalogueEntry] = (),
    told: Callable[[str], None] = lambda _: None,
) -> tuple[list[Judged], Fitted]:
    """The first `count` names left out by turns and looked for again, and the fit with all that remains.

    `fitted` has all names of `taken`. A name that adds nothing beside the others is dropped, and the others are looked
    at without it; what is refused otherwise ends the list.
    """
    judged = list(taken)
    for number, (before, _) in enumerate(taken[:count]):
        old = before.best.entry.name if before.best is not None else ""
        others = [named for named in fitted.state.named if named.entry.name != old]
        without = fit(fitted.frame, others, fitted, rounds=2, iterations=8)
        again = step(without, entries_besides(others, entries), present, told, rules=before.rules)
        rest = [other for place, (other, _) in enumerate(judged) if place != number]
        chance = insignificant(again, rest)
        if chance and rest:
            # Each removal changes what the others must explain, so the round begins anew without it.
            left = [*judged[:number], *judged[number + 1 :]]
            return revised(without, left, present, len(left), entries=entries, told=told)
        refusal = chance or dubious(again)
        judged[number] = again, refusal
        if refusal or again.best is None or again.best.fitted is None:
            return judged[: number + 1], fitted
        fitted = again.best.fitted
    return judged, fitted
