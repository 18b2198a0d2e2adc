"""One self-contained HTML report a model, and the index of a campaign: text and figures in, HTML out."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, floor, isfinite, log10
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from sim.sha import Location
from sim.validation.metrics import QUANTILES
from sim.validation.results import Interval, TraceResult
from sim.validation.stages import Prepared, Stage, location_row
from sim.validation.verdicts import Gain, TraceVerdict, VerdictSummary, gain, summaries, verdict

EMBEDDED = 40
"""Pictures that stand in the report itself; of more traces the worst, and the others are in the folder."""
OPEN = 3
"""Pictures that are unfolded when the report opens, rounded up to whole traces."""
LONGEST_LABEL = 24
WIDTH, LEFT, RIGHT, ROW, TOP, BOTTOM = 860.0, 150.0, 20.0, 20.0, 8.0, 34.0


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
    """All that the report of one model tells."""

    campaign: CampaignSummary
    prepared: Prepared
    stages: Sequence[Stage]
    results: Sequence[TraceResult]
    pictures: Sequence[ReportFigure] = ()
    missing: Mapping[str, int] = field(default_factory=dict)

    @property
    def judged(self) -> list[tuple[TraceResult, TraceVerdict]]:
        """Each result with its verdict, trace by trace in the order of the numbers in their names (cd2 before cd10)."""
        places = list(dict.fromkeys(one.semantics for one in self.results))
        ordered = sorted(self.results, key=lambda one: (places.index(one.semantics), natural(one.trace)))
        return [(one, verdict(one)) for one in ordered]

    @property
    def summaries(self) -> list[VerdictSummary]:
        """One a semantics."""
        return summaries(self.results)

    @property
    def gain(self) -> Gain | None:
        """Thesis semantics against ours, where both ran."""
        return gain(self.results)

    @property
    def synthetic(self) -> str:
        """What of it no plant made; empty when nothing is known to be synthetic."""
        count = len({one.trace for one in self.results if one.synthetic})
        said = [f"{count} of {len({one.trace for one in self.results})} traces are SYNTHETIC"] if count else []
        if self.prepared.skeleton.provenance.synthetic:
            said.append("the model was learned from SYNTHETIC traces")
        return "; ".join(said)

    @property
    def in_sample(self) -> list[str]:
        """The traces that have the name of one that the model was learned from."""
        learned = set(self.prepared.skeleton.provenance.traces)
        return [name for name in dict.fromkeys(one.trace for one, _ in self.judged) if name in learned]

    @property
    def locations(self) -> list[tuple[str, list[dict[str, Any]]]]:
        """The rows of each variant's table of locations."""
        return [(name, [_row(one) for one in model.sha.locations]) for name, model in self.prepared.variants.items()]

    @property
    def boxes(self) -> Boxes | None:
        """The error distribution by trace, its semantics one below the other; None without figures."""
        there = [one for one in self.results if one.error_quantiles]
        return error_boxes(sorted(there, key=lambda one: natural(one.trace)))


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts digits as numbers."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def _row(location: Location) -> dict[str, Any]:
    row = location_row(location)
    constants = ", ".join(f"{name}={value:.4g}" for name, value in row["constants"].items())
    driven = ", ".join(f"{one.signal} ({one.gain:+.3g})" for one in location.flow.inputs)
    return row | {"constants": constants, "inputs": driven}


def error_boxes(results: Sequence[TraceResult]) -> Boxes | None:
    """Boxes (quartiles, median), whiskers (5 and 95 %) and ends (0 and 100 %) of predicted - measured, a row each."""
    if not results:
        return None
    low = min(0.0, *(one.error_quantiles[0] for one in results))
    high = max(0.0, *(one.error_quantiles[-1] for one in results))
    step = _tick(high - low)
    low, high = floor(low / step) * step, -floor(-high / step) * step or step

    def place(value: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (value - low) / (high - low)

    several = len({one.semantics for one in results}) > 1
    boxes = tuple(
        Box(
            _label(one.trace, f" ({one.semantics})" if several else ""),
            one.semantics,
            TOP + ROW * (row + 0.5),
            tuple(place(value) for value in one.error_quantiles),
            ", ".join(
                f"{level:.0%}: {value:+.2f} °C" for level, value in zip(QUANTILES, one.error_quantiles, strict=True)
            ),
        )
        for row, one in enumerate(results)
    )
    count = round((high - low) / step)
    first = round(low / step)
    ticks = tuple((place(low + step * index), _signed((first + index) * step)) for index in range(count + 1))
    return Boxes(WIDTH, TOP + ROW * len(results) + BOTTOM, boxes, ticks, place(0.0))


def _label(name: str, end: str) -> str:
    room = LONGEST_LABEL - len(end)
    return (name if len(name) <= room else f"{name[: room - 1]}…") + end


def _signed(value: float) -> str:
    return f"{value:+g}" if value else "0"


def _tick(span: float) -> float:
    """A round step that gives four to nine ticks."""
    if not span > 0:
        return 1.0
    raw = span / 8
    power = 10.0 ** floor(log10(raw))
    return next((factor * power for factor in (1.0, 2.0, 5.0) if factor * power >= raw), 10.0 * power)


def shown(results: Sequence[TraceResult], files: Mapping[tuple[str, str], Path], base: Path) -> list[ReportFigure]:
    """The pictures in `files` (by semantics and trace), the first EMBEDDED of them with their data.

    The trace with the largest error first; the semantics of one trace stand together. Raises OSError.
    """
    there = [one for one in results if (one.semantics, one.trace) in files]
    worst = {one.trace: max(other.mae.value for other in there if other.trace == one.trace) for one in there}
    there.sort(key=lambda one: (-worst[one.trace], one.trace))
    made = []
    for rank, one in enumerate(there):
        file = files[one.semantics, one.trace]
        content = base64.b64encode(file.read_bytes()).decode() if rank < EMBEDDED else ""
        data = f"data:image/png;base64,{content}" if content else ""
        made.append(ReportFigure(one, verdict(one), data, str(file.relative_to(base))))
    return made


def model_html(report: ModelReport) -> str:
    """The report of one model as one HTML file without any external resource."""
    each = max(1, len(report.summaries))
    opened = each * ceil(OPEN / each)
    return _environment().get_template("model.html").render(report=report, open=opened, embedded=EMBEDDED)


@dataclass(frozen=True, slots=True)
class ReportEntry:
    """A model in the index: where its folder is, relative to the index."""

    place: str
    report: ModelReport


def index_html(campaign: CampaignSummary, entries: Sequence[ReportEntry], log: Sequence[Stage]) -> str:
    """The page from which the reports of a campaign are reached."""
    return _environment().get_template("index.html").render(campaign=campaign, entries=entries, log=log)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("sim.validation"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": _number, "share": _share, "interval": _interval}
    return environment


def _number(value: float | None, digits: int = 2, sign: bool = False) -> str:
    if value is None or not isfinite(value):
        return "–"
    return f"{value:{'+' if sign else ''}.{digits}f}"


def _share(value: float, digits: int = 0) -> str:
    return f"{value:.{digits}%}" if isfinite(value) else "–"


def _interval(value: Interval, digits: int = 2) -> str:
    return f"{_number(value.low, digits)}–{_number(value.high, digits)}" if isfinite(value.low) else "–"
