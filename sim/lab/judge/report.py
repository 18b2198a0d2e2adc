"""One self-contained HTML report a model, and the index of a campaign: text and figures in, HTML out."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, floor, inf, isfinite, log10, nan
from pathlib import Path
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.artefacts import JudgedCriterion, Word
from sim.lab.judge.fitness import fitness_verdict
from sim.lab.judge.metrics import QUANTILES
from sim.lab.judge.results import Interval, Seen, TraceResult
from sim.lab.judge.stages import Prepared, Stage, location_row
from sim.lab.judge.verdicts import SAMPLE_WORDS, Gain, TraceVerdict, VerdictSummary, gain, summaries, verdict
from sim.lab.judge.worth import ForecastSkill
from sim.lab.pages import number, page_environment
from sim.sha import display_unit

if TYPE_CHECKING:
    from jinja2 import Environment


MAX_EMBEDDED = 40
"""Pictures that stand in the report itself; of more traces the worst, and the others are in the folder."""
OPEN_PICTURES = 3
"""Pictures that are unfolded when the report opens, rounded up to whole traces."""
MAX_LABEL_CHARS = 24
TRAINING_WORDS: Mapping[Seen, str] = {"no": "no", "content": "yes", "name": "yes, by name", "unknown": "not known"}
"""What the column `in training` says."""
WIDTH, LEFT, RIGHT, ROW, TOP, BOTTOM = 860.0, 150.0, 20.0, 20.0, 8.0, 34.0
HISTOGRAM_HEIGHT = 200.0
MIN_HISTOGRAM_TRACES = 5
"""Traces below which a histogram of one error each says no more than the table."""


@dataclass(frozen=True, slots=True)
class Box:
    """One trace in the error distribution: its row's `y`, and the x of each of QUANTILES, in the drawing's units."""

    label: str
    semantics: str
    y: float
    x: tuple[float, ...]
    text: str


@dataclass(frozen=True, slots=True)
class Boxes:
    """The error distribution as a drawing: size, the ticks of its axis (x, text), and where 0 is."""

    width: float
    height: float
    boxes: tuple[Box, ...]
    ticks: tuple[tuple[float, str], ...]
    zero: float


@dataclass(frozen=True, slots=True)
class Bar:
    """One bar of a histogram in the drawing's units: its left edge, width and top, and how many it counts."""

    x: float
    width: float
    y: float
    count: int
    text: str


@dataclass(frozen=True, slots=True)
class Histogram:
    """Errors as a drawing, bars standing on `floor`, with the ticks of its axis (x, text) and where 0 is.

    `mean` and `sigma` of the `count` errors are in their unit.
    """

    width: float
    height: float
    floor: float
    bars: tuple[Bar, ...]
    ticks: tuple[tuple[float, str], ...]
    zero: float
    mean: float
    sigma: float
    count: int


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """A picture in the report: `data` is its PNG as a data URI, empty where only the `file` is named."""

    result: TraceResult
    verdict: TraceVerdict
    data: str
    file: str


@dataclass(frozen=True, slots=True)
class CampaignSummary:
    """What is the same for all reports of a campaign: `facts` by name, as they stand in the header."""

    created: str
    facts: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelReport:
    """All that the report of one model tells; `skill` is that of its forecasts, where these were made.

    `findings` of its fitness by semantics.
    """

    campaign: CampaignSummary
    prepared: Prepared
    stages: Sequence[Stage]
    results: Sequence[TraceResult]
    pictures: Sequence[ReportFigure] = ()
    missing: Mapping[str, int] = field(default_factory=dict)
    skill: ForecastSkill | None = None
    findings: Mapping[str, Sequence[JudgedCriterion]] = field(default_factory=dict)

    @property
    def fitness(self) -> list[tuple[str, Word, str]]:
        """(semantics, word, why and what to do next) of each."""
        verdicts = {name: fitness_verdict(found) for name, found in self.findings.items()}
        return [(name, verdict.word, verdict.why) for name, verdict in verdicts.items()]

    @property
    def unit(self) -> str:
        """The unit of the errors, as people read it."""
        return display_unit(self.results[0].unit if self.results else self.prepared.structure.unit)

    @property
    def judged_results(self) -> list[tuple[TraceResult, TraceVerdict]]:
        """Each result with its verdict: unseen traces first, then by the numbers in their names (cd2 before cd10)."""
        semantics = list(dict.fromkeys(result.semantics for result in self.results))
        samples = list(dict.fromkeys(SAMPLE_WORDS.values()))
        ordered = sorted(
            self.results,
            key=lambda result: (
                samples.index(SAMPLE_WORDS[result.seen]),
                semantics.index(result.semantics),
                natural(result.trace),
            ),
        )
        return [(result, verdict(result)) for result in ordered]

    @property
    def summaries(self) -> list[VerdictSummary]:
        """One a semantics and sample, of unseen traces first."""
        return summaries(self.results)

    @property
    def gain(self) -> Gain | None:
        """Carried against resampled temperature, where both ran."""
        return gain(self.results)

    @property
    def synthetic(self) -> str:
        """What of it no plant made; empty when nothing is known to be synthetic."""
        count = len({result.trace for result in self.results if result.synthetic})
        parts = [f"{count} of {len({result.trace for result in self.results})} traces are SYNTHETIC"] if count else []
        if self.prepared.structure.provenance.synthetic:
            parts.append("the model was learned from SYNTHETIC traces")
        return "; ".join(parts)

    @property
    def several_semantics(self) -> bool:
        """Whether the rows have to say under which semantics they are."""
        return len({result.semantics for result in self.results}) > 1

    @property
    def locations(self) -> list[tuple[str, list[dict[str, Any]]]]:
        """The rows of each variant's table of locations."""
        tables = []
        for name, model in self.prepared.variants.items():
            rows = []
            for location in model.sha.locations:
                row = location_row(location)
                constants = ", ".join(f"{constant}={value:.4g}" for constant, value in row["constants"].items())
                inputs = ", ".join(f"{driving.signal} ({driving.gain:+.3g})" for driving in location.flow.inputs)
                rows.append(row | {"constants": constants, "inputs": inputs})
            tables.append((name, rows))
        return tables

    @property
    def boxes(self) -> Boxes | None:
        """The error distribution by trace, its semantics one below the other; None without figures."""
        known = [result for result in self.results if result.error_quantiles]
        return error_boxes(sorted(known, key=lambda result: natural(result.trace)))

    @property
    def histograms(self) -> list[tuple[str, Histogram]]:
        """The final errors of each semantics and sample with at least MIN_HISTOGRAM_TRACES of them, with its title."""
        groups: dict[str, list[float]] = {}
        for result, _ in self.judged_results:
            if isfinite(result.final_error):
                semantics = f", temperature {result.semantics}" if self.several_semantics else ""
                groups.setdefault(f"{SAMPLE_WORDS[result.seen]} traces{semantics}", []).append(result.final_error)
        return [
            (title, error_histogram(errors, self.unit))
            for title, errors in groups.items()
            if len(errors) >= MIN_HISTOGRAM_TRACES
        ]


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts digits as numbers."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def error_boxes(results: Sequence[TraceResult]) -> Boxes | None:
    """Boxes (quartiles, median), whiskers (5 and 95 %) and ends (0 and 100 %) of predicted - measured, a row each."""
    if not results:
        return None
    # The axis holds 0, at which a prediction is right, and ends at whole steps.
    low = min(0.0, *(result.error_quantiles[0] for result in results))
    high = max(0.0, *(result.error_quantiles[-1] for result in results))
    step = _tick(high - low)
    low, high = floor(low / step) * step, -floor(-high / step) * step or step

    def place(value: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (value - low) / (high - low)

    several = len({result.semantics for result in results}) > 1
    boxes = []
    for row, result in enumerate(results):
        # A long name is cut before the semantics, which tells two rows of one trace apart.
        end = f" ({result.semantics})" if several else ""
        room = MAX_LABEL_CHARS - len(end)
        name = result.trace if len(result.trace) <= room else f"{result.trace[: room - 1]}…"
        quantiles = zip(QUANTILES, result.error_quantiles, strict=True)
        boxes.append(
            Box(
                label=name + end,
                semantics=result.semantics,
                y=TOP + ROW * (row + 0.5),
                x=tuple(place(value) for value in result.error_quantiles),
                text=", ".join(f"{level:.0%}: {value:+.2f} {display_unit(result.unit)}" for level, value in quantiles),
            )
        )
    count, first = round((high - low) / step), round(low / step)
    ticks = []
    for index in range(count + 1):
        # A multiple of the step, not the last tick plus a step: sums of 0.1 would be written with their last digits.
        value = (first + index) * step
        ticks.append((place(low + step * index), f"{value:+g}" if value else "0"))
    height = TOP + ROW * len(results) + BOTTOM
    return Boxes(WIDTH, height, tuple(boxes), tuple(ticks), place(0.0))


def error_histogram(errors: Sequence[float], unit: str) -> Histogram:
    """How often which error: bars of a round width (four to nine of them and 0 on an edge), over at least one error."""
    # The axis holds 0, so that an offset shows as one.
    step = _tick(max(0.0, *errors) - min(0.0, *errors))
    first, last = floor(min(0.0, *errors) / step), floor(max(0.0, *errors) / step) + 1
    counts = np.histogram(errors, np.arange(first, last + 1) * step)[0].tolist()
    width, ground = (WIDTH - LEFT - RIGHT) / len(counts), HISTOGRAM_HEIGHT - BOTTOM
    bars = tuple(
        Bar(
            x=LEFT + width * place,
            width=width,
            y=ground - (ground - ROW) * count / max(counts),
            count=count,
            text=f"{(first + place) * step:+.4g} to {(first + place + 1) * step:+.4g} {unit}: {count}",
        )
        for place, count in enumerate(counts)
    )
    ticks = tuple((LEFT + width * place, f"{(first + place) * step:+g}") for place in range(len(counts) + 1))
    return Histogram(
        width=WIDTH,
        height=HISTOGRAM_HEIGHT,
        floor=ground,
        bars=bars,
        ticks=ticks,
        zero=LEFT - width * first,
        mean=fmean(errors),
        sigma=stdev(errors) if len(errors) > 1 else nan,
        count=len(errors),
    )


def _tick(span: float) -> float:
    """A round step that gives four to nine ticks."""
    if not span > 0:
        return 1.0
    raw = span / 8
    power = 10.0 ** floor(log10(raw))
    return next((factor * power for factor in (1.0, 2.0, 5.0) if factor * power >= raw), 10.0 * power)


def choose_figures(
    results: Sequence[TraceResult], files: Mapping[tuple[str, str], Path], base: Path
) -> list[ReportFigure]:
    """The pictures in `files` (by semantics and trace), the first MAX_EMBEDDED of them with their data.

    The trace with the largest error first; the semantics of one trace stand together. Raises OSError.
    """
    drawn = [result for result in results if (result.semantics, result.trace) in files]
    worst: dict[str, float] = {}
    for result in drawn:
        worst[result.trace] = max(result.mae.value, worst.get(result.trace, -inf))
    drawn.sort(key=lambda result: (-worst[result.trace], result.trace))
    figures = []
    for rank, result in enumerate(drawn):
        file = files[result.semantics, result.trace]
        content = base64.b64encode(file.read_bytes()).decode() if rank < MAX_EMBEDDED else ""
        data = f"data:image/png;base64,{content}" if content else ""
        figures.append(ReportFigure(result, verdict(result), data, str(file.relative_to(base))))
    return figures


def model_html(report: ModelReport) -> str:
    """The report of one model as one HTML file without any external resource."""
    each = max(
        1, len({result.semantics for result in report.results})
    )  # pictures that one trace has: whole traces are unfolded
    opened = each * ceil(OPEN_PICTURES / each)
    return (
        _environment()
        .get_template("model.html")
        .render(report=report, unit=report.unit, open=opened, embedded=MAX_EMBEDDED, training=TRAINING_WORDS)
    )


@dataclass(frozen=True, slots=True)
class ReportEntry:
    """A model in the index: where its folder is, relative to the index."""

    place: str
    report: ModelReport


def index_html(campaign: CampaignSummary, entries: Sequence[ReportEntry], log: Sequence[Stage]) -> str:
    """The page from which the reports of a campaign are reached."""
    unit = " or ".join(dict.fromkeys(entry.report.unit for entry in entries))
    return _environment().get_template("index.html").render(campaign=campaign, entries=entries, log=log, unit=unit)


def _environment() -> Environment:
    return page_environment("sim.lab.judge", share=_share, interval=_interval, spread=_spread)


def _share(value: float, digits: int = 0) -> str:
    return f"{value:.{digits}%}" if isfinite(value) else "–"


def _spread(sigma: float, digits: int = 2) -> str:
    return f" ± {number(sigma, digits)}" if isfinite(sigma) else ""


def _interval(value: Interval, digits: int = 2) -> str:
    return f"{number(value.low, digits)}–{number(value.high, digits)}" if isfinite(value.low) else "–"
