"""`decanter model version shadow`: two versions on live cycles, from the records; on or back to the better one.

The historian has everything that either version would have read, so that the one that does not run is forecast with
afterwards, exactly as the gateway would have: it costs the running gateway nothing, and cannot disturb it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import ceil, inf
from pathlib import Path
from typing import Any

import click

from gateway.console import (
    CommandResult,
    Part,
    Rows,
    conclude,
    progress,
)
from gateway.entry import interruptible, sentences
from gateway.lab.judging.figures import LONGEST_HORIZON, MAX_FORECASTS_PER_CYCLE, score_trace
from gateway.lab.retraining.cutting import CycleSource, Progress, cut_new, extend_cycle, read_cycle
from gateway.lab.retraining.cycle_library import CycleLibrary, CycleRow, open_library
from gateway.lab.retraining.training_record import creation_time, read_record
from gateway.store import machines, newest_scan, reading
from sim.artefacts import current, load, objection, promote, ran, read_familiarity, version_directory, versions
from sim.lab.judge import HorizonComparison, compare_horizons
from sim.sha import Trace, display_unit, encode_trace

LIVE = "live cycles"
MIN_TEST_CYCLES, MAX_TEST_CYCLES = 8, 24
"""Live cycles that a paired test needs, and how many of the newest it takes."""
DAY_S = 86_400.0
"""s; cycles of one day share operator, product and weather, and are no independent witnesses."""
TRIAL_DAYS, CYCLES_A_DAY = 7, 6
"""The days (UTC), the first since both versions were made, by whose live cycles a candidate is promoted or not, and how
many cycles of a day at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SideBySide:
    """The version that `runs` now, the one that was `judged` against what `stood`, on how many live `cycles`.

    `days` is on how many days they began, `enough` whether they are what a verdict takes, `promoted` the version that
    this has promoted, "" for none.
    """

    runs: str
    judged: str
    stood: str
    cycles: int
    days: int
    enough: bool
    promoted: str
    sentence: str
    comparisons: tuple[HorizonComparison, ...]


def side_by_side(
    store: Path,
    historian: Path,
    library: CycleLibrary,
    *,
    machine: str,
    version: str | None = None,
    roll_back: bool = False,
    promotes: bool = False,
    seed: int,
    report: Progress,
    most: int = MAX_FORECASTS_PER_CYCLE,
) -> SideBySide:
    """Both versions on the cycles since the younger of them was made, and what the stated policy makes of it.

    The current version is judged against `version` (default: the one that ran before). With `roll_back` that one, which
    must have run, is promoted again where the current one is worse at some horizon. With `promotes` `version`, which
    must not have run, is judged instead, and promoted where it is better at some horizon and worse at none, as a
    retraining proposes: on the cycles of its first TRIAL_DAYS and no others, so that it is judged once, however often a
    timer asks. There the test takes a day as one difference, as the cycles of a day share operator, product and weather
    (record 0146). A cycle has `most` forecasts at most. Raises ValueError where there is no such version.
    """
    running = current(store)
    other = version or former_version(store)
    if other == running or other not in versions(store):
        said = repr(other) if other else "the version before the current one, of which nothing is on record,"
        raise ValueError(
            f"{store}: {said} is no other version of this store; name "
            f"one of: {', '.join(name for name in versions(store) if name != running) or 'none yet'}"
        )
    known = {*ran(store), former_version(store)}
    if roll_back and other not in known:
        raise ValueError(f"{store}: {other} has never run, and there is no way back to it; judge it with --promote")
    if promotes and other in known:
        raise ValueError(
            f"{store}: {other} has run, and was replaced since: it is no candidate any more; a person may run it again "
            f"with `decanter model version promote {store} {other}`"
        )
    judged, stood = (other, running) if promotes else (running, other)
    new, old = load(store, judged), load(store, stood)
    since = max(creation_time(version_directory(store, name)) for name in (running, other))
    present = load(store, running)
    source = CycleSource(historian=historian, machine=machine, model=present, version=running, since=-inf)
    familiar = read_familiarity(version_directory(store, running))
    cut_new(library, source, None if familiar is None else familiar.reference, report)
    seen = {*new.provenance.contents, *old.provenance.contents}
    live = [
        row
        for row in library.cycles()
        if row.begin >= since and not row.is_excluded and row.error is not None and row.content not in seen
    ]
    live = trial_cycles(live) if promotes else live[-MAX_TEST_CYCLES:]
    scores: list[dict[str, Any]] = []
    traces = list[Trace]()
    for row in live:
        trace = read_cycle(source, row, library)
        if trace is None:
            continue
        traces.append(trace)
        if promotes:
            # What judges a candidate outlives the historian's retention, or its verdict would change with that.
            library.keep(row.name, trace)
    days = len({utc_day(float(trace.times[0])) for trace in traces})
    enough = days == TRIAL_DAYS and len(traces) == len(live) if promotes else len(traces) >= MIN_TEST_CYCLES
    for trace in traces if enough or not promotes else ():
        followed = encode_trace(extend_cycle(source, trace, LONGEST_HORIZON), present.alphabet)
        until = float(trace.times[-1])
        rows = score_trace(followed, old, new, seed=seed, report=report, most=most, until=until)
        scores += [row | {"day": utc_day(float(trace.times[0]))} for row in rows]
    comparisons = compare_horizons(LIVE, scores, seed=seed, unit="day" if promotes else "trace")
    worse = [each for each in comparisons if each.outcome == "worse"]
    better = [each for each in comparisons if each.outcome == "better"]
    promoted = ""
    if not enough:
        on = f" on {days} of {TRIAL_DAYS} days" if promotes else ""
        sentence = f"{len(traces)} cycles{on} since both were made are too few to tell"
        sentence += "" if promotes else f"; it takes {MIN_TEST_CYCLES}"
        if len(traces) < len(live):
            sentence += f", and {len(live) - len(traces)} are neither kept nor in the historian any more"
    elif worse:
        sentence = f"{judged} is worse than {stood} at {', '.join(f'{each.horizon:g} s' for each in worse)}"
        # Better is told from the longest horizon on, and that is what warns: less right a minute ahead is no harm then.
        if better:
            sentence += f", and better at {', '.join(f'{each.horizon:g} s' for each in better)}"
        promoted = stood if roll_back and not better else ""
    elif better:
        sentence = f"{judged} is better than {stood} at {', '.join(f'{each.horizon:g} s' for each in better)}"
        refusing = [f"{each.horizon:g} s" for each in comparisons if each.refuses]
        promoted = judged if promotes and not refusing else ""
        if refusing:
            sentence += f", and not told apart but by its mean worse at {', '.join(refusing)}"
    else:
        sentence = f"{judged} and {stood} are not told apart"
    if promoted:
        # A person may force what was judged unfit where it was learned; a timer may not.
        # How both verdicts compare (`version promote` asks that) is older than these live cycles, which decide.
        _, reason = objection(store, promoted)
        if reason:
            sentence += f"; {promoted} is not promoted, as {reason}"
            promoted = ""
        else:
            promote(store, promoted)
            sentence += f"; {promoted} is promoted{' again' if roll_back else ''}"
    return SideBySide(
        runs=promoted or running,
        judged=judged,
        stood=stood,
        cycles=len(traces),
        days=days,
        enough=enough,
        promoted=promoted,
        sentence=sentence,
        comparisons=tuple(comparisons),
    )


def utc_day(time: float) -> int:
    """The day (UTC) of a time (s UTC)."""
    return int(time // DAY_S)


def trial_cycles(live: Sequence[CycleRow]) -> list[CycleRow]:
    """The cycles, given in the order of time, by which a candidate is judged: of TRIAL_DAYS that are over.

    A day is over when a cycle of a later one is there; of its cycles CYCLES_A_DAY at most judge, evenly over it.
    """
    days = [list(rows) for _, rows in groupby(live, lambda row: utc_day(row.begin))][:-1]
    return [row for rows in days[:TRIAL_DAYS] for row in rows[:: ceil(len(rows) / CYCLES_A_DAY)]]


def former_version(store: Path) -> str:
    """The version that ran before the current one, "" where nothing says which.

    Of a store of a former release it is the one beside which the current one was learned.
    """
    running = current(store)
    former = [name for name in ran(store) if name != running]
    if former:
        return former[-1]
    record = read_record(version_directory(store, running))
    return "" if record is None else record.parent


def shadow_command(
    store: Path,
    version: str | None,
    historian: Path,
    machine: str | None,
    folder: Path | None,
    roll_back: bool,
    promotes: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Carry out `decanter model version shadow`; its options and its help are in retraining/commands.py."""
    if promotes and (roll_back or version is None):
        raise click.UsageError("--promote needs the VERSION that waits for it, and excludes --roll-back")
    with sentences(), progress("comparing") as bar, interruptible(bar) as report:
        temperature = load(store).temperature
        with reading(historian) as connection:
            if newest_scan(connection, machine=machine) is None:
                raise ValueError(f"{historian}: this historian has no scan yet; let the gateway run first")
            name = machine if machine is not None else next(iter(dict(machines(connection))))
        place = folder or historian.parent / "cycles" / "-".join(filter(None, (name, temperature)))
        with open_library(place, machine=name, temperature=temperature) as library:
            found = side_by_side(
                store,
                historian,
                library,
                machine=name,
                version=version,
                roll_back=roll_back,
                promotes=promotes,
                seed=seed,
                report=report,
            )
        unit = load(store).unit
    data = {"current": found.runs, "compared": [found.judged, found.stood], "cycles": found.cycles}
    data |= {"days": found.days, "enough": found.enough}
    data |= {"rolled_back": roll_back and bool(found.promoted), "promoted": found.promoted}
    data |= {"sentence": found.sentence, "comparisons": [each.as_plain() for each in found.comparisons]}

    def show() -> Iterator[Part]:
        unit_of_test = "days" if promotes else "cycles"
        columns = ("horizon (s)", unit_of_test, found.judged, found.stood, "difference", "p", "told apart")
        rows = [each.cells() for each in found.comparisons]
        if rows:
            yield Rows(f"CRPS on live cycles ({display_unit(unit)})", columns, rows)
        yield found.sentence

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)
