"""What forecasts are worth beside persistence and rivals: tables of figures, and plain sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from sim.lab.judge.rows import STRETCHES, SkillRow, common, difference, grouped, skill, stretch
from sim.sha import DEGREES, shown_unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """A method of ours against the best other one at one `horizon` (s), on one machine or on all of them ("").

    `crps` and `best_crps` are the means of both in the temperature's unit; the best has the lowest at that place.
    """

    method: str
    horizon: float
    machine: str
    crps: float
    best: str
    best_crps: float

    @property
    def verdict(self) -> Literal["better", "as good", "worse"]:
        """What the model is: as good as the best other method while neither CRPS is AHEAD times the other's."""
        if self.crps > AHEAD * self.best_crps:
            return "worse"
        return "better" if AHEAD * self.crps < self.best_crps else "as good"

    def sentence(self, unit: str) -> str:
        """The verdict with its figures, in `unit` as people read it."""
        where = f"on {self.machine} at {self.horizon:g} s" if self.machine else f"at {self.horizon:g} s"
        own, other = f"{self.crps:.3g}", f"{self.best_crps:.3g}"
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
    unit: str = DEGREES

    @property
    def sentences(self) -> list[str]:
        """A sentence for each method and horizon, and for each machine on which that turns out otherwise."""
        whole = {(each.method, each.horizon): each for each in self.worth if not each.machine}
        told = []
        for each in self.worth:
            over_all = whole[each.method, each.horizon]
            if each.machine and (each.verdict == "better") == (over_all.verdict == "better"):
                continue
            name = f"{each.method}: " if len(self.ours) > 1 else ""
            told.append(name + each.sentence(shown_unit(self.unit)))
        return told

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values for JSON."""
        worth = [{**asdict(each), "verdict": each.verdict} for each in self.worth]
        plain = {"worth": worth, "sentences": self.sentences, "notes": list(self.notes), "unit": self.unit}
        return {**{name: [dict(row) for row in rows] for name, rows in self.tables.items()}, **plain}


def forecast_skill(
    rows: Sequence[SkillRow], ours: Sequence[str], *, seed: int = 0, notes: Sequence[str] = (), unit: str = DEGREES
) -> ForecastSkill:
    """The skill of the methods `ours` among all that have rows, at the moments that all of them share."""
    shared = common(rows)
    said = list(notes)
    if rows and not shared:
        said.append("the methods have no forecast for the same moment, so they cannot be compared")
    worth = []
    for horizon, here in sorted(grouped(shared, lambda row: row.horizon).items()):
        machines = grouped(here, lambda row: row.machine)
        # One machine alone is all of them: its verdict would say the same once more.
        places = {"": here, **(machines if len(machines) > 1 else {})}
        for method in ours:
            for machine, part in places.items():
                crps = {name: skill(own).crps for name, own in grouped(part, lambda row: row.method).items()}
                others = {name: value for name, value in crps.items() if name not in ours}
                if method not in crps or not others:
                    continue
                best = min(others, key=lambda name: others[name])
                worth.append(
                    Worth(
                        method=method,
                        horizon=horizon,
                        machine=machine,
                        crps=crps[method],
                        best=best,
                        best_crps=others[best],
                    )
                )
    return ForecastSkill(
        ours=tuple(ours), tables=tables(shared, ours, seed), worth=tuple(worth), notes=tuple(said), unit=unit
    )


AHEAD = 1.05
"""A method is as good as the best other one while its CRPS is at most so many times that one's."""


def tables(rows: Sequence[SkillRow], ours: Sequence[str], seed: int = 0) -> dict[str, list[dict[str, Any]]]:
    """`by horizon`, `by machine`, `by time` since the trace's start, and `differences` of ours to the best other.

    The best other method of a horizon is the one with the lowest CRPS there.
    """
    parts: Mapping[str, Any] = {
        "by horizon": lambda row: (row.horizon, row.method),
        "by machine": lambda row: (row.horizon, row.machine, row.method),
        "by time": lambda row: (row.horizon, stretch(row), row.method),
    }
    names = {"by horizon": (), "by machine": ("machine",), "by time": ("since start",)}
    places = {name: place for place, name in enumerate(STRETCHES)}
    found: dict[str, list[dict[str, Any]]] = {}
    for title, key in parts.items():
        groups = grouped(rows, key)
        # Methods stand in the order in which they came, the parts of a trace in theirs.
        order = {group: (group[0], places.get(group[1], 0)) for group in groups}
        found[title] = [
            {
                "horizon": group[0],
                **dict(zip(names[title], group[1:-1], strict=True)),
                "method": group[-1],
                **asdict(skill(own)),
            }
            for group, own in sorted(groups.items(), key=lambda item: order[item[0]])
        ]
    found["differences"] = []
    rng = np.random.default_rng(seed)
    for horizon, here in grouped(rows, lambda row: row.horizon).items():
        by_method = grouped(here, lambda row: row.method)
        others = {name: skill(own).crps for name, own in by_method.items() if name not in ours}
        if not others:
            continue
        best = min(others, key=lambda name: others[name])
        for name in ours:
            if name in by_method:
                apart = difference(by_method[name], by_method[best], rng)
                ratio = skill(by_method[name]).crps / others[best] if others[best] > 0 else float("nan")
                row = {"horizon": horizon, "method": name, "best other": best, "ratio": ratio, "machines": apart.n}
                found["differences"].append(
                    {**row, "difference": apart.mean, "low": apart.low, "high": apart.high, "p": apart.p}
                )
    return found
