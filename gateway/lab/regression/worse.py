"""What became worse since which run, and what of former runs is not there at the last one."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.lab.regression.history import RegressionHistory, own_scores
from sim.lab.judge import NEW, PRESENT, HorizonComparison, compare_horizons
from sim.sha import display_unit

MIN_CRPS_RATIO = 1.01
"""A CRPS that a test tells apart, but that is not so many times the former one's, is nothing to act on."""
SET = "standard set"

Results = Mapping[str, Mapping[str, Any]]
"""The results of a run by the content of the trace."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorseForecast:
    """A `subject` (a model by its name) whose forecasts became worse at some horizon.

    `best` and `since` are rows of runs: the one that it is held against, and the first one that was worse ever since.
    """

    subject: str
    comparison: HorizonComparison
    best: Mapping[str, Any]
    since: Mapping[str, Any]
    worst_trace: str

    def sentence(self, unit: str) -> str:
        """What became worse since when, and what changed there."""
        c = self.comparison
        changed = []
        if self.since["code"] != self.best["code"]:
            changed.append(f"program {self.since['code_name']}, before {self.best['code_name']}")
        now, before = self.since["models"][self.subject], self.best["models"][self.subject]
        if now != before:
            changed.append(f"model {now[:8]}, before {before[:8]}")
        return (
            f"{self.subject}: worse at {c.horizon:g} s since {self.since['when']} ({'; '.join(changed)}): CRPS "
            f"{c.crps[NEW]:.3g} {display_unit(unit)}, before {c.crps[PRESENT]:.3g}, on {c.difference.n} traces "
            f"(p {c.p:.2g}), most of all on {self.worst_trace}"
        )


def find_regressions(subject: str, history: RegressionHistory, *, seed: int) -> list[WorseForecast | str]:
    """What is worse at the subject's last run than at its best one before; a sentence for a trace that failed since.

    The best run is looked for horizon by horizon. Two runs are held against each other on the traces of both.
    """
    runs = history.runs(subject, seed)
    results = [history.results(run, subject) for run in runs]
    found: list[WorseForecast | str] = []
    if len(runs) < 2:
        return found
    for content, row in results[-1].items():
        if row["failed"] and any(content in each and not each[content]["failed"] for each in results[:-1]):
            found.append(f"{subject}: has no forecast along {row['trace_name']} any more: {row['failed']}")
    worse = [worse_by_horizon(before, results[-1], seed) for before in results[:-1]]
    for horizon in sorted({each for comparisons in worse for each in comparisons}):
        held = [(comparisons[horizon], place) for place, comparisons in enumerate(worse) if horizon in comparisons]
        comparison, best = min(held, key=lambda each: each[0].crps[PRESENT] / each[0].crps[NEW])
        # Back from the last run, which is worse, to the first of those that are worse without a break.
        since = len(runs) - 1
        while since - 1 > best and horizon in worse_by_horizon(results[best], results[since - 1], seed):
            since -= 1
        before, now = _crps(results[best], horizon), _crps(results[-1], horizon)
        worst = max(before.keys() & now.keys(), key=lambda content: now[content] - before[content])
        found.append(
            WorseForecast(
                subject=subject,
                comparison=comparison,
                best=runs[best],
                since=runs[since],
                worst_trace=results[-1][worst]["trace_name"],
            )
        )
    return found


def worse_by_horizon(before: Results, now: Results, seed: int) -> dict[float, HorizonComparison]:
    """The horizons (s) at which the later run is worse on the traces that both have forecasts along."""
    scores: list[dict[str, Any]] = []
    for content in sorted(before.keys() & now.keys()):
        present, new = own_scores(before[content]), own_scores(now[content])
        # A horizon that only one of them has would be in one mean and not in the other.
        for horizon in (each for each in present if each in new):
            scores.append({**present[horizon], "trace": content})
            scores.append({**new[horizon], "trace": content, "method": NEW})
    return {
        comparison.horizon: comparison
        for comparison in compare_horizons(SET, scores, seed=seed)
        if comparison.refuses and comparison.crps[NEW] > MIN_CRPS_RATIO * comparison.crps[PRESENT]
    }


def _crps(results: Results, horizon: float) -> dict[str, float]:
    own = {content: own_scores(row) for content, row in results.items()}
    return {content: scores[horizon]["crps"] for content, scores in own.items() if horizon in scores}


Run = Mapping[str, Any]


def gone_models(history: RegressionHistory) -> list[str]:
    """A sentence for each model that the newest former run had under a place asked now, and the last run has not.

    Former runs are those that share a trace with the last one and were asked for all of that place.
    """
    run, former = _last_and_former(history)
    folder = history.path.parent.resolve()
    gone: dict[str, str] = {}
    for place in run["places"]:
        before = next((each for each in reversed(former) if _covers_place(each, place, folder)), None)
        if before is None:
            continue
        for subject in sorted(before["models"].keys() - run["models"].keys()):
            if _is_part(subject, place, folder):
                gone[subject] = f"{subject} was in the run of {before['when']} and is not there any more"
    return list(gone.values())


def trace_notes(history: RegressionHistory) -> list[str]:
    """What the last run's set lacks of the newest former one that shares a trace; that none does, where there are some.

    Of the very first run there is nothing to say.
    """
    run, former = _last_and_former(history)
    if not former:
        any_run = any(row["kind"] == "run" for row in history.rows[:-1])
        return ["compared with no former run: none has these traces"] if any_run else []
    names = {row["trace"]: row["trace_name"] for row in history.rows if row["kind"] == "result"}
    here = {names[content] for content in run["traces"] if content in names}
    gone = sorted(names.get(content, content[:8]) for content in set(former[-1]["traces"]) - set(run["traces"]))
    shown = [f"{name} (it has other readings now)" if name in here else name for name in gone]
    return [f"not in the set any more since the run of {former[-1]['when']}: {', '.join(shown)}"] if gone else []


def _last_and_former(history: RegressionHistory) -> tuple[Run, list[Run]]:
    """The last run, and the runs before it that share a trace with it: those of the same standard set."""
    *former, last = (row for row in history.rows if row["kind"] == "run")
    return last, [run for run in former if set(run["traces"]) & set(last["traces"])]


def _covers_place(run: Run, place: str, folder: Path) -> bool:
    # Rows of former versions do not say what was asked: a model that they have there shows it.
    asked = run.get("places")
    if asked is None:
        return any(_is_part(subject, place, folder) for subject in run["models"])
    return any(_is_part(place, each, folder) for each in asked)


def _is_part(name: str, place: str, folder: Path) -> bool:
    """Whether a subject or a place lies at or below another place; both are as seen from `folder`."""
    path, above = (os.path.normpath(folder / each) for each in (name, place))
    return Path(path).is_relative_to(above) or path.startswith(f"{above}@")
