"""In locations such as "ON/200+ #2" or "ON/0-120 rising" an effect of the running machine did not act.

L*_SHA adds to the alphabet's names, and the running locations were looked up by the bare names of the product.
"""

from sim.lab.discrepancy.fitting.named import running_locations
from tests.effects.engines import model_of


def test_a_location_runs_whatever_follows_its_name() -> None:
    assert running_locations(model_of("lsha")) == ("ON/0-120 rising", "ON/120+ #2")
