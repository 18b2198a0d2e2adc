"""How pages are made of templates: one stylesheet for all, every text escaped, every name known."""

from collections.abc import Callable
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined


@cache
def page_environment(package: str, **filters: Callable[..., str]) -> Environment:
    """The templates of a package with these filters, each template compiled once; `page.html` is there to be extended.

    Names of models, signals and traces come from whoever wrote them: they are escaped, and a variable that a template
    misspells stops the page instead of leaving a hole in it.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("sim")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters
    return environment
