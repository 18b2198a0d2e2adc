"""A pump's signal below 0 warmed in the fit and did nothing in the automaton, which counts it as 0."""

import numpy as np

from tests.effects.engines import automaton, fitted, model_of, named, trace_of, with_effects


def test_a_negative_pump_counts_as_zero_in_the_fit_too() -> None:
    trace = trace_of()
    assert np.nanmin(trace.signals["P"]) == -1.0
    one = named("pump-cooling", {"pump": "P"}, {"loss": 5e-3, "sink": 25.0})
    run = automaton(with_effects(model_of("bins"), one), trace)
    np.testing.assert_allclose(fitted(model_of("bins"), one, trace), run, atol=0.03)
