"""The report of a diagnosis: one HTML file without any external resource, its pictures inside it."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from shlex import quote

from sim.effects import parameter_words
from sim.lab.discrepancy import (
    MIN_LISTED_SHARE,
    Diagnosis,
    HeatPlace,
    NamedEffect,
    TriedEffect,
    advice_lines,
    beginning_sentence,
    floor_sentence,
    held_out_count,
    law_sentence,
    overlap_sentence,
    span,
    told_places,
)
from sim.lab.discrepancy.output.pictures import CYCLES, ERRORS, MISSING, SHEET, WHERE
from sim.lab.pages import page_environment
from sim.sha import display_unit

MEANINGS: Mapping[str, str] = {
    "agree": "On these cycles the model, with its parameters fitted anew, is as right as its own noise allows. "
    "That no effect was found does not prove that there is none: see what these data could not show.",
    "named": "One cause was found that the likelihood, the single cycles, the held-out cycles and the check on what is "
    "left all agree on. It has been added to the model.",
    "class": "The gap is real and its kind is known, but these data cannot tell the members of the class apart. The "
    "model was given the first of them; the experiment named below would decide.",
    "unexplained": "The gap is real, and nothing that is known here explains it well enough to be named. Where "
    "it lies is described; no cause is claimed and nothing was added to the model.",
    "too-little-data": "There are too few cycles to fit the model on some and judge it on others, or noise alone "
    "errs by so much on these that to agree with them would say nothing, or what was read never changes: neither "
    "agreement nor a gap is claimed.",
}
"""What each verdict says and does not say."""
COLOURS: Mapping[str, str] = {
    "agree": "good",
    "named": "found",
    "class": "found",
    "unexplained": "failed",
    "too-little-data": "review",
}
MAX_LISTED = 3
"""Places that are told as sentences; the table has all."""


@dataclass(frozen=True, slots=True)
class Occasion:
    """What is said of a diagnosis beside its findings.

    `name` is the model's, `temperature` the signal that it follows, `created` the time of the report, `facts` stand in
    the header, `roles` (role -> signal) say what the effects' words mean in these data. `synthetic` says what of the
    data no plant made, "" for nothing. `folder` is where the diagnosis is written. `verification` are the reasons why
    the new model is not deployable: none for a deployable one, None where there is no new model.
    """

    name: str
    temperature: str
    created: str
    facts: Mapping[str, str]
    roles: Mapping[str, str]
    folder: Path
    synthetic: str = ""
    verification: tuple[str, ...] | None = None

    @property
    def shown_folder(self) -> str:
        """The folder as a shell's word."""
        return quote(str(self.folder))

    @property
    def model(self) -> str:
        """The new model's directory as a shell's word."""
        return quote(str(self.folder / "model"))


def report_html(diagnosis: Diagnosis, occasion: Occasion, pictures: Mapping[str, Path]) -> str:
    """The whole report. Raises OSError when a picture cannot be read."""
    data = {
        name: "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()
        for name, path in pictures.items()
        if name != SHEET
    }
    best = max((tried.gain for tried in diagnosis.candidates if isfinite(tried.gain)), default=0.0)
    unit, held = display_unit(diagnosis.unit), diagnosis.held_out
    environment = page_environment(
        "sim.lab.discrepancy.output",
        share=_share,
        span=lambda seconds: span(*seconds),
        shown_unit=display_unit,
        parameter=lambda value, kind, name: parameter_words(kind, name, value, 5),
    )
    return environment.get_template("diagnosis.html").render(
        one=diagnosis,
        unit=unit,
        occasion=occasion,
        meaning=MEANINGS[diagnosis.verdict],
        colour=COLOURS[diagnosis.verdict],
        missing=data.get(MISSING),
        told_share=MIN_LISTED_SHARE,
        began="" if diagnosis.began is None else beginning_sentence(diagnosis.began, unit),
        floor="" if diagnosis.floor is None else floor_sentence(diagnosis.floor, unit),
        held_out_count="" if held is None else held_out_count(held),
        shrinking_shown=all(effect.shrinking_shown for effect in diagnosis.effects),
        where=data.get(WHERE),
        cycles=data.get(CYCLES),
        errors=data.get(ERRORS),
        places=[place_sentence(place, unit) for place in told_places(diagnosis.places)[:MAX_LISTED]],
        looks=advice_lines(diagnosis),
        laws=[law_sentence(law) for law in diagnosis.laws],
        overlap=overlap_sentence(diagnosis.places),
        unexplained=[place_sentence(place, unit) for place in told_places(diagnosis.unexplained)],
        candidates=diagnosis.candidates,
        best=max(best, 1e-9),
        rivals={effect.name: name_rivals(effect, diagnosis.candidates) for effect in diagnosis.effects},
    )


def place_sentence(place: HeatPlace, unit: str) -> str:
    """One sentence of where heat is: "62 % of the unexplained heat is in ON/200-300, 0-4 min after W_ON, ...".

    `unit` is that of the temperature, as people read it.
    """
    after = f", {span(*place.seconds)} after {place.after}" if place.after else ""
    after += f", with {place.when}" if place.when else ""
    sign = "too little" if place.heat < 0 else "too much"
    sentence = (
        f"{place.share:.0%} of the unexplained heat is in {place.location}{after}: the plant makes "
        f"{abs(place.heat):.2g} {unit}/h {sign} for the model there, in {place.cycles[0]} of {place.cycles[1]} cycles "
        f"(p = {place.p:.2g})"
    )
    return sentence + (f"; it goes with {place.correlates}" if place.correlates and not place.when else "")


def name_rivals(effect: NamedEffect, candidates: Sequence[TriedEffect]) -> tuple[str, ...]:
    """The names that look somewhat like a named effect in these data, outside its class."""
    own = next((candidate for candidate in candidates if candidate.name == effect.name), None)
    return () if own is None else tuple(name for name in own.rivals if name not in effect.members)


def _share(value: float | None, digits: int = 0, sign: bool = False) -> str:
    if value is None or not isfinite(value):
        return "–"
    return f"{100 * value:{'+' if sign else ''}.{digits}f} %"
