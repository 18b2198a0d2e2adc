"""Stages 5 to 8 of a model as records: what all its traces together gave, in a sentence, and trace by trace."""

from collections import Counter
from collections.abc import Sequence
from math import isfinite
from typing import Any

from sim.lab.judge.free_run import TraceOutcome
from sim.lab.judge.stages import Stage
from sim.lab.judge.verdicts import mean, summaries, verdict
from sim.lab.recordings import LoadReport, listed
from sim.sha import shown_unit

Row = dict[str, Any]


def records(label: str, outcomes: Sequence[TraceOutcome]) -> list[Stage]:
    """Stages 5 to 8 of one model. Seconds are those of the work, summed over all processes."""
    stages = []
    for number, summarise in ((5, _processed), (6, _simulated), (7, _compared), (8, _measured)):
        reached = [outcome for outcome in outcomes if number in outcome.seconds or outcome.result.stage == number]
        sentence, rows = summarise(reached)
        stops = (4, 6) if number == 6 else (number,)  # a model refused at stage 4 goes on to the check of the events
        failed = [outcome.result for outcome in reached if outcome.result.failure and outcome.result.stage in stops]
        if failed:
            sentence += f"; {len(failed)} stopped here, the first is {failed[0].trace}: {failed[0].failure}"
        traces = []
        for outcome, row in zip(reached, rows, strict=True):
            result = outcome.result
            key: Row = {"trace": result.trace, "semantics": result.semantics}
            stopped: Row = {"stopped_at": result.stage, "failure": result.failure} if result.failure else {}
            traces.append(key | stopped | row)
        seconds = sum(outcome.seconds.get(number, 0.0) for outcome in outcomes)
        stages.append(Stage(number, label, sentence, seconds, {"traces": traces}))
    return stages


def load_stage(report: LoadReport, seconds: float) -> Stage:
    """What the reading of the trace files gave, for all models together."""
    refused = f", {report.refused} rows refused" if report.refused else ""
    lost = f"; without use: {listed(report.errors, 3)}" if report.errors else ""
    sentence = f"{len(report.files)} files read, {report.used} of {report.rows} rows used{refused}{lost}"
    return Stage(5, "", sentence, seconds, {"files": report.as_table()})


# ----------------------------------- each stage: what all traces together gave, in a sentence, and a row for each trace


def _processed(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
    # A trace that ran under two semantics was read and encoded twice, and counts once.
    traces = {outcome.result.trace: outcome.result for outcome in outcomes if outcome.result.readings}
    readings = sum(result.readings for result in traces.values())
    events = sum(result.events for result in traces.values())
    rows: list[Row] = [
        {
            "rows": outcome.rows,
            "readings": outcome.result.readings,
            "seconds_long": outcome.result.duration,
            "filtered_events": outcome.result.events,
            "full_events": outcome.full,
            "synthetic": outcome.result.synthetic,
        }
        for outcome in outcomes
    ]
    return (
        f"{len(traces)} traces, {readings} readings of the temperature, {events} events in the filtered encoding",
        rows,
    )


def _simulated(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
    accepted = sum(outcome.result.accepted for outcome in outcomes)
    missing = Counter[tuple[str, str]]()
    rows: list[Row] = []
    for outcome in outcomes:
        checked, result = outcome.compatibility, outcome.result
        pairs = checked.pairs if checked else {}
        missing.update(pairs)
        rows.append(
            {
                "accepted": result.accepted,
                "without_edge": checked.missing if checked else 0,
                "missing_edges": {f"{symbol} in {place}": count for (place, symbol), count in pairs.items()},
                "events_without_edge": list(checked.named) if checked else [],
                "simulated_readings": outcome.simulated,
                "clamps": result.clamps,
                "limited": result.limited,
                "flags": list(result.flags),
            }
        )
    sentence = f"every event has an edge in {accepted} of {len(outcomes)} runs along traces"
    if missing:
        most = [f"{symbol!r} in {place!r} ({count} x)" for (place, symbol), count in missing.most_common(3)]
        sentence += f"; no edge for {', '.join(most)}{' and others' if len(missing) > 3 else ''}"
    simulated = sum(outcome.simulated for outcome in outcomes)
    return f"{sentence}; simulated at {simulated} readings", rows


def _compared(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
    parts = []
    for semantics in dict.fromkeys(outcome.result.semantics for outcome in outcomes):
        own = [outcome for outcome in outcomes if outcome.result.semantics == semantics and not outcome.result.failure]
        if own:
            sparse = mean(outcome.result.at_events.mae for outcome in own)
            dense = mean(outcome.result.dense.mae for outcome in own)
            apart = max(outcome.comparison.apart for outcome in own)
            unit = shown_unit(own[0].result.unit)
            parts.append(
                f"{semantics}: mean MAE {sparse:.3f} {unit} at the filtered events (sparse), {dense:.3f} {unit} at all "
                f"readings under the full encoding (dense), courses up to {apart:.3g} {unit} apart"
            )
    rows: list[Row] = [
        {
            "sparse_at_events": outcome.result.at_events,
            "sparse_at_readings": outcome.result.at_samples,
            "dense_at_readings": outcome.result.dense,
            "dense": outcome.comparison,
        }
        for outcome in outcomes
    ]
    return "; ".join(parts) or "nothing to compare", rows


def _measured(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
    parts = []
    for each in summaries(outcome.result for outcome in outcomes if not outcome.result.failure):
        # A last reading of 0 has no error in per cent.
        unit = shown_unit(each.unit)
        percent = f"{each.final_percent:.1f} %" if isfinite(each.final_percent) else "–"
        parts.append(
            f"{each.semantics}: MAE {each.mae:.3f} {unit}, RMSE {each.rmse:.3f} {unit}, final {each.final:.3f} {unit} "
            f"({percent}), coverage {each.coverage:.0%}, CRPS {each.crps:.3f} {unit}; "
            f"better than persistence ({each.persistence:.2f} {unit}) on {each.better} of {each.scored}"
        )
    names = ("final_error", "final_percent", "at_events", "at_samples", "mae", "rmse", "max_error", "error_sigma")
    more = ("coverage", "crps", "beyond", "persistence", "clamps", "error_quantiles")
    rows: list[Row] = []
    for outcome in outcomes:
        judged = verdict(outcome.result)
        figures = {name: getattr(outcome.result, name) for name in (*names, *more)}
        rows.append(figures | {"verdict": judged.word, "reasons": list(judged.reasons)})
    return "; ".join(parts) or "no figures", rows
