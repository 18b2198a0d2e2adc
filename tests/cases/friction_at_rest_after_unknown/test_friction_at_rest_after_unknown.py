"""Where the location names were not the alphabet's, an effect of the running machine acted at rest too.

The search for the running locations compared an edge's symbol with "UNKNOWN", and the encoder's symbol is "unknown":
the edge that leads from every location to the initial one made that one "running", 20 to 26 degC too warm.
"""

from sim.lab.discrepancy.fitting.named import main_effect, running_locations
from tests.effects.engines import model_of, named


def test_unknown_leads_to_no_running_location() -> None:
    model = model_of("own names")
    assert running_locations(model) == ("q1", "q2")
    one = named("torque-friction", {"torque": "M"}, {"gain": 1e-3, "reference": 20.0, "power": 1.0})
    assert main_effect(one, model).locations == ("q1", "q2")
