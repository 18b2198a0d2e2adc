"""A ranking for the command line: results of a fresh campaign or of an earlier one, and what is known of the models."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sim.ranking.fitness import Facts, Seen, seen_traces
from sim.ranking.ranking import entrants
from sim.sha.model import Model
from sim.sha.trace import Trace
from sim.traces.column_map import load_map
from sim.traces.traces import load_traces
from sim.validation.campaign import Progress, outcomes_by_model, run_here, unread
from sim.validation.output_folder import CAMPAIGN, read_results
from sim.validation.results import TraceResult
from sim.validation.stages import Prepared, Wanted, prepare, relabelled
from sim.validation.trace_run import TraceRunSettings

GENERATION = "04_model_generation.json"


@dataclass(frozen=True, slots=True)
class Compared:
    """What is ranked: the results, and what is known of each model beside them, by entrant."""

    results: list[TraceResult]
    facts: dict[str, Facts]


@dataclass(frozen=True, slots=True)
class Campaign:
    """What to compare: `models` along the traces of `paths`, or the results in `folders` (with models at hand)."""

    models: Sequence[str]
    paths: Sequence[str]
    folders: Sequence[Path]
    map_file: Path
    wanted: Wanted
    training: Sequence[str]
    runs: int
    jobs: int | None
    seed: int


def compared(wish: Campaign, progress: Progress) -> Compared:
    """Runs every model along every trace, or reads what an earlier campaign found.

    Raises ValueError or OSError for what cannot be read, and for a model at hand that has no results in the folders.
    """
    return _earlier(wish) if wish.folders else _fresh(wish, progress)


def _fresh(wish: Campaign, progress: Progress) -> Compared:
    column_map = load_map(wish.map_file)
    traces, report = load_traces(list(wish.paths), column_map)
    training = load_traces(list(wish.training), column_map)[0] if wish.training else None
    prepared = _prepared(wish, training)
    run = run_here(wish.jobs or len(os.sched_getaffinity(0)))
    settings = TraceRunSettings(wish.runs, seed=wish.seed)
    told = outcomes_by_model(
        prepared, traces, without=unread(report, traces), settings=settings, run=run, progress=progress
    )
    results = [outcome.result for _, outcomes in told for outcome in outcomes]
    return Compared(results, _by_entrant(results, {one.label: _facts(one, traces) for one in prepared}))


def _prepared(wish: Campaign, training: Sequence[Trace] | None) -> list[Prepared]:
    column_map = load_map(wish.map_file)
    alphabet, temperature = column_map.alphabet, column_map.temperature
    return relabelled(
        [
            prepare(where, alphabet, temperature, wanted=wish.wanted, training=training, seed=wish.seed)
            for where in wish.models
        ]
    )


def _earlier(wish: Campaign) -> Compared:
    """The results of the folders, with what their records say; a model at hand is that of the results with its name."""
    results = [result for folder in wish.folders for result in read_results(folder)]
    names, labels = {result.trace for result in results}, sorted({result.model for result in results})
    facts: dict[str, dict[str, Facts]] = {}
    for folder in wish.folders:
        facts |= _recorded(folder if folder.is_dir() else folder.parent, names)
    for one in _prepared(wish, None):
        if one.label not in labels:
            raise ValueError(
                f"{one.where}: the results have no model {one.label!r}; they have {', '.join(labels) or 'none'}"
            )
        facts[one.label] = _joined(facts.get(one.label, {}), one, names)
    return Compared(results, _by_entrant(results, facts))


def _joined(recorded: Mapping[str, Facts], at_hand: Prepared, names: Iterable[str]) -> dict[str, Facts]:
    """What the records say of each semantics, with the gate's word on the model at hand."""
    found = {}
    for semantics, model in at_hand.variants.items():
        own = _origin(model, {name: "name" for name in names if name in model.provenance.traces})
        verified, gate = gate_of(model)
        found[semantics] = replace(own, verified=verified, gate=gate)
    said = next(iter(found.values()), Facts(verified=False, gate="; ".join(at_hand.refusals.values())))
    others = {name: replace(each, verified=said.verified, gate=said.gate) for name, each in recorded.items()}
    return {**others, **found}


def gate_of(model: Model) -> tuple[bool, str]:
    """Whether verification lets the model be deployed, and the sentence that says so."""
    from sim.checking.proof.verify import verify

    found = verify(model)
    if found.deployable:
        return True, f"verified: {len([check for check in found.checks if check.blocking])} blocking checks are proven"
    return False, "; ".join(found.reasons)


def _by_entrant(results: Sequence[TraceResult], facts: Mapping[str, Mapping[str, Facts]]) -> dict[str, Facts]:
    """Facts by model and semantics become facts by entrant."""
    found = {}
    for name, own in entrants(results).items():
        result = next(iter(own.values()))
        known = facts.get(result.model, {})
        if result.semantics in known:
            found[name] = known[result.semantics]
        elif "" in known:
            found[name] = known[""]
    return found


def _facts(prepared: Prepared, traces: Sequence[Trace]) -> dict[str, Facts]:
    """What a model at hand says of itself, by semantics; a model that cannot be run fails the gate."""
    found = {"": Facts(verified=False, gate="; ".join(prepared.refusals.values()))}
    for semantics, model in prepared.variants.items():
        verified, gate = gate_of(model)
        found[semantics] = replace(_origin(model, seen_traces(model, traces)), verified=verified, gate=gate)
    return found


def _origin(model: Model, seen: Mapping[str, Seen]) -> Facts:
    """Artefacts and models by hand do not say what they were learned from."""
    known = bool(model.provenance.data_hash or model.provenance.traces)
    return Facts(synthetic=model.provenance.synthetic if known else None, seen=seen)


def _recorded(folder: Path, names: Iterable[str]) -> dict[str, dict[str, Facts]]:
    """What a campaign's records say of its models, by label and semantics; a missing or odd record says nothing."""
    found: dict[str, dict[str, Facts]] = {}
    for label, place in _document(folder / CAMPAIGN).get("folders", {}).items():
        variants = _document(folder / place / GENERATION).get("variants", {})
        found[label] = {semantics: _fact(row, names) for semantics, row in variants.items()}
    return found


def _fact(row: Mapping[str, Any], names: Iterable[str]) -> Facts:
    trained = set(row.get("training_traces", ()))
    known = bool(row.get("data_hash") or trained)
    seen: dict[str, Seen] = {name: "name" for name in names if name in trained}
    return Facts(synthetic=bool(row.get("synthetic")) if known else None, seen=seen)


def _document(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}
