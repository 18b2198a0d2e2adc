"""The report's blocks as one HTML page that needs nothing else."""

from collections.abc import Sequence
from dataclasses import fields

from jinja2 import Environment, PackageLoader, StrictUndefined

from gateway.commission.acceptance.blocks import Block


def page(made: Sequence[Block], title: str) -> str:
    """The page; every text in it is escaped."""
    world = Environment(
        loader=PackageLoader("gateway.commission.acceptance"),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    plain = [
        {"kind": type(block).__name__, **{field.name: getattr(block, field.name) for field in fields(block)}}
        for block in made
    ]
    return world.get_template("report.html.j2").render(blocks=plain, title=title)
