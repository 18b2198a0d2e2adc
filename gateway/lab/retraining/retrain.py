"""`decanter model version retrain`: from the historian to a proposed version, in steps that a kill does not undo."""

import os
import time
from collections.abc import Iterator, Sequence
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
from gateway.lab.models.propose import RecordedDrift, recorded_drift
from gateway.lab.resource_usage import peak_megabytes
from gateway.lab.retraining.cycle_library import open_library
from gateway.lab.retraining.report import Retraining
from gateway.lab.retraining.study import (
    MIN_NEW_CYCLES,
    REPORTS,
    RetrainingRequest,
    cut_and_rate,
    due,
    make_source,
    new_cycles,
    retrain,
)
from gateway.lab.retraining.training_record import creation_time
from gateway.lab.traces.load import load
from gateway.store import machines, newest_scan, reading
from sim.artefacts import load as load_version
from sim.artefacts import version_directory
from sim.sha import display_unit

NICE = 19


def retrain_command(
    store: Path,
    historian: Path,
    machine: str | None,
    since: str | None,
    folder: Path | None,
    standard: Sequence[str],
    former: Sequence[str],
    map_name: str,
    method: str | None,
    rows: int,
    search: tuple[int, float | None] | None,
    no_diagnosis: bool,
    if_due: bool,
    after: int,
    every: float | None,
    yellow: float,
    red: float,
    full_speed: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Carry out `decanter model version retrain`; its options and its help are in retraining/commands.py."""
    if red < yellow:
        raise click.UsageError("--red is below --yellow; give the red class the larger error")
    if not full_speed:
        os.nice(NICE)
    trials, score_limit = search or (0, None)
    begin = time.process_time()
    with sentences(), progress("retraining") as bar, interruptible(bar) as report:
        model = load_version(store)
        temperature = model.temperature
        with reading(historian) as connection:
            known = dict(machines(connection))
            last = newest_scan(connection, machine=machine)
            if last is None:
                raise ValueError(f"{historian}: this historian has no scan yet; let the gateway run first")
            name = machine if machine is not None else next(iter(known))
            drift = RecordedDrift(0, 0, f"{historian} has no model of {temperature}")
            if if_due and temperature in known[name]:
                drift = recorded_drift(connection, historian, machine=name, model=model)
        request = RetrainingRequest(
            store=store,
            historian=historian,
            machine=name,
            since=since,
            standard=load(standard, map_name)[0] if standard else (),
            former=load(former, map_name)[0] if former else (),
            method=method,
            seed=seed,
            rows=rows,
            trials=trials,
            score_limit=score_limit,
            diagnosis=not no_diagnosis,
            yellow=yellow,
            red=red,
        )
        source = make_source(request, last)
        folder = folder or historian.parent / "cycles" / "-".join(filter(None, (name, temperature)))
        with open_library(folder, machine=name, temperature=temperature) as library:
            cut = cut_and_rate(request, library, source, report)
            reason = ""
            if if_due:
                # Before the first retraining the version that runs was the last thing learned.
                learned = creation_time(version_directory(store, source.version))
                age = time.time() - max(learned, (library.fact("finished") or {"at": learned})["at"])
                limit = float("inf") if every is None else every * 86_400.0
                ripe = due(request, library, source, after=after, drifting=drift.stands, age=age, every=limit)
                reason = ripe.reason
                fresh = len(new_cycles(library, source.model))
                said = f"not due: {cut} cycles came; {drift.why_not_due()}; fewer than {after} that are not ordinary"
                if ripe.score:
                    said += f"; {ripe.score}"
                if reason and fresh < MIN_NEW_CYCLES:
                    # For a timer that is no mistake: it comes again.
                    said = f"not yet: {reason}, but {fresh} new cycles are too few; it takes {MIN_NEW_CYCLES}"
                if not reason or fresh < MIN_NEW_CYCLES:
                    conclude(
                        CommandResult({"due": False, "cycles": cut} | drift.as_plain()),
                        lambda _: [said],
                        as_json=as_json,
                    )
                    return
            found = retrain(request, library, source, report=report, clock=time.time)
    place = folder / REPORTS / f"{found.study:04d}"
    cost = {"cpu_s": time.process_time() - begin, "peak_mb": peak_megabytes()}
    data: dict[str, Any] = {"due": reason or True, "cut": cut, "report": str(place), "cost": cost, **found.as_plain()}
    conclude(CommandResult(data), lambda _: show(found, store, place, cost), as_json=as_json)


def show(found: Retraining, store: Path, place: Path, cost: dict[str, float]) -> Iterator[Part]:
    """The verdict, the comparison and what to do next."""
    rows = [[each.subject, *each.cells()] for each in found.comparisons]
    if rows:
        columns = ("set", "horizon (s)", "cycles", "new", "present", "difference", "p", "told apart")
        yield Rows(f"CRPS ({display_unit(found.unit)}) of the new model and of version {found.present}", columns, rows)
    for line in found.lines():
        if not any(line.startswith(f"{each.subject}, ") for each in found.comparisons):
            yield line
    yield f"report: {place}"
    yield f"cost: {cost['cpu_s']:.0f} s of processor time, {cost['peak_mb']:.0f} MB at most"
    if found.version:
        yield f"to run it: decanter model version promote {store} {found.version}"
