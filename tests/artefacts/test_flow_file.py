"""The flows' equations: read, understood as flows of the library or refused, written again."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.files import ArtefactError
from sim.lab.formats.foreign.flow_file import flow_file_text, parse_equation, parse_flow_file
from sim.lab.formats.foreign.flow_kinds import equation_text, recognise_flow, same_equation
from sim.sha.automaton import Flow, Input
from tests.artefacts.models import flows, numbers


def exponential(k: float, m: float) -> Flow:
    return Flow("exponential", {"k": k, "m": m, "noise": 0.0})


@pytest.mark.parametrize(
    ("text", "flow"),
    [
        ("(x0)' = -0.003 x0", exponential(0.003, 0.0)),
        ("(x0)' = 0.004 1 + -0.004 x0", exponential(0.004, 1.0)),
        ("F'==-0.003*F", exponential(0.003, 0.0)),
        ("F'==0.004*1-0.004*F", exponential(0.004, 1.0)),
        ("T' = -1e-5*(T - 20)", exponential(1e-05, 20.0)),
        ("(T)' = (50 - T) / 250", exponential(0.004, 50.0)),
        ("(T)' = 0.1 m - 0.1 T", Flow("exponential", {"k": 0.1, "noise": 0.0})),
        ("(x0)' = 0.000", Flow("constant", {"noise": 0.0})),
        ("(x0)' = 0.002 1", Flow("linear", {"m": 0.002, "noise": 0.0})),
        ("(x0)' = m", Flow("linear", {"noise": 0.0})),
        ("(x0)' = m exp(-u / 8.0) / 8.0", Flow("transient", {"tau": 8.0, "noise": 0.0})),
        ("x0' == -0.25*exp(-0.5*u)", Flow("transient", {"tau": 2.0, "m": -0.5, "noise": 0.0})),
        ("(x0)' = 2 / (3 + 4 u)", Flow("logarithmic", {"t0": 0.75, "m": 0.5, "noise": 0.0})),
        (
            "(T)' = 1.0 1 - 0.5 T + 0.25 S",
            Flow("driven", {"k": 0.5, "m": 2.0, "noise": 0.0}, (Input("S", 0.5, 0.0),)),
        ),
        (
            "(T)' = 0.5 (m + 0.1 (A - 150) - T)",
            Flow("driven", {"k": 0.5, "noise": 0.0}, (Input("A", 0.1, 150.0),)),
        ),
    ],
)
def test_an_equation_is_the_flow_of_the_library_that_it_describes(text: str, flow: Flow) -> None:
    assert recognise_flow(parse_equation(text)) == flow


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(P)' = 1.0 1 + 0.4 P + -0.2 P^2", "the term P^2 is quadratic in the state; the flow library has constant"),
        ("(P)' = 1.0 1 + 0.001 P S", "the term P S is a product of the state with another variable"),
        ("(P)' = -1 P + 0.1 S^2", "the term S^2 is quadratic in other variables"),
        ("(P)' = -1 P^3", "cubic in the state"),
        ("(P)' = 0.4 P", "would grow without bound"),
        ("(P)' = 0.1 S", "without pulling it back"),
        ("(P)' = 2 m", "drift must be m itself"),
        ("(P)' = 0.1 m - 0.2 P", "here the target is 0.5 m + 0"),
        ("(P)' = 1 / (3 + P)", "only t0 + u"),
        ("(P)' = 1 / u", "t0 must be positive"),
        ("(P)' = exp(u / 5)", "exp is known of -u / tau alone"),
        ("(P)' = exp(-u^2)", "exp is known of -u / tau alone"),
        ("(P)' = exp", "exp is known of -u / tau alone"),
        ("(P)' = 2 m exp(-u / 5)", "times exp(-u / tau) / tau, and no more"),
        ("(P)' = 1 + exp(-u / 5)", "times exp(-u / tau) / tau, and no more"),
        ("(P)' = P exp(-u / 5)", "times exp(-u / tau) / tau, and no more"),
        ("(P)' = u / (3 + u)", "over t0 + u stands 1 u"),
    ],
)
def test_an_equation_that_no_flow_fits_is_refused_by_the_term(text: str, reason: str) -> None:
    with pytest.raises(ArtefactError) as error:
        recognise_flow(parse_equation(text))
    assert reason in str(error.value)


def test_coefficients_are_exact_and_terms_are_collected() -> None:
    equation = parse_equation("P' == 0.1*P + 0.2*P - 3*(P - 2)**2/2")
    assert {monomial: str(value) for monomial, value in equation.numerator.items()} == {
        (("P", 1),): "63/10",
        (("P", 2),): "-3/2",
        (): "-6",
    }


@settings(max_examples=150)
@given(flows(st.none() | numbers))
def test_every_flow_kind_is_written_and_read_again(flow: Flow) -> None:
    """Exactly, but for what an equation cannot say: no noise, no zero gain, no reference of a zero gain, no order."""
    equation = parse_equation(equation_text(flow, "T"))
    assert same_equation(flow, equation)
    read = recognise_flow(equation, flow.params["noise"])
    seen = tuple(sorted((given for given in flow.inputs if given.gain), key=lambda given: given.signal))
    kind = flow.kind if seen or flow.kind != "driven" else "exponential"
    if flow.kind in ("linear", "transient") and flow.params.get("m") == 0:
        assert read == Flow("constant", {"noise": flow.params["noise"]})
    else:
        assert read == Flow(kind, flow.params, seen)


def test_a_flow_file_is_written_back_as_it_was() -> None:
    text = "0\n(x0)' = -0.003 x0\n13\nF'==0.004*1-0.004*F\n2\n(P)' = 1.0 1 + 0.4 P + -0.2 P^2\n"
    read = parse_flow_file(text)
    assert list(read.equations) == [0, 13, 2]
    assert flow_file_text(read) == text
    assert parse_flow_file(flow_file_text(read)) == read


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("0\n1\n(x)' = 1\n", 2, "unexpected '1'"),
        ("0\n(x)' = 1\n0\n(x)' = 2\n", 3, "flow 0 stands here a second time"),
        ("0\n(x)' = 1\n(y)' = 2\n", 1, "flow 0 has 2 equations (x, y)"),
        ("0\n(x)' = 3 -\n", 2, "ends too early"),
        ("0\n(x)' = nan x\n", 2, "a finite number is needed"),
        ("0\n(x)' = 1e999 x\n", 2, "a finite number is needed"),
        ("0\n(x)' = sin(x)\n", 2, "the function sin"),
        ("0\n(x)' = 1/0\n", 2, "divides by zero"),
        ("0\n(x)[k+1] = 0.9 x[k]\n", 2, None),
        ("0\n(x)[k+1] = 0.9 x\n", 2, "a derivative is needed"),
        ("0\n(x)' = x^99999999\n", 2, "the power 99999999 is above"),
        ("0\n(x)' = (a+b+c+d+e+f+g+h+i+j)^6\n", 2, "more than 500 terms"),
        ("0\n(x)' = " + "(" * 2000 + "x" + ")" * 2000 + "\n", 2, "nested too deeply"),
        ("0\n(x)' = __import__('os')\n", 2, "unexpected"),
    ],
)
def test_what_is_wrong_in_a_flow_file_is_told_with_its_line(text: str, line: int, reason: str | None) -> None:
    with pytest.raises(ArtefactError, match=rf"^f\.txt:{line}: ") as error:
        parse_flow_file(text, "f.txt")
    assert reason is None or reason in str(error.value)


def test_a_signal_that_an_equation_cannot_name_is_refused() -> None:
    flow = Flow("driven", {"k": 1.0, "noise": 0.0}, (Input("motor`current", 1.0),))
    with pytest.raises(ArtefactError, match="'motor`current' cannot be a variable"):
        equation_text(flow, "T")
    with pytest.raises(ArtefactError, match="'m' cannot be a variable"):
        equation_text(Flow("constant", {"noise": 0.0}), "m")


def test_a_signal_with_blanks_and_signs_stands_in_backquotes() -> None:
    flow = Flow("driven", {"k": 1.0, "noise": 0.0}, (Input("Motor current (A)", 2.0, 3.0),))
    text = equation_text(flow, "coolant temp °C")
    assert text == "(`coolant temp °C`)' = 1.0 (m + 2.0 (`Motor current (A)` - 3.0) - `coolant temp °C`)"
    assert recognise_flow(parse_equation(text)) == flow
