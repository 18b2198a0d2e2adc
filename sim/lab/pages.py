"""How pages are made of templates: one stylesheet for all, every text escaped, every name known."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def page_environment(package: str, **filters: Callable[..., str]) -> Environment:
    """The templates of a package with these filters beside `number` and `figure`; `page.html` is there to be extended.

    Names of models, signals and traces come from whoever wrote them: they are escaped, and a variable that a template
    misspells stops the page instead of leaving a hole in it.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("sim.lab")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "figure": figure, **filters}
    return environment


def number(value: float | None, digits: int = 2, sign: bool = False) -> str:
    """A number with so many decimals; a dash where there is none."""
    if value is None or not isfinite(value):
        return "–"
    return f"{value:{'+' if sign else ''}.{digits}f}"


def figure(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits; a dash where there is none."""
    return f"{value:.{digits}g}" if value is not None and isfinite(value) else "–"
