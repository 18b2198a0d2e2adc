"""The report's blocks as one HTML page that needs nothing else."""

from collections.abc import Sequence
from dataclasses import fields

from gateway.commission.acceptance.blocks import Block
from sim.lab.pages import page_environment


def page(made: Sequence[Block], title: str) -> str:
    """The page; every text in it is escaped."""
    plain = [
        {"kind": type(block).__name__, **{field.name: getattr(block, field.name) for field in fields(block)}}
        for block in made
    ]
    return (
        page_environment("gateway.commission.acceptance")
        .get_template("report.html.j2")
        .render(blocks=plain, title=title)
    )
