"""What an answer is worth, given the truth of its case."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.discrepancy.effects import NEEDS
from benchmarks.discrepancy.runner import Outcome
from benchmarks.discrepancy.seal import Label

GAP = 0.1
"""A plant of which the best baseline leaves more than this (sensor sigmas) is not clean; its case is set aside."""
REACHED = 0.15
"""Relative distance from the wanted signal-to-noise ratio up to which a case counts at that ratio."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What was claimed: `names` in order, `classes` where only a class was claimed, the verdict, the confidence of the
    first claim, the share of the excess removed, the held-out `errors` before and after (NaN: not stated)."""

    verdict: str
    names: tuple[str, ...] = ()
    classes: tuple[frozenset[str], ...] = ()
    confidence: float = float("nan")
    removed: float = float("nan")
    errors: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def claims(self) -> bool:
        """Whether anything was named, be it by its class."""
        return bool(self.names or self.classes)


def answer(outcome: Outcome) -> Answer:
    """The answer in an outcome. An error is an answer that claims nothing.

    An effect counts as named when the verdict is "named" or its class has no other member, else as a class.
    """
    if outcome.status != "done":
        return Answer(outcome.status)
    diagnosis = outcome.diagnosis
    effects: Sequence[dict[str, Any]] = diagnosis.get("effects") or ()
    verdict = diagnosis["verdict"]
    single = [verdict == "named" or set(one.get("class") or [one["name"]]) == {one["name"]} for one in effects]
    held_out = diagnosis.get("held_out") or {}
    return Answer(
        verdict,
        tuple(one["name"] for one, alone in zip(effects, single, strict=True) if alone),
        tuple(frozenset(one["class"]) for one, alone in zip(effects, single, strict=True) if not alone),
        _number(effects[0].get("confidence")) if effects else float("nan"),
        _number(held_out.get("excess_removed")),
        (_number(held_out.get("rmse_before")), _number(held_out.get("rmse_after"))),
    )


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


@dataclass(frozen=True, slots=True)
class Judged:
    """A case with its answer. `truth` has the names that could be found: those whose signal was recorded.

    `gainless`: the given model follows the current in no location, so that it lacks the heat of the current itself.
    """

    label: Label
    outcome: Outcome
    answer: Answer
    gainless: bool = False

    @property
    def truth(self) -> frozenset[str]:
        """The names of a perfect answer; an effect that acts through a signal that was not recorded has none."""
        missing = set(self.label.spec["missing"])
        return frozenset(name for name in self.label.truth if NEEDS.get(name) not in missing)

    @property
    def nameless(self) -> bool:
        """Whether something acts that no name can be given to."""
        return bool(self.label.outside) or self.truth != self.label.truth

    @property
    def clean(self) -> bool:
        """Whether nothing acts."""
        return not self.label.spec["effects"]

    @property
    def exact(self) -> bool:
        """Every effect named, and nothing else."""
        return frozenset(self.answer.names) == self.truth and not self.answer.classes and bool(self.truth)

    @property
    def in_class(self) -> bool:
        """Every effect named or by a class that holds it, and nothing else; exact answers included."""
        left = self.truth - set(self.answer.names)
        if not self.truth or not set(self.answer.names) <= self.truth or len(self.answer.classes) != len(left):
            return False
        return _covers(left, list(self.answer.classes))

    @property
    def wrong(self) -> bool:
        """Something was claimed that is not there."""
        stray = any(name not in self.truth for name in self.answer.names)
        return stray or any(not (one & self.truth) for one in self.answer.classes)

    @property
    def wrong_first(self) -> bool:
        """The first thing claimed is not there."""
        if self.answer.names:
            return self.answer.names[0] not in self.truth
        return bool(self.answer.classes) and not (self.answer.classes[0] & self.truth)

    @property
    def removed(self) -> float:
        """Share of the excess removed: as stated, else by the plant's true floor."""
        stated = self.answer.removed
        return stated if stated == stated else self.removed_by_truth

    @property
    def removed_by_truth(self) -> float:
        """Share of the excess removed by the stated held-out errors and the plant's true noise floor."""
        before, after = self.answer.errors
        floor = self.label.floor
        return 1 - (after**2 - floor**2) / (before**2 - floor**2) if before > floor else float("nan")

    @property
    def rough(self) -> bool:
        """On a rough plant."""
        return bool(self.label.spec["rough"])

    @property
    def stratum(self) -> str:
        """Its stratum."""
        return str(self.label.spec["stratum"])

    @property
    def ratio(self) -> float:
        """The wanted signal-to-noise ratio if it was reached, else NaN."""
        wanted = float(self.label.spec["ratio"])
        reached = all(abs(ratio / wanted - 1) <= REACHED for ratio in self.label.ratios.values())
        return wanted if wanted and reached else float("nan")

    @property
    def usable(self) -> bool:
        """Whether the baseline can say all that the plant does without its effects."""
        return self.label.baseline_gap <= GAP


def _covers(left: frozenset[str], classes: list[frozenset[str]]) -> bool:
    """Whether each name can be given a class of its own that holds it."""
    if not left:
        return not classes
    name = min(left)
    return any(
        name in one and _covers(left - {name}, classes[:at] + classes[at + 1 :]) for at, one in enumerate(classes)
    )
