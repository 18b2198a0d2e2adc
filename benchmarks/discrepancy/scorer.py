"""The figures of the benchmark: each target of the design with count, exact interval and whether it was met."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import Any

import numpy as np

from benchmarks.discrepancy.effects import EFFECTS
from benchmarks.discrepancy.judging import Judged
from benchmarks.discrepancy.outside import OUTSIDE
from sim.scores import clopper_pearson

VISIBLE = 1.5
"""Signal-to-noise ratio from which an effect outside the vocabulary ought to be seen."""
STATED = (0.925, 0.975)
"""Confidences that count as "stated 95 %"."""
SPEED_LIMIT = 30.0

Group = Sequence[Judged]
Test = Callable[[Judged], bool]


@dataclass(frozen=True, slots=True)
class Row:
    """A share `hits` of `cases`, with its target as a range; a target that is no target is (0, 1)."""

    name: str
    hits: int
    cases: int
    target: tuple[float, float] = (0.0, 1.0)

    @property
    def share(self) -> float:
        """hits / cases; NaN without cases."""
        return self.hits / self.cases if self.cases else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Clopper-Pearson."""
        if not self.cases:
            return 0.0, 1.0
        found = clopper_pearson(self.hits, self.cases)
        return found.low, found.high

    @property
    def verdict(self) -> str:
        """met, missed, or missed with the target inside the interval; or not measured."""
        low, high = self.target
        if (low, high) == (0.0, 1.0):
            return ""
        if not self.cases:
            return "not measured"
        if low <= self.share <= high:
            return "met"
        below, above = self.interval
        return "MISSED (within the interval)" if below <= high and above >= low else "MISSED"

    def plain(self) -> dict[str, Any]:
        """As JSON carries it."""
        share = self.share if self.cases else None
        own = {"name": self.name, "hits": self.hits, "cases": self.cases, "share": share}
        return own | {"ci95": list(self.interval), "target": list(self.target), "verdict": self.verdict}


def row(name: str, cases: Group, test: Test, target: tuple[float, float] = (0.0, 1.0)) -> Row:
    """The share of `cases` that pass `test`."""
    return Row(name, sum(test(one) for one in cases), len(cases), target)


def at_most(share: float) -> tuple[float, float]:
    """A target from above."""
    return 0.0, share


def at_least(share: float) -> tuple[float, float]:
    """A target from below."""
    return share, 1.0


def targets(judged: Group) -> list[Row]:
    """Every row of the table of targets but the time."""
    clean = [one for one in judged if one.stratum.startswith("clean") and one.usable]
    singles = [one for one in judged if one.stratum == "singles"]
    pairs = [one for one in judged if one.stratum == "pairs"]
    outside = [one for one in judged if one.stratum == "outside"]
    seen = [one for one in outside if one.label.ratio >= VISIBLE * 0.9]
    acting = (*singles, *pairs)
    right = [one for one in acting if one.exact]
    stated = [one for one in judged if STATED[0] <= one.answer.confidence <= STATED[1]]
    return [
        row("names something where nothing is missing", clean, lambda one: one.answer.claims, at_most(0.01)),
        row("wrong first name, effect in the catalogue", acting, lambda one: one.wrong_first, at_most(0.01)),
        *by_ratio(singles, rough=True, wanted={1.0: 0.75, 1.5: 0.90, 2.0: 0.95, 3.0: 0.98}),
        *by_ratio(singles, rough=False, wanted={1.0: 0.90, 1.5: 0.98, 2.0: 0.99, 3.0: 0.99}),
        row("both of a pair exact", pairs, lambda one: one.exact, at_least(0.90)),
        row("outside the catalogue: a wrong name", outside, lambda one: bool(one.answer.names), at_most(0.02)),
        row("outside, visible: unexplained", seen, lambda one: one.answer.verdict == "unexplained", at_least(0.80)),
        row("rightly named: >= 90 % of the excess removed", right, lambda one: one.removed >= 0.9, at_least(0.90)),
        row("stated 95 % confidence is right", stated, lambda one: not one.wrong_first, (0.93, 0.97)),
    ]


def by_ratio(singles: Group, *, rough: bool, wanted: Mapping[float, float]) -> list[Row]:
    """Exact names by signal-to-noise ratio on one kind of plant."""
    kind = "rough" if rough else "smooth"
    return [
        row(
            f"exact at signal-to-noise {ratio:g}, {kind} plant",
            [one for one in singles if one.rough == rough and one.ratio == ratio],
            lambda one: one.exact,
            at_least(share),
        )
        for ratio, share in wanted.items()
    ]


def further(judged: Group) -> list[Row]:
    """Figures that have no target: where the targets' figures come from, and the strata that have none."""
    return [*_clean_rows(judged), *_answer_rows(judged), *_special_rows(judged)]


def _clean_rows(judged: Group) -> list[Row]:
    clean = [one for one in judged if one.stratum.startswith("clean") and one.usable]
    splits: dict[str, Test] = {
        "rough": lambda one: one.rough,
        "smooth": lambda one: not one.rough,
        "parameters moved": lambda one: bool(one.label.spec["moved"]),
        "model of the same traces": lambda one: one.label.spec["learned"] == "same",
    }
    rows = [
        row(f"clean, {name}: names something", [one for one in clean if test(one)], lambda one: one.answer.claims)
        for name, test in splits.items()
    ]
    rows.append(row("clean: agree", clean, lambda one: one.answer.verdict == "agree"))
    rows.append(row("clean: unexplained", clean, lambda one: one.answer.verdict == "unexplained"))
    return rows


def _answer_rows(judged: Group) -> list[Row]:
    rows = []
    for stratum in ("singles", "pairs"):
        cases = [one for one in judged if one.stratum == stratum]
        rows += [
            row(f"{stratum}: exact", cases, lambda one: one.exact),
            row(f"{stratum}: exact, or by classes that hold the truth", cases, lambda one: one.in_class),
            row(f"{stratum}: something wrong claimed", cases, lambda one: one.wrong),
            row(f"{stratum}: nothing claimed", cases, lambda one: not one.answer.claims),
            row(f"{stratum}: agree", cases, lambda one: one.answer.verdict == "agree"),
        ]
    outside = [one for one in judged if one.stratum == "outside"]
    rows.append(row("outside: a name or a class", outside, lambda one: one.answer.claims))
    return rows


def _special_rows(judged: Group) -> list[Row]:
    rows = []
    for stratum in ("one-day", "missing", "irregular", "gaps"):
        cases = [one for one in judged if one.stratum == stratum]
        named = [one for one in cases if one.truth]
        rows += [
            row(f"{stratum}: exact", named, lambda one: one.exact),
            row(f"{stratum}: something wrong claimed", cases, lambda one: one.wrong),
        ]
    blind = [one for one in judged if one.stratum == "missing" and one.nameless]
    rows.append(row("missing, the effect's own signal: claims something", blind, lambda one: one.answer.claims))
    cycle = [one for one in judged if one.stratum == "one-cycle"]
    rows.append(row("one cycle: too little data", cycle, lambda one: one.answer.verdict == "too-little-data"))
    told = [one for one in judged if one.exact and isfinite(one.removed_by_truth)]
    rows.append(row("exact: >= 90 % of the excess removed, true floor", told, lambda one: one.removed_by_truth >= 0.9))
    rows.append(row("errors", judged, lambda one: one.outcome.status == "error"))
    rows.append(row("over the time limit", judged, lambda one: one.outcome.status == "timeout"))
    return rows


def per_effect(judged: Group) -> dict[str, list[Row]]:
    """Singles and outside cases by what acts: exact, in class, wrong, nothing claimed."""
    tests: dict[str, Test] = {
        "exact": lambda one: one.exact,
        "in class": lambda one: one.in_class,
        "wrong": lambda one: one.wrong,
        "nothing": lambda one: not one.answer.claims,
    }
    of = {name: [one for one in judged if one.label.spec["effects"] == [name]] for name in (*EFFECTS, *OUTSIDE)}
    kept = {name: [one for one in group if one.stratum in ("singles", "outside")] for name, group in of.items()}
    return {name: [row(what, group, test) for what, test in tests.items()] for name, group in kept.items() if group}


@dataclass(frozen=True, slots=True)
class Bin:
    """Claims whose stated confidence lies in low..high: their mean confidence and how many were right."""

    low: float
    high: float
    stated: float
    right: Row


def reliability(judged: Group) -> list[Bin]:
    """Stated confidence against the share of right first claims, in bins."""
    edges = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)
    bins = []
    for low, high in pairwise(edges):
        cases = [one for one in judged if low <= one.answer.confidence < high]
        if cases:
            stated = float(np.mean([one.answer.confidence for one in cases]))
            bins.append(Bin(low, min(high, 1.0), stated, row("right", cases, lambda one: not one.wrong_first)))
    return bins


def confusion(judged: Group) -> dict[tuple[str, str], int]:
    """(what acts, first claim or verdict) -> cases, for clean, singles and outside cases."""
    table: dict[tuple[str, str], int] = {}
    for one in judged:
        if one.stratum in ("singles", "outside") or one.stratum.startswith("clean"):
            truth = one.label.spec["effects"][0] if one.label.spec["effects"] else "nothing"
            table[truth, said(one)] = table.get((truth, said(one)), 0) + 1
    return table


def said(one: Judged) -> str:
    """The first claim in a word: a name, "class" when its class holds the truth, "wrong class", or the verdict."""
    if one.answer.names:
        return one.answer.names[0]
    if one.answer.classes:
        return "class" if one.answer.classes[0] & one.truth else "wrong class"
    return one.answer.verdict


def times(judged: Group) -> dict[str, float]:
    """Seconds a case (p50, p95, max) for whole cases of four days at 10 s."""
    found = [one.outcome.seconds for one in judged if one.label.spec["days"] == 4 and one.outcome.status != "error"]
    if not found:
        return {}
    return {"p50": float(np.percentile(found, 50)), "p95": float(np.percentile(found, 95)), "max": max(found)}


def excess(judged: Group) -> list[float]:
    """Share of the excess removed of every exact answer that states one."""
    return [one.removed for one in judged if one.exact and isfinite(one.removed)]


def document(judged: Group) -> dict[str, Any]:
    """All figures of one tool, as JSON carries them."""
    return {
        "targets": [one.plain() for one in targets(judged)],
        "further": [one.plain() for one in further(judged)],
        "per_effect": {name: [one.plain() for one in rows] for name, rows in per_effect(judged).items()},
        "reliability": [
            {"from": one.low, "to": one.high, "stated": one.stated, "right": one.right.plain()}
            for one in reliability(judged)
        ],
        "seconds": times(judged) | {"target_max": SPEED_LIMIT},
        "set_aside": sum(not one.usable for one in judged),
    }
