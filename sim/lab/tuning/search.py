"""Hyper-parameter search by cross-validation over traces: resumable, the same whatever the number of workers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from math import isfinite, nan, sqrt
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Literal

import numpy as np

from sim.lab.judge import RUN_ERRORS, HeldOutFold, Paired, compare_pairs, score_fold, unit_differences
from sim.lab.learning import in_order
from sim.lab.tuning.methods import Method, Settings, Task, Taught, find_method
from sim.lab.tuning.study import (
    REASON_KEY,
    Facts,
    Search,
    ask,
    finished_trials,
    grid_size,
    interrupt,
    open_study,
    unbroken,
)
from sim.lab.workers import parallel
from sim.sha import Alphabet, Trace

if TYPE_CHECKING:
    from optuna.study import Study
    from optuna.trial import FrozenTrial
    from optuna.trial import Trial as OptunaTrial

Objective = Literal["crps", "likelihood"]
OBJECTIVES: tuple[Objective, ...] = ("crps", "likelihood")
Progress = Callable[[str, float], None]
SCORES, SECONDS = "scores", "seconds"
MIN_READINGS = 3
"""A trace with fewer is not held out."""


@dataclass(frozen=True, slots=True)
class StudyPlan:
    """What is searched and how it is scored: `fold_count` folds at most, dealt by `seed`, which seeds the learner too.

    `objective`: the mean CRPS (degC, per reading, of open-loop runs of the held-out traces), or minus the mean
    log-likelihood per reading (nats); either is the mean over traces, and lower is better. `search`: how settings are
    suggested.
    """

    method: str
    objective: Objective = "crps"
    fold_count: int = 5
    seed: int = 0
    search: Search = "tpe"

    def __post_init__(self) -> None:
        find_method(self.method)
        if self.objective not in OBJECTIVES:
            raise ValueError(f"the objective {self.objective!r} is unknown; known are {', '.join(OBJECTIVES)}")

    def value(self, score: HeldOutFold) -> float:
        """The objective of one trace."""
        return score.crps if self.objective == "crps" else -score.log_likelihood


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTrial:
    """One trial that is over; `number` counts those from 0.

    `value` with its standard error over traces is NaN where it failed or was pruned. `state` is "complete", "pruned" or
    "failed"; `reason` says why. `by_trace` is the objective of each held-out trace; no `settings` are the defaults.
    """

    number: int
    settings: Settings
    state: str
    value: float = nan
    error: float = nan
    by_trace: Mapping[str, float] | None = None
    reason: str = ""
    seconds: float = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """What a study says. `best` and `default` are None where no such trial was completed.

    `gain` is the objective of the defaults minus that of the best settings, paired by trace; `better` says whether it
    is larger than its own standard error. `stopped` says that the search was interrupted.
    """

    trials: tuple[StudyTrial, ...]
    best: StudyTrial | None
    default: StudyTrial | None
    gain: Paired | None
    better: bool
    sentence: str
    notes: tuple[str, ...] = ()
    stopped: bool = False


@dataclass(frozen=True, slots=True)
class FoldJob:
    """One fold of one trial, for a worker process: learn from `task`, score on `left_out`."""

    method: Method
    settings: Settings
    task: Task
    left_out: Sequence[Trace]


@dataclass(frozen=True, slots=True)
class FoldResult:
    """The scores of a fold, or why there are none."""

    scores: tuple[HeldOutFold, ...]
    seconds: float
    reason: str = ""


def tune(
    traces: Sequence[Trace],
    alphabet: Alphabet,
    temperature: str,
    plan: StudyPlan,
    study_file: Path,
    *,
    trials: int,
    jobs: int = 1,
    prune: bool = False,
    progress: Progress | None = None,
) -> Tuning:
    """Searches until the study in `study_file` has `trials` trials; goes on with what it has already.

    The first trial has the method's defaults. With up to as many jobs as folds the trials are the same however many
    jobs there are, interrupted or not; with more, as many trials at a time as fill the jobs are suggested together,
    and with `prune` folds are worked through `jobs` at a time: both depend on `jobs`, and on nothing else. Control-C
    ends the search and leaves the study as it is.

    Raises ValueError for too few traces, without Optuna, and for a study of something else (see `study.open_study`).
    """
    kept, notes, digest = usable(traces, temperature)
    parts = folds(len(kept), plan.fold_count, plan.seed)
    search = _TuningSearch(
        plan=plan, traces=kept, parts=parts, alphabet=alphabet, temperature=temperature, jobs=jobs, prune=prune
    )
    if plan.search == "grid":
        points = grid_size(find_method(plan.method).space)
        if trials > 1 + points:
            notes, trials = (*notes, f"the grid has {points} points: all are tried, and the defaults"), 1 + points
    stopped = False
    # All that decides what a score means. Not the number of jobs, which may change what is tried, and no score.
    facts: Facts = {
        "method": plan.method,
        "data": digest[:16],
        "signal": temperature,
        "alphabet": sha256(repr(alphabet).encode()).hexdigest()[:16],
        "search space": "; ".join(map(repr, find_method(plan.method).space)),
        "objective": plan.objective,
        "number of folds": len(parts),
        "seed": plan.seed,
        "search": plan.search,
    }
    with open_study(study_file, facts, prune=prune) as study:
        try:
            _run_trials(study, search, trials, progress or (lambda _what, _share: None))
        except KeyboardInterrupt:
            interrupt(study)
            stopped = True
        over = [_trial(place, stored, plan) for place, stored in enumerate(finished_trials(study))]
        return summary(over, notes, stopped=stopped)


def final_model(
    traces: Sequence[Trace], alphabet: Alphabet, temperature: str, plan: StudyPlan, trial: StudyTrial, name: str
) -> Taught:
    """The model learned with a trial's settings from all traces that the search used; its provenance says so.

    Raises ValueError as the learner does.
    """
    kept, _, _ = usable(traces, temperature)
    task = Task(_silent(kept), alphabet, temperature, plan.seed, name)
    taught = find_method(plan.method).learn(task, trial.settings)
    origin = taught.model.provenance
    tuned = {f"tuned_{name}": value for name, value in trial.settings.items()}
    scores = {f"tuning_{plan.objective}": trial.value, f"tuning_{plan.objective}_error": trial.error}
    origin = replace(origin, settings={**origin.settings, **tuned}, scores={**origin.scores, **scores})
    return replace(taught, model=replace(taught.model, provenance=origin))


def usable(traces: Sequence[Trace], temperature: str) -> tuple[tuple[Trace, ...], tuple[str, ...], str]:
    """(the traces that can be held out, in an order of their own; sentences about the others; the hash of the first).

    Copies count once. Traces of equal names but other content get a number, so that scores can be told apart.
    """
    readable, notes = [], []
    for trace in traces:
        readings = int(np.isfinite(trace.signals.get(temperature, np.empty(0))).sum())
        if readings < MIN_READINGS:
            notes.append(f"{trace.name} is left out: it has {readings} readings of {temperature!r}")
        else:
            readable.append(trace)
    ordered, digest = in_order(readable)
    copies = len(readable) - len(ordered)
    if copies:
        notes.append(f"{copies} cop{'y is' if copies == 1 else 'ies are'} left out")
    names: dict[str, int] = {}
    named = []
    for trace in ordered:
        names[trace.name] = names.get(trace.name, 0) + 1
        number = names[trace.name]
        named.append(trace if number == 1 else replace(trace, name=f"{trace.name} #{number}"))
    return tuple(named), tuple(notes), digest


def folds(count: int, wanted: int, seed: int) -> list[list[int]]:
    """Which of `count` traces each fold holds out: shuffled by `seed`, dealt one after another.

    There are no more folds than traces. Raises ValueError for fewer than two traces or folds.
    """
    if count < 2 or wanted < 2:
        raise ValueError(
            f"a cross-validation by trace needs 2 traces and 2 folds at least; there are {count} usable traces and "
            f"{wanted} folds (a long recording can be cut into cycles first)"
        )
    shuffled = np.random.default_rng(seed).permutation(count)
    number = min(wanted, count)
    return [sorted(shuffled[first::number].tolist()) for first in range(number)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _TuningSearch:
    plan: StudyPlan
    traces: Sequence[Trace]
    parts: Sequence[Sequence[int]]
    alphabet: Alphabet
    temperature: str
    jobs: int
    prune: bool

    def fold_jobs(self, settings: Settings) -> list[FoldJob]:
        """One job a fold."""
        jobs = []
        for held in map(set, self.parts):
            known = [trace for place, trace in enumerate(self.traces) if place not in held]
            left_out = [trace for place, trace in enumerate(self.traces) if place in held]
            task = Task(_silent(known), self.alphabet, self.temperature, self.plan.seed)
            jobs.append(FoldJob(find_method(self.plan.method), settings, task, _silent(left_out)))
        return jobs


def _silent(traces: Sequence[Trace]) -> list[Trace]:
    """The traces without events: each trial encodes them by its own alphabet."""
    return [replace(trace, events=()) for trace in traces]


def _run_trials(study: "Study", search: _TuningSearch, trials: int, progress: Progress) -> None:
    """Trial after trial until the study has as many as are wanted. Raises KeyboardInterrupt."""
    space = find_method(search.plan.method).space
    # More than one trial at a time only where one alone does not fill the jobs: trials that are asked for together know
    # nothing of one another. With pruning it is one, and `jobs` of its folds are worked through at a time.
    together = 1 if search.prune else max(1, search.jobs // len(search.parts))
    while (done := len(over := finished_trials(study))) < trials:
        ahead = range(done, min(done + together, trials))
        suggested = [ask(study, space, place, search.plan.seed, search.plan.search) for place in ahead]
        values = [trial.value for trial in over if trial.value is not None and trial.state.name == "COMPLETE"]
        best = f", best so far {min(values):.4g}" if values else ""
        progress(f"trial {done + 1} of {trials}{best}", done / trials)
        if search.prune:
            _tell(study, suggested[0], _run_pruned_folds(suggested[0], search), search)
            continue
        work = [job for trial in suggested for job in search.fold_jobs(trial.params)]
        results = list(parallel(run_fold, work, search.jobs))
        for place, trial in enumerate(suggested):
            own = results[place * len(search.parts) : (place + 1) * len(search.parts)]
            _tell(study, trial, own, search)


def _run_pruned_folds(trial: "OptunaTrial", search: _TuningSearch) -> list[FoldResult]:
    """The folds, as many at a time as there are jobs, until the pruner sees enough."""
    work, results = search.fold_jobs(trial.params), list[FoldResult]()
    for first in range(0, len(work), search.jobs):
        results += parallel(run_fold, work[first : first + search.jobs], search.jobs)
        if any(fold.reason for fold in results):
            return results
        values = [search.plan.value(score) for fold in results for score in fold.scores]
        with unbroken():
            trial.report(float(np.mean(values)), len(results))
            enough = len(results) < len(work) and trial.should_prune()
        if enough:
            return results
    return results


def run_fold(job: FoldJob) -> FoldResult:
    """Learn, then score; what the traces cannot teach becomes the reason."""
    begin = perf_counter()
    try:
        model = job.method.learn(job.task, job.settings).model
        scores = tuple(score_fold(model, trace) for trace in job.left_out)
    except RUN_ERRORS as error:
        return FoldResult((), perf_counter() - begin, str(error) or type(error).__name__)
    unusable = next((score.trace for score in scores if not isfinite(score.crps + score.log_likelihood)), None)
    reason = f"the model's prediction of {unusable} is no number" if unusable is not None else ""
    return FoldResult(scores, perf_counter() - begin, reason)


@unbroken()
def _tell(study: "Study", trial: "OptunaTrial", results: Sequence[FoldResult], search: _TuningSearch) -> None:
    from optuna.trial import TrialState

    scores = [score for fold in results for score in fold.scores]
    trial.set_user_attr(SECONDS, sum(fold.seconds for fold in results))
    trial.set_user_attr(SCORES, [asdict(score) for score in scores])
    reason = next((fold.reason for fold in results if fold.reason), "")
    if reason:
        trial.set_user_attr(REASON_KEY, reason)
        study.tell(trial, state=TrialState.FAIL)
    elif len(results) < len(search.parts):
        study.tell(trial, state=TrialState.PRUNED)
    else:
        study.tell(trial, float(np.mean([search.plan.value(score) for score in scores])))


def _trial(number: int, stored: "FrozenTrial", plan: StudyPlan) -> StudyTrial:
    """The trial as the study's file has it."""
    state = {"COMPLETE": "complete", "PRUNED": "pruned"}.get(stored.state.name, "failed")
    values = {row["trace"]: plan.value(HeldOutFold(**row)) for row in stored.user_attrs.get(SCORES, ())}
    seconds = stored.user_attrs.get(SECONDS, nan)
    if state != "complete":
        reason = stored.user_attrs.get(REASON_KEY, f"given up after {len(values)} traces")
        return StudyTrial(number=number, settings=stored.params, state=state, reason=reason, seconds=seconds)
    column = np.array(list(values.values()))
    error = float(np.std(column, ddof=1)) / sqrt(column.size)
    return StudyTrial(
        number=number,
        settings=stored.params,
        state=state,
        value=float(column.mean()),
        error=error,
        by_trace=values,
        seconds=seconds,
    )


def summary(trials: Sequence[StudyTrial], notes: Sequence[str] = (), *, stopped: bool = False) -> Tuning:
    """What the trials say: the best settings, and whether they are better than the defaults."""
    complete = [trial for trial in trials if trial.state == "complete"]
    best = min(complete, key=lambda trial: (trial.value, trial.number), default=None)
    default = next((trial for trial in complete if not trial.settings), None)
    gain = None
    if best is not None and default is not None and best is not default:
        # Paired by trace, which takes out how much harder one trace is than another.
        gain = compare_pairs(unit_differences(default.by_trace or {}, best.by_trace or {}), np.random.default_rng(0))
    better = gain is not None and gain.mean > gain.error
    if best is None:
        failed = next((trial.reason for trial in trials if trial.state == "failed"), "")
        sentence = f"no trial was completed{f': {failed}' if failed else ''}"
    elif default is None:
        sentence = "the defaults cannot be learned from these traces, so the best settings are compared with nothing"
    elif gain is None:
        sentence = "no settings were found that are better than the defaults"
    else:
        by = f"by {gain.mean:.3g} with a standard error of {gain.error:.2g}, paired over {gain.n} traces"
        # The best of many trials owes part of its lead to luck: the sentence says so.
        sentence = (
            f"the best settings are better than the defaults {by}; as the best of many they look a little too good"
            if better
            else f"the best settings are not better than the defaults by more than one standard error ({by})"
        )
    return Tuning(
        trials=tuple(trials),
        best=best,
        default=default,
        gain=gain,
        better=better,
        sentence=sentence,
        notes=tuple(notes),
        stopped=stopped,
    )
