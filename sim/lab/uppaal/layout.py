"""Where locations, edges and their texts are drawn, so that the exported automaton can be read in UPPAAL's editor."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import cos, hypot, pi, sin

from sim.lab.uppaal.document import Arrow, Point, Template, TemplateLocation

LOCATION_SPACING_PX = 380
"""Distance of neighbouring locations on the circle, in UPPAAL's pixels: room for an invariant between them."""


def on_a_circle(template: Template) -> Template:
    """The template with its locations on a circle, in their order, and its edges bent so that none hides another."""
    count = len(template.places)
    radius = max(1.0, LOCATION_SPACING_PX * count / (2 * pi))
    angles = [2 * pi * index / count - pi / 2 for index in range(count)]  # from the top on, clockwise
    at = [(round(radius * cos(angle)), round(radius * sin(angle))) for angle in angles]
    places = tuple(replace(place, at=point) for place, point in zip(template.places, at, strict=True))
    return replace(template, places=places, arrows=_arrows(places, template.arrows))


def in_a_row(template: Template) -> Template:
    """The template with its locations from left to right, for the players with their few locations."""
    places = tuple(replace(place, at=(LOCATION_SPACING_PX * index, 0)) for index, place in enumerate(template.places))
    return replace(template, places=places, arrows=_arrows(places, template.arrows))


def _arrows(places: Sequence[TemplateLocation], arrows: Sequence[Arrow]) -> tuple[Arrow, ...]:
    at = {place.name: place.at for place in places}
    numbers: Counter[tuple[str, str]] = Counter()
    drawn = []
    for arrow in arrows:
        pair = (arrow.source, arrow.target)
        numbers[pair] += 1
        number = numbers[pair]
        (x0, y0), (x1, y1) = at[arrow.source], at[arrow.target]
        if arrow.source == arrow.target:
            # A loop above its location; a later one stands higher.
            top = y0 - 60 - 60 * number
            nails: tuple[Point, ...] = ((x0 - 30 - 6 * number, top), (x0 + 30 + 6 * number, top))
            labels = (x0 - 30, top - 54)
        else:
            # A line with one corner beside its middle. The corner lies to one side as seen from the source, so the way
            # back takes the other side; a second edge lies farther out.
            length = hypot(x1 - x0, y1 - y0) or 1.0
            aside = 60.0 * number
            x = round((x0 + x1) / 2 - (y1 - y0) / length * aside)
            y = round((y0 + y1) / 2 + (x1 - x0) / length * aside)
            nails, labels = ((x, y),), (x + 6, y - 8)
        drawn.append(replace(arrow, nails=nails, labels=labels))
    return tuple(drawn)
