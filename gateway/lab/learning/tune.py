"""`model learn settings`: the best settings of a learning method by cross-validation over traces, resumable."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gateway.console import CommandResult, Part, Rows, conclude, progress
from gateway.entry import Exit, interruptible, sentences
from gateway.lab.traces.load import channel_warnings, load
from sim.artefacts import VERDICT_FILE
from sim.lab.choices import Search
from sim.lab.formats import write_model_directory
from sim.lab.judge import judge_learning
from sim.lab.recordings import split_cycles
from sim.lab.tuning import Objective, StudyPlan, Tuning, final_model
from sim.lab.tuning import tune as searched
from sim.sha import display_unit, encode_trace, signal_unit

MAX_LISTED_TRIALS = 10


def tune(
    method: str,
    paths: Sequence[str],
    map_name: str,
    cycles: bool,
    study: Path,
    trials: int,
    folds: int,
    jobs: int,
    objective: Objective,
    search: Search,
    prune: bool,
    out: Path | None,
    name: str,
    seed: int,
    as_json: bool,
) -> None:
    """Carry out `decanter model learn settings`; its options and its help are in learning/commands.py."""
    with sentences(), progress(f"tuning ({method})") as bar, interruptible(bar) as report:
        traces, column_map = load(paths, map_name)
        warnings = channel_warnings(traces, column_map.alphabet)
        if cycles:
            traces = [piece for trace in traces for piece in split_cycles(trace, column_map.alphabet)]
        unit = signal_unit(traces, column_map.temperature)
        plan = StudyPlan(method, objective, folds, seed, search)
        tuning = searched(
            traces,
            column_map.alphabet,
            column_map.temperature,
            plan,
            study,
            trials=trials,
            jobs=jobs,
            prune=prune,
            progress=report,
        )
        written = None
        if out is not None and not tuning.stopped:
            report("learning with the best settings", 1.0)
            if tuning.best is None:
                raise ValueError(f"{tuning.sentence}; nothing is written to {out}")
            alphabet, temperature = column_map.alphabet, column_map.temperature
            learned = final_model(traces, alphabet, temperature, plan=plan, trial=tuning.best, name=name)
            verdict = judge_learning(
                learned.model, [encode_trace(trace, learned.model.alphabet) for trace in traces], learned.coverage
            )
            write_model_directory(out, learned.model, learned.values, more={VERDICT_FILE: verdict.text()})
            written = out
    data = {
        "method": method,
        "objective": objective,
        "search": search,
        "unit": unit,
        "warnings": warnings,
        "study": str(study),
        **asdict(tuning),
        "model": written and str(written),
    }
    complaint = f"stopped after {len(tuning.trials)} trials; the same command goes on with {study}"
    found = CommandResult(data, complaint if tuning.stopped else "", Exit.INTERRUPTED)
    conclude(found, lambda _: _show(tuning, plan, study, written, display_unit(unit)), as_json=as_json)


def _show(tuning: Tuning, plan: StudyPlan, study: Path, written: Path | None, unit: str) -> Iterator[Part]:
    figure = f"CRPS ({unit})" if plan.objective == "crps" else "minus log-likelihood per reading"
    complete = sorted((trial for trial in tuning.trials if trial.state == "complete"), key=lambda trial: trial.value)
    rows = [
        [trial.number, trial.value, trial.error, trial.settings or "defaults"] for trial in complete[:MAX_LISTED_TRIALS]
    ]
    if tuning.default is not None and tuning.default not in complete[:MAX_LISTED_TRIALS]:
        rows.append([tuning.default.number, tuning.default.value, tuning.default.error, "defaults"])
    others: dict[str, Any] = {}
    for trial in tuning.trials:
        if trial.state != "complete":
            others[trial.state] = others.get(trial.state, 0) + 1
    more = "".join(f", {count} {state}" for state, count in others.items())
    title = f"{plan.method}: {len(tuning.trials)} trials{more}; the best by held-out {figure}"
    if rows:
        yield Rows(title, ("trial", "value", "standard error", "settings"), rows)
    yield tuning.sentence
    failed = next((trial for trial in tuning.trials if trial.state == "failed"), None)
    if failed is not None and tuning.best is not None:
        yield f"trial {failed.number} failed: {failed.reason}"
    for note in tuning.notes:
        yield f"note: {note}"
    yield f"study: {study}"
    if written is not None:
        yield f"model directory: {written}"
