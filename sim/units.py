"""Units as they are kept and as people read them."""

DEGREES = "degC"
"""The unit of what a model follows, where nobody says another one."""


def shown_unit(unit: str) -> str:
    """A unit as people read it: °C for degC."""
    return unit.replace(DEGREES, "°C")
