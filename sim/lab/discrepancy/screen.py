"""Which effects would explain what the model leaves: every shape of every entry against the fitted noise.

The columns are what an effect of unit strength does to the windows; the model's own parameters (and the effects that it
has already) are projected out of them, in the product that the noise gives (generalised least squares). A shape's gain
is the log-likelihood ratio of its best strength, 0 where the sign is not physics; that of an entry is the best of its
shapes. The screen is conservative: the noise was fitted without the effect and has swallowed some of it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import scipy

from sim.effects import MachineLog
from sim.lab.discrepancy.fitting import (
    CatalogueEntry,
    Fitted,
    Named,
    Record,
    Whitener,
    automaton_effects,
    heat_response,
    hold_signal,
    net_heat,
    on_sensor,
    role_signals,
    sense_course,
)
from sim.sha import Array

MIN_VISIBLE_SHARE = 0.05**2
"""Of a column's square that the fit's own parameters must leave where it is weighed by itself: 1/20 of its size."""
SHOWN_NATS = 1.0
"""From which a rival shows in a screen."""
CHUNK_COLUMNS = 16
"""Columns that are weighed at a time: the states behind them take several times their memory."""
MAX_EVALUATIONS = 60
"""Evaluations at most when the shape of an effect is refined."""
TIME_PARAMETERS = ("tau", "delay", "lag")
"""Parameters of a shape that are a time (s) over which something happens."""
MIN_VISIBLE_ROWS = 2.0
"""Rows that something must last to be seen in them: between two of them it could be anything."""


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of an entry: signals by role, `params` without (in a `whole` entry: with) the strength."""

    entry: CatalogueEntry
    signals: Mapping[str, str]
    params: Mapping[str, float]

    def with_strength(self, strength: float) -> Named:
        """The effect at a strength; a `whole` entry keeps the one of its shape."""
        own = {} if self.entry.whole else {self.entry.strength: strength}
        return Named(self.entry, self.signals, self.entry.candidate.settled({**self.params, **own}))


class Projector:
    """The linear problem around a fit with the fit's own parameters taken out of everything."""

    def __init__(self, fitted: Fitted) -> None:
        self.fitted = fitted
        # Frisch, Waugh and Lovell: regressing on what is left after the fit's own parameters gives an effect the same
        # strength and gain as a joint fit would. The factor of the normal matrix is made once for all columns.
        self._whitener = Whitener(fitted.grid, fitted.noise)
        stacked = np.column_stack([fitted.residual, fitted.columns])
        weighed = self._whitener.weigh(stacked)
        prior = np.maximum(fitted.prior, 1e-12)
        self._fit_weighed, self._weighed = weighed[:, 0], weighed[:, 1:]
        self._factor = scipy.linalg.cho_factor(fitted.columns.T @ self._weighed + np.diag(prior))
        best = scipy.linalg.cho_solve(self._factor, fitted.columns.T @ weighed[:, 0] - fitted.prior * fitted.off)
        self.residual = fitted.residual - fitted.columns @ best
        self.weighed_residual = weighed[:, 0] - self._weighed @ best

    @cached_property
    def smooth(self) -> Array:
        """(n,) degC the temperature at the knots without the sensor's noise: free run plus the smoothed residual."""
        return _course_at_knots(self.fitted, self._whitener.smooth(self.fitted.residual, self._fit_weighed))

    @property
    def smoothed_residual(self) -> Array:
        """(m,) degC `residual` without the errors of the reading."""
        return self._whitener.smooth(self.residual, self.weighed_residual)

    @cached_property
    def added(self) -> Callable[[Array], Array]:
        """The fit's `heat_response`."""
        return heat_response(self.fitted.frame, self.fitted.state)

    def size_and_score(self, column: Array) -> tuple[float, float]:
        """(c' P c, c' P r) of a column (m,) degC: the linear problem of its strength alone."""
        weighed = self._weighed.T @ column
        size = float(
            self._whitener.gram(column[:, None])[0, 0] - weighed @ scipy.linalg.cho_solve(self._factor, weighed)
        )
        return size, float(column @ self.weighed_residual)

    def cosines(self, columns: Array) -> Array:
        """(c,) the cosine of each of the columns (m, c) degC with the first, in the product of P."""
        # Columns of unit size: strengths run from degC to 1/s, and one normal matrix would lose its digits.
        scale = np.sqrt(np.mean(columns**2, axis=0))
        scaled = columns / np.where(scale > 1e-12, scale, 1.0)
        _, weighed, _ = self.clean(scaled)
        size = np.sqrt(np.maximum(np.einsum("ij,ij->j", scaled, weighed), 1e-300))
        return np.asarray(weighed[:, 0] @ scaled / (size * size[0]))

    def made_room(self, column: Array) -> Array:
        """(p + r + e,) how the fit's parameters move when `column` (m,) degC is added to its course."""
        fitted = self.fitted
        score = self._weighed.T @ (fitted.residual - column) - fitted.prior * fitted.off
        return np.asarray(scipy.linalg.cho_solve(self._factor, score))

    def clean(self, columns: Array) -> tuple[Array, Array, Array]:
        """(columns without what the fit's parameters imitate, the same weighed, V^-1-size of the columns before)."""
        weighed = self._whitener.weigh(columns)
        part = scipy.linalg.cho_solve(self._factor, self._weighed.T @ columns)
        before = np.einsum("ij,ij->j", columns, weighed)
        return columns - self.fitted.columns @ part, weighed - self._weighed @ part, before


def alone(projector: Projector, columns: Array, signs: Array) -> tuple[Array, Array, Array]:
    """(gains (c,) nats, strengths (c,), the columns weighed (m, c)) of columns (m, c) degC, each by itself.

    0 where nothing is visible beside the fit's own parameters, or where the sign that physics allows (`signs` (c,), 0:
    either) is another.
    """
    _, weighed, before = projector.clean(columns)
    size, score = np.einsum("ij,ij->j", columns, weighed), columns.T @ projector.weighed_residual
    allowed = (size > MIN_VISIBLE_SHARE * np.maximum(before, 1e-300)) & ((signs == 0) | (signs * score > 0))
    strength = np.where(allowed, score / np.where(allowed, size, 1.0), 0.0)
    return 0.5 * strength * score, strength, weighed


@dataclass(frozen=True, slots=True)
class Screen:
    """c shapes with their projected problem: `size` (c,) = c'Pc and `score` (c,) = c'Pr, P the projected V^-1.

    `visible` (c,) is the share of each column's size that is left after projection. `by_cycle` (cycles, c) are the
    parts of the scores and `information` (cycles, c) those of the sizes. Columns are scaled to a
    root mean square of 1 degC, `scale` (c,) being their own: degC for one unit of strength.
    """

    shapes: tuple[Shape, ...]
    scale: Array
    size: Array
    score: Array
    visible: Array
    by_cycle: Array
    information: Array

    @property
    def standardised_strengths(self) -> Array:
        """(c,) the best strengths over their standard errors."""
        return np.asarray(self.score / np.sqrt(np.maximum(self.size, 1e-300)))

    @property
    def strength(self) -> Array:
        """(c,) the best strength of each shape alone, in the parameter's unit."""
        return np.asarray(self.score / np.maximum(self.size * self.scale, 1e-300))

    @property
    def gain(self) -> Array:
        """(c,) nats of each shape alone, 0 where its sign is not physics or where nothing of it is visible."""
        return self.gains(self.standardised_strengths)

    def gains(self, z: Array) -> Array:
        """(..., c) nats of signed strengths over standard errors."""
        sign = np.array([shape.entry.sign for shape in self.shapes])
        allowed = (self.visible > 0) & ((sign == 0) | (sign * z > 0))
        burden = np.array([shape.entry.burden for shape in self.shapes])
        return np.where(allowed, np.maximum(0.5 * z**2 - burden, 0.0), 0.0)

    def concatenate(self, more: "Screen") -> "Screen":
        """These shapes and more of the same problem."""
        pairs = {each.name: (getattr(self, each.name), getattr(more, each.name)) for each in fields(self)}
        shapes = self.shapes + more.shapes
        columns = {name: np.concatenate(pair, axis=-1) for name, pair in pairs.items() if name != "shapes"}
        return Screen(shapes=shapes, **columns)

    def best(self) -> dict[str, int]:
        """entry name -> its best shape's number, in the order of their gains."""
        gain = self.gain
        order = np.argsort(-gain, kind="stable").tolist()
        chosen: dict[str, int] = {}
        for number in order:
            chosen.setdefault(self.shapes[number].entry.name, number)
        return chosen


def smooth_course(fitted: Fitted) -> Array:
    """(n,) degC `Projector.smooth` of a fit of which nothing else is asked."""
    return _course_at_knots(fitted, Whitener(fitted.grid, fitted.noise).smooth(fitted.residual))


def _course_at_knots(fitted: Fitted, smoothed: Array) -> Array:
    """(n,) degC the free run and the `smoothed` residual (m,) of the windows."""
    record = fitted.frame.record
    # The residual is smoothed on windows and carried to the knots between them; the free run has the knots' own shape.
    out = fitted.state.mean.copy()
    runs, run = record.runs, record.runs.run[record.rows[record.begins]]
    times = record.times
    for number in np.unique(run):
        windows, knots = run == number, runs.run == number
        out[knots] += np.interp(runs.time[knots], times[windows], smoothed[windows])
    return out


def shape_columns(projector: Projector, shapes: Sequence[Shape]) -> Array:
    """(m, c) degC what one unit of strength of each shape does to the windows of a fit."""
    fitted, smooth, added = projector.fitted, projector.smooth, projector.added
    record, state = fitted.frame.record, fitted.state
    out = []
    for shape in shapes:
        effects = automaton_effects(shape.with_strength(1.0), record.model)
        if on_sensor(effects[0]):
            sensed = state.mean
            for effect in effects:
                sensed = sense_course(record, effect, sensed)
            out.append(record.window_means(sensed - state.mean))
            continue
        # A heat that depends on the temperature is taken along the smoothed reading, not along the free run: where
        # something is missing the free run is wrong, and a thermostat would open in it at the wrong times.
        out.append(added(net_heat(record, effects, smooth)))
    return np.column_stack(out) if out else np.empty((fitted.residual.size, 0))


def candidate_shapes(
    projector: Projector, entries: Sequence[CatalogueEntry], roles: Mapping[str, str]
) -> Iterator[Shape]:
    """Every shape of every entry whose signals are there, but those too short to be seen between the rows."""
    record, smooth, score = projector.fitted.frame.record, projector.smooth, projector.weighed_residual
    shortest = shortest_visible(record)
    for entry in entries:
        signals = role_signals(entry, roles)
        if signals is None:
            continue
        log = MachineLog(
            time=record.runs.time,
            dt=record.runs.dt,
            running=record.running,
            smooth=smooth,
            signals={role: hold_signal(record, signal) for role, signal in signals.items()},
        )
        further = entry.candidate.scan(record.times, score) if entry.candidate.scan is not None else []
        for params in [*entry.candidate.shapes(log), *further]:
            if all(params[name] >= shortest for name in TIME_PARAMETERS if name in params):
                yield Shape(entry, signals, params)


def shortest_visible(record: Record) -> float:
    """s below which nothing that happens is visible in the record's readings."""
    between = np.diff(record.runs.time[record.rows])
    return MIN_VISIBLE_ROWS * float(np.median(between)) if between.size else 0.0


def screen(fitted: Fitted, entries: Sequence[CatalogueEntry], roles: Mapping[str, str]) -> tuple[Screen, Screen]:
    """The shapes of the entries against what the fit leaves: under its noise, and under that of `quieter`.

    What came twice is looked at where what came once shows, and so is each rival that is wider than another: of such
    pairs there are hundreds, and of two that say nothing alone the sum says as little.
    """
    projectors = Projector(fitted), Projector(quieter(fitted))
    wider = [entry for entry in entries if entry.rival and entry.candidate.special]

    def screen_entries(some: Sequence[CatalogueEntry]) -> list[Screen]:
        shapes = tuple(candidate_shapes(projectors[0], some, roles))
        columns = shape_columns(projectors[0], shapes)
        return [screen_shapes(projector, shapes, columns) for projector in projectors]

    usual, quiet = screen_entries([entry for entry in entries if entry not in wider])
    shown = {shape.entry.name for each in (usual, quiet) for shape, gain in zip(each.shapes, each.gain, strict=True)
             if gain >= SHOWN_NATS}  # fmt: skip
    further = [entry for entry in wider if shown & {*entry.candidate.special}]
    more = screen_entries(further) if further else ()
    return (usual, quiet) if not more else (usual.concatenate(more[0]), quiet.concatenate(more[1]))


def quieter(fitted: Fitted) -> Fitted:
    """The fit with cycles that scatter half as much: what differs from cycle to cycle is scatter to a fit without it,
    and weighs next to nothing under that."""
    return replace(fitted, noise=replace(fitted.noise, cycle=0.5 * fitted.noise.cycle))


def screen_shapes(projector: Projector, shapes: tuple[Shape, ...], columns: Array) -> Screen:
    """The projected problem of the shapes' columns (m, c)."""
    # Columns of unit size: strengths run from degC to 1/s, and one normal matrix of them all would lose its digits.
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns / np.where(scale > 1e-12, scale, 1.0)
    # The cycles follow one another, so that each one's windows lie together.
    begins = np.flatnonzero(np.diff(projector.fitted.grid.cycle, prepend=-1))
    width = columns.shape[1]
    parts, shares, before = np.empty((begins.size, width)), np.empty((begins.size, width)), np.empty(width)
    for begin in range(0, width, CHUNK_COLUMNS):
        some = slice(begin, begin + CHUNK_COLUMNS)
        cleaned, weighed, before[some] = projector.clean(scaled[:, some])
        parts[:, some] = np.add.reduceat(cleaned * projector.weighed_residual[:, None], begins)
        shares[:, some] = np.add.reduceat(cleaned * weighed, begins)
    size = shares.sum(axis=0)
    left = np.maximum(size, 0.0)
    visible = np.where((scale > 1e-12) & (before > 0), np.sqrt(left / np.maximum(before, 1e-300)), 0.0)
    return Screen(
        shapes=shapes,
        scale=scale,
        size=size,
        score=scaled.T @ projector.weighed_residual,
        visible=visible,
        by_cycle=parts,
        information=shares,
    )


def refine_shape(projector: Projector, shape: Shape, strength: float) -> Named:
    """The effect with its shape where the gain is greatest, searched from a shape of the screen."""
    record = projector.fitted.frame.record
    shortest = shortest_visible(record)
    names = [name for name in shape.entry.candidate.refine if name in shape.params]
    if not names:
        return shape.with_strength(strength)
    best: list[tuple[float, Shape, float]] = []

    def loss(point: Array) -> float:
        trial = _shape_at_point(shape, names, point, record, shortest)
        size, score = projector.size_and_score(shape_columns(projector, [trial])[:, 0])
        if size <= 0:
            return 0.0
        wrong = shape.entry.sign * score < 0
        # ln L along the column is c score - c^2 size / 2: at c = 1 for an effect that is there once, else at its top.
        gain = 0.0 if wrong else score - 0.5 * size if shape.entry.whole else 0.5 * score**2 / size
        best.append((gain, trial, score / size))
        return -gain

    values = [(name, shape.params[name]) for name in names]
    widths = shape.entry.candidate.widths
    begin = np.array([np.log(max(v, 1.0)) if _is_time(name) else v / widths.get(name, 10.0) for name, v in values])
    # Nelder and Mead (1965), without derivatives: bounds and switching points leave kinks in the gain. The best point
    # that was ever tried is kept, not the last simplex, since the search may be cut off by its evaluations.
    simplex = np.vstack([begin, begin + np.diag(np.full(begin.size, 0.3))])
    scipy.optimize.minimize(
        loss,
        begin,
        method="Nelder-Mead",
        options={"maxfev": MAX_EVALUATIONS, "xatol": 0.02, "fatol": 0.05, "initial_simplex": simplex},
    )
    _, top, value = max(best, key=lambda trial: trial[0])
    return top.with_strength(value)


def _shape_at_point(shape: Shape, names: Sequence[str], point: Array, record: Record, shortest: float) -> Shape:
    """The shape at coordinates of the search: logarithms of times, else steps of a width or of ten, within bounds.

    No time is made shorter than the `shortest` (s) that the record shows, no moment without bounds lies outside of it.
    """
    values = {}
    begin, end = float(record.runs.time[0]), float(record.runs.time[-1])
    for name, coordinate in zip(names, point.tolist(), strict=True):
        low, high = shape.entry.candidate.refine[name]
        low = max(low, shortest) if _is_time(name) else low
        low, high = (low, high) if np.isfinite(high) else (begin, end)
        # A simplex may step anywhere; beyond e^20 s the exponential would overflow before the bound could hold it.
        value = (
            float(np.exp(min(coordinate, 20.0)))
            if _is_time(name)
            else shape.entry.candidate.widths.get(name, 10.0) * coordinate
        )
        values[name] = min(max(value, low), high)
    settled = shape.entry.candidate.settled({**shape.params, **values})
    return Shape(shape.entry, shape.signals, settled)


def _is_time(name: str) -> bool:
    return name in TIME_PARAMETERS
