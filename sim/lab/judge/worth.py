"""What forecasts are worth beside persistence and rivals: tables of figures, and plain sentences."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from math import floor
from typing import Any, Literal

import numpy as np

from sim.lab.judge.rows import (
    MIN_FORECASTS,
    TRACE_PARTS_S,
    SkillRow,
    difference,
    group_rows,
    independent,
    means,
    rows_at_common_moments,
    stretch,
)
from sim.sha import DEFAULT_UNIT, display_unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """A method of ours against the best other one at one `horizon` (s), on one machine or on all of them ("").

    `crps` and `best_crps` are the means of both in the temperature's unit; the best has the lowest at that place.
    Of the `due` forecasts, which came due within a trace at moments that all methods share, `scored` had an outcome;
    these overlap and are worth `independent` ones that do not.
    """

    method: str
    horizon: float
    machine: str
    crps: float
    best: str
    best_crps: float
    due: int
    scored: int
    independent: float

    @property
    def verdict(self) -> Literal["not known", "better", "as good", "worse"]:
        """What the model is: as good as the best other method while neither CRPS is MAX_CRPS_RATIO times the other's.

        Not known from fewer than MIN_FORECASTS independent forecasts, or where less than LEAST_READ of the moments
        have an outcome.
        """
        if self.independent < MIN_FORECASTS or self.scored < LEAST_READ * self.due:
            return "not known"
        if self.crps > MAX_CRPS_RATIO * self.best_crps:
            return "worse"
        return "better" if MAX_CRPS_RATIO * self.crps < self.best_crps else "as good"

    def sentence(self, unit: str) -> str:
        """The verdict with its figures, in `unit` as people read it."""
        where = f"on {self.machine} at {self.horizon:g} s" if self.machine else f"at {self.horizon:g} s"
        own, other = f"{self.crps:.3g}", f"{self.best_crps:.3g}"
        if self.verdict == "not known":
            had = "1 forecast" if self.scored == 1 else f"{self.scored} forecasts"
            why = (
                f"{had} had an outcome, worth {_floor_text(self.independent)} that do not overlap; "
                f"{MIN_FORECASTS:g} is the fewest that tell"
                if self.independent < MIN_FORECASTS
                else f"{self.scored} of {self.due} moments have an outcome, which may be the easier ones"
            )
            return (
                f"{where} it is not known whether the model is better than {self.best} (CRPS {own} against {other} "
                f"{unit}): {why}"
            )
        if self.verdict == "better":
            return f"{where} the model is better than {self.best} (CRPS {own} against {other} {unit})"
        if self.verdict == "worse":
            beaten = f"{where} {self.best} is better (CRPS {other} against {own} {unit})"
        else:
            beaten = f"{where} {self.best} is as good (CRPS {other} against {own} {unit})"
        return f"{beaten}: the model is not worth its trouble there"


@dataclass(frozen=True, slots=True, kw_only=True)
class ForecastSkill:
    """How good the forecasts of the methods `ours` are beside the others: `tables` of figures, and what they are worth.

    Figures are in `unit`; `notes` say what could not be scored.
    """

    ours: tuple[str, ...]
    tables: Mapping[str, Sequence[Mapping[str, Any]]]
    worth: tuple[Worth, ...]
    notes: tuple[str, ...] = ()
    unit: str = DEFAULT_UNIT

    @property
    def sentences(self) -> list[str]:
        """A sentence for each method and horizon, and for each machine on which that turns out otherwise."""
        whole = {(each.method, each.horizon): each for each in self.worth if not each.machine}
        told = []
        for each in self.worth:
            over_all = whole[each.method, each.horizon]
            otherwise = (each.verdict == "better") != (over_all.verdict == "better")
            if each.machine and (each.verdict == "not known" or not otherwise):
                continue
            name = f"{each.method}: " if len(self.ours) > 1 else ""
            told.append(name + each.sentence(display_unit(self.unit)))
        return told

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values for JSON."""
        worth = [{**asdict(each), "verdict": each.verdict} for each in self.worth]
        plain = {"worth": worth, "sentences": self.sentences, "notes": list(self.notes), "unit": self.unit}
        return {**{name: [dict(row) for row in rows] for name, rows in self.tables.items()}, **plain}


def forecast_skill(
    rows: Sequence[SkillRow], ours: Sequence[str], *, seed: int = 0, notes: Sequence[str] = (), unit: str = DEFAULT_UNIT
) -> ForecastSkill:
    """The skill of the methods `ours` among all that have rows, at the moments that all of them share."""
    due = rows_at_common_moments(rows)
    shared = [row for row in due if row.read]
    said = list(notes)
    if rows and not shared:
        said.append("the methods have no forecast for the same moment, so they cannot be compared")
    found = tables(shared, ours, seed)
    own = group_rows(shared, lambda row: (row.method, row.horizon))
    every = group_rows(due, lambda row: (row.method, row.horizon))
    said += _unread(group_rows(rows, lambda row: (row.method, row.horizon)).values(), ours)
    crps: dict[float, dict[str, dict[str, float]]] = {}
    for row in (*found["by horizon"], *found["by machine"]):
        places = crps.setdefault(row["horizon"], {})
        places.setdefault(row.get("machine", ""), {})[row["method"]] = row["crps"]
    worth = []
    for horizon, places in crps.items():
        # One machine alone is all of them: its verdict would say the same once more.
        for method, machine in product(ours, list(places)[: None if len(places) > 2 else 1]):
            here = places[machine]
            others = {name: value for name, value in here.items() if name not in ours}
            if method in here and others:
                best = min(others, key=lambda name: others[name])
                made = [row for row in own[method, horizon] if machine in ("", row.machine)]
                worth.append(
                    Worth(
                        method=method,
                        horizon=horizon,
                        machine=machine,
                        crps=here[method],
                        best=best,
                        best_crps=others[best],
                        due=sum(machine in ("", row.machine) for row in every[method, horizon]),
                        scored=len(made),
                        independent=independent(made),
                    )
                )
    return ForecastSkill(ours=tuple(ours), tables=found, worth=tuple(worth), notes=tuple(said), unit=unit)


NOTHING_READ = "nothing was read: the recording has gaps there, or is stored on change and its map does not say so"
"""Why a moment that came due has no outcome."""


def _unread(every: Iterable[Sequence[SkillRow]], ours: Sequence[str]) -> list[str]:
    """A sentence for each horizon of the first of our methods with moments at which nothing was read."""
    said = []
    for rows in every:
        read = sum(row.read for row in rows)
        if rows[0].method in ours[:1] and read < len(rows):
            said.append(
                f"at {rows[0].horizon:g} s {read} of {len(rows)} moments have an outcome; at the others {NOTHING_READ}"
            )
    return said


def _floor_text(count: float) -> str:
    # Rounded to the nearest, 7.97 would read as the fewest that tell.
    return f"{floor(10.0 * count) / 10.0:g}"


LEAST_READ = 0.5
"""Share of the moments that came due which must have an outcome: readings of few moments are no sample of all."""
MAX_CRPS_RATIO = 1.05
"""A method is as good as the best other one while its CRPS is at most so many times that one's."""


def tables(rows: Sequence[SkillRow], ours: Sequence[str], seed: int = 0) -> dict[str, list[dict[str, Any]]]:
    """`by horizon`, `by machine`, `by time` since the trace's start, and `differences` of ours to the best other.

    The best other method of a horizon is the one with the lowest CRPS there.
    """
    places = {name: place for place, name in enumerate(TRACE_PARTS_S)}
    keys: dict[str, Callable[[SkillRow], Any]] = {
        "horizon": lambda row: row.horizon,
        "machine": lambda row: row.machine,
        "since start": stretch,
        "method": lambda row: row.method,
    }
    found = {}
    for title, names in (("by horizon", ()), ("by machine", ("machine",)), ("by time", ("since start",))):
        own = means(rows, {name: keys[name] for name in ("horizon", *names, "method")})
        # Methods stand in the order in which they came, the parts of a trace in theirs.
        found[title] = sorted(own, key=lambda row: (row["horizon"], places.get(row.get("since start", ""), 0)))
    crps = {(row["horizon"], row["method"]): row["crps"] for row in found["by horizon"]}
    found["differences"] = []
    rng = np.random.default_rng(seed)
    for horizon, here in group_rows(rows, keys["horizon"]).items():
        by_method = group_rows(here, lambda row: row.method)
        others = {name: crps[horizon, name] for name in by_method if name not in ours}
        best = min(others, key=lambda name: others[name], default="")
        for name in ours:
            if name in by_method and best:
                apart = difference(by_method[name], by_method[best], rng)
                ratio = crps[horizon, name] / others[best] if others[best] > 0 else float("nan")
                row = {"horizon": horizon, "method": name, "best other": best, "ratio": ratio, "machines": apart.n}
                row |= {"difference": apart.mean, "low": apart.low, "high": apart.high, "p": apart.p}
                found["differences"].append(row)
    return found
