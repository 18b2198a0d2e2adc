"""Opens the labels and writes what a benchmark is judged by: table.md, figures.json and picture.png."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.discrepancy.judging import Judged, answer
from benchmarks.discrepancy.picture import draw
from benchmarks.discrepancy.rivals import METHODS, TUNED
from benchmarks.discrepancy.runner import RESULTS, RUN, outcomes
from benchmarks.discrepancy.scorer import document
from benchmarks.discrepancy.seal import committed, index, opened
from benchmarks.discrepancy.strata import SETS
from benchmarks.discrepancy.table import markdown


def judge(folder: Path, name: str) -> list[Judged]:
    """The cases of a folder with the answers of one tool. Raises ValueError without results or with other labels."""
    results = folder / RESULTS / name
    if not (results / RUN).exists():
        raise ValueError(f"{results}: there are no results; run the cases first")
    commitment, found = outcomes(results)
    labels = opened(folder, commitment)
    return [Judged(labels[case], outcome, answer(outcome)) for case, outcome in sorted(found.items())]


def write_report(folder: Path, name: str, out: Path) -> str:
    """Score `name` and every rival that has results; returns the table."""
    rivals = [one for one in METHODS if one != name and (folder / RESULTS / one / RUN).exists()]
    tools = {one: judge(folder, one) for one in (name, *rivals)}
    out.mkdir(parents=True, exist_ok=True)
    words = markdown(tools, _about(folder, tools[name]))
    (out / "table.md").write_text(words, encoding="utf-8")
    figures = {one: document(judged) for one, judged in tools.items()}
    facts = {
        "commitment": committed(folder),
        "rival_settings": {method: asdict(one) for method, one in TUNED.items()},
        "tools": figures,
    }
    (out / "figures.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    draw(tools, out / "picture.png")
    return words


def _about(folder: Path, judged: Sequence[Judged]) -> str:
    sets = sorted({str(one.label.spec["set"]) for one in judged})
    seeds = ", ".join(f"{one} (entropy {SETS[one]})" for one in sets)
    aside = sum(not one.usable for one in judged)
    return (
        f"{len(judged)} of {len(index(folder))} cases of the set {seeds}; labels committed to as `{committed(folder)}`."
        f" Set aside among the clean ones, for a baseline that cannot say what the plant does: {aside} at most."
    )
