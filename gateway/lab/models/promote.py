"""`decanter model version promote`: makes a version of a store the one that runs, if its model verifies."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import click

from gateway.console import CommandResult, Part, conclude
from gateway.entry import sentences
from sim.artefacts import (
    FAMILIARITY_FILE,
    NO_VERDICT_TEXT,
    VERDICT_FILE,
    Force,
    JudgedCriterion,
    ModelVerdict,
    compare_verdicts,
    find_force,
    load,
    ran,
    read_familiarity,
    read_verdict,
    version_directory,
)
from sim.artefacts import promote as promote_version
from sim.files import ArtefactError
from sim.lab.formats import find_model, save


def promote(
    store: Path, version: str | None, model: str | None, reason: str | None, by: str | None, as_json: bool
) -> None:
    """The work of `model version promote`."""
    if (version is None) == (model is None):
        raise click.UsageError("name a VERSION of the store, or --add a model; one of the two")
    if (reason is None) != (by is None) or (reason is not None and not (reason.strip() and str(by).strip())):
        raise click.UsageError("--force REASON and --by NAME belong together, and neither is empty")
    with sentences():
        now = time.time()
        if model is not None:
            found = find_model(model)
            familiar = None if found.home is None else read_familiarity(found.home)
            more = {} if familiar is None else {FAMILIARITY_FILE: familiar.text()}
            more |= {} if found.verdict is None else {VERDICT_FILE: found.verdict.text()}
            version = save(store, found.runnable(), created=now, more=more)
        chosen = str(version)
        former = ran(store)
        judged = {name: _find_verdict(store, name) for name in (*former[-1:], chosen)}
        pair = None if chosen in former else _beside(store, chosen, former, judged)
        promote_version(
            store,
            chosen,
            Force(str(by), reason, now) if reason is not None else None,
            beside=f"it is {pair.sentence}" if pair is not None and pair.kept is False else "",
        )
        force = find_force(store)
    sentence = f"{store}: {chosen} is current" + (f", forced by {force.by}: {force.reason}" if force else "")
    verdicts = {name: own.as_command_json() if isinstance(own, ModelVerdict) else None for name, own in judged.items()}
    data = {
        "store": str(store),
        "current": chosen,
        "forced": force is not None,
        "verdicts": verdicts,
        "beside": None if pair is None else asdict(pair),
    }

    def show() -> Iterator[Part]:
        for name, own in judged.items():
            said = own.sentence if isinstance(own, ModelVerdict) else own
            yield f"{name}{'' if name == chosen else ' (ran before)'}: {said}"
        if pair is not None:
            yield f"{pair.sentence}{f'; next: {pair.next_step}' if pair.next_step else ''}"
        yield sentence

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def _beside(
    store: Path, chosen: str, former: Sequence[str], judged: Mapping[str, ModelVerdict | str]
) -> JudgedCriterion | None:
    """The version beside the one that ran last; None where there is none, or one of them has no verdict."""
    own, runs = judged[chosen], judged[former[-1]] if former else ""
    if not isinstance(own, ModelVerdict) or not isinstance(runs, ModelVerdict):
        return None
    both = f"{store}@{former[-1]} {store}@{chosen}"
    how = f"`decanter model judge rank {both} --traces NEW... --skill` compares them on recordings"
    return compare_verdicts(own, runs, load(store, chosen).unit, how)


def _find_verdict(store: Path, version: str) -> ModelVerdict | str:
    """A version's verdict, or why there is none: what has befallen the one that ran before is no obstacle."""
    try:
        return read_verdict(version_directory(store, version)) or NO_VERDICT_TEXT
    except ArtefactError as error:
        return f"its verdict cannot be read: {error}"
