"""The laws that are searched: forms of single signals, exchanges, products, history, rhythm, the clock, and dates.

Those of the clock and of a date are the rivals without a name (`sim.effects.rivals`), at all moments at which one may
begin. The family is bounded on purpose: every law that is tried costs evidence (`law_search`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from sim.effects import SINCE, TEMPERATURE, moment_words
from sim.lab.discrepancy.advice import in_words
from sim.lab.discrepancy.fitting import Fitted, hold_signal, lagged_signal, rivals
from sim.lab.discrepancy.heat import since_switch
from sim.lab.discrepancy.screen import Projector, Shape, candidate_shapes
from sim.lab.learning import first_switch
from sim.sha import Array

MAX_SIGNALS = 10
"""Signals at most, those that change most often: products grow with their square."""
LAGS: Mapping[str, float] = {"5min": 300.0, "15min": 900.0, "1h": 3600.0, "4h": 14400.0}
DAY_S = 86400.0
PHASE_COUNT = 4
FADING, GROWING = (120.0, 600.0, 1800.0, 7200.0), (1800.0, 14400.0)
"""Seconds since a start (or a stop) by which a heat dies away, or up to which it grows."""
MAX_MOMENTS = 12
"""Moments of a record, evenly over what the machine ran, at which a heat is tried to begin."""
EVENT_RIVAL = "heat-after-an-event"
"""The rival of which there may be several: what is done to a machine is done again."""


@dataclass(frozen=True, slots=True)
class LawForm:
    """A law of unit strength: its `text`, how many `terms` it has, and whether it acts while running only.

    `exchange`: it is straight in the temperature, and only a positive strength is physics. `experiment` is what would
    tell it from chance. `words` are the plant's (more and less of it), where the text does not speak for itself.
    `shapes` are those of rivals without a name whose heats it adds up; their text is no expression.
    """

    text: str
    terms: int
    running: bool
    experiment: str
    exchange: bool = False
    words: tuple[str, str] | None = None
    shapes: tuple[Shape, ...] = ()

    @property
    def kind(self) -> str:
        """What laws share that differ in their numbers alone."""
        kinds = [shape.entry.name for shape in self.shapes]
        return " and ".join(kinds) or re.sub(r"_\d+(min|h)|\b\d[\d.]*(e[-+]?\d+)?\b", "", self.text)

    def said(self, strength: float) -> str:
        """What it is at a strength, in the plant's words or as the expression."""
        return in_words(self.text) if self.words is None else self.words[0 if strength > 0 else 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class LawColumns:
    """What the names of the family stand for on one record: `values` (n,) by name; `signals` gives the plant's name."""

    values: Mapping[str, Array]
    signals: Mapping[str, str]
    binary: frozenset[str] = field(default_factory=frozenset)


def law_columns(
    fitted: Fitted, smooth: Array, names: Mapping[str, str], begin: float, periods: Sequence[float]
) -> LawColumns:
    """The columns of a record: `names` are (name, signal), `smooth` (n,) degC the temperature, `begin` absolute s.

    `periods` (s) are those of rhythms.
    """
    record = fitted.frame.record
    runs = record.runs
    values: dict[str, Array] = {TEMPERATURE: smooth}
    for name, signal in names.items():
        column = hold_signal(record, signal)
        values[name] = column
        history = record.history(signal)
        history = np.where(np.isfinite(history), history, float(np.nanmean(history)))
        for label, lag in LAGS.items():
            values[f"lag_{name}_{label}"] = lagged_signal(record, history, lag)
    middle = runs.time - runs.dt / 2.0
    # A day at most: where no start or stop was seen, the time since is a placeholder.
    values[SINCE] = np.minimum(record.since + runs.dt / 2.0, DAY_S)
    values["since_stop"] = np.where(record.running > 0.5, DAY_S, np.minimum(since_switch(record), DAY_S))
    values["days"] = (middle - begin) / DAY_S
    for phase in range(PHASE_COUNT):
        angle = np.pi * phase / PHASE_COUNT
        for period in periods:
            values[f"every_{period / 60.0:.0f}min_{phase}"] = np.cos(2.0 * np.pi * (middle - begin) / period - angle)
    binary = frozenset(name for name in names if np.unique(values[name]).size <= 2)
    return LawColumns(values=values, signals=names, binary=binary)


def signal_names(fitted: Fitted) -> dict[str, str]:
    """name in an expression -> signal: those of the record that change, MAX_SIGNALS at most, without its switch."""
    record = fitted.frame.record
    switch = first_switch(record.model.alphabet)
    changes = {signal: int(np.count_nonzero(np.diff(hold_signal(record, signal)))) for signal in record.signals}
    changes.pop(switch.signal if switch is not None else "", None)
    often = sorted((signal for signal in changes if changes[signal] > 1), key=lambda signal: -changes[signal])
    chosen = [signal for signal in record.signals if signal in often[:MAX_SIGNALS]]
    names: dict[str, str] = {}
    for number, signal in enumerate(chosen):
        plain = re.sub(r"\W", "_", signal, flags=re.ASCII)
        fits = re.fullmatch(r"[A-Za-z]\w{0,29}", plain) and plain.lower() not in (TEMPERATURE, SINCE, "scale", "shift")
        names[plain if fits and plain not in names else f"signal_{number}"] = signal
    return names


def family(columns: LawColumns, running: Array, begin: float) -> list[LawForm]:
    """The expressions of the first round; the record begins at `begin` (absolute s)."""
    forms: list[LawForm] = []

    def add_form(
        text: str, terms: int, experiment: str, *, exchange: bool = False, only_running: bool = False, words: str = ""
    ) -> None:
        both = (words, f"less {words}") if words else None
        for on in (True,) if only_running else (True, False):
            forms.append(LawForm(text, terms, on, experiment, exchange, words=both))

    values = columns.values
    warm = values[TEMPERATURE]
    cold, span = float(np.quantile(warm, 0.02)), float(np.quantile(warm, 0.98) - np.quantile(warm, 0.02))
    degrees = [
        name
        for name in columns.signals
        if name not in columns.binary and cold - 2 * span < float(np.median(values[name])) < cold + 2 * span
    ]
    for name, signal in columns.signals.items():
        column = values[name][running > 0.5] if (running > 0.5).any() else values[name]
        alone = f"step {signal} up and down while all else stays, half an hour each"
        add_form(name, 1, alone)
        for sink in (cold, cold + 0.5 * span):
            add_form(f"max({name}, 0) * ({sink:.4g} - temperature)", 3, alone, exchange=True)
        if name not in columns.binary:
            add_form(f"{name} ^ 2", 2, f"dwell at three values of {signal}, each until the temperature settles")
            add_form(
                f"sqrt(max({name}, 0))", 2, f"dwell at three values of {signal}, each until the temperature settles"
            )
            for share in (0.25, 0.5, 0.75):
                level = f"{float(np.quantile(column, share)):.4g}"
                bend = f"hold {signal} below and above {level}, half an hour each"
                add_form(f"max({name} - {level}, 0)", 2, bend)
                add_form(f"above({name}, {level})", 2, bend)
        for label in LAGS:
            after = f"one sharp step of {signal}, then watch for three times {label}"
            add_form(f"lag_{name}_{label}", 2, after)
            fades = f"heat that follows each step of {signal} and fades over {label}"
            add_form(f"{name} - lag_{name}_{label}", 3, after, words=fades)
            if name not in columns.binary:
                size = f"heat that follows each step of {signal}, up or down, and fades over {label}"
                add_form(f"abs({name} - lag_{name}_{label})", 3, after, words=size)
        if name in degrees:
            add_form(f"{name} - temperature", 2, alone, exchange=True)
            for other, pump in columns.signals.items():
                if other != name:
                    both = f"change {signal} at constant {pump}, then {pump} at constant {signal}"
                    add_form(f"({name} - temperature) * max({other}, 0)", 3, both, exchange=True)
    for (name, signal), (other, second) in combinations(columns.signals.items(), 2):
        both = f"change {signal} at constant {second}, then {second} at constant {signal}"
        add_form(f"{name} * {other}", 2, both)
        # About its mean a signal adds nothing of the other's own.
        for moving, gate in ((name, other), (other, name)):
            if moving not in columns.binary:
                add_form(f"({moving} - {float(np.mean(values[moving])):.4g}) * {gate}", 3, both)
    for share in (0.3, 0.5, 0.7, 0.85):
        level = f"{cold + share * span:.4g}"
        add_form(f"-max(temperature - {level}, 0)", 2, f"a slow ramp of the load up and down across {level}")
    twice = "start twice within an hour, at the same load"
    for seconds in FADING:
        within = f"{seconds / 60.0:.0f} min"
        fades = f"heat after each start, fading over {within}"
        add_form(f"exp(-since / {seconds:g})", 2, twice, only_running=True, words=fades)
        first = f"heat in the first {within} after each start"
        add_form(f"above({seconds:g}, since)", 2, twice, only_running=True, words=first)
        fades, stopped = f"heat after each stop, fading over {within}", "stop twice, after a short and a long run"
        forms.append(LawForm(f"exp(-since_stop / {seconds:g})", 2, False, stopped, words=(fades, f"less {fades}")))
    for seconds in GROWING:
        grows = f"heat that grows over the first {seconds / 60.0:.0f} min after each start"
        add_form(f"min(since, {seconds:g})", 2, "one long run at one load", only_running=True, words=grows)
    later = "the same load today and in two weeks, with a reading at long rest each time"
    add_form("days", 1, later, words="heat that grows from day to day")
    for moment in moments(values["days"], running):
        from_then = f"heat that grows from {moment_words(begin + moment * DAY_S)} on"
        add_form(f"max(days - {moment:.4g}, 0)", 2, later, words=from_then)
    for name in values:
        if name.startswith("every_"):
            add_form(name, 1, f"look for what switches every {name.split('_')[1]}, and stop it for an hour")
    return forms


def moments(days: Array, running: Array) -> list[float]:
    """Days at which something is tried to begin: evenly over what the machine ran, none at its ends."""
    ran = np.cumsum(running) if running.any() else np.arange(1.0, days.size + 1.0)
    shares = (np.arange(MAX_MOMENTS) + 1.0) / (MAX_MOMENTS + 1)
    return [float(day) for day in np.interp(shares * ran[-1], ran, days)]


def dated_rivals(projector: Projector) -> list[LawForm]:
    """The rivals without a name as laws: of the clock, of an event that fades, of a cooling that begins to change.

    They are those that read no signal; of a signal the expressions know more.
    """
    shapes = candidate_shapes(projector, [entry for entry in rivals() if not entry.needs], {})
    return [of_shapes((shape,)) for shape in shapes]


def of_shapes(shapes: tuple[Shape, ...]) -> LawForm:
    """The law that adds up rivals of one kind, all of one strength."""
    entry, first = shapes[0].entry, shapes[0].params
    both = tuple(_words(shapes, sign) for sign in (1.0, -1.0))
    return LawForm(
        text=both[0],
        terms=1 + len(shapes),
        running=entry.kind.acts == "running",
        experiment=entry.experiment,
        exchange=entry.sign > 0 and "loss" not in first,
        words=(both[0], both[1]),
        shapes=shapes,
    )


def _words(shapes: tuple[Shape, ...], sign: float) -> str:
    entry = shapes[0].entry
    if entry.candidate.words is None:
        return entry.plain
    if len(shapes) == 1:
        return entry.candidate.words(shapes[0].with_strength(sign).params)
    dates = " and ".join(moment_words(at) for at in sorted(shape.params["at"] for shape in shapes))
    hours = shapes[0].params["tau"] / 3600.0
    return f"heat after {len(shapes)} events (at {dates}), fading over {hours:.1f} running hours"


def repeat_events(best: LawForm, forms: Sequence[LawForm]) -> list[LawForm]:
    """An event with each further one that fades as it does, and that is not the same one again."""
    (shape,) = best.shapes
    others = [form.shapes[0] for form in forms if form.shapes and form.shapes[0].entry.name == EVENT_RIVAL]
    moved = (replace(other, params={**shape.params, "at": other.params["at"]}) for other in others)
    further = {each.params["at"]: each for each in moved}
    apart = shape.params["tau"]
    return [of_shapes((shape, each)) for at, each in further.items() if abs(at - shape.params["at"]) >= apart]


def products(best: Sequence[LawForm], columns: LawColumns) -> list[LawForm]:
    """The second round: the best forms of the first, each times each signal."""
    forms = []
    for form in best:
        for name, signal in columns.signals.items():
            if name not in form.text and not form.shapes:
                text = f"({form.text}) * max({name}, 0)"
                experiment = f"{form.experiment}; then the same at another {signal}"
                forms.append(LawForm(text, form.terms + 1, form.running, experiment, form.exchange))
    return forms
