"""What the recorder's cases show, figure by figure of what is promised, and beside it what could be known."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.discrepancy.judging import Judged
from benchmarks.discrepancy.recorder.actors import ACTORS, OUTSIDE
from benchmarks.discrepancy.recorder.ideal import EVIDENCE, Verdict
from benchmarks.discrepancy.scorer import Row, at_least, at_most, row
from benchmarks.discrepancy.table import grid, interval, percent, wanted

CLEAN = 0.3
"""A plant of which the given model's best run leaves more than this (sensor sigmas) is not clean."""
STATED = (0.95, 0.99)
"""Confidences that are held against what came out right."""
TOLD = ("sentence", "unexplained", "descriptions")
"""Where in a diagnosis a description of what has no name may stand, beside the sentences of its laws."""
ADVICE = "; to find out"
"""What a law's sentence ends with: what to try, not what was found."""
ROWS_LATE = 300.0
"""Seconds after a start up to which the first row that shows it comes: late rows of the slowest recorder."""
NOT_COMPUTED = "not computed"
"""What stands for a figure that the folder was made without."""
SHOWN = 120
"""Characters of a reason or an error in a case's line."""

Group = Sequence[Judged]


def rows(judged: Group, known: Mapping[str, Verdict]) -> list[Row]:
    """Every figure."""
    clean = [one for one in judged if one.clean and one.label.baseline_gap <= CLEAN]
    singles, pairs, late, half, outside = (
        [one for one in judged if one.stratum == stratum and np.isfinite(one.ratio)]  # at the ratio that was wanted
        for stratum in ("singles", "pairs", "late", "half-way", "outside")
    )
    named = [*singles, *pairs, *late]
    strong = [one for one in half if one.label.spec["ratio"] >= 3.0]
    right = [one for one in judged if one.exact]
    stated = [one for one in judged if one.answer.claims and STATED[0] <= one.answer.confidence <= STATED[1]]
    found = [
        row("internal errors", judged, lambda one: one.outcome.status == "error", at_most(0.0)),
        row("over the time limit", judged, lambda one: one.outcome.status == "timeout"),
        row("clean: something named", clean, lambda one: one.answer.claims, at_most(0.01)),
        row("clean: falsely unexplained", clean, lambda one: one.answer.verdict == "unexplained", at_most(0.01)),
        row("clean: begins falsely", clean, lambda one: began_at(one) is not None, at_most(0.01)),
        row("wrong first name", named, lambda one: one.wrong_first, at_most(0.01)),
        row("singles at 1.5: exact", _at(singles, 1.5), lambda one: one.exact, at_least(0.75)),
        row("singles at 3: exact", _at(singles, 3.0), lambda one: one.exact, at_least(0.90)),
        row("singles: exact or in class", singles, lambda one: one.in_class),
        row("both of a pair exact", pairs, lambda one: one.exact, at_least(0.85)),
        row("both of a pair exact or in class", pairs, lambda one: one.in_class),
        row("late heat: exact or in class", late, lambda one: one.in_class, at_least(0.90)),
        row("half-way gap: found", half, finds_gap),
        row("half-way gap at 3: found", strong, finds_gap, at_least(0.90)),
        row("half-way gap at 3: found, and said to begin", strong, lambda one: began_at(one) is not None),
        row("half-way gap at 3: dated within a cycle", strong, dates_gap, at_least(0.80)),
        row("rightly named: >= 90 % of the excess removed", right, lambda one: one.removed >= 0.9, at_least(0.85)),
        row("the same by the plant's own noise", _with_excess(right), lambda one: one.removed_by_truth >= 0.9),
        _ideal_row("the same by an ideal judge", right, known),
        _ideal_row("all singles, pairs and late: the same by an ideal judge", named, known),
        row("stated 0.95 to 0.99: right", stated, lambda one: not one.wrong_first, (0.93, 0.99)),
        row("outside: a name or a class", outside, lambda one: one.answer.claims, at_most(0.05)),
        row("outside: unexplained", outside, lambda one: one.answer.verdict == "unexplained"),
        row("outside: unexplained with a true description", outside, describes, at_least(0.60)),
        *_habit_rows(judged),
        *_known_rows(judged, known),
    ]
    return [one for one in found if one.cases or one.name.endswith(NOT_COMPUTED)]


def _ideal_row(name: str, cases: Group, known: Mapping[str, Verdict]) -> Row:
    """In how many cases a fit with the true form removes nine tenths of an excess over the plant's own noise."""
    told = [(one, known[one.label.case].removal) for one in cases if one.label.case in known]
    removed = [removal.share(one.label.floor) for one, removal in told if removal]
    if cases and not removed:
        return Row(f"{name}: {NOT_COMPUTED}", 0, 0)
    excess = [share for share in removed if np.isfinite(share)]
    return Row(name, sum(share >= 0.9 for share in excess), len(excess))


def _with_excess(judged: Group) -> list[Judged]:
    """Where the noise that fell in the held-out cycles left an excess to remove."""
    return [one for one in judged if np.isfinite(one.removed_by_truth)]


def _of(judged: Group, stratum: str) -> list[Judged]:
    return [one for one in judged if one.stratum == stratum]


def _at(judged: Group, ratio: float) -> list[Judged]:
    return [one for one in judged if one.ratio == ratio]


def _habit_rows(judged: Group) -> list[Row]:
    habits = sorted({str(one.label.spec["habit"]) for one in judged})
    return [
        row(f"internal errors, recorder {habit!r}", [one for one in judged if one.label.spec["habit"] == habit],
            lambda one: one.outcome.status == "error")
        for habit in habits
    ]  # fmt: skip


def _known_rows(judged: Group, known: Mapping[str, Verdict]) -> list[Row]:
    """The share of what an ideal judge would have found that was found."""
    acting = [one for one in judged if one.label.case in known and np.isfinite(one.ratio)]
    found = []
    for stratum in sorted({one.stratum for one in acting}):
        cases = _of(acting, stratum)
        seen = [one for one in cases if known[one.label.case].visible]
        what = [one for one in cases if known[one.label.case].knowable and not one.label.outside]
        found.append(Row(f"{stratum}: an ideal judge sees that something acts", len(seen), len(cases)))
        found.append(row(f"{stratum}: of these, no agreement and no error", seen, finds_gap))
        if stratum in ("singles", "pairs", "late"):
            found.append(Row(f"{stratum}: an ideal judge knows what acts", len(what), len(cases)))
            found.append(row(f"{stratum}: of these, exact", what, lambda one: one.exact))
    clean = [one for one in judged if one.clean and one.label.case in known]
    found.append(
        row("clean: an ideal judge would name", clean, lambda one: known[one.label.case].rival_nats >= EVIDENCE)
    )
    return found


def finds_gap(one: Judged) -> bool:
    """The answer says that something is missing, by a name, a class or none."""
    return one.answer.verdict in ("named", "class", "unexplained")


def began_at(one: Judged) -> float | None:
    """The time (s) at which the diagnosis says that a gap begins; None where it says nothing of the kind."""
    began = one.outcome.diagnosis.get("began")
    time = began.get("time") if isinstance(began, dict) else None
    return float(time) if isinstance(time, int | float) and np.isfinite(time) else None


def dates_gap(one: Judged) -> bool:
    """Found, and dated within a cycle: the cycle that it names as the first is the true one or the one beside it."""
    time, truth = began_at(one), one.label.spec["began"]
    if time is None or not finds_gap(one):
        return False
    starts = np.asarray(truth["starts"])
    # A change in a rest may be dated at any moment between the stop and the next start, or at the row that shows it.
    stated = int(np.searchsorted(starts, time - ROWS_LATE))
    return abs(stated - int(truth["before"])) <= 1


def describes(one: Judged) -> bool:
    """ "Unexplained", and one of the words of a true description stands where it says of what."""
    if one.answer.verdict != "unexplained":
        return False
    said = one.outcome.diagnosis
    laws = [str(law.get("sentence")).split(ADVICE)[0] for law in said.get("laws") or ()]
    text = json.dumps([*(said.get(key) for key in TOLD), *laws]).lower()
    return any(word in text for name in one.label.spec["acts"] if name in OUTSIDE for word in ACTORS[name].words)


def tables(judged: Group, known: Mapping[str, Verdict], *, every: bool = False) -> str:
    """The figures as Markdown, and each error in its own words; `every`: and a line a case."""
    aside = sum(one.clean and one.label.baseline_gap > CLEAN for one in judged)
    body = [[one.name, _target(one), percent(one), interval(one), f"{one.hits}/{one.cases}", one.verdict]
            for one in rows(judged, known)]  # fmt: skip
    short = sum(not one.clean and not np.isfinite(one.ratio) for one in judged)
    parts = [
        f"{len(judged)} cases; set aside {aside} clean ones for their baseline gap, {short} for a ratio out of reach",
        grid(["figure", "target", "share", "95 %", "n", ""], body),
    ]
    failed = [one for one in judged if one.outcome.status != "done"]
    parts += [f"{one.label.case} ({one.label.spec['habit']}): {_flat(one.outcome.message)}" for one in failed]
    if every:
        head = ["what acts", "case", "ideal judge", "answer", "before, after, floor (degC)", "s"]
        parts.append(grid(head, [_line(one, known.get(one.label.case)) for one in judged]))
    return "\n\n".join(parts)


def _target(one: Row) -> str:
    return "" if one.target == (0.0, 1.0) else wanted(one)


def _flat(words: str) -> str:
    return " ".join(words.split()).replace("|", "/")


def _line(one: Judged, known: Verdict | None) -> list[str]:
    spec, said = one.label.spec, one.outcome.diagnosis
    acts = ", ".join(f"{name} {ratio:.1f}" for name, ratio in one.label.ratios.items()) or "nothing"
    if spec["began"]:
        acts += f" from {spec['began']['time'] / 3600:.1f} h"
    ideal = "-" if known is None else f"{known.nats:.0f}, margin {known.margin:.0f} over {known.rival or '-'}"
    claims = [*one.answer.names, *("/".join(sorted(each)) for each in one.answer.classes)]
    reasons = _flat("; ".join(map(str, said.get("reasons") or ())) or one.outcome.message)[:SHOWN]
    began = began_at(one)
    dated = "" if began is None else f" begins {began / 3600:.1f} h"
    held: dict[str, Any] = said.get("held_out") or {}
    errors = [held.get(key) for key in ("rmse_before", "rmse_after", "noise_floor")]
    numbers = ", ".join("-" if value is None else f"{value:.3f}" for value in errors)
    case = f"{one.stratum} {spec['number']}, {spec['law']}, {spec['habit']}, {spec['learned']}, {one.label.case}"
    answer = f"{one.answer.verdict} {' + '.join(claims)}{dated} {reasons}"
    return [acts, case, ideal, answer.strip(), f"{numbers} (true {one.label.floor:.3f})", f"{one.outcome.seconds:.0f}"]
