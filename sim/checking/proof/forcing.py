"""What the effects do to a location's drift: ranges of heats, losses and sinks, as the signals' ranges allow them.

Heats that read the same signal are bounded together, cell by cell of its range. A loss lies between that of the pump's
least and greatest value. The housing is as warm as anything was, a thermostat that may be open or closed does the more.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim.checking.proof.drift import DriftBound, Pair, added
from sim.effects import (
    EffectRefusal,
    Feature,
    HeatBound,
    LossBound,
    Structural,
    VaryingBound,
    acts_in,
    kind_of,
    parameter,
    unknown,
)
from sim.engine import held
from sim.sha import FLOWS, RELAXING, SHA, Effect, Flow, Location, flows

Range = tuple[float, float]

CELLS = 32
"""Parts of a signal's range in which the heats that read it are bounded each by itself."""
HOTTEST = 1e4
"""Kelvins up to which radiation is bounded closely."""
STEEP = 1e3
"""1/s: how a lower bound falls beyond."""


@dataclass(frozen=True, slots=True)
class Loss:
    """A heat -loss (X - sink), both within ranges (1/s, degC)."""

    loss: Range
    sink: Range


@dataclass(frozen=True, slots=True)
class Forcing:
    """What effects add in one location: `heat` (degC/s), the flow's own inputs among it; `losses`; `coupling` (1/s).

    `signals` are the values that give the least and the greatest drift, as far as constant ones can. `around` (degC) is
    the range of what is radiated to.
    """

    heat: Range
    signals: tuple[Mapping[str, float], Mapping[str, float]]
    losses: tuple[Loss, ...]
    coupling: float = 0.0
    thermostat: Effect | None = None
    radiation: Effect | None = None
    around: Range = (0.0, 0.0)


class UnboundedEffect(ValueError):
    """An effect of a kind of which no bound is known, so that nothing can be proven of temperatures."""


def forcing_of(
    sha: SHA, location: Location, m: Range, ranges: Callable[[str], Range], *, horizon: float, z: float
) -> Forcing | None:
    """What acts in the location; None where nothing does. `ranges` gives that of each signal that is read there.

    `m` is the range of the mode parameter, `horizon` (s) how long wear goes on, `z` how many standard deviations what
    is random keeps to. Raises UnboundedEffect, naming the kind, where an effect cannot be bounded: what is not bounded
    is never left out.
    """
    heats: list[Effect] = []
    losses: list[tuple[Effect, Loss]] = []
    features: dict[Feature, Effect] = {}
    least = most = 0.0
    nothing = True
    for effect in sha.effects:
        bound = kind_of(effect).bound
        match bound:
            case Structural(feature="dead time" | "sensor lag" | "sensor offset"):
                continue  # they move no heat; `bounds` adds them to what the sensor may read
            case HeatBound() | LossBound() | VaryingBound() | Structural() if not acts_in(effect, location.name):
                continue
            case HeatBound():
                heats.append(effect)
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
                if location.flow.kind not in RELAXING:
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
    low, high, chosen = _heated(location.flow, heats, ranges)
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
        coupling=0.0 if housing is None else housing.params["coupling"],
        thermostat=features.get("thermostat"),
        radiation=radiation,
        around=around,
    )


def drift_of(flow: Flow, m: Range, forcing: Forcing, *, up: bool, housing: float | None) -> DriftBound:
    """The greatest (`up`) or the least drift in X, for a mode parameter within `m`.

    `housing` (degC) is the highest or lowest temperature that the housing may have; None leaves it out.
    """
    side = int(up)
    parts = [_alone(flow, m, forcing.heat, side)]
    for lossy in forcing.losses:
        # Below the sink a loss warms, above it cools: which of its strengths is the bound changes there.
        sink = lossy.sink[side]
        least, most = lossy.loss
        below, above = (most, least) if up else (least, most)
        parts.append(DriftBound((sink,), ((below * sink, below), (above * sink, above))))
    if forcing.coupling and housing is not None:
        parts.append(DriftBound((), ((forcing.coupling * housing, forcing.coupling),)))
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
        parts.append(_radiated(forcing.radiation, forcing.around[side], up=up))
    return added(parts)


def _alone(flow: Flow, m: Range, heat: Range, side: int) -> DriftBound:
    """The flow and the heats without anything lost."""
    if flow.kind in RELAXING:
        return DriftBound((), ((flow.params["k"] * m[side] + heat[side], flow.params["k"]),))
    drive = m[side] if flow.kind == "linear" else 0.0
    if FLOWS[flow.kind].fading is not None:  # it fades from this to 0
        entered = float(flows.drift(flow, 0.0, m[side], 0.0))
        drive = max(entered, 0.0) if side else min(entered, 0.0)
    return DriftBound((), ((drive + heat[side], 0.0),))


# ------------------------------------------------------------------ heats


def _heated(
    flow: Flow, effects: Sequence[Effect], ranges: Callable[[str], Range]
) -> tuple[float, float, tuple[dict[str, float], dict[str, float]]]:
    """(least heat, greatest heat, the signals' values at either), the flow's inputs taken in."""
    low, high = 0.0, 0.0
    chosen: tuple[dict[str, float], dict[str, float]] = ({}, {})
    names = [driver.signal for driver in flow.inputs]
    names += [signal for effect in effects for signal in effect.signals.values()]
    for name in dict.fromkeys(names):
        readers = [effect for effect in effects if name in effect.signals.values()]
        bends = [0.0]
        for effect in readers:
            bound = kind_of(effect).bound
            bends += bound.bends(effect) if isinstance(bound, HeatBound) else ()
        # With the bends among the points every heat is monotone between two of them, so that the ends of a cell bound
        # each heat in it. Cell by cell, because heats that read one signal are not at their worst at different values.
        least, most = ranges(name)
        points = {*np.linspace(least, most, CELLS + 1).tolist(), *(bend for bend in bends if least < bend < most)}
        grid = np.array(sorted(points) if most > least else [least, least])
        k = flow.params.get("k", 0.0)
        values = np.array(
            [np.asarray(held(effect, {name: grid})[0]) for effect in readers]
            + [k * driver.gain * (grid - driver.reference) for driver in flow.inputs if driver.signal == name]
        )
        inside = np.minimum(values[:, :-1], values[:, 1:]), np.maximum(values[:, :-1], values[:, 1:])
        low, high = low + float(inside[0].sum(axis=0).min()), high + float(inside[1].sum(axis=0).max())
        total = values.sum(axis=0)
        chosen[0][name], chosen[1][name] = float(grid[total.argmin()]), float(grid[total.argmax()])
    return low, high, chosen


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
    a, b = alone.at(sink[side])
    outward = (a - b * sink[side]) * (1.0 if side else -1.0) > 0
    bound, values = kind_of(effect).bound, {}
    for role, signal in effect.signals.items():
        low, high = ranges(signal)
        pumping = max(low if outward else high, 0.0)
        strength = isinstance(bound, LossBound) and role == bound.strength
        values[signal] = pumping if strength else (high if side else low)
    return values


def _radiated(effect: Effect, around: float, *, up: bool) -> DriftBound:
    """Tangents (`up`) or chords of -gain ((X - zero)^4 - (around - zero)^4), which is concave above zero.

    Below the absolute zero of X's scale nothing is radiated.
    """
    # On a concave curve a tangent is never below it, and a chord never above: upper and lower bounds, both in lines.
    gain, zero = effect.params["gain"], parameter(effect, "zero")
    received = gain * (max(around, zero) - zero) ** 4
    # Every 2 K, where machines are; beyond that coarser, as nothing real comes there.
    depths = np.concatenate([np.arange(0.0, 900.0, 2.0), np.geomspace(900.0, HOTTEST, 200)])
    heats = received - gain * depths**4
    if up:
        slopes = 4.0 * gain * depths**3
        lines = np.column_stack([heats + slopes * (depths + zero), slopes])
        # The lowest of lines that grow steeper from one to the next: each begins where it meets the one before it.
        # Where the gain is so small that two are equally steep in floats, the first is enough.
        falling: list[Pair] = [(received, 0.0), *map(tuple, lines[1:].tolist())]
        steeper = [falling[0], *(after for before, after in pairwise(falling) if after[1] > before[1])]
        knots = ((after[0] - before[0]) / (after[1] - before[1]) for before, after in pairwise(steeper))
        return DriftBound(tuple(knots), tuple(steeper))
    slopes = np.append(-np.diff(heats) / np.diff(depths), STEEP)
    lines = np.column_stack([heats + slopes * (depths + zero), slopes])
    return DriftBound(tuple((depths + zero).tolist()), ((received, 0.0), *map(tuple, lines.tolist())))
