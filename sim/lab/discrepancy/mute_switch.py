"""A switch that does not say when the machine runs, where its load does: a signal to look at, and no missing heat.

The model goes by its switch. Where that never moves, stays where it was, chatters or says the opposite, the refit makes
up for every start and stop, and what comes and goes with the machine, its current first, explains most of the gap.
Where it only turns for single rows now and then, the load tells what it would have said in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.lab.discrepancy.fitting import build_frame, build_record, model_effects, patiently, run_frame
from sim.lab.discrepancy.layout import DataLayout, required_signals
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import Indices, LearningError, first_switch
from sim.sha import Array, Bins, Mask, Trace


@dataclass(frozen=True, slots=True)
class MuteSwitch:
    """The given model is off by `error` (degC rms) by its `switch`, which is `value` in all rows (None: it moves), and
    by `by_load` where the machine counts as running while it has a `load`."""

    switch: str
    value: float | None
    load: str
    error: float
    by_load: float

    def reason(self) -> str:
        """Why nothing is told of the machine."""
        return f"{self.switch} does not say when the machine runs, and {self.load} does"

    def sentence(self, unit: str) -> str:
        """It as a sentence; `unit` as people read it."""
        says = "says something else" if self.value is None else f"is {self.value:g} in every row"
        return (
            f"Too little data: {self.load} shows when the machine runs, and {self.switch} {says}. By {self.load} the "
            f"model as given is off by {self.by_load:.3g} {unit}, by {self.switch} by {self.error:.3g}: look at that "
            "signal. Without it nothing can be told of what the model lacks."
        )


def find_mute_switch(layout: DataLayout, rules: DecisionRules) -> MuteSwitch | None:
    """The model's switch where a load contradicts it often and foresees the temperature by far better."""
    model = layout.model
    switch = first_switch(model.alphabet)
    if switch is None:
        return None
    for load in _loads(layout):
        turns = [_turns_by_load(trace, load, rules) for trace in layout.traces]
        if not _contradicts(layout.traces, turns, switch.signal, rules):
            continue
        error, by_load = (
            _given_error(layout, traces)
            for traces in (
                layout.traces,
                [
                    replace(trace, signals={**trace.signals, switch.signal: each.astype(float)}, events=())
                    for trace, each in zip(layout.traces, turns, strict=True)
                ],
            )
        )
        if by_load <= rules.by_load_most_error_share * error:
            known = np.concatenate([trace.signals[switch.signal] for trace in layout.traces])
            known = known[np.isfinite(known)]
            value = float(known[0]) if np.ptp(known) == 0.0 else None
            return MuteSwitch(switch.signal, value, load, error, by_load)
    return None


@dataclass(frozen=True, slots=True)
class ChatteringSwitch:
    """The model's `switch` turned in so many single `rows` in which its `load` did not."""

    switch: str
    load: str
    rows: int

    def sentence(self) -> str:
        """It as a sentence."""
        times = "a single row" if self.rows == 1 else f"{self.rows} single rows"
        return (
            f"{self.switch} turned for {times} while {self.load} did not: look at that signal; there the machine "
            f"counts as {self.load} says."
        )

    def settle(self, trace: Trace, rules: DecisionRules) -> Trace:
        """The trace with the switch as the load says in these rows; as it is where there are none."""
        rows = _contradicted_rows(trace, self.switch, self.load, rules)
        if not rows.size:
            return trace
        column = trace.signals[self.switch].astype(float)
        column[rows] = _turns_by_load(trace, self.load, rules)[rows]
        return replace(trace, signals={**trace.signals, self.switch: column}, events=())


def find_chatter(layout: DataLayout, rules: DecisionRules) -> ChatteringSwitch | None:
    """The model's switch where it turned for single rows in which a load goes on: each would be a stop and a start, and
    a model that enters its bins as the load moves would have lost its place until it moves again."""
    switch = first_switch(layout.model.alphabet)
    if switch is None:
        return None
    for load in _loads(layout):
        rows = sum(_contradicted_rows(trace, switch.signal, load, rules).size for trace in layout.traces)
        if rows:
            return ChatteringSwitch(switch.signal, load, rows)
    return None


def _loads(layout: DataLayout) -> Sequence[str]:
    """The signals of what loads the machine, each once."""
    loads = [channel.signal for channel in layout.model.alphabet.channels if isinstance(channel, Bins)]
    loads += [layout.present[role] for role in ("current",) if role in layout.present]
    return tuple(dict.fromkeys(loads))


def _contradicted_rows(trace: Trace, switch: str, load: str, rules: DecisionRules) -> Indices:
    """The single rows in which the switch says something else than the load, which says in them what both say in the
    rows on either side."""
    if switch not in trace.signals or load not in trace.signals or trace.times.size < 3:
        return np.empty(0, dtype=np.intp)
    turns = _turns_by_load(trace, load, rules)
    apart = turns != (_hold_values(trace.signals[switch]) > 0.5)
    alone = apart[1:-1] & ~apart[:-2] & ~apart[2:]
    return np.flatnonzero(alone & (turns[1:-1] == turns[:-2]) & (turns[1:-1] == turns[2:])) + 1


def _turns_by_load(trace: Trace, load: str, rules: DecisionRules) -> Mask:
    """(n,) whether the machine turns, by its load; as before where that was not read."""
    column = np.abs(trace.signals.get(load, np.full(trace.times.size, np.nan)))
    seen = column[np.isfinite(column)]
    turns = column > rules.turning_least_load_share * np.max(seen, initial=0.0)
    return _hold_values(np.where(np.isfinite(column), turns, np.nan)) > 0.5


def _hold_values(column: Array) -> Array:
    """(n,) each value until the next one that was read; 0 before the first."""
    last = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(column.size), -1))
    return np.where(last < 0, 0.0, column[last])


def _contradicts(traces: Sequence[Trace], turns: Sequence[Mask], switch: str, rules: DecisionRules) -> bool:
    """Whether the switch says something else than these for much of the time, and these show both."""
    apart, whole, seen = 0.0, 0.0, set[bool]()
    for trace, turning in zip(traces, turns, strict=True):
        if switch not in trace.signals or trace.times.size < 2:
            continue
        lasted = np.diff(trace.times)
        apart += float(lasted[(turning != (_hold_values(trace.signals[switch]) > 0.5))[:-1]].sum())
        whole += float(lasted.sum())
        seen |= set(turning.tolist())
    return len(seen) == 2 and whole > 0.0 and apart >= rules.contradicted_least_share * whole


def _given_error(layout: DataLayout, traces: Sequence[Trace]) -> float:
    """degC rms by which the model as given is off over traces, run on from where each run begins; inf: none follows."""
    model = layout.model
    encoded = [trace if trace.events else patiently(trace, model.alphabet) for trace in traces]
    try:
        record = build_record(model, encoded, required_signals(model, layout.present))
    except LearningError:
        return np.inf
    frame, named = build_frame(record), model_effects(model)
    point = np.concatenate([frame.centre, *(np.array(each.point) for each in named)])
    state = run_frame(frame, point, record.reading[record.window_first], named)
    return float(np.sqrt(np.mean((record.reading - record.window_means(state.mean)) ** 2)))
