"""What is certain and too small to matter is fitted along, has no name, and hides no effect that matters."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy import judging, path
from sim.lab.discrepancy.evidence import small_effects, tried_effects
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.fitting.free_run_fit import Fitted, fit
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.rules import RULES
from sim.sha.events import encode
from sim.sha.trace import Array
from tests.discrepancy.plants import ALPHABET, PERIOD, model, plant

ROLES = {"vibration": "VibrazioneCuscinetti", "pump": "MarciaPmpFango"}
COARSE = replace(RULES, material_sigmas=2.0)
"""What is less than two readings' errors does not matter."""
SHAKES, COOLS = "vibration-friction", "pump-cooling"


@pytest.fixture(scope="module")
def base() -> Fitted:
    """A plant that is cooled by its pump, and heated a little by a vibration that changes each minute."""
    shaking = np.repeat(np.random.default_rng(77).choice([1.0, 3.0], int(86400 / PERIOD) // 2 + 1), 2)

    def heat(times: Array, running: Array, _: Array) -> tuple[Array, Array]:
        return 9e-4 * (shaking[: times.size] - 2.0) * running, 0.0 * times

    trace = plant(3, days=1, pump=4e-5, more=heat)
    trace = replace(trace, signals={**trace.signals, ROLES["vibration"]: shaking[: trace.times.size]}, events=())
    record = build_record(model(), [replace(trace, events=encode(trace, ALPHABET))], tuple(ROLES.values()))
    return fit(move_frame(build_frame(record), record))


def look(base: Fitted, *names: str) -> judging.NamingResult:
    """The path to one name at most, with these effects in the catalogue."""
    entries = [entry for entry in catalogue() if entry.name in names]
    return path.name(base, ROLES, 1, lambda *_: None, rules=COARSE, entries=entries)[0]


def test_a_small_certain_effect_is_fitted_along_and_the_one_that_matters_is_named(base: Fitted) -> None:
    found = look(base, SHAKES, COOLS)
    (small,) = found.nuisances
    assert small.best is not None and small.best.entry.name == SHAKES
    assert [each.best.entry.name for each in found.accepted_steps if each.best is not None] == [COOLS]
    # It was fitted along while the name was looked for, and is in no fit that is given back.
    assert [named.entry.name for named in found.accepted_steps[0].before.state.named] == [SHAKES]
    assert [named.entry.name for named in found.fitted.state.named] == [COOLS]
    assert found.best_fit is found.fitted
    fates = {each.name: each.fate for each in tried_effects(found.looks, kept=True) if each.step > 1}
    assert fates[SHAKES] == judging.TOO_SMALL
    assert [each.name for each in small_effects(found)] == [SHAKES]


def test_where_nothing_else_is_missing_the_small_one_is_all_that_is_told(base: Fitted) -> None:
    found = look(base, SHAKES)
    ((only, refusal),) = found.steps
    assert refusal == judging.TOO_SMALL and only.best is not None and only.best.entry.name == SHAKES
    assert (found.accepted_steps, found.nuisances) == ((), ())
    assert found.fitted is base
    assert [each.name for each in small_effects(found)] == [SHAKES]
