"""How pages are made of templates: the one place that says that every text is escaped and every name must be known."""

from collections.abc import Callable
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined


@cache
def page_environment(package: str, **filters: Callable[..., str]) -> Environment:
    """The templates of a package with these filters, each template compiled once.

    Names of models, signals and traces come from whoever wrote them: they are escaped, and a variable that a template
    misspells stops the page instead of leaving a hole in it.
    """
    environment = Environment(
        loader=PackageLoader(package), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters
    return environment
