"""A study of a fleet, step by step: a model of the type, then every machine, each result kept as soon as it is there.

    OUT/results.jsonl   a line for the type's model, one for each machine that is done
    OUT/sample/         the model of the type as a sample of machines teaches it
    OUT/machines/NAME/  a model of a machine of its own, where that was asked for
    OUT/model/          the model of the type with what each machine has of its own

A kill at any moment costs the machines that were being worked on: the same command goes on with those that are left.
A machine that cannot teach is left out of the sample and another one drawn for it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from urllib.parse import quote

import numpy as np

from gateway.entry import sentence as error_sentence
from gateway.lab.fleet.kept import KeptType, keep_result, keep_type, kept_rows, parse_result
from gateway.lab.fleet.machine_task import FleetTask, MachineResult, failed_result, judge_machine
from gateway.lab.fleet.sources import MachineSource
from sim.artefacts import model_hash, read_model
from sim.lab.formats import write_model_directory
from sim.lab.learning import (
    MachineSpread,
    StandsOut,
    check_data,
    find_outliers,
    offset_spread,
    shrink_offset,
    target_groups,
)
from sim.lab.learning.bins import learn_bins
from sim.lab.recordings import ColumnMap, with_thresholds
from sim.lab.workers import Workers
from sim.sha import Model, Trace, display_unit, encode

Progress = Callable[[str, float], None]

RESULTS, SAMPLE, MACHINES, MODEL = "results.jsonl", "sample", "machines", "model"


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRequest:
    """What is studied: `sources`, their `column_map`, where it goes. `sample` machines teach the type's model."""

    sources: Sequence[MachineSource]
    column_map: ColumnMap
    temperature: str
    out: Path
    sample: int
    own: bool
    diagnosis: bool
    seed: int


@dataclass(frozen=True, slots=True)
class FleetFindings:
    """The `model` of the type with each machine's own, all `results` by machine, the `spread` of the targets.

    `find_outliers`: the machines whose targets stand out, and in which groups of locations, the least likely first.
    `left_out`: the machines that were drawn to teach the type and could not, with the reason.
    """

    model: Model
    results: Mapping[str, MachineResult]
    spread: MachineSpread
    outstanding: Mapping[str, Sequence[StandsOut]]
    left_out: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class TypeModel:
    """The model of the type, the spread of targets (degC) among those that taught it, and who could not, and why."""

    model: Model
    between: float
    left_out: Mapping[str, str]


def study(request: FleetRequest, workers: Workers, tell: Callable[[str], None], progress: Progress) -> FleetFindings:
    """The whole study; what a former one has done of it is taken from the folder.

    Raises ValueError where no model of the type can be learned or every machine fails, OSError.
    """
    file = request.out / RESULTS
    kept = kept_rows(file)
    taught = type_model(request, kept.taught, progress)
    model = taught.model
    for name, reason in taught.left_out.items():
        tell(f"{name} is not among the machines that teach the type: {reason}")
    keys = {
        source.machine: _key(source.content(), model_hash(model), request.own, request.diagnosis, request.seed)
        for source in request.sources
    }
    groups = target_groups(model.alphabet)
    done = {
        row.machine: parse_result(place, row, groups)
        for place, row in kept.machines
        if row.key == keys.get(row.machine)
    }
    left = [source for source in request.sources if source.machine not in done]
    if done:
        tell(f"{len(done)} of {len(keys)} machines are done already")
    tasks = [
        FleetTask(
            source=source,
            column_map=request.column_map,
            model=model,
            between=taught.between,
            own=request.own,
            diagnosis=request.diagnosis,
            seed=request.seed,
        )
        for source in left
    ]
    for result in workers(judge_machine, tasks, failed_result, ordered=False):
        if result.own is not None:
            write_model_directory(request.out / MACHINES / quote(result.machine, safe=""), result.own)
        result = replace(result, own=None)
        # One that failed is tried again by the next command: what stood in its way may be gone.
        if not result.failure:
            keep_result(file, keys[result.machine], result)
        done[result.machine] = result
        tell(sentence(result, display_unit(model.unit)))
        progress(result.machine, len(done) / len(keys))
    return conclusions(request, taught, dict(sorted(done.items())))


def type_model(request: FleetRequest, kept: KeptType | None, progress: Progress) -> TypeModel:
    """The model of the type: the one that is kept, if it was learned from this sample, else a new one.

    Raises ValueError where no machine can teach it, OSError.
    """
    drawn = np.random.default_rng(request.seed).permutation(len(request.sources)).tolist()
    order = [request.sources[place] for place in drawn]
    folder = request.out / SAMPLE
    if (
        kept is not None
        and (folder / "model.json").is_file()
        and kept.type == _sample_key(request, order, kept.left_out)
    ):
        return TypeModel(read_model(folder / "model.json"), kept.between, kept.left_out)
    traces, left_out = _sample(request, order, progress)
    alphabet = with_thresholds(request.column_map.alphabet, traces)
    traces = [replace(trace, name=f"{trace.machine} {trace.name}", events=()) for trace in traces]
    learned = learn_bins(traces, alphabet, request.temperature, seed=request.seed, name="type")
    model = replace(learned.model, roles=request.column_map.roles)
    write_model_directory(folder, model, learned.values)
    key = _sample_key(request, order, left_out)
    keep_type(request.out / RESULTS, key, learned.spread.between, left_out)
    return TypeModel(model, learned.spread.between, left_out)


def _sample(
    request: FleetRequest, order: Sequence[MachineSource], progress: Progress
) -> tuple[list[Trace], dict[str, str]]:
    """The traces of the first machines in `order` that can teach; those that were to and cannot, with the reason."""
    usable: dict[str, list[Trace]] = {}
    left_out: dict[str, str] = {}
    count = min(request.sample, len(order))
    for source in order:
        if len(usable) == count:
            break
        progress(f"the type, from {count} machines", 0.0)
        try:
            usable[source.machine] = _teaching_traces(source, request)
        except (ValueError, OSError) as error:
            left_out[source.machine] = error_sentence(error)
    if not usable:
        name, reason = next(iter(left_out.items()))
        raise ValueError(f"none of {len(left_out)} machines can teach a model of the type; {name}: {reason}")
    return [trace for name in sorted(usable) for trace in usable[name]], left_out


def _teaching_traces(source: MachineSource, request: FleetRequest) -> list[Trace]:
    """The traces of a machine. Raises ValueError or OSError where they cannot be read or teach nothing."""
    traces = [replace(trace, machine=source.machine) for trace in source.read(request.column_map).traces]
    alphabet = with_thresholds(request.column_map.alphabet, traces)
    check_data([replace(trace, events=encode(trace, alphabet)) for trace in traces], request.temperature)
    return traces


def _sample_key(request: FleetRequest, order: Sequence[MachineSource], left_out: Mapping[str, str]) -> str:
    """Changes when another sample would be taken: so does a machine that was left out and now has other data."""
    usable = [source for source in order if source.machine not in left_out][: request.sample]
    others = [source.content() for source in order if source.machine in left_out]
    taught = [source.content() for source in sorted(usable, key=lambda source: source.machine)]
    return _key(*taught, request.temperature, request.seed, *others)


def conclusions(request: FleetRequest, taught: TypeModel, results: Mapping[str, MachineResult]) -> FleetFindings:
    """What all machines tell together; writes the model of the type with what each has of its own."""
    model = taught.model
    known = {name: result for name, result in results.items() if result.offset is not None and result.error is not None}
    if not known:
        name, first = next(iter(results.items()))
        raise ValueError(f"none of {len(results)} machines could be judged; {name}: {first.failure}")
    offsets = {name: float(result.offset or 0.0) for name, result in known.items()}
    spread = offset_spread(offsets, {name: float(result.error or 0.0) for name, result in known.items()})
    others = [effect for effect in model.sha.effects if effect.kind != "machine-offset"]
    machines = {}
    if spread.between > 0:
        machines = {
            name: shrink_offset(offset, spread.errors[name], spread.between) for name, offset in spread.offsets.items()
        }
    sha = replace(model.sha, effects=(*others, *spread.effects))
    whole = replace(model, sha=sha, machines=machines)
    write_model_directory(request.out / MODEL, whole)
    grouped = {name: result.grouped for name, result in known.items()}
    return FleetFindings(whole, results, spread, find_outliers(grouped), taught.left_out)


def sentence(result: MachineResult, unit: str) -> str:
    """What came of a machine, on one line; `unit` as people read it."""
    if result.failure:
        return f"{result.machine}: {result.failure}"
    targets = f"targets {result.offset:+.2f} +- {result.error:.2f} {unit}"
    errors = ", ".join(f"{what} {error:.2f}" for what, error in result.held_out.items())
    verdict = f"; {result.verdict}: {', '.join(result.effects) or 'nothing'}" if result.verdict else ""
    return f"{result.machine}: {targets}, held-out error {errors} {unit}{verdict}"


def _key(*parts: object) -> str:
    return sha256(repr(parts).encode()).hexdigest()
