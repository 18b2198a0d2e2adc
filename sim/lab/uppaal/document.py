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
    """The template engine; it keeps the templates that it has compiled. A template of somebody else can call nothing
    but what text and lists are asked."""
    from jinja2 import PackageLoader, StrictUndefined
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    return ImmutableSandboxedEnvironment(
        loader=PackageLoader("sim.lab.uppaal"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def xml_text(system: System, template: str = "") -> str:
    """The document as UPPAAL's graphical editor and verifyta read it; all text is escaped by the template engine.

    `template` is the text of another Jinja template than this program's own, with the same names. Raises ValueError
    with its line where it cannot be used.
    """
    from jinja2 import TemplateError, TemplateSyntaxError

    # The file format refers to locations by ids, which are unique within a template only.
    numbers = {
        template.name: {place.name: f"id{index}" for index, place in enumerate(template.places)}
        for template in system.templates
    }
    try:
        found = _engine().from_string(template) if template else _engine().get_template("system.xml")
        return found.render(system=system, doctype=DOCTYPE, ids=numbers)
    except TemplateSyntaxError as error:
        raise ValueError(f"line {error.lineno} of the template: {error.message}") from None
    except (TemplateError, ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as error:
        raise ValueError(f"the template cannot be filled in: {error}") from None


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
