"""What has come of an arm's days so far, in a folder that is whole at any moment: a year that was ended goes on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from benchmarks.year.arms import Happening
from benchmarks.year.judge import DayScore

DAYS, WORK = "days.json", "work"


class KeptDays:
    """An arm's `days` so far in a `folder`, by the `settings` of the year; `work` is what the arm itself writes.

    After each day all of it is copied to a folder `kept`, put in its place by renaming: a kill at any moment leaves the
    evening of the last whole day. Raises click.ClickException for a folder of a year with other settings.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self._folder, self._settings = folder, dict(settings)
        self.work = folder / WORK
        self.scores, self.happenings = list[DayScore](), list[Happening]()
        self.state: dict[str, Any] = {}
        self.days, self.seconds = 0, 0.0
        kept, before = folder / "kept", folder / "before"
        if not kept.is_dir() and before.is_dir():
            before.rename(kept)
        shutil.rmtree(self.work, ignore_errors=True)
        if not kept.is_dir():
            self.work.mkdir(parents=True)
            return
        plain = json.loads((kept / DAYS).read_text(encoding="utf-8"))
        if plain["settings"] != self._settings:
            raise click.ClickException(
                f"{folder}: is of a year with {plain['settings']}, not {self._settings}; give another --keep"
            )
        shutil.copytree(kept / WORK, self.work)
        self.scores = [DayScore(**_tuples(each)) for each in plain["scores"]]
        self.happenings = [Happening(**each) for each in plain["happenings"]]
        self.state, self.days, self.seconds = plain["state"], plain["days"], plain["seconds"]

    def keep(self) -> None:
        """Put on disk what stands after a day."""
        new, kept, before = self._folder / "new", self._folder / "kept", self._folder / "before"
        for left in (new, before):
            shutil.rmtree(left, ignore_errors=True)
        shutil.copytree(self.work, new / WORK)
        plain = {
            "settings": self._settings,
            "scores": [asdict(each) for each in self.scores],
            "happenings": [asdict(each) for each in self.happenings],
            "state": self.state,
            "days": self.days,
            "seconds": self.seconds,
        }
        (new / DAYS).write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
        if kept.is_dir():
            kept.rename(before)
        new.rename(kept)


def _tuples(plain: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in plain.items()}
