"""A fault of the program is said as one, with exit code 1; input that cannot be used is a sentence with exit code 2."""

from collections.abc import Callable

import click
import numpy as np
import pytest
import scipy.linalg

from gateway.entry import Exit, sentences
from gateway.lab.checking import simulate
from sim.lab.discrepancy.fitting.record import RecordFault
from sim.lab.learning import LearningError
from sim.sha import Trace
from tests.rig.pair import known_model


def too_many_values() -> None:
    np.zeros(3)[np.array([True, True, False])] = np.ones(3)


def other_shapes() -> None:
    np.zeros(3) + np.zeros(4)


def singular() -> None:
    np.linalg.inv(np.zeros((2, 2)))


def indefinite() -> None:
    scipy.linalg.cho_factor(-np.eye(2))


def not_finite() -> None:
    scipy.linalg.cho_factor(np.full((2, 2), np.nan))


def of_nothing() -> None:
    np.quantile(np.empty(0), 0.5)


def lengths() -> None:
    list(zip(np.zeros(2), np.zeros(3), strict=True))


def invariant() -> None:
    raise RecordFault("a record in which this does not hold: every run has a window")


@pytest.mark.parametrize(
    "fault", [too_many_values, other_shapes, singular, indefinite, not_finite, of_nothing, lengths, invariant]
)
def test_what_the_libraries_raise_is_a_fault_of_the_program(
    fault: Callable[[], None], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left, sentences():
        fault()
    said = capsys.readouterr().err
    assert left.value.code == Exit.FAULT == 1
    assert "a fault of the program, not of what it was given" in said and "--traceback" in said
    assert f"in {__name__}, line {fault.__code__.co_firstlineno + 1}" in said


def refused() -> None:
    raise ValueError("give another one")


def unlearnable() -> None:
    raise LearningError("nothing can be fitted")


def unreadable() -> None:
    try:
        float("eleven")
    except ValueError as error:
        raise ValueError(f"'eleven' is no number: {error}") from error


@pytest.mark.parametrize("refusal", [refused, unlearnable, unreadable])
def test_what_our_own_code_refuses_is_input(refusal: Callable[[], None], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left, sentences():
        refusal()
    assert left.value.code == Exit.USAGE
    assert "fault" not in capsys.readouterr().err


def test_where_a_fault_arose_is_shown_on_request() -> None:
    with click.Context(click.Command("decanter")) as context:
        context.params["traceback"] = True
        with pytest.raises(ValueError, match="cannot assign"), sentences():
            too_many_values()


def test_a_fault_that_costs_one_trace_of_several_is_told_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate, "_simulate_one", lambda *_, **__: too_many_values())
    trace = Trace("one", np.arange(3.0), {})
    (row,) = simulate.simulate_traces(
        known_model(),
        [trace],
        runs=1,
        policy="reject",
        start="measured",
        seed=0,
        picture=None,
        report=lambda *_: None,
    )
    assert row["trace"] == "one" and row["error"].startswith("a fault of the program, not of what it was given")
