"""A study of a fleet, step by step: a model of the type, then every machine, each result kept as soon as it is there.

    OUT/results.jsonl   a line for the type's model, one for each machine that is done
    OUT/sample/         the model of the type as a sample of machines teaches it
    OUT/machines/NAME/  a model of a machine of its own, where that was asked for
    OUT/model/          the model of the type with what each machine has of its own

A kill at any moment costs the machines that were being worked on: the same command goes on with those that are left.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from gateway.lab.fleet.machine_task import FleetTask, MachineResult, judged, not_done
from gateway.lab.fleet.sources import MachineSource
from gateway.lab.json_rows import append_row, read_rows
from sim.artefacts import model_hash, read_model
from sim.artefacts.formats import write_model_directory
from sim.learning import GroupTargets, MachineSpread, StandsOut, believed, outstanding, spread_of
from sim.learning.bins import learn_bins
from sim.sha import Model, Trace, shown_unit
from sim.traces import ColumnMap, with_thresholds
from sim.workers import Workers

Progress = Callable[[str, float], None]

FORMAT = 2
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

    `outstanding`: the machines whose targets stand out, and in which groups of locations, the least likely first.
    """

    model: Model
    results: Mapping[str, MachineResult]
    spread: MachineSpread
    outstanding: Mapping[str, Sequence[StandsOut]]


def study(request: FleetRequest, workers: Workers, tell: Callable[[str], None], progress: Progress) -> FleetFindings:
    """The whole study; what a former one has done of it is taken from the folder.

    Raises ValueError where no model of the type can be learned or every machine fails, OSError.
    """
    file = request.out / RESULTS
    kept = [row for row in read_rows(file) if row.get("format") == FORMAT]
    model, between = type_model(request, kept, progress)
    keys = {
        source.machine: _key(source.content(), model_hash(model), request.own, request.diagnosis, request.seed)
        for source in request.sources
    }
    finished = [row for row in kept if "machine" in row]
    done = {row["machine"]: result_of(row) for row in finished if row["key"] == keys.get(row["machine"])}
    left = [source for source in request.sources if source.machine not in done]
    if done:
        tell(f"{len(done)} of {len(keys)} machines are done already")
    tasks = [
        FleetTask(
            source=source,
            column_map=request.column_map,
            model=model,
            between=between,
            own=request.own,
            diagnosis=request.diagnosis,
            seed=request.seed,
        )
        for source in left
    ]
    for result in workers(judged, tasks, not_done, ordered=False):
        if result.own is not None:
            write_model_directory(request.out / MACHINES / quote(result.machine, safe=""), result.own)
        result = replace(result, own=None)
        # One that failed is tried again by the next command: what stood in its way may be gone.
        if not result.failure:
            append_row(file, {"format": FORMAT, "key": keys[result.machine], **asdict(result)})
        done[result.machine] = result
        tell(sentence(result, shown_unit(model.unit)))
        progress(result.machine, len(done) / len(keys))
    return conclusions(request, model, dict(sorted(done.items())))


def type_model(request: FleetRequest, kept: Sequence[Mapping[str, Any]], progress: Progress) -> tuple[Model, float]:
    """The model of the type, and the spread of targets (degC) among the machines that taught it."""
    drawn = np.random.default_rng(request.seed).permutation(len(request.sources))[: request.sample]
    sample = [request.sources[place] for place in sorted(drawn.tolist())]
    key = _key(*(source.content() for source in sample), request.temperature, request.seed)
    folder = request.out / SAMPLE
    for row in kept:
        if row.get("type") == key and (folder / "model.json").is_file():
            return read_model(folder / "model.json"), float(row["between"])
    progress(f"the type, from {len(sample)} machines", 0.0)
    traces, alphabet = list[Trace](), request.column_map.alphabet
    for source in sample:
        traces += [replace(trace, machine=source.machine) for trace in source.traces(request.column_map)]
    alphabet = with_thresholds(alphabet, traces)
    traces = [replace(trace, name=f"{trace.machine} {trace.name}", events=()) for trace in traces]
    learned = learn_bins(traces, alphabet, request.temperature, seed=request.seed, name="type")
    write_model_directory(folder, learned.model, learned.values)
    append_row(request.out / RESULTS, {"format": FORMAT, "type": key, "between": learned.spread.between})
    return learned.model, learned.spread.between


def conclusions(request: FleetRequest, model: Model, results: Mapping[str, MachineResult]) -> FleetFindings:
    """What all machines tell together; writes the model of the type with what each has of its own."""
    known = {name: result for name, result in results.items() if result.offset is not None and result.error is not None}
    if not known:
        name, first = next(iter(results.items()))
        raise ValueError(f"none of {len(results)} machines could be judged; {name}: {first.failure}")
    offsets = {name: float(result.offset or 0.0) for name, result in known.items()}
    spread = spread_of(offsets, {name: float(result.error or 0.0) for name, result in known.items()})
    others = [effect for effect in model.sha.effects if effect.kind != "machine-offset"]
    machines = {}
    if spread.between > 0:
        machines = {
            name: believed(offset, spread.errors[name], spread.between) for name, offset in spread.offsets.items()
        }
    sha = replace(model.sha, effects=(*others, *spread.effects))
    whole = replace(model, sha=sha, machines=machines)
    write_model_directory(request.out / MODEL, whole)
    grouped = {name: result.grouped for name, result in known.items()}
    return FleetFindings(whole, results, spread, outstanding(grouped))


def sentence(result: MachineResult, unit: str) -> str:
    """What came of a machine, on one line; `unit` as people read it."""
    if result.failure:
        return f"{result.machine}: {result.failure}"
    targets = f"targets {result.offset:+.2f} +- {result.error:.2f} {unit}"
    errors = ", ".join(f"{what} {error:.2f}" for what, error in result.held_out.items())
    verdict = f"; {result.verdict}: {', '.join(result.effects) or 'nothing'}" if result.verdict else ""
    return f"{result.machine}: {targets}, held-out error {errors} {unit}{verdict}"


def result_of(row: Mapping[str, Any]) -> MachineResult:
    """A result as it was kept."""
    fields = {name: row[name] for name in MachineResult.__dataclass_fields__ if name != "own"}
    grouped = {group: GroupTargets(**each) for group, each in row["grouped"].items()}
    return MachineResult(**{**fields, "effects": tuple(row["effects"]), "grouped": grouped})


def _key(*parts: object) -> str:
    return sha256(repr(parts).encode()).hexdigest()
