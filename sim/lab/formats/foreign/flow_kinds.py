"""Between an equation and a flow of the library: which kind it is, with which constants, or why it is none of them."""

import re
from fractions import Fraction

from sim.files import ArtefactError
from sim.lab.formats.foreign.flow_file import AGE, FUNCTIONS, PARAMETER, Equation, decay_rate, parse_equation
from sim.lab.formats.foreign.polynomial import Monomial, Polynomial, scale, term_text
from sim.sha import FLOWS, Flow, Input

FLOW_LIBRARY_TEXT = f"the flow library has {', '.join(FLOWS)}"


def recognise_flow(equation: Equation, noise: float = 0.0) -> Flow:
    """The flow that the equation describes, with `noise` (degC/sqrt(s)), which no equation carries.

    A parameter that the equation fixes to a number becomes the flow's constant `m`. Raises ArtefactError, naming the
    term, where no kind of the library fits.
    """
    if not _is_constant(equation.denominator):
        return _logarithmic(equation, noise)
    if any(decay_rate(name) for monomial in equation.numerator for name, _ in monomial):
        return _transient(equation, noise)
    # Every term above the first degree is refused by what it is.
    for monomial in equation.numerator:
        powers = dict(monomial)
        total = sum(powers.values())
        if total <= 1:
            continue
        order = {2: "quadratic", 3: "cubic"}.get(total, "of higher degree")
        if set(powers) == {equation.state}:
            what = f"{order} in the state"
        elif equation.state in powers:
            what = "a product of the state with another variable"
        else:
            what = f"{order} in other variables than the state"
        raise ArtefactError(f"the term {term_text(monomial)} is {what}; {FLOW_LIBRARY_TEXT}")
    rate = -equation.numerator.get(((equation.state, 1),), Fraction(0))
    if rate < 0:
        raise ArtefactError(
            f"{equation.state} has the positive coefficient {float(-rate):g}, so it would grow without bound; "
            "an exponential flow needs a negative one"
        )
    return _relaxing_flow(equation, rate, noise) if rate else _drift_flow(equation, noise)


def _is_constant(polynomial: Polynomial) -> bool:
    return polynomial.keys() <= {()}


def _signals(equation: Equation) -> list[str]:
    """The first-degree variables that are neither the state nor the mode parameter, in alphabetical order."""
    names = {monomial[0][0] for monomial in equation.numerator if monomial}
    return sorted(names - {equation.state, PARAMETER})


def _drift_flow(equation: Equation, noise: float) -> Flow:
    signals = _signals(equation)
    if signals:
        raise ArtefactError(
            f"the term {signals[0]} moves {equation.state} without pulling it back (no term -{equation.state}); only a "
            f"driven flow takes signals; {FLOW_LIBRARY_TEXT}"
        )
    fixed = equation.numerator.get((), Fraction(0))
    share = equation.numerator.get(((PARAMETER, 1),), Fraction(0))
    if share not in (0, 1) or (share and fixed):
        raise ArtefactError(f"a linear flow's drift must be {PARAMETER} itself; {FLOW_LIBRARY_TEXT}")
    if share:
        return Flow("linear", {"noise": noise})
    return Flow("linear", {"m": float(fixed), "noise": noise}) if fixed else Flow("constant", {"noise": noise})


def _relaxing_flow(equation: Equation, rate: Fraction, noise: float) -> Flow:
    """k (m + sum of gain (signal - reference) - x), all from the expanded terms, exactly."""
    gains = {name: equation.numerator[((name, 1),)] / rate for name in _signals(equation)}
    references = {name: equation.references.get(name, Fraction(0)) for name in gains}
    share = equation.numerator.get(((PARAMETER, 1),), Fraction(0)) / rate
    rest = equation.numerator.get((), Fraction(0)) / rate
    rest += sum((gains[name] * references[name] for name in gains), Fraction(0))
    if share not in (0, 1) or (share and rest):
        raise ArtefactError(
            f"{PARAMETER} must be the target itself, as in k ({PARAMETER} - {equation.state}); here the target is "
            f"{float(share):g} {PARAMETER} + {float(rest):g}"
        )
    inputs = tuple(Input(name, float(gains[name]), float(references[name])) for name in gains)
    constants = {"k": float(rate), "noise": noise} | ({} if share else {"m": float(rest)})
    return Flow("driven" if inputs else "exponential", constants, inputs)


def _logarithmic(equation: Equation, noise: float) -> Flow:
    """a / (t0 + u), the drift that falls with the time since entry."""
    slope = equation.denominator.get(((AGE, 1),), Fraction(0))
    if not slope or not equation.denominator.keys() <= {(), ((AGE, 1),)}:
        shape = " + ".join(term_text(monomial) for monomial in equation.denominator)
        raise ArtefactError(
            f"the denominator has the terms {shape}; only t0 + {AGE}, {AGE} being the seconds since entry, is known "
            f"(logarithmic); {FLOW_LIBRARY_TEXT}"
        )
    start = equation.denominator.get((), Fraction(0)) / slope
    top = scale(1 / slope, equation.numerator)
    if start <= 0:
        raise ArtefactError(f"t0 is {float(start):g}, so the drift has no bound at entry; t0 must be positive")
    parameter: Monomial = ((PARAMETER, 1),)
    if top == {parameter: Fraction(1)}:
        return Flow("logarithmic", {"t0": float(start), "noise": noise})
    if _is_constant(top):
        return Flow("logarithmic", {"t0": float(start), "m": float(top.get((), Fraction(0))), "noise": noise})
    shape = " + ".join(f"{float(value):g} {term_text(monomial)}" for monomial, value in top.items())
    raise ArtefactError(f"over t0 + {AGE} stands {shape}; a logarithmic flow has {PARAMETER} or a number there")


def _transient(equation: Equation, noise: float) -> Flow:
    """a / tau exp(-u / tau), the drift that is over some tau after entry: X moves by a in all."""
    shape = " + ".join(f"{float(value):g} {term_text(monomial)}" for monomial, value in equation.numerator.items())
    if len(equation.numerator) == 1:
        (monomial, value), *_ = equation.numerator.items()
        powers = dict(monomial)
        fades = next(name for name in powers if decay_rate(name))
        rate = decay_rate(fades)
        if rate and powers == {fades: 1}:
            return Flow("transient", {"tau": float(1 / rate), "m": float(value / rate), "noise": noise})
        if rate and powers == {fades: 1, PARAMETER: 1} and value == rate:
            return Flow("transient", {"tau": float(1 / rate), "noise": noise})
    raise ArtefactError(
        f"the terms are {shape}; a transient flow has {PARAMETER} or a number, "
        f"times exp(-{AGE} / tau) / tau, and no more"
    )


def equation_text(flow: Flow, state: str) -> str:
    """The flow's equation for the state variable, in the form that `recognise_flow` gives back. Raises
    ArtefactError."""
    parameter, x = number_text(flow.params["m"]) if "m" in flow.params else PARAMETER, quote_name(state)
    if flow.kind == "constant":
        right = "0"
    elif flow.kind == "linear":
        right = parameter
    elif flow.kind == "logarithmic":
        right = f"{parameter} / ({number_text(flow.params['t0'])} + {AGE})"
    elif flow.kind == "transient":
        tau = number_text(flow.params["tau"])
        right = f"{parameter} exp(-{AGE} / {tau}) / {tau}"
    elif flow.kind in ("exponential", "driven"):
        signals = "".join(
            f" + {number_text(driving.gain)} ({quote_name(driving.signal)} - {number_text(driving.reference)})"
            for driving in flow.inputs
        )
        right = f"{number_text(flow.params['k'])} ({parameter}{signals} - {x})"
    else:
        raise ArtefactError(f"flow {flow.kind!r} has no equation; {FLOW_LIBRARY_TEXT}")
    return f"({x})' = {right}"


def quote_name(name: str) -> str:
    """The name as an equation can have it: in backquotes unless it is a plain word. Raises ArtefactError."""
    if not name or name in (PARAMETER, AGE) or name != name.strip() or "`" in name or not name.isprintable():
        raise ArtefactError(
            f"{name!r} cannot be a variable of an equation: {PARAMETER} and {AGE} have a meaning of their own, and "
            "blanks at the ends, backquotes and control characters cannot be written; rename the signal"
        )
    plain = re.fullmatch(r"[^\W\d][\w.]*", name) and name.lower() not in (*FUNCTIONS, "nan", "inf", "infinity")
    return name if plain else f"`{name}`"


def number_text(value: float) -> str:
    """The shortest decimal that reads back as the same float."""
    return repr(float(value))


def same_equation(flow: Flow, equation: Equation) -> bool:
    """True when the flow's own equation and the given one are the same function (both exact)."""
    own = parse_equation(equation_text(flow, equation.state))
    return own.numerator == equation.numerator and own.denominator == equation.denominator
