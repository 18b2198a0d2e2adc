"""What each rule of a diagnosis carries: every one of them off, halved and doubled, on cases whose truth is known.

\b
python -m benchmarks.discrepancy.ablation DIR --name rules --cases 8

A rule that a diagnosis never reads cannot change it, and of the others only what hangs on them is worked out again. The
answers lie in DIR/results/NAME/ablation.jsonl, a line for each case; the table is of all that lie there.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import replace
from io import StringIO
from math import inf
from pathlib import Path
from time import perf_counter
from typing import Any

import click

from benchmarks.discrepancy.judging import Judged, answer
from benchmarks.discrepancy.remembered import NAMES, Memory, WorkLimitError
from benchmarks.discrepancy.runner import RESULTS, Case, Outcome, case
from benchmarks.discrepancy.seal import Label, committed, index, opened
from sim.lab.discrepancy.rules import RULES, DecisionRules

OFF: Mapping[str, Any] = {
    "least_cycles": 2, "first_name_least_cycles": 0, "each_name_least_cycles": 1,
    "turning_least_load_share": 0.0, "contradicted_least_share": 0.0, "by_load_most_error_share": inf,
    "still_usual_least_moved_share": 0.0, "still_least_usual": 1, "still_least_lasted_share": 0.0,
    "still_least_way_share": 0.0, "still_least_way_steps": 0,
    "follows_least_share": inf, "follows_most_lead_share": inf,
    "least_gain_nats": 0.0, "same_least_cosine": inf, "near_least_cosine": 0.0, "margin_nats": 0.0,
    "margin_share": 0.0, "invisible_most_share": 0.0, "told_apart_times": 0.0, "strength_least_sigmas": 0.0,
    "once_least_share": inf,
    "robust_least_z": 0.0, "spread_least_cycles": 0.0, "overwhelming_nats": inf,
    "further_nats": 0.0, "further_least_size_share": 0.0, "further_clear_nats": -inf,
    "leftover_share": 0.0, "leftover_of_rival_share": 0.0, "most_heat_times": inf,
    "material_sigmas": 0.0, "gap_itself_least_share": inf,
    "removed_least_share": -inf, "beyond_doubt_nats": inf, "covered_most_times": inf,
    "ceiling_most_p": -1.0, "ceiling_least_share": -inf, "ceiling_left_most_share": inf, "ceiling_alone_most_p": -1.0,
    "wide_median_times": inf, "wide_low_times": 0.0, "wide_low_share": 0.0,
    "stated_noise_log_sd": inf, "stated_noise_most_times": inf,
    "floor_parameters_most_times": inf, "equal_least_cycles": 10**9, "comparable_least_share": inf,
    "named_least_confidence": 0.0, "left_by_names_log_sd": inf,
    "floor_interval_share": 1.0, "floor_blind_from_share": inf,
    "beginning_least_cycles": 1, "beginning_most_p": -1.0, "beginning_carried_share": -inf,
    "beginning_wanders_from": inf,
    "place_most_p": 1.0, "place_least_share": 0.0, "place_least_correlation": 0.0,
    "moved_least_sigmas": 0.0, "moved_least_share": 0.0, "absorbed_least_p": 0.0, "absorbed_least_saved": 0,
    "law_least_nats": -inf, "law_fitted_least_nats": -inf,
    "law_least_share": -inf, "law_least_cycles_share": 0.0, "law_same_least_cosine": inf,
    "law_term_nats": 0.0, "law_further_least_share": 0.0,
}  # fmt: skip
"""The value at which a rule decides nothing; of the share that is held out there is none."""
MOST_COSINE = 0.999
"""A doubled cosine."""
WAYS = ("off", "halved", "doubled")
FITS = 6
"""Fits that a variant may need beyond those of the ones before it; with more its path is another, and is not ended."""
ELSEWHERE = "another path"
"""The verdict of a variant that was not ended."""
UNTOLD = ("settings", "candidates")
"""Parts of a diagnosis that are the work behind it."""
FILE = "ablation.jsonl"
FOLDER = click.Path(path_type=Path, file_okay=False)


def variants(name: str) -> Iterator[tuple[str, DecisionRules]]:
    """(way, rules) of the variants of one rule that differ from it."""
    value = getattr(RULES, name)
    values = {"off": OFF.get(name, value), "halved": 0.5 * value, "doubled": 2.0 * value}
    for way, other in values.items():
        if way != "off":
            other = max(round(other), 1) if isinstance(value, int) else other
            other = min(other, MOST_COSINE) if name.endswith("_cosine") else other
            other = min(other, 1.0) if name.endswith(("_share", "_p")) else other
        if other != value:
            yield way, replace(RULES, **{name: other})


def remembered() -> dict[Any, tuple[str, ...]]:
    """The functions of the workflow that cost something, by the modules that call them."""
    from sim.lab.discrepancy import (
        constants,
        gap,
        judging,
        law_search,
        layout,
        locate,
        naming,
        path,
        proving,
        story,
        workflow,
    )

    return {
        layout: ("build_record", "build_frame", "with_priors", "move_frame", "follows", "patiently"),
        workflow: (
            "fit", "ceiling", "missing_heat", "build_record", "diagnosis_course", "find_absorbed_law", "places",
            "shifts",
            "candidate_laws",
        ),
        proving: (
            "ceiling", "let_run", "compare_fits", "stated_errors", "sensor_noise", "noise_floor", "excess", "beginning",
            "given_model_fit", "fit", "find_onset",
        ),
        naming: ("fit", "screen", "confirm", "_cosines", "gain_at_once", "slow_heat", "with_heats"),
        path: ("fit",),
        judging: ("smooth_course", "sensor_noise", "foreseen_better", "greatest_heat", "fastest_movement"),
        gap: ("let_run", "predict_errors"),
        locate: ("heat_blocks", "flips"),
        constants: ("let_run",),
        law_search: (
            "let_run", "Projector", "_rhythms", "law_columns", "_score_forms", "window_sensitivity", "smooth_course",
        ),
        story: ("implied_heat",),
    }  # fmt: skip


def ablated(one: Case, names: Sequence[str], fits: float) -> dict[str, Any]:
    """What is said of a case under the rules as they stand ("said"), and under the variants where it is another thing.

    Of each: the answer, as the scorer reads it, and "told": which parts of the diagnosis are others.
    """
    from gateway.lab.traces.load import load
    from sim.lab.discrepancy import diagnose
    from sim.lab.discrepancy.fitting import patiently
    from sim.lab.discrepancy.output import document
    from sim.lab.formats import find_model

    model = find_model(str(one.model)).runnable()
    with redirect_stderr(StringIO()):  # what is said of the files
        loaded, _ = load([str(one.traces)], "decanter")
    traces = [patiently(trace, model.alphabet) for trace in loaded]
    memory = Memory(counted="fit")

    def said(rules: DecisionRules) -> dict[str, Any]:
        return document(diagnose(model, traces, seed=one.seed, rules=memory.under(rules)).diagnosis)

    with memory.standing_in(remembered()):
        with memory.noting() as read:
            usual = said(RULES)
        memory.limit = fits
        others: dict[str, dict[str, Any]] = {name: {} for name in names if name in read}
        for name in others:
            for way, rules in variants(name):
                try:
                    with memory.light():
                        found = said(rules)
                except WorkLimitError:
                    others[name][way] = {"verdict": ELSEWHERE}
                    continue
                told = [key for key in {**usual, **found} if key not in UNTOLD and found.get(key) != usual.get(key)]
                if told:
                    others[name][way] = {**_short(found), "told": told}
    return {"said": _short(usual), "unread": sorted(set(names) - read), "others": others}


def _short(found: Mapping[str, Any]) -> dict[str, Any]:
    """What the scorer reads of a diagnosis."""
    effects = [{key: each[key] for key in ("name", "class", "confidence") if key in each} for each in found["effects"]]
    return {"verdict": found["verdict"], "effects": effects, "held_out": found.get("held_out")}


def worth(label: Label, found: Mapping[str, Any]) -> str:
    """ "right", "wrong" or "nothing", as the truth of the case has it."""
    outcome = Outcome(label.case, "done", 0.0, dict(found))
    judged = Judged(label, outcome, answer(outcome))
    verdict = judged.answer.verdict
    if judged.clean:
        return "right" if verdict == "agree" else "wrong" if verdict != "too-little-data" else "nothing"
    if judged.wrong:
        return "wrong"
    if judged.truth:
        return "right" if judged.in_class else "nothing"
    return "right" if verdict == "unexplained" else "nothing"


def first(found: Mapping[str, Any]) -> str:
    """The first name."""
    return str(found["effects"][0]["name"]) if found.get("effects") else ""


def table(labels: Mapping[str, Label], done: Sequence[Mapping[str, Any]]) -> str:
    """rule -> of the cases: verdicts, first names and scores that change, and diagnoses that change at all, each off /
    halved / doubled; "+" scores that become better, "-" worse."""
    head = ("verdicts", "first names", "scores", "anything", "elsewhere")
    lines = [
        f"{len(done)} cases; off / halved / doubled",
        f"{'rule':30} read" + "".join(f"{each:>19}" for each in head),
    ]
    for name in [each for each in RULES.__dataclass_fields__ if each in NAMES]:
        counts = {way: Counter[str]() for way in WAYS}
        read = 0
        for each in done:
            usual, label = each["said"], labels[each["case"]]
            read += name in each["others"]
            for way, found in each["others"].get(name, {}).items():
                count = counts[way]
                if found["verdict"] == ELSEWHERE:
                    count["elsewhere"] += 1
                    continue
                count["anything"] += 1
                count["verdict"] += found["verdict"] != usual["verdict"]
                count["first"] += first(found) != first(usual)
                before, after = (("wrong", "nothing", "right").index(worth(label, said)) for said in (usual, found))
                count["better"] += after > before
                count["worse"] += after < before

        def of(key: str, counts: Mapping[str, Counter[str]] = counts) -> str:
            return "/".join(str(counts[way][key]) for way in WAYS)

        scores = "/".join(f"+{counts[way]['better']}-{counts[way]['worse']}" for way in WAYS)
        cells = (of("verdict"), of("first"), scores, of("anything"), of("elsewhere"))
        lines.append(f"{name:30} {read:4}" + "".join(f"{each:>19}" for each in cells))
    return "\n".join(lines)


def in_turn(folder: Path, labels: Mapping[str, Label]) -> list[str]:
    """The cases, of every stratum in turn, those of the least rows first."""
    size = {name: case(folder, name).traces.stat().st_size for name in index(folder)}
    by_stratum: dict[str, list[str]] = {}
    for name in sorted(size, key=lambda name: size[name]):
        by_stratum.setdefault(str(labels[name].spec["stratum"]), []).append(name)
    rounds = max(len(each) for each in by_stratum.values())
    return [each[turn] for turn in range(rounds) for each in by_stratum.values() if turn < len(each)]


@click.command(help=__doc__)
@click.argument("folder", type=FOLDER)
@click.option("--name", default="ablation", show_default=True, help="Under which name the answers are kept.")
@click.option("--cases", type=click.IntRange(0), default=6, show_default=True, help="Cases in all; 0: only the table.")
@click.option("--rule", "only", multiple=True, help="Only this rule; may be given again.")
@click.option("--fits", type=click.IntRange(0), default=FITS, show_default=True, help="New fits a variant may need.")
def main(folder: Path, name: str, cases: int, only: tuple[str, ...], fits: int) -> None:
    """The command."""
    labels = opened(folder, committed(folder))
    out = folder / RESULTS / name
    out.mkdir(parents=True, exist_ok=True)
    file = out / FILE
    done = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
    names = only or tuple(each for each in RULES.__dataclass_fields__ if each in OFF)
    there = {each["case"] for each in done}
    for number, each in enumerate(in_turn(folder, labels)[:cases], start=1):
        if each in there:
            continue
        begun = perf_counter()
        found = {"case": each, **ablated(case(folder, each), names, fits)}
        done.append(found)
        with file.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(found) + "\n")
        stratum = labels[each].spec["stratum"]
        click.echo(f"{number} of {cases}: {each} ({stratum}), {perf_counter() - begun:.0f} s", err=True)
    click.echo(table(labels, done))


if __name__ == "__main__":
    main()
