"""A fit is the likeliest of its rounds, however the later ones run off; none is made that could change nothing."""

import numpy as np

from sim.effects import ROLES
from sim.lab.discrepancy.fitting import build_frame, build_record, fit, move_frame, with_priors
from sim.lab.discrepancy.naming import entries_besides, step
from sim.lab.discrepancy.rules import RULES
from sim.sha.trace import Array
from tests.discrepancy.plants import TARGETS, model, plant

DELAY_S = 300.0


def on_its_way(time: Array, on: Array, current: Array) -> tuple[Array, Array]:
    """All heat of the running machine comes so late; what it loses, it loses at once."""
    rest = TARGETS["OFF"][0]
    target, k = np.where(current < 200.0, TARGETS["LOW"][0], TARGETS["HIGH"][0]), TARGETS["LOW"][1]
    heat = on * k * (target - rest)
    return np.interp(time - DELAY_S, time, heat, left=0.0) - heat, 0.0 * time


def test_a_refit_does_not_run_off_from_what_was_likelier_by_far() -> None:
    """Of such a plant the parameters of each round fit the noise before it and leave its free run by 18 degC."""
    record = build_record(model(), [plant(2, days=3, more=on_its_way)], ())
    frame = with_priors(move_frame(build_frame(record), record))
    first, whole = fit(frame, rounds=1), fit(frame)
    assert whole.likelihood > first.likelihood - 10.0
    assert np.sqrt(np.mean(whole.residual**2)) < 5.0


def test_a_fit_that_begins_where_another_one_ended_moves_nothing() -> None:
    record = build_record(model(), [plant(1, days=2)], ())
    frame = with_priors(move_frame(build_frame(record), record))
    ended = fit(frame, rounds=8)
    again = fit(frame, begin=ended, rounds=1, iterations=0)
    assert np.array_equal(again.state.parameters, ended.state.parameters)


def test_beside_an_effect_beyond_doubt_only_what_could_come_near_it_is_fitted() -> None:
    """The catalogue's screen gives several others some nats each; a refit of them would be a hundred short."""
    record = build_record(model(), [plant(2, days=4, pump=2e-4)], tuple(ROLES.values()))
    told: list[str] = []
    found = step(
        fit(with_priors(move_frame(build_frame(record), record))), entries_besides(()), ROLES, told.append, rules=RULES
    )
    assert found.best is not None and found.best.entry.name == "pump-cooling"
    others = [each for each in found.evidence[1:] if not each.is_joint]
    assert told[0] == "pump-cooling" and others
