"""What is done for one machine of a fleet: its own targets, and what the models are worth on what none of them saw."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gateway.entry import sentence
from gateway.lab.fleet.sources import MachineSource, MachineTraces
from gateway.lab.gap.diagnose import check_traces, signal_roles
from gateway.lab.resource_usage import peak_megabytes
from sim.effects import of_machine
from sim.engine import errors, open_loop
from sim.lab.discrepancy import diagnose
from sim.lab.learning import GroupTargets, LearningError, grouped_targets, own_targets, shrink_offset
from sim.lab.learning.bins import learn_bins
from sim.lab.recordings import ColumnMap
from sim.sha import Alphabet, Model, Trace, encode_trace

HELD_OUT_DIVISOR = 4
"""The last of so many parts of a machine's record is held out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetTask:
    """A machine's `source`, the `model` of its type, and what is wanted: a model of its `own`, a diagnosis.

    `between` (degC) is the spread of targets between machines that the type's training told.
    """

    source: MachineSource
    column_map: ColumnMap
    model: Model
    between: float
    own: bool
    diagnosis: bool
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineResult:
    """What came of a machine; `failure` says why nothing did, `unread` which of its files were passed over, and why.

    `offset` and `error` (degC): how far its targets lie from its type's, and the standard error; `grouped` has the same
    by group of locations, as far as its runs tell it. `held_out` (degC): the
    mean absolute free-run error on the last part of its record of the `type`, of the type `corrected` by what the
    rest of its record told, and of a model of its `own`. `verdict` and `effects` are the diagnosis' of the corrected
    type. `cpu_s` and `peak_mb` are what that took, in the process that did it.
    """

    machine: str
    failure: str = ""
    unread: tuple[str, ...] = ()
    rows: int = 0
    hours: float = 0.0
    offset: float | None = None
    error: float | None = None
    grouped: dict[str, GroupTargets] = field(default_factory=dict)
    held_out: dict[str, float] = field(default_factory=dict)
    verdict: str = ""
    effects: tuple[str, ...] = ()
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    own: Model | None = None


def judge_machine(task: FleetTask) -> MachineResult:
    """The task done, or the sentence of what stood in its way."""
    begin, read = time.process_time(), MachineTraces([])
    try:
        read = task.source.read(task.column_map)
        result = _judge_traces(task, read.traces)
    except (ValueError, OSError) as error:
        result = MachineResult(machine=task.source.machine, failure=sentence(error))
    return replace(result, unread=read.unread, cpu_s=time.process_time() - begin, peak_mb=peak_megabytes())


def failed_result(task: FleetTask, reason: str) -> MachineResult:
    """The result of a task that no worker could do."""
    return MachineResult(machine=task.source.machine, failure=reason)


def _judge_traces(task: FleetTask, read: Sequence[Trace]) -> MachineResult:
    name, model = task.source.machine, task.model
    traces = [replace(encode_trace(trace, model.alphabet), machine=name) for trace in read]
    check_traces(model, traces, f"machine {name}")
    first, last = split_traces(traces, model.alphabet)
    fit = own_targets(model, first)
    machines = {name: shrink_offset(fit.correction.offset, fit.offset_error, task.between)} if task.between > 0 else {}
    corrected = of_machine(replace(model, machines=machines), name) if machines else model
    candidates, own = {"type": model, "corrected": corrected}, None
    if task.own:
        learned = learn_bins(first, model.alphabet, model.temperature, seed=task.seed, name=name).model
        own = replace(learned, roles=model.roles)
        candidates["own"] = own
    found: dict[str, Any] = {}
    if task.diagnosis:
        diagnosis = diagnose(
            corrected, traces, seed=task.seed, roles=signal_roles(task.column_map, corrected)
        ).diagnosis
        found = {"verdict": diagnosis.verdict, "effects": tuple(effect.name for effect in diagnosis.effects)}
    return MachineResult(
        machine=name,
        rows=sum(trace.times.size for trace in traces),
        hours=sum(float(np.ptp(trace.times)) for trace in traces) / 3600.0,
        offset=fit.correction.offset,
        error=fit.offset_error,
        grouped=grouped_targets(model, first),
        held_out={what: _error(each, last) for what, each in candidates.items()},
        own=own,
        **found,
    )


def split_traces(traces: Sequence[Trace], alphabet: Alphabet) -> tuple[list[Trace], list[Trace]]:
    """What is learned from, and the last quarter: of the traces in their order, of each one's rows where they are few.

    Raises LearningError where nothing would be left.
    """
    if len(traces) >= HELD_OUT_DIVISOR:
        count = len(traces) // HELD_OUT_DIVISOR
        return list(traces[:-count]), list(traces[-count:])
    if any(trace.times.size < HELD_OUT_DIVISOR for trace in traces):
        raise LearningError(f"trace {traces[0].name!r} has too few rows to hold a part of them out")
    halves = []
    for trace in traces:
        cut = float(trace.times[trace.times.size * (HELD_OUT_DIVISOR - 1) // HELD_OUT_DIVISOR])
        pieces = (trace.between(-np.inf, cut), trace.between(cut, np.inf))
        halves.append([encode_trace(piece, alphabet) for piece in pieces])
    return [first for first, _ in halves], [last for _, last in halves]


def _error(model: Model, traces: Sequence[Trace]) -> float:
    runs = [errors(open_loop(model, trace, "resync"), trace, model.temperature) for trace in traces]
    return float(np.mean([run.at_samples.mae for run in runs]))
