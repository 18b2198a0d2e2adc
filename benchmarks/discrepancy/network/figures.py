"""What the network's cases show: false alarms by sampling, noise and model; exact names by strength; harm done."""

from collections.abc import Sequence
from math import isfinite

from benchmarks.discrepancy.judging import Judged
from benchmarks.discrepancy.scorer import VISIBLE, Row, Test, row
from benchmarks.discrepancy.table import grid, interval, percent

CLEAN = 0.3
"""A plant of which the best first-order model leaves more than this (sensor sigmas) is not clean."""


def rows(judged: Sequence[Judged]) -> list[Row]:
    """All figures."""
    clean = [one for one in judged if one.clean and one.label.baseline_gap <= CLEAN]
    splits: dict[str, Test] = {
        "all": lambda _: True,
        "rows of 1 to 5 s": lambda one: one.label.spec["period"] <= 5,
        "rows of 10 to 20 s": lambda one: 10 <= one.label.spec["period"] <= 20,
        "rows of 30 to 60 s": lambda one: one.label.spec["period"] >= 30,
        "noise up to 0.15 degC": lambda one: one.label.spec["noise"] <= 0.15,
        "noise above 0.15 degC": lambda one: one.label.spec["noise"] > 0.15,
        "model of days before": lambda one: one.label.spec["learned"] == "before",
        "model of another machine": lambda one: one.label.spec["learned"] == "other",
        "model of the same traces": lambda one: one.label.spec["learned"] == "same",
        "rough plant": lambda one: one.rough,
        "runs of days": lambda one: one.label.spec["duty"] == "campaign",
    }
    found = []
    for name, test in splits.items():
        cases = [one for one in clean if test(one)]
        found.append(row(f"clean, {name}: named", cases, lambda one: one.answer.claims))
        found.append(row(f"clean, {name}: unexplained", cases, lambda one: one.answer.verdict == "unexplained"))
    singles = [one for one in judged if one.stratum == "singles"]
    for ratio in (1.5, 3.0, 6.0):
        cases = [one for one in singles if one.label.spec["ratio"] == ratio]
        found.append(row(f"singles at {ratio:g}: exact", cases, lambda one: one.exact))
        found.append(row(f"singles at {ratio:g}: exact or in class", cases, lambda one: one.in_class))
        found.append(row(f"singles at {ratio:g}: nothing claimed", cases, lambda one: not one.answer.claims))
        found.append(row(f"singles at {ratio:g}: agree", cases, lambda one: one.answer.verdict == "agree"))
        found.append(row(f"singles at {ratio:g}: too little data", cases, too_little))
        found.append(row(f"singles at {ratio:g}: wrong first name", cases, lambda one: one.wrong_first))
        for kind in ("rough", "smooth"):
            part = [one for one in cases if one.rough == (kind == "rough")]
            found.append(row(f"singles at {ratio:g}, {kind} plant: exact", part, lambda one: one.exact))
        slow = [one for one in cases if one.label.spec["period"] >= 30]
        found.append(row(f"singles at {ratio:g}, rows of 30 to 60 s: exact", slow, lambda one: one.exact))
    found.append(row("singles: wrong first name", singles, lambda one: one.wrong_first))
    right = [one for one in judged if one.exact]
    found.append(row("exact: >= 90 % of the excess removed", right, lambda one: one.removed >= 0.9))
    told = [one for one in right if isfinite(one.removed_by_truth)]
    found.append(row("the same, by the plant's true floor", told, lambda one: one.removed_by_truth >= 0.9))
    pairs = [one for one in judged if one.stratum == "pairs"]
    found.append(row("pairs: exact", pairs, lambda one: one.exact))
    found.append(row("pairs: wrong first name", pairs, lambda one: one.wrong_first))
    outside = [one for one in judged if one.stratum == "outside"]
    found.append(row("outside: a name or a class", outside, lambda one: one.answer.claims))
    found.append(row("outside: unexplained", outside, lambda one: one.answer.verdict == "unexplained"))
    seen = [one for one in outside if one.label.ratio >= VISIBLE * 0.9]
    found.append(row("outside, visible: unexplained", seen, lambda one: one.answer.verdict == "unexplained"))
    # Strictly a wrong name, above; of such a model it is a right one.
    gainless = [one for one in judged if one.gainless]
    found.append(
        row("model without a gain: current-heating named", gainless, lambda one: "current-heating" in one.answer.names)
    )
    able = [one for one in judged if not one.gainless]
    found.append(
        row("model with a gain, clean: named", [one for one in able if one.clean], lambda one: one.answer.claims)
    )
    acting = [one for one in able if one.stratum in ("singles", "pairs")]
    found.append(row("model with a gain, singles and pairs: wrong first name", acting, lambda one: one.wrong_first))
    claims = [one for one in judged if one.answer.claims]
    found.append(row("named while the held-out free run grows", claims, grows))
    found.append(row("errors and cases over the limit", judged, lambda one: one.outcome.status != "done"))
    return [one for one in found if one.cases]


def grows(one: Judged) -> bool:
    """The free run over the held-out part is further off with the name than without it."""
    before, after = one.answer.errors
    return after > before


def too_little(one: Judged) -> bool:
    """The tool said that there is too little to judge by."""
    return one.answer.verdict == "too-little-data"


def tables(judged: Sequence[Judged], *, every: bool = False) -> str:
    """The figures as Markdown; `every`: and a line a case."""
    aside = sum(one.clean and one.label.baseline_gap > CLEAN for one in judged)
    head = ["figure", "share", "95 %", "n"]
    body = [[one.name, percent(one), interval(one), f"{one.hits}/{one.cases}"] for one in rows(judged)]
    parts = [f"{len(judged)} cases, {aside} clean ones set aside for their baseline gap", grid(head, body)]
    if every:
        parts.append(grid(["what acts", "case", "answer", "before, after, floor (degC)"], [*map(_line, judged)]))
    return "\n\n".join(parts)


def _line(one: Judged) -> list[str]:
    spec, found = one.label.spec, one.outcome.diagnosis
    acts = ", ".join(f"{name} {ratio:.1f}" for name, ratio in one.label.ratios.items()) or "nothing"
    case = f"{spec['duty']}, {spec['learned']}, {spec['period']} s, {one.label.sensor:.2f} degC, {one.label.case}"
    said = [*one.answer.names, *("/".join(sorted(each)) for each in one.answer.classes)]
    held = found.get("held_out") or {}
    errors = [held.get(key) for key in ("rmse_before", "rmse_after", "noise_floor")]
    numbers = ", ".join("-" if value is None else f"{value:.3f}" for value in errors)
    answer = f"{one.answer.verdict} {' + '.join(said)} {'; '.join(found.get('reasons') or ())[:110]}"
    return [acts, case + (", rough" if one.rough else ""), answer.strip(), numbers]
