"""Which signals drive a temperature and which follow it: regressions over stretches of time, held out in blocks.

A stretch's rise of the temperature is put down to where it began and to the means of the signals meanwhile, as a body
that loses heat does it. A signal that the temperature moves (a fan, a valve, another reading of the same heat) would
explain the rise as well: it is told by its own moves, which a high temperature foretells upwards. What loads a machine
is never told so: it starts a cold machine and stops a hot one. Another temperature beside it, which never jumps, is
told by what makes it move: the same signals that jump.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim.lab.learning.runs import Indices
from sim.sha import Array, Trace

Verdict = Literal["drives", "follows", "adds nothing"]
_STRETCH_STEPS = (1, 3, 10, 30, 100)
"""Stretches that are tried, in usual steps between readings: short ones are noise, long ones have no course left."""
_MAX_STRETCHES = 20_000
_MIN_STRETCHES = 60
"""Stretches below which nothing is said."""
_BLOCK_COUNT = 10
"""Parts of the time, each held out once."""
_CLEAR_SIGMAS = 2.0
"""Standard errors over blocks by which a share must lie above nothing."""
_LARGE_SHARE = 0.1
"""A share that chance hardly makes on what was held out; blocks differ by what nobody has measured."""
MIN_EXTRA_SHARE = 0.01
"""Of the rise that the others leave, a driver explains at least so much."""
MIN_FORETOLD_SHARE = 0.05
"""Of its own moves that are left to it, the temperature foretells so much of a signal that follows it."""
_MIN_JUMP_SHARE = 0.2
"""The same of what the signals that jump foretell of one that never does: it is heated by them, too."""
_JUMP_RANGE_SHARE = 0.3
"""Of a signal's range, in one step: no temperature moves so."""
_SWITCHED, _FEWEST_SWITCHES = 0.8, 5
"""How surely the temperature tells when a signal is switched (1: it is switched on above, off below), at so many."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverEvidence:
    """What traces say of one `signal` and a temperature.

    `alone` is the share (0 to 1, held out) of the temperature's rises that it explains beside the temperature itself,
    `beyond` the share of what the other drivers leave; `gain` what a unit of it changes the temperature by in the end
    (the temperature's unit per unit of the signal; NaN where it does not drive). `foretold` is the share of its own
    moves that the temperature foretells, upwards where it is hot, or of one that never jumps what the drivers foretell.
    """

    signal: str
    verdict: Verdict
    alone: float
    beyond: float
    gain: float
    foretold: float

    @property
    def sentence(self) -> str:
        """The verdict with its evidence."""
        match self.verdict:
            case "follows":
                return (
                    f"{self.signal} follows the temperature, or what drives it: they foretell {self.foretold:.0%} of "
                    "its moves, so it is no driver"
                )
            case "drives":
                return (
                    f"{self.signal} drives it: {self.alone:.0%} of its rises alone, {self.beyond:.0%} of what the "
                    f"other drivers leave; {self.gain:+.3g} for each unit in the end"
                )
            case _:
                return f"{self.signal} explains nothing clearly beyond the other drivers ({self.alone:.0%} alone)"


@dataclass(frozen=True, slots=True)
class _Stretches:
    """n stretches: the temperature's `start` and `rise`, and of each signal its `mean`, `first` and `move` after it."""

    start: Array
    rise: Array
    means: Mapping[str, Array]
    first: Mapping[str, Array]
    moves: Mapping[str, Array]
    block: Indices


def find_drivers(
    traces: Sequence[Trace], temperature: str, candidates: Sequence[str], *, gap: float
) -> tuple[DriverEvidence, ...]:
    """What the traces say of each of `candidates` that moves, in their order.

    Drivers are those that do not follow, without any that explains nothing beyond the others.

    Over steps of more than `gap` s nothing is known. Empty where there are too few readings to tell.
    """
    moving = [name for name in candidates if name != temperature and _moves(traces, name)]
    if not moving:
        return ()
    tried = [
        each for steps in _STRETCH_STEPS if (each := _stretches(traces, temperature, moving, gap, steps)) is not None
    ]
    if not tried:
        return ()
    data = max(
        tried, key=lambda each: float(_explained_shares(each, each.rise, [each.start, *each.means.values()])[0].mean())
    )
    jumps = [name for name in moving if _jumps(traces, name)]
    # What is switched is switched from one reading to the next, whatever stretch tells most of the temperature.
    foretold = {name: _switching_certainty(tried[0], name) or _foretold(data, name) for name in moving}
    leading = [name for name in jumps if foretold[name] is None]
    for name in (name for name in moving if name not in jumps and foretold[name] is None):
        foretold[name] = _foretold_share(data, name, leading)
    free = [name for name in moving if foretold[name] is None]
    # What follows is known beside the drivers: a fan's cooling is not put down to another signal.
    beside = [data.means[name] for name in moving if name in jumps and name not in free]
    chosen = _choose_drivers(data, free, beside)
    evidence = []
    for name in moving:
        others = [data.means[each] for each in chosen if each != name]
        beyond = _gain(data, data.rise, [data.start, *beside, *others], data.means[name])
        alone = _gain(data, data.rise, [data.start], data.means[name])
        follows = foretold[name] is not None
        evidence.append(
            DriverEvidence(
                signal=name,
                verdict="follows" if follows else "drives" if name in chosen else "adds nothing",
                alone=max(float(alone.mean()), 0.0),
                beyond=max(float(beyond.mean()), 0.0),
                gain=_steady(data, beside, chosen, name) if name in chosen else float("nan"),
                foretold=foretold[name] or 0.0,
            )
        )
    return tuple(evidence)


def _moves(traces: Sequence[Trace], name: str) -> bool:
    values = [trace.signals[name][np.isfinite(trace.signals[name])] for trace in traces if name in trace.signals]
    return any(own.size for own in values) and float(np.ptp(np.concatenate(values))) > 0


def _stretches(
    traces: Sequence[Trace], temperature: str, names: Sequence[str], gap: float, steps: int
) -> _Stretches | None:
    """Stretches of so many usual steps; None where there are too few."""
    parts: list[list[Array]] = []
    total = sum(trace.times.size for trace in traces)
    for trace in traces:
        if any(name not in trace.signals for name in (temperature, *names)):
            continue
        known = np.isfinite(trace.signals[temperature])
        times, values = trace.times[known], trace.signals[temperature][known]
        if times.size < 2 * steps + 1:
            continue
        columns = [_hold_signal(trace, name)[known] for name in names]
        places = np.arange(0, times.size - 2 * steps, max(steps, -(-total // _MAX_STRETCHES)))
        middle, end = places + steps, places + 2 * steps
        usual = float(np.median(np.diff(times)))
        even = np.abs((times[end] - times[places]) / (2 * steps * usual) - 1.0) <= 0.5
        broken = np.concatenate(([0], np.cumsum(np.diff(times) > gap)))
        good = even & (broken[end] == broken[places])
        means, first, moves = [], [], []
        for column in columns:
            sums = np.concatenate(([0.0], np.cumsum(np.nan_to_num(column))))
            good &= np.isfinite(column[places]) & np.isfinite(column[middle]) & np.isfinite(column[end])
            means.append((sums[middle + 1] - sums[places + 1]) / steps if steps > 1 else column[places])
            # How it stands at the end of the stretch, and by how much it moves over the next.
            first.append(column[middle])
            moves.append(column[end] - column[middle])
        rows = [values[places], values[middle] - values[places], times[places], values[middle], *means, *first, *moves]
        parts.append([row[good] for row in rows])
    if not parts:
        return None
    start, rise, times, later, *rest = (np.concatenate(column) for column in zip(*parts, strict=True))
    if start.size < _MIN_STRETCHES or float(np.ptp(rise)) == 0.0:
        return None
    count = len(names)
    mean, end_of, moved = (dict(zip(names, rest[at * count : (at + 1) * count], strict=True)) for at in range(3))
    block = np.arange(start.size) * _BLOCK_COUNT // start.size
    return _Stretches(start, rise, mean, {**end_of, "": later}, moved, block)


def _hold_signal(trace: Trace, name: str) -> Array:
    """A signal's newest reading in each row."""
    values = trace.signals[name]
    return np.asarray(values[np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), 0))])


def _explained_shares(data: _Stretches, outcome: Array, columns: Sequence[Array]) -> tuple[Array, Array]:
    """By held-out block the share of the outcome's squares that a linear law of the columns explains, and what is left.

    The law is that of the other blocks.
    """
    spread = [float(column.std()) for column in columns]
    scaled = [(c - c.mean()) / (width if width > 0 else 1.0) for c, width in zip(columns, spread, strict=True)]
    rows = np.column_stack([np.ones(outcome.size), *scaled, outcome])
    # The last column is the outcome: the squares and products of a block are all that a law of the others needs of it.
    products = np.array([rows[data.block == block].T @ rows[data.block == block] for block in range(_BLOCK_COUNT)])
    left, whole = np.zeros(_BLOCK_COUNT), np.zeros(_BLOCK_COUNT)
    for block, held in enumerate(products):
        others = products.sum(axis=0) - held
        law, *_ = np.linalg.lstsq(others[:-1, :-1], others[:-1, -1], rcond=1e-10)
        mean = others[0, -1] / others[0, 0]
        left[block] = held[-1, -1] - 2.0 * law @ held[:-1, -1] + law @ held[:-1, :-1] @ law
        whole[block] = held[-1, -1] - 2.0 * mean * held[0, -1] + mean**2 * held[0, 0]
    total = max(float(whole.sum()), 1e-300)
    return (whole - left) * _BLOCK_COUNT / total, left


def _gain(data: _Stretches, outcome: Array, columns: Sequence[Array], more: Array) -> Array:
    """By block, of the squares that a law leaves (their mean over blocks), the share that one more column explains."""
    without, with_it = (
        _explained_shares(data, outcome, columns)[1],
        _explained_shares(data, outcome, [*columns, more])[1],
    )
    return np.asarray((without - with_it) / max(float(without.mean()), 1e-300))


def _clearly(shares: Array, least: float) -> bool:
    """Whether a share is at least so large in the mean, and clearly above nothing: less clearly where it is large."""
    mean, error = float(shares.mean()), float(shares.std(ddof=1)) / np.sqrt(shares.size)
    return mean >= least and mean > (1.0 if mean >= _LARGE_SHARE else _CLEAR_SIGMAS) * error


def _foretold(data: _Stretches, name: str) -> float | None:
    """The share of a signal's moves that the temperature foretells upwards; None where it does not follow it."""
    outcome, own, heat = data.moves[name], data.first[name], data.first[""]
    if float(np.ptp(outcome)) == 0.0:
        return None
    shares = _gain(data, outcome, [own], heat)
    law, *_ = np.linalg.lstsq(np.column_stack([np.ones(own.size), own, heat]), outcome, rcond=None)
    return float(shares.mean()) if law[2] > 0 and _clearly(shares, MIN_FORETOLD_SHARE) else None


def _switching_certainty(data: _Stretches, name: str) -> float | None:
    """How surely a high temperature switches a signal on and a low one off (0 to 1); None where that is not sure."""
    own, move, heat = data.first[name], data.moves[name], data.first[""]
    low = float(own.min()) + float(np.ptp(own)) / 2
    sure = 1.0
    for up, state in ((1.0, own <= low), (-1.0, own > low)):
        moved = state & (up * move > _JUMP_RANGE_SHARE * np.ptp(own))
        stayed = state & ~moved
        if min(moved.sum(), stayed.sum()) < _FEWEST_SWITCHES:
            return None
        # The chance that it is hotter (colder) at a switch than at a moment at which it stays.
        order = np.sort(up * heat[stayed])
        both = np.searchsorted(order, up * heat[moved], side="left") + np.searchsorted(
            order, up * heat[moved], side="right"
        )
        sure = min(sure, float(both.mean()) / (2 * order.size))
    return 2.0 * sure - 1.0 if sure >= _SWITCHED else None


def _jumps(traces: Sequence[Trace], name: str) -> bool:
    """Whether a signal moves by much of its range within one step, as no temperature does."""
    values = [own[np.isfinite(own)] for trace in traces if (own := trace.signals.get(name)) is not None]
    span = float(np.ptp(np.concatenate(values)))
    return any(own.size > 1 and float(np.abs(np.diff(own)).max()) > _JUMP_RANGE_SHARE * span for own in values)


def _foretold_share(data: _Stretches, name: str, leading: Sequence[str]) -> float | None:
    """The share of a signal's moves that those which jump foretell; None where it moves by itself."""
    if not leading or float(np.ptp(data.moves[name])) == 0.0:
        return None
    own = [data.first[name]]
    left = _explained_shares(data, data.moves[name], own)[1]
    shared = _explained_shares(data, data.moves[name], [*own, *(data.first[each] for each in leading)])[1]
    shares = (left - shared) / max(float(left.mean()), 1e-300)
    return float(shares.mean()) if _clearly(shares, _MIN_JUMP_SHARE) else None


def _choose_drivers(data: _Stretches, free: Sequence[str], beside: Sequence[Array]) -> list[str]:
    """All but those that explain nothing beyond the others, given up one after the other: two may need each other."""
    chosen = list(free)
    while chosen:
        shares = {
            name: _gain(
                data,
                data.rise,
                [data.start, *beside, *(data.means[each] for each in chosen if each != name)],
                data.means[name],
            )
            for name in chosen
        }
        weak = [name for name in chosen if not _clearly(shares[name], MIN_EXTRA_SHARE)]
        if not weak:
            break
        # Of two that say the same the later one goes.
        chosen.remove(min(reversed(weak), key=lambda name: float(shares[name].mean())))
    return chosen


def _steady(data: _Stretches, beside: Sequence[Array], chosen: Sequence[str], name: str) -> float:
    """What a unit of a driver changes the temperature by in the end, the others as they are; NaN: it never ends."""
    columns = [np.ones(data.rise.size), data.start, *(data.means[each] for each in chosen), *beside]
    law, *_ = np.linalg.lstsq(np.column_stack(columns), data.rise, rcond=None)
    return float(law[2 + list(chosen).index(name)] / -law[1]) if law[1] < 0 else float("nan")
