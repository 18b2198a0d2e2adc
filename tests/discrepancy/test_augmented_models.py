"""What a diagnosis adds acts where a flow says something, and its signals' ranges are learned with it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects.kinds import EFFECTS
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.fitting.named import Named, main_effect
from sim.lab.learning.semi_markov import fit_stays, with_inputs
from sim.proof.verification import verify
from sim.sha.automaton import Effect
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.rig.pair import TARGETS, known_model


def named(kind: str) -> Named:
    entry = next(entry for entry in catalogue() if entry.name == kind)
    signals = {role: role.capitalize() for role in EFFECTS[kind].required_roles}
    params = {name: max(given.low, 1.0) for name, given in EFFECTS[kind].parameters.items()}
    return Named(entry, signals, params)


@pytest.mark.parametrize("kind", [entry.name for entry in catalogue()])
def test_no_effect_acts_where_the_flow_says_nothing(kind: str) -> None:
    model = known_model()
    effect = main_effect(named(kind), model)
    silent = {place.name for place in model.sha.locations if place.flow.kind == "constant"}
    assert "ON/?" in silent
    if EFFECTS[kind].acts == "everywhere":
        assert effect.locations == ()
        return
    assert effect.locations and not silent & set(effect.locations)
    running = {name for name in TARGETS if name.startswith("ON/")}
    assert set(effect.locations) == (
        running if EFFECTS[kind].action_place(effect.signals) == "running" else set(TARGETS)
    )


def test_the_signals_of_effects_are_learned_per_stay_and_make_the_model_deployable() -> None:
    times = np.arange(0.0, 4000.0, 10.0)
    running = (times // 1000) % 2
    signals = {"Pump": np.where(running > 0, 0.8, 0.1), "TCuscinettiRiduttore": np.full(times.size, 30.0)}
    symbols = [("W_ON", 1000.0), ("A_1", 1000.0), ("W_OFF", 2000.0), ("A_0", 2000.0), ("W_ON", 3000.0), ("A_1", 3000.0)]
    trace = Trace("t", times, signals, tuple(Event(time, symbol) for symbol, time in symbols))
    plain = known_model()
    plain = replace(plain, semi_markov=fit_stays(plain, [trace]))
    cooled: Model = replace(
        plain,
        sha=replace(plain.sha, effects=(Effect("pump-cooling", {"loss": 1e-4, "sink": 10.0}, {"pump": "Pump"}),)),
    )
    assert not verify(cooled).deployable
    learned = with_inputs(cooled, [trace])
    stay = learned.semi_markov["ON/100-200"]
    assert stay.inputs["Pump"] == pytest.approx((0.8, 0.0), abs=1e-9)
    assert stay.law == plain.semi_markov["ON/100-200"].law
    assert verify(learned).deployable
