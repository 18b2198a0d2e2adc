"""The figures of methods as tables of plain values: by horizon, by machine, over the time since a trace's start."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from sim.lab.skill.rows import STRETCHES, SkillRow, difference, grouped, skill, stretch

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
