"""What a diagnosis keeps in memory of the fits that it has made."""

import numpy as np

from sim.lab.discrepancy.fitting import build_frame, build_record, catalogue, fit, restore_fit, slim
from sim.lab.discrepancy.naming import step
from sim.lab.discrepancy.rules import RULES
from tests.discrepancy.plants import model, plant


def test_only_the_best_of_a_step_keeps_its_free_run_and_the_others_give_it_again() -> None:
    record = build_record(model(), [plant(3, pump=2e-4, days=2)], ("MarciaPmpFango",))
    base = fit(build_frame(record))
    entries = [each for each in catalogue() if each.name in ("pump-cooling", "startup-churning", "wear-drift")]
    best, *others = step(base, entries, {"pump": "MarciaPmpFango"}, rules=RULES).evidence
    assert best.fitted is not None and best.fitted.state.mean.size
    assert not any(each.fitted.state.mean.size for each in others if each.fitted is not None)
    again = restore_fit(slim(best.fitted))
    np.testing.assert_allclose(again.state.mean, best.fitted.state.mean, atol=1e-9)
    np.testing.assert_allclose(again.grid.heats, best.fitted.grid.heats, atol=1e-9)
