"""Where locations, edges and their texts are drawn, so that the exported automaton can be read in UPPAAL's editor."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import cos, hypot, pi, sin

from sim.uppaal.document import Arrow, Point, Template, TemplateLocation

STEP = 380
"""Distance of neighbouring locations on the circle, in UPPAAL's pixels: room for an invariant between them."""


def on_a_circle(template: Template) -> Template:
    """The template with its locations on a circle, in their order, and its edges bent so that none hides another."""
    count = len(template.places)
    radius = max(1.0, STEP * count / (2 * pi))
    angles = [2 * pi * index / count - pi / 2 for index in range(count)]  # from the top on, clockwise
    at = [(round(radius * cos(angle)), round(radius * sin(angle))) for angle in angles]
    places = tuple(replace(place, at=point) for place, point in zip(template.places, at, strict=True))
    return replace(template, places=places, arrows=_arrows(places, template.arrows))


def in_a_row(template: Template) -> Template:
    """The template with its locations from left to right, for the players with their few locations."""
    places = tuple(replace(place, at=(STEP * index, 0)) for index, place in enumerate(template.places))
    return replace(template, places=places, arrows=_arrows(places, template.arrows))


def _arrows(places: Sequence[TemplateLocation], arrows: Sequence[Arrow]) -> tuple[Arrow, ...]:
    at = {place.name: place.at for place in places}
    number: Counter[tuple[str, str]] = Counter()
    drawn = []
    for arrow in arrows:
        pair = (arrow.source, arrow.target)
        number[pair] += 1
        drawn.append(_loop(arrow, at, number[pair]) if pair[0] == pair[1] else _line(arrow, at, number[pair]))
    return tuple(drawn)


def _loop(arrow: Arrow, at: dict[str, Point], number: int) -> Arrow:
    """A loop above its location; a later one stands higher."""
    x, y = at[arrow.source]
    top = y - 60 - 60 * number
    return replace(arrow, nails=((x - 30 - 6 * number, top), (x + 30 + 6 * number, top)), labels=(x - 30, top - 54))


def _line(arrow: Arrow, at: dict[str, Point], number: int) -> Arrow:
    """A line with one corner beside its middle: the way back, and a second edge, take other corners."""
    (x0, y0), (x1, y1) = at[arrow.source], at[arrow.target]
    length = hypot(x1 - x0, y1 - y0) or 1.0
    aside = 60.0 * number
    x = round((x0 + x1) / 2 - (y1 - y0) / length * aside)
    y = round((y0 + y1) / 2 + (x1 - x0) / length * aside)
    return replace(arrow, nails=((x, y),), labels=(x + 6, y - 8))
