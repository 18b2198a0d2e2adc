"""The demonstration's figures over seeds: how long before the limit each alarm comes, and how often in vain.

`python -m benchmarks.demo_seeds [--seeds 20] [--histories 4] [--json FILE]`: the alarms are scored on one day for each
seed, in which the bearing runs to its limit and nobody acts. It is the demonstration without its processes: the
gateway's own predictor, bands and ensemble follow the day scan by scan (`forecast_trace`), with the demonstration's
periods. A day has one richer feed that is harmless, and one heat. The models are learned from histories of three days;
the days take turns with them (`--histories` as many as seeds: each day has its own, as in the demonstration).
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from statistics import mean, median
from typing import Any

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from gateway.console import shipped_file
from gateway.demo.lead_time import AHEAD_S, AlarmScore, first_crossing, forecast_chances, rivals, score
from gateway.demo.prepare import LEAST_FORECAST_S, P_LIMIT, PLANT_LIMIT, pace
from gateway.lab.learning.learn import learn_traces
from sim.lab.recordings import load_map
from sim.plant import heat_history, uncontrolled_heat_day
from sim.sha import Model, Trace, encode

FORECASTS = (("forecast", AHEAD_S, P_LIMIT), ("forecast, 10 % in 5 min", 300.0, 0.1))
"""The demonstration's own alarm, and the one that was chosen on other days than are reported here."""


@cache
def learned(seed: int) -> Model:
    """The model of one history."""
    column_map = load_map(shipped_file("traces", "decanter"))
    days = [replace(trace, events=encode(trace, column_map.alphabet)) for trace in heat_history(seed)]
    return learn_traces(days, column_map, name="demo", seed=seed, report=lambda *_: None).model


def scores_of(model: Model, day: Trace) -> list[AlarmScore]:
    """Every alarm's score on one day."""
    _, speed, scan_period = pace(day, None)
    period = max(10.0, 5 * scan_period, LEAST_FORECAST_S * speed)
    reached = first_crossing(day, model.temperature, PLANT_LIMIT)
    forecasts = forecast_chances(model, day, limit=PLANT_LIMIT, period=period, scan_period=scan_period)
    others = rivals(
        model,
        day,
        temperature=model.temperature,
        limit=PLANT_LIMIT,
        p_limit=P_LIMIT,
        period=period,
        scan_period=scan_period,
    )
    return [
        *(
            score(name, alarm, reached, usable)
            for name, ahead, p_limit in FORECASTS
            for alarm, usable in [forecasts.alarm(ahead=ahead, p_limit=p_limit)]
        ),
        *(score(name, moments, reached) for name, moments in others.items()),
    ]


def summed(scores: Sequence[AlarmScore]) -> dict[str, Any]:
    """One alarm's figures over all days; lead times in minutes."""
    leads = sorted(each.lead_s / 60 for each in scores if each.lead_s is not None)
    usable = [each.usable_s / 60 for each in scores if each.usable_s is not None]
    return {
        "days": len(scores),
        "lead_median": median(leads) if leads else None,
        "lead_least": leads[0] if leads else None,
        "lead_most": leads[-1] if leads else None,
        "usable_mean": mean(usable) if usable else None,
        "missed": sum(each.missed for each in scores),
        "false": sum(each.false for each in scores),
        "days_with_false": sum(each.false > 0 for each in scores),
    }


def show(figures: dict[str, dict[str, Any]], console: Console) -> None:
    """The table that the documentation shows."""
    table = Table(box=SIMPLE)
    for name in (
        "alarm",
        "lead, median (min)",
        "least",
        "most",
        "at the PLC, mean",
        "missed",
        "false",
        "days with one",
    ):
        table.add_column(name, justify="left" if name == "alarm" else "right")
    for name, row in figures.items():
        leads = [row[key] for key in ("lead_median", "lead_least", "lead_most", "usable_mean")]
        counts = [row[key] for key in ("missed", "false", "days_with_false")]
        table.add_row(name, *("-" if lead is None else f"{lead:.1f}" for lead in leads), *map(str, counts))
    console.print(table)


@click.command()
@click.option("--seeds", type=click.IntRange(1), default=20, show_default=True)
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The first seed.")
@click.option("--histories", type=click.IntRange(1), default=4, show_default=True)
@click.option("--json", "path", type=click.Path(path_type=Path), help="Write the scores of each seed here.")
def main(seeds: int, first: int, histories: int, path: Path | None) -> None:
    """Score the demonstration's alarms over seeds."""
    by_name: dict[str, list[AlarmScore]] = {}
    every: list[dict[str, Any]] = []
    for seed in range(first, first + seeds):
        day = uncontrolled_heat_day(seed)
        scored = scores_of(learned(first + (seed - first) % histories), day)
        for each in scored:
            by_name.setdefault(each.name, []).append(each)
        begin = float(day.times[0])
        plain = [each.plain() | {"raised": [moment - begin for moment in each.raised]} for each in scored]
        every.append({"seed": seed, "alarms": plain})
        words = (f"{each.name}: {'missed' if each.lead_s is None else f'{each.lead_s / 60:.1f}'}" for each in scored)
        click.echo(f"seed {seed}: " + ", ".join(words), err=True)
    figures = {name: summed(scores) for name, scores in by_name.items()}
    if path is not None:
        path.write_text(json.dumps({"figures": figures, "seeds": every}, indent=1) + "\n", encoding="utf-8")
    show(figures, Console(width=120))


if __name__ == "__main__":
    main()
