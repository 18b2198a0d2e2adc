"""Which machine of a fleet stands out: a stated share of false ones, and the true one by its own runs."""

from dataclasses import replace

import numpy as np
import pytest

from sim.learning import LearningError, outstanding, own_targets, spread_of
from sim.learning.bins.candidates import CANDIDATES
from sim.learning.bins.learn import learn_bins
from sim.sha import Model
from sim.sha.events import DECANTER
from tests.learning.plants import with_signal
from tests.learning.test_machines import of_machine
from tests.rig.no_bands import without_bands


def drawn(rng: np.random.Generator, machines: int, shifts: dict[str, float] | None = None) -> dict[str, float]:
    """The machines said to stand out of so many alike (2 degC apart), some of which are shifted."""
    error = rng.uniform(0.2, 1.5, machines)
    offset = rng.normal(0.0, 2.0, machines) + rng.normal(0.0, error)
    names = [f"m{number}" for number in range(machines)]
    offsets = {name: float(value) + (shifts or {}).get(name, 0.0) for name, value in zip(names, offset, strict=True)}
    return outstanding(spread_of(offsets, dict(zip(names, error.tolist(), strict=True))))


@pytest.mark.parametrize("machines", [6, 20])
def test_of_machines_alike_one_in_a_hundred_fleets_has_one_that_stands_out(machines: int) -> None:
    rng = np.random.default_rng(machines)
    false = sum(bool(drawn(rng, machines)) for _ in range(300))
    assert false <= 8, "more would be a chance of 0.004 at a rate of 1 %"


def test_one_that_is_far_off_is_found_and_so_are_two_of_many() -> None:
    rng = np.random.default_rng(1)
    assert sum(set(drawn(rng, 20, {"m3": 16.0})) == {"m3"} for _ in range(40)) >= 36
    assert sum({"m3", "m7"} <= set(drawn(rng, 40, {"m3": 18.0, "m7": -18.0})) for _ in range(40)) >= 32
    assert drawn(rng, 4, {"m3": 50.0}) == {}, "of four machines nobody knows by what the others differ"


@pytest.fixture(scope="module")
def model() -> Model:
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        return learn_bins(of_machine("m", 0.0, 3, cycles=4), DECANTER, "T", seed=0, candidates=CANDIDATES[:1]).model


def test_the_targets_of_a_machine_are_found_from_its_own_runs(model: Model) -> None:
    own = [own_targets(model, of_machine("x", offset, 20, cycles=5)) for offset in (0.0, 7.0)]
    # The same days, so that what these had of their own drops out.
    assert own[1].correction.offset - own[0].correction.offset == pytest.approx(7.0, abs=0.5)
    assert abs(own[0].correction.offset) < 3.0 * own[0].offset_error + 1.0
    assert own[1].correction.gain == 1.0 and own[1].after < own[1].before


def test_what_its_runs_do_not_tell_is_a_sentence(model: Model) -> None:
    (trace,) = of_machine("x", 0.0, 1, cycles=1)
    short = replace(trace.between(trace.times[0], trace.times[0] + 30.0), events=())
    with pytest.raises(LearningError, match="at least 2"):
        own_targets(model, [short])
    empty = with_signal(trace, T=np.full(trace.times.size, np.nan))
    with pytest.raises(LearningError, match="at least 2"):
        own_targets(model, [empty])
