"""`decanter diagnose`: where model and measurement disagree, which effect is missing, and the model that has it."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click

from gateway.console import (
    CommandResult,
    Part,
    Rows,
    conclude,
    progress,
    shipped_file,
)
from gateway.entry import sentences
from gateway.lab.models.propose import propose, recorded_drift, require_store
from gateway.lab.traces.load import load
from gateway.store import reading, recent
from sim.artefacts import model_hash, read_effect_lines
from sim.effects import parameter_words, usual_roles
from sim.lab.discrepancy import (
    Diagnosis,
    DiagnosisOutcome,
    ProposedExperiment,
    advice_lines,
    augment_model,
    experiment_lines,
    held_out_sentence,
    law_sentence,
    overlap_sentence,
    propose_experiment,
    span,
)
from sim.lab.discrepancy import diagnose as diagnose_model
from sim.lab.discrepancy.fitting import find_overlap, patiently
from sim.lab.discrepancy.output import MISSING_HEAT_FILE, MODEL, Occasion, check_folder, document, write_diagnosis
from sim.lab.formats import find_model
from sim.lab.recordings import ColumnMap, load_map, write_trace
from sim.proof import verify
from sim.sha import EffectLine, Model, Trace, display_unit, joint_hash

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisRequest:
    """What is to be diagnosed, and where the result goes. `created` is the time for the report, in seconds UTC.

    `source` says where the traces are from, as it stands in the report; `most` is how many effects may be named.
    Without `report` there are no page and no pictures. `lines` are effects of the engineer's own that may be named too.
    With `experiment` the experiment is proposed that tells rivals apart.
    """

    where: str
    out: Path
    source: str
    seed: int
    most: int
    created: float
    temperature: str | None = None
    report: bool = True
    lines: tuple[EffectLine, ...] = ()
    experiment: bool = False


@dataclass(frozen=True, slots=True)
class DiagnosisResult:
    """What came out: the diagnosis as it was written, the new model, and why that is not deployable (None, None: there
    is none)."""

    diagnosis: Diagnosis
    model: Model | None
    verification: tuple[str, ...] | None


def require_model(request: DiagnosisRequest, column_map: ColumnMap) -> Model:
    """The model to be diagnosed. Raises ValueError where there is none, or `request.out` cannot take the result."""
    check_folder(request.out, Path(request.where))
    temperature = request.temperature or column_map.temperature
    model = find_model(request.where, alphabet=column_map.alphabet, temperature=temperature).runnable()
    if request.temperature not in (None, model.temperature):
        raise ValueError(
            f"{request.where}: this model predicts {model.temperature!r}; leave --temperature out, it is for models "
            f"that do not say what they predict"
        )
    return model


def signal_roles(column_map: ColumnMap, model: Model) -> Mapping[str, str]:
    """role -> signal: as the map says, else as the one says that the model was learned with, else the decanter's."""
    return usual_roles(model.roles if column_map.roles is None else column_map.roles)


def check_traces(model: Model, traces: Sequence[Trace], source: str) -> None:
    """Raises ValueError, in one sentence, where the traces have not what the model needs at least."""
    present = dict.fromkeys(name for trace in traces for name in trace.signals)
    needed = [model.temperature, *(channel.signal for channel in model.alphabet.channels)]
    missing = [name for name in dict.fromkeys(needed) if name not in present]
    if missing:
        raise ValueError(
            f"{source}: the model needs {missing[0]!r}, which no trace has (they have "
            f"{', '.join(list(present)[:12])}); give traces of the same plant, or the --map that names their columns"
        )


def run(
    request: DiagnosisRequest,
    model: Model,
    traces: Sequence[Trace],
    roles: Mapping[str, str],
    progress: Progress,
    *,
    experiments: Sequence[Trace] = (),
) -> DiagnosisResult:
    """Diagnose and write everything. Raises ValueError or OSError; then nothing in the folder has changed.

    `experiments` are traces of an experiment that was proposed: what is told of the model begins with none of them.
    """
    check_traces(model, traces, request.source)
    if experiments:
        check_traces(model, experiments, "--with-experiment")
    # For the new model too, whose stays learn from them what the effects' signals are like.
    traces, experiments = ([patiently(trace, model.alphabet) for trace in those] for those in (traces, experiments))
    outcome = diagnose_model(
        model,
        traces,
        seed=request.seed,
        roles=roles,
        lines=request.lines,
        most=request.most,
        experiments=experiments,
        progress=progress,
    )
    if request.experiment and outcome.path is not None:
        progress("the experiment that tells rivals apart", 0.97)
        proposed = propose_experiment(outcome.path, traces, roles)
        outcome = replace(outcome, diagnosis=replace(outcome.diagnosis, experiment=proposed))
    progress("writing the report", 0.97)
    new = new_model(request, model, [*traces, *experiments], outcome)
    reasons = None if new is None else verify(new).reasons
    after = None if new is None else str(request.out / MODEL)
    diagnosis = replace(outcome.diagnosis, model_before=request.where, model_after=after)
    count = sum(trace.synthetic for trace in traces)
    synthetic = [f"{count} of {len(traces)} traces are synthetic"] if count else []
    synthetic += ["the model was learned from synthetic traces"] if model.provenance.synthetic else []
    rows = sum(trace.times.size for trace in traces)
    occasion = Occasion(
        name=model.sha.name,
        temperature=model.temperature,
        created=datetime.fromtimestamp(request.created, UTC).strftime("%Y-%m-%d %H:%M UTC"),
        facts={
            "model": request.where,
            "traces": f"{len(traces)} with {rows} rows from {request.source}",
            "seed": str(request.seed),
            "decanter": version("decanter-gateway"),
        },
        roles={role: signal for role, signal in roles.items() if any(signal in trace.signals for trace in traces)},
        folder=request.out,
        synthetic="; ".join(synthetic),
        verification=reasons,
    )
    write_diagnosis(diagnosis, occasion, new, report=request.report)
    return DiagnosisResult(diagnosis, new, reasons)


def new_model(
    request: DiagnosisRequest, model: Model, traces: Sequence[Trace], outcome: DiagnosisOutcome
) -> Model | None:
    """The model with what was found and its lineage; None where nothing is added."""
    if outcome.fitted is None or not outcome.diagnosis.effects:
        return None
    names = tuple(trace.name for trace in traces)
    new = augment_model(outcome.fitted, data_hash=joint_hash(traces), traces=names, readings=traces)
    held_out = outcome.diagnosis.held_out
    scores = (
        {} if held_out is None else {"held_out_rmse": held_out.rmse_after, "held_out_noise_floor": held_out.noise_floor}
    )
    origin = replace(
        new.provenance,
        synthetic=model.provenance.synthetic or any(trace.synthetic for trace in traces),
        settings={**new.provenance.settings, "seed": request.seed},
        scores={**new.provenance.scores, **scores},
        parent=model_hash(model),
    )
    return replace(new, provenance=origin)


RECENT = "14d"
"""What of a historian is read where nobody says how much."""


def diagnose(
    more: Sequence[str],
    where: str,
    paths: Sequence[str],
    historian: Path | None,
    since: str | None,
    machine: str | None,
    map_name: str,
    out: Path,
    effects: Path | None,
    most: int,
    temperature: str | None,
    proposes: bool,
    if_drifting: bool,
    no_report: bool,
    experiment: bool,
    schedule: Path | None,
    made: Sequence[str],
    seed: int,
    as_json: bool,
) -> None:
    """Carry out `decanter diagnose`; its options and its help are in gap/commands.py."""
    sources = (*paths, *more)
    if bool(sources) == (historian is not None):
        raise click.UsageError("give either --traces or --historian")
    for option, given in (("--since", since), ("--machine", machine), ("--if-drifting", if_drifting or None)):
        if given is not None and historian is None:
            raise click.UsageError(f"{option} belongs to --historian")
    with sentences(), progress("diagnosing") as report:
        request = DiagnosisRequest(
            where=where,
            out=out,
            source=", ".join(sources) if historian is None else str(historian),
            seed=seed,
            most=most,
            created=time.time(),
            temperature=temperature,
            report=not no_report,
            lines=() if effects is None else read_effect_lines(effects),
            experiment=experiment or schedule is not None,
        )
        report("reading", 0.0)
        # The model before the traces: it is refused in a moment, and a historian of weeks takes its time.
        store = require_store(where) if proposes else None
        column_map = load_map(shipped_file("traces", map_name))
        model = require_model(request, column_map)
        if historian is not None and if_drifting:
            with reading(historian) as connection:
                drift = recorded_drift(connection, historian, machine=machine, model=model)
            if not drift.stands:
                said = f"not due: {drift.why_not_due()}"
                conclude(
                    CommandResult(
                        {"due": False, "drifting": None if drift.not_looked_at else drift.cycles} | drift.as_plain()
                    ),
                    lambda _: [said],
                    as_json=as_json,
                )
                return
        if historian is None:
            traces, column_map = load(sources, map_name)
        else:
            traces = [recent(historian, since or RECENT, machine=machine)]
        if overlap := find_overlap(traces):
            click.echo(f"{overlap}: the traces are taken one after the other, as given (a folder by names)", err=True)
        experiments = load(made, map_name)[0] if made else ()
        result = run(request, model, traces, signal_roles(column_map, model), report, experiments=experiments)
        proposed = result.diagnosis.experiment
        if schedule is not None and proposed is not None:
            write_trace(proposed.trace, schedule)
        candidate: tuple[str, bool] | None = None
        if store is not None and result.model is not None and not result.verification:
            candidate = propose(store, result.model, result.diagnosis, created=request.created)
    page = out / "report.html"
    data: dict[str, Any] = {"out": str(out), "report": str(page) if page.exists() else None}
    if result.verification is not None:
        data |= {"verified": not result.verification, "refused": list(result.verification)}
    if proposes:
        data |= {"proposed": None if candidate is None else candidate[0], "new": candidate is not None and candidate[1]}

    def result_parts() -> Iterator[Part]:
        yield from show(result, out)
        if request.experiment:
            yield from show_experiment(proposed)
        if candidate is not None:
            name, fresh = candidate
            yield f"{'proposed' if fresh else 'waits already for the same finding'}: {where}@{name}"
            yield f"to run it once it is confirmed: decanter model version promote {where} {name}"

    conclude(CommandResult(document(result.diagnosis) | data), lambda _: result_parts(), as_json=as_json)


def show(result: DiagnosisResult, out: Path) -> Iterator[Part]:
    """Print the verdict with its evidence."""
    diagnosis = result.diagnosis
    unit = display_unit(diagnosis.unit)
    yield f"{diagnosis.verdict}: {diagnosis.sentence}"
    for reason in diagnosis.reasons:
        yield f"  {reason}"
    for look in advice_lines(diagnosis):
        yield f"look at {look}"
    if diagnosis.places:
        rows = [
            [
                place.location,
                place.after,
                span(*place.seconds),
                place.share,
                place.heat,
                f"{place.cycles[0]} of {place.cycles[1]}",
                place.p,
                place.when or place.correlates,
            ]
            for place in diagnosis.places[:5]
        ]
        columns = ("location", "after", "seconds", "share", f"heat ({unit}/h)", "cycles", "p", "goes with")
        yield Rows("where the unexplained heat is", columns, rows)
        if overlap := overlap_sentence(diagnosis.places[:5]):
            yield overlap
    for number, law in enumerate(diagnosis.laws, start=1):
        yield f"law {number}, {law_sentence(law)}"
    if diagnosis.effects:
        rows = [
            [
                effect.name,
                ", ".join(effect.members),
                effect.confidence,
                effect.gain,
                {name: parameter_words(effect.name, name, value, 4) for name, value in effect.params.items()},
            ]
            for effect in diagnosis.effects
        ]
        yield Rows("added to the model", ("effect", "class", "confidence", "nats", "parameters"), rows)
        for effect in diagnosis.effects:
            yield f"to tell {effect.name} from its twins: {effect.experiment}"
    if diagnosis.shifts:
        rows = [
            [
                s.location,
                s.parameter,
                s.before,
                s.after,
                display_unit(s.unit),
                "–" if s.change is None else s.change,
                s.sigma,
            ]
            for s in diagnosis.shifts
        ]
        yield Rows(
            "parameters that moved", ("location", "parameter", "before", "after", "unit", "change", "sigma"), rows
        )
    if said := held_out_sentence(diagnosis):
        yield f"held out: {said}"
    if diagnosis.untested:
        yield f"not tested: {', '.join(diagnosis.untested)} (the report says why)"
    if diagnosis.missing_heat is not None:
        yield f"missing heat over time: {out / MISSING_HEAT_FILE}"
    if (out / "report.html").exists():
        yield f"report: {out / 'report.html'}"
    if diagnosis.model_after is not None:
        verdict = f"it DOES NOT VERIFY: {'; '.join(result.verification)}" if result.verification else "it verifies"
        yield f"new model: {diagnosis.model_after}; {verdict}"


def show_experiment(proposed: ProposedExperiment | None) -> Iterator[Part]:
    """Print an experiment as a numbered list for whoever stands at the machine."""
    if proposed is None:
        yield "experiment: none; there are no two effects to be told apart, or nothing that could be set for it"
        return
    yield from experiment_lines(proposed)
