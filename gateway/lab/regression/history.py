"""The history of a standard set: one JSON object a line, each result once, and what models there were at each run."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any

from gateway.entry import sentence
from gateway.lab.json_rows import RowKeys, append_row, check_row, read_rows
from gateway.lab.judging.figures import score_trace
from gateway.lab.regression.standard import CodeVersion, StandardSet
from sim.artefacts import model_hash
from sim.files import file_error, held_alone
from sim.lab.judge import PRESENT
from sim.sha import Model, content_hash

FORMAT = 1
KEPT = ("horizon", "method", "forecasts", "crps", "mae", "coverage")
"""What is kept of the scores of a method at a horizon (s) along a trace: CRPS and MAE in degC."""


class ScoreKeys(RowKeys):
    """What is used of a method's scores at a horizon."""

    horizon: float
    method: str
    crps: float
    coverage: float


class ResultRow(RowKeys):
    """A model along a trace: its `scores`, or why it `failed`."""

    model: str
    trace: str
    code: str
    seed: int
    trace_name: str
    scores: list[ScoreKeys]
    failed: str


class RunRow(RowKeys):
    """The `models` (hashes by subject) and traces of a run, and the `places` asked for, which old rows do not have."""

    when: str
    code: str
    code_name: str
    seed: int
    models: dict[str, str]
    traces: list[str]
    places: list[str] | None = None


class AcceptedRow(RowKeys):
    """The `models` (subjects) and the seed that somebody accepted as they were; an old row without them means all."""

    when: str
    reason: str
    models: list[str] | None = None
    seed: int | None = None


ROWS: Mapping[str, type[RowKeys]] = {"result": ResultRow, "run": RunRow, "accepted": AcceptedRow}


@dataclass(slots=True)
class RegressionHistory:
    """The file of all results and runs; see `open_history`.

    A `result` is of a model along a trace by a program and a seed, so that none is computed twice; a `run` says which
    models there were under which names.
    """

    path: Path
    rows: list[dict[str, Any]]

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a row. Raises OSError."""
        append_row(self.path, {"format": FORMAT, **row})
        self.rows.append(dict(row))

    def results(self, run: Mapping[str, Any], subject: str) -> dict[str, Mapping[str, Any]]:
        """The results of a subject along a run's traces, by the content of the trace."""
        key = (run["models"].get(subject), run["code"], run["seed"])
        found = (row for row in self.rows if row["kind"] == "result")
        own = (row for row in found if (row["model"], row["code"], row["seed"]) == key)
        return {row["trace"]: row for row in own if row["trace"] in run["traces"]}

    def runs(self, subject: str, seed: int) -> list[Mapping[str, Any]]:
        """The runs with the subject since it was last accepted as it was, the oldest first; equal ones count once."""
        kept: list[Mapping[str, Any]] = []
        for row in self.rows:
            if row["kind"] == "accepted":
                # Rows of former versions do not say what they accept: that was everything.
                named = row.get("models")
                if (named is None or subject in named) and row.get("seed") in (None, seed):
                    kept = kept[-1:]
            elif row["kind"] == "run" and subject in row["models"] and row["seed"] == seed:
                last = kept[-1] if kept else None
                state = (row["code"], row["models"][subject], row["traces"])
                if last is None or state != (last["code"], last["models"][subject], last["traces"]):
                    kept.append(row)
        return kept


@contextmanager
def open_history(path: Path) -> Iterator[RegressionHistory]:
    """The history in a file, held by this process alone; made where there is none.

    Raises ArtefactError where it is no such file or another process holds it, OSError where it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    busy = file_error(path, None, "another process is writing this history; wait for it")
    with held_alone(path.with_name(f".{path.name}.lock"), busy):
        rows = read_rows(path)
        for number, row in enumerate(rows, 1):
            if row.get("format") != FORMAT or row.get("kind") not in tuple(ROWS):
                raise file_error(
                    path, number, "is no row of a history of regressions; give another file, or a new name"
                )
            check_row(path, number, row, ROWS[row["kind"]])
        yield RegressionHistory(path, rows)


def own_scores(row: Mapping[str, Any]) -> dict[float, Mapping[str, Any]]:
    """The model's own scores of a result, by horizon (s)."""
    return {score["horizon"]: score for score in row["scores"] if score["method"] == PRESENT}


def run_standard(
    models: Mapping[str, Model | str],
    standard: StandardSet,
    history: RegressionHistory,
    *,
    places: Sequence[str],
    code: CodeVersion,
    seed: int,
    clock: Callable[[], float],
    report: Callable[[str, float], None],
) -> None:
    """Forecast with every model along every trace, as far as the history has not; each result is kept as it comes.

    The models are all that there are under `places`, called as seen from the history.
    """
    hashes = {subject: _subject_hash(model) for subject, model in models.items()}
    known = {(row["model"], row["trace"], row["code"], row["seed"]) for row in history.rows if row["kind"] == "result"}
    traces = {content_hash(trace): trace for trace in standard.traces}
    for number, (subject, model) in enumerate(models.items()):
        for content, trace in traces.items():
            key = (hashes[subject], content, code.content, seed)
            if key in known:
                continue
            known.add(key)
            report(f"{subject} along {trace.name}", number / len(models))
            scores: list[dict[str, Any]] = []
            failed = model if isinstance(model, str) else ""
            if not isinstance(model, str):
                try:
                    found = score_trace(trace, model, None, seed=seed, report=lambda what, share: None)
                    if not all(isfinite(each["crps"]) for each in found):
                        raise ValueError("its forecasts are no finite numbers")
                    scores = [{name: each[name] for name in KEPT} for each in found]
                except ValueError as error:
                    failed = sentence(error)
            row = {"kind": "result", "model": key[0], "trace": content, "code": code.content, "seed": seed}
            history.add({**row, "trace_name": trace.name, "scores": scores, "failed": failed})
    when = datetime.fromtimestamp(clock(), UTC).isoformat(timespec="seconds")
    run = {"kind": "run", "when": when, "code": code.content, "code_name": str(code), "seed": seed}
    history.add({**run, "models": hashes, "traces": sorted(traces), "places": list(places)})


def _subject_hash(model: Model | str) -> str:
    # What cannot be run is known by the sentence why.
    return sha256(model.encode()).hexdigest() if isinstance(model, str) else model_hash(model)
