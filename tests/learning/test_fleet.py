"""Which machine of a fleet stands out: a stated share of false ones, and the true one by its own runs."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects import with_targets
from sim.lab.learning import GroupTargets, LearningError, StandsOut, find_outliers, grouped_targets, own_targets
from sim.lab.learning.bins.candidates import CANDIDATES
from sim.lab.learning.bins.learn import learn_bins
from sim.sha import Model
from sim.sha.events import DECANTER
from tests.learning.plants import with_signal
from tests.learning.test_machines import of_machine
from tests.rig.no_bands import without_bands


def drawn(
    rng: np.random.Generator, machines: int, shifts: dict[tuple[str, str], float] | None = None, differ: float = 0.5
) -> dict[str, tuple[StandsOut, ...]]:
    """The machines said to stand out of so many alike, some of which are shifted in a group.

    Their errors differ, and each is an estimate from eight runs.
    """
    fleet: dict[str, dict[str, GroupTargets]] = {f"m{number}": {} for number in range(machines)}
    for group in ("OFF", "ON", "ON/100-200"):
        true = 0.4 * np.exp(0.5 * rng.standard_normal(machines))
        offset = rng.normal(0.0, np.hypot(differ, true))
        told = true * np.sqrt(rng.chisquare(7, machines) / 7)
        for (name, own), one, error in zip(fleet.items(), offset.tolist(), told.tolist(), strict=True):
            own[group] = GroupTargets(one + (shifts or {}).get((name, group), 0.0), error, 8)
    return find_outliers(fleet)


@pytest.mark.parametrize("differ", [0.0, 2.0])
@pytest.mark.parametrize("machines", [6, 30])
def test_of_machines_alike_one_in_a_hundred_fleets_has_one_that_stands_out(machines: int, differ: float) -> None:
    rng = np.random.default_rng(machines)
    false = sum(bool(drawn(rng, machines, differ=differ)) for _ in range(400))
    assert false <= 10, "more would be a chance of 0.003 at a rate of 1 %"


def test_one_that_is_far_off_is_found_where_it_is_and_so_are_two_of_many() -> None:
    rng = np.random.default_rng(1)
    one = [drawn(rng, 20, {("m3", "ON"): 6.0}) for _ in range(40)]
    assert sum([place.group for place in found.get("m3", ())] == ["ON"] for found in one) >= 36
    found = next(found for found in one if "m3" in found)["m3"][0]
    assert found.beyond == pytest.approx(6.0, abs=2.5) and 0.3 < found.differ < 1.5 and found.chance <= 0.01
    two = [drawn(rng, 40, {("m3", "ON"): 7.0, ("m7", "OFF"): -7.0}) for _ in range(40)]
    assert sum({"m3", "m7"} <= set(found) for found in two) >= 36
    assert drawn(rng, 4, {("m3", "ON"): 50.0}) == {}, "of four machines nobody knows by what the others differ"


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


def test_targets_that_are_off_while_it_runs_are_found_there_and_not_at_rest(model: Model) -> None:
    traces = of_machine("x", 0.0, 20, cycles=5)
    pairs = zip(model.sha.locations, with_targets(model.sha, -7.0).locations, strict=True)
    running = tuple(moved if moved.name.startswith("ON/") else place for place, moved in pairs)
    colder = replace(model, sha=replace(model.sha, locations=running))
    before, after = grouped_targets(model, traces), grouped_targets(colder, traces)
    assert after["ON"].offset - before["ON"].offset == pytest.approx(7.0, abs=0.3)
    assert after["OFF"].offset - before["OFF"].offset == pytest.approx(0.0, abs=0.3)
    assert {"OFF", "ON"} < set(after) and all(each.runs == 8 and each.error > 0 for each in after.values())


def test_what_its_runs_do_not_tell_is_a_sentence(model: Model) -> None:
    (trace,) = of_machine("x", 0.0, 1, cycles=1)
    short = replace(trace.between(trace.times[0], trace.times[0] + 30.0), events=())
    with pytest.raises(LearningError, match="at least 2"):
        own_targets(model, [short])
    empty = with_signal(trace, T=np.full(trace.times.size, np.nan))
    with pytest.raises(LearningError, match="at least 2"):
        own_targets(model, [empty])
    assert grouped_targets(model, [empty]) == {} == grouped_targets(model, [short])
