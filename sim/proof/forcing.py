"""What the effects do to a location's drift: ranges of heats, losses and sinks, as the signals' ranges allow them.

Heats that read the same signal are bounded together, cell by cell of its range; an expression of several signals, or of
the temperature, by itself. A loss lies between that of the pump's least and greatest value. The housing is as warm as
anything was, a thermostat that may be open or closed does the more.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

import numpy as np

from sim.effects import (
    TEMPERATURE,
    EffectRefusal,
    ExpressedBound,
    Expression,
    Feature,
    LatePart,
    LossBound,
    Structural,
    VaryingBound,
    affects_location,
    cells,
    delay_of,
    effect_kind,
    enclosure,
    heat_lag,
    linear_radiation,
    names_in,
    parameter,
    steepest_loss,
    unknown,
)
from sim.engine import held_terms
from sim.proof.drift import DriftBound, Pair, add_bounds
from sim.sha import FLOWS, RELAXING_FLOWS, SHA, Array, Effect, Flow, Location, Mask, draw_temperature, flows

Range = tuple[float, float]

CELL_COUNT = 32
"""Parts of a signal's range in which the heats that read it are bounded each by itself."""
MAX_RADIATION_K = 1e4
"""Kelvins up to which radiation is bounded closely."""
HEAT_GRID_DEGC: Array = np.arange(-40.0, 261.0, 10.0)
"""degC at which a heat that depends on the temperature is bounded; chords lie between."""
STEEP_LOSS_PER_S = 1e3
"""1/s: how a lower bound falls beyond."""


@dataclass(frozen=True, slots=True)
class Loss:
    """A heat -loss (X - sink), both within ranges (1/s, degC)."""

    loss: Range
    sink: Range


@dataclass(frozen=True, slots=True)
class Forcing:
    """What effects add in one location: `heat` (degC/s), the flow's own inputs among it; `losses`;
    `coupling` (1/s). `written` are the (least, greatest) drifts of expressions that are bounded by themselves.

    `signals` are the values that give the least and the greatest drift, as far as constant ones can. `around` (degC) is
    the range of what is radiated to.

    `coming` (degC) is what may be on its way of all that comes late, wherever the machine was before,
    and `settled` the same where the signals have been as they may be here for ever.
    """

    heat: Range
    signals: tuple[Mapping[str, float], Mapping[str, float]]
    losses: tuple[Loss, ...]
    written: tuple[tuple[DriftBound, DriftBound], ...] = ()
    coupling: float = 0.0
    thermostat: Effect | None = None
    radiation: Effect | None = None
    around: Range = (0.0, 0.0)
    coming: Range = (0.0, 0.0)
    settled: Range = (0.0, 0.0)


class UnboundedEffect(ValueError):
    """An effect of a kind of which no bound is known, so that nothing can be proven of temperatures."""


def location_forcing(
    sha: SHA,
    location: Location,
    m: Range,
    ranges: Callable[[str], Range],
    *,
    everywhere: Callable[[str], Range],
    horizon: float,
    z: float,
) -> Forcing | None:
    """What acts in the location; None where nothing does. `ranges` gives that of each signal that is read there.

    `everywhere` gives a signal's range over all locations, where what comes late may come from. `m` is the range of the
    mode parameter, `horizon` (s) how long wear goes on, `z` how many standard deviations what is random keeps to.
    Raises UnboundedEffect, naming the kind, where an effect cannot be bounded: what is not bounded is never left out.
    """
    heats: list[tuple[Effect, Expression]] = []
    losses: list[tuple[Effect, Loss]] = []
    written: list[tuple[DriftBound, DriftBound]] = []
    told: tuple[dict[str, float], dict[str, float]] = ({}, {})
    features: dict[Feature, Effect] = {}
    coming = settled = (0.0, 0.0)
    least = most = 0.0
    nothing = True
    for effect in sha.effects:
        bound, late = effect_kind(effect).bound, effect_kind(effect).late
        if late is not None and heat_lag(effect) > 0:
            _refuse_late(sha, effect)
            own, anywhere = (_warmth(effect, late, limits) for limits in (ranges, everywhere))
            settled, coming = added_ranges(settled, own), added_ranges(coming, anywhere)
            for side in (0, 1):
                told[side].update({name: ranges(name)[side] for name in effect.signals.values()})
            nothing = False
        match bound:
            case Structural(feature="dead time" | "sensor lag" | "sensor offset"):
                continue  # they move no heat; `bounds` adds them to what the sensor may read
            case ExpressedBound() | LossBound() | VaryingBound() | Structural() if not affects_location(
                effect, location.name
            ):
                continue
            case ExpressedBound(heat=tree):
                if len(effect.signals) == 1 and TEMPERATURE not in names_in(tree):
                    heats.append((effect, tree))
                else:
                    box = {role: ranges(signal) for role, signal in effect.signals.items()}
                    both, ends = _line_heat_bounds(tree, effect, box)
                    written.append(both)
                    for side in (0, 1):
                        told[side].update({effect.signals[role]: value for role, value in ends[side].items()})
            case LossBound():
                # A pump that runs backwards does not warm: its least strength is none.
                pumps = ranges(effect.signals[bound.strength]) if bound.strength in effect.signals else (1.0, 1.0)
                weak, strong = (effect.params["loss"] * max(pump, 0.0) for pump in pumps)
                losses.append((effect, Loss((weak, strong), _temperature(effect, bound.sink, bound.sink, ranges))))
            case VaryingBound():
                low, high = bound.extremes(effect, horizon)
                least, most = least + low, most + high
            case Structural(feature="housing" | "thermostat" | "radiation" as feature):
                features[feature] = effect
            case Structural(feature="disturbance" | "machine offset" as feature):
                # Normal laws have no ends: as of m, so many standard deviations are taken. A flow without a target
                # gathers a disturbance as it gathers noise, which no proof has in it (`bounds.noise_band`).
                if location.flow.kind not in RELAXING_FLOWS:
                    continue
                size = z * effect.params["sigma"]
                size *= location.flow.params["k"] if feature == "machine offset" else 1.0
                least, most = least - size, most + size
            case EffectRefusal(reason=reason):
                raise UnboundedEffect(f"effects of the kind {effect.kind!r} are not bounded: {reason}")
            case _:
                raise UnboundedEffect(str(unknown("the verification", effect.kind, bound)))
        nothing = False
    if nothing:
        return None
    low, high, chosen = _heat_bounds(location.flow, heats, ranges)
    for side in (0, 1):
        chosen[side].update({name: value for name, value in told[side].items() if name not in chosen[side]})
    low, high = low + least, high + most
    for side in (0, 1):
        alone = _alone(location.flow, m, (low, high), side)
        for effect, loss in losses:
            chosen[side].update(_loss_signals(effect, loss.sink, ranges, alone, side))
    radiation, around = features.get("radiation"), (0.0, 0.0)
    if radiation is not None:
        around = _temperature(radiation, "ambient", "surroundings", ranges)
        for name in radiation.signals.values():
            for side in (0, 1):
                chosen[side].setdefault(name, ranges(name)[side])
    housing = features.get("housing")
    return Forcing(
        heat=(low, high),
        signals=chosen,
        losses=tuple(loss for _, loss in losses),
        written=tuple(written),
        coupling=0.0 if housing is None else housing.params["coupling"],
        thermostat=features.get("thermostat"),
        radiation=radiation,
        around=around,
        coming=coming,
        settled=settled,
    )


def drift_bound(flow: Flow, m: Range, forcing: Forcing, *, up: bool, housing: float | None) -> DriftBound:
    """The greatest (`up`) or the least drift in Y = X + what is to come, for a mode parameter within `m`.

    With d late/dt = (source(t - delay) - late) / lag the sum Y of X, lag late and the integral of the source over the
    last `delay` moves as X would if all came at once: what is late has no rate of its own in it, and never adds up. Y
    is X itself where nothing comes late. `housing` (degC) is the highest or lowest Y that there may be; None leaves it
    out.
    """
    side = int(up)
    parts = [_alone(flow, m, forcing.heat, side), *(both[side] for both in forcing.written)]
    for lossy in forcing.losses:
        # Below the sink a loss warms, above it cools: which of its strengths is the bound changes there.
        sink = lossy.sink[side]
        least, most = lossy.loss
        below, above = (most, least) if up else (least, most)
        parts.append(DriftBound((sink,), ((below * sink, below), (above * sink, above))))
    if forcing.coupling and housing is not None:
        # A housing has the mean of what X was, which is Y less what was to come.
        warm = housing - forcing.coming[1 - side]
        parts.append(DriftBound((), ((forcing.coupling * warm, forcing.coupling),)))
    if forcing.thermostat is not None:
        # Open at `opens` and above, closed at `closes` and below, and between the two whichever bounds the drift: it
        # warms where its sink lies above X, so that the sink's place among the thresholds decides.
        p = forcing.thermostat.params
        opens, closes, sink = p["opens"], p["closes"], p["sink"]
        cooled, idle = (p["loss"] * sink, p["loss"]), (0.0, 0.0)
        if not up:
            parts.append(DriftBound((max(closes, sink),), (idle, cooled)))
        elif sink <= closes:
            parts.append(DriftBound((opens,), (idle, cooled)))
        elif sink >= opens:
            parts.append(DriftBound((), (cooled,)))
        else:
            parts.append(DriftBound((sink, opens), (cooled, idle, cooled)))
    if forcing.radiation is not None:
        parts.append(_radiation_bound(forcing.radiation, forcing.around[side], up=up))
    # A drift never rises with X, and X is at least Y less all that may be to come.
    return add_bounds(parts).shift(forcing.coming[side])


def _alone(flow: Flow, m: Range, heat: Range, side: int) -> DriftBound:
    """The flow and the heats without anything lost."""
    if flow.kind in RELAXING_FLOWS:
        return DriftBound((), ((flow.params["k"] * m[side] + heat[side], flow.params["k"]),))
    drive = m[side] if flow.kind == "linear" else 0.0
    if FLOWS[flow.kind].fading is not None:  # it fades from this to 0
        entered = float(flows.drift(flow, 0.0, m[side], 0.0))
        drive = max(entered, 0.0) if side else min(entered, 0.0)
    return DriftBound((), ((drive + heat[side], 0.0),))


# ------------------------------------------------------------------ heats


def _heat_bounds(
    flow: Flow, effects: Sequence[tuple[Effect, Expression]], ranges: Callable[[str], Range]
) -> tuple[float, float, tuple[dict[str, float], dict[str, float]]]:
    """(least heat, greatest heat, the signals' values at either), the flow's inputs taken in."""
    low, high = 0.0, 0.0
    chosen: tuple[dict[str, float], dict[str, float]] = ({}, {})
    read = [driver.signal for driver in flow.inputs]
    read += [signal for effect, _ in effects for signal in effect.signals.values()]
    for name in dict.fromkeys(read):
        readers = [(effect, tree) for effect, tree in effects if name in effect.signals.values()]
        # Cell by cell, because heats that read one signal are not at their worst at different values. In a cell each is
        # enclosed; the flow's own inputs are straight in the signal, so that the ends bound them.
        least, most = ranges(name)
        points = {*np.linspace(least, most, CELL_COUNT + 1).tolist(), *([0.0] if least < 0.0 < most else [])}
        grid = np.array(sorted(points) if most > least else [least, least])
        k = flow.params.get("k", 0.0)
        driven = [k * driver.gain * (grid - driver.reference) for driver in flow.inputs if driver.signal == name]
        total = np.sum([held_terms(effect, {name: grid})[0] for effect, _ in readers] + driven, axis=0)
        inside = [(np.minimum(each[:-1], each[1:]), np.maximum(each[:-1], each[1:])) for each in driven]
        for effect, tree in readers:
            (role,) = effect.signals
            inside.append(enclosure(tree, effect.params, {role: (grid[:-1], grid[1:])}))
        low = low + float(np.min(sum(each[0] for each in inside)))
        high = high + float(np.max(sum(each[1] for each in inside)))
        chosen[0][name], chosen[1][name] = float(grid[total.argmin()]), float(grid[total.argmax()])
    return low, high, chosen


def _refuse_late(sha: SHA, effect: Effect) -> None:
    """Raises UnboundedEffect where the sum of X and what is to come is not moved by the drift alone (`drift_bound`)."""
    drawn = any(draw_temperature(place) is not None for place in sha.locations)
    if drawn or isfinite(sha.max_rate):
        why = "where a location draws the temperature anew" if drawn else "under a greatest rate"
        raise UnboundedEffect(f"effects of the kind {effect.kind!r} are not bounded with a lag {why}")


def _warmth(effect: Effect, late: LatePart, ranges: Callable[[str], Range]) -> Range:
    """degC: lag and delay times the least and greatest source, which is what may be to come where signals are so."""
    box = cells({role: ranges(signal) for role, signal in effect.signals.items()})
    low, high = enclosure(late.heat, effect.params, box)
    seconds = heat_lag(effect) + delay_of(effect)
    return seconds * float(np.min(low)), seconds * float(np.max(high))


def added_ranges(one: Range, other: Range) -> Range:
    """The least and the greatest sum."""
    return one[0] + other[0], one[1] + other[1]


def _line_heat_bounds(
    tree: Expression, effect: Effect, box: Mapping[str, Range]
) -> tuple[tuple[DriftBound, DriftBound], tuple[dict[str, float], dict[str, float]]]:
    """((least, greatest) heat of an expression as bounds in X, the roles' values at either); `box` is by role."""
    parts = cells(box)
    reads = TEMPERATURE in names_in(tree)
    temperatures = HEAT_GRID_DEGC.tolist() if reads else [0.0]
    enclosed = [enclosure(tree, effect.params, parts, x) for x in temperatures]
    lows, highs = (np.array([each[side] for each in enclosed]) for side in (0, 1))
    middle = len(temperatures) // 2
    worst = int(lows[middle].argmin()), int(highs[middle].argmax())
    at_least, at_most = (
        {role: float(0.5 * (low[row] + high[row])) for role, (low, high) in parts.items()} for row in worst
    )
    least, most = lows.min(axis=1), highs.max(axis=1)
    if not reads:
        flat = [DriftBound((), ((float(value[0]), 0.0),)) for value in (least, most)]
        return (flat[0], flat[1]), (at_least, at_most)
    # The heat never grows with X, so that a bound at one temperature holds on one side of it too; where wide cells
    # spoilt that, the better one is taken.
    least, most = np.maximum.accumulate(least[::-1])[::-1], np.minimum.accumulate(most)
    # Of heats that are straight in X the greatest is convex, so that its chords lie above it; the least is concave, so
    # that they lie below. Beyond the points a bound stays as it was or falls by the steepest loss, whichever holds.
    steepest = steepest_loss(tree, effect.params, parts)
    return (_chords(least, 0.0, steepest), _chords(most, steepest, 0.0)), (at_least, at_most)


def _chords(values: Array, before: float, beyond: float) -> DriftBound:
    """The chords between values at HEAT_GRID_DEGC, with the losses (1/s) before the first and beyond the last."""
    losses = [before, *(-np.diff(values) / np.diff(HEAT_GRID_DEGC)).tolist(), beyond]
    anchors = zip([values[0], *values], [HEAT_GRID_DEGC[0], *HEAT_GRID_DEGC], losses, strict=True)
    return DriftBound(
        tuple(HEAT_GRID_DEGC.tolist()), tuple((float(value + loss * x), loss) for value, x, loss in anchors)
    )


# ------------------------------------------------------------------ losses


def _temperature(effect: Effect, role: str, fixed: str, ranges: Callable[[str], Range]) -> Range:
    """The range of a temperature that a signal gives in the scale of X, or the parameter without one."""
    if role not in effect.signals:
        return effect.params[fixed], effect.params[fixed]
    low, high = ranges(effect.signals[role])
    scale, shift = parameter(effect, "scale"), parameter(effect, "shift")
    return scale * low + shift, scale * high + shift


def _loss_signals(
    effect: Effect, sink: Range, ranges: Callable[[str], Range], alone: DriftBound, side: int
) -> dict[str, float]:
    """The values that drive outwards: warm (cold) sinks, and least pumping where the drift `alone` goes beyond them."""
    a, b = alone.find_piece(sink[side])
    outward = (a - b * sink[side]) * (1.0 if side else -1.0) > 0
    bound, values = effect_kind(effect).bound, {}
    for role, signal in effect.signals.items():
        low, high = ranges(signal)
        pumping = max(low if outward else high, 0.0)
        strength = isinstance(bound, LossBound) and role == bound.strength
        values[signal] = pumping if strength else (high if side else low)
    return values


def _radiation_bound(effect: Effect, around: float, *, up: bool) -> DriftBound:
    """Tangents (`up`) or chords of -gain ((X - zero)^4 - (around - zero)^4), which is concave above zero.

    Below the absolute zero of X's scale nothing is radiated. Where the flow has a linear part of it already, what is
    above the surroundings is another such curve, which begins where the first one ends.
    """
    # On a concave curve a tangent is never below it, and a chord never above: upper and lower bounds, both in lines.
    gain, zero = effect.params["gain"], parameter(effect, "zero")
    received = gain * (max(around, zero) - zero) ** 4
    linear, level = linear_radiation(effect)
    bends = max(level - zero, 0.0) if linear else MAX_RADIATION_K
    # Every 2 K, where machines are; beyond that coarser, as nothing real comes there.
    depths = np.concatenate([np.arange(0.0, 900.0, 2.0), np.geomspace(900.0, MAX_RADIATION_K, 200)])
    depths = np.union1d(depths[np.abs(depths - bends) > 1e-3], [bends])
    heats = received - gain * (depths**4 - linear * np.maximum(depths - bends, 0.0))
    if up:
        slopes = 4.0 * gain * depths**3
        whole = _tangents(depths, heats, slopes, depths <= bends, zero)
        bent = _tangents(depths, heats, slopes - gain * linear, depths >= bends, zero)
        falling: list[Pair] = [(received, 0.0), *whole[1:]]
        parts = [_lowest(falling), _lowest(bent)] if linear else [_lowest(falling)]
        knots = [*parts[0][0], *(knot for each in parts[1:] for knot in (bends + zero, *each[0]))]
        return DriftBound(tuple(knots), tuple(line for _, lines in parts for line in lines))
    slopes = np.append(-np.diff(heats) / np.diff(depths), STEEP_LOSS_PER_S)
    lines = np.column_stack([heats + slopes * (depths + zero), slopes])
    return DriftBound(tuple((depths + zero).tolist()), ((received, 0.0), *map(tuple, lines.tolist())))


def _tangents(depths: Array, heats: Array, slopes: Array, those: Mask, zero: float) -> list[Pair]:
    """(heat, loss) of the tangents at `those` depths."""
    lines = np.column_stack([heats + slopes * (depths + zero), slopes])[those]
    return [(heat, loss) for heat, loss in lines.tolist()]


def _lowest(lines: Sequence[Pair]) -> tuple[list[float], list[Pair]]:
    """(knots, lines): the lowest of lines that grow steeper, each from where it meets the one before it."""
    # Where the gain is so small that two are equally steep in floats, the first is enough.
    steeper = [lines[0], *(after for before, after in pairwise(lines) if after[1] > before[1])]
    knots = [(after[0] - before[0]) / (after[1] - before[1]) for before, after in pairwise(steeper)]
    return knots, steeper
