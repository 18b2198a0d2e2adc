"""How many classes the proposed experiment resolved, to the right member and to a wrong one; and its promised nats."""

from collections.abc import Sequence

import numpy as np

from benchmarks.discrepancy.experiment.again import Closed
from benchmarks.discrepancy.judging import answer
from benchmarks.discrepancy.runner import Outcome
from benchmarks.discrepancy.scorer import Row, at_least, at_most, row
from benchmarks.discrepancy.table import grid, interval, percent, wanted

RIGHT, WRONG = at_least(0.8), at_most(0.02)
"""What is promised of the classes that an experiment can resolve."""
SHOWN = 120
"""Characters of a reason or an error in a case's line."""


def rows(ways: Sequence[Closed]) -> list[Row]:
    """Of the experiments that were made: what became of the class, all together, without the pairs that nothing tells
    apart, and these alone; then by kind."""
    made = [one for one in ways if one.fate]
    told = [one for one in made if one.missing and not one.inseparable]
    enough = [one for one in told if one.enough]
    apart = [one for one in made if one.missing and one.inseparable]
    small = [one for one in made if not one.missing]
    found = [
        row("class to the right member", [one for one in told if one.is_class], _right, RIGHT),
        row("class, or names withheld between rivals, to the right one", told, _right, RIGHT),
        row("the same, where the experiment was said to be enough", enough, _right, RIGHT),
        row("the same, to a wrong one", told, _wrong, WRONG),
        row("the same, still a class", told, lambda one: one.fate == "class"),
        row("the same, nothing named", told, lambda one: one.fate in ("withheld", "error")),
        row("said to be beyond any experiment: not named wrongly", apart, lambda one: one.fate != "wrong"),
        row("said to be beyond any experiment: resolved all the same", apart, _right),
        row(
            "agreed at first, with rivals too small to matter: not named wrongly",
            small,
            lambda one: one.fate != "wrong",
        ),
    ]
    found += [
        row(f"{kind}: to the right one", [one for one in told if one.kind == kind], _right)
        for kind in dict.fromkeys(one.kind for one in ways)
    ]
    return [one for one in found if one.cases]


def _right(one: Closed) -> bool:
    return one.fate == "right"


def _wrong(one: Closed) -> bool:
    return one.fate == "wrong"


def tables(ways: Sequence[Closed], *, every: bool = False) -> str:
    """The figures as Markdown; `every`: and a line a case."""
    made = [one for one in ways if one.fate]
    classes = sum(one.is_class for one in ways)
    stray = sum(one.proposed is not None and one.acts not in one.rivals for one in ways)
    proposed = sum(one.proposed is not None for one in ways)
    about = (
        f"{len(ways)} cases: {classes} ended in a class, in {proposed} an experiment was proposed ({stray} without "
        f"what acts among its rivals, left out), {len(made)} were made and diagnosed again"
    )
    body = []
    for one in rows(ways):
        target = wanted(one) if one.target != (0.0, 1.0) else ""
        body.append([one.name, target, percent(one), interval(one), f"{one.hits}/{one.cases}", one.verdict])
    parts = [about, grid(["figure", "target", "share", "95 %", "n", ""], body)]
    weighed = [one for one in made if np.isfinite(one.gained) and not one.inseparable]
    if weighed:
        expected, gained = ([getattr(one, name) for one in weighed] for name in ("expected", "gained"))
        share = np.median(np.asarray(gained) / np.maximum(expected, 1e-9))
        parts.append(
            f"nats between what acts and its nearest rival: expected {np.median(expected):.0f}, gained "
            f"{np.median(gained):.0f} (medians), gained over expected {share:.2f} (median)"
        )
    if every:
        head = ["kind", "acts", "case", "first", "experiment", "expected (needed)", "gained", "second", "fate"]
        parts.append(grid(head, [_line(one) for one in ways]))
    return "\n\n".join(parts)


def _line(one: Closed) -> list[str]:
    proposed = one.proposed
    what = f"{proposed['what']}, {proposed['seconds'] / 3600.0:.0f} h" if proposed else "none"
    beyond = ", beyond any" if one.inseparable else ""
    expected = f"{one.expected:.0f} ({proposed['needed_nats']:.0f}{beyond})" if proposed else ""
    return [
        *(one.kind, f"{one.acts} {one.ratio:.1f}", one.case, _said(one.first), what, expected),
        *(f"{one.gained:.0f}", _said(one.second), one.fate),
    ]


def _said(outcome: Outcome | None) -> str:
    if outcome is None:
        return ""
    said = answer(outcome)
    claims = " + ".join([*said.names, *("/".join(sorted(each)) for each in said.classes)])
    reasons = "; ".join(map(str, outcome.diagnosis.get("reasons") or ())) or outcome.message
    return f"{said.verdict} {claims or reasons[:SHOWN]}".replace("|", "/").replace("\n", " ")
