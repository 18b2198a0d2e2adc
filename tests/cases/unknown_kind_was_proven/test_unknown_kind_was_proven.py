"""A kind of which the verification knew no bound was passed over, and the model was "proven, deployable".

Measured then: its mean course ran to the clamp at 500 degC.
"""

from dataclasses import replace

from sim.effects.kind import EffectRefusal
from sim.proof.envelope import Assumptions
from sim.proof.verification import verify
from tests.effects.engines import automaton, model_of, named, trace_of, with_effects
from tests.effects.made_up import HUMIDITY_HEATING, known


def test_what_cannot_be_bounded_is_not_decided_and_not_deployed() -> None:
    with known(replace(HUMIDITY_HEATING, bound=EffectRefusal("no range of it is known"))):
        hot = named("humidity-heating", {"humidity": "I"}, {"gain": 1.0, "reference": 0.0})
        model = with_effects(model_of("own names"), hot)
        assert automaton(model, trace_of()).max() == 500.0
        found = verify(model, assumptions=Assumptions(inputs={"I": (0.0, 250.0)}))
    assert not found.deployable
    assert found.check("growth").verdict == "not decided"
    assert found.reasons == (
        "growth not decided: effects of the kind 'humidity-heating' are not bounded: no range of it is known",
    )
