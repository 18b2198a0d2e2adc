"""What a diagnosis stands on: traces laid out, roles of their signals, cycles to fit and for the proof."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.effects import effect_signals, in_sensor_scale
from sim.lab.discrepancy.consequence import follows
from sim.lab.discrepancy.fitting import (
    Frame,
    Record,
    build_frame,
    build_record,
    first_new_cycle,
    in_order,
    move_frame,
    patiently,
    with_priors,
)
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import Indices
from sim.sha import Model, Trace, signal_unit

TEMPERATURE_ROLES = ("ambient", "feed", "sink")
"""Roles of temperatures, which may as well be warmed by the machine as warm it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataLayout:
    """Traces laid out under a model: its `record`, with the encoded `traces` in their order, experiments last.

    `roles` gives the signal of each role that was asked for, `present` those of them that the traces have, `following`
    the roles whose signal follows the temperature. `cycles` are the pieces of evidence in which something was read, but
    for those of experiments, `made`, which begin with the piece `first_made` (inf where there are none).
    """

    model: Model
    traces: Sequence[Trace]
    roles: Mapping[str, str]
    present: Mapping[str, str]
    following: frozenset[str]
    record: Record
    cycles: Indices
    made: Indices
    first_made: float


@dataclass(frozen=True, slots=True)
class SplitCycles:
    """The `training` cycles, with the structure of the parameters, and the `held_out` ones: of the traces from the
    piece of evidence `first` on, of experiments the last of many."""

    training: Frame
    held_out: Record
    first: int


def build_layout(
    model: Model, traces: Sequence[Trace], experiments: Sequence[Trace], roles: Mapping[str, str], rules: DecisionRules
) -> DataLayout:
    """The layout of traces, with those of experiments behind them. Raises ValueError where they cannot be followed."""
    # Artefacts of the public learner know no unit: then that of the traces is the model's.
    model = replace(in_sensor_scale(model), unit=signal_unit(traces, model.temperature, model.unit))
    usual = in_order(traces)
    laid_out = [patiently(trace, model.alphabet) for trace in (*usual, *in_order(experiments))]
    following = following_roles(model, laid_out, roles, rules)
    present = present_roles(laid_out, {role: each for role, each in roles.items() if role not in following})
    record = build_record(model, laid_out, required_signals(model, present))
    first_made = first_new_cycle(record, usual)
    cycles = np.unique(record.window_cycle)  # those in which something was read
    return DataLayout(
        model=model,
        traces=laid_out,
        roles=roles,
        present=present,
        following=following,
        record=record,
        cycles=cycles[cycles < first_made],
        made=cycles[cycles >= first_made],
        first_made=first_made,
    )


def split_cycles(layout: DataLayout, rules: DecisionRules) -> SplitCycles:
    """The last cycles held out from everything but the proof: not even the screen may have seen them.

    So are the last ones of an experiment: what acts where nobody ever worked is proved there, and nowhere else.
    """
    record, cycles, made = layout.record, layout.cycles, layout.made
    first = cycles[fitted_cycles(cycles.size, rules)]
    to_fit = (record.cycle < first) | (record.cycle >= layout.first_made)
    fitted = fitted_cycles(made.size, rules)
    if fitted < made.size:
        to_fit &= record.cycle < made[fitted]
    training = with_priors(move_frame(build_frame(record), record.select(to_fit)))
    return SplitCycles(training, record.select(~to_fit).by_cycles(), int(first))


def fitted_cycles(count: int, rules: DecisionRules) -> int:
    """How many of so many cycles are fitted, the first ones: all where they are too few for a proof."""
    if count < rules.least_cycles:
        return count
    return max(round((1.0 - rules.held_out_share) * count), rules.least_cycles - 1)


def present_roles(traces: Sequence[Trace], roles: Mapping[str, str]) -> dict[str, str]:
    """The roles whose signal some trace has with at least two different values."""
    present = {}
    for role, signal in roles.items():
        columns = [trace.signals[signal] for trace in traces if signal in trace.signals]
        known = np.concatenate([column[np.isfinite(column)] for column in columns]) if columns else np.empty(0)
        if known.size and np.ptp(known) > 0:
            present[role] = signal
    return present


def following_roles(
    model: Model, traces: Sequence[Trace], roles: Mapping[str, str], rules: DecisionRules
) -> frozenset[str]:
    """The roles of temperatures whose signal follows the model's own (`follows`); one that the model reads is kept."""
    read = set(_inputs(model)) | {*effect_signals(model.sha)}
    asked = {role: roles[role] for role in TEMPERATURE_ROLES if role in roles and roles[role] not in read}
    return frozenset(role for role, signal in asked.items() if follows(traces, model.temperature, signal, rules))


def _inputs(model: Model) -> tuple[str, ...]:
    """The signals that the model's flows are driven by, each as often as it drives one."""
    return tuple(driving.signal for location in model.sha.locations for driving in location.flow.inputs)


def required_signals(model: Model, present: Mapping[str, str]) -> tuple[str, ...]:
    """The inputs of the model's flows and the signals of the roles, each once."""
    return tuple(dict.fromkeys([*_inputs(model), *present.values()]))


def measured_signals(model: Model, traces: Sequence[Trace], rules: DecisionRules) -> tuple[str, ...]:
    """All signals that some trace has with at least two different values, none of which follows the temperature."""
    names = dict.fromkeys(name for trace in traces for name in trace.signals if name != model.temperature)
    present = present_roles(traces, {name: name for name in names})
    causes = [name for name in present if not follows(traces, model.temperature, name, rules)]
    return tuple(dict.fromkeys([*_inputs(model), *causes]))
