"""A year at the plant: a model learned once, the product's loop, a model learned daily from everything.

    python -m benchmarks.year --picture out/year.png
    python -m benchmarks.year --months 3 --days 1                     # shorter
    python -m benchmarks.year --days 30 --judged 2 --keep out/year    # every day; goes on where it was ended

Seasons, wear, a changed sensor, a new product, a swapped bearing and three operators (`plant`); of each month `--days`
are simulated, evenly over it. A day is forecast by the three models as they were on the evening before (`--judged` days
of each month, or all); then each arm is given the day (`arms`). A loop that needs a week is as slow as that only where
every day is lived: at two days of each month its week lasts from spring to summer. The loop is the product's own code,
step by step what a nightly timer would call: cycles are cut from a historian, rated, retrained from, a candidate
followed on live cycles and promoted by the stated policy, rolled back where it is worse. What came true is known to the
judge alone (`judge`). A promotion is wrong where the CRPS of the promoted model at 900 s, over the following fortnight,
is larger than that which the model before it would have had.

Figures by month and arm are printed, what the loop did and why, and the processor time of each arm. With `--keep` a
year that was ended goes on after its last whole day, and an arm that is through is not run again.
"""

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from math import nan, sqrt
from pathlib import Path
from time import process_time

import click
import numpy as np
from joblib import Parallel, delayed

from benchmarks.figures import Figure, give
from benchmarks.year.arms import Arm, Daily, Happening, Loop, Once, learned
from benchmarks.year.judge import HORIZONS, DayScore, day_score
from benchmarks.year.kept_days import KeptDays
from benchmarks.year.picture import draw_year
from benchmarks.year.plant import BEGIN, MONTHS, dates_of, day_of, days_before
from gateway.console import table
from sim.lab.pictures import check_picture, save_picture

ARMS = ("once", "loop", "daily")
FOLLOWED = 14
"""Days after a promotion over which it is judged: of fewer the mean tells the days rather than the models."""


@dataclass(frozen=True, slots=True, kw_only=True)
class YearPlan:
    """The first `months`, `days` of each of which `judged` are judged, after a first model of `before` days."""

    months: int
    days: int
    judged: int
    before: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Promotion:
    """CRPS at the longest horizon (degC) over the `days` after a promotion: of the promoted model and of the former.

    `error` is the standard error of their difference, day by day (NaN of a single day).
    """

    day: float
    days: int
    promoted: float
    former: float
    error: float

    @property
    def wrong(self) -> bool:
        """Whether the promoted model did worse on the days that followed."""
        return self.promoted > self.former


@dataclass(frozen=True, slots=True, kw_only=True)
class Year:
    """What one arm came to."""

    arm: str
    scores: tuple[DayScore, ...]
    happenings: tuple[Happening, ...]
    promotions: tuple[Promotion, ...]
    seconds: float


def lived(arm: str, plan: YearPlan, folder: Path) -> Year:
    """A year with one arm, which goes on where it was ended in `folder`; the same plant for all of them."""
    kept = KeptDays(folder / arm, asdict(plan))
    seed = plan.seed
    history = days_before(plan.before, seed=seed)
    begin = process_time()
    first = learned(history, seed)
    made: Arm
    if arm == "once":
        made = Once(first)
    elif arm == "daily":
        made = Daily(first, history, seed)
    else:
        made = Loop(first, history, kept.work, seed, BEGIN)
    if not kept.days:
        kept.seconds = process_time() - begin
    dates = dates_of(plan.months, plan.days, plan.judged)
    if kept.days:
        made.go_on(kept.state, (day_of(date, seed=seed) for date in dates[: kept.days]))
    for date in dates[kept.days :]:
        day = day_of(date, seed=seed)
        begin = process_time()
        model = made.model if date.judged else None
        kept.seconds += process_time() - begin
        if model is not None:
            kept.scores.append(day_score(arm, model, day, seed=seed))
        begin = process_time()
        made.evening(day)
        kept.seconds += process_time() - begin
        done = [each for each in made.happenings if each.day == day.number]
        kept.happenings += done
        kept.state = made.to_plain()
        kept.days += 1
        kept.keep()
        # A year takes long: what has come of it so far is said as it comes.
        lines = [f"  day {day.number:.0f}: {each.kind}: {each.words}" for each in done]
        if model is not None:
            score = kept.scores[-1]
            so_far = f"{arm}: day {day.number:.0f}, MAE {', '.join(f'{value:.2f}' for value in score.mae)} degC, "
            so_far += f"coverage {score.coverage[-1]:.2f}, {score.overheated} overheatings, {score.false} false alarms"
            lines.insert(0, so_far)
        for line in lines:
            click.echo(line, err=True)
    return Year(
        arm=arm,
        scores=tuple(kept.scores),
        happenings=tuple(kept.happenings),
        promotions=tuple(judged_promotions(made, plan)),
        seconds=kept.seconds,
    )


def judged_promotions(made: Arm, plan: YearPlan) -> Iterator[Promotion]:
    """Each promotion by the days that followed it, of those that were lived."""
    for promoted_on, models in made.promotions().items():
        dates = [date for date in dates_of(plan.months, plan.days) if date.number > promoted_on][:FOLLOWED]
        days = [day_of(date, seed=plan.seed) for date in dates]
        scores = [[day_score("", model, day, seed=plan.seed).crps[-1] for model in models] for day in days]
        if scores:
            former, promoted = np.mean(scores, axis=0).tolist()
            differences = np.diff(scores, axis=1)[:, 0]
            error = float(np.std(differences, ddof=1) / sqrt(len(scores))) if len(scores) > 1 else nan
            yield Promotion(day=promoted_on, days=len(scores), promoted=promoted, former=former, error=error)


def figures_of(years: Sequence[Year]) -> list[Figure]:
    """The year in figures, each arm against the model that was learned once."""
    by_arm = {year.arm: year for year in years}
    base = by_arm.get("once", years[0])
    found: list[Figure] = []
    for year in years:
        for column, horizon in enumerate(HORIZONS):
            for name, unit in (("mae", "°C"), ("crps", "°C"), ("coverage", "")):
                value, other = (
                    float(np.nanmean([getattr(score, name)[column] for score in each.scores])) for each in (year, base)
                )
                found.append(Figure(f"{year.arm}: {name} at {horizon:g} s", value, unit, base.arm, other))
        leads = [lead for score in year.scores for lead in score.leads]
        events = sum(score.overheated for score in year.scores)
        found += [
            Figure(f"{year.arm}: overheatings foretold", len(leads), "", "overheatings", events),
            Figure(f"{year.arm}: median lead", float(np.median(leads)) / 60.0 if leads else 0.0, "min"),
            Figure(f"{year.arm}: alarms", sum(score.alarms for score in year.scores), ""),
            Figure(f"{year.arm}: false alarms", sum(score.false for score in year.scores), ""),
            Figure(f"{year.arm}: processor time", year.seconds, "s"),
        ]
    if (loop := by_arm.get("loop")) is not None:
        kinds = [each.kind for each in loop.happenings]
        found += [
            Figure("retrainings", kinds.count("proposal") + kinds.count("no proposal"), ""),
            Figure("promotions", kinds.count("promotion"), ""),
            Figure("roll-backs", kinds.count("roll-back"), ""),
            Figure(
                "wrong promotions", sum(each.wrong for each in loop.promotions), "", "promotions", len(loop.promotions)
            ),
        ]
    return found


def show_months(years: Sequence[Year]) -> None:
    """Error and coverage by month, and what the loop did."""
    columns = ["month", *(f"{year.arm}: {name}" for year in years for name in ("MAE 900 s", "coverage", "false"))]
    rows: list[list[object]] = []
    for month in sorted({score.month for score in years[0].scores}):
        row: list[object] = [month + 1]
        for year in years:
            own = [score for score in year.scores if score.month == month]
            row += [
                float(np.mean([score.mae[-1] for score in own])),
                float(np.mean([score.coverage[-1] for score in own])),
                sum(score.false for score in own),
            ]
        rows.append(row)
    table("By month", columns, rows)
    for year in years:
        for each in year.happenings:
            what = f"{each.kind} {each.version}".rstrip()
            click.echo(f"day {each.day:.0f}: {what}: {each.words}")
        for promotion in year.promotions:
            click.echo(
                f"promotion of day {promotion.day:.0f}: CRPS at 900 s over the next {promotion.days} days "
                f"{promotion.promoted:.3g}, of the model before it {promotion.former:.3g}, difference "
                f"{promotion.promoted - promotion.former:+.2g} +- {promotion.error:.2g} degC"
            )


@click.command(help=(__doc__ or "").split("\n\n", 1)[0])
@click.option("--months", type=click.IntRange(1, MONTHS), default=MONTHS, show_default=True)
@click.option("--days", type=click.IntRange(1), default=2, show_default=True, help="Days of each month.")
@click.option("--judged", type=click.IntRange(1), help="Of these, the days along which is forecast.  [all]")
@click.option("--before", type=click.IntRange(2), default=3, show_default=True, help="Days of the first model.")
@click.option("--arms", default=",".join(ARMS), show_default=True, help="Which, by commas.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Arms at a time.")
@click.option("--picture", type=click.Path(path_type=Path), help="Draw the year (.png, .pdf, .svg).")
@click.option("--keep", type=click.Path(path_type=Path, file_okay=False), help="Folder in which a year goes on.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(
    months: int,
    days: int,
    judged: int | None,
    before: int,
    arms: str,
    jobs: int,
    picture: Path | None,
    keep: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Print what a year is worth to each arm."""
    names = arms.split(",")
    if unknown := [name for name in names if name not in ARMS]:
        raise click.UsageError(f"--arms: {unknown[0]!r} is none of {', '.join(ARMS)}")
    if picture is not None:
        check_picture(picture)
    with tempfile.TemporaryDirectory(prefix="year-") as scratch:
        plan = YearPlan(months=months, days=days, judged=min(judged or days, days), before=before, seed=seed)
        years: list[Year] = Parallel(n_jobs=jobs)(delayed(lived)(name, plan, keep or Path(scratch)) for name in names)
    if keep is not None:
        text = json.dumps([asdict(year) for year in years], indent=1) + "\n"
        (keep / "year.json").write_text(text, encoding="utf-8")
    if picture is not None:
        save_picture(draw_year(years), picture, picture.suffix[1:].lower())
    if not as_json:
        show_months(years)
    give("year", figures_of(years), as_json=as_json)


if __name__ == "__main__":
    main()
