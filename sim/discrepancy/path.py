"""The path of names: one after the other, then each looked at again beside the others, and swapped or taken back."""

from collections.abc import Callable, Mapping, Sequence

from sim.discrepancy.fitting import Fitted, fit
from sim.discrepancy.judging import OVERWHELMING, NamingResult, dubious, insignificant
from sim.discrepancy.naming import MARGIN, NamingStep, entries_besides, step

Progress = Callable[[str, float], None]
Judged = tuple[NamingStep, str]
"""A step, and why its best entry is refused ("": it is taken)."""


def name(base: Fitted, present: Mapping[str, str], seed: int, most: int, progress: Progress) -> NamingResult:
    """Effects named one after the other, each on top of the ones before, until none deserves it; then revised.

    `present` gives the signal of each role. An effect that is clear but for rivals that stand too near is taken for the
    time being: beside the next name it may be told from them.
    """
    fitted, taken, refused = base, list[Judged](), list[Judged]()
    for number in range(most):
        progress(f"looking for effect {number + 1}", 0.25 + 0.6 * number / (most + 1))
        one = step(fitted, entries_besides(fitted.state.named), present, seed + number)
        earlier = [each for each, _ in taken]
        refusal = insignificant(one, earlier) or dubious(one)
        if one.best is None or one.best.fitted is None or (refusal and not _open(one, earlier)):
            refused = [(one, refusal)]
            break
        taken.append((one, refusal))
        fitted = one.best.fitted
    while taken and taken[-1][1]:
        refused = [taken.pop()]
    last = taken[-1][0].best if taken else None
    fitted = last.fitted if last is not None and last.fitted is not None else base
    if len(taken) > 1:
        progress("looking at each name again", 0.25 + 0.6 * most / (most + 1))
        taken, fitted = revised(fitted, taken, present, seed + most, len(taken) - 1)
    if any(refusal for _, refusal in taken):
        return NamingResult(base, base, tuple(taken[-1:]))
    return NamingResult(base, fitted, (*taken, *refused))


def _open(one: NamingStep, earlier: Sequence[NamingStep]) -> bool:
    """Whether a step's best is beyond doubt but for its margin over its rivals."""
    clear = one.best is not None and one.best.gain >= OVERWHELMING and not insignificant(one, earlier)
    return clear and one.margin < MARGIN


def revised(
    fitted: Fitted, taken: Sequence[Judged], present: Mapping[str, str], seed: int, count: int
) -> tuple[list[Judged], Fitted]:
    """The first `count` names left out by turns and looked for again, and the fit with all that remains.

    `fitted` has all names of `taken`. A name that adds nothing beside the others is dropped, and the others are looked
    at without it; what is refused otherwise ends the list.
    """
    judged = list(taken)
    for number, (before, _) in enumerate(taken[:count]):
        old = before.best.entry.name if before.best is not None else ""
        others = [one for one in fitted.state.named if one.entry.name != old]
        without = fit(fitted.frame, others, fitted, rounds=2, iterations=8)
        one = step(without, entries_besides(others), present, seed + number)
        rest = [each for place, (each, _) in enumerate(judged) if place != number]
        chance = insignificant(one, rest)
        if chance and rest:
            left = [*judged[:number], *judged[number + 1 :]]
            return revised(without, left, present, seed, len(left))
        refusal = chance or dubious(one)
        judged[number] = one, refusal
        if refusal or one.best is None or one.best.fitted is None:
            return judged[: number + 1], fitted
        fitted = one.best.fitted
    return judged, fitted
