"""What of former runs is not there at the last one: models under the places that were asked, traces of the set."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gateway.lab.regression.history import RegressionHistory

Run = Mapping[str, Any]


def gone_models(history: RegressionHistory) -> list[str]:
    """A sentence for each model that the newest former run had under a place asked now, and the last run has not.

    Former runs are those that share a trace with the last one and were asked for all of that place.
    """
    run, former = _last_and_former(history)
    folder = history.path.parent.resolve()
    gone: dict[str, str] = {}
    for place in run["places"]:
        before = next((each for each in reversed(former) if _asked_for(each, place, folder)), None)
        if before is None:
            continue
        for subject in sorted(before["models"].keys() - run["models"].keys()):
            if _under(subject, place, folder):
                gone[subject] = f"{subject} was in the run of {before['when']} and is not there any more"
    return list(gone.values())


def trace_notes(history: RegressionHistory) -> list[str]:
    """What the last run's set lacks of the newest former one that shares a trace; that none does, where there are some.

    Of the very first run there is nothing to say.
    """
    run, former = _last_and_former(history)
    if not former:
        any_run = any(row["kind"] == "run" for row in history.rows[:-1])
        return ["compared with no former run: none has these traces"] if any_run else []
    names = {row["trace"]: row["trace_name"] for row in history.rows if row["kind"] == "result"}
    here = {names[content] for content in run["traces"] if content in names}
    gone = sorted(names.get(content, content[:8]) for content in set(former[-1]["traces"]) - set(run["traces"]))
    shown = [f"{name} (it has other readings now)" if name in here else name for name in gone]
    return [f"not in the set any more since the run of {former[-1]['when']}: {', '.join(shown)}"] if gone else []


def _last_and_former(history: RegressionHistory) -> tuple[Run, list[Run]]:
    """The last run, and the runs before it that share a trace with it: those of the same standard set."""
    *former, last = (row for row in history.rows if row["kind"] == "run")
    return last, [run for run in former if set(run["traces"]) & set(last["traces"])]


def _asked_for(run: Run, place: str, folder: Path) -> bool:
    # Rows of former versions do not say what was asked: a model that they have there shows it.
    asked = run.get("places")
    if asked is None:
        return any(_under(subject, place, folder) for subject in run["models"])
    return any(_under(place, each, folder) for each in asked)


def _under(name: str, place: str, folder: Path) -> bool:
    """Whether a subject or a place lies at or below another place; both are as seen from `folder`."""
    path, above = (os.path.normpath(folder / each) for each in (name, place))
    return Path(path).is_relative_to(above) or path.startswith(f"{above}@")
