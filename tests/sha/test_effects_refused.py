"""What does not do effects says so in one sentence, before any result."""

import numpy as np
import pytest

from sim.engine.schedules import schedule, step_coefficients
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from tests.sha.effect_reference import EFFECTS, plant

MODEL = Model(plant("exponential", EFFECTS["wear-drift"]), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1)


def test_a_calculation_with_the_flows_alone_declines() -> None:
    steps = schedule(MODEL, [], np.array([0.0, 10.0]))
    with pytest.raises(ValueError, match="closed forms does not do effects yet, and model 'augmented' has wear-drift"):
        step_coefficients(steps)
