"""A UPPAAL document as plain records, and its XML text by a template with named placeholders."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from jinja2 import Environment


DOCTYPE = (
    "<!DOCTYPE nta PUBLIC '-//Uppaal Team//DTD Flat System 1.6//EN' "
    "'http://www.it.uu.se/research/group/darts/uppaal/flat-1_6.dtd'>"
)

Point = tuple[int, int]


@dataclass(frozen=True, slots=True)
class TemplateLocation:
    """A location of a template: its identifier, where it is drawn, its invariant (rates included) and its kind."""

    name: str
    at: Point = (0, 0)
    invariant: str = ""
    kind: Literal["", "urgent", "committed"] = ""
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Arrow:
    """An edge of a template; `labels` is where its text begins, `nails` the corners of its line."""

    source: str
    target: str
    guard: str = ""
    sync: str = ""
    update: str = ""
    nails: tuple[Point, ...] = ()
    labels: Point = (0, 0)


@dataclass(frozen=True, slots=True)
class Template:
    """One automaton: declarations, locations, edges, and the location where it starts."""

    name: str
    declaration: str
    places: tuple[TemplateLocation, ...]
    arrows: tuple[Arrow, ...]
    initial: str


@dataclass(frozen=True, slots=True)
class ExportedQuery:
    """A query in UPPAAL's words and what it asks for."""

    formula: str
    comment: str = ""


@dataclass(frozen=True, slots=True)
class System:
    """The whole document: global declarations, templates, (instance, template) pairs and queries."""

    title: str
    declaration: str
    templates: tuple[Template, ...]
    instances: tuple[tuple[str, str], ...]
    questions: tuple[ExportedQuery, ...] = field(default=())


@cache
def _engine() -> Environment:
    """The template engine; it keeps the template that it has compiled."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("sim.lab.uppaal"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def xml_text(system: System) -> str:
    """The document as UPPAAL's graphical editor and verifyta read it; all text is escaped by the template engine."""
    # The file format refers to locations by ids, which are unique within a template only.
    numbers = {
        template.name: {place.name: f"id{index}" for index, place in enumerate(template.places)}
        for template in system.templates
    }
    return _engine().get_template("system.xml").render(system=system, doctype=DOCTYPE, ids=numbers)


def number(value: float) -> str:
    """A double as UPPAAL reads it: always with a point or an exponent, so that it is no integer.

    Raises ValueError for what UPPAAL has no word for.
    """
    if not isfinite(value):
        raise ValueError(f"UPPAAL has no literal for the number {value}; give the model finite parameters")
    return repr(float(value) + 0.0)  # -0.0 becomes 0.0


def comment_text(text: str) -> str:
    """Free text (names from files) as ASCII on one line, fit for a comment in UPPAAL's declarations."""
    ascii_text = text.encode("ascii", "backslashreplace").decode("ascii")
    return " ".join("".join(sign if sign.isprintable() else " " for sign in ascii_text).split()).replace("*/", "* /")
