"""A diagnosis for the command line: model, traces and roles read, the workflow run, all of it written at the end."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from sim.artefacts.find import find_model
from sim.artefacts.model_json import model_hash
from sim.checking.proof.verify import verify
from sim.discrepancy.augment import augmented
from sim.discrepancy.catalogue import ROLES
from sim.discrepancy.diagnosis import Diagnosis
from sim.discrepancy.output.folder import MODEL, check_folder, write_diagnosis
from sim.discrepancy.output.report import Occasion
from sim.discrepancy.workflow import DiagnosisOutcome, diagnose
from sim.sha.model import Model
from sim.sha.trace import Trace, joint_hash
from sim.traces.column_map import ColumnMap

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be diagnosed, and where the result goes. `created` is the time for the report, in seconds UTC.

    `source` says where the traces are from, as it stands in the report; `most` is how many effects may be named.
    Without `report` there are no page and no pictures.
    """

    where: str
    out: Path
    source: str
    seed: int
    most: int
    created: float
    temperature: str | None = None
    report: bool = True


@dataclass(frozen=True, slots=True)
class Told:
    """What came out: the diagnosis as it was written, and why the new model is not deployable (None: there is none)."""

    diagnosis: Diagnosis
    verification: tuple[str, ...] | None


def model_of(request: Request, column_map: ColumnMap) -> Model:
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


def roles_of(column_map: ColumnMap | None) -> Mapping[str, str]:
    """role -> signal: the map's own table, else the plant's names."""
    return ROLES if column_map is None or column_map.effects is None else column_map.effects.roles


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


def run(request: Request, model: Model, traces: Sequence[Trace], roles: Mapping[str, str], progress: Progress) -> Told:
    """Diagnose and write everything. Raises ValueError or OSError; then nothing in the folder has changed."""
    check_traces(model, traces, request.source)
    outcome = diagnose(model, traces, seed=request.seed, roles=roles, most=request.most, progress=progress)
    progress("writing the report", 0.97)
    new = new_model(request, model, traces, outcome)
    reasons = None if new is None else verify(new).reasons
    after = None if new is None else str(request.out / MODEL)
    diagnosis = replace(outcome.diagnosis, model_before=request.where, model_after=after)
    occasion = _occasion(request, model, traces, roles, reasons)
    write_diagnosis(diagnosis, occasion, new, report=request.report)
    return Told(diagnosis, reasons)


def new_model(request: Request, model: Model, traces: Sequence[Trace], outcome: DiagnosisOutcome) -> Model | None:
    """The model with what was found and its lineage; None where nothing is added."""
    if outcome.fitted is None or not outcome.diagnosis.effects:
        return None
    names = tuple(trace.name for trace in traces)
    new = augmented(outcome.fitted, data_hash=joint_hash(traces), traces=names, readings=traces)
    found = outcome.diagnosis.held_out
    scores = {} if found is None else {"held_out_rmse": found.rmse_after, "held_out_noise_floor": found.noise_floor}
    origin = replace(
        new.provenance,
        synthetic=model.provenance.synthetic or any(trace.synthetic for trace in traces),
        settings={**new.provenance.settings, "seed": request.seed},
        scores={**new.provenance.scores, **scores},
        parent=model_hash(model),
    )
    return replace(new, provenance=origin)


def _occasion(
    request: Request,
    model: Model,
    traces: Sequence[Trace],
    roles: Mapping[str, str],
    verification: tuple[str, ...] | None,
) -> Occasion:
    made = sum(trace.synthetic for trace in traces)
    parts = [f"{made} of {len(traces)} traces are synthetic"] if made else []
    parts += ["the model was learned from synthetic traces"] if model.provenance.synthetic else []
    rows = sum(trace.times.size for trace in traces)
    return Occasion(
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
        synthetic="; ".join(parts),
        verification=verification,
    )
