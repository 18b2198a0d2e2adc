"""How right the predictions were, from the historian alone: errors, forecasts against persistence, what was written."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from gateway.store.nearest_rank import percentile
from gateway.store.read_back import (
    Matured,
    history,
    machines,
    mature_forecasts,
    newest_scan,
    reading,
    row_number,
    stored_rows,
)
from sim.scores import coverage, crps_quantiles
from sim.sha import Array, Mask


@dataclass(frozen=True, slots=True)
class Error:
    """Root mean square and mean absolute error (degC) over `count` readings; NaN without any."""

    rmse: float
    mae: float
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonScore:
    """The forecasts for one `horizon` (s) that have matured: mean absolute error of the median and of persistence
    (the reading when it was made), mean CRPS (degC), share of readings inside the 90 % band, their `count`."""

    horizon: float
    mae: float
    persistence_mae: float
    crps: float
    coverage90: float
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StartScore:
    """The `forecasts` that were made from `begin` to `end` (s) after the machine's start, one score a horizon; an `end`
    of None is open, and a `begin` of None is at rest."""

    begin: float | None
    end: float | None
    forecasts: tuple[HorizonScore, ...]


@dataclass(frozen=True, slots=True)
class WriteScore:
    """Blocks by verdict, and the latency (ms, real time) from a scan's last reply to the confirmed write."""

    verdicts: dict[str, int]
    p50: float
    p99: float


@dataclass(frozen=True, slots=True)
class Scorecard:
    """`scans` and `samples` (kept) and `events` are counts; `free_run` and `one_step` the errors of the two ways to
    predict; `forecasts` one score a horizon, ascending; `guards` what the model's guards last said: reviews, clamps;
    `by_location` the errors one step ahead while the model was in each location; `by_start` the forecasts by the time
    since the machine's start, none where it is not known in which locations it runs."""

    scans: int
    samples: int
    events: int
    free_run: Error
    one_step: Error
    band90: float
    forecasts: tuple[HorizonScore, ...]
    writes: WriteScore
    guards: Mapping[str, Any] = field(default_factory=dict)
    by_location: Mapping[str, Error] = field(default_factory=dict)
    by_start: tuple[StartScore, ...] = ()


def scorecard(
    path: Path,
    *,
    machine: str | None = None,
    temperature: str | None = None,
    start: float = -inf,
    end: float = inf,
    runs: Mapping[str, bool | None] | None = None,
) -> Scorecard:
    """The scores of a followed `temperature` of a machine in the historian at `path`, and of its scans and samples.

    None is the only machine, the first temperature that is followed on it. The predictions, forecasts and writes are
    those from `start` to `end` (s UTC); the counts are of the whole file. `runs` says of a model's locations whether
    the machine runs in them (None: either). Raises HistorianError.
    """
    with reading(path) as connection:
        counts = {table: row_number(connection, table, machine=machine) for table in ("scans", "samples")}
        counts["events"] = row_number(connection, "events", machine=machine, temperature=temperature)
        columns = ("time", "verdict", "latency_ms")
        writes = stored_rows(connection, "writes", columns, start, end, machine=machine, temperature=temperature)
        verdicts = dict(Counter(str(verdict) for _, verdict, _ in writes))
        latencies = [float(latency) for _, _, latency in writes if latency is not None]
        # A file of an earlier gateway has no such table, and a run without a model no report in it.
        guards: dict[str, Any] = {}
        if connection.execute("SELECT count(*) FROM sqlite_master WHERE name = 'guards'").fetchone()[0]:
            reports = stored_rows(connection, "guards", ("time", "content"), machine=machine, temperature=temperature)
            guards = json.loads(reports[-1][1]) or {} if reports else {}
    seen = history(path, start, end, machine=machine, temperature=temperature)
    forecasts = mature_forecasts(path, machine=machine, temperature=temperature, start=start, end=end)
    places = np.array(seen.locations)
    known = np.isfinite(seen.mean) & np.isfinite(seen.measured)
    band90 = coverage(seen.low[known], seen.high[known], seen.measured[known]) if known.any() else nan
    return Scorecard(
        scans=counts["scans"],
        samples=counts["samples"],
        events=counts["events"],
        free_run=error(seen.free_run, seen.measured),
        one_step=error(seen.mean, seen.measured),
        band90=band90,
        forecasts=tuple(_horizon_score(one) for _, one in sorted(forecasts.items())),
        writes=WriteScore(verdicts, percentile(latencies, 0.5), percentile(latencies, 0.99)),
        guards=guards,
        by_location={
            name: error(seen.mean[here], seen.measured[here])
            for name in dict.fromkeys(seen.locations)
            if (here := places == name).any()
        },
        by_start=_scores_since_start(seen.times, seen.locations, forecasts, runs) if runs else (),
    )


START_BOUNDS_S = (0.0, 180.0, 600.0, 1800.0)
"""Where the classes of the time since a start begin: those of the laboratory's judge of forecasts."""
LEAST_GAP_S, GAP_SCANS = 60.0, 10.0
"""How long nothing was predicted, at least and in usual steps, for a start meanwhile to have been missed."""


def time_since_start(times: Array, locations: Sequence[str], runs: Mapping[str, bool | None]) -> Array:
    """Seconds since the machine's last start at each of some ascending times; -inf at rest, NaN where it is not known:
    before the first start, and after what may hide one, a gap or a location of another model than that of `runs`.

    A location in which the machine either runs or rests (None) changes nothing.
    """
    if not times.size:
        return np.empty(0)
    steps, order = np.diff(times, prepend=-inf), np.arange(times.size)
    longest = max(LEAST_GAP_S, GAP_SCANS * float(np.median(steps[1:]))) if times.size > 1 else 0.0
    fresh = (steps > longest) | np.array([location not in runs for location in locations])
    state = np.array([runs.get(location) for location in locations], dtype=float)
    state = state[np.maximum.accumulate(np.where(np.isfinite(state) | fresh, order, 0))]
    starts = ~fresh & (state == 1.0) & (np.roll(state, 1) == 0.0)
    last = np.maximum.accumulate(np.where(starts | fresh, order, 0))
    running = np.where(starts[last], times - times[last], nan)
    return np.where(state == 0.0, -inf, np.where(state == 1.0, running, nan))


def _scores_since_start(
    times: Array, locations: Sequence[str], forecasts: Mapping[float, Matured], runs: Mapping[str, bool | None]
) -> tuple[StartScore, ...]:
    if all(each is None for each in runs.values()):
        return ()
    since = time_since_start(times, locations, runs)
    classes = ((None, None), *pairwise((*START_BOUNDS_S, None)))
    found: dict[tuple[float | None, float | None], list[HorizonScore]] = {each: [] for each in classes}
    for _, one in sorted(forecasts.items()):
        place = np.searchsorted(times, one.times, side="right") - 1
        own = np.where(place >= 0, np.append(since, nan)[place], nan)
        for begin, end in classes:
            here = own == -inf if begin is None else (own >= begin) & (own < (inf if end is None else end))
            if here.any():
                found[begin, end].append(_horizon_score(_select(one, here)))
    return tuple(StartScore(begin=b, end=e, forecasts=tuple(scores)) for (b, e), scores in found.items() if scores)


def _select(forecasts: Matured, here: Mask) -> Matured:
    parts = ("times", "quantiles", "p_limit", "persistence", "outcome")
    return replace(forecasts, **{name: getattr(forecasts, name)[here] for name in parts})


@dataclass(frozen=True, slots=True, kw_only=True)
class WarningScore:
    """What came of the warnings that a temperature will reach its limit: `hits` that it did within the longest horizon,
    `false_alarms` that it did not, `misses` that it did without one. `lead` is the median time (s) from a hit's warning
    to the limit; NaN without any."""

    hits: int
    misses: int
    false_alarms: int
    lead: float


def warning_score(
    path: Path, *, machine: str | None = None, temperature: str | None = None, start: float = -inf, end: float = inf
) -> WarningScore:
    """The warnings from `start` to `end` (s UTC) held against the threshold alarm. Raises HistorianError.

    Where somebody heeds a warning, and the limit is not reached for that, it counts as false: the records do not know.
    """
    with reading(path) as connection:
        columns = ("time", "condition", "tag", "state")
        rows = sorted(stored_rows(connection, "alarms", columns, machine=machine), key=lambda row: row[0])
        horizons = stored_rows(
            connection, "forecasts", ("time", "horizon"), start, end, machine=machine, temperature=temperature
        )
        last = newest_scan(connection, machine=machine)
        followed = dict(machines(connection))
    longest = max((horizon for _, horizon in horizons), default=0.0)
    # Without a name it is the only machine, as in all that was read above.
    own = followed.get(machine, []) if machine is not None else next(iter(followed.values()), [])
    tag = temperature or next(iter(own), "")
    raised = [row for row in rows if row[3] == "unacknowledged" and row[2] == tag]
    warned = [row[0] for row in raised if row[1].startswith("predicted over limit")]
    reached = [row[0] for row in raised if row[1].startswith("over limit")]
    leads, false_alarms = [], 0
    for time in warned:
        after = next((other - time for other in reached if time < other <= time + longest), None)
        if start <= time < end and after is not None:
            leads.append(after)
        elif start <= time < end and last is not None and last >= time + longest:
            false_alarms += 1
    misses = sum(
        start <= time < end and not any(time - longest <= other < time for other in warned) for time in reached
    )
    return WarningScore(hits=len(leads), misses=misses, false_alarms=false_alarms, lead=percentile(leads, 0.5))


def error(predicted: Array, measured: Array) -> Error:
    """The error where both are known."""
    gap = (predicted - measured)[np.isfinite(predicted) & np.isfinite(measured)]
    if not gap.size:
        return Error(nan, nan, 0)
    return Error(float(np.sqrt(np.mean(gap**2))), float(np.mean(np.abs(gap))), int(gap.size))


def _horizon_score(forecasts: Matured) -> HorizonScore:
    f = forecasts
    # The same forecasts for both: those that began without a reading have no persistence to be held against.
    came = np.isfinite(f.outcome) & np.isfinite(f.persistence)
    if not came.any():
        return HorizonScore(horizon=f.horizon, mae=nan, persistence_mae=nan, crps=nan, coverage90=nan, count=0)
    outcome, quantiles = f.outcome[came], f.quantiles[came]
    low, median, high = (quantiles[:, f.levels.index(level)] for level in (0.05, 0.5, 0.95))
    return HorizonScore(
        horizon=f.horizon,
        mae=float(np.mean(np.abs(median - outcome))),
        persistence_mae=float(np.mean(np.abs(f.persistence[came] - outcome))),
        crps=float(np.mean(crps_quantiles(f.levels, quantiles, outcome))),
        coverage90=coverage(low, high, outcome),
        count=int(came.sum()),
    )
