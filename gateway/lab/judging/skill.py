"""`decanter model judge skill`: forecasts along held-out traces as the running gateway makes them, beside rivals."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from gateway.console import (
    CommandResult,
    Part,
    Rows,
    conclude,
    progress,
    shipped_file,
)
from gateway.entry import sentences
from gateway.lab.judging.figures import missing_horizons, other_methods, skill_rows
from gateway.lab.options import MOST_MOMENTS
from gateway.lab.traces.load import load
from gateway.machine.model import estimate_offset
from gateway.settings import ForecastSection
from sim.lab.formats import find_model
from sim.lab.judge import ForecastSkill, SkillRow, common, draw_skill, forecast_skill, trace_machine
from sim.lab.pictures import check_picture
from sim.lab.recordings import load_map, load_traces
from sim.sha import Model, Trace, display_unit

OURS = "decanter"


@dataclass(frozen=True, slots=True, kw_only=True)
class SkillAlong:
    """What forecasts along traces are worth: `found`, the `rows` that it is made of, what was learned of machines."""

    found: ForecastSkill
    rows: Sequence[SkillRow]
    offsets: Sequence[Mapping[str, Any]]


def spread_period(trace: Trace, period: float, moments: int) -> float:
    """The seconds between two forecasts of a trace: `period`, or more where there would be more than `moments`."""
    return max(period, float(trace.times[-1] - trace.times[0]) / moments) if trace.times.size else period


def measure_skill(
    ours: Sequence[Model],
    traces: Sequence[Trace],
    *,
    training: Sequence[Trace] | None,
    forecasts: ForecastSection,
    scan: float,
    moments: int = MOST_MOMENTS,
    report: Callable[[str, float], None] = lambda what, share: None,
) -> SkillAlong:
    """Forecasts along traces, of the first of `ours` with the others as its members, beside persistence and rivals.

    Rivals are fitted to `training`; None asks for none. A trace gets a forecast each `forecasts.period` s, or fewer,
    evenly, where those would be more than `moments`; `scan` is the scan period in s. Raises ValueError where no
    forecast came due or has an outcome, for a trace that a model cannot follow, and for rivals that cannot be loaded.
    """
    first, horizons, seed = ours[0], forecasts.horizons, forecasts.seed
    if training is not None:
        report("fitting the rivals", 0.0)
    others, notes = other_methods(training, first.temperature, first.alphabet, horizons=horizons, scan=scan, seed=seed)
    rows: list[SkillRow] = []
    offsets: list[dict[str, Any]] = []
    for number, trace in enumerate(traces):
        period = spread_period(trace, forecasts.period, moments)
        if period > forecasts.period:
            notes.append(
                f"{trace.name}: a forecast each {period:.4g} s, for no more than {moments} moments; more of them say "
                "the same more exactly"
            )
        own = skill_rows(
            trace,
            first.temperature,
            first.alphabet,
            models={OURS: ours},
            others=others,
            forecasts=forecasts.model_copy(update={"period": period}),
            scan_period=scan,
            report=lambda what, share, number=number: report(what, (number + share) / len(traces)),  # type: ignore[misc]
        )
        rows += own
        notes += missing_horizons(trace, own, horizons)
        learned_offset = estimate_offset(first, trace, scan_period=scan)
        if learned_offset is not None:
            mean, sigma = learned_offset
            offsets.append({"machine": trace_machine(trace), "trace": trace.name, "offset": mean, "sigma": sigma})
    if not rows:
        raise ValueError(f"no forecast came due: {'; '.join(notes)}; give longer traces or shorter horizons")
    if not any(row.read for row in rows):
        raise ValueError(f"no forecast has an outcome: {'; '.join(notes)}")
    return SkillAlong(
        found=forecast_skill(rows, [OURS], seed=seed, notes=notes, unit=first.unit), rows=rows, offsets=offsets
    )


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
    moments: int,
    picture: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Carry out `decanter model judge skill`; its options and its help are in judging/commands.py."""
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
        learned = load_traces(list(training), load_map(shipped_file("traces", map_name)))[0] if training else []
        along = measure_skill(
            ours,
            traces,
            training=learned if rivals else None,
            forecasts=ForecastSection(horizons=horizons, period=period, seed=seed),
            scan=scan,
            moments=moments,
            report=report,
        )
        found, offsets = along.found, along.offsets
        if picture is not None:
            draw_skill({ours[0].sha.name: common(along.rows)}, picture)
    data = {"model": ours[0].sha.name, "members": len(members), "period": period, **found.as_plain()}
    data |= {"machine offsets": offsets, "picture": picture and str(picture)}
    conclude(CommandResult(data), lambda _: show(found, offsets, picture), as_json=as_json)


def show(found: ForecastSkill, offsets: Sequence[Mapping[str, Any]], picture: Path | None) -> Iterator[Part]:
    """The tables as text, and what was learned of each machine along its trace."""
    yield from show_skill(found)
    if offsets:
        title = (
            f"what this machine's targets lie above the model's, at the end of its trace ({display_unit(found.unit)})"
        )
        yield Rows(title, list(offsets[0]), [list(row.values()) for row in offsets])
    if picture is not None:
        yield f"picture: {picture}"


def show_skill(found: ForecastSkill, wanted: Sequence[str] = ("by horizon", "by time", "by machine")) -> Iterator[Part]:
    """The `wanted` tables, the differences, what the forecasts are worth, and the notes, as text."""
    unit = display_unit(found.unit)
    titles = {
        "by horizon": f"forecasts by horizon ({unit}; coverage of the 90 % band)",
        "by time": "the same by the time since the trace's start",
        "by machine": "the same by machine",
    }
    for name in wanted:
        rows = found.tables[name]
        # One machine alone has been shown in the table by horizon.
        if rows and (name != "by machine" or len({row["machine"] for row in rows}) > 1):
            yield Rows(titles[name], list(rows[0]), [list(row.values()) for row in rows])
    if rows := found.tables["differences"]:
        title = "CRPS minus that of the best other method, over machines (95 % interval)"
        yield Rows(title, list(rows[0]), [list(row.values()) for row in rows])
    yield from found.sentences
    for note in found.notes:
        yield f"note: {note}"
