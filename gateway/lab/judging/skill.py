"""`decanter model skill`: forecasts along held-out traces as the running gateway makes them, beside rivals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from math import inf
from pathlib import Path
from typing import Any

import click
import numpy as np

from gateway.console import emit, json_option, map_option, progress, seed_option, shipped, table
from gateway.entry import sentence, sentences
from gateway.lab.traces.load import load
from gateway.machine.model import forecasts_along, machine_offset_along, recorded_scans
from gateway.settings import ForecastSection
from sim.forecast import DENSE
from sim.lab.formats import find_model
from sim.lab.judge import ForecastSkill, SkillRow, common, draw_skill, forecast_skill, persistence
from sim.lab.learning import PERSISTENCE, outcomes_of
from sim.lab.pictures import check_picture
from sim.lab.recordings import load_map, load_traces
from sim.sha import Alphabet, Array, Model, Trace, shown_unit

OURS = "decanter"


@dataclass(frozen=True, slots=True)
class ScannedPast:
    """What a gateway has read up to an origin, the last of n scans: `times` (n,) in absolute s, NaN where nothing new.

    `temperature` (n,) in degC; `inputs` name -> (n,), the trace's other signals, each held since it was read.
    """

    times: Array
    temperature: Array
    inputs: Mapping[str, Array]

    def until(self, time: float) -> "ScannedPast":
        """The scans up to and including `time`; views."""
        end = int(np.searchsorted(self.times, time, side="right"))
        inputs = {name: column[:end] for name, column in self.inputs.items()}
        return ScannedPast(self.times[:end], self.temperature[:end], inputs)


PastForecaster = Callable[[ScannedPast], Array | None]
"""A method that is asked at an origin: (L, H) quantiles in degC at the levels DENSE; None where it says nothing."""


def machine_of(trace: Trace) -> str:
    """The machine that a trace was measured on: the one that it names, or else its file's name."""
    return trace.machine or trace.name


def scanned(trace: Trace, temperature: str, alphabet: Alphabet, period: float) -> ScannedPast:
    """The whole trace as the gateway's scans show it."""
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
    return ScannedPast(np.array(times), arrays.pop(temperature), arrays)


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
    """What all methods forecast along a trace, for the moments whose outcome was read.

    `models` are methods of ours: a model and the members beside it. The `others` are asked when the first of ours has
    forecast, at most every `ask_period` s since some of them are slow; every `forecasts.period` s without any of ours.
    No forecast is made before `since` (s, of the trace's clock). Raises ValueError where a method cannot follow the
    trace.
    """
    if temperature not in trace.signals:
        raise ValueError(f"trace {trace.name!r}: has no signal {temperature!r}, which is to be forecast")
    outcomes = outcomes_of(trace, temperature, alphabet.gap)
    rows: list[SkillRow] = []

    def take(method: str, time: float, fan: Array) -> None:
        for column, horizon in enumerate(forecasts.horizons):
            outcome = outcomes.at(time + horizon)
            if outcome is not None and np.all(np.isfinite(fan[:, column])):
                rows.append(
                    SkillRow(
                        machine=machine_of(trace),
                        trace=trace.name,
                        method=method,
                        horizon=horizon,
                        origin=time - float(trace.times[0]),
                        outcome=outcome,
                        quantiles=fan[:, column],
                    )
                )

    origins: list[float] = []
    for method, members in models.items():
        made = forecasts_along(
            members,
            trace,
            forecasts,
            scan_period=scan_period,
            since=since,
            progress=lambda share, method=method: report(f"{trace.name}: {method}", share),  # type: ignore[misc]
        )
        for forecast in made:
            take(method, forecast.time, forecast.quantiles)
        origins = origins or [forecast.time for forecast in made]
    past = scanned(trace, temperature, alphabet, scan_period)
    if not models and past.times.size:
        due = np.arange(max(past.times[0], since), past.times[-1], forecasts.period)
        origins = past.times[np.unique(np.searchsorted(past.times, due))].tolist()
    asked = -inf
    for number, origin in enumerate(origins):
        if origin - asked < ask_period:
            continue
        asked, known = origin, past.until(origin)
        report(f"{trace.name}: {', '.join(others)}", number / len(origins))
        for method, forecaster in others.items():
            if (fan := forecaster(known)) is not None:
                take(method, origin, fan)
    return rows


def persist(past: ScannedPast, horizons: tuple[float, ...]) -> Array | None:
    """Persistence for these horizons (s)."""
    return persistence(past.times, past.temperature, horizons, DENSE)


def rivals_room() -> Any:
    """The package `sim.lab.judge.rivals`. Raises ValueError where it cannot be loaded.

    Loaded only where it is wanted: its methods bring scikit-learn, which nothing else here needs.
    """
    try:
        return import_module("sim.lab.judge.rivals")
    except ModuleNotFoundError as error:
        raise ValueError(f"the rivals cannot be loaded ({error}); leave them out") from None


@dataclass(frozen=True, slots=True)
class TrainedRival:
    """A rival fitted for `horizons` (s) to traces with `inputs`, which is asked like all other methods."""

    fitted: Any
    inputs: tuple[str, ...]
    horizons: tuple[float, ...]

    def __call__(self, past: ScannedPast) -> Array:
        """(L, H) quantiles in degC; an input that this trace lacks is not known."""
        unknown = np.full(past.times.shape, np.nan)
        inputs = {name: past.inputs.get(name, unknown) for name in self.inputs}
        known = rivals_room().Past(past.times, past.temperature, inputs)
        return np.asarray(self.fitted.forecast(known, self.horizons, DENSE))


def train(rival: Any, training: Sequence[ScannedPast], horizons: tuple[float, ...]) -> TrainedRival:
    """A rival fitted to what gateways have read along whole traces, by the inputs that all of them have."""
    names = tuple(sorted(set.intersection(*(set(past.inputs) for past in training))))
    pasts = [
        rivals_room().Past(past.times, past.temperature, {name: past.inputs[name] for name in names})
        for past in training
    ]
    return TrainedRival(rival.fit(pasts, horizons), names, horizons)


def fitted_rivals(
    traces: Sequence[Trace],
    temperature: str,
    alphabet: Alphabet,
    *,
    horizons: tuple[float, ...],
    scan: float,
    seed: int,
) -> tuple[dict[str, PastForecaster], list[str]]:
    """(the rivals fitted to `traces` by name, a sentence about those that cannot be). Raises ValueError without them.

    Each is asked for `horizons` (s); the traces are read by scans every `scan` s.
    """
    past = [scanned(trace, temperature, alphabet, scan) for trace in traces]
    fitted: dict[str, PastForecaster] = {}
    absent: dict[str, list[str]] = {}
    for rival in rivals_room().rivals(seed):
        try:
            fitted[rival.name] = train(rival, past, horizons)
        except (ImportError, ValueError) as error:
            absent.setdefault(sentence(error), []).append(rival.name)
    return fitted, [f"without {', '.join(names)}: {reason}" for reason, names in absent.items()]


def _horizons(_: click.Context, __: click.Parameter, text: str) -> tuple[float, ...]:
    try:
        return ForecastSection(horizons=tuple(float(part) for part in text.split(","))).horizons
    except ValueError:
        raise click.BadParameter(f"{text!r}: give positive seconds in ascending order, such as 60,300,900") from None


@click.command(short_help="Forecast along held-out traces as the running gateway does; score it beside rivals.")
@click.argument("directory", metavar="MODEL")
@click.option("--traces", "paths", multiple=True, required=True, help="A file, a folder or a glob; may be given again.")
@map_option
@click.option("--member", "members", multiple=True, help="A model beside MODEL in an ensemble; may be given again.")
@click.option("--rivals", is_flag=True, help="Statistical methods too, fitted to the traces of --training.")
@click.option("--training", multiple=True, help="Traces that the rivals are fitted to; may be given again.")
@click.option(
    "--period", type=click.FloatRange(1.0), default=30.0, show_default=True, help="Seconds between two forecasts."
)
@click.option(
    "--horizons", default="60,300,900", show_default=True, callback=_horizons, help="Seconds ahead, ascending."
)
@click.option(
    "--scan", type=click.FloatRange(0.0, min_open=True), default=1.0, show_default=True, help="The scan period, s."
)
@click.option(
    "--picture", type=click.Path(path_type=Path, dir_okay=False), help="Also draw the figures (.png, .pdf, .svg)."
)
@seed_option
@json_option
def skill(
    directory: str,
    paths: Sequence[str],
    map_name: str,
    members: Sequence[str],
    rivals: bool,
    training: Sequence[str],
    period: float,
    horizons: tuple[float, ...],
    scan: float,
    picture: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Forecast along held-out traces as the running gateway does, and score it beside persistence and rivals.

    Every trace is followed scan by scan: events to come are not known, the bands are widened by what came true so far.
    All methods are compared at the same moments; a forecast's outcome is the reading when it is due. Means are of the
    machines' means.
    """
    if rivals and not training:
        raise click.UsageError("--rivals are fitted to traces: name them with --training")
    with sentences(), progress("forecasting") as report:
        if picture is not None:
            check_picture(picture)
        traces, column_map = load(paths, map_name)
        temperature, alphabet = column_map.temperature, column_map.alphabet
        ours = [
            find_model(name, alphabet=alphabet, temperature=temperature).runnable() for name in (directory, *members)
        ]
        temperature, alphabet = ours[0].temperature, ours[0].alphabet
        learned = load_traces(list(training), load_map(shipped("traces", map_name)))[0] if training else []
        others: dict[str, PastForecaster] = {PERSISTENCE: partial(persist, horizons=horizons)}
        notes: list[str] = []
        if rivals:
            fitted, notes = fitted_rivals(learned, temperature, alphabet, horizons=horizons, scan=scan, seed=seed)
            others |= fitted
        forecasts = ForecastSection(horizons=horizons, period=period, seed=seed)
        rows: list[SkillRow] = []
        offsets: list[dict[str, Any]] = []
        for trace in traces:
            own = skill_rows(
                trace,
                temperature,
                alphabet,
                models={OURS: ours},
                others=others,
                forecasts=forecasts,
                scan_period=scan,
                report=report,
            )
            rows += own
            notes += lacking(trace, own, horizons)
            learned_offset = machine_offset_along(ours[0], trace, scan_period=scan)
            if learned_offset is not None:
                mean, sigma = learned_offset
                offsets.append({"machine": machine_of(trace), "trace": trace.name, "offset": mean, "sigma": sigma})
        if not rows:
            raise ValueError(f"no forecast came due: {'; '.join(notes)}; give longer traces or shorter --horizons")
        found = forecast_skill(rows, [OURS], seed=seed, notes=notes, unit=ours[0].unit)
        if picture is not None:
            draw_skill({ours[0].sha.name: common(rows)}, picture)
    data = {"model": ours[0].sha.name, "members": len(members), "period": period, **found.as_plain()}
    data |= {"machine offsets": offsets, "picture": picture and str(picture)}
    emit(data, lambda: show(found, offsets, picture), as_json_line=as_json)


def lacking(trace: Trace, rows: Sequence[SkillRow], horizons: Sequence[float]) -> list[str]:
    """A sentence for the horizons (s) that no forecast along the trace has come due for."""
    missing = [f"{horizon:g}" for horizon in horizons if all(row.horizon != horizon for row in rows)]
    lasts = f"{trace.times[-1] - trace.times[0]:.4g} s" if trace.times.size else "no time: it has no rows"
    return [f"{trace.name}: no forecast for {', '.join(missing)} s came due; it lasts {lasts}"] if missing else []


def show(found: ForecastSkill, offsets: Sequence[Mapping[str, Any]], picture: Path | None) -> None:
    """The tables as text, and what was learned of each machine along its trace."""
    show_skill(found)
    if offsets:
        title = f"what this machine's targets lie above the model's, at the end of its trace ({shown_unit(found.unit)})"
        table(title, list(offsets[0]), [list(row.values()) for row in offsets])
    if picture is not None:
        click.echo(f"picture: {picture}")


def show_skill(found: ForecastSkill, wanted: Sequence[str] = ("by horizon", "by time", "by machine")) -> None:
    """The `wanted` tables, the differences, what the forecasts are worth, and the notes, as text."""
    unit = shown_unit(found.unit)
    titles = {
        "by horizon": f"forecasts by horizon ({unit}; coverage of the 90 % band)",
        "by time": "the same by the time since the trace's start",
        "by machine": "the same by machine",
    }
    for name in wanted:
        rows = found.tables[name]
        # One machine alone has been shown in the table by horizon.
        if rows and (name != "by machine" or len({row["machine"] for row in rows}) > 1):
            table(titles[name], list(rows[0]), [list(row.values()) for row in rows])
    if rows := found.tables["differences"]:
        title = "CRPS minus that of the best other method, over machines (95 % interval)"
        table(title, list(rows[0]), [list(row.values()) for row in rows])
    for said in found.sentences:
        click.echo(said)
    for note in found.notes:
        click.echo(f"note: {note}")
