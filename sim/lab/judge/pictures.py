"""The pictures of a campaign: one PNG and one PDF a trace, measured, predicted, band, events and inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.lab.judge.free_run import TraceOutcome
from sim.lab.judge.output_folder import places, write_error
from sim.lab.pictures import Curve, Picture, draw
from sim.sha import display_unit


@dataclass(frozen=True, slots=True)
class Drawing:
    """A picture that is to be drawn to a PNG and a PDF of the same name."""

    picture: Picture
    png: Path


def drawings(
    folder: Path, outcomes: Sequence[TraceOutcome], temperature: str, units: Mapping[str, str]
) -> dict[tuple[str, str], Drawing]:
    """By semantics and trace, what is to be drawn into `folder` for the outcomes of one model that have a course."""
    courses = {
        (outcome.result.semantics, outcome.result.trace): (outcome.result, outcome.course)
        for outcome in outcomes
        if outcome.course is not None
    }
    several = len({semantics for semantics, _ in courses}) > 1
    names = places(list(dict.fromkeys(trace for _, trace in courses)))
    pictures = {}
    for (semantics, trace), (result, course) in courses.items():
        notes = ["SYNTHETIC: not measured on a plant"] if result.synthetic else []
        unit = display_unit(result.unit)
        notes += [
            f"MAE {result.mae.value:.2f} {unit}",
            f"final error {result.final_error:+.2f} {unit}",
            f"band covers {result.coverage:.0%}",
        ]
        if course.seen > len(course.events):
            notes.append(f"{len(course.events)} of {course.seen} events shown")
        # Mean and band were thinned by themselves, so the band is read off where the mean stands.
        times, mean = course.mean
        low, high = (np.interp(times, course.band[0], edge) for edge in course.band[1:])
        picture = Picture(
            f"{result.model} along {trace}, open loop, semantics {semantics}",
            Curve(f"measured {temperature}", *course.measured),
            predicted=Curve("predicted mean, 90 % band", times, mean, low, high),
            inputs=[Curve(name, *columns) for name, columns in course.inputs.items()],
            events=course.events,
            note="; ".join(notes),
            units=units,
            unit=result.unit,
        )
        file = f"{names[trace]}.{semantics}.png" if several else f"{names[trace]}.png"
        pictures[semantics, trace] = Drawing(picture, folder / file)
    return pictures


def draw_one(drawing: Drawing) -> Path:
    """Draw it. Raises ValueError where it cannot be written."""
    try:
        return draw(drawing.picture, drawing.png, drawing.png.with_suffix(".pdf"))
    except OSError as error:
        raise write_error(drawing.png, error) from None
