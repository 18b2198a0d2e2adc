"""How good are our forecasts beside rivals? MAE, CRPS and coverage of the 90 % band along traces held out.

Each machine or trip is held out in turn: a model is learned from the others and follows the held-out trace as the
running gateway does (`lab.judging.figures`), events to come unknown and bands widened online. SKAB's one recording is
held out by its halves. The trip of another car is forecast by models of all trips of the first. `--judge` takes
folders `carobd`, `skab`, `femto` of machines that are in no training: models of all shared traces forecast them.

The measured data are looked for in ../shared/data; a set that is not there is left out. All methods of a set are
scored at the same moments; figures are means of the machines' means. Against the best other method, ours have a ratio
with its interval over machines, by the time since a trace's start. The whole SKAB (34 files), carOBD (129 trips) and
FEMTO (`Full_Test_Set`, a folder a bearing) are public: github.com/waico/SKAB, eron93br/carOBD and
wkzs111/phm-ieee-2012-data-challenge-dataset; what is put into the folders of `--judge` is their judge.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any

import click
import numpy as np
from joblib import Parallel, delayed

from benchmarks.figures import Figure, give
from gateway.console import table
from gateway.lab.judging.figures import rivals_room, scan_trace, skill_rows
from gateway.settings import ForecastSection
from sim.lab.judge import (
    MAX_CRPS_RATIO,
    MIN_INTERVAL_DIFFERENCES,
    TRACE_PARTS_S,
    PastForecaster,
    Skill,
    SkillRow,
    common,
    draw_skill,
    group_rows,
    persist,
    skill,
    stretch,
    tables,
    train_rival,
)
from sim.lab.learning import PERSISTENCE
from sim.lab.learning.bins import learn_bins
from sim.lab.learning.lsha import learn_lsha
from sim.lab.pictures import check_picture
from sim.lab.recordings import ColumnMap, load_map, load_traces
from sim.sha import Model, Trace

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
SETS: Mapping[str, tuple[str, str]] = {
    "car": ("carobd", "carobd"),
    "pump": ("skab", "skab"),
    "bearing": ("femto", "femto_bearing"),
}
"""Column map and folder by the set's name."""
OTHER_CAR = ("can_obd2", "can_obd2")
OURS = ("bins", "lsha")
HORIZONS = (60.0, 300.0, 900.0)
JUDGE = ", judge"
"""How the titles of sets end whose machines are in no training."""
QUICK = {"car": ("drive12", "idle1"), "bearing": ("Bearing2_4_temp",)}
"""What the short form holds out of a set."""


@dataclass(frozen=True, slots=True)
class Pace:
    """Seconds between our forecasts, at least between those of the rivals (some are slow), and between scans."""

    forecasts: float
    rivals: float
    scans: float = 1.0


@dataclass(frozen=True, slots=True)
class Fold:
    """What methods of one set learn from and what they forecast then."""

    title: str
    column_map: ColumnMap
    training: tuple[Trace, ...]
    tests: tuple[Trace, ...]


def loaded(name: str, folder: Path) -> tuple[ColumnMap, list[Trace]]:
    """The traces of a folder by the map of that name; none where the folder is not there."""
    column_map = load_map(ROOT / "config" / "traces" / f"{name}.toml")
    return column_map, load_traces(str(folder), column_map)[0] if folder.is_dir() else []


def folds(name: str, data: Path, judge: Path | None, *, quick: bool) -> Iterator[Fold]:
    """What is held out of a set, one after another."""
    map_name, folder = SETS[name]
    column_map, traces = loaded(map_name, data / folder)
    if not traces:
        return
    if len(traces) == 1:
        (trace,) = traces
        middle = float(trace.times[0] + trace.times[-1]) / 2.0
        first = replace(trace.between(-1e18, middle), name=f"{trace.name}, first half")
        second = replace(trace.between(middle, 1e18), name=f"{trace.name}, second half")
        for training, test in ((first, second), (second, first))[: 1 if quick else 2]:
            yield Fold(name, column_map, (training,), (test,))
    else:
        for held in traces:
            if not quick or held.name in QUICK.get(name, (held.name,)):
                yield Fold(name, column_map, tuple(trace for trace in traces if trace is not held), (held,))
    others = []
    if name == "car" and not quick:
        others.append(("other car", loaded(OTHER_CAR[0], data / OTHER_CAR[1])[1]))
    if judge is not None:
        others.append((f"{name}{JUDGE}", loaded(map_name, judge / map_name)[1]))
    for title, tests in others:
        if tests:
            yield Fold(title, column_map, tuple(traces), tuple(tests))


def learned(fold: Fold, method: str) -> Model:
    """A model of the fold's training, as `decanter model learn` makes it."""
    learn = {"bins": learn_bins, "lsha": learn_lsha}[method]
    return learn(fold.training, fold.column_map.alphabet, fold.column_map.temperature, name=method, seed=0).model


def fitted(fold: Fold, methods: Sequence[str], pace: Pace) -> tuple[dict[str, PastForecaster], list[str]]:
    """The other methods, fitted to the fold's training, and a sentence for each that could not be.

    A rival may want a library that is not installed, or more data than there are.
    """
    rivals = {rival.name: rival for rival in known_rivals()}
    alphabet, temperature = fold.column_map.alphabet, fold.column_map.temperature
    wanted = [name for name in methods if name in rivals]
    past = [scan_trace(trace, temperature, alphabet, pace.scans) for trace in fold.training] if wanted else []
    made: dict[str, PastForecaster] = {}
    notes = []
    for name in methods:
        try:
            if name in rivals:
                made[name] = train_rival(rivals[name], past, HORIZONS)
            elif name == PERSISTENCE:
                made[name] = partial(persist, horizons=HORIZONS)
        except (ImportError, ValueError) as error:
            notes.append(f"{fold.title}: {name} is left out: {error}")
    return made, notes


def forecast(
    fold: Fold, trace: Trace, models: Mapping[str, Model], methods: Sequence[str], pace: Pace
) -> tuple[str, list[SkillRow], list[str]]:
    """The set, the rows of all methods along one trace that is held out, and what had to be left out.

    Rivals are fitted here and not sent from process to process: what they hold need not bear that.
    """
    others, notes = fitted(fold, methods, pace)
    rows = skill_rows(
        trace,
        fold.column_map.temperature,
        fold.column_map.alphabet,
        models={name: [model] for name, model in models.items()},
        others=others,
        forecasts=ForecastSection(horizons=HORIZONS, period=pace.forecasts),
        scan_period=pace.scans,
        ask_period=pace.rivals,
    )
    return fold.title, rows, notes


def rows_of(chosen: Sequence[Fold], methods: Sequence[str], *, pace: Pace, jobs: int) -> dict[str, list[SkillRow]]:
    """The rows of each set at the moments that all its methods share; progress on standard error."""
    run = Parallel(n_jobs=jobs, return_as="generator")
    begun = monotonic()

    def counted(what: str, results: Iterable[Any], count: int) -> Iterator[Any]:
        for number, result in enumerate(results, start=1):
            click.echo(f"{what}: {number} of {count}, {monotonic() - begun:.0f} s", err=True)
            yield result

    wanted = [(number, method) for number in range(len(chosen)) for method in methods if method in OURS]
    tasks = (delayed(learned)(chosen[number], method) for number, method in wanted)
    models: list[dict[str, Model]] = [{} for _ in chosen]
    for (number, method), model in zip(wanted, counted("learned", run(tasks), len(wanted)), strict=True):
        models[number][method] = model
    # The longest first, so that no process is left alone with it.
    tests = sorted(
        (
            (replace(fold, tests=()), trace, own)
            for fold, own in zip(chosen, models, strict=True)
            for trace in fold.tests
        ),
        key=lambda test: -(test[1].times[-1] - test[1].times[0]),
    )
    tasks = (delayed(forecast)(fold, trace, own, methods, pace) for fold, trace, own in tests)
    rows: dict[str, list[SkillRow]] = {fold.title: [] for fold in chosen}
    notes: list[str] = []
    for title, own_rows, own_notes in counted("forecast", run(tasks), len(tests)):
        rows[title] += own_rows
        notes += own_notes
    for note in dict.fromkeys(notes):
        click.echo(note, err=True)
    order = {method: place for place, method in enumerate(methods)}
    return {
        title: common(sorted(own, key=lambda row: (order[row.method], row.trace, row.origin)))
        for title, own in rows.items()
    }


Cells = Mapping[tuple[str, float, str], Mapping[str, Skill]]
"""The figures of each method by set, horizon and machine ("" for all machines of the set)."""


def cells(rows: Mapping[str, Sequence[SkillRow]], *, by_machine: bool) -> Cells:
    """The figures of each method in each set at each horizon, of all machines or of each."""
    found: dict[tuple[str, float, str], dict[str, Skill]] = {}
    for title, own in rows.items():
        parts = group_rows(own, lambda row: (row.horizon, row.machine if by_machine else "", row.method))
        for (horizon, machine, method), part in sorted(parts.items(), key=lambda item: item[0][0]):
            found.setdefault((title, horizon, machine), {})[method] = skill(part)
    return found


def verdict(found: Cells, ours: Sequence[str], figure: str) -> str:
    """In how many cells each of ours is as good as the best of the others, and in how many it is better."""
    parts = []
    for method in ours:
        pairs = [
            (
                getattr(own[method], figure),
                min(getattr(other, figure) for name, other in own.items() if name not in OURS),
            )
            for own in found.values()
            if method in own and set(own) - set(OURS)
        ]
        near, better = (
            sum(value <= MAX_CRPS_RATIO * least for value, least in pairs),
            sum(value < least for value, least in pairs),
        )
        parts.append(f"{method} within {MAX_CRPS_RATIO:g} of it in {near} of {len(pairs)}, better in {better}")
    return f"{figure.upper()} against the best other method: {'; '.join(parts)}"


@dataclass(frozen=True, slots=True)
class Ratio:
    """Ours over the `best` other method in MAE and CRPS, each with the 90 % interval over `machines` of the latter.

    NaN bounds where there are too few machines, or the other never erred on some. `coverage` is ours, `width` our half
    width over the best's that covers (COVERS at least), NaN where none does.
    """

    best: str
    machines: int
    mae: float
    crps: float
    low: float
    high: float
    coverage: float
    width: float


COVERS = 0.88
RESAMPLES = 2000


def ratio(rows: Sequence[SkillRow], method: str, seed: int = 0) -> Ratio | None:
    """What the rows, of one horizon and the same moments for all methods, say of `method`; None without another one.

    The interval is the percentile bootstrap over machines: forecasts of one are not independent.
    """
    by_method = group_rows(rows, lambda row: row.method)
    if method not in by_method or not set(by_method) - set(OURS):
        return None
    whole = {name: skill(own) for name, own in by_method.items()}
    others = [name for name in whole if name not in OURS]
    best = min(others, key=lambda name: whole[name].crps)
    own, their = (
        {machine: skill(part).crps for machine, part in group_rows(by_method[name], lambda row: row.machine).items()}
        for name in (method, best)
    )
    pairs = np.array([(own[machine], their[machine]) for machine in own])
    low = high = float("nan")
    if len(pairs) >= MIN_INTERVAL_DIFFERENCES:
        sums = pairs[np.random.default_rng(seed).integers(0, len(pairs), (RESAMPLES, len(pairs)))].sum(axis=1)
        if np.all(sums[:, 1] > 0):
            low, high = np.quantile(sums[:, 0] / sums[:, 1], [0.05, 0.95]).tolist()
    covering = [whole[name].half_width for name in others if whole[name].coverage >= COVERS]
    return Ratio(
        best=best,
        machines=len(pairs),
        mae=_over(whole[method].mae, min(whole[name].mae for name in others)),
        crps=_over(whole[method].crps, whole[best].crps),
        low=low,
        high=high,
        coverage=whole[method].coverage,
        width=_over(whole[method].half_width, min(covering)) if covering else float("nan"),
    )


def _over(ours: float, best: float) -> float:
    """The ratio of two figures; a machine that stood still leaves persistence without an error."""
    if best > 0:
        return ours / best
    return inf if ours > 0 else 1.0


def show_ratios(rows: Mapping[str, Sequence[SkillRow]], ours: Sequence[str]) -> None:
    """A row for each set, horizon, part of the time since the start, and method of ours."""
    lines: list[list[object]] = []
    for title, own in rows.items():
        horizons = sorted({row.horizon for row in own})
        for horizon, part in ((horizon, part) for horizon in horizons for part in ("all", *TRACE_PARTS_S)):
            chosen = [row for row in own if row.horizon == horizon and part in ("all", stretch(row))]
            for method in ours:
                if (found := ratio(chosen, method)) is not None:
                    interval = f"{found.low:.2f} to {found.high:.2f}"
                    numbers = [f"{one:.2f}" for one in (found.mae, found.crps, found.coverage, found.width)]
                    lines.append([title, horizon, part, method, found.machines, found.best, *numbers, interval])
    heads = [
        "set",
        "s",
        "since start",
        "method",
        "machines",
        "best other",
        "MAE",
        "CRPS",
        "coverage",
        "width",
        "90 % of CRPS",
    ]
    table("ours over the best other method (width: over the narrowest that covers)", heads, lines)


def show_cells(found: Cells, methods: Sequence[str]) -> None:
    """A row for each method of a cell; the lowest MAE and CRPS of the cell bear a star."""
    lines: list[list[object]] = []
    for (title, horizon, _), by_method in found.items():
        least = {name: min(getattr(own, name) for own in by_method.values()) for name in ("mae", "crps")}
        for method in (name for name in methods if name in by_method):
            own = by_method[method]
            marked = [f"{(value := getattr(own, name)):.3f}{'*' if value == least[name] else ''}" for name in least]
            lines.append([title, horizon, method, own.machines, own.forecasts, *marked, f"{own.coverage:.2f}"])
    heads = ["set", "s", "method", "machines", "forecasts", "MAE", "CRPS", "coverage"]
    table("forecasts held out (°C; * the lowest of the cell; 90 % band)", heads, lines)


@click.command(help=__doc__)
@click.option("--quick", is_flag=True, help="A few trips and a longer period.")
@click.option("--sets", default=",".join(SETS), show_default=True, help="Which sets, by commas.")
@click.option("--data", type=click.Path(path_type=Path), default=DATA, help="The folder with the measured data.")
@click.option("--judge", type=click.Path(path_type=Path), help="A folder with further machines: carobd, skab, femto.")
@click.option(
    "--methods",
    multiple=True,
    help="Only this one; may be given again.  [default: ours, persistence; not --quick: the rivals too]",
)
@click.option("--period", type=click.FloatRange(1.0), help="Seconds between forecasts.  [default: 30; quick: 120]")
@click.option(
    "--rival-period",
    type=click.FloatRange(1.0),
    help="Seconds between forecasts of rivals, and so between those that are scored.  [default: 120; quick: 600]",
)
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Processes.")
@click.option(
    "--json", "json_file", is_flag=False, flag_value="-", help="All tables as JSON to a file; alone: figures as JSON."
)
@click.option("--picture", type=click.Path(path_type=Path), help="Also draw the figures (.png, .pdf, .svg).")
def main(
    quick: bool,
    sets: str,
    data: Path,
    judge: Path | None,
    methods: Sequence[str],
    period: float | None,
    rival_period: float | None,
    jobs: int,
    json_file: str | None,
    picture: Path | None,
) -> None:
    if picture is not None:
        check_picture(picture)
    names = sets.split(",")
    if unknown := [name for name in names if name not in SETS]:
        raise click.BadParameter(f"{', '.join(unknown)}: the sets are {', '.join(SETS)}")
    chosen = [fold for name in names for fold in folds(name, data, judge, quick=quick)]
    if not chosen:
        missing = f"{data}: has none of the sets {', '.join(names)}; name their folder with --data"
        if json_file != "-":
            raise click.ClickException(missing)
        # Among all benchmarks this one has no figures where the measured data are not, and the others go on.
        click.echo(missing, err=True)
        give("skill", [], as_json=True)
        return
    there = list(dict.fromkeys([*OURS, PERSISTENCE, *(rival.name for rival in known_rivals())]))
    if strange := [name for name in methods if name not in there]:
        raise click.BadParameter(f"{', '.join(strange)}: the methods are {'; '.join(there)}")
    # The short form is one of all benchmarks, and some rivals alone take longer than those.
    default = [*OURS, PERSISTENCE] if quick else there
    wanted = [name for name in there if name in (methods or default)]
    slow = rival_period or (600.0 if quick else 120.0)
    pace = Pace(period or (120.0 if quick else 30.0), slow if set(wanted) - {*OURS, PERSISTENCE} else 0.0)
    rows = rows_of(chosen, wanted, pace=pace, jobs=jobs)
    if picture is not None:
        draw_skill(rows, picture)
    found, ours = cells(rows, by_machine=False), [name for name in OURS if name in wanted]
    if json_file == "-":
        give("skill", figures(found, ours), as_json=True)
        return
    show_cells(found, wanted)
    show_ratios(rows, ours)
    for title, counted in (("sets and horizons", found), ("machines and horizons", cells(rows, by_machine=True))):
        for where in ("", JUDGE):
            part = {key: own for key, own in counted.items() if key[0].endswith(JUDGE) == bool(where)}
            for figure in ("mae", "crps"):
                if part:
                    print(f"{title}{where}: {verdict(part, ours, figure)}")
    if json_file:
        document = {title: tables(own, ours) for title, own in rows.items()}
        Path(json_file).write_text(json.dumps(document, indent=1), encoding="utf-8")


def known_rivals() -> list[Any]:
    """The rivals, with a persistence whose band knows the training; none where they cannot be loaded."""
    try:
        return list(rivals_room().rivals(0))
    except ValueError:
        return []


def figures(found: Cells, ours: Sequence[str]) -> list[Figure]:
    """CRPS of ours against that of the best other method, and coverage against 90 %."""
    made = []
    for (title, horizon, _), by_method in found.items():
        others = {name: one.crps for name, one in by_method.items() if name not in OURS}
        best = min(others, key=lambda name: others[name]) if others else None
        for method in ours:
            what = f"{title}, {horizon:g} s, {method}"
            against, crps = ("", None) if best is None else (f"best other: {best}", others[best])
            made.append(Figure(f"{what}: CRPS", by_method[method].crps, "degC", against, crps))
            made.append(Figure(f"{what}: coverage", by_method[method].coverage, "", "nominal", 0.9))
    return made


if __name__ == "__main__":
    main()
