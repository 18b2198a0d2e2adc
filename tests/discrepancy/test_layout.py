"""What is held out for the proof is seen by nothing before it."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.lab.discrepancy import layout
from sim.lab.discrepancy.fitting import fit
from sim.lab.discrepancy.layout import (
    SplitCycles,
    build_layout,
    following_roles,
    measured_signals,
    present_roles,
    required_signals,
    split_cycles,
)
from sim.lab.discrepancy.rules import RULES
from sim.sha import Flow, Input, Location, Model, Trace
from tests.discrepancy.plants import model, plant

ROLES = {"current": "Assorbimento", "pump": "MarciaPmpFango"}


def split_of(trace: Trace) -> SplitCycles:
    return split_cycles(build_layout(model(), [trace], [], ROLES, RULES), RULES)


@pytest.fixture(scope="module")
def trace() -> Trace:
    return plant(3, days=3, pump=2e-4, period=120.0)


def test_readings_of_the_held_out_cycles_do_not_change_the_refit(trace: Trace) -> None:
    split = split_of(trace)
    held_out = trace.times >= split.held_out.runs.time.min()
    others = np.where(held_out, trace.signals["T"] + 3.0, trace.signals["T"])
    changed = split_of(replace(trace, signals={**trace.signals, "T": others}))
    assert not np.array_equal(changed.held_out.reading, split.held_out.reading)
    first, second = (fit(each.training, rounds=1) for each in (split, changed))
    np.testing.assert_array_equal(first.state.parameters, second.state.parameters)
    assert first.noise == second.noise


def test_each_reading_is_fitted_or_held_out_and_the_last_cycles_are(trace: Trace) -> None:
    split = split_of(trace)
    fitted, held_out = split.training.record.runs.time, split.held_out.runs.time
    assert fitted.max() < held_out.min()
    assert np.unique(split.held_out.window_cycle).size == round(RULES.held_out_share * 9) == 3


# ---------------------------------------------------------------- the split, cycle by cycle


@dataclass
class Cut:
    """A record of which only the pieces of evidence are known."""

    cycle: Any
    by: str = ""

    def select(self, keep: Any) -> "Cut":
        return Cut(self.cycle[keep])

    def by_cycles(self) -> "Cut":
        return Cut(self.cycle, "cycles")


@pytest.mark.parametrize("share", [0.3, 0.7])
@pytest.mark.parametrize("experiments", [0, 2, 4, 9])
@pytest.mark.parametrize("count", range(4, 15))
def test_the_last_cycles_are_held_out_those_of_an_experiment_of_four_too(
    count: int, experiments: int, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "build_frame", lambda record: record)
    monkeypatch.setattr(layout, "move_frame", lambda frame, record: record)
    monkeypatch.setattr(layout, "with_priors", lambda frame: frame)
    # Three knots a cycle; cycle 1 has no reading, so that it is none of those that count.
    numbers = [0, *range(2, count + 1)]
    record = Cut(np.repeat(np.arange(count + 1 + experiments), 3))
    laid_out: Any = SimpleNamespace(
        record=record,
        cycles=np.array(numbers),
        made=np.arange(count + 1, count + 1 + experiments),
        first_made=float(count + 1) if experiments else float("inf"),
    )
    split = split_cycles(laid_out, replace(RULES, held_out_share=share))
    held = min(count - round((1.0 - share) * count), count - 3)
    first = numbers[count - held]
    proving = max(min(experiments - round((1.0 - share) * experiments), experiments - 3), 0)
    made = list(range(count + 1, count + 1 + experiments - proving))
    proof = [*range(first, count + 1), *range(count + 1 + experiments - proving, count + 1 + experiments)]
    assert split.first == first and isinstance(split.first, int)
    fitted: Any = split.training
    assert sorted(set(fitted.cycle)) == [*range(first), *made] and fitted.by == ""
    assert sorted(set(split.held_out.cycle)) == proof and split.held_out.by == "cycles"  # type: ignore[attr-defined]


def test_an_experiment_comes_behind_the_traces_and_is_seen_by_the_fit() -> None:
    usual, other = plant(3, days=1, period=120.0), plant(4, days=1, period=120.0)
    made = replace(plant(5, days=1, period=120.0), name="made")
    later = [replace(each, times=each.times + 1e6 * place) for place, each in enumerate((usual, other), 1)]
    later[1] = replace(later[1], units={"T": "degF", "Assorbimento": "A"})
    roles = ROLES | {"ambient": "Assorbimento", "feed": "MarciaPmpFango"}
    laid_out = build_layout(model(), later[::-1], [made], roles, RULES)
    assert (
        laid_out.model.unit == "degF" and build_layout(model(), later[:1], [], ROLES, RULES).model.unit == model().unit
    )
    kelvin = build_layout(replace(model(), unit="K"), [replace(usual, units={})], [], ROLES, RULES)
    assert kelvin.model.unit == "K", "where no trace says it"
    assert [trace.name for trace in laid_out.traces][-1] == "made" and len(laid_out.traces) == 3
    assert laid_out.traces[0].times[0] < laid_out.traces[1].times[0], "in the order of their times"
    assert all(trace.events for trace in laid_out.traces)
    assert laid_out.roles == roles == laid_out.present and laid_out.following == frozenset()
    assert laid_out.cycles.size == 6 and laid_out.cycles.max() < laid_out.first_made < np.inf
    split = split_cycles(laid_out, RULES)
    assert split.first == laid_out.cycles[4]
    assert set(split.held_out.runs.trace) == {1} and 2 in set(split.training.record.runs.trace)
    assert build_layout(model(), later, [], ROLES, RULES).first_made == np.inf


# ---------------------------------------------------------------- roles


def traced(**signals: list[float]) -> Trace:
    columns = {name: np.array(column, dtype=float) for name, column in signals.items()}
    return Trace("t", np.arange(float(len(next(iter(columns.values()))))), columns)


NAN = float("nan")


def test_a_role_is_there_whose_signal_takes_two_values_in_some_trace() -> None:
    traces = [traced(still=[1.0, 1.0, NAN], one=[5.0, NAN, NAN], none=[NAN] * 3), traced(one=[6.0, NAN, NAN])]
    roles = {"a": "still", "b": "one", "c": "none", "d": "absent"}
    assert present_roles(traces, roles) == {"b": "one"}
    assert present_roles(traces[:1], roles) == {} == present_roles([], roles)


def driven(*signals: str) -> Model:
    base = model()
    locations = tuple(
        Location(each.name, Flow("driven", dict(each.flow.params), tuple(Input(s, 0.1, 0.0) for s in signals)))
        for each in base.sha.locations
    )
    return replace(base, sha=replace(base.sha, locations=locations))


def test_what_follows_the_temperature_is_no_cause_unless_the_model_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def follows(traces: Any, temperature: str, signal: str, rules: Any) -> bool:
        asked.append((len(traces), temperature, signal, rules))
        return signal in ("room", "oil")

    monkeypatch.setattr(layout, "follows", follows)
    traces = [traced(room=[1.0, 2.0], oil=[1.0, 2.0], T=[1.0, 2.0], I=[1.0, 2.0], still=[1.0, 1.0])]
    roles = {"ambient": "room", "sink": "oil", "current": "I", "feed": "I"}
    assert following_roles(model(), traces, roles, RULES) == {"ambient", "sink"}
    assert asked == [(1, "T", "room", RULES), (1, "T", "I", RULES), (1, "T", "oil", RULES)], "temperatures alone"
    assert following_roles(driven("oil"), traces, roles, RULES) == {"ambient"}
    asked.clear()
    assert measured_signals(driven("oil", "oil"), traces, RULES) == ("oil", "I")
    assert asked == [(1, "T", name, RULES) for name in ("room", "oil", "I")]


def test_what_is_needed_is_named_once_inputs_first() -> None:
    assert required_signals(driven("b", "a"), {"x": "c", "y": "a", "z": "c"}) == ("b", "a", "c")
    assert required_signals(model(), {}) == ()
