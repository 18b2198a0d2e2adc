"""`decanter model shadow`: two versions side by side on live cycles, from the records; back to the better one.

The historian has everything that either version would have read, so that the one that does not run is forecast with
afterwards, exactly as the gateway would have: it costs the running gateway nothing, and cannot disturb it.
"""

from pathlib import Path
from typing import Any

import click

from gateway.console import emit, historian_machine_option, json_option, progress, seed_option, table
from gateway.entry import interruptible, sentences
from gateway.lab.retraining.cutting import CycleSource, cut_new, cycle_of
from gateway.lab.retraining.judging import compared, scores_along
from gateway.lab.retraining.library import opened_library
from gateway.lab.retraining.study import encoded
from gateway.lab.retraining.training_record import created_of, read_record
from gateway.store import machines, reading
from sim.artefacts import current, load, promote, read_familiarity, version_directory, versions
from sim.sha import shown_unit

LIVE = "live cycles"
LEAST, MOST = 8, 24
"""Live cycles that a paired test needs, and how many of the newest it takes."""


@click.command("shadow", short_help="Compare two versions on live cycles; roll back where the promoted one is worse.")
@click.argument("store", type=click.Path(path_type=Path, file_okay=False))
@click.argument("version", required=False)
@click.option("--historian", type=click.Path(path_type=Path), required=True, help="The gateway's historian.")
@historian_machine_option
@click.option("--library", "folder", type=click.Path(path_type=Path), help="Its cycles  [cycles beside the historian].")
@click.option("--roll-back", is_flag=True, help="Promote VERSION again where the current one is worse than it.")
@seed_option
@json_option
def shadow_command(
    store: Path,
    version: str | None,
    historian: Path,
    machine: str | None,
    folder: Path | None,
    roll_back: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Hold the current version of STORE against VERSION on the cycles since the younger of them was made.

    VERSION is a candidate that waits for its promotion, or the one that ran before, which is the default: then
    --roll-back promotes it again if the current one is worse on live cycles by the paired test. Neither version has
    been learned from these cycles.
    """
    with sentences(), progress("comparing") as bar, interruptible(bar) as report:
        running = current(store)
        record = read_record(version_directory(store, running))
        other = version or ("" if record is None else record.parent)
        if other == running or other not in versions(store):
            raise ValueError(
                f"{store}: {other or 'the version before the current one'!r} is no other version of this store; name "
                f"one of: {', '.join(name for name in versions(store) if name != running) or 'none yet'}"
            )
        present, rival = load(store, running), load(store, other)
        since = max(created_of(version_directory(store, name)) for name in (running, other))
        with reading(historian) as connection:
            name = machine if machine is not None else next(iter(dict(machines(connection))))
        source = CycleSource(historian=historian, machine=name, model=present, version=running, since=-float("inf"))
        place = folder or historian.parent / "cycles" / "-".join(filter(None, (name, present.temperature)))
        scores: list[dict[str, Any]] = []
        with opened_library(place, machine=name, temperature=present.temperature) as library:
            known = read_familiarity(version_directory(store, running))
            cut_new(library, source, None if known is None else known.reference, report)
            seen = {*present.provenance.contents, *rival.provenance.contents}
            live = [
                row
                for row in library.cycles()
                if row.begin >= since and not row.excluded and row.error is not None and row.content not in seen
            ][-MOST:]
            for row in live:
                trace = cycle_of(source, row, library)
                if trace is not None:
                    # The current version is the one that is judged: the other stands as what ran before.
                    scores += scores_along(encoded(trace, present), rival, present, seed=seed, report=report)
        comparisons = compared(LIVE, scores, seed=seed)
        worse = [each for each in comparisons if each.told_apart == "worse"]
        better = [each for each in comparisons if each.told_apart == "better"]
        if len(live) < LEAST:
            sentence = f"{len(live)} cycles since both were made are too few to tell; it takes {LEAST}"
        elif worse:
            sentence = f"{running} is worse than {other} at {', '.join(f'{each.horizon:g} s' for each in worse)}"
        elif better:
            sentence = f"{running} is better than {other} at {', '.join(f'{each.horizon:g} s' for each in better)}"
        else:
            sentence = f"{running} and {other} are not told apart"
        back = roll_back and bool(worse) and len(live) >= LEAST
        if back:
            promote(store, other)
            sentence += f"; {other} is promoted again"
    data = {"current": other if back else running, "compared": [running, other], "cycles": len(live)}
    data |= {"rolled_back": back, "sentence": sentence, "comparisons": [each.as_plain() for each in comparisons]}

    def show() -> None:
        columns = ("horizon (s)", "cycles", running, other, "difference", "p", "told apart")
        rows = [
            [c.horizon, c.difference.n, c.crps["new"], c.crps["present"], c.difference.mean, c.p, c.told_apart or "no"]
            for c in comparisons
        ]
        if rows:
            table(f"CRPS on live cycles ({shown_unit(present.unit)})", columns, rows)
        click.echo(sentence)

    emit(data, show, as_json_line=as_json)
