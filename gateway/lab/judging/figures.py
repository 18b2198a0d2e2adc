"""What models forecast along recordings as the running gateway does, beside rivals: rows that every command judges."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from math import inf
from typing import Any

import numpy as np

from gateway.entry import sentence
from gateway.machine.model import forecast_trace, recorded_scans
from gateway.settings import ForecastSection
from sim.lab.judge import (
    NEW,
    NOTHING_READ,
    PRESENT,
    ForecastSkill,
    Past,
    PastForecaster,
    Prepared,
    SkillRow,
    common,
    figures,
    forecast_skill,
    means,
    persist,
    train_rival,
)
from sim.lab.learning import PERSISTENCE
from sim.sha import DEFAULT_UNIT, Alphabet, Array, Model, Trace

SCAN_PERIOD_S = 1.0
"""s: the scan period of a gateway along a trace."""
MIN_FORECAST_PERIOD_S, MOST_FORECASTS = 60.0, 200
"""s between two forecasts, and how many of them a trace gets at most: a forecast takes about 40 ms."""
MAX_RIVAL_FORECASTS = 40
"""Forecasts of a rival along a trace at most: some are fitted anew for each."""
HORIZONS = ForecastSection().horizons
LONGEST_HORIZON = max(HORIZONS)
"""s: the outcome of a cycle's last forecast comes so long after it."""
MAX_FORECASTS_PER_CYCLE = 40
"""How many forecasts a cycle gets at most where two versions are compared."""


def scan_trace(trace: Trace, temperature: str, alphabet: Alphabet, period: float) -> Past:
    """The whole trace as the gateway's scans show it; of the temperature what is new, of the others what is held."""
    columns: dict[str, list[float]] = {name: [] for name in trace.signals}
    times, read_at = [], float("nan")
    for scan in recorded_scans(trace, period, alphabet):
        times.append(scan.time)
        for name, column in columns.items():
            value = scan.good(name)
            column.append(float("nan") if value is None else value)
        # A reading that is only held is none of the temperature's: it would count twice.
        if scan.samples[temperature].time == read_at:
            columns[temperature][-1] = float("nan")
        read_at = scan.samples[temperature].time
    arrays = {name: np.array(column) for name, column in columns.items()}
    return Past(np.array(times), arrays.pop(temperature), arrays)


def skill_rows(
    trace: Trace,
    temperature: str,
    alphabet: Alphabet,
    *,
    models: Mapping[str, Sequence[Model]],
    others: Mapping[str, PastForecaster],
    forecasts: ForecastSection,
    scan_period: float = 1.0,
    ask_period: float = 0.0,
    since: float = -inf,
    report: Callable[[str, float], None] = lambda what, share: None,
) -> list[SkillRow]:
    """What all methods forecast along a trace, for the moments that came due within it.

    `models` are methods of ours: a model and the members beside it. The `others` are asked when the first of ours has
    forecast, at most every `ask_period` s since some of them are slow; every `forecasts.period` s without any of ours.
    No forecast is made before `since` (s, of the trace's clock). Raises ValueError where a method cannot follow the
    trace.
    """

    def method_forecasts() -> Iterator[tuple[str, float, Array]]:
        origins: list[float] = []
        for method, members in models.items():
            own = forecast_trace(
                members,
                trace,
                forecasts,
                scan_period=scan_period,
                since=since,
                progress=lambda share, method=method: report(f"{trace.name}: {method}", share),  # type: ignore[misc]
            )
            yield from ((method, forecast.time, forecast.quantiles) for forecast in own)
            origins = origins or [forecast.time for forecast in own]
        if not trace.times.size:
            return
        past = scan_trace(trace, temperature, alphabet, scan_period)
        if not models:
            due = np.arange(max(past.times[0], since), past.times[-1], forecasts.period)
            origins = past.times[np.unique(np.searchsorted(past.times, due))].tolist()
        asked = -inf
        for number, origin in enumerate(origins):
            if origin - asked < ask_period:
                continue
            asked, known = origin, past.truncate(origin)
            report(f"{trace.name}: {', '.join(others)}", number / len(origins))
            for method, forecaster in others.items():
                if (fan := forecaster(known)) is not None:
                    yield method, origin, fan

    return figures(trace, temperature, alphabet.gap, forecasts.horizons, method_forecasts())


def score_trace(
    trace: Trace,
    present: Model,
    new: Model | None,
    *,
    seed: int,
    report: Callable[[str, float], None],
    most: int = MAX_FORECASTS_PER_CYCLE,
    until: float = inf,
) -> list[dict[str, Any]]:
    """A row for each horizon (s) and method along a trace: how many forecasts, CRPS and MAE (degC), coverage.

    The forecasts are those that are made `until` then (s), `most` at most; what comes after it is their outcome. They
    lie evenly, from a moment on that is drawn: where each cycle began with one, some part of a cycle, such as its last
    minutes, would never be judged.

    Without a `new` model the present one is alone beside persistence. Methods are compared at the moments at which all
    of them have a forecast. Raises ValueError for a trace that a model cannot follow.
    """
    begin = float(trace.times[0])
    lasts = min(float(trace.times[-1]), until) - begin
    period = max(MIN_FORECAST_PERIOD_S, lasts / most)
    rows = common(
        skill_rows(
            trace,
            present.temperature,
            present.alphabet,
            models={PRESENT: [present]} | ({} if new is None else {NEW: [new]}),
            others={PERSISTENCE: partial(persist, horizons=HORIZONS)},
            forecasts=ForecastSection(horizons=HORIZONS, period=period, seed=seed),
            since=begin + period * np.random.default_rng((seed, abs(int(begin)))).random(),
            report=report,
        )
    )
    own = [row for row in rows if row.origin <= lasts]
    found = means(own, {"horizon": lambda row: row.horizon, "method": lambda row: row.method})
    return [{"trace": trace.name, **row} for row in sorted(found, key=lambda row: (row["horizon"], row["method"]))]


def rivals_room() -> Any:
    """The module `sim.lab.judge.rivals`. Raises ValueError where it cannot be loaded.

    Loaded only where it is wanted: its methods bring scikit-learn, which nothing else here needs.
    """
    try:
        return import_module("sim.lab.judge.rivals")
    except ModuleNotFoundError as error:
        raise ValueError(f"the rivals cannot be loaded ({error}); leave them out") from None


def other_methods(
    training: Sequence[Trace] | None,
    temperature: str,
    alphabet: Alphabet,
    *,
    horizons: tuple[float, ...],
    scan: float,
    seed: int,
) -> tuple[dict[str, PastForecaster], list[str]]:
    """(persistence and the rivals fitted to `training` by name, a sentence about those that cannot be).

    None asks for no rivals. Each is asked for `horizons` (s); the traces are read by scans every `scan` s. Raises
    ValueError where the rivals cannot be loaded.
    """
    methods: dict[str, PastForecaster] = {PERSISTENCE: partial(persist, horizons=horizons)}
    absent: dict[str, list[str]] = {}
    if training is not None:
        past = [scan_trace(trace, temperature, alphabet, scan) for trace in training]
        for rival in rivals_room().rivals(seed):
            try:
                methods[rival.name] = train_rival(rival, past, horizons)
            except (ImportError, ValueError) as error:
                absent.setdefault(sentence(error), []).append(rival.name)
    return methods, [f"without {', '.join(names)}: {reason}" for reason, names in absent.items()]


def missing_horizons(trace: Trace, rows: Sequence[SkillRow], horizons: Sequence[float]) -> list[str]:
    """Sentences for the horizons (s) for which no forecast along the trace came due, or none has an outcome."""
    due, read = {row.horizon for row in rows}, {row.horizon for row in rows if row.read}
    short = [f"{horizon:g}" for horizon in horizons if horizon not in due]
    unread = [f"{horizon:g}" for horizon in horizons if horizon in due - read]
    said = []
    if short:
        lasts = f"{trace.times[-1] - trace.times[0]:.4g} s" if trace.times.size else "no time: it has no rows"
        said.append(f"{trace.name}: no forecast for {', '.join(short)} s came due; it lasts {lasts}")
    if unread:
        said.append(f"{trace.name}: no forecast for {', '.join(unread)} s has an outcome: {NOTHING_READ}")
    return said


@dataclass(frozen=True, slots=True)
class JudgedForecasts:
    """The forecasts of several models along the same traces, and sentences about what could not be made.

    `methods` are the names of a model's variants by its label; `unit` is that of the first model.
    """

    rows: Sequence[SkillRow]
    notes: Sequence[str]
    methods: Mapping[str, Sequence[str]]
    unit: str = DEFAULT_UNIT

    def skill(self, label: str | None = None, *, seed: int = 0) -> ForecastSkill:
        """Of all models at the moments that all share; of the one of this `label` beside what is no model."""
        every = [name for names in self.methods.values() for name in names]
        ours = every if label is None else list(self.methods[label])
        rows = [row for row in self.rows if row.method in ours or row.method not in every]
        return forecast_skill(rows, ours, seed=seed, notes=self.notes, unit=self.unit)


def judged_forecasts(
    prepared: Sequence[Prepared],
    traces: Sequence[Trace],
    *,
    training: Sequence[Trace] | None,
    seed: int,
    report: Callable[[str, float], None],
) -> JudgedForecasts:
    """What every variant of the models forecasts along the traces, beside persistence and the rivals.

    Rivals are fitted to the traces of `training`; None asks for none. What a model or a rival cannot do becomes a note.
    Raises ValueError where the rivals cannot be loaded.
    """
    models: dict[str, Model] = {}
    methods: dict[str, list[str]] = {}
    for each in prepared:
        # As the ranking calls them: a model of several semantics is one entrant for each.
        named = {
            f"{each.label} ({semantics})" if len(each.variants) > 1 else each.label: model
            for semantics, model in each.variants.items()
        }
        models |= named
        methods[each.label] = list(named)
    if not models:
        return JudgedForecasts([], ["no model can be run, so there are no forecasts"], methods)
    first = next(iter(models.values()))
    others, notes = other_methods(
        training, first.temperature, first.alphabet, horizons=HORIZONS, scan=SCAN_PERIOD_S, seed=seed
    )
    rows: list[SkillRow] = []
    for trace in traces:
        lasts = float(trace.times[-1] - trace.times[0]) if trace.times.size else 0.0
        section = ForecastSection(
            horizons=HORIZONS, period=max(MIN_FORECAST_PERIOD_S, lasts / MOST_FORECASTS), seed=seed
        )
        asked: Mapping[str, PastForecaster] = others
        own: list[SkillRow] = []
        followed = False
        for name, model in models.items():
            try:
                if (model.temperature, model.unit) != (first.temperature, first.unit) or name in others:
                    raise ValueError("it forecasts another signal than the first model, or is called as one beside it")
                made = skill_rows(
                    trace,
                    first.temperature,
                    model.alphabet,
                    models={name: [model]},
                    others=asked,
                    forecasts=section,
                    scan_period=SCAN_PERIOD_S,
                    report=report,
                    ask_period=lasts / MAX_RIVAL_FORECASTS if training is not None else 0.0,
                )
            except ValueError as error:
                notes.append(f"{name} has no forecast along {trace.name}: {sentence(error)}")
                continue
            # The others are asked once, at the moments of the first model that forecasts.
            asked = {} if made else asked
            own += made
            followed = True
        rows += own
        notes += missing_horizons(trace, own, HORIZONS) if followed else []
    return JudgedForecasts(rows, notes, methods, first.unit)
