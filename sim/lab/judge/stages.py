"""The nine stages by number and name, and what each leaves behind: from files to a model, then records of traces."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from sim.effects import check_sha
from sim.lab.formats import FoundModel, find_model
from sim.lab.judge.discovery import CrossCheck, Discovery, cross_check, discover, own_check, read_own_report
from sim.lab.judge.free_run import TraceOutcome
from sim.lab.judge.semantics import CARRIED, RESAMPLED, model_semantics, side_by_side
from sim.lab.judge.verdicts import mean, summaries, verdict
from sim.lab.recordings import LoadReport, list_names
from sim.sha import (
    Alphabet,
    Location,
    Model,
    Provenance,
    Trace,
    alphabet_symbols,
    display_unit,
    distributions,
    transitions,
)

STAGES: Mapping[int, str] = {
    1: "discovery",
    2: "parsing",
    3: "distributions and flows",
    4: "model generation",
    5: "trace processing",
    6: "compatibility and simulation",
    7: "comparison",
    8: "metrics",
    9: "pictures and report",
}
Wanted = Literal["written", "carried", "resampled", "both"]
"""Which semantics to run: the one that the model is written in, one of the two, or both side by side."""


@dataclass(slots=True)
class Stage:
    """One stage of one model: a sentence about what was found, the seconds it took, and plain values for its file.

    `model` is empty where a stage is that of all models together.
    """

    number: int
    model: str
    found: str = ""
    seconds: float = 0.0
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The stage's name."""
        return STAGES[self.number]

    @property
    def line(self) -> str:
        """For the log."""
        whose = f"{self.model}: " if self.model else ""
        return f"{self.number} {self.name:<28} {self.seconds:7.2f} s  {whose}{self.found}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A model after its first four stages. `variants` are what is simulated, by semantics; empty when nothing can be.

    `structure` has the automaton for the compatibility of traces, whether it can be run or not; `refusals` say, by
    semantics (empty for all), why nothing is simulated; `check` is that of stage 3, None without artefacts.
    """

    label: str
    where: str
    parsed: FoundModel
    structure: Model
    variants: Mapping[str, Model]
    refusals: Mapping[str, str]
    stages: tuple[Stage, ...]
    discovery: Discovery
    check: CrossCheck | None = None


@contextmanager
def time_stage(stage: Stage) -> Iterator[Stage]:
    """The block's seconds are the stage's."""
    begin = perf_counter()
    try:
        yield stage
    finally:
        stage.seconds += perf_counter() - begin


def prepare(
    where: str,
    alphabet: Alphabet,
    temperature: str,
    *,
    wanted: Wanted = "written",
    training: Sequence[Trace] | None = None,
    seed: int = 0,
) -> Prepared:
    """Stages 1 to 4 of the model under `where`, an argument of `find_model`.

    `alphabet` and `temperature` are the column map's, for models that have none of their own. Raises ArtefactError
    where files are missing or cannot be read; an automaton that is read but cannot be run is refused in `refusals`.
    """
    discovering, parsing, checking, generating = stages = tuple(Stage(number, "") for number in (1, 2, 3, 4))
    with time_stage(discovering):
        discovery = discover(where)
        discovering.found = discovery.sentence
        discovering.details = {
            "where": where,
            "kind": discovery.kind,
            "directory": str(discovery.directory),
            "files": [{"file": file.name, "bytes": file.size, "sha256": file.sha256} for file in discovery.files],
            "absent": list(discovery.absent),
        }
    with time_stage(parsing):
        parsed = find_model(where, alphabet=alphabet, temperature=temperature)
        sha = parsed.structure
        names = [location.name for location in sha.locations]
        edges = [{"source": edge.source, "symbol": edge.symbol, "target": edge.target} for edge in sha.edges]
        symbols = sorted({edge.symbol for edge in sha.edges})
        parsing.found = f"{len(names)} locations, {len(edges)} edges, {len(symbols)} symbols, start {sha.initial}"
        parsing.details = {"initial": sha.initial, "locations": names, "symbols": symbols, "edges": edges}
    with time_stage(checking):
        if parsed.artefacts:
            check: CrossCheck | None = cross_check(parsed.artefacts)
        else:
            beside = read_own_report(discovery)
            check = own_check(*beside, parsed.model) if beside and parsed.model else None
        checked = check.sentence if check else "no artefacts with reported distributions"
        checking.details = {"cross_check": check, "notes": list(parsed.notes)}
        if parsed.model is None:
            # There are no flows yet, only what the flow file says; why they cannot be run is told at stage 4.
            equations = parsed.artefacts.flows.equations if parsed.artefacts and parsed.artefacts.flows else {}
            written = {str(number): equation.text for number, equation in equations.items()}
            checking.found = f"{len(written)} flow equations; {checked}"
            checking.details = {**checking.details, "equations": written}
        else:
            rows = [location_row(location) for location in parsed.model.sha.locations]
            checking.found = f"flows {', '.join(sorted({row['flow'] for row in rows}))}; {checked}"
            checking.details = {**checking.details, "locations": rows}
    with time_stage(generating):
        bare = Model(parsed.structure, Alphabet(()), temperature, 0.0, provenance=Provenance(method="artefacts"))
        structure = _with_alphabet(parsed.model or bare, alphabet)
        variants, refusals = _variants(parsed, structure, wanted, training, seed)
        sentences, models = [], {}
        for name, model in variants.items():
            laws = model.provenance.settings.get("entry_laws", "")
            sentences.append(f"runs as {name}{f' (entry laws from {laws})' if laws else ''}")
            models[name] = {
                "temperature": model.temperature,
                "sensor_sigma": model.sensor_sigma,
                "method": model.provenance.method,
                "synthetic": model.provenance.synthetic,
                "training_traces": list(model.provenance.traces),
                "data_hash": model.provenance.data_hash,
                "limits": {"low": model.sha.low, "high": model.sha.high, "max_rate": model.sha.max_rate},
                "entry_laws": laws,
                "locations": [location_row(location) for location in model.sha.locations],
            }
        for name, reason in refusals.items():
            sentences.append(f"not simulated{f' as {name}' if name else ''}: {reason}")
        generating.found = "; ".join(sentences)
        generating.details = {"variants": models, "refusals": dict(refusals), "notes": list(parsed.notes)}
    for stage in stages:
        stage.model = parsed.name
    return Prepared(
        label=parsed.name,
        where=where,
        parsed=parsed,
        structure=structure,
        variants=variants,
        refusals=refusals,
        stages=stages,
        discovery=discovery,
        check=check,
    )


def distinct_labels(prepared: Sequence[Prepared]) -> list[Prepared]:
    """The same with labels that differ: a name that several models share gets the end of its path, then a number."""
    names = [model.label for model in prepared]
    done: list[Prepared] = []
    for model in prepared:
        label = model.label if names.count(model.label) == 1 else f"{model.label} ({Path(model.where).name})"
        number, first = 2, label
        # Whatever their case: a label becomes a folder, and some file systems do not tell the two apart.
        while label.casefold() in {other.label.casefold() for other in done}:
            label, number = f"{first} {number}", number + 1
        for stage in model.stages:
            stage.model = label
        done.append(replace(model, label=label))
    return done


def location_row(location: Location) -> dict[str, Any]:
    """A location as plain values: flow with its constants, law, entry mode."""
    law = location.distribution
    return {
        "location": location.name,
        "flow": location.flow.kind,
        "constants": dict(location.flow.params),
        "inputs": [driver.signal for driver in location.flow.inputs],
        "law": law.kind if law else "",
        "mean": distributions.mean(law) if law else None,
        "sigma": distributions.variance(law) ** 0.5 if law else None,
        "entry": location.entry,
    }


def _with_alphabet(model: Model, alphabet: Alphabet) -> Model:
    """The model with an alphabet: its own, else the map's. Edges that bear UPPAAL's channel names get the symbols."""
    model = model if model.alphabet.channels else replace(model, alphabet=alphabet)
    known, spoken = set(alphabet_symbols(model.alphabet)), {edge.symbol for edge in model.sha.edges}
    symbol_of = {channel: symbol for symbol, channel in model.alphabet.uppaal if channel not in known}
    if not spoken & set(symbol_of):
        return model
    edges = tuple(replace(edge, symbol=symbol_of.get(edge.symbol, edge.symbol)) for edge in model.sha.edges)
    return replace(model, sha=replace(model.sha, edges=edges))


def _variants(
    parsed: FoundModel, model: Model, wanted: Wanted, training: Sequence[Trace] | None, seed: int
) -> tuple[dict[str, Model], dict[str, str]]:
    """The models to run by semantics, and why others are not."""
    if parsed.refusal:
        return {}, {"": parsed.refusal}
    try:
        transitions(model.sha)
        check_sha(model.sha)
    except ValueError as error:
        return {}, {"": str(error)}
    written = model_semantics(model)
    if wanted in ("written", written):
        return {written: model}, {}
    try:
        both = side_by_side(model, training, seed=seed)
    except ValueError as error:
        other = CARRIED if written == RESAMPLED else RESAMPLED
        return ({written: model} if wanted == "both" else {}), {other: str(error)}
    return {name: each for name, each in both.items() if wanted in ("both", name)}, {}


Row = dict[str, Any]


def records(label: str, outcomes: Sequence[TraceOutcome]) -> list[Stage]:
    """Stages 5 to 8 of one model. Seconds are those of the work, summed over all processes."""
    stages = []
    for number, summarise in ((5, _process_stage), (6, _simulate_stage), (7, _compare_stage), (8, _measure_stage)):
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
    lost = f"; without use: {list_names(report.errors, 3)}" if report.errors else ""
    sentence = f"{len(report.files)} files read, {report.used} of {report.rows} rows used{refused}{lost}"
    return Stage(5, "", sentence, seconds, {"files": report.as_table()})


# ----------------------------------- each stage: what all traces together gave, in a sentence, and a row for each trace


def _process_stage(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
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


def _simulate_stage(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
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


def _compare_stage(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
    parts = []
    for semantics in dict.fromkeys(outcome.result.semantics for outcome in outcomes):
        own = [outcome for outcome in outcomes if outcome.result.semantics == semantics and not outcome.result.failure]
        if own:
            sparse = mean(outcome.result.at_events.mae for outcome in own)
            dense = mean(outcome.result.dense.mae for outcome in own)
            apart = max(outcome.comparison.apart for outcome in own)
            unit = display_unit(own[0].result.unit)
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


def _measure_stage(outcomes: Sequence[TraceOutcome]) -> tuple[str, list[Row]]:
    parts = []
    for each in summaries(outcome.result for outcome in outcomes if not outcome.result.failure):
        # A last reading of 0 has no error in per cent.
        unit = display_unit(each.unit)
        percent = f"{each.final_percent:.1f} %" if isfinite(each.final_percent) else "–"
        parts.append(
            f"{each.semantics}: MAE {each.mae:.3f}{_plus_minus(each.mae_sigma)} {unit}, RMSE {each.rmse:.3f} {unit}, "
            f"final {each.final:.3f}{_plus_minus(each.final_sigma)} {unit} "
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


def _plus_minus(sigma: float) -> str:
    return f" ± {sigma:.3f}" if isfinite(sigma) else ""
