"""What entering a location does to the mode parameter m and to the temperature X, in one place for all who need it."""

from sim.sha import distributions
from sim.sha.automaton import Distribution, Location
from sim.sha.flows import FIXED_PARAMETER, RELAXING_FLOWS


def draw_parameter(location: Location) -> Distribution | None:
    """The law from which a stay draws its mode parameter m; None when m is fixed (see `mode_parameter`)."""
    return (
        location.distribution if location.entry == "parameter" and FIXED_PARAMETER not in location.flow.params else None
    )


def draw_temperature(location: Location) -> Distribution | None:
    """The law from which X is drawn on entry (`resample`); None when X stays continuous."""
    return location.distribution if location.entry == "resample" else None


def mode_parameter(location: Location) -> tuple[float, float]:
    """Mean and variance of the mode parameter m of a stay, in the flow's unit of m.

    Every stay has its own m: drawn from the location's law (`parameter`), or else fixed, at the flow's own constant
    `m` where it has one, at the law's mean where that has m's unit (every `none`, and `resample` under a flow that
    moves towards m), and at 0 otherwise.
    """
    law = draw_parameter(location)
    if law is not None:
        return distributions.mean(law), distributions.variance(law)
    fixed = location.flow.params.get(FIXED_PARAMETER)
    if fixed is not None:
        return fixed, 0.0
    usable = location.entry == "none" or location.flow.kind in RELAXING_FLOWS
    if location.distribution is not None and usable:
        return distributions.mean(location.distribution), 0.0
    return 0.0, 0.0
