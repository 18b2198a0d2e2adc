"""How many corruptions changed what is said: by class, with the reasons of what was refused."""

from collections import Counter
from collections.abc import Mapping
from re import sub

from benchmarks.discrepancy.corrupted.cases import CLASSES, DROPPED, RECORDS, CorruptedRecord
from benchmarks.discrepancy.corrupted.contradictions import contradictions
from benchmarks.discrepancy.judging import answer
from benchmarks.discrepancy.runner import Outcome
from benchmarks.discrepancy.scorer import Row, at_least, at_most, row
from benchmarks.discrepancy.table import grid, interval, percent, wanted
from gateway.entry.exits import Exit

UNCHANGED = at_least(0.98)
"""What is promised where 2 % of the rows are dropped."""
REFUSED = f"SystemExit: {Exit.USAGE:d} "
"""How the runner begins what it keeps of input that was refused."""
SHOWN = 160
"""Characters of a reason in a line."""

Found = Mapping[CorruptedRecord, Outcome]


def first_name(outcome: Outcome) -> str:
    """The name that leads, alone or in its class; "" where none does."""
    effects = outcome.diagnosis.get("effects") or ()
    return str(effects[0]["name"]) if effects else ""


def said(outcome: Outcome) -> tuple[str, str]:
    """(verdict, first name); the status for a verdict where there is none."""
    return answer(outcome).verdict, first_name(outcome)


def is_refused(outcome: Outcome) -> bool:
    """Whether it ended in one sentence about its input, with the exit code of those."""
    return outcome.status == "error" and outcome.message.startswith(REFUSED)


def is_fault(outcome: Outcome) -> bool:
    """Whether it neither ended in a diagnosis nor was refused."""
    return outcome.status != "done" and not is_refused(outcome)


def against_itself(outcome: Outcome) -> list[str]:
    """What a diagnosis that there is says against its own figures."""
    return contradictions(outcome.diagnosis) if outcome.status == "done" else []


def rows(found: Found) -> list[Row]:
    """Faults of all; then verdict and first name by class, of those that were not refused."""
    corrupted = [one for one in found if one.kind]
    whole = {one.record: said(outcome) for one, outcome in found.items() if not one.kind}

    def unchanged(one: CorruptedRecord) -> bool:
        return said(found[one]) == whole[one.record]

    def other_name(one: CorruptedRecord) -> bool:
        return first_name(found[one]) not in ("", whole[one.record][1])

    figures = [
        row("internal errors", corrupted, lambda one: is_fault(found[one]), at_most(0.0)),
        row("refused in a sentence", corrupted, lambda one: is_refused(found[one])),
        row("contradicts itself", corrupted, lambda one: bool(against_itself(found[one])), at_most(0.0)),
        row("a first name that the record as it is does not have", corrupted, other_name),
    ]
    for kind in CLASSES:
        those = [one for one in corrupted if one.kind == kind and not is_refused(found[one])]
        target = UNCHANGED if kind == DROPPED else (0.0, 1.0)
        figures.append(row(f"{kind}: verdict and first name unchanged", those, unchanged, target))
    return [one for one in figures if one.cases]


def tables(found: Found, *, every: bool = False) -> str:
    """The figures as Markdown; `every`: and a line for each corruption that changed what is said."""
    body = [
        [one.name, wanted(one) if one.target != (0.0, 1.0) else "", percent(one), interval(one),
         f"{one.hits}/{one.cases}", one.verdict]
        for one in rows(found)
    ]  # fmt: skip
    parts = [grid(["figure", "target", "share", "95 %", "n", ""], body)]
    whole = {one.record: said(outcome) for one, outcome in found.items() if not one.kind}
    shares = []
    for record in RECORDS:
        of = [(one, outcome) for one, outcome in found.items() if one.record == record and one.kind]
        lost = [said(outcome) == whole.get(record) for one, outcome in of if one.kind == DROPPED]
        changes = Counter(said(outcome) for _, outcome in of if not is_refused(outcome))
        changes.pop(whole.get(record), None)
        others = ", ".join(f"{count} {' '.join(filter(None, one))}" for one, count in changes.most_common())
        shares.append([record, " ".join(whole.get(record, ())), f"{sum(lost)}/{len(lost)}", str(len(of)), others])
    parts.append(grid(["record", "as it is", "2 % dropped: the same", "corruptions", "else"], shares))
    reasons = Counter(_reason(outcome) for outcome in found.values() if outcome.message)
    if reasons:
        parts.append(grid(["errors and refusals", "n"], [[one, str(n)] for one, n in reasons.most_common()]))
    against = [[one.name, one.record, one.kind, "; ".join(against_itself(outcome))] for one, outcome in found.items()]
    if against := [line for line in against if line[-1]]:
        parts.append(grid(["case", "record", "class", "contradicts itself"], against))
    if every:
        changed = [
            [one.name, one.record, one.kind, " ".join(said(outcome)), _why(outcome)]
            for one, outcome in found.items()
            if one.kind and said(outcome) != whole[one.record]
        ]
        parts.append(grid(["case", "record", "class", "said", "reasons"], changed))
    return "\n\n".join(parts)


def _reason(outcome: Outcome) -> str:
    """A message without its numbers, so that those of one kind are one."""
    return sub(r"[0-9]+", "N", outcome.message.partition(": ")[2])[:SHOWN].replace("\n", " ")


def _why(outcome: Outcome) -> str:
    reasons = "; ".join(map(str, outcome.diagnosis.get("reasons") or ())) or outcome.message
    return reasons[:SHOWN].replace("|", "/").replace("\n", " ")
