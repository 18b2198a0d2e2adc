"""The table of the benchmark as Markdown: targets, the tool, its rivals; then what has no target, and each effect."""

from collections.abc import Mapping, Sequence

from benchmarks.discrepancy.judging import Judged
from benchmarks.discrepancy.scorer import SPEED_LIMIT, Row, further, per_effect, reliability, targets, times


def markdown(tools: Mapping[str, Sequence[Judged]], about: str) -> str:
    """All tables; the first tool is the one under test, the others are its rivals."""
    first = next(iter(tools))
    parts = [
        f"# Blind benchmark of `{first} diagnose`\n\n{about}",
        "## Targets\n\n" + _targets(tools),
        "## Without a target\n\n" + _further(tools),
        "## By effect\n\n" + _effects(tools[first]),
        "## Stated confidence\n\n" + _reliability(tools[first]),
        "Intervals are 95 % Clopper-Pearson. Errors and cases over the time limit claim nothing and count as such.",
    ]
    return "\n\n".join(parts) + "\n"


def _targets(tools: Mapping[str, Sequence[Judged]]) -> str:
    rows = {name: targets(judged) for name, judged in tools.items()}
    first, *rivals = rows
    head = ["figure", "target", first, "95 %", "n", "", *rivals]
    body = [
        [one.name, wanted(one), percent(one), interval(one), f"{one.hits}/{one.cases}", one.verdict]
        + [f"{percent(rows[rival][number])} ({rows[rival][number].cases})" for rival in rivals]
        for number, one in enumerate(rows[first])
    ]
    spent = {name: times(judged) for name, judged in tools.items()}
    if spent[first]:
        late = spent[first]["p95"] > SPEED_LIMIT
        body.append(
            [
                *("seconds a case of 4 days, p50 / p95 / max", f"<= {SPEED_LIMIT:g} (p95)", _seconds(spent[first])),
                *("", "", "MISSED" if late else "met", *(_seconds(spent[rival]) for rival in rivals)),
            ]
        )
    return grid(head, body)


def _seconds(found: Mapping[str, float]) -> str:
    return f"{found['p50']:.1f} / {found['p95']:.1f} / {found['max']:.1f}" if found else "-"


def _further(tools: Mapping[str, Sequence[Judged]]) -> str:
    rows = {name: further(judged) for name, judged in tools.items()}
    first, *rivals = rows
    body = [
        [one.name, percent(one), interval(one), f"{one.hits}/{one.cases}"]
        + [percent(rows[rival][number]) for rival in rivals]
        for number, one in enumerate(rows[first])
    ]
    return grid(["figure", first, "95 %", "n", *rivals], body)


def _effects(judged: Sequence[Judged]) -> str:
    found = per_effect(judged)
    head = ["what acts", "cases", "exact", "exact or in class", "wrong claim", "nothing claimed"]
    return grid(head, [[name, str(rows[0].cases), *(percent(one) for one in rows)] for name, rows in found.items()])


def _reliability(judged: Sequence[Judged]) -> str:
    bins = reliability(judged)
    body = [
        [
            *(f"{one.low:g} to {one.high:g}", f"{one.stated:.3f}", percent(one.right), interval(one.right)),
            f"{one.right.hits}/{one.right.cases}",
        ]
        for one in bins
    ]
    return grid(["stated", "mean stated", "right", "95 %", "n"], body) if body else "Nothing was claimed."


def wanted(one: Row) -> str:
    """A target in words."""
    low, high = one.target
    if low == 0:
        return f"<= {100 * high:g} %"
    return f">= {100 * low:g} %" if high == 1 else f"{100 * low:g}-{100 * high:g} %"


def percent(one: Row) -> str:
    """A share, or a dash without cases."""
    return f"{100 * one.share:.1f} %" if one.cases else "-"


def interval(one: Row) -> str:
    """Its interval in per cent."""
    low, high = one.interval
    return f"{100 * low:.1f}-{100 * high:.1f}" if one.cases else "-"


def grid(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
