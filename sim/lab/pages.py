"""How pages are made of templates: one stylesheet for all, every text escaped, every name known."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def page_environment(package: str, **filters: Callable[..., str]) -> Environment:
    """The templates of a package with these filters, each template compiled once; `page.html` is there to be extended.

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
    environment.filters |= filters
    return environment
