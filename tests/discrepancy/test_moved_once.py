"""A signal that moved once tells of a moment, and of all that happened then: by it alone no cause is named."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import build_record
from sim.lab.discrepancy.judging import only_move
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from sim.sha import Array, Trace
from tests.discrepancy.plants import model, plant

ROW_S = 240.0
SIGNALS = {"vibration": "LivelloVibrazioni", "torque": "Coppia", "speed": "Differenziale"}


def with_column(trace: Trace, name: str, column: Array) -> Trace:
    return replace(trace, signals={**trace.signals, name: column}, events=())


def step(share: float, size: int) -> Array:
    return np.where(np.arange(size) < share * size, 20.0, 45.0)


@pytest.mark.parametrize("role", SIGNALS)
def test_no_cause_is_named_by_a_signal_that_moved_once(role: str) -> None:
    """A part was exchanged when somebody set another speed: friction by the speed was named, with 0.83."""
    trace = plant(3, days=3, exchanged=0.08, period=ROW_S)
    moved = with_column(trace, SIGNALS[role], step(0.5, trace.times.size) * trace.signals["MarciaDecanter"])
    said = diagnose(model(), [moved], seed=0, roles={role: SIGNALS[role]}, most=1).diagnosis
    assert said.verdict == "unexplained" and said.began is not None
    assert any(f"rests on the one time that {SIGNALS[role]} moved while the machine ran, 2023-11-16" in reason
               for reason in said.reasons)  # fmt: skip


def test_one_that_moves_again_is_named_by() -> None:
    def by_half_days(times: Array, on: Array, _: Array) -> tuple[Array, Array]:
        return 1.5e-3 * on * ((times - 1.7e9) % 86400 < 43200), 0.0 * on

    trace = plant(3, days=3, period=ROW_S, more=by_half_days)
    torque = (20.0 + 25.0 * ((trace.times - 1.7e9) % 86400 < 43200)) * trace.signals["MarciaDecanter"]
    roles = {"torque": "Coppia"}
    said = diagnose(model(), [with_column(trace, "Coppia", torque)], seed=0, roles=roles, most=1).diagnosis
    assert [effect.name for effect in said.effects] == ["torque-friction"]


MOVES: dict[str, tuple[Callable[[np.random.Generator, int], Array], bool]] = {
    "up": (lambda _, n: step(0.4, n), True),
    "down": (lambda _, n: -step(0.7, n), True),
    "with noise": (lambda rng, n: step(0.4, n) + 2.0 * rng.standard_normal(n), True),
    "never": (lambda _, n: np.full(n, 20.0), False),
    "never read": (lambda _, n: np.full(n, np.nan), False),
    "a ramp": (lambda _, n: np.linspace(0.0, 1.0, n), False),
    "noise alone": (lambda rng, n: rng.standard_normal(n), False),
    "up and down": (lambda _, n: np.abs(step(0.3, n) - step(0.8, n)), False),
    "up, and back and forth at the end": (
        lambda _, n: np.where((np.arange(n) > 0.96 * n) & (np.arange(n) // 8 % 2 == 0), 20.0, step(0.5, n)),
        False,
    ),
}


@pytest.mark.parametrize("how", MOVES)
def test_one_step_is_one_move_and_nothing_else_is(how: str) -> None:
    trace = plant(4, days=2, runs_on=True, period=ROW_S)
    column, once = MOVES[how]
    trace = with_column(trace, "Coppia", column(np.random.default_rng(1), trace.times.size))
    record = build_record(model(), [replace(trace, events=plant(4, days=2, runs_on=True, period=ROW_S).events)],
                          ("Coppia",))  # fmt: skip
    assert (only_move(record, "Coppia", RULES) is not None) is once
