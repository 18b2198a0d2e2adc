"""What a campaign says of one model on one trace, and whether the model was trained on the trace."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Literal

from sim.engine import Score
from sim.sha import DEFAULT_UNIT, Model, Trace, content_hash, joint_hash

Seen = Literal["no", "content", "name", "unknown"]
"""Whether a model was trained on a trace: its content proves it, or only its name says so; "unknown" where the model
does not say what it was learned from."""
TRAINED_VALUES: tuple[Seen, ...] = ("content", "name")


def seen_traces(model: Model, traces: Sequence[Trace]) -> dict[str, Seen]:
    """Each trace's name with the answer.

    A model keeps the hash of every trace that had a part in it. Models of earlier releases have one hash over all their
    training traces: it proves the content where the traces with known names, all traces, or one of them alone, have
    it. A known name alone is a warning, since its content may differ.
    """
    origin = model.provenance
    if not (origin.data_hash or origin.traces):
        return {trace.name: "unknown" for trace in traces}
    seen: dict[str, Seen] = {trace.name: "name" if trace.name in origin.traces else "no" for trace in traces}
    if origin.contents:
        proven = [trace for trace in traces if content_hash(trace) in origin.contents]
    else:
        named = [trace for trace in traces if seen[trace.name] == "name"]
        groups = (named, list(traces), *([trace] for trace in traces))
        proven = next((group for group in groups if group and joint_hash(group) == origin.data_hash), [])
        if proven:
            seen = dict.fromkeys(seen, "no")
    return seen | {trace.name: "content" for trace in proven}


NO_SCORE = Score(nan, nan, nan, 0)


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure with its 95 % block-bootstrap interval; NaN bounds where there were too few readings for one."""

    value: float
    low: float = nan
    high: float = nan


@dataclass(frozen=True, slots=True)
class TraceResult:
    """One model along one trace, open loop. Temperatures and errors (predicted - measured) are in `unit`.

    `failure` is the sentence of the stage that could not be passed (`stage`, 1 to 9), and every figure after it is
    NaN. `accepted` says whether every event had an edge; `rejected` is the sentence about the first that had none.
    `at_events` is the thesis's way, `at_samples` that of this project, `dense` the thesis's second run over all rows.
    `coverage` is the share of readings inside the 90 % band, `crps` the mean CRPS (degC), `beyond` the share of
    readings outside three standard deviations (the review flag). `persistence` is the MAE of the first reading held.
    `error_quantiles` are the 0, 5, 25, 50, 75, 95, 100 % quantiles of the error at the readings. `level` is the mean
    size of the readings, of which an error is so many per cent. `seen`: was the model trained on the trace?
    """

    model: str
    trace: str
    semantics: str
    synthetic: bool = False
    events: int = 0
    readings: int = 0
    duration: float = nan
    accepted: bool = False
    rejected: str = ""
    final_error: float = nan
    final_percent: float = nan
    at_events: Score = NO_SCORE
    at_samples: Score = NO_SCORE
    dense: Score = NO_SCORE
    mae: Interval = Interval(nan)
    rmse: Interval = Interval(nan)
    max_error: float = nan
    error_sigma: float = nan
    coverage: float = nan
    crps: float = nan
    beyond: float = nan
    persistence: float = nan
    clamps: int = 0
    limited: int = 0
    flags: tuple[str, ...] = ()
    error_quantiles: tuple[float, ...] = ()
    seconds: float = nan
    stage: int = 9
    failure: str = ""
    unit: str = DEFAULT_UNIT
    seen: Seen = "unknown"
    level: float = nan

    def percent(self, error: float) -> float:
        """An error (in `unit`) in per cent of the readings' mean size; NaN where that is 0 or not known."""
        return 100.0 * error / self.level if self.level > 0 else nan
