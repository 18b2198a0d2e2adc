"""The report of a retraining, as text, page and JSON: what was learned from what, both models side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gateway.lab.options import RATINGS
from gateway.lab.retraining.cycle_library import CycleRow
from sim.familiarity import FEATURES, ClassFigures
from sim.lab.judge import NEW, PRESENT, HorizonComparison
from sim.lab.learning import PERSISTENCE
from sim.lab.pages import page_environment
from sim.lab.pictures import blank_figure, svg_text
from sim.sha import display_unit
from sim.strict_json import json_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT = "retraining_report"
COLOURS = {"badly predicted": "#b3261e", "rare": "#875509", "near a difficult one": "#7a4fa3", "ordinary": "#1f6fb4"}
ACROSS, UP = "load", "temperature"


@dataclass(frozen=True, slots=True, kw_only=True)
class Retraining:
    """What a retraining came to: the new model beside the `present` version, and whether it is `proposed` and why.

    `version` is what it was saved as ("": it was not). `refusals` say what speaks against it, `left` what a diagnosis
    of it says. `classes` are its errors by expected class, `regions` and `ratings` count cycles; `training` and
    `held_out` are how many of them it was learned from and judged by, `rows` the training's scans.
    """

    study: int
    machine: str
    temperature: str
    unit: str
    present: str
    new_hash: str
    version: str
    proposed: bool
    sentence: str
    comparisons: tuple[HorizonComparison, ...]
    scores: tuple[Mapping[str, Any], ...]
    refusals: tuple[str, ...]
    left: str
    classes: tuple[ClassFigures, ...]
    regions: tuple[Mapping[str, Any], ...]
    ratings: Mapping[str, int]
    training: int
    held_out: int
    rows: int
    tuned: str
    notes: tuple[str, ...]

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values for JSON."""
        return {**asdict(self), "comparisons": [each.as_plain() for each in self.comparisons]}

    def lines(self) -> list[str]:
        """The report as text."""
        unit = display_unit(self.unit)
        made = f"; saved as version {self.version}, promoted by nobody" if self.version else ""
        lines = [f"{self.sentence}{made}"]
        lines.append(
            f"new model {self.new_hash[:8]} of {self.temperature}, learned from {self.training} cycles "
            f"({self.rows} scans), judged by {self.held_out} new ones beside version {self.present}"
        )
        if self.tuned:
            lines.append(f"settings: {self.tuned}")
        lines += [each.sentence(self.unit) for each in self.comparisons]
        for each in self.comparisons:
            shares = ", ".join(f"{name} {each.coverage[name]:.0%}" for name in (NEW, PRESENT))
            lines.append(f"{each.subject}, {each.horizon:g} s: the 90 % band held {shares}")
        lines.append("verified" if not self.refusals else f"REFUSED: {'; and '.join(self.refusals)}")
        if self.left:
            lines.append(f"what is left, on the cycles held out: {self.left}")
        lines.append("cycles: " + ", ".join(f"{count} {rating}" for rating, count in self.ratings.items()))
        for figures in self.classes:
            if figures.error is not None:
                lines.append(
                    f"expected {figures.name}: {figures.cycles} cycles held out, relative error {figures.error:.0%}"
                )
        for region in self.regions:
            lines.append(
                f"region {region['region']} {unit}: {region['cycles']} cycles, {region['not ordinary']} not ordinary, "
                f"{region['in training']} in training"
            )
        return lines + [f"note: {note}" for note in self.notes]


def report_files(found: Retraining, cycles: Iterable[CycleRow], trained: frozenset[str]) -> dict[str, str]:
    """The report's files by name; `trained` names the cycles that the new model was learned from."""
    return {
        f"{REPORT}.txt": "\n".join(found.lines()) + "\n",
        f"{REPORT}.json": json_text(found.as_plain(), indent=1) + "\n",
        f"{REPORT}.html": _page(found, list(cycles), trained),
    }


def coverage_figure(cycles: Sequence[CycleRow], trained: frozenset[str]) -> Figure:
    """A map of what the plant does: cycles by mean load and highest temperature, those `trained` on ringed.

    What a person has excluded is left out.
    """
    canvas = blank_figure(9, 5)
    axes = canvas.subplots()
    names = list(FEATURES)
    across, up = names.index(ACROSS), names.index(UP)
    for rating in RATINGS:
        own = [row for row in cycles if row.rating == rating and not row.is_excluded and len(row.points)]
        if own:
            x = [float(np.nanmax(row.points[:, across])) for row in own]
            y = [float(np.nanmax(row.points[:, up])) for row in own]
            axes.scatter(x, y, s=28, c=COLOURS[rating], linewidths=0, alpha=0.75, label=rating)
            ringed = [place for place, row in enumerate(own) if row.name in trained]
            if ringed:
                around = ([x[place] for place in ringed], [y[place] for place in ringed])
                axes.scatter(*around, s=64, facecolors="none", edgecolors="#1d232b", linewidths=0.9)
    axes.set_xlabel("mean load over half an hour, the highest of the cycle (A)")
    axes.set_ylabel("temperature, the highest of the cycle (°C)")
    axes.grid(alpha=0.25)
    if axes.has_data():
        axes.legend(fontsize=8)
    ring = "; ringed: what the newest retraining learned from" if trained else ""
    axes.set_title(f"what the plant did{ring}", fontsize=10, loc="left")
    return canvas


def _page(found: Retraining, cycles: list[CycleRow], trained: frozenset[str]) -> str:
    """One HTML file that needs no other."""
    environment = page_environment("gateway.lab.retraining")
    shown = [row for row in cycles if row.rating != "ordinary" or row.is_excluded]
    return environment.get_template("retraining.html").render(
        found=found,
        unit=display_unit(found.unit),
        picture=svg_text(coverage_figure(cycles, trained)),
        cycles=shown,
        methods={"new": NEW, "present": PRESENT, "persistence": PERSISTENCE},
    )
