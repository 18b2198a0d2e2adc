"""A feed without a pump's signal was fitted while the machine runs, and executed at rest too: 9.8 degC apart."""

import numpy as np
import pytest

from tests.effects.engines import OUTPUTS, automaton, fitted, model_of, named, trace_of, with_effects


@pytest.mark.parametrize("signals", [{"feed": "Ta"}, {"feed": "Ta", "pump": "P"}], ids=["without", "with a pump"])
def test_a_feed_acts_where_it_was_fitted(signals: dict[str, str]) -> None:
    one, trace = named("feed-temperature-coupling", signals, {"loss": 3e-3}), trace_of()
    model = with_effects(model_of("bins"), one)
    resting = {"OFF/0-120", "OFF/120+"}
    assert bool(resting & set(model.sha.effects[0].locations)) == ("pump" in signals)
    np.testing.assert_allclose(fitted(model_of("bins"), one, trace), automaton(model, trace), atol=0.03)
    assert OUTPUTS.size == automaton(model, trace).size
