"""Units as they are kept and as people read them."""

DEFAULT_UNIT = "degC"
"""The unit of what a model follows, where nobody says another one."""


def display_unit(unit: str) -> str:
    """A unit as people read it: °C for degC."""
    return unit.replace(DEFAULT_UNIT, "°C")
