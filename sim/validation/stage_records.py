"""Stages 5 to 8 of a model as records: what all its traces together gave, in a sentence, and trace by trace."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from sim.traces import LoadReport, listed
from sim.validation.results import TraceResult
from sim.validation.stages import Stage
from sim.validation.trace_run import TraceOutcome
from sim.validation.verdicts import mean, summaries, verdict

Row = Mapping[str, Any]


def records(label: str, outcomes: Sequence[TraceOutcome]) -> list[Stage]:
    """Stages 5 to 8 of one model. Seconds are those of the work, summed over all processes."""
    made = []
    for number, sentence, row in (
        (5, _processed, _processed_row),
        (6, _simulated, _simulated_row),
        (7, _compared, _compared_row),
        (8, _measured, _measured_row),
    ):
        reached = [one for one in outcomes if number in one.seconds or one.result.stage == number]
        seconds = sum(one.seconds.get(number, 0.0) for one in outcomes)
        details = {"traces": [_key(one.result) | dict(row(one)) for one in reached]}
        made.append(Stage(number, label, _with_failures(number, sentence(reached), reached), seconds, details))
    return made


def load_stage(report: LoadReport, seconds: float) -> Stage:
    """What the reading of the trace files gave, for all models together."""
    refused = f", {report.refused} rows refused" if report.refused else ""
    lost = f"; without use: {listed(report.errors, 3)}" if report.errors else ""
    sentence = f"{len(report.files)} files read, {report.used} of {report.rows} rows used{refused}{lost}"
    return Stage(5, "", sentence, seconds, {"files": report.as_table()})


def _key(result: TraceResult) -> dict[str, Any]:
    key = {"trace": result.trace, "semantics": result.semantics}
    return key | ({"stopped_at": result.stage, "failure": result.failure} if result.failure else {})


def _with_failures(number: int, sentence: str, reached: Sequence[TraceOutcome]) -> str:
    here = (4, 6) if number == 6 else (number,)  # a model refused at stage 4 goes as far as the check of the events
    failed = [one.result for one in reached if one.result.failure and one.result.stage in here]
    if not failed:
        return sentence
    return f"{sentence}; {len(failed)} stopped here, the first is {failed[0].trace}: {failed[0].failure}"


def _processed(outcomes: Sequence[TraceOutcome]) -> str:
    traces = {one.result.trace: one for one in outcomes if one.result.readings}
    readings = sum(one.result.readings for one in traces.values())
    events = sum(one.result.events for one in traces.values())
    return f"{len(traces)} traces, {readings} readings of the temperature, {events} events in the filtered encoding"


def _processed_row(outcome: TraceOutcome) -> Row:
    result = outcome.result
    return {
        "rows": outcome.rows,
        "readings": result.readings,
        "seconds_long": result.duration,
        "filtered_events": result.events,
        "full_events": outcome.full,
        "synthetic": result.synthetic,
    }


def _simulated(outcomes: Sequence[TraceOutcome]) -> str:
    accepted = sum(one.result.accepted for one in outcomes)
    pairs = Counter[tuple[str, str]]()
    for one in outcomes:
        pairs.update(one.compatibility.pairs if one.compatibility else {})
    said = f"every event has an edge in {accepted} of {len(outcomes)} runs along traces"
    if pairs:
        most = [f"{symbol!r} in {place!r} ({count} x)" for (place, symbol), count in pairs.most_common(3)]
        said += f"; no edge for {', '.join(most)}{' and others' if len(pairs) > 3 else ''}"
    simulated = sum(one.simulated for one in outcomes)
    return f"{said}; simulated at {simulated} readings"


def _simulated_row(outcome: TraceOutcome) -> Row:
    checked, result = outcome.compatibility, outcome.result
    missing = {f"{symbol} in {place}": count for (place, symbol), count in checked.pairs.items()} if checked else {}
    return {
        "accepted": result.accepted,
        "without_edge": checked.missing if checked else 0,
        "missing_edges": missing,
        "events_without_edge": list(checked.named) if checked else [],
        "simulated_readings": outcome.simulated,
        "clamps": result.clamps,
        "limited": result.limited,
        "flags": list(result.flags),
    }


def _compared(outcomes: Sequence[TraceOutcome]) -> str:
    said = []
    for semantics in dict.fromkeys(one.result.semantics for one in outcomes):
        done = [one for one in outcomes if one.result.semantics == semantics and not one.result.failure]
        if done:
            sparse = mean(one.result.at_events.mae for one in done)
            dense = mean(one.result.dense.mae for one in done)
            apart = max(one.comparison.apart for one in done)
            said.append(
                f"{semantics}: mean MAE {sparse:.3f} °C at the filtered events (sparse), {dense:.3f} °C at all "
                f"readings under the full encoding (dense), courses up to {apart:.3g} °C apart"
            )
    return "; ".join(said) or "nothing to compare"


def _compared_row(outcome: TraceOutcome) -> Row:
    result = outcome.result
    return {
        "sparse_at_events": result.at_events,
        "sparse_at_readings": result.at_samples,
        "dense_at_readings": result.dense,
        "dense": outcome.comparison,
    }


def _measured(outcomes: Sequence[TraceOutcome]) -> str:
    done = [one.result for one in outcomes if not one.result.failure]
    return "; ".join(_summed(done)) if done else "no figures"


def _summed(results: Sequence[TraceResult]) -> list[str]:
    return [
        f"{one.semantics}: MAE {one.mae:.3f} °C, RMSE {one.rmse:.3f} °C, final {one.final:.3f} °C "
        f"({one.final_percent:.1f} %), coverage {one.coverage:.0%}, CRPS {one.crps:.3f} °C; "
        f"better than persistence ({one.persistence:.2f} °C) on {one.better} of {one.scored}"
        for one in summaries(results)
    ]


def _measured_row(outcome: TraceOutcome) -> Row:
    result, judged = outcome.result, verdict(outcome.result)
    names = ("final_error", "final_percent", "at_events", "at_samples", "mae", "rmse", "max_error", "error_sigma")
    more = ("coverage", "crps", "beyond", "persistence", "clamps", "error_quantiles")
    figures = {name: getattr(result, name) for name in (*names, *more)}
    return figures | {"verdict": judged.word, "reasons": list(judged.reasons)}
