"""The same effect on the same record has the same course in every engine: there is one physics, that of the table."""

import numpy as np
import pytest

from sim.effects.kinds import EFFECTS
from sim.engine.open_loop_run import open_loop
from tests.effects.engines import (
    automaton,
    exported,
    filtered,
    fitted,
    model_of,
    named,
    sampled,
    trace_of,
    with_effects,
)
from tests.sha.effect_reference import EFFECTS as EXAMPLES

FIT: dict[str, float] = {"thermostatic-cooling": 3.3, "sensor-lag": 0.09}
"""degC by which the fit's course differs at most, where it is more than 0.03: it holds a law over a step of the record.
Thermostats that cycle lose step with one another, and then differ by their hysteresis; a lag is late by half a step."""
LEARNERS = ("bins", "lsha", "own names")


def test_every_kind_has_an_example() -> None:
    assert {effect.kind for effects in EXAMPLES.values() for effect in effects} == set(EFFECTS)


def test_every_optional_role_is_present_in_one_example_and_absent_in_another() -> None:
    for kind in EFFECTS.values():
        filled = [
            set(effect.signals) for effects in EXAMPLES.values() for effect in effects if effect.kind == kind.name
        ]
        for role in kind.optional:
            assert any(role in each for each in filled) and any(role not in each for each in filled), (kind.name, role)


CASES = [
    pytest.param(name, learner, first, id=f"{name}-{learner}{'-read late' if first else ''}")
    for name, (example,) in EXAMPLES.items()
    for learner in LEARNERS
    for first in ((0.0, 250.0) if example.signals else (0.0,))
]


@pytest.mark.parametrize(("name", "learner", "first"), CASES)
def test_all_engines_have_one_course(name: str, learner: str, first: float) -> None:
    (example,) = EXAMPLES[name]
    one = named(example.kind, dict(example.signals), dict(example.params))
    plain, trace = model_of(learner), trace_of(first)
    model = with_effects(plain, one)
    assert len(model.sha.effects) == 1
    expected = automaton(model, trace)
    assert np.abs(expected - automaton(plain, trace)).max() > 0.2, "the effect must be seen"
    np.testing.assert_allclose(fitted(plain, one, trace), expected, atol=FIT.get(example.kind, 0.03))
    exact = 5e-4 if example.kind == "radiation-loss" else 1e-4  # a tangent that is taken once a segment
    np.testing.assert_allclose(filtered(model, trace), expected, atol=exact)
    np.testing.assert_allclose(sampled(model, trace), expected, atol=exact)
    times, read = exported(model, trace)
    native = open_loop(model, trace, "resync")
    rows = np.searchsorted(native.times, times + 1e-5) - 1
    near = np.abs(native.times[rows] - times) < 1e-4  # a dead time's events lie between the rows
    assert near.any()
    bound = 0.05 if example.kind == "thermostatic-cooling" else 2e-3
    np.testing.assert_allclose(read[near], native.mean[rows][near], atol=bound)
