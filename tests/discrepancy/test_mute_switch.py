"""A switch that does not say when the machine runs is told as one, and nothing is named by what comes and goes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import catalogue
from sim.lab.discrepancy.layout import build_layout
from sim.lab.discrepancy.mute_switch import ChatteringSwitch, MuteSwitch, find_chatter, find_mute_switch
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from sim.sha import Array, Trace
from tests.discrepancy.plants import model, plant

ROW_S = 240.0
ROLES = {"current": "Assorbimento", "pump": "MarciaPmpFango"}
SWITCH, LOAD = "MarciaDecanter", "Assorbimento"


def with_column(trace: Trace, name: str, column: Array) -> Trace:
    """The trace with another column, encoded anew."""
    return replace(trace, signals={**trace.signals, name: np.asarray(column, dtype=float)}, events=())


def found(trace: Trace) -> MuteSwitch | None:
    return find_mute_switch(build_layout(model(), [trace], [], ROLES, RULES), RULES)


def test_rules_say_from_when_a_switch_is_not_asked() -> None:
    layout = build_layout(model(), [plant(7, days=1, period=ROW_S)], [], ROLES, RULES)
    no_time, any_error = replace(RULES, contradicted_least_share=0.0), replace(RULES, by_load_most_error_share=np.inf)
    neither = replace(no_time, by_load_most_error_share=np.inf)
    assert [find_mute_switch(layout, rules) is None for rules in (RULES, no_time, any_error, neither)] == [
        True, True, True, False,
    ]  # fmt: skip


def from_half_way(value: float) -> Callable[[Array], Array]:
    return lambda on: np.where(np.arange(on.size) < on.size // 2, on, value)


MUTE: dict[str, Callable[[Array], Array]] = {
    "always 1": np.ones_like,
    "always 0": np.zeros_like,
    "moves only once": np.maximum.accumulate,
    "stays at 1": from_half_way(1.0),
    "stays at 0": from_half_way(0.0),
    "the other way round": lambda on: 1.0 - on,
    "chatters": lambda on: np.where(np.random.default_rng(1).random(on.size) < 0.2, 1.0 - on, on),
}


@pytest.mark.parametrize("what", MUTE)
def test_a_switch_that_the_load_contradicts_is_looked_at_and_nothing_is_named(what: str) -> None:
    """Of a switch that was 1 throughout, a heat of the current was named with 0.83."""
    trace = plant(7, days=3, period=ROW_S)
    mute = with_column(trace, SWITCH, MUTE[what](trace.signals[SWITCH]))
    said = diagnose(model(), [mute], seed=0, roles=ROLES).diagnosis
    assert said.verdict == "too-little-data" and not said.effects
    assert said.reasons == ("MarciaDecanter does not say when the machine runs, and Assorbimento does",)
    assert ("is 1 in every row" in said.sentence) == (what == "always 1")
    assert "look at that signal" in said.sentence and "°C" not in said.reasons[0]


def test_a_machine_that_runs_on_or_idles_or_is_read_a_little_late_has_no_mute_switch() -> None:
    trace, on = plant(7, days=3, period=ROW_S), plant(4, days=2, runs_on=True, period=ROW_S)
    rows = np.arange(on.times.size)
    broken = np.where(np.random.default_rng(1).random(trace.times.size) < 0.1, 0.0, trace.signals[SWITCH])
    for one in (
        trace,
        on,
        with_column(on, LOAD, np.where(rows // 30 % 3 == 0, 0.0, on.signals[LOAD])),
        with_column(trace, LOAD, np.full(trace.times.size, 150.0)),
        with_column(trace, LOAD, np.full(trace.times.size, np.nan)),
        with_column(trace, SWITCH, broken),
        with_column(trace, SWITCH, np.r_[np.zeros(3), trace.signals[SWITCH][:-3]]),
    ):
        assert found(one) is None


def chattering(trace: Trace) -> ChatteringSwitch | None:
    return find_chatter(build_layout(model(), [trace], [], ROLES, RULES), RULES)


def with_turns(trace: Trace, share: float) -> Trace:
    """The trace with so many of its rows, each by itself and with rows of one load beside it, turned."""
    rows = np.random.default_rng(1).random(trace.times.size) < share
    on = trace.signals[SWITCH]
    rows[1:] &= ~rows[:-1]
    rows[[0, -1]] = False
    rows[1:-1] &= (on[1:-1] == on[:-2]) & (on[1:-1] == on[2:])
    return with_column(trace, SWITCH, np.where(rows, 1.0 - on, on))


def test_single_rows_of_a_switch_are_what_the_load_says() -> None:
    trace = plant(4, days=2, pump=1e-4, runs_on=True, period=ROW_S)
    turned = with_turns(trace, 0.02)
    count = int((turned.signals[SWITCH] != trace.signals[SWITCH]).sum())
    chatter = chattering(turned)
    assert count > 5 and chatter is not None and chatter.rows == count
    np.testing.assert_array_equal(chatter.settle(turned, RULES).signals[SWITCH], trace.signals[SWITCH])
    assert chatter.settle(trace, RULES) is trace


def test_a_switch_that_chatters_brings_no_name() -> None:
    """Each turn had the model enter its lower bin until the load moved again, and what explained that hid the pump."""
    trace = plant(4, days=2, pump=1e-4, runs_on=True, period=ROW_S)
    others = {entry.name for entry in catalogue()} - {"pump-cooling", "current-heating"}
    turned = with_turns(trace, 0.02)
    said = diagnose(model(), [turned], seed=0, roles=ROLES, most=1, without=others).diagnosis
    assert [effect.name for effect in said.effects] == ["pump-cooling"]
    assert "single rows while Assorbimento did not: look at that signal" in said.sentence


def test_starts_and_stops_that_the_load_shows_or_lags_behind_are_no_chatter() -> None:
    trace = plant(7, days=3, period=ROW_S)
    on, load = trace.signals[SWITCH], trace.signals[LOAD]
    middle = int(np.flatnonzero((on[1:-1] > 0) & (on[:-2] > 0) & (on[2:] > 0))[20]) + 1
    stopped = np.where(np.arange(on.size) == middle, 0.0, 1.0)
    brief = with_column(trace, SWITCH, on * stopped)
    for one in (
        trace,
        with_column(trace, SWITCH, np.r_[np.zeros(3), on[:-3]]),
        with_column(brief, LOAD, load * stopped),
        with_column(brief, LOAD, load * np.r_[1.0, stopped[:-1]]),
        with_column(trace, LOAD, np.full(on.size, np.nan)),
    ):
        assert chattering(one) is None
