"""A kind of effect from an engineer's line: everything that an engine needs follows from the expression.

What a line may say is checked here, once: its heat must be finite for whatever a sensor reads, proportional to its
strength, and straight in the temperature, which it must not drive away.
"""

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product
from math import inf, isfinite

import numpy as np

from sim.effects.expressed import SCALE, SHIFT, SINCE, TEMPERATURE, compile_held_heat
from sim.effects.expression import (
    FUNCTIONS_OF_A_LINE,
    Expression,
    ExpressionError,
    ExpressionNumber,
    Interval,
    bounds,
    compile_expression,
    crossings,
    derivative,
    names,
    parse,
    problem,
    substitute,
    uppaal_text,
)
from sim.effects.kind import (
    EffectCandidate,
    EffectKind,
    MachineLog,
    Parameter,
    Params,
    Role,
    Roles,
    TextLaw,
    TextWriter,
    VaryingBound,
    VaryingLaw,
)
from sim.effects.roles import TO_SCALE_OF_X
from sim.sha import Array, Effect, EffectLine, LineParameter

MOST_TRIED, SPREAD = 64, 4
"""Sets of values from which a diagnosis begins at most, and values over a range where a line gives none."""
LOG_SEARCH_RATIO = 20.0
"""A positive range whose ends differ by so many times is searched by factors."""
RESERVED_NAMES = (TEMPERATURE, SINCE, SCALE, SHIFT, *FUNCTIONS_OF_A_LINE)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,29}")
_EFFECT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,49}")
NO_START_S = 1e8
"""Seconds from which on no start was seen: a record writes a number there, and the engines infinity."""
_START_AGES_S: Array = np.concatenate([[0.0], np.geomspace(1.0, 1e6, 84)])
"""Seconds since a start at which a varying line is cut."""


class LineError(ValueError):
    """What is wrong with a line, and under which `key` of it that stands."""

    def __init__(self, key: str, sentence: str) -> None:
        super().__init__(f"{key}: {sentence}")
        self.key, self.sentence = key, sentence


@lru_cache(maxsize=256)
def kind_of_line(line: EffectLine) -> EffectKind:
    """The kind that a line stands for. Raises LineError with the key, the reason and what would be right."""
    tree = _tree(line)
    ranges: dict[str, Interval] = {each.name: _interval(each.low, each.high) for each in line.parameters}
    ranges |= {role: _interval(-inf, inf) for role, _ in line.signals}
    ranges |= {TEMPERATURE: _interval(-inf, inf), SINCE: _interval(0.0, inf)}
    if wrong := problem(tree, ranges):
        raise LineError("heat", f"{wrong}; narrow the parameters' low and high, or write max(..., 0) or the like")
    _check_strength(line, tree)
    varying = SINCE in names(tree)
    losing = TEMPERATURE in names(tree)
    if losing:
        slope = derivative(tree, TEMPERATURE)
        if TEMPERATURE in names(slope):
            raise LineError(
                "heat", "it bends with the temperature; a line is straight in it, such as loss * (sink - temperature)"
            )
        if not bool(np.all(bounds(slope, ranges)[1] <= 0)):
            raise LineError(
                "heat",
                "it may grow with the temperature, and the machine would run away; give the strength low = 0 and "
                "write max(..., 0) around a signal that multiplies the temperature",
            )
    if varying:
        _check_variation(line, tree, ranges)
    elif not line.signals:
        raise LineError("signals", "the heat reads no signal: a constant is in the model's own parameters already")
    parameters = {
        each.name: Parameter(
            unit=each.unit,
            low=each.low,
            high=each.high,
            # Beside a temperature the two last parameters carry the whole line to another scale.
            rescaled="scaled" if each.name == line.strength and not losing else "stays",
        )
        for each in line.parameters
    }
    if varying:
        return EffectKind(
            name=line.name,
            meaning=line.meaning,
            acts=line.acts,
            candidate=_candidate(line),
            parameters=parameters,
            roles=Roles(),
            law=_varying_law(tree),
            bound=VaryingBound(extremes=lambda effect, _: _extremes(tree, effect.params)),
            uppaal=TextLaw(lambda writer, effect: _varying_text(tree, writer, effect)),
        )
    return EffectKind(
        name=line.name,
        meaning=line.meaning,
        acts=line.acts,
        candidate=_candidate(line),
        parameters=parameters | (TO_SCALE_OF_X if losing else {}),
        roles=Roles(needed=tuple(Role(role, signal) for role, signal in line.signals)),
        **compile_held_heat(line.heat),
    )


def _interval(low: float, high: float) -> Interval:
    return np.asarray(low, dtype=float), np.asarray(high, dtype=float)


# ------------------------------------------------------------------ what a line may say


def _tree(line: EffectLine) -> Expression:
    """The parsed heat of a line whose names are all known and all used."""
    if not _EFFECT_NAME.fullmatch(line.name):
        raise LineError(
            "name", f"{line.name[:60]!r} is no name; give letters, digits, - and _, such as 'slurry-coupling'"
        )
    for key, text in (("meaning", line.meaning), ("experiment", line.experiment)):
        if not text.strip():
            raise LineError(key, "it is empty; give one phrase in the plant's words")
    given = [(f"signals.{role}", role) for role, _ in line.signals]
    given += [(f"parameters.{each.name}", each.name) for each in line.parameters]
    for place, (key, name) in enumerate(given):
        if not _NAME.fullmatch(name) or name in RESERVED_NAMES:
            reason = (
                "has a meaning of its own in a line" if name in RESERVED_NAMES else "is no name (letters, digits and _)"
            )
            raise LineError(key, f"{name[:40]!r} {reason}; give it another one")
        if name in [other for _, other in given[:place]]:
            raise LineError(key, f"{name!r} is the name of a signal too; give one of them another name")
    for each in line.parameters:
        _check_parameter(line, each)
    try:
        tree = parse(line.heat)
    except ExpressionError as error:
        raise LineError("heat", str(error)) from None
    known = [name for _, name in given]
    for name in names(tree):
        if name not in known and name not in (TEMPERATURE, SINCE):
            raise LineError(
                "heat",
                f"{name!r} is neither a signal nor a parameter of this effect; it has "
                f"{', '.join([*known, TEMPERATURE, SINCE])}",
            )
    for key, name in given:
        if name not in names(tree):
            raise LineError(key, "the heat does not read it; take it out, or write it into the heat")
    return tree


def _check_parameter(line: EffectLine, each: LineParameter) -> None:
    key = f"parameters.{each.name}"
    if not each.low < each.high:
        raise LineError(key, f"low {each.low:g} must lie below high {each.high:g}")
    outside = [value for value in each.tried if not each.low <= value <= each.high]
    if outside:
        raise LineError(key, f"try has {outside[0]:g}, which lies outside of low {each.low:g} to high {each.high:g}")
    if each.usual and each.usual not in [role for role, _ in line.signals]:
        raise LineError(key, f"usual names {each.usual!r}, which is no signal of this effect")
    if each.usual and each.tried:
        raise LineError(key, "give either try or usual")
    if each.name == line.strength and (each.usual or each.tried):
        raise LineError(key, "the strength is found by the fit; leave out try and usual")
    if each.name != line.strength and not (each.tried or each.usual or (isfinite(each.low) and isfinite(each.high))):
        raise LineError(
            key, "nothing says where to look for it; give low and high, or try = [...], or usual = a signal"
        )


def _check_strength(line: EffectLine, tree: Expression) -> None:
    if line.strength not in [each.name for each in line.parameters]:
        raise LineError("strength", f"{line.strength!r} is no parameter of this effect")
    slope = derivative(tree, line.strength)
    if line.strength in names(slope) or substitute(tree, line.strength, ExpressionNumber(0.0)) != ExpressionNumber(0.0):
        raise LineError("heat", f"it is not proportional to {line.strength!r}; write {line.strength} * (...)")
    count = int(
        np.prod(
            [
                len(each.tried) or (1 if each.usual else SPREAD)
                for each in line.parameters[:20]
                if each.name != line.strength
            ]
            or [1]
        )
    )
    if count > MOST_TRIED:
        raise LineError(
            "parameters", f"{count} sets of values would be tried, {MOST_TRIED} are the most; give fewer in try"
        )


def _check_variation(line: EffectLine, tree: Expression, ranges: dict[str, Interval]) -> None:
    if line.signals or TEMPERATURE in names(tree):
        raise LineError(
            "heat", "it reads both `since` and something measured, which no engine has yet; give one of them"
        )
    low, high = bounds(tree, {**ranges, line.strength: _interval(1.0, 1.0)})
    if not (np.isfinite(low) and np.isfinite(high)):
        raise LineError(
            "heat", "it has no bound as `since` grows; write min(since, 3600) or exp(-since / tau) with low and high"
        )


# ------------------------------------------------------------------ how a diagnosis looks for it


def _candidate(line: EffectLine) -> EffectCandidate:
    strength = next(each for each in line.parameters if each.name == line.strength)
    others = [each for each in line.parameters if each.name != line.strength]
    searched = [each for each in others if isfinite(each.low) and isfinite(each.high)]
    return EffectCandidate(
        strength=line.strength,
        sign=1.0 if strength.low >= 0 else -1.0 if strength.high <= 0 else 0.0,
        experiment=line.experiment,
        look=line.look,
        shapes=_shapes(others, line.acts == "running"),
        refine={each.name: (each.low, each.high) for each in searched},
        widths={each.name: (each.high - each.low) / 8.0 for each in searched},
    )


def _shapes(others: Sequence[LineParameter], running: bool) -> Callable[[MachineLog], Sequence[Params]]:
    def try_values(each: LineParameter, log: MachineLog) -> tuple[float, ...]:
        if each.usual:
            return (float(np.clip(log.usual(each.usual, running=running), each.low, each.high)),)
        if each.tried:
            return each.tried
        if each.low > 0 and each.high >= LOG_SEARCH_RATIO * each.low:
            return tuple(np.geomspace(each.low, each.high, 2 * SPREAD + 1)[1::2].tolist())
        return tuple(np.linspace(each.low, each.high, 2 * SPREAD + 1)[1::2].tolist())

    def shapes(log: MachineLog) -> Sequence[Params]:
        choices = product(*(try_values(each, log) for each in others))
        return [dict(zip((each.name for each in others), values, strict=True)) for values in choices]

    return shapes


# ------------------------------------------------------------------ heats that vary since a start


def _varying_law(tree: Expression) -> VaryingLaw:
    value = compile_expression(tree)
    slope = compile_expression(derivative(tree, SINCE))
    bends = tuple(compile_expression(each) for each in crossings(tree) if SINCE in names(each))

    def heat(effect: Effect, _time: Array, since: Array) -> Array:
        begun = since < NO_START_S
        age = np.where(begun, np.maximum(since, 0.0), 0.0)
        return np.where(begun, value({**effect.params, SINCE: age}), 0.0)

    def knots(effect: Effect, starts: Array) -> Array:
        if not starts.size:
            return starts
        ages = np.concatenate([_START_AGES_S[1:], *(_zeros(bend, effect.params) for bend in bends)])
        times = starts[:, None] + np.sort(ages)
        # What lies beyond the next start is of no use: there the clock begins anew.
        return np.asarray(times[times < np.append(starts[1:], np.inf)[:, None]])

    def speed(effect: Effect) -> float:
        values: dict[str, Array | float] = {**effect.params, SINCE: _START_AGES_S[1:]}
        with np.errstate(all="ignore"):
            steepest = float(np.nanmax(np.abs(np.broadcast_to(slope(values), _START_AGES_S[1:].shape))))
            largest = float(np.nanmax(np.abs(np.broadcast_to(value(values), _START_AGES_S[1:].shape))))
        return min(steepest / largest, 1.0) if largest > 0 else 0.0

    return VaryingLaw(heat=heat, knots=knots, speed=speed, from_event=True)


def _zeros(bend: Callable[..., Array], params: Params) -> Array:
    """Where a bend of the law lies (s), to a millisecond, found between the cuts by halving."""
    signs = np.sign(np.broadcast_to(bend({**params, SINCE: _START_AGES_S}), _START_AGES_S.shape))
    rows = np.flatnonzero(signs[1:] * signs[:-1] < 0)
    low, high, before = _START_AGES_S[rows], _START_AGES_S[rows + 1], signs[rows]
    for _ in range(40):
        middle = 0.5 * (low + high)
        left = np.sign(bend({**params, SINCE: middle})) == before
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    return high


def _extremes(tree: Expression, params: Params) -> tuple[float, float]:
    """Least and greatest heat at any time since a start; 0 before the first one is among them."""
    fixed = {name: _interval(value, value) for name, value in params.items()}
    low, high = bounds(tree, {**fixed, SINCE: (_START_AGES_S, np.append(_START_AGES_S[1:], inf))})
    return min(float(np.min(low)), 0.0), max(float(np.max(high)), 0.0)


def _varying_text(tree: Expression, writer: TextWriter, effect: Effect) -> str:
    begun, clock = writer.since(effect)
    texts = {name: writer.constant(name.upper(), value) for name, value in effect.params.items()}
    return f" + {begun} * {uppaal_text(tree, {**texts, SINCE: clock}, lambda value: writer.constant('NUMBER', value))}"
